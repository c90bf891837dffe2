"""Two processes that need the same thing at the same moment."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import logging
import multiprocessing
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Barrier
from pathlib import Path

from helpers import interrupted_work


@dataclass(frozen=True)
class Answer:
    """What one of the two made itself, whether it waited for the other, and what it then read: name -> digest."""

    made: int
    waited: bool
    read: dict[str, str]


@dataclass(frozen=True)
class Pair:
    """The outcome: how often the work was done, by how many, and whether both read the same complete files."""

    made: int
    makers: int
    waited: bool
    same: bool
    problems: list[str]


def ask_for_run(root: Path) -> tuple[int, Path]:
    """A run of the profile smoke; the number of trainings this process started, and the run's folder."""
    from viewnet.recipes import make_config
    from viewnet.runs import make_run, run_store

    trained: list[Path] = []
    steps = make_run.default_steps()

    def train(config, views, folder, **options):
        trained.append(folder)
        steps.train(config, views, folder, **options)

    (run,) = run_store.ensure(
        [make_config(profile="smoke")], workers=1, progress=False, steps=dataclasses.replace(steps, train=train)
    )
    return len(trained), run.folder


def ask_for_views(root: Path) -> tuple[int, Path]:
    """A view store and its CAD models; the number of models this process rendered, and the store's folder."""
    from viewnet.data import rendered_store
    from viewnet.data.build import view_store
    from viewnet.recipes import make_config

    drawn: list[int] = []
    draw = rendered_store.render_chunk
    rendered_store.render_chunk = lambda chunk: drawn.append(len(chunk.models)) or draw(chunk)
    try:
        store = view_store(make_config(profile="smoke").data, workers=1, progress=False)
    finally:
        rendered_store.render_chunk = draw
    return sum(drawn), store.folder


QUESTIONS: dict[str, tuple[Callable[[Path], tuple[int, Path]], int]] = {
    "run": (ask_for_run, 1),
    "view store": (ask_for_views, 30),
}
"""What is needed, and the count of making it once: trainings, rendered models."""


@contextlib.contextmanager
def two_processes(data: Path) -> Iterator[Callable[[str, Path], Pair]]:
    """A function that starts both: the name of a question, the folder to work in. Runs use the views in `data`."""
    context = multiprocessing.get_context("spawn")
    barrier, pipes, crew = context.Barrier(2), [], []
    for _ in range(2):
        ours, theirs = context.Pipe()
        crew.append(context.Process(target=_serve, args=(theirs, barrier, data)))
        crew[-1].start()
        pipes.append(ours)

    def ask(question: str, root: Path) -> Pair:
        for pipe in pipes:
            pipe.send((question, root))
        answers = [pipe.recv() for pipe in pipes]
        if failed := [answer for answer in answers if isinstance(answer, str)]:
            return Pair(0, 0, False, False, failed)
        one, two = answers
        return Pair(
            one.made + two.made,
            (one.made > 0) + (two.made > 0),
            one.waited or two.waited,
            one.read == two.read,
            interrupted_work.leftovers(root),
        )

    try:
        yield ask
    finally:
        for pipe, process in zip(pipes, crew, strict=True):
            pipe.close()
            process.join(60)


class _Waiting(logging.Handler):
    """Records that another process is at work."""

    seen = False

    def emit(self, record: logging.LogRecord) -> None:
        self.seen |= "waiting for it" in record.getMessage()


def _serve(pipe: Connection, barrier: Barrier, data: Path) -> None:
    while True:
        try:
            question, root = pipe.recv()
        except EOFError:
            return
        for place, variable in interrupted_work.PLACES.items():
            os.environ[variable] = str(root / place)
        if question == "run":
            os.environ["VIEWNET_DATA"] = str(data)
        handler = _Waiting()
        logging.getLogger("viewnet").addHandler(handler)
        barrier.wait(600)
        try:
            made, folder = QUESTIONS[question][0](root)
            read = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in interrupted_work.files(folder)}
            pipe.send(Answer(made, handler.seen, read))
        except Exception as error:
            pipe.send(f"{type(error).__name__}: {error}")
        finally:
            logging.getLogger("viewnet").removeHandler(handler)
