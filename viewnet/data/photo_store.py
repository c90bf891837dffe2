"""Photographs with known viewpoints as a view store: cut to a box, made square, in one size.

    annotated photographs ─► crops ─► view store

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
from viewnet.data.store import COLUMNS, Rejected, ViewStore, in_words, tally, write_store
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

    Images that cannot be decoded, boxes outside of them, and images to calibrate on whose very bytes are scored too
    join what is rejected. Raises ViewnetError where one file is in both splits, or a split has no usable photograph.
    """
    _check_apart(data.usable)
    root, rejected = data.root, list(data.rejected)
    # Decoding and resizing release the interpreter's lock, so threads do.
    with ThreadPoolExecutor(workers or cores()) as pool:
        work = pool.map(lambda photograph: _crop_and_digest(photograph, crop, data.upright), data.usable)
        results = list(bar(progress, iterable=work, total=len(data.usable), desc="photographs", unit="image"))
    pairs = list(zip(data.usable, results, strict=True))
    scored = {result[1] for photo, result in pairs if photo.split == "test" and isinstance(result, tuple)}
    usable: list[tuple[Photograph, str, np.ndarray]] = []
    for photograph, result in pairs:
        source = photograph.image_path.relative_to(root).as_posix()
        if isinstance(result, ViewnetError):
            rejected.append((photograph.id, source, str(result)))
        elif photograph.split == "val" and result[1] in scored:
            rejected.append((photograph.id, source, "image to calibrate on that is scored on under another name"))
        else:
            usable.append((photograph, source, result[0]))
    usable.sort(key=lambda item: item[0].id)
    rows = [(p.id, p.category, p.split, 0, p.azimuth % 360 % 360, float(p.elevation), file) for p, file, _ in usable]
    index = pd.DataFrame(rows, columns=list(COLUMNS))
    for name in SPLITS:
        if not (index["split"] == name).any():
            first = f" (the first that was left out: {rejected[0][1]}: {rejected[0][2]})" if rejected else ""
            raise ViewnetError(f"{root}: no usable photograph in the {name} split{first}")
    crops = [pixels for _, _, pixels in usable]
    batches = (np.stack(crops[i : i + 256]) for i in range(0, len(crops), 256))  # (256, S, S, 4), the last one fewer
    return write_store(folder, batches, index, made_by | data.notes, rejected)


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
    """A hash of the contents of the photographs' files."""
    hashes = contents.of_files(data.root, [photograph.image_path for photograph in data.usable])
    return hashlib.sha256(json.dumps(hashes).encode()).hexdigest()


def describe_crop(crop: Crop) -> dict[str, Any]:
    """What of the cutting decides the pixels, as JSON values."""
    return {"version": VERSION, **asdict(crop)}


def _check_apart(photographs: Sequence[Photograph]) -> None:
    """Raise where a file is in both splits."""
    seen: dict[Path, str] = {}
    for photograph in photographs:
        if seen.setdefault(photograph.image_path, photograph.split) != photograph.split:
            raise ViewnetError(f"{photograph.image_path}: is both calibrated on and scored: list it in one split only")


def _crop_and_digest(photograph: Photograph, crop: Crop, upright: bool) -> tuple[np.ndarray, bytes] | ViewnetError:
    """The crop and a digest of the image's file, or why it cannot be used."""
    try:
        image = image_files.read(photograph.image_path, upright=upright)
        digest = hashlib.sha256(photograph.image_path.read_bytes()).digest()
        return cut(image, photograph.box, crop), digest
    except ViewnetError as error:
        return error
