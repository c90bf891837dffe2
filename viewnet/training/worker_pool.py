"""Several runs side by side: on worker processes of this machine, on any executor, or each by all of a torchrun."""

from __future__ import annotations

import contextlib
import csv
import multiprocessing
import os
import queue
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

import torch

from viewnet.errors import ViewnetError
from viewnet.runtime import distributed, provenance
from viewnet.runtime.files import write_text
from viewnet.runtime.parallel import follow_parent
from viewnet.runtime.progress import bar as progress_bar
from viewnet.training import run_store

T = TypeVar("T")

POLL = 1.0  # seconds between looks at the logs
TRIES = 3
"""So often a run is begun on an executor whose workers die."""


def run_all(
    jobs: Sequence[run_store.Job],
    steps: run_store.Steps,
    workers: int | None,
    progress: bool,
    executor: Executor | None = None,
) -> list[str]:
    """Make every job; the failures' messages, in the order of the jobs.

    Without an executor: with one worker, or one job, everything happens in this process, otherwise in a LocalPool.
    What dies there has mostly run out of memory and would do so again, so it is left to the next call. On an executor,
    whose workers come and go, a run whose worker died is begun up to `TRIES` times and goes on from its last state.
    """
    if executor is not None:
        return _collect(executor, jobs, steps, None, progress, TRIES)
    workers = min(workers or torch.cuda.device_count() or provenance.cores(), len(jobs))
    if workers <= 1:
        return [failure for job in jobs if (failure := attempt(job, steps, provenance.cores(), progress))]
    with LocalPool(workers) as pool:
        try:
            return _collect(pool, jobs, steps, pool.threads, progress, tries=1)
        except BaseException:
            pool.terminate_workers()
            raise


