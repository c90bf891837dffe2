"""Work shared out to processes of this machine."""

import multiprocessing
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager, nullcontext
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from viewnet.errors import ViewnetError

Job = TypeVar("Job")
Result = TypeVar("Result")

QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""A container's share of the CPU: microseconds allowed in a period, and the period; "max" for no limit."""

THREADS = "OMP_NUM_THREADS"
"""The environment variable that says how many threads a run computes on; PyTorch, Numba's and NumPy's loops obey it."""
MOST_THREADS = 1024
CLUSTER = "VIEWNET_CLUSTER"
"""The environment variable that names the Dask scheduler whose workers render and train, instead of this machine's."""


def cores() -> int:
    """CPU cores this process may use: its affinity and, in a container, its quota; 1 or more."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if QUOTA.exists():
        allowed, _, period = QUOTA.read_text().partition(" ")
        if allowed.isdigit():
            count = min(count, max(1, int(allowed) // int(period)))
    return count


def threads_asked() -> int | None:
    """The threads that OMP_NUM_THREADS asks for, of a list the first; None where it is not set.

    ViewnetError for anything but 1 to MOST_THREADS, of which the OpenMP libraries would take their default.
    """
    text = os.environ.get(THREADS, "")
    if not text.strip():
        return None
    first = text.partition(",")[0].strip()  # what follows is for nested loops
    if not re.fullmatch("[0-9]{1,9}", first) or not 1 <= int(first) <= MOST_THREADS:
        raise ViewnetError(f"{THREADS}={text}: expected a whole number from 1 to {MOST_THREADS}, or nothing")
    return int(first)


def threads(side_by_side: int = 1) -> int:
    """Threads of each of some runs side by side: OMP_NUM_THREADS, or else its share of the cores; 1 or more."""
    return threads_asked() or max(1, cores() // side_by_side)


def room() -> int:
    """How many runs with OMP_NUM_THREADS threads each, or else one, there are cores for; 1 or more."""
    return max(1, cores() // (threads_asked() or 1))


@contextmanager
def pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """`workers` processes with one thread each for linear algebra; what has not begun at the block's end is dropped."""
    with environment(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1"):
        executor = ProcessPoolExecutor(workers, mp_context=Spawning(), initializer=follow_parent)
        try:
            yield executor
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


_starting = threading.Lock()


class Spawned(SpawnProcess):
    """A process that runs the script it was started by only if that has a guard, `if __name__ == "__main__":`.

    Without one the script would start all of its work anew.
    """

    @staticmethod
    def _Popen(process: Any) -> Any:
        with _starting:
            script = sys.modules["__main__"]
            try:
                if not _guarded(script):
                    sys.modules["__main__"] = ModuleType("__main__")  # without a file to run
                return SpawnProcess._Popen(process)
            finally:
                sys.modules["__main__"] = script


class Spawning(SpawnContext):
    """Processes are spawned, not forked: forking a process with threads (torch, BLAS) can hang."""

    def Process(self, *arguments: Any, **options: Any) -> SpawnProcess:  # type: ignore[override]
        """As SpawnContext."""
        return Spawned(*arguments, **options)


def _guarded(script: ModuleType) -> bool:
    try:
        return "__main__" in Path(script.__file__ or "").read_text(encoding="utf-8", errors="replace")
    except (AttributeError, OSError):  # no file, no second run
        return True


def follow_parent() -> None:
    """Make this process end with the one that started it: a killed notebook leaves nothing running."""

    def follow() -> None:
        if parent := multiprocessing.parent_process():
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def as_done(
    work: Callable[[Job], Result], jobs: Sequence[Job], workers: int, what: str, executor: Executor | None = None
) -> Iterator[Result]:
    """The results of `work` on every job, in order of completion; ViewnetError, naming `what`, if a process dies.

    On an executor, if there is one; otherwise in `workers` processes, or in this one where one is enough.
    """
    workers = min(workers, len(jobs))
    if executor is None and workers <= 1:
        yield from map(work, jobs)
        return
    try:
        with pool(workers) if executor is None else nullcontext(executor) as crew:
            working = [crew.submit(work, job) for job in jobs]
            try:
                for future in as_completed(working):
                    yield future.result()
            finally:
                for waiting in working:
                    waiting.cancel()
    except BrokenExecutor:
        advice = "call again, with fewer workers if memory ran out"
        raise ViewnetError(f"a process that makes {what} died: {advice}") from None


@contextmanager
def environment(**values: str) -> Iterator[None]:
    """Set environment variables for a block; processes started in it inherit them."""
    before = {name: os.environ[name] for name in values if name in os.environ}
    os.environ.update(values)
    try:
        yield
    finally:
        for name in values:
            os.environ.pop(name, None)
        os.environ.update(before)
