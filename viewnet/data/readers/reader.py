"""What every reader of a data set provides, for training, for scoring and for `viewnet data` alike."""

import contextlib
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from viewnet.config import PhotoConfig, VideoConfig
from viewnet.data.crop import Crop
from viewnet.data.store import Rejected, in_words, tally
from viewnet.errors import ViewnetError
from viewnet.runtime.parallel import cores

if TYPE_CHECKING:
    # Slow to import, and processes that only render CAD models import this module too.
    from viewnet.data.clips import Clip
    from viewnet.data.photo_store import Photograph, Photographs

SAMPLE = 20
"""Models, images or clips of a category that are opened to see whether they can be used."""


@dataclass
class Contents:
    """What a folder holds: counts by category ("" where there are none), problems and notes, each in a line.

    `deep` asks for every file to be opened, not a sample. What is counted comes with its kind, in words.
    """

    key: str
    folder: str
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    deep: bool = False

    def add(self, category: str, usable: Iterable[str], lost: Iterable[tuple[str, str]]) -> None:
        """Count what can be used, by kind, and what cannot, (name, reason): the first is named for each reason."""
        self.counts[category] = dict(Counter(usable))
        name, alike = f"{category}: " if category else "", dict[str, list[str]]()
        for what, reason in lost:
            (plain,) = tally([reason])
            alike.setdefault(plain, []).append(what)
        for reason, (first, *others) in sorted(alike.items()):
            more = f" and {len(others)} more" if others else ""
            self.problems.append(f"{name}{1 + len(others)} left out: {reason}: {first}{more}")

    def opened(self, category: str, count: int, what: str, part: str = "", most: int = SAMPLE) -> range:
        """The numbers of those to open of a category's `count` models, images or clips; a note says so if not all.

        `part` is what of each is opened, where it is not the whole, and `most` how many are without `deep`.
        """
        numbers = range(0, count, 1 if self.deep else max(1, -(-count // most)))
        if len(numbers) < count or (part and not self.deep):
            name = f"{category}: " if category else ""
            self.notes.append(f"{name}{len(numbers)} of {count} {what} opened{part}: --deep opens all")
        return numbers

    def add_photographs(
        self, category: str, found: Sequence[tuple[str, "Photograph"]], upright: bool, rejected: Iterable[Rejected]
    ) -> None:
        """Count photographs by kind and use, but for those that would not become a view; see `add`."""
        from viewnet.data import photo_store

        with self.error_is_problem():
            photo_store.check_apart([photograph for _, photograph in found])
        opened = self.opened(category, len(found), "objects")
        crops = photo_store.crops([found[number][1] for number in opened], Crop(), upright)
        cut = zip(opened, crops, strict=True)
        lost = {n: (found[n][1].id, str(crop)) for n, crop in cut if isinstance(crop, ViewnetError)}
        uses = {"val": "calibrate", "test": "score"}
        usable = [f"{kind} to {uses[photo.split]}" for number, (kind, photo) in enumerate(found) if number not in lost]
        self.add(category, usable, [*((what, reason) for what, _, reason in rejected), *lost.values()])

    def add_clips(
        self, root: Path, category: str, found: Sequence[tuple[str, "Clip"]], what: str, rejected: Iterable[Rejected]
    ) -> None:
        """Count clips and their frames but for what would not become views; see `add`.

        A clip is opened up to the frame from which on it can be used; `deep` opens all.
        """
        from viewnet.data import clip_store

        opened = self.opened(category, len(found), what, ", each up to its second usable frame")
        enough = None if self.deep else clip_store.LEAST
        with ThreadPoolExecutor(cores()) as pool:
            reports = pool.map(lambda number: clip_store.unusable(found[number][1], root, enough), opened)
            lost = dict(zip(opened, reports, strict=True))
        usable: list[str] = []
        for number, (kind, clip) in enumerate(found):
            mine = [name for name, *_ in lost.get(number, ())]
            if clip.id not in mine:
                usable += [kind, *["frames"] * (len(clip.frames) - len(mine))]
                usable += [f"{what} with masks"] * (clip.masks is not None)
        self.add(category, usable, ((what, reason) for what, _, reason in itertools.chain(rejected, *lost.values())))

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

    recognises: Callable[[Path], bool]  # whether a folder has its layout
    count: Callable[[Path, Contents], None]  # adds what a folder holds to its contents
    photographs: "Callable[[PhotoConfig, Path], Photographs] | None" = None  # annotated ones
    # Clips and what cannot be used, and whether a folder is read so where a configuration does not name its layout.
    videos: "Callable[[VideoConfig, Path], tuple[list[Clip], list[Rejected]]] | None" = None
    accepts: Callable[[Path], bool] = lambda folder: False


def require_all(config: PhotoConfig, root: Path) -> None:
    """ViewnetError where a configuration chooses by flags of difficulty, which a plain list has not."""
    if config.keep != "all":
        raise ViewnetError(f"{root}: its list has no difficulty flags: use keep='all', or PASCAL3D+")


def read_text(path: Path, expected: str) -> str:
    """The content of a text file. ViewnetError, which says what was `expected`, where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise ViewnetError(f"{path}: cannot be read ({error}): expected {expected}") from None


def no_usable(root: Path, what: str, rejected: Iterable[Rejected], otherwise: str) -> ViewnetError:
    """The error of a data set of which nothing can be used, with the reasons."""
    return ViewnetError(f"{root}: no usable {what} ({in_words(tally(reason for *_, reason in rejected)) or otherwise})")