def make_together(jobs: Sequence[run_store.Job], steps: run_store.Steps, progress: bool) -> None:
    """Make one job after another, each trained by all processes of a torchrun; what fails ends all.

    The first process does everything else: it holds the run's lock, predicts and evaluates.
    """
    threads = max(1, provenance.cores() // distributed.local_size())

    def train(*arguments: Any, **options: Any) -> None:
        distributed.first(lambda: True)
        steps.train(*arguments, **options)

    for job in jobs:
        if distributed.rank() == 0:
            run_store.make(job, replace(steps, train=train), threads, progress)
            distributed.first(lambda: False)
        else:
            while distributed.first(lambda: False):  # as the first process says
                steps.train(job.config, steps.open(job.views), job.folder, threads=threads, progress=False)


def _collect(
    executor: Executor,
    jobs: Sequence[run_store.Job],
    steps: run_store.Steps,
    threads: int | None,
    progress: bool,
    tries: int,
) -> list[str]:
    """What went wrong in jobs on an executor; see `run_all`."""
    failures: dict[int, str] = {}
    begun, tried = time.time(), Counter(range(len(jobs)))
    left = {executor.submit(attempt, job, steps, threads): number for number, job in enumerate(jobs)}
    bar = progress_bar(progress, total=len(jobs), unit="run")
    try:
        while left:
            for future in wait(left, POLL, FIRST_COMPLETED).done:
                number = left.pop(future)
                failure = _outcome(future, jobs[number])
                if isinstance(failure, BrokenExecutor) and tried[number] < tries:
                    tried[number] += 1
                    with contextlib.suppress(RuntimeError):  # one that is broken for good takes no more
                        left[executor.submit(attempt, jobs[number], steps, threads)] = number
                        continue
                if failure:
                    failures[number] = str(failure)
                bar.update()
            shown = [_latest(jobs[number]) for future, number in left.items() if _going(future, jobs[number], begun)]
            bar.set_postfix_str("; ".join(shown), refresh=True)
    finally:
        for future in left:
            future.cancel()
        bar.close()
    return [failures[number] for number in sorted(failures)]


def _outcome(future: Future[str | None], job: run_store.Job) -> str | BrokenExecutor | None:
    """What went wrong in a job: a BrokenExecutor where its worker died."""
    try:
        return future.result()
    except BrokenExecutor as error:
        what = str(error) if isinstance(error, WorkerDied) else f"its worker died ({_first_line(error)})"
        return WorkerDied(f"{run_store.name(job.config)}: {what}: run again to go on where it was")
    except Exception as error:
        return f"{run_store.name(job.config)}: {type(error).__name__}: {_first_line(error)}"


def _going(future: Future[Any], job: run_store.Job, begun: float) -> bool:
    """Whether a job is being made; some executors do not tell."""
    try:
        return future.running() or (job.folder / "log.csv").stat().st_mtime >= begun
    except OSError:
        return False


class WorkerDied(BrokenExecutor):
    """A worker process ended in the middle of a job."""


class LocalPool(Executor):
    """Spawned processes of this machine, each with `threads` threads and, where there are GPUs, one of them in turn.

    `workers`: as many as there are GPUs, or cores without any. A process that dies fails its job with WorkerDied and is
    replaced. Functions, arguments and results must be picklable.
    """

    def __init__(self, workers: int | None = None):
        gpus = torch.cuda.device_count()
        workers = workers or gpus or provenance.cores()
        self.threads = max(1, provenance.cores() // workers)
        self._tasks: queue.SimpleQueue[_Task | None] = queue.SimpleQueue()
        self._crew = [_Worker(self._tasks, _gpu(i, gpus)) for i in range(workers)]
        self._closed = threading.Event()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """As Executor.submit. RuntimeError once the pool is shut down."""
        if self._closed.is_set():
            raise RuntimeError("the pool is shut down")
        future: Future[T] = Future()
        self._tasks.put((future, (fn, args, kwargs)))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As Executor.shutdown."""
        self._closed.set()
        if cancel_futures:
            with contextlib.suppress(queue.Empty):
                while True:
                    if task := self._tasks.get_nowait():
                        task[0].cancel()
        for _ in self._crew:
            self._tasks.put(None)
        if wait:
            for worker in self._crew:
                worker.join()

    def terminate_workers(self) -> None:
        """End all processes, whatever they are at."""
        self.shutdown(wait=False, cancel_futures=True)
        for worker in self._crew:
            worker.terminate()


_Task = tuple[Future[Any], tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]]


class _Worker(threading.Thread):
    """Has a spawned process do one task after another, and another process when that has died."""

    def __init__(self, tasks: queue.SimpleQueue[_Task | None], gpu: str | None):
        super().__init__(daemon=True)
        self.tasks, self.gpu = tasks, gpu
        self.process: SpawnProcess | None = None
        self.connection: Connection | None = None
        self.start()

    def run(self) -> None:
        while (task := self.tasks.get()) is not None:
            future, call = task
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(self._do(call))
            except BaseException as error:
                future.set_exception(error)
        if self.process is not None:
            assert self.connection is not None
            self.connection.close()  # an idle process takes the hint
            self.process.join()

    def _do(self, call: Any) -> Any:
        if self.process is None or not self.process.is_alive():
            context = multiprocessing.get_context("spawn")
            self.connection, theirs = context.Pipe()
            self.process = context.Process(target=_serve, args=(theirs, self.gpu), daemon=False)
            # Pages of 2 MiB for what is large, which volumes are: a step is faster by some per cent. Read at its start.
            os.environ.setdefault("GLIBC_TUNABLES", "glibc.malloc.hugetlb=1")
            self.process.start()
            theirs.close()  # so that the process's end is noticed
        assert self.connection is not None
        self.connection.send(call)
        try:
            result, error = self.connection.recv()
        except (EOFError, ConnectionError):
            self.process.join()
            raise WorkerDied(f"its process was ended ({_ending(self.process.exitcode)})") from None
        if error is not None:
            raise error
        return result

    def terminate(self) -> None:
        if self.process is not None:
            self.process.terminate()


def _serve(connection: Connection, gpu: str | None) -> None:
    """The life of a worker process."""
    follow_parent()
    if gpu is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = gpu  # heeded as long as CUDA has not been touched
    while True:
        try:
            function, arguments, options = connection.recv()
            answer: tuple[Any, Exception | None] = (function(*arguments, **options), None)
        except (EOFError, KeyboardInterrupt):
            return
        except Exception as error:
            answer = (None, error)
        try:
            connection.send(answer)
        except (KeyboardInterrupt, BrokenPipeError):
            return
        except Exception as error:  # what cannot be pickled
            connection.send((None, RuntimeError(f"{type(error).__name__}: {error}")))


_busy = threading.Lock()


def attempt(job: run_store.Job, steps: run_store.Steps, threads: int | None, progress: bool = False) -> str | None:
    """Make a job; what went wrong in one line, the whole story in error.log.

    A process makes one at a time, however many threads an executor gives it: seeds and thread counts are its own.
    """
    with _busy:
        return _attempt(job, steps, threads, progress)


def _attempt(job: run_store.Job, steps: run_store.Steps, threads: int | None, progress: bool) -> str | None:
    before = torch.get_num_threads()
    try:
        run_store.make(job, steps, threads, progress)
    except ViewnetError as error:
        return f"{run_store.name(job.config)}: {error}"
    except Exception as error:
        report, where = job.folder / "error.log", ""
        with contextlib.suppress(ViewnetError):  # it may be for want of a place to write to
            write_text(report, traceback.format_exc())
            where = f" (see {report})"
        return f"{run_store.name(job.config)}: {type(error).__name__}: {_first_line(error)}{where}"
    finally:
        torch.set_num_threads(before)
    return None


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [""])[0]


def _latest(job: run_store.Job) -> str:
    """The last line of a run's log in a few words."""
    config = job.config
    title = f"{config.variant} {config.category} {config.seed}"
    try:
        with (job.folder / "log.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error):  # or one that is damaged: this is only for display
        rows = []
    if not rows or "epoch" not in rows[-1]:
        return title
    last = rows[-1]
    words = f"{title} {str(last['epoch'])[:9].strip()}/{config.train.epochs}"
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
