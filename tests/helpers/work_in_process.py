"""Work done in this process, one step after another: views are rendered, a run is trained, a table is made."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from helpers.interrupted_work import PLACES, damage, differences

from viewnet.config import RunConfig
from viewnet.data.build import view_store
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.recipes import make_config
from viewnet.runs.run_store import ensure


@dataclass(frozen=True)
class Task:
    """`act` does the work; it writes below `makes`, in the folder `place`, and nowhere else."""

    name: str
    makes: str
    act: Callable[[], Any]

    @property
    def place(self) -> str:
        """The first part of `makes`."""
        return self.makes.split("/")[0]

    def message(self) -> str:
        """Do it; the message of a ViewnetError, "" if it finished. Other errors are raised."""
        try:
            self.act()
        except ViewnetError as error:
            return str(error)
        return ""

    def damage(self, root: Path, reference: Path) -> list[str]:
        """See interrupted_work.damage."""
        return damage(root, reference, (self.makes,))

    def differences(self, root: Path, reference: Path) -> list[str]:
        """See interrupted_work.differences."""
        return differences(root, reference, (self.makes,))


def config(**overrides: Any) -> RunConfig:
    """Two epochs on thirty models."""
    return make_config(profile="smoke", **overrides)


def train(asked: RunConfig) -> None:
    """One run, in this process."""
    ensure([asked], workers=1, progress=False)


def _tabulate() -> None:
    asked = experiment("table1_shapenet", profile="smoke", categories="car", rows="viewnet", workers=1)
    asked.table(asked.run(progress=False)).write(asked.folder)


TASKS = (
    Task("drawing", "data", lambda: view_store(config().data, workers=1, progress=False)),
    Task("training", "runs/viewnet", lambda: train(config())),
    Task("table", "tables", _tabulate),
)
"""Each needs the results of those before it."""


@contextlib.contextmanager
def at(root: Path, reference: Path, task: Task) -> Iterator[None]:
    """What a task makes goes below `root`; everything else is where undisturbed tasks left it."""
    places = {variable: str((root if place == task.place else reference) / place) for place, variable in PLACES.items()}
    with mock.patch.dict(os.environ, places), one_processor():
        yield


@contextlib.contextmanager
def one_processor() -> Iterator[None]:
    """With more, a training has more threads and gives other bits."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def undisturbed(root: Path) -> None:
    """Do all tasks."""
    for task in TASKS:
        with at(root, root, task):
            task.act()
