"""Photographs with known viewpoints as a view store: cut to a box, made square, in one size.

A photograph has no mask, so its alpha is 1 throughout; what lies beyond its edges is black.
"""

import hashlib
import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet.data import contents
from viewnet.data.crop import Box, Crop, cut
from viewnet.data.store import COLUMNS, Rejected, ViewStore, in_words, tally, within, write_store
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files
from viewnet.runtime.parallel import cores
from viewnet.runtime.progress import bar

VERSION = 2  # raise it when a change alters how photographs are cut: it is part of every store's identity
SPLITS = ("val", "test")  # photographs on which viewpoints are calibrated, and which are scored


@dataclass(frozen=True)
class Photograph:
    """One annotated object of one photograph."""

    id: str  # unique among the photographs of a category
    category: str
    split: str  # "val" (calibrated on) or "test" (scored)
    image_path: Path
    box: Box | None  # the object's edges in pixels; None for the whole image
    azimuth: float  # degrees, see viewnet.geometry
    elevation: float


@dataclass(frozen=True)
class Photographs:
    """The photographs of the data set at `root`, split into "val" (calibrated on) and "test" (scored)."""

    root: Path
    usable: Sequence[Photograph]
    rejected: Sequence[Rejected] = ()
    notes: dict[str, Any] = field(default_factory=dict)  # JSON values that a view store records of its making
    upright: bool = False  # whether boxes are of the image rotated as its camera recorded


def photo_store(
    data: Photographs,
    folder: Path,
    crop: Crop,
    made_by: dict[str, Any],
    workers: int | None = None,
    progress: bool = False,
) -> ViewStore:
    """Cut photographs into a view store, one view each, and open it.

    What cannot be used (see `crops`) joins what is rejected. There may be none to calibrate on. Raises ViewnetError
    where one file is in both splits, and where a split has no usable photograph although there are some of it.
    """
    check_apart(data.usable)
    root, rejected = data.root, list(data.rejected)
    usable: list[tuple[Photograph, str, np.ndarray]] = []
    for photograph, result in zip(data.usable, crops(data.usable, crop, data.upright, workers, progress), strict=True):
        source = within(photograph.image_path, root)
        if isinstance(result, ViewnetError):
            rejected.append((photograph.id, source, str(result)))
        else:
            usable.append((photograph, source, result))
    usable.sort(key=lambda item: item[0].id)
    rows = [(p.id, p.category, p.split, 0, p.azimuth % 360 % 360, float(p.elevation), file) for p, file, _ in usable]
    index = pd.DataFrame(rows, columns=list(COLUMNS))
    for name in sorted({"test"} | {photograph.split for photograph in data.usable}):
        if not (index["split"] == name).any():
            first = f" (the first that was left out: {rejected[0][1]}: {rejected[0][2]})" if rejected else ""
            raise ViewnetError(f"{root}: no usable photograph in the {name} split{first}")
    return write_store(folder, (pixels[None] for _, _, pixels in usable), index, made_by | data.notes, rejected)


def crops(
    photographs: Sequence[Photograph], crop: Crop, upright: bool, workers: int | None = None, progress: bool = False
) -> list[np.ndarray | ViewnetError]:
    """The crop (S, S, 4) uint8 of each photograph, or why it cannot be used.

    Images that cannot be decoded, boxes outside of them, and images to calibrate on whose very pixels are scored too.
    """
    # Decoding and resizing release the interpreter's lock, so threads do.
    with ThreadPoolExecutor(workers or cores()) as pool:
        work = pool.map(lambda photograph: _crop_and_digest(photograph, crop, upright), photographs)
        results = list(bar(progress, iterable=work, total=len(photographs), desc="photographs", unit="image"))
    pairs = list(zip(photographs, results, strict=True))
    scored = {pixels for photograph, (_, pixels) in pairs if photograph.split == "test"} - {None}
    again = ViewnetError("image to calibrate on that is scored on under another name")
    return [again if photo.split == "val" and pixels in scored else made for photo, (made, pixels) in pairs]


def summary(store: ViewStore) -> str:
    """What a store of photographs holds and what it leaves out, in a line for under a table."""
    counts = store.index["split"].value_counts()
    text = f"{store.index['category'].iloc[0]}: {counts.get('val', 0)} calibrate, {counts.get('test', 0)} scored"
    mended = store.meta["made_by"].get("mended", {})
    for title, reasons in (("left out", tally(store.rejected["reason"])), ("mended", mended)):
        if reasons:
            text += f"; {title}: {in_words(dict(sorted(reasons.items())))}"
    return text


def digest(data: Photographs) -> str:
    """A hash of what was read of the photographs, and of the contents of their images."""
    hashes = contents.of_files(data.root, [photograph.image_path for photograph in data.usable])
    rows = [
        [p.id, p.category, p.split, p.box, p.azimuth, p.elevation, within(path, data.root), hashes[path]]
        for p, path in ((photograph, photograph.image_path) for photograph in data.usable)
    ]
    return hashlib.sha256(json.dumps([rows, data.rejected]).encode()).hexdigest()


def describe_crop(crop: Crop) -> dict[str, Any]:
    """What of the cutting decides the pixels, as JSON values."""
    return {"version": VERSION, **asdict(crop)}


def check_apart(photographs: Sequence[Photograph]) -> None:
    """ViewnetError where a file is in both splits."""
    seen: dict[Path, str] = {}
    for photograph in photographs:
        if seen.setdefault(photograph.image_path, photograph.split) != photograph.split:
            raise ViewnetError(f"{photograph.image_path}: is both calibrated on and scored: list it in one split only")


def _crop_and_digest(
    photograph: Photograph, crop: Crop, upright: bool
) -> tuple[np.ndarray | ViewnetError, bytes | None]:
    """The crop, or why there is none, and a digest of the whole image's pixels."""
    try:
        image = image_files.read(photograph.image_path, upright=upright)
        pixels = hashlib.sha256(image.tobytes())
        pixels.update(repr(image.size).encode())
        return cut(image, photograph.box, crop), pixels.digest()
    except ViewnetError as error:
        return error, None
