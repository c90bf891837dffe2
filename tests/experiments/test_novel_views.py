"""Novel views: what each run scored is kept, and its network is needed no more."""

from __future__ import annotations

import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest
from helpers.boxes import box_store
from helpers.untrained_models import finished_run

from viewnet.evaluation.run import Run
from viewnet.experiments import experiment


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """Runs of untrained networks in the place of trained ones, listed as they are made."""
    store, made = box_store(tmp_path / "views", {"val": 8, "test": 4}), []
    monkeypatch.setattr("viewnet.data.build.view_store", lambda *a, **k: store)

    def folder(config):
        return tmp_path / "runs" / f"{config.variant}-{config.seed}"

    def ensure(configs, workers, progress, finished=lambda run: None):
        runs = [Run(config, folder(config)) for config in configs]
        for run in runs:
            if not run.folder.exists():
                finished_run(run.folder, store, run.config.variant, seed=run.config.seed)
                made.append(run.key)
            finished(run)
        return runs

    def needs(configs):
        return SimpleNamespace(runs={config: {"kept": folder(config).exists()} for config in configs})

    monkeypatch.setattr("viewnet.experiments.novel_views.ensure", ensure)
    monkeypatch.setattr("viewnet.experiments.novel_views.needs", needs)
    return made


def test_runs_are_scored_once_and_drawn_where_all_are_at_hand(trained, tmp_path):
    def request(seeds):
        asked = experiment("novel_views", profile="smoke", categories="car", seeds=seeds, output=str(tmp_path / "t"))
        return replace(asked, variants=("viewnet", "no_shape_prior"))

    assert [run.key for run in request(1).run(progress=False)] == ["viewnet-0", "no_shape_prior-0"]
    assert trained == ["viewnet-0", "no_shape_prior-0"]
    kept = request(1).kept
    assert list(kept["variant"].unique()) == ["", "viewnet", "no_shape_prior"]
    shutil.rmtree(tmp_path / "runs")
    assert (request(1).missing, request(1).needs().runs, request(1).run(progress=False)) == ([], {}, [])
    assert set(request(2).needs().runs) == set(request(2).to_run)
    request(2).run(progress=False)
    assert trained[2:] == ["viewnet-0", "viewnet-1", "no_shape_prior-1"]
    again = request(1).kept
    assert again[again["seed"] == 0].reset_index(drop=True).equals(kept)
    assert again.groupby("variant")["seed"].nunique().to_dict() == {"": 1, "viewnet": 2, "no_shape_prior": 2}
    assert request(1).note.endswith("mean of up to 2 seeds")
