"""Photographs with known viewpoints as a view store: cut to a box, made square, in one size.

    annotated photographs ─► crops ─► view store

A photograph has no mask, so its alpha is 1 throughout; what lies beyond its edges is filled with one colour.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from PIL import ImageOps

from viewnet.data.crop import Box, Crop, cut
from viewnet.data.store import COLUMNS, Rejected, ViewStore, in_words, tally, write_store
from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import opened
from viewnet.runtime.parallel import cores
from viewnet.runtime.progress import bar

VERSION = 1
"""Raise it when a change alters how photographs are cut: it is part of every store's identity."""
SPLITS = ("val", "test")
"""Photographs on which viewpoints are calibrated, and which are scored."""


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


def photo_store(
    photographs: Sequence[Photograph],
    folder: Path,
    crop: Crop,
    made_by: dict[str, Any],
    root: Path,
    rejected: Iterable[Rejected] = (),
    upright: bool = False,
    workers: int | None = None,
    progress: bool = False,
) -> ViewStore:
    """Cut photographs of the data set at `root` into a view store, one view each, and open it.

    `made_by` describes where they come from (JSON values). With `upright`, images are rotated as their camera recorded
    before they are cut. Images that cannot be decoded, boxes outside of them, and images to calibrate on whose very
    bytes are scored too join `rejected` with their reason.

    Raises ViewnetError where one file is in both splits, or a split has no usable photograph.
    """
    _check_apart(photographs)
    rejected = list(rejected)

    def attempt(photograph: Photograph) -> tuple[np.ndarray, bytes] | ViewnetError:
        try:
            return _crop_and_digest(photograph, crop, upright)
        except ViewnetError as error:
            return error

    # Decoding and resizing release the interpreter's lock, so threads do.
    with ThreadPoolExecutor(workers or cores()) as pool:
        crops = pool.map(attempt, photographs)
        results = list(bar(progress, iterable=crops, total=len(photographs), desc="photographs", unit="image"))
    pairs = list(zip(photographs, results, strict=True))
    scored = {result[1] for photo, result in pairs if photo.split == "test" and isinstance(result, tuple)}
    usable: list[tuple[Photograph, np.ndarray]] = []
    for photograph, result in pairs:
        source = photograph.image_path.relative_to(root).as_posix()
        if isinstance(result, ViewnetError):
            rejected.append((photograph.id, source, str(result)))
        elif photograph.split == "val" and result[1] in scored:
            reason = "image to calibrate on that is scored on under another name"
            rejected.append((photograph.id, source, reason))
        else:
            usable.append((photograph, result[0]))
    for name in SPLITS:
        if not any(photograph.split == name for photograph, _ in usable):
            first = f" (the first that was left out: {rejected[0][1]}: {rejected[0][2]})" if rejected else ""
            raise ViewnetError(f"{root}: no usable photograph in the {name} split{first}")
    usable.sort(key=lambda item: item[0].id)
    index = pd.DataFrame(
        [
            (
                p.id,
                p.category,
                p.split,
                0,
                p.azimuth % 360 % 360,
                float(p.elevation),
                p.image_path.relative_to(root).as_posix(),
            )
            for p, _ in usable
        ],
        columns=list(COLUMNS),
    )
    return write_store(folder, _batches([pixels for _, pixels in usable]), index, made_by, rejected)


def summary(store: ViewStore) -> str:
    """What a store of photographs holds and what it leaves out, in a line for under a table.

    For example "car: 308 calibrate, 605 scored; left out: 12 only coarsely annotated, 1 image does not decode".
    """
    counts = store.index["split"].value_counts()
    text = f"{store.index['category'].iloc[0]}: {counts.get('val', 0)} calibrate, {counts.get('test', 0)} scored"
    for title, reasons in (
        ("left out", tally(store.rejected["reason"])),
        ("mended", store.meta["made_by"].get("mended", {})),
    ):
        if reasons:
            text += f"; {title}: {in_words(dict(sorted(reasons.items())))}"
    return text


def describe_crop(crop: Crop) -> dict[str, Any]:
    """What of the cutting decides the pixels, as JSON values."""
    return {"version": VERSION, **asdict(crop), "colour": list(crop.colour)}


def _check_apart(photographs: Sequence[Photograph]) -> None:
    """Raise where a file is in both splits."""
    seen: dict[Path, str] = {}
    for photograph in photographs:
        if seen.setdefault(photograph.image_path, photograph.split) != photograph.split:
            raise ViewnetError(
                f"{photograph.image_path}: is both calibrated on and scored: list it in one split, or the score is"
                " of an image that was seen in calibration"
            )


def _crop_and_digest(photograph: Photograph, crop: Crop, upright: bool) -> tuple[np.ndarray, bytes]:
    try:
        content = photograph.image_path.read_bytes()
    except FileNotFoundError:
        raise ViewnetError("no such image") from None
    except (OSError, ValueError) as error:
        raise ViewnetError(f"image cannot be read ({type(error).__name__})") from None
    with opened(io.BytesIO(content)) as image:
        image.load()
        whole = ImageOps.exif_transpose(image) if upright else image.copy()
    return cut(whole, photograph.box, crop), hashlib.sha256(content).digest()


def _batches(crops: Sequence[np.ndarray], size: int = 256) -> Iterator[np.ndarray]:
    for start in range(0, len(crops), size):
        yield np.stack(crops[start : start + size])  # (size, S, S, 4)
