"""Photographs with known viewpoints as a view store: cut to a box, made square, in one size.

    annotated photographs ─► crops ─► view store

A photograph has no mask, so its alpha is 1 throughout; what lies beyond its edges is painted in one colour.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
from PIL import Image

from viewnet.config import CATEGORIES, known
from viewnet.data.store import ViewStore, write_store
from viewnet.errors import ViewnetError

Box = tuple[float, float, float, float]


class Photograph(Protocol):
    """What is needed of a photograph; viewnet.data.pascal3d.Annotation is one, Listed another."""

    @property
    def id(self) -> str: ...
    @property
    def category(self) -> str: ...
    @property
    def split(self) -> str: ...
    @property
    def picture(self) -> Path: ...
    @property
    def box(self) -> Box | None: ...
    @property
    def azimuth(self) -> float: ...
    @property
    def elevation(self) -> float: ...


@dataclass(frozen=True)
class Listed:
    """A row of a folder's list: see `read_folder`."""

    id: str
    category: str
    split: str
    picture: Path
    box: Box | None
    azimuth: float
    elevation: float


@dataclass(frozen=True)
class Crop:
    """How photographs are cut.

    size     pixels along a side
    margin   so much of the box's longer side is seen beyond it, on either side
    square   whether the shorter side is made as long as the other (the object keeps its shape) or stretched
    colour   of what lies beyond the photograph's edges, 0 to 255
    """

    size: int = 64
    margin: float = 0.0
    square: bool = True
    colour: tuple[int, int, int] = (0, 0, 0)

    def __post_init__(self) -> None:
        if self.size < 1:
            raise ViewnetError(f"crop: size {self.size}: expected 1 or more pixels")
        if not 0 <= self.margin <= 2:
            raise ViewnetError(f"crop: margin {self.margin}: expected 0 to 2 sides of the box")
        if any(not 0 <= value <= 255 for value in self.colour):
            raise ViewnetError(f"crop: colour {self.colour}: expected three numbers from 0 to 255")


def cut(picture: Image.Image, box: Box | None, crop: Crop) -> np.ndarray:
    """The part of a picture in `box` (pixels from 0; None: all of it), (size, size, 4) uint8.

    Raises ViewnetError for a box that has no part in the picture.
    """
    width, height = picture.size
    x0, y0, x1, y1 = box or (0.0, 0.0, float(width), float(height))
    x0, y0, x1, y1 = max(x0, 0.0), max(y0, 0.0), min(x1, float(width)), min(y1, float(height))
    if x1 - x0 < 1 or y1 - y0 < 1:
        raise ViewnetError(f"box has no part in the picture ({width} x {height})")
    half_x, half_y = (x1 - x0) / 2, (y1 - y0) / 2
    beyond = 2 * crop.margin * max(half_x, half_y)
    half_x, half_y = half_x + beyond, half_y + beyond
    if crop.square:
        half_x = half_y = max(half_x, half_y)
    centre_x, centre_y = (x0 + x1) / 2, (y0 + y1) / 2
    seen = (centre_x - half_x, centre_y - half_y, centre_x + half_x, centre_y + half_y)
    # Whole pixels around it, the picture's own or the colour's; the exact corners are cut when it is resized.
    left, upper = int(np.floor(seen[0])), int(np.floor(seen[1]))
    right, lower = int(np.ceil(seen[2])), int(np.ceil(seen[3]))
    canvas = Image.new("RGB", (right - left, lower - upper), crop.colour)
    canvas.paste(picture.convert("RGB"), (-left, -upper))
    exact = (seen[0] - left, seen[1] - upper, seen[2] - left, seen[3] - upper)
    small = canvas.resize(
        (crop.size, crop.size), Image.Resampling.BOX if _shrinks(seen, crop.size) else None, box=exact
    )
    return np.dstack([np.asarray(small), np.full((crop.size, crop.size), 255, np.uint8)])


