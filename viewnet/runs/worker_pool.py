"""Several runs side by side: on worker processes of this machine, on any executor, or each by all of a torchrun."""

import contextlib
import itertools
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent import futures
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import replace
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

import torch

from viewnet.errors import ViewnetError
from viewnet.evaluation.run import read_log
from viewnet.runs.make_run import Job, Steps, attempt, make, one_line
from viewnet.runtime import distributed, parallel
from viewnet.runtime.progress import bar as progress_bar

T = TypeVar("T")
POLL = 1.0  # seconds between looks at the logs
TRIES = 3  # how often a run is begun on an executor whose workers die


class WorkerDied(BrokenExecutor):
    """A worker process ended in the middle of a job."""


def run_all(
    jobs: Sequence[Job],
    steps: Steps,
    workers: int | None,
    progress: bool,
    executor: Executor | None = None,
    finished: Callable[[Job], None] | None = None,
) -> list[str]:
    """Make every job; the messages of those that failed, in the order of the jobs. `finished` is called as each ends.

    Without an executor: with one worker, or one job, in this process, otherwise in a LocalPool. What dies there has
    mostly run out of memory and would do so again, so it is left to the next call. On an executor, whose workers come
    and go, a run whose worker died is begun up to `TRIES` times and resumes from its last state.
    """
    if executor is not None:
        return _collect(executor, jobs, steps, None, progress, TRIES, finished)
    workers = min(workers or torch.cuda.device_count() or parallel.room(), len(jobs))
    if workers <= 1:
        failures = []
        for job in jobs:
            told = f"{job.name}: {_counted(parallel.threads())} on {_counted(parallel.cores(), 'core')}"
            progress_bar(progress, total=0, bar_format="{desc}", desc=told).close()
            failures.append(attempt(job, steps, parallel.threads(), progress))
            if finished and not failures[-1]:
                finished(job)
        return [failure for failure in failures if failure]
    with LocalPool(workers) as pool:
        try:
            return _collect(pool, jobs, steps, pool.threads, progress, 1, finished)
        except BaseException:
            pool.terminate_workers()
            raise


def make_together(jobs: Sequence[Job], steps: Steps, progress: bool) -> None:
    """Make one job after another, each trained by all processes of a torchrun; the first failure ends all."""
    threads = parallel.threads(int(os.environ.get("LOCAL_WORLD_SIZE", distributed.size())))  # those of this machine

    def train(*arguments: Any, **options: Any) -> None:
        distributed.first(lambda: True)
        steps.train(*arguments, **options)

    for job in jobs:
        if distributed.rank() == 0:  # holds the run's lock, predicts and evaluates
            make(job, replace(steps, train=train), threads, progress)
            distributed.first(lambda: False)
        else:
            while distributed.first(lambda: False):  # the value is the first process's
                steps.train(job.config, steps.open(job.views), job.folder, threads=threads, progress=False)


def _collect(
    executor: Executor,
    jobs: Sequence[Job],
    steps: Steps,
    threads: int | None,
    progress: bool,
    tries: int,
    finished: Callable[[Job], None] | None,
) -> list[str]:
    """The messages of jobs that failed on an executor; see `run_all`."""
    failures: dict[int, str] = {}
    started, attempts = time.time(), Counter(range(len(jobs)))
    pending = {executor.submit(attempt, job, steps, threads): number for number, job in enumerate(jobs)}
    told = None if threads is None else f"{_counted(threads)} a run"
    bar = progress_bar(progress, total=len(jobs), desc=told, unit="run")
    try:
        while pending:
            for future in futures.wait(pending, POLL, futures.FIRST_COMPLETED).done:
                number = pending.pop(future)
                failure = _failure(future, jobs[number])
                # What failed by itself would fail again; a run whose worker died resumes from its last state.
                if isinstance(failure, BrokenExecutor) and attempts[number] < tries:
                    attempts[number] += 1
                    with contextlib.suppress(RuntimeError):  # an executor that is broken for good takes no more
                        pending[executor.submit(attempt, jobs[number], steps, threads)] = number
                        continue
                if failure:
                    failures[number] = str(failure)
                elif finished:
                    finished(jobs[number])
                bar.update()
            running = [jobs[number] for future, number in pending.items() if _is_running(future, jobs[number], started)]
            bar.set_postfix_str("; ".join(map(progress_line, running)), refresh=True)
    finally:
        for future in pending:
            future.cancel()
        bar.close()
    return [failures[number] for number in sorted(failures)]


