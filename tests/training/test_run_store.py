from __future__ import annotations

import ast
import json
import multiprocessing
import os
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers import fake_steps
from helpers.fake_steps import STEPS, calls, plan

from viewnet.config import RunConfig, VideoConfig
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines
from viewnet.evaluation.evaluate import evaluate
from viewnet.evaluation.predictions import Predictions
from viewnet.recipes import make_config
from viewnet.runtime import provenance
from viewnet.runtime.parallel import cores
from viewnet.training import make_run, other_views, run_store, worker_pool
from viewnet.training.run_store import ensure


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    return tmp_path


def config(seed: int = 0, category: str = "car") -> RunConfig:
    return make_config(category=category, profile="smoke", seed=seed)


def test_a_run_is_made_once_and_then_reused(folders):
    (run,) = ensure([config()], steps=STEPS)
    assert calls(folders) == ["car-0"]
    assert run.folder.parent == folders / "runs" / "viewnet"
    assert RunConfig.from_dict(json.loads((run.folder / "config.json").read_text())) == config()
    assert {p.name for p in run.folder.iterdir()} == {
        "config.json", "log.csv", "checkpoint.safetensors", "predictions.parquet", "result.json",
    }  # fmt: skip
    written = (run.folder / "result.json").stat().st_mtime_ns
    assert ensure([config(), config()], steps=STEPS) == [run, run]
    assert calls(folders) == ["car-0"]
    assert (run.folder / "result.json").stat().st_mtime_ns == written


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
    assert set(training["git"]) == {"commit", "dirty"}
    assert training["seeds"]["run"] == 0
    assert list(run.log["epoch"]) == [1, 2, 3, 4]


def test_the_key_follows_config_views_and_code(monkeypatch):
    base = run_store.locate(config(), "views")
    assert base == run_store.locate(config(), "views")
    moved = replace(
        config(), data=replace(config().data, root="elsewhere", splits="lists", extra="more", backgrounds="there")
    )
    assert base == run_store.locate(moved, "views")  # the views' identity depends on the models, not on their place
    videos = VideoConfig("car", root="here")
    filmed = replace(config(), data=replace(config().data, video=videos))
    elsewhere = replace(filmed, data=replace(filmed.data, video=replace(videos, root="there"), models=7, views=3))
    assert base != run_store.locate(filmed, "views") == run_store.locate(elsewhere, "views")
    fewer = replace(filmed, data=replace(filmed.data, video=replace(videos, count=5)))
    assert run_store.locate(filmed, "views") != run_store.locate(fewer, "views")
    others = [run_store.locate(config(1), "views"), run_store.locate(config(), "other")]
    others += [run_store.locate(config(), "views", "one scenery"), run_store.locate(config(), "views", "another")]
    monkeypatch.setattr(provenance, "code_identity", lambda modules: "edited")
    others.append(run_store.locate(config(), "views"))
    assert len({base, *others}) == 6
    assert all((provenance.PACKAGE / module).is_file() for module in make_run.PREDICTING + make_run.EVALUATING)


def test_code_identity_ignores_comments_and_docstrings_only():
    one = '"""Doc."""\nX = 1  # why\n\n\ndef f(a):\n    """Doc.\n\n    More.\n    """\n    return "# no comment"\n'
    same = 'X = 1\ndef f(a):\n    # reason\n    return "# no comment"\n'
    assert provenance.statements(one) == provenance.statements(same)
    assert provenance.statements(one) != provenance.statements(same.replace("X = 1", "X = 2"))
    assert provenance.statements(one) != provenance.statements(same.replace("# no", "# a"))


def _ensure_in_child() -> None:
    ensure([config()], steps=STEPS, progress=False)


@pytest.mark.slow
def test_two_processes_that_ask_for_one_run_train_it_once(folders):
    plan(folders, seed0="slow")
    context = multiprocessing.get_context("spawn")
    both = [context.Process(target=_ensure_in_child) for _ in range(2)]
    for process in both:
        process.start()
    for process in both:
        process.join(300)
    assert [process.exitcode for process in both] == [0, 0]
    assert calls(folders) == ["car-0"]


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


def test_a_failure_names_its_run_and_leaves_the_others(folders):
    plan(folders, seed1="refuse", seed2="crash")
    with pytest.raises(ViewnetError) as caught:
        ensure([config(s) for s in range(4)], workers=1, progress=False, steps=STEPS)
    message = str(caught.value)
    assert "\n" not in message
    first = "2 of 4 runs failed: viewnet car seed 1 (smoke, matting): the loss is not finite at step 20"
    assert message.startswith(first)
    assert "viewnet car seed 2 (smoke, matting): ZeroDivisionError: division by zero (see " in message
    report = Path(message.split("(see ")[1].rstrip(")"))
    assert "Traceback" in report.read_text()
    plan(folders)
    before = len(calls(folders))
    assert len(ensure([config(s) for s in range(4)], workers=1, progress=False, steps=STEPS)) == 4
    assert len(calls(folders)) == before + 2


