"""Several runs side by side: worker processes, their progress and their failures."""

from __future__ import annotations

import csv
import multiprocessing
import os
import threading
import traceback
from collections import deque
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

import torch

from viewnet import provenance, runs
from viewnet.errors import ViewnetError
from viewnet.progress import bar as progress_bar

POLL = 1.0  # seconds between looks at the logs


def run_all(jobs: Sequence[runs.Job], steps: runs.Steps, workers: int | None, progress: bool) -> list[str]:
    """Make every job; the failures' messages, in the order of the jobs.

    With one worker, or one job, everything happens in this process. Otherwise in spawned ones, each with
    cores // workers threads and, where there are GPUs, one of them in turn.
    """
    gpus = torch.cuda.device_count()
    workers = min(workers or gpus or provenance.cores(), len(jobs))
    if workers <= 1:
        return [failure for job in jobs if (failure := _attempt(job, steps, provenance.cores(), progress))]
    failures: dict[int, str] = {}
    queue = deque(enumerate(jobs))
    crew = [_Worker(steps, max(1, provenance.cores() // workers), _gpu(i, gpus)) for i in range(workers)]
    bar = progress_bar(progress, total=len(jobs), unit="run")
    try:
        while queue or any(worker.busy for worker in crew):
            for worker in crew:
                if queue and not worker.busy:
                    worker.begin(*queue.popleft())
            for worker in _ready(crew):
                number, failure = worker.end()
                if failure:
                    failures[number] = failure
                bar.update()
            bar.set_postfix_str("; ".join(_latest(worker.job) for worker in crew if worker.job), refresh=True)
    finally:
        for worker in crew:
            worker.stop()
        bar.close()
    return [failures[number] for number in sorted(failures)]


class _Worker:
    """A spawned process that makes one job after another, and is replaced if it dies."""

    def __init__(self, steps: runs.Steps, threads: int, gpu: str | None):
        self.setup = (steps, threads, gpu)
        self.number, self.job = -1, None  # type: tuple[int, runs.Job | None]
        self.process: SpawnProcess | None = None
        self.connection: Connection | None = None

    @property
    def busy(self) -> bool:
        return self.job is not None

    def begin(self, number: int, job: runs.Job) -> None:
        if self.process is None or not self.process.is_alive():
            context = multiprocessing.get_context("spawn")
            self.connection, theirs = context.Pipe()
            self.process = context.Process(target=_serve, args=(theirs, *self.setup), daemon=False)
            # Pages of 2 MiB for what is large, which volumes are: a step is faster by some per cent. Read at its start.
            os.environ.setdefault("GLIBC_TUNABLES", "glibc.malloc.hugetlb=1")
            self.process.start()
            theirs.close()  # so that the process's end is noticed
        assert self.connection is not None
        self.number, self.job = number, job
        self.connection.send(job)

    def end(self) -> tuple[int, str | None]:
        """The finished job's number and what went wrong."""
        assert self.connection is not None and self.process is not None and self.job is not None
        try:
            failure = self.connection.recv()
        except (EOFError, ConnectionError):
            self.process.join()
            failure = f"{runs.name(self.job.config)}: its process was ended ({_ending(self.process.exitcode)})"
            failure += ": run again to go on where it was"
            self.process = None
        number, self.job = self.number, None
        return number, failure

    def stop(self) -> None:
        if self.process is not None:
            assert self.connection is not None
            if self.busy:
                self.process.terminate()
            self.connection.close()  # an idle worker takes the hint
            self.process.join()


def _ready(crew: Sequence[_Worker]) -> list[_Worker]:
    """Busy workers that have something to say, after at most `POLL` seconds."""
    waiting = {worker.connection: worker for worker in crew if worker.busy}
    return [waiting[connection] for connection in wait(list(waiting), timeout=POLL)]  # type: ignore[index,arg-type]


def _serve(connection: Connection, steps: runs.Steps, threads: int, gpu: str | None) -> None:
    """The life of a worker process."""
    threading.Thread(target=_follow_parent, daemon=True).start()
    if gpu is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = gpu  # heeded as long as CUDA has not been touched
    while True:
        try:
            job = connection.recv()
        except (EOFError, KeyboardInterrupt):
            return
        try:
            connection.send(_attempt(job, steps, threads, progress=False))
        except (KeyboardInterrupt, BrokenPipeError):
            return


def _follow_parent() -> None:
    """Ends this process when the one that asked for it is gone: a killed notebook leaves nothing running behind."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _attempt(job: runs.Job, steps: runs.Steps, threads: int, progress: bool) -> str | None:
    """Make a job; what went wrong in one line, the whole story in error.log."""
    before = torch.get_num_threads()
    try:
        runs.make(job, steps, threads, progress)
    except ViewnetError as error:
        return f"{runs.name(job.config)}: {error}"
    except Exception as error:
        job.folder.mkdir(parents=True, exist_ok=True)
        report = job.folder / "error.log"
        report.write_text(traceback.format_exc(), encoding="utf-8")
        first = (str(error).strip().splitlines() or [""])[0]
        return f"{runs.name(job.config)}: {type(error).__name__}: {first} (see {report})"
    finally:
        torch.set_num_threads(before)
    return None


def _latest(job: runs.Job) -> str:
    """The last line of a run's log in a few words."""
    config = job.config
    title = f"{config.variant} {config.category} {config.seed}"
    try:
        with (job.folder / "log.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
    except OSError:
        rows = []
    if not rows or "epoch" not in rows[-1]:
        return title
    last = rows[-1]
    words = f"{title} {last['epoch']}/{config.train.epochs}"
    for column, word in (("loss", "loss"), ("val_accuracy", "acc")):
        try:
            words += f" {word} {float(last[column]):.3g}"
        except (KeyError, TypeError, ValueError):
            continue
    return words


def _gpu(worker: int, gpus: int) -> str | None:
    if not gpus:
        return None
    visible = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")
    names = visible if len(visible) >= gpus and visible[0] else [str(i) for i in range(gpus)]
    return names[worker % gpus]


def _ending(code: Any) -> str:
    return f"signal {-code}" if isinstance(code, int) and code < 0 else f"exit code {code}"
