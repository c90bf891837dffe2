from __future__ import annotations

import json
import multiprocessing
from dataclasses import replace

import pytest
from helpers import fake_steps
from helpers.fake_steps import STEPS, calls, config, plan
from helpers.imported_code import imports

from viewnet.config import RunConfig, VideoConfig
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines
from viewnet.runs import make_run, run_store
from viewnet.runs.run_store import ensure
from viewnet.runtime import provenance

pytestmark = pytest.mark.usefixtures("folders")


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


@pytest.mark.parametrize(("models", "workers", "shared"), [(1000, 2, True), (1000, 1, False), (30, 2, False)])
def test_one_pool_renders_all_categories_where_views_are_many(models, workers, shared):
    configs = [replace(c, data=replace(c.data, models=models, views=5)) for c in (config(), config(category="chair"))]
    runs = ensure(configs, 1, steps=STEPS)
    given = []

    def views(data, executor=None, **options):
        given.append(executor)
        return fake_steps.views(data, **options)

    assert ensure(configs, workers, steps=replace(STEPS, views=views)) == runs  # nothing to train: no process starts
    assert len(given) == 2 and given[0] is given[1]
    assert (given[0] is not None) is shared


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


@pytest.mark.parametrize("workers", [0, 10**6])
def test_bad_requests_are_said(workers):
    with pytest.raises(ViewnetError, match=f"workers {workers}: expected 1 to 1024"):
        ensure([config()], workers=workers, steps=STEPS)
    assert ensure([], steps=STEPS) == []


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
