"""Runs and rendering on executors: this machine's pool, the standard library's, and a Dask cluster."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from helpers import fake_steps
from helpers.cad_files import write_box
from helpers.fake_steps import STEPS, calls, plan

from viewnet.config import SYNSETS, RunConfig
from viewnet.data.readers.shapenet import find_models
from viewnet.data.rendered_store import render_views
from viewnet.errors import ViewnetError
from viewnet.recipes import make_config
from viewnet.training import dask_cluster
from viewnet.training.run_store import ensure
from viewnet.training.worker_pool import TRIES, LocalPool, WorkerDied


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.delenv(dask_cluster.VARIABLE, raising=False)
    return tmp_path


def config(seed: int = 0) -> RunConfig:
    return make_config(profile="smoke", seed=seed)


class Mortal(Executor):
    """Does a job immediately, except for the first ones, whose worker dies."""

    def __init__(self, deaths: int):
        self.deaths, self.submitted = deaths, 0

    def submit(self, fn, /, *arguments, **options):
        self.submitted += 1
        future: Future = Future()
        if self.submitted <= self.deaths:
            future.set_exception(WorkerDied("its process was ended (signal 9)"))
        else:
            future.set_result(fn(*arguments, **options))
        return future


# Any executor


def test_runs_on_an_executor_are_those_made_here(folders, monkeypatch):
    here = ensure([config(0), config(1)], workers=1, progress=False, steps=STEPS)
    monkeypatch.setenv("VIEWNET_RUNS", str(folders / "others"))
    with ThreadPoolExecutor(2) as executor:
        there = ensure([config(0), config(1)], progress=False, steps=STEPS, executor=executor)
        assert executor.submit(int, "3").result() == 3, "it is the caller's to shut down"
    assert [run.folder.name for run in there] == [run.folder.name for run in here]
    for one, other in zip(here, there, strict=True):
        assert one.result["metrics"] == other.result["metrics"]
        assert np.array_equal(one.predictions.hypotheses, other.predictions.hypotheses)


def test_views_are_made_on_the_executor_too(monkeypatch):
    given = []

    def views(config, workers=None, progress=True, executor=None):
        given.append(executor)
        return fake_steps.views(config)

    with ThreadPoolExecutor(1) as executor:
        ensure([config()], progress=False, steps=replace(STEPS, views=views), executor=executor)
    assert given == [executor]


@pytest.mark.slow
def test_a_process_makes_one_run_at_a_time(folders):
    plan(folders, seed0="slow", seed1="slow")
    with ThreadPoolExecutor(2) as executor:
        made = ensure([config(0), config(1)], progress=False, steps=STEPS, executor=executor)
    first, second = sorted((run.result["training"] for run in made), key=lambda training: training["started"])
    assert first["finished"] <= second["started"]


def test_a_run_whose_worker_dies_is_begun_again_and_a_refused_one_is_not(folders):
    plan(folders, seed1="refuse")
    (run,) = ensure([config()], progress=False, steps=STEPS, executor=Mortal(TRIES - 1))
    assert list(run.log["epoch"]) == [1, 2, 3, 4]
    mortal = Mortal(0)
    with pytest.raises(ViewnetError, match=r"1 of 1 runs failed: .*seed 1.* the loss is not finite at step 20"):
        ensure([config(1)], progress=False, steps=STEPS, executor=mortal)
    assert mortal.submitted == 1
    mortal = Mortal(TRIES)
    with pytest.raises(ViewnetError, match=r"its process was ended \(signal 9\): run again to go on"):
        ensure([config(2)], progress=False, steps=STEPS, executor=mortal)
    assert mortal.submitted == TRIES
    assert calls(folders) == ["car-0", "car-1"]


@pytest.mark.slow
def test_a_process_pool_that_breaks_is_said_and_the_next_goes_on(folders):
    plan(folders, seed0="die")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        message = "car seed 0 .* its worker died .*: run again to go on where it was"
        with pytest.raises(ViewnetError, match=message):
            ensure([config()], progress=False, steps=STEPS, executor=executor)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        (run,) = ensure([config()], progress=False, steps=STEPS, executor=executor)
    assert list(run.log["epoch"]) == [1, 2, 3, 4]
    assert run.result["training"]["resumed"] is True


# This machine's pool


@pytest.mark.slow
def test_the_local_pool_is_an_executor(folders):
    with LocalPool(1) as pool:
        assert list(pool.map(pow, [2, 3], [5, 2])) == [32, 9]
        assert isinstance(pool.submit(int, "x").exception(), ValueError)
        assert "pickle" in str(pool.submit(threading.Lock).exception())
        process = pool.submit(os.getpid).result()
        assert process != os.getpid()
        dying = pool.submit(os.kill, process, signal.SIGKILL)
        with pytest.raises(WorkerDied, match="signal 9"):
            dying.result()
        assert pool.submit(os.getpid).result() not in (process, os.getpid())
        # A run submitted to it is started again and resumes from its last state.
        plan(folders, seed0="die")
        (run,) = ensure([config()], progress=False, steps=STEPS, executor=pool)
        assert run.result["training"]["resumed"] is True
        assert calls(folders) == ["car-0", "car-0"]
        waiting = [pool.submit(time.sleep, 0.2) for _ in range(3)]
        pool.shutdown(cancel_futures=True)
    assert waiting[-1].cancelled()
    with pytest.raises(RuntimeError, match="after shutdown"):
        pool.submit(int)


# Rendering


def test_rendering_on_an_executor_gives_the_same_bytes(folders):
    root = folders / "shapenet"
    for number in range(40):
        write_box(root, SYNSETS["car"], f"{number:03d}", scale=1 + number / 40)
    models = find_models(root, "car")
    here = render_views(models, folders / "here", views=2, image_size=16, workers=1, progress=False)
    with ThreadPoolExecutor(3) as executor:
        there = render_views(models, folders / "there", views=2, image_size=16, progress=False, executor=executor)
        for name in ("views.npy", "index.parquet", "meta.json", "rejected.csv"):
            assert (here.folder / name).read_bytes() == (there.folder / name).read_bytes()
    with pytest.raises(ViewnetError, match="a rendering process died"):
        render_views(models, folders / "dead", views=2, image_size=16, progress=False, executor=Mortal(1))


# A Dask cluster


def test_clusters_that_are_not_there_are_named(folders, monkeypatch):
    with pytest.raises(ViewnetError, match="no cluster: give tcp://HOST:PORT"), dask_cluster.executor():
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setenv(dask_cluster.VARIABLE, "tcp://nowhere:1")
    with pytest.raises(ViewnetError, match=r"cluster tcp://nowhere:1: Dask is not installed: pip install"):
        ensure([config()], progress=False, steps=STEPS)


def test_schedulers_that_do_not_answer_are_named(folders):
    pytest.importorskip("distributed", reason="Dask is not installed")
    with (
        pytest.raises(ViewnetError, match="no such file: start the scheduler"),
        dask_cluster.executor("scheduler-file:x"),
    ):
        pass
    with pytest.raises(ViewnetError, match="no scheduler answers there"):  # noqa: SIM117
        with dask_cluster.executor("tcp://127.0.0.1:9", patience=1):
            pass


@pytest.mark.slow
def test_a_dask_worker_that_is_killed_costs_no_saved_step(folders):
    dask = pytest.importorskip("distributed", reason="Dask is not installed")
    plan(folders, seed0="hang")
    killed: list[tuple[int, str]] = []

    def kill() -> None:
        """Kill the worker once it has saved two epochs."""
        while not (logs := list((folders / "runs").glob("viewnet/*/log.csv"))) or len(logs[0].read_text().split()) < 3:
            time.sleep(0.05)
        (call,) = (folders / "data" / "calls").iterdir()
        killed.append((int(call.read_text().split()[0]), logs[0].read_text()))
        os.kill(killed[0][0], signal.SIGKILL)

    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with dask.LocalCluster(**settings) as machines, dask_cluster.executor(machines.scheduler_address) as executor:
        machines.wait_for_workers(2)
        executioner = threading.Thread(target=kill)
        executioner.start()
        (run,) = ensure([config()], progress=False, steps=STEPS, executor=executor)
        executioner.join()
    ((worker, kept),) = killed
    assert list(run.log["epoch"]) == [1, 2, 3, 4]
    assert (run.folder / "log.csv").read_text().startswith(kept)
    assert run.result["training"]["resumed"] is True
    processes = {int(note.read_text().split()[0]) for note in (folders / "data" / "calls").iterdir()}
    assert len(processes) == 2
    assert processes > {worker}
    assert os.getpid() not in processes
