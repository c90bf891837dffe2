"""The list of kept runs, and the command `viewnet runs`."""

from __future__ import annotations

import json

import pytest
from helpers.fake_steps import STEPS
from helpers.simulated_faults import can_mount, read_only

from viewnet import cli, paths
from viewnet.errors import ViewnetError
from viewnet.recipes import make_config
from viewnet.runs import kept_runs
from viewnet.runs.run_store import ensure
from viewnet.runtime.files import locked, read_json, write_json


@pytest.fixture
def runs(folders, monkeypatch):
    """Two finished runs of cars that differ in epochs, and one of chairs that was stopped."""
    monkeypatch.setenv("VIEWNET_TABLES", str(folders / "tables"))
    configs = [make_config(profile="smoke"), make_config(profile="smoke", epochs=9), make_config(category="chair")]
    made = ensure(configs, 1, progress=False, steps=STEPS)
    (made[2].folder / "result.json").unlink()
    return made


def command(capsys, *arguments: str) -> str:
    assert cli.main(["runs", *arguments]) == 0
    return capsys.readouterr().out


def test_runs_are_listed_with_what_they_reached(runs):
    table = kept_runs.listed()
    assert sorted(table["key"]) == sorted(run.key for run in runs)
    assert list(table["state"]) == ["finished", "finished", "stopped"]
    assert list(table.columns) == list(kept_runs.FIELDS)
    metrics = runs[0].result["metrics"]["procrustes"]
    (row,) = table[table["key"] == runs[0].key].to_dict("records")
    assert (row["acc30"], row["median"]) == (metrics["acc30"], metrics["median"])
    assert (row["category"], row["profile"], row["seed"], row["epochs"]) == ("car", "smoke", 0, 4)
    assert row["reconstruction"] == runs[0].reconstruction == runs[0].log["val_reconstruction"].iloc[-1] == 0.035
    assert row["bytes"] == sum(path.stat().st_size for path in runs[0].folder.rglob("*"))
    assert kept_runs.listed(category="chair")["acc30"].isna().all()
    assert kept_runs.listed(recipe="paper").empty


def test_a_run_that_is_being_made_is_said_to_be_and_not_removed(runs):
    folder = runs[2].folder
    with locked(folder):
        (state,) = kept_runs.listed(category="chair")["state"]
        assert state == "in training"
        with pytest.raises(ViewnetError, match="being made by another process"):
            kept_runs.remove(folder)
    assert (folder / "config.json").is_file()


def test_a_stopped_run_is_said_to_be_where_nothing_can_be_written(runs, tmp_path):
    if not can_mount(tmp_path):
        pytest.skip("needs the right to mount file systems")
    with read_only(runs[2].folder.parent):
        assert list(kept_runs.listed(category="chair")["state"]) == ["stopped"]


@pytest.mark.parametrize("damage", ["{", "[]", '{"variant": "viewnet"}', ""])
def test_a_run_that_cannot_be_read_is_listed_as_damaged(runs, damage):
    (runs[0].folder / "config.json").write_text(damage)
    table = kept_runs.listed().set_index("key")
    assert table["state"][runs[0].key] == "damaged"
    assert table["state"][runs[1].key] == "finished"
    with pytest.raises(ViewnetError, match=runs[0].key):
        kept_runs.read(runs[0].folder)


def test_keys_may_be_shortened_to_where_they_are_unique(runs):
    first, second = runs[0].key, runs[1].key
    alike = next(i for i in range(12) if first[i] != second[i])
    assert kept_runs.find(first[:11]) == runs[0].folder
    if alike:
        with pytest.raises(ViewnetError, match="2 keys begin so"):
            kept_runs.find(first[:alike])
    for wrong in ("", "xyz"):
        with pytest.raises(ViewnetError, match="no such key"):
            kept_runs.find(wrong)


def test_the_command_lists_shows_compares_and_removes(runs, capsys):
    write_json(paths.tables() / "table9.json", {"runs": {f"{runs[0].key}/linear": {}}})
    text = command(capsys)
    assert all(run.key in text for run in runs)
    assert runs[2].key not in command(capsys, "--category", "car")
    assert command(capsys, "--recipe", "paper") == "no runs\n"
    (chair,) = json.loads(command(capsys, "--category", "chair", "--json"))
    assert (chair["state"], chair["acc30"]) == ("stopped", None)
    shown = command(capsys, "show", runs[0].key)
    assert "shown in paper_tables/table9.json" in shown
    assert json.dumps(runs[0].config.to_dict(), indent=2) in shown
    compared = json.loads(command(capsys, "compare", runs[0].key, runs[1].key, "--json"))
    assert compared["settings"] == {runs[0].key: {"epochs": runs[0].config.train.epochs}, runs[1].key: {"epochs": 9}}
    assert [row["key"] for row in compared["scores"]] == [runs[0].key, runs[1].key]
    removed = command(capsys, "remove", runs[0].key)
    assert "its numbers stay in paper_tables/table9.json" in removed
    assert not runs[0].folder.exists()
    assert read_json(paths.tables() / "table9.json")["runs"]


@pytest.mark.parametrize(("arguments", "message"), [
    (["show"], "runs show: name a key"),
    (["compare", "0"], "runs compare: name two keys or more"),
    (["compare", "0", "0"], "runs compare: name two keys or more"),
    (["remove", "0123456789ab"], "no such key"),
])  # fmt: skip
def test_a_mistake_is_named(runs, capsys, arguments, message):
    assert cli.main(["runs", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_two_beginnings_of_a_key_are_one_run(runs, capsys):
    assert cli.main(["runs", "compare", runs[0].key[:11], runs[0].key]) == 2
    assert "name two keys or more" in capsys.readouterr().err
