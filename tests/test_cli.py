from __future__ import annotations

import os
from dataclasses import replace

import pytest
from fake_steps import STEPS

from viewnet import cli, notebook, runs


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.delenv("VIEWNET_CLUSTER", raising=False)
    monkeypatch.setattr(runs, "default_steps", lambda: STEPS)
    return tmp_path


def test_train_prints_runs_and_scores(folders, capsys):
    arguments = ["train", "car", "chair", "--profile", "smoke", "--seed", "3", "--workers", "1"]
    arguments += ["-s", "epochs=5", "-s", "amp=off", "-s", "betas=[0.8, 0.9]"]
    assert cli.main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines[::2]] == [
        "viewnet car seed 3 (smoke, matting)",
        "viewnet chair seed 3 (smoke, matting)",
    ]
    (config,) = folders.glob(f"runs/viewnet/{lines[0].rpartition('/')[2]}/config.json")
    made = runs.RunConfig.from_dict(runs.read_json(config))
    assert (made.train.epochs, made.train.amp, made.train.betas) == (5, "off", (0.8, 0.9))
    assert lines[1].startswith("  test: within 30 degrees ")


def test_train_says_what_is_trained_and_not_scored(capsys, monkeypatch):
    def opened(folder):
        store = STEPS.open(folder)
        return replace(store, index=store.index[store.index["split"] == "train"])

    monkeypatch.setattr(runs, "default_steps", lambda: replace(STEPS, open=opened))
    assert cli.main(["train", "car", "--profile", "smoke", "--workers", "1"]) == 0
    assert "  not scored: its own views have no annotated val and test split" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "cart"], "unknown category 'cart'"),
        (["train", "car", "-s", "epochs"], "-s epochs: expected NAME=VALUE"),
        (["train", "car", "-s", "epoch=3"], "unknown setting 'epoch'"),
        (["train", "car", "-s", "epochs=many"], "config.train.epochs: expected int, got 'many'"),
        (["train", "car", "--data-root", "nowhere"], "data_root nowhere: no such folder"),
        (["train", "car", "--cluster", "scheduler-file:nowhere"], "cluster scheduler-file:nowhere: "),
    ],
)
def test_what_cannot_be_trained_is_said(arguments, message, capsys, monkeypatch):
    monkeypatch.setenv("VIEWNET_CLUSTER", "")  # what the command sets goes with the test
    assert cli.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"viewnet: {message}")
    assert said.count("\n") == 1


def test_a_notebook_s_kernel_is_told_the_cluster(monkeypatch, capsys):
    monkeypatch.setenv("VIEWNET_CLUSTER", "")
    monkeypatch.setattr(notebook, "run", lambda *_: os.environ["VIEWNET_CLUSTER"])
    assert cli.main(["notebook", "table2_ablation", "--cluster", "tcp://host:8786"]) == 0
    assert capsys.readouterr().out == "tcp://host:8786\n"
