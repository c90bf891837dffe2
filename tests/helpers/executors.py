from __future__ import annotations

from concurrent.futures import Executor, Future

from viewnet.runs.worker_pool import WorkerDied


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
