"""What every reader of a data set provides, for training, for scoring and for `viewnet data` alike."""

import contextlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from viewnet.config import PhotoConfig, VideoConfig
from viewnet.data.store import Rejected, in_words, tally
from viewnet.errors import ViewnetError

if TYPE_CHECKING:
    # Slow to import, and processes that only render CAD models import this module too.
    from viewnet.data.clips import Clip
    from viewnet.data.photo_store import Photographs


@dataclass
class Contents:
    """What a folder holds: counts by category ("" where there are none), problems and notes, each in a line.

    `deep` asks for every file to be opened, not a sample.
    """

    key: str
    folder: str
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    deep: bool = False

    def add(self, category: str, usable: Iterable[str], reasons: Iterable[str] = ()) -> None:
        """Count what can be used, by kind, and what cannot, by reason."""
        self.counts[category] = dict(Counter(usable))
        name = f"{category}: " if category else ""
        self.problems += [f"{name}{count} left out: {reason}" for reason, count in sorted(tally(reasons).items())]

    @contextlib.contextmanager
    def error_is_problem(self) -> Iterator[None]:
        """A ViewnetError in the block becomes a problem, so that other parts of the folder are read all the same."""
        try:
            yield
        except ViewnetError as error:
            self.problems.append(str(error))


@dataclass(frozen=True)
class Reader:
    """A data set that the project reads, by the data set's folder and a configuration."""

    recognises: Callable[[Path], bool] = lambda folder: False  # whether a folder has its layout
    count: Callable[[Path, Contents], None] = lambda folder, contents: None  # adds what a folder holds to its contents
    photographs: "Callable[[PhotoConfig, Path], Photographs] | None" = None  # annotated ones
    # Clips and what cannot be used, and whether a folder is read so where a configuration does not name its layout.
    videos: "Callable[[VideoConfig, Path], tuple[list[Clip], list[Rejected]]] | None" = None
    accepts: Callable[[Path], bool] = lambda folder: False


def read_text(path: Path, expected: str) -> str:
    """The content of a text file. ViewnetError, which says what was `expected`, where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise ViewnetError(f"{path}: cannot be read ({error}): expected {expected}") from None


def no_usable(root: Path, what: str, rejected: Iterable[Rejected], otherwise: str) -> ViewnetError:
    """The error of a data set of which nothing can be used, with the reasons."""
    return ViewnetError(f"{root}: no usable {what} ({in_words(tally(reason for *_, reason in rejected)) or otherwise})")
