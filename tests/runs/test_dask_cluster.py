from __future__ import annotations

import os
import signal
import sys
import threading
import time
from concurrent.futures import Executor, Future

import pytest
from helpers.fake_steps import STEPS, config, plan

from viewnet.errors import ViewnetError
from viewnet.runs import dask_cluster
from viewnet.runs.run_store import ensure
from viewnet.runtime import parallel

pytestmark = pytest.mark.usefixtures("folders")


def test_clusters_that_are_not_there_are_named(folders, monkeypatch):
    with dask_cluster.executor() as nobody:
        assert nobody is None
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setenv(parallel.CLUSTER, "tcp://nowhere:1")
    with pytest.raises(ViewnetError, match="tcp://nowhere:1: Dask is not installed"):
        ensure([config()], progress=False, steps=STEPS)


def test_schedulers_that_do_not_answer_are_named(folders):
    pytest.importorskip("distributed", reason="Dask is not installed")
    with (
        pytest.raises(ViewnetError, match="no such file: start the scheduler"),
        dask_cluster.executor("scheduler-file:x"),
    ):
        pass
    with pytest.raises(ViewnetError, match="no scheduler answers there"):  # noqa: SIM117
        with dask_cluster.executor("tcp://127.0.0.1:9", timeout=1):
            pass


class Lost(Executor):
    """Cancels all it is given, as Dask's does without its scheduler."""

    def submit(self, *_, **__) -> Future:
        future: Future = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future


def test_a_scheduler_that_is_gone_is_named(folders):
    with pytest.raises(ViewnetError, match="the cluster's scheduler is gone: the same command goes on"):
        ensure([config()], progress=False, steps=STEPS, executor=Lost())


@pytest.mark.slow
def test_a_scheduler_without_workers_is_said_to_wait_for_one(capfd):
    dask = pytest.importorskip("distributed", reason="Dask is not installed")
    with dask.LocalCluster(n_workers=0, dashboard_address=None) as alone:  # noqa: SIM117
        with dask_cluster.executor(alone.scheduler_address):
            assert "no worker is connected yet" in capfd.readouterr().err


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
