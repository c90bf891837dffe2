"""The queue of trainings, kept in the folder of tables as they end."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pandas as pd
import pytest
from helpers import fake_steps
from helpers.fake_steps import STEPS, calls
from helpers.photo_data import fake_photographs, keep_apart, make_photos

from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.experiments.alignment_study import study_alignment
from viewnet.experiments.replication import QUEUE, Replication
from viewnet.model.checkpoint import ROBUST
from viewnet.recipes import VARIANTS
from viewnet.tables import kept_predictions
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import named

ROWS = [row for row in LAYOUTS["table1_shapenet"].rows if row.variant and not row.optional]
LABELS = [named(row.label, "matting" * (row.variant in VARIANTS)) for row in ROWS]
PARTS = (
    ("table1_shapenet", {"categories": "car", "seeds": "2"}),
    ("table2_ablation", {"categories": "car", "rows": "viewnet"}),
)


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Runs, views and tables of the test's own."""
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    return tmp_path


def queue(folders, *parts) -> Replication:
    return Replication.of(parts or PARTS, profile="smoke", output=str(folders / "tables"))


def cells(folders, path) -> pd.DataFrame:
    table = pd.read_csv(folders / "tables" / f"{path}.csv")
    return table[(table["metric"] == "acc30") & (table["seeds"] > 0)].set_index("row")


def test_every_part_of_the_queue_is_a_table_with_its_own_file():
    whole = Replication.of()
    assert len({(request.folder, request.name) for request in whole.requests}) == len(QUEUE)


def test_what_is_missing_is_trained_and_kept_and_nothing_twice(folders):
    queue(folders).train(workers=1, progress=False, steps=STEPS)
    count = len(ROWS)
    assert sorted(calls(folders)) == ["car-0"] * count + ["car-1"] * count
    of_table1 = cells(folders, "smoke-car/table1_shapenet")
    assert of_table1["seeds"].to_dict() == dict.fromkeys(LABELS, 2)
    of_table2 = cells(folders, "smoke-viewnet-car/table2_ablation")
    assert of_table2["seeds"].to_dict() == {"ViewNet (matting)": 1}
    assert of_table2["measured"].item() == kept_predictions.remade(
        folders / "tables/smoke-viewnet-car/table2_ablation.json"
    ).cells.query("metric == 'acc30'")["measured"].iloc[0].round(4)
    (curves,) = (folders / "tables/figures").rglob("*.png")  # of Table 2's logs
    assert curves.relative_to(folders / "tables/figures").as_posix() == "smoke-viewnet-car/training_curves.png"
    shutil.rmtree(folders / "runs")  # as on another machine
    again = queue(folders)
    assert again.missing == []
    assert [(part["runs"], part["kept"]) for part in again.plan()] == [(2 * count, 2 * count), (1, 1)]
    again.train(workers=1, progress=False, steps=STEPS)
    assert len(calls(folders)) == 2 * count


def test_each_run_is_kept_when_it_ends_even_if_a_later_one_fails(folders):
    fake_steps.plan(folders, seed1="refuse")
    with pytest.raises(ViewnetError, match=f"{len(ROWS)} of {2 * len(ROWS)} runs failed"):
        queue(folders).train(workers=1, progress=False, steps=STEPS)
    table = cells(folders, "smoke-car/table1_shapenet")
    assert table["seeds"].to_dict() == dict.fromkeys(LABELS, 1)
    logs = pd.read_csv(folders / "tables/smoke-car/table1_shapenet_logs.csv")
    assert set(map(tuple, logs[["row", "seed"]].drop_duplicates().to_numpy())) == {(row.label, 0) for row in ROWS}
    fake_steps.plan(folders)
    rest = queue(folders)
    assert [config.seed for config in rest.missing] == [1] * len(ROWS)
    rest.train(workers=1, progress=False, steps=STEPS)
    logs = pd.read_csv(folders / "tables/smoke-car/table1_shapenet_logs.csv")
    assert len(logs.drop_duplicates(["row", "seed"])) == 2 * len(ROWS)
    assert len(logs) == 2 * len(ROWS) * fake_steps.EPOCHS


def test_a_run_of_other_settings_is_not_the_one_that_is_asked_for(folders):
    one = ("table2_ablation", {"categories": "car", "rows": "viewnet"})
    queue(folders, one).train(workers=1, progress=False, steps=STEPS)
    path = folders / "tables/smoke-viewnet-car/table2_ablation.json"
    about = json.loads(path.read_text())
    for run in about["runs"].values():
        run["settings"] = "0" * 12
    path.write_text(json.dumps(about))
    assert [config.variant for config in queue(folders, one).missing] == ["viewnet"]


