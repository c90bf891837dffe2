"""What every reader of a data set provides, for training, for scoring and for `viewnet data` alike."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viewnet.config import PhotoConfig, VideoConfig
from viewnet.data.store import Rejected, tally
from viewnet.errors import ViewnetError

if TYPE_CHECKING:
    # Slow to import, and processes that only render CAD models import this module too.
    from viewnet.data.clips import Clip
    from viewnet.data.photo_store import Photograph


@dataclass(frozen=True)
class DataSet:
    """The catalogue's entry of a data set.

    key      its short name
    title    its own name
    use      what for
    named    how a copy is named to the project
    layout   what must lie in the folder
    terms    under what terms it is had, and where they are
    source   where it is had
    """

    key: str
    title: str
    use: str
    named: str
    layout: str
    terms: str
    source: str


@dataclass
class Contents:
    """What a folder holds: counts by category ("" where there are none), and problems, each in a line."""

    key: str
    folder: str
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def add(self, category: str, usable: Iterable[str], reasons: Iterable[str] = ()) -> None:
        """Count what can be used, by kind, and what cannot, by reason."""
        self.counts[category] = dict(Counter(usable))
        self.problems += [
            f"{category + ': ' if category else ''}{count} left out: {reason}"
            for reason, count in sorted(tally(reasons).items())
        ]

    @contextlib.contextmanager
    def error_is_problem(self) -> Iterator[None]:
        """A ViewnetError in the block becomes a problem, so that other parts of the folder are read all the same."""
        try:
            yield
        except ViewnetError as error:
            self.problems.append(str(error))


@dataclass(frozen=True)
class Photographs:
    """The photographs of a data set, split into "val" (calibrated on) and "test" (scored).

    `notes` (JSON values) join what a view store records of its making.
    """

    usable: list[Photograph]
    rejected: list[Rejected] = field(default_factory=list)
    notes: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class PhotoReader:
    """Reads annotated photographs.

    describe   of a configuration and the data set's folder: what decides the photographs, as JSON values
    read       the photographs
    upright    whether boxes are of the image rotated as its camera recorded
    """

    describe: Callable[[PhotoConfig, Path], dict[str, Any]]
    read: Callable[[PhotoConfig, Path], Photographs]
    upright: bool = False


@dataclass(frozen=True)
class VideoReader:
    """Reads clips.

    accepts   whether a folder is read in this layout where the configuration does not name one
    read      of a configuration and the data set's folder: the clips, and what cannot be used
    """

    accepts: Callable[[Path], bool]
    read: Callable[[VideoConfig, Path], tuple[list[Clip], list[Rejected]]]


@dataclass(frozen=True)
class Reader:
    """A data set that the project reads.

    about        its entry in the catalogue; None for a layout that is named in a configuration alone
    recognises   whether a folder has its layout
    count        adds what a folder holds to its `Contents`
    """

    about: DataSet | None
    recognises: Callable[[Path], bool] = lambda folder: False
    count: Callable[[Path, Contents], None] = lambda folder, contents: None
    photographs: PhotoReader | None = None
    videos: VideoReader | None = None