def _counted(number: int, what: str = "thread") -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _failure(future: Future[str | None], job: Job) -> str | BrokenExecutor | None:
    """What went wrong in a job: a BrokenExecutor where its worker died."""
    try:
        return future.result()
    except BrokenExecutor as error:
        reason = str(error) if isinstance(error, WorkerDied) else f"its worker died ({one_line(error)})"
        return WorkerDied(f"{job.name}: {reason}: run again to resume it")
    except futures.CancelledError:  # what is collected was not cancelled here
        return f"{job.name}: the cluster's scheduler is gone: the same command goes on with what its workers have done"
    except Exception as error:
        return f"{job.name}: {one_line(error)}"


def _is_running(future: Future[Any], job: Job, started: float) -> bool:
    """Whether a job is being made; for executors that do not know, whether its log has grown."""
    try:
        return future.running() or (job.folder / "log.csv").stat().st_mtime >= started
    except OSError:
        return False


def progress_line(job: Job) -> str:
    """A job and the last row of its log in some words: epoch, loss, Acc@30 on validation views."""
    config = job.config
    line = f"{config.variant} {config.category} {config.seed}"
    # A damaged log is reported where it is read for results.
    with contextlib.suppress(ViewnetError, LookupError):
        last = read_log(job.folder / "log.csv").iloc[-1].dropna()
        line += f" {last['epoch']:.9g}/{config.train.epochs}"
        for column, label in (("loss", "loss"), ("val_accuracy", "acc")):
            line += f" {label} {last[column]:.3g}" if column in last else ""
    return line


class LocalPool(futures.ThreadPoolExecutor):
    """Spawned processes of this machine, each with `threads` threads and, where there are GPUs, one of them in turn.

    A process that dies fails its job with WorkerDied and is replaced.
    """

    def __init__(self, workers: int):
        gpus = torch.cuda.device_count()
        super().__init__(workers, initializer=self._begin)  # a thread for each process, which waits for it
        self.threads = parallel.threads(workers)
        # As CUDA_VISIBLE_DEVICES names them.
        visible = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")
        names = visible if len(visible) >= gpus and visible[0] else [str(number) for number in range(gpus)]
        self._gpus = itertools.cycle(names[:gpus] or [None])
        self._workers: list[_Worker] = []
        self._mine = threading.local()

    def _begin(self) -> None:
        self._mine.worker = _Worker(next(self._gpus))
        self._workers.append(self._mine.worker)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """As Executor.submit. RuntimeError once the pool is shut down."""
        return super().submit(lambda: self._mine.worker.call(fn, *args, **kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As Executor.shutdown."""
        super().shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            for worker in self._workers:
                worker.executor.shutdown()

    def terminate_workers(self) -> None:
        """End all processes, whatever they are doing."""
        self.shutdown(wait=False, cancel_futures=True)
        for worker in self._workers:
            if worker.process:
                worker.process.terminate()


class _Worker(parallel.Spawning):
    """A process for one task at a time, started when needed and again when it has died.

    It is its executor's context, so as to remember the process: executors do not tell how theirs ended.
    """

    process: SpawnProcess | None = None

    def __init__(self, gpu: str | None):
        self._gpu = gpu
        self._renew()

    def _renew(self) -> None:
        self.executor = futures.ProcessPoolExecutor(1, self, _initialise, (self._gpu,))

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        self.process = super().Process(*args, **kwargs)
        return self.process

    def call(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> T:
        """The result of a function in the process. WorkerDied where the process ends before it returns."""
        try:
            return self.executor.submit(fn, *args, **kwargs).result()
        except BrokenExecutor:
            self.executor.shutdown()  # waits until the process has ended
            self._renew()
            code = self.process.exitcode if self.process else None
            ending = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
            raise WorkerDied(f"its process was ended ({ending})") from None


def _initialise(gpu: str | None) -> None:
    """Prepare a worker process."""
    parallel.follow_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, which then ends its workers
    if gpu is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = gpu  # takes effect as long as CUDA has not been initialised