def test_weights_chosen_robustly_have_a_row_of_their_own(folders):
    def trained(config, views, folder, **how):
        fake_steps.train(config, views, folder, **how)
        (folder / ROBUST).write_bytes(b"other weights")

    one = ("table2_ablation", {"categories": "car", "rows": "viewnet"})
    queue(folders, one).train(workers=1, progress=False, steps=replace(STEPS, train=trained))
    rows = cells(folders, "smoke-viewnet-car/table2_ablation")
    assert set(rows.index) == {"ViewNet (matting)", "ViewNet, weights by robust accuracy (matting)"}
    queue(folders, one).train(workers=1, progress=False, steps=STEPS)
    assert cells(folders, "smoke-viewnet-car/table2_ablation").equals(rows)
    assert not len(kept_predictions.differences(folders / "tables/smoke-viewnet-car/table2_ablation.json"))


@pytest.fixture
def on_photographs(tmp_path, monkeypatch):
    """Folders of the test's own, made photographs, and trainings and predictions that take milliseconds."""
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)
    fake_photographs(tmp_path, monkeypatch)
    return keep_apart(tmp_path, monkeypatch)


ON_PHOTOGRAPHS = ("table3_pascal3d", {"categories": "car", "rows": "constant,viewnet", "seeds": "2"})


@pytest.mark.slow
def test_runs_scored_on_photographs_are_kept_and_nothing_twice(on_photographs):
    parts = (ON_PHOTOGRAPHS, ("table5_dva", ON_PHOTOGRAPHS[1]))
    queue(on_photographs, *parts).train(workers=1, progress=False, steps=STEPS)
    assert sorted(calls(on_photographs)) == ["car-0", "car-1"]
    paths = [on_photographs / f"tables/smoke-constant-viewnet-car/{name}" for name, _ in parts]
    first = [path.with_suffix(".parquet").read_bytes() for path in paths]
    rows = cells(on_photographs, "smoke-constant-viewnet-car/table3_pascal3d")["seeds"]
    assert rows.to_dict() == {
        "Constant": 1,
        "ViewNet (photos)": 2,
        "ViewNet (robust, photos)": 2,
        "ViewNet* (photos)": 2,
    }
    shutil.rmtree(on_photographs / "runs")  # as on another machine
    again = queue(on_photographs, *parts)
    assert [(part["runs"], part["kept"]) for part in again.plan()] == [(2, 2), (2, 2)]
    again.train(workers=1, progress=False, steps=STEPS)
    assert len(calls(on_photographs)) == 2
    assert [path.with_suffix(".parquet").read_bytes() for path in paths] == first


@pytest.mark.slow
def test_the_study_of_alignments_takes_what_table_3_has_kept(on_photographs):
    queue(on_photographs, ON_PHOTOGRAPHS).train(workers=1, progress=False, steps=STEPS)
    (on_photographs / "tables/smoke-constant-viewnet-car").rename(on_photographs / "tables/smoke-car")
    parameters = {"categories": "car", "profile": "smoke", "output": str(on_photographs / "tables")}
    request = experiment("alignment_study", **parameters)
    assert {entry.seed for entry in request.kept} == {0, 1}
    assert (
        {config.variant for config in request.to_run}
        == {"ssv", "viewnet_cycle"}
        == {c.variant for c in request.needs().runs}
    )
    assert request.note.endswith("up to 2 seeds")
    found = study_alignment(request, [])
    assert found.collapse.groupby("predictor")["seed"].nunique()["ViewNet"] == 2
    more = experiment("alignment_study", seeds=3, **parameters)
    assert [config.seed for config in more.to_run if config.variant == "viewnet"] == [2]
    shutil.rmtree(on_photographs / "photos/car")
    make_photos(on_photographs / "photos/car", seed=99)
    with pytest.raises(ViewnetError, match="photographs of another version"):
        study_alignment(request, [])


@pytest.mark.slow
def test_rows_on_other_photographs_are_not_mixed(on_photographs):
    queue(on_photographs, ON_PHOTOGRAPHS).train(workers=1, progress=False, steps=STEPS)
    shutil.rmtree(on_photographs / "photos/car")
    make_photos(on_photographs / "photos/car", seed=99)
    name, parameters = ON_PHOTOGRAPHS
    more = queue(on_photographs, (name, parameters | {"seeds": "3"}))
    with pytest.raises(ViewnetError, match="photographs of another version: remove the table's files"):
        more.train(workers=1, progress=False, steps=STEPS)
