"""Work shared out to processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from viewnet.errors import ViewnetError

Job = TypeVar("Job")
Result = TypeVar("Result")


@contextmanager
def pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """`workers` processes with one thread each for linear algebra; what has not begun when the block ends is dropped.

    A script must start its work under `if __name__ == "__main__":`, or processes die (BrokenProcessPool).
    """
    with _one_thread_each():
        # Spawned, not forked: forking a process with threads (torch, BLAS) can hang, and other systems have nothing
        # else.
        context = multiprocessing.get_context("spawn")
        executor = ProcessPoolExecutor(workers, mp_context=context, initializer=follow_parent)
        try:
            yield executor
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def follow_parent() -> None:
    """Has this process end with the one that started it: a killed notebook leaves nothing running behind."""
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def as_done(work: Callable[[Job], Result], jobs: Sequence[Job], workers: int, what: str) -> Iterator[Result]:
    """The results of `work` on every job, in the order in which they are done; with one worker, in this process.

    Raises ViewnetError, saying that it makes `what`, where a process dies.
    """
    workers = min(workers, len(jobs))
    if workers == 1:
        yield from map(work, jobs)
        return
    try:
        with pool(workers) as crew:
            for done in as_completed([crew.submit(work, job) for job in jobs]):
                yield done.result()
    except BrokenProcessPool:
        raise ViewnetError(
            f"a process that makes {what} died: call again with fewer workers if memory ran out; a script must start"
            " its work under `if __name__ == '__main__':`"
        ) from None


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Child processes started inside use one thread each for linear algebra; they are one a processor already."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