def _shrinks(seen: Box, size: int) -> bool:
    return seen[2] - seen[0] >= 2 * size and seen[3] - seen[1] >= 2 * size


def photo_store(
    photographs: Sequence[Photograph],
    folder: Path,
    crop: Crop,
    made_by: dict[str, Any],
    splits: dict[str, str] | None = None,
    rejected: Iterable[tuple[str, str, str]] = (),
) -> ViewStore:
    """Cut photographs into a view store, one view each, and open it.

    `made_by` describes where they come from (JSON values). `splits` renames splits, say {"train": "val", "val":
    "test"}: what another data set trains on is what viewpoints are calibrated on here. Pictures that cannot be decoded
    and boxes outside of them join `rejected` with their reason. Raises ViewnetError where none is left.
    """
    refused, kept, crops = list(rejected), [], []
    for photograph in photographs:
        try:
            crops.append(_decoded(photograph, crop))
        except ViewnetError as error:
            refused.append((photograph.id, str(photograph.picture), str(error)))
        else:
            kept.append(photograph)
    if not kept:
        told = f": {refused[0][1]}: {refused[0][2]}" if refused else ""
        raise ViewnetError(f"{folder}: none of {len(photographs)} photographs can be used{told}")
    order = sorted(range(len(kept)), key=lambda i: kept[i].id)
    index = pd.DataFrame(
        {
            "model_id": [kept[i].id for i in order],
            "category": [kept[i].category for i in order],
            "split": [(splits or {}).get(kept[i].split, kept[i].split) for i in order],
            "view": np.zeros(len(order), dtype=np.int64),
            "azimuth": [kept[i].azimuth % 360 for i in order],
            "elevation": [float(kept[i].elevation) for i in order],
            "source": [kept[i].picture.name for i in order],
        }
    )
    return write_store(folder, _batches([crops[i] for i in order]), index, made_by | {"crop": asdict(crop)}, refused)


def read_folder(root: Path, category: str, images: str = "images") -> list[Listed]:
    """Photographs listed in `<root>/viewpoints.csv`: file, azimuth_deg, elevation_deg, split, and x0 y0 x1 y1 if cut.

    Raises ViewnetError for a missing list, column or value.
    """
    known(category, CATEGORIES, "category")
    path = Path(root) / "viewpoints.csv"
    try:
        frame = pd.read_csv(path, dtype={"file": str, "split": str})
    except FileNotFoundError as error:
        raise ViewnetError(f"{path}: no such file") from error
    except (OSError, ValueError) as error:
        raise ViewnetError(f"{path}: not a readable CSV file ({error})") from error
    for name in ("file", "azimuth_deg", "elevation_deg", "split"):
        if name not in frame.columns:
            raise ViewnetError(f"{path}: column {name!r} is missing")
        if frame[name].isna().any():
            row = int(np.flatnonzero(frame[name].isna())[0])
            raise ViewnetError(f"{path}: {name} is empty in row {row + 1}")
    boxed = all(name in frame.columns for name in ("x0", "y0", "x1", "y1"))
    return [
        Listed(
            row.file,
            category,
            row.split,
            Path(root) / images / row.file,
            (row.x0, row.y0, row.x1, row.y1) if boxed else None,
            float(row.azimuth_deg) % 360,
            float(row.elevation_deg),
        )
        for row in frame.itertuples()
    ]


def _decoded(photograph: Photograph, crop: Crop) -> np.ndarray:
    try:
        with Image.open(photograph.picture) as picture:
            picture.load()
            return cut(picture, photograph.box, crop)
    except FileNotFoundError:
        raise ViewnetError("no such picture") from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise ViewnetError(f"picture does not decode ({type(error).__name__})") from None


def _batches(crops: Sequence[np.ndarray], size: int = 256) -> Iterator[np.ndarray]:
    for start in range(0, len(crops), size):
        yield np.stack(crops[start : start + size])
