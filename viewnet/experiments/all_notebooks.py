"""Every notebook in turn: one that fails is told, and the others go on."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.experiments import notebook
from viewnet.experiments.request import DESIGNS

ORDER = (
    # Nothing is trained for these.
    "architecture",
    "audit_metrics",
    # The runs of Table 2 serve the figures after it, those of Table 3 what scores on photographs.
    "table1_shapenet",
    "table2_ablation",
    "figure3_azimuth",
    "failures",
    "learned_volumes",
    "training_curves",
    "novel_views",
    "table3_pascal3d",
    "table5_dva",
    "alignment_study",
    "reconstructions",
    "table4_freiburg",
    "objectron",
    "your_method",
)
"""What shares runs stands together, so that the first of them trains and the others are done in no time."""


@dataclass(frozen=True)
class Planned:
    """A notebook and the parameters it is run with, as text."""

    name: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Done:
    """What became of a notebook: the executed copy, or the error in a line."""

    name: str
    seconds: float
    copy: Path | None
    error: str | None

    def __str__(self) -> str:
        outcome = f"failed: {self.error}" if self.error else str(self.copy)
        return f"{self.name}: {self.seconds:.0f} s: {outcome}"

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self) | {"copy": None if self.copy is None else str(self.copy), "seconds": round(self.seconds, 1)}


def planned(only: Sequence[str] | None = None, profile: str | None = None, seeds: str | None = None) -> list[Planned]:
    """The notebooks to run, all or `only` these, in the order of ORDER, and their parameters, checked.

    `profile` is given to those that train, `seeds` to those that take several. Raises ViewnetError for an unknown
    notebook and for values that a notebook would refuse, before any is run.
    """
    wanted = {known(name.removesuffix(".ipynb"), ORDER, "notebook") for name in only or ORDER}
    found = []
    for name in ORDER:
        if name not in wanted:
            continue
        path = notebook.find(name)
        declared = notebook.parameters(path)
        given = {"profile": profile if _trains(name) else None, "seeds": seeds}
        values = tuple((key, value) for key, value in given.items() if value is not None and key in declared)
        notebook.checked(path, values)
        found.append(Planned(name, values))
    return found


def run(notebooks: Sequence[Planned]) -> Iterator[Done]:
    """Run them one after the other; what became of each, as soon as it is done."""
    for one in notebooks:
        begun, copy, error = time.monotonic(), None, None
        try:
            copy = notebook.run(one.name, one.values)
        except ViewnetError as problem:
            error = str(problem)
        yield Done(one.name, time.monotonic() - begun, copy, error)


def _trains(name: str) -> bool:
    design = DESIGNS[name]
    return bool(design.variants or design.tables)
