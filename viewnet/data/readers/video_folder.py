"""Any folder of videos, or of folders of frames, one object each.

    <clip>.mp4              a video (viewnet.data.frames.VIDEOS), or
    <clip>/<frame>.png      its frames, whose names sort in the order of time
    masks/<clip>/           if there are any: PNG masks named like the frames, or 000000.png by a frame's number
    splits.csv              if there is one: columns clip, split (train, val or test)

Nothing is left out silently: whatever is not used is listed with the reason.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from viewnet.config import CATEGORIES, known
from viewnet.data import frames
from viewnet.data.clips import Clip, Frame
from viewnet.data.readers.freiburg import Rejected
from viewnet.data.readers.shapenet import SHARES, SPLITS
from viewnet.errors import ViewnetError
from viewnet.runtime.files import read_csv

LIST = "splits.csv"
MASKS = "masks"


def read(
    root: Path,
    category: str,
    count: int | None = 10,
    pick: frames.Pick = "random",
    seed: int = 0,
    splits: Mapping[str, str] | None = None,
) -> tuple[list[Clip], list[Rejected]]:
    """The clips of a folder by name, `count` frames each (None: all), and what cannot be used.

    A clip's name is its file's without the suffix, or its folder's. `splits` gives clip -> split; else `splits.csv`
    does; else names are shuffled by `seed` and cut at 0.7, 0.1 and 0.2. Clips that have no split are not used.
    Raises ViewnetError for a folder that does not exist, a malformed list, and where no clip can be used.
    """
    root = Path(root)
    known(category, CATEGORIES, "category")
    if not root.is_dir():
        raise ViewnetError(f"{root}: no such folder: give one of videos, or of folders of frames")
    rejected: list[Rejected] = []
    sources: dict[str, Path] = {}
    for path in sorted(root.iterdir()):
        if path.name.startswith(".") or path.name in (LIST, MASKS):
            continue
        name = path.name if path.is_dir() else path.stem
        if not path.is_dir() and not frames.is_video(path):
            rejected.append((name, path.name, "neither a video nor a folder of frames"))
        elif name in sources:
            rejected.append((name, path.name, f"another clip has its name ({sources[name].name})"))
        else:
            sources[name] = path
    numbers: dict[str, list[int]] = {}
    for name, path in sources.items():
        try:
            total = frames.count(path)
        except ViewnetError as error:
            rejected.append((name, path.name, str(error)))
        else:
            numbers[name] = frames.pick(total, count, pick, name, seed)
    chosen = dict(splits) if splits is not None else _listed(root) or seeded(list(numbers), seed)
    clips: list[Clip] = []
    for name, mine in numbers.items():
        if name not in chosen:
            rejected.append((name, sources[name].name, "in no split"))
            continue
        masks = root / MASKS / name
        found = masks if masks.is_dir() else None
        stills = tuple(Frame(number) for number in mine)
        clips.append(Clip(name, category, known(chosen[name], SPLITS, "split"), sources[name], stills, found))
    if not clips:
        told = f" (the first that was left out: {': '.join(rejected[0][1:])})" if rejected else ""
        raise ViewnetError(f"{root}: no usable video or folder of frames{told}")
    return clips, rejected


def seeded(names: Sequence[str], seed: int = 0) -> dict[str, str]:
    """Clip -> split: exact shares, in an order by seed and names only; from three clips on none is empty."""
    order = sorted(names, key=lambda name: hashlib.sha256(f"{seed} split {name}".encode()).digest())
    test = max(round(SHARES[2] * len(names)), int(len(names) > 2))
    val = max(round(SHARES[1] * len(names)), int(len(names) > 1))
    splits = ["test"] * test + ["val"] * val + ["train"] * (len(names) - test - val)
    return dict(zip(order, splits, strict=True))


def _listed(root: Path) -> dict[str, str]:
    """Clip -> split by the folder's own list, nothing where there is none."""
    path = root / LIST
    if not path.is_file():
        return {}
    table = read_csv(path, dtype=str, keep_default_na=False)
    for column in ("clip", "split"):
        if column not in table.columns:
            raise ViewnetError(f"{path}: column {column!r} is missing")
    for number, row in enumerate(table.itertuples(), start=1):
        if row.split not in SPLITS:
            raise ViewnetError(f"{path}: row {number}: split {row.split[:60]!r}: expected one of {', '.join(SPLITS)}")
    if (again := table["clip"].duplicated()).any():
        raise ViewnetError(f"{path}: clip {table['clip'][again].iloc[0][:60]!r} is listed twice")
    return dict(zip(table["clip"], table["split"], strict=True))
