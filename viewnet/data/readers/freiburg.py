"""Freiburg static cars 52, release 1.1: videos of parked cars from all around, in the data set's own layout.

    car001/<frame>.png             the frames of a sequence (a folder may be called 001 too)
    annotations/1_annot.txt        a frame a line: name x1 y1 x2 y2 azimuth, or 001_annot.txt
    masks/car001/<frame>.png       not part of the release: masks made elsewhere

A name is the frame's path or its file's name; suffixes may differ. Boxes are in pixels, azimuths in degrees; elevations
are not annotated and taken as 0. 48 of the 52 sequences are annotated. Whatever is not used is listed with the reason.
"""

import math
import re
from dataclasses import replace
from pathlib import Path

from viewnet.config import VideoConfig
from viewnet.data.clips import Clip, Frame, images_in, pick_frames
from viewnet.data.crop import Box, clipped
from viewnet.data.readers.reader import Contents, Reader, no_usable
from viewnet.data.store import Rejected, rejecting, within
from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import size

CATEGORY = "car"
AZIMUTH = (1.0, 0.0)
"""Sense and offset: our azimuth is sense * theirs + offset. The release does not define its azimuths; PASCAL3D+'s
convention is assumed, which is ours: 0 shows the front and 90 the left side. Alignment would correct an offset, but not
the opposite sense (-1)."""
ANNOTATIONS = "annotations"
MASKS = "masks"


def read(root: Path) -> tuple[list[Clip], list[Rejected]]:
    """The sequences by number with the frames that can be used, and what cannot be used.

    Sequences up to 45 are "train", 46 and 47 "val", the rest "test". Frames are numbered by their place among all
    images of their folder. Boxes are cut at their image's edges.
    Raises ViewnetError where `root` is not this data set or no frame can be used.
    """
    root = Path(root)
    if not (root / ANNOTATIONS).is_dir():
        raise ViewnetError(f"{root}: no folder {ANNOTATIONS}: expected that of Freiburg static cars 52, release 1.1")
    folders = {n: path for path in sorted(root.iterdir()) if path.is_dir() and (n := _number(path.name)) is not None}
    files = sorted((root / ANNOTATIONS).glob("*_annot.txt"))
    lists = {n: path for path in files if (n := _number(path.name.removesuffix("_annot.txt"))) is not None}
    clips: list[Clip] = []
    rejected: list[Rejected] = []
    for number in sorted(folders.keys() | lists.keys()):
        if number not in folders:
            rejected.append((f"car{number:03d}", within(lists[number], root), "no frames of the sequence"))
        elif number not in lists:
            rejected.append((f"car{number:03d}", folders[number].name, "no annotations of the sequence"))
        else:
            folder, masks = folders[number], root / MASKS / folders[number].name
            if frames := tuple(_frames(lists[number], folder, root, rejected)):
                split = "train" if number <= 45 else "val" if number <= 47 else "test"
                clips.append(Clip(folder.name, CATEGORY, split, folder, frames, masks if masks.is_dir() else None))
    if not clips:
        raise no_usable(root, "frame", rejected, "no sequences")
    return clips, rejected


def azimuth(theirs: float) -> float:
    """An annotated azimuth as ours, degrees in [0, 360)."""
    # A tiny negative angle is 360 after rounding.
    return (AZIMUTH[0] * theirs + AZIMUTH[1]) % 360 % 360


def _number(name: str) -> int | None:
    """The number of a sequence, from car001, 001 or 1."""
    match = re.fullmatch(r"(?:car_?)?0*([0-9]+)", name, re.IGNORECASE)
    return int(match[1]) if match else None


def _frames(file: Path, folder: Path, root: Path, rejected: list[Rejected]) -> list[Frame]:
    """The usable frames of one sequence, in the order of time; what cannot be used joins `rejected`."""
    where = within(file, root)
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        rejected.append((folder.name, where, f"annotations cannot be read ({type(error).__name__})"))
        return []
    files = images_in(folder)
    places = {path.stem: number for number, path in enumerate(files)}
    frames: dict[int, Frame] = {}
    annotated: set[int] = set()
    for row, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        with rejecting(rejected, f"{folder.name}:{row}", where):
            stem, box, angle = _parsed(line)
            if stem not in places:
                raise ViewnetError(f"annotation of a frame that is missing ({stem})")
            number = places[stem]
            if number in annotated:
                raise ViewnetError(f"frame annotated twice ({stem})")
            annotated.add(number)
            frames[number] = Frame(number, azimuth(angle), 0.0, clipped(box, size(files[number])))
    for number, path in enumerate(files):
        if number not in annotated:
            rejected.append((f"{folder.name}/{path.stem}", within(path, root), "frame without a usable annotation"))
    return [frames[number] for number in sorted(frames)]


def _parsed(line: str) -> tuple[str, Box, float]:
    """The stem of a frame's name, its box and azimuth."""
    parts = line.split()
    try:
        name, (x0, y0, x1, y1, angle) = parts[0], map(float, parts[1:])
        if not all(map(math.isfinite, (x0, y0, x1, y1, angle))):
            raise ValueError
    except ValueError:
        raise ViewnetError(f"annotation is malformed ({line.strip()[:60]!r})") from None
    return Path(name.replace("\\", "/")).stem, (x0, y0, x1, y1), angle


def _read_videos(config: VideoConfig, root: Path) -> tuple[list[Clip], list[Rejected]]:
    if config.category != CATEGORY:
        raise ViewnetError(f"{root}: shows cars, not {config.category}: name another root or category car")
    clips, rejected = read(root)
    picked = []
    for clip in clips:
        chosen = pick_frames(len(clip.frames), config.count or None, config.pick, clip.id, config.seed)
        picked.append(replace(clip, frames=tuple(clip.frames[i] for i in chosen)))
    return picked, rejected


def _count(root: Path, contents: Contents) -> None:
    clips, rejected = read(root)
    contents.add_clips(root, CATEGORY, [("sequences", clip) for clip in clips], "sequences", rejected)


READER = Reader(
    recognises=lambda folder: any((folder / ANNOTATIONS).glob("*_annot.txt")),
    count=_count,
    accepts=lambda folder: (folder / ANNOTATIONS).is_dir() and not (folder / "videos").is_dir(),
    videos=_read_videos,
)