@pytest.mark.slow
def test_side_by_side_a_failure_or_a_death_costs_its_run_only(folders):
    plan(folders, seed0="refuse", seed1="die")
    wanted = [config(0), config(1), config(3, "chair"), config(2)]
    with pytest.raises(ViewnetError) as caught:
        ensure(wanted, workers=2, progress=False, steps=STEPS)
    assert not multiprocessing.active_children()
    message = str(caught.value)
    assert message.startswith("2 of 4 runs failed: viewnet car seed 0 (smoke, matting): the loss is not finite")
    assert "; viewnet car seed 1 (smoke, matting): its process was ended (signal 9): run again" in message
    assert calls(folders) == ["car-0", "car-1", "car-2", "chair-3"]
    notes = [p.read_text().split() for p in (folders / "data" / "calls").glob("*")]
    assert {threads for _, threads in notes} == {str(max(1, cores() // 2))}
    assert str(os.getpid()) not in {pid for pid, _ in notes}
    plan(folders)
    made = ensure(wanted, workers=1, progress=False, steps=STEPS)
    assert [run.config for run in made] == wanted
    assert [run.result["training"]["resumed"] for run in made] == [True, True, False, False]
    assert len(calls(folders)) == 6


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


def test_untrained_predictors_are_runs_too(folders):
    constant = run_store.untrained("constant", config(seed=3))
    (run,) = ensure([constant], steps=STEPS)
    assert not (folders / "data" / "calls").exists()
    assert run.folder.parent.name == "constant"
    assert run.alignment == "none"
    expected = baselines.constant(fake_steps.views(constant.data).index)
    assert (run.predictions.selected == expected.selected).all()
    assert run.result["metrics"]["none"]["acc30"] == 0
    assert run.result["training"] is None
    assert ensure([run_store.untrained("constant", config(seed=4))], steps=STEPS) == [
        run
    ]  # training settings do not matter
    with pytest.raises(ViewnetError, match="needs no training"):
        _ = run.log
    with pytest.raises(ViewnetError, match="unknown untrained variant 'mean'"):
        run_store.untrained("mean", config())


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
    with pytest.raises(ViewnetError, match=r"viewnet car seed 0 .* no annotated val and test split: score it on photo"):
        _ = run.predictions
    photographs = fake_steps.views(config(category="chair").data)
    assert len(other_views.on_photographs(run, photographs, STEPS).subset("test")) > 0
    with pytest.raises(ViewnetError, match=r"constant car .* no annotated val and test split"):
        ensure([run_store.untrained("constant", config())], workers=1, steps=steps)


def test_scoring_on_other_views_keeps_the_run_s_own_alignment(tmp_path):
    trained, constant = ensure([config(), run_store.untrained("constant", config())], workers=1, steps=STEPS)
    other = fake_steps.views(make_config(profile="smoke", data_root=str(tmp_path)).data)
    found = other_views.score_on(trained, other, steps=STEPS)
    assert found["images"] == len(other.index)
    own = trained.result["metrics"]["procrustes"]["alignment"]
    assert found["alignment"] == own
    assert other_views.score_on(constant, other, steps=STEPS)["images"] == len(other.index)
    with pytest.raises(ViewnetError, match="views it was trained on"):
        other_views.score_on(trained, fake_steps.views(config().data), steps=STEPS)
    seen = fake_steps.FakeStore(other.folder, other.index.assign(model_id=other.index["model_id"].str[5:]), "x")
    with pytest.raises(ViewnetError, match="model 00000 was seen in training"):
        other_views.score_on(trained, seen, steps=STEPS)


def test_bad_requests_are_said():
    with pytest.raises(ViewnetError, match="workers 0: expected 1 or more"):
        ensure([config()], workers=0, steps=STEPS)
    assert ensure([], steps=STEPS) == []


def test_progress_tells_the_last_line_of_a_log(folders):
    (run,) = ensure([config()], steps=STEPS)
    job = make_run.Job(run.config, run.folder, Path())
    assert worker_pool.progress_line(job) == "viewnet car 0 4/2 loss 0.25 acc 40"
    (run.folder / "log.csv").write_text("")
    assert worker_pool.progress_line(job) == "viewnet car 0"


def test_parquet_of_a_run_opens_with_pandas():
    (run,) = ensure([config()], steps=STEPS)
    frame = pd.read_parquet(run.folder / "predictions.parquet")
    assert set(frame["split"]) == {"val", "test"}
    assert isinstance(run.predictions, Predictions)


def imports(module: str) -> set[str]:
    """Modules of this package that a module of it imports, anywhere in its source, as paths below the package."""
    found = set()
    for node in ast.walk(ast.parse((provenance.PACKAGE / module).read_text())):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "viewnet":
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.startswith("viewnet.")]
        for name in names:
            path = "/".join(name.split(".")[1:]) + ".py"
            if (provenance.PACKAGE / path).is_file():
                found.add(path)
    return found


def test_the_key_covers_all_code_that_training_reaches():
    # The rest has no say in the weights: settings, views and backgrounds are in the key by themselves, the others read
    # and write.
    harmless = {"config.py", "errors.py", "paths.py", "runtime/files.py", "runtime/progress.py", "data/store.py"}
    harmless |= {"data/backgrounds.py", "evaluation/predictions.py"}
    reached, waiting = set(), {"training/train.py"}
    while waiting:
        module = waiting.pop()
        reached.add(module)
        waiting |= imports(module) - reached - harmless
    assert reached == set(run_store.TRAINING)
