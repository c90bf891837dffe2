from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import fake_steps
from helpers.executors import Mortal
from helpers.fake_steps import STEPS, calls, config, plan

from viewnet.errors import ViewnetError
from viewnet.runs import make_run, worker_pool
from viewnet.runs.run_store import ensure
from viewnet.runs.worker_pool import TRIES, LocalPool, WorkerDied
from viewnet.runtime import parallel
from viewnet.runtime.parallel import threads

pytestmark = pytest.mark.usefixtures("folders")


def test_a_failure_names_its_run_and_leaves_the_others(folders):
    plan(folders, seed1="refuse", seed2="crash")
    with pytest.raises(ViewnetError) as caught:
        ensure([config(s) for s in range(4)], workers=1, progress=False, steps=STEPS)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("2 of 4 runs") and "; viewnet car seed 2 " in message
    assert "car seed 1 (smoke, matting): the loss" in message and "ZeroDivisionError: division by zero" in message
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
    assert message.startswith("2 of 4 runs failed: viewnet car seed 0 ") and "the loss is not finite" in message
    assert "; viewnet car seed 1 " in message and "was ended (signal 9)" in message
    assert calls(folders) == ["car-0", "car-1", "car-2", "chair-3"]
    notes = [p.read_text().split() for p in (folders / "data" / "calls").glob("*")]
    assert {number for _, number in notes} == {str(threads(2))}
    assert str(os.getpid()) not in {pid for pid, _ in notes}
    plan(folders)
    made = ensure(wanted, workers=1, progress=False, steps=STEPS)
    assert [run.config for run in made] == wanted
    assert [run.result["training"]["resumed"] for run in made] == [True, True, False, False]
    assert len(calls(folders)) == 6


def test_threads_are_a_run_s_and_no_part_of_its_key(folders, monkeypatch):
    monkeypatch.setattr(parallel, "cores", lambda: 8)
    told, found, bar = [], [], worker_pool.progress_bar
    monkeypatch.setattr(worker_pool, "progress_bar", lambda *a, **settings: (told.append(settings), bar(False))[1])
    for number in (1, 2):
        monkeypatch.setenv("OMP_NUM_THREADS", str(number))
        monkeypatch.setenv("VIEWNET_RUNS", str(folders / f"runs-{number}"))
        found += ensure([config()], steps=STEPS)
    name = "viewnet car seed 0 (smoke, matting)"
    assert [each["desc"] for each in told] == [f"{name}: 1 thread on 8 cores", f"{name}: 2 threads on 8 cores"]
    assert [run.result["training"]["hardware"]["threads"] for run in found] == [1, 2]
    assert found[0].folder.name == found[1].folder.name
    assert sorted(note.read_text().split()[1] for note in (folders / "data" / "calls").glob("*")) == ["1", "2"]


def test_side_by_side_there_are_as_many_runs_as_their_threads_leave_cores_for(monkeypatch):
    monkeypatch.setattr(parallel, "cores", lambda: 8)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    for asked, workers, expected in (("", None, (8, 1)), ("2", None, (4, 2)), ("", 3, (3, 2)), ("4", 3, (3, 4))):
        monkeypatch.setenv("OMP_NUM_THREADS", asked)
        with LocalPool(workers or parallel.room()) as pool:
            assert (pool._max_workers, pool.threads) == expected


def test_progress_tells_the_last_line_of_a_log(folders):
    (run,) = ensure([config()], steps=STEPS)
    job = make_run.Job(run.config, run.folder, Path())
    assert worker_pool.progress_line(job) == "viewnet car 0 4/2 loss 0.25 acc 40"
    (run.folder / "log.csv").write_text("")
    assert worker_pool.progress_line(job) == "viewnet car 0"


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


def test_a_run_whose_worker_dies_is_begun_again_and_a_refused_one_is_not(folders):
    plan(folders, seed1="refuse")
    (run,) = ensure([config()], progress=False, steps=STEPS, executor=Mortal(TRIES - 1))
    assert list(run.log["epoch"]) == [1, 2, 3, 4]
    mortal = Mortal(0)
    with pytest.raises(ViewnetError, match=r"1 of 1 runs.*seed 1.*finite at step 20"):
        ensure([config(1)], progress=False, steps=STEPS, executor=mortal)
    assert mortal.submitted == 1
    mortal = Mortal(TRIES)
    with pytest.raises(ViewnetError, match=r"was ended \(signal 9\)"):
        ensure([config(2)], progress=False, steps=STEPS, executor=mortal)
    assert mortal.submitted == TRIES
    assert calls(folders) == ["car-0", "car-1"]


@pytest.mark.slow
def test_a_process_pool_that_breaks_is_said_and_the_next_goes_on(folders):
    plan(folders, seed0="die")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        message = "car seed 0 .* its worker died .*: run again to resume it"
        with pytest.raises(ViewnetError, match=message):
            ensure([config()], progress=False, steps=STEPS, executor=executor)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        (run,) = ensure([config()], progress=False, steps=STEPS, executor=executor)
    assert list(run.log["epoch"]) == [1, 2, 3, 4]
    assert run.result["training"]["resumed"] is True


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
