from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers import fake_steps
from helpers.fake_steps import STEPS, calls, config, plan

from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import evaluate
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import ROBUST_PREDICTIONS
from viewnet.model.checkpoint import ROBUST
from viewnet.runs import other_views, run_store
from viewnet.runs.run_store import ensure
from viewnet.runtime import provenance

pytestmark = pytest.mark.usefixtures("folders")


def test_the_result_tells_where_it_comes_from():
    (run,) = ensure([config()], steps=STEPS)
    result = run.result
    assert result["metrics"]["procrustes"] == evaluate(run.predictions)
    assert result["metrics"]["linear"]["alignment"]["kind"] == "linear"
    assert result["views"] == "car-0"
    training = result["training"]
    assert training["seconds"] >= 400  # the log's clock, which a resumed training continues
    assert training["resumed"] is False
    assert training["hardware"]["cores"] >= 1
    assert {"python", "torch", "numpy"} <= set(training["versions"])
    assert set(training["git"]) >= {"commit", "dirty"}
    assert training["seeds"]["run"] == 0
    assert list(run.log["epoch"]) == [1, 2, 3, 4]


def _ensure_in_child() -> None:
    ensure([config()], steps=STEPS, progress=False)


def test_an_unknown_commit_is_told_once_for_all_runs(monkeypatch, caplog):
    provenance.warn_once.cache_clear()
    monkeypatch.setenv("PATH", "")  # without git
    runs = ensure([config(seed=0), config(seed=1)], workers=1, steps=STEPS)
    assert all(run.result["git"]["commit"] is None and run.result["git"]["unknown"] for run in runs)
    assert len([record for record in caplog.records if "commit" in record.getMessage()]) == 1


@pytest.mark.slow
def test_a_killed_run_goes_on_where_it_was(folders):
    plan(folders, seed0="hang")
    process = multiprocessing.get_context("spawn").Process(target=_ensure_in_child)
    process.start()
    deadline = time.monotonic() + 300
    while not (logs := list((folders / "runs").glob("viewnet/*/log.csv"))) or len(logs[0].read_text().splitlines()) < 3:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.join(300)
    before = logs[0].read_text()
    (run,) = ensure([config()], steps=STEPS, progress=False)
    assert (run.folder / "log.csv").read_text().startswith(before)
    assert list(run.log["epoch"]) == [1, 2, 3, 4]
    assert run.result["training"]["resumed"] is True
    assert calls(folders) == ["car-0", "car-0"]


def test_what_is_lost_is_made_again_from_what_is_left(folders):
    (run,) = ensure([config()], steps=STEPS)
    before = run.predictions
    (run.folder / "predictions.parquet").unlink()
    ensure([config()], steps=STEPS)
    assert run.predictions.ids.equals(before.ids)
    result = json.loads((run.folder / "result.json").read_text())
    training = result["training"]
    result["code"]["evaluating"] = "older"
    result["metrics"] = {}
    (run.folder / "result.json").write_text(json.dumps(result))
    ensure([config()], steps=STEPS)
    assert run.result["metrics"]["procrustes"]["images"] > 0
    assert run.result["training"] == training
    assert calls(folders) == ["car-0"]
    shutil.rmtree(run.folder)
    ensure([config()], steps=STEPS)
    assert calls(folders) == ["car-0", "car-0"]


@pytest.mark.parametrize("lost", ["val", "test", "viewpoints"])
def test_a_run_on_views_that_cannot_be_scored_is_trained_only(folders, lost):
    def opened(folder):
        store = fake_steps.open_store(folder)
        index = store.index[store.index["split"] != lost].copy()
        if lost == "viewpoints":
            index.loc[index.index[index["split"] == "val"][0], ["azimuth", "elevation"]] = np.nan
        return replace(store, index=index)

    steps = replace(STEPS, open=opened, predict=lambda *a, **k: pytest.fail("predicted"))
    (run,) = ensure([config()], workers=1, steps=steps)
    assert not run.scored and run.result["metrics"] is None and run.result["training"]["seconds"] > 0
    assert {p.name for p in run.folder.iterdir()} >= {"log.csv", "checkpoint.safetensors"}
    assert not (run.folder / "predictions.parquet").exists()
    assert ensure([config()], workers=1, steps=steps) == [run]
    assert calls(folders) == ["car-0"]
    with pytest.raises(ViewnetError, match=r"viewnet car seed 0 .* no annotated val"):
        _ = run.predictions
    photographs = fake_steps.views(config(category="chair").data)
    assert len(other_views.on_photographs(run, photographs, STEPS).subset("test")) > 0
    with pytest.raises(ViewnetError, match=r"constant car .* no annotated val"):
        ensure([run_store.untrained("constant", config())], workers=1, steps=steps)


def test_a_second_choice_of_weights_has_predictions_of_its_own(folders):
    def trained(config, views, folder, **how):
        fake_steps.train(config, views, folder, **how)
        (folder / ROBUST).write_bytes(b"other weights")

    (run,) = ensure([config()], workers=1, steps=replace(STEPS, train=trained))
    robust = Predictions.from_parquet(run.folder / ROBUST_PREDICTIONS)
    assert robust.ids.equals(run.predictions.ids)
    assert not np.array_equal(robust.hypotheses, run.predictions.hypotheses)
    (without,) = ensure([config(1)], workers=1, steps=STEPS)
    with pytest.raises(ViewnetError, match=r"predictions_robust\.parquet: no such file"):
        Predictions.from_parquet(without.folder / ROBUST_PREDICTIONS)


def test_parquet_of_a_run_opens_with_pandas():
    (run,) = ensure([config()], steps=STEPS)
    frame = pd.read_parquet(run.folder / "predictions.parquet")
    assert set(frame["split"]) == {"val", "test"}
    assert isinstance(run.predictions, Predictions)


@pytest.mark.slow
def test_a_process_makes_one_run_at_a_time(folders):
    plan(folders, seed0="slow", seed1="slow")
    with ThreadPoolExecutor(2) as executor:
        made = ensure([config(0), config(1)], progress=False, steps=STEPS, executor=executor)
    first, second = sorted((run.result["training"] for run in made), key=lambda training: training["started"])
    assert first["finished"] <= second["started"]
