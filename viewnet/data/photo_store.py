"""Photographs with known viewpoints as a view store: cut to a box, made square, in one size.

    annotated photographs ─► crops ─► view store

A photograph has no mask, so its alpha is 1 throughout; what lies beyond its edges is painted in one colour.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath
from typing import Any, Protocol

import numpy as np
import pandas as pd
from PIL import ImageOps

from viewnet.config import CATEGORIES, known
from viewnet.data.crop import Box, Crop, cut
from viewnet.data.readers.pascal3d import tally
from viewnet.data.store import ViewStore, write_store
from viewnet.errors import ViewnetError
from viewnet.runtime.files import read_csv
from viewnet.runtime.image_files import opened
from viewnet.runtime.parallel import cores
from viewnet.runtime.progress import bar

VERSION = 1
"""Raise it when a change alters how photographs are cut: it is part of every store's identity."""
LIST = "viewpoints.csv"
"""What a folder of photographs says about them, see `read_folder`."""
SPLITS = ("val", "test")
"""Photographs on which viewpoints are calibrated, and which are scored."""

_CORNERS = ("x0", "y0", "x1", "y1")


class Photograph(Protocol):
    """What is needed of a photograph; viewnet.data.readers.pascal3d.Annotation is one, Listed another."""

    @property
    def id(self) -> str:
        """Unique among the photographs of a category."""

    @property
    def category(self) -> str:
        """What it shows: one of viewnet.config.CATEGORIES."""

    @property
    def split(self) -> str:
        """Which part of the data set: "val" to calibrate, "test" to score, or as the data set calls it."""

    @property
    def image_path(self) -> Path:
        """Its file."""

    @property
    def box(self) -> Box | None:
        """The object's edges in pixels; None for the whole image."""

    @property
    def azimuth(self) -> float:
        """Degrees, see viewnet.geometry."""

    @property
    def elevation(self) -> float:
        """Degrees above the horizon."""


@dataclass(frozen=True)
class Listed:
    """A row of a folder's list: see `read_folder`."""

    id: str
    category: str
    split: str
    image_path: Path
    box: Box | None
    azimuth: float
    elevation: float


def photo_store(
    photographs: Sequence[Photograph],
    folder: Path,
    crop: Crop,
    made_by: dict[str, Any],
    root: Path,
    splits: dict[str, str] | None = None,
    rejected: Iterable[tuple[str, str, str]] = (),
    upright: bool = False,
    workers: int | None = None,
    progress: bool = False,
) -> ViewStore:
    """Cut photographs of the data set at `root` into a view store, one view each, and open it.

    `made_by` describes where they come from (JSON values). `splits` renames splits, say {"train": "val", "val":
    "test"}: what another data set trains on is what viewpoints are calibrated on here. With `upright`, images are
    turned as their camera says before they are cut. Images that cannot be decoded, boxes outside of them, and
    images to calibrate on whose very bytes are scored on too join `rejected` with their reason.

    Raises ViewnetError where one file is in both splits, or a split has no usable photograph.
    """
    renamed = [(splits or {}).get(photograph.split, photograph.split) for photograph in photographs]
    _check_apart(photographs, renamed)
    refused = list(rejected)

    def attempt(photograph: Photograph) -> tuple[np.ndarray, bytes] | ViewnetError:
        try:
            return _decoded(photograph, crop, upright)
        except ViewnetError as error:
            return error

    # Decoding and resizing happen outside of the interpreter, so threads do.
    with ThreadPoolExecutor(workers or cores()) as pool:
        results = list(
            bar(
                progress,
                iterable=pool.map(attempt, photographs),
                total=len(photographs),
                desc="photographs",
                unit="image",
            )
        )
    scored = {r[1] for r, split in zip(results, renamed, strict=True) if split == "test" and isinstance(r, tuple)}
    kept: list[tuple[Photograph, str, np.ndarray]] = []
    for photograph, split, result in zip(photographs, renamed, results, strict=True):
        if isinstance(result, ViewnetError):
            refused.append((photograph.id, _within(photograph.image_path, root), str(result)))
        elif split == "val" and result[1] in scored:
            reason = "image to calibrate on that is scored on under another name"
            refused.append((photograph.id, _within(photograph.image_path, root), reason))
        else:
            kept.append((photograph, split, result[0]))
    for name in SPLITS:
        if not any(split == name for _, split, _ in kept):
            told = f" (the first that was left out: {refused[0][1]}: {refused[0][2]})" if refused else ""
            raise ViewnetError(f"{root}: no usable photograph in the {name} split{told}")
    kept.sort(key=lambda item: item[0].id)
    index = pd.DataFrame(
        {
            "model_id": [photograph.id for photograph, _, _ in kept],
            "category": [photograph.category for photograph, _, _ in kept],
            "split": [split for _, split, _ in kept],
            "view": np.zeros(len(kept), dtype=np.int64),
            "azimuth": [photograph.azimuth % 360 % 360 for photograph, _, _ in kept],
            "elevation": [float(photograph.elevation) for photograph, _, _ in kept],
            "source": [_within(photograph.image_path, root) for photograph, _, _ in kept],
        }
    )
    return write_store(folder, _batches([pixels for _, _, pixels in kept]), index, made_by, refused)


def summary(store: ViewStore) -> str:
    """What a store of photographs holds and what it leaves out, in a line for under a table.

    For example "car: 308 calibrate, 605 scored; left out: 12 only coarsely annotated, 1 image does not decode".
    """
    counts = store.index["split"].value_counts()
    told = f"{store.index['category'].iloc[0]}: {counts.get('val', 0)} calibrate, {counts.get('test', 0)} scored"
    for title, reasons in (
        ("left out", tally(store.rejected["reason"])),
        ("mended", store.meta["made_by"].get("mended", {})),
    ):
        if reasons:
            told += f"; {title}: " + ", ".join(f"{count} {reason}" for reason, count in sorted(reasons.items()))
    return told


def read_folder(root: Path, category: str) -> list[Listed]:
    """The photographs in `<root>/images` that `<root>/viewpoints.csv` lists, one object a row.

    Columns: file, azimuth_deg, elevation_deg, split (val: viewpoints are calibrated on it; test: scored), and x0, y0,
    x1, y1, the edges of the object's box in pixels from the upright image's left upper corner, unless an image
    shows just the object. All other columns are ignored. A file may have several rows, one for each object.

    Raises ViewnetError for a missing list, column or value, naming the row (the first after the header is 1).
    """
    known(category, CATEGORIES, "category")
    path = Path(root) / LIST
    frame = read_csv(path, dtype={"file": str, "split": str})
    boxed = any(name in frame.columns for name in _CORNERS)
    for name in ("file", "azimuth_deg", "elevation_deg", "split", *(_CORNERS if boxed else ())):
        if name not in frame.columns:
            raise ViewnetError(f"{path}: column {name!r} is missing")
    if frame.empty:
        raise ViewnetError(f"{path}: lists no photograph")
    found: list[Listed] = []
    times: dict[str, int] = {}
    for number, row in enumerate(frame.to_dict("records"), start=1):
        where = f"{path}: row {number}"
        file, split = str(row["file"]), row["split"]
        if not isinstance(row["file"], str) or PurePath(file).is_absolute() or ".." in PurePath(file).parts:
            raise ViewnetError(f"{where}: file {row['file']!r}: expected the name of an image in images/")
        if split not in SPLITS:
            raise ViewnetError(f"{where}: split {split!r}: expected val (calibrated on) or test (scored)")
        azimuth, elevation = (_value(row, name, where) for name in ("azimuth_deg", "elevation_deg"))
        if abs(elevation) > 90:
            raise ViewnetError(f"{where}: elevation_deg {elevation:g}: expected -90 to 90")
        box = None
        if boxed and not all(pd.isna(row[name]) for name in _CORNERS):
            x0, y0, x1, y1 = (_value(row, name, where) for name in _CORNERS)
            box = (x0, y0, x1, y1)
        again = times[file] = times.get(file, -1) + 1
        name = f"{file}/{again}" if again else file
        found.append(Listed(name, category, split, Path(root) / "images" / file, box, azimuth % 360, elevation))
    return found


def folder_digest(root: Path) -> str:
    """What a folder's photographs depend on: its list, and as a cheap sign of a changed image, its size."""
    hashed = hashlib.sha256((Path(root) / LIST).read_bytes())
    for path in sorted((Path(root) / "images").rglob("*")):
        if path.is_file():
            hashed.update(json.dumps([path.relative_to(root).as_posix(), path.stat().st_size]).encode())
    return hashed.hexdigest()


def described(crop: Crop) -> dict[str, Any]:
    """What of the cutting decides the pixels, as JSON values."""
    return {"version": VERSION, **asdict(crop), "colour": list(crop.colour)}


def _value(row: dict[Any, Any], name: str, where: str) -> float:
    try:
        value = float(row[name])
    except (TypeError, ValueError):
        value = np.nan
    if not np.isfinite(value):
        raise ViewnetError(f"{where}: {name} {row[name]!r}: expected a number")
    return value


def _check_apart(photographs: Sequence[Photograph], splits: Sequence[str]) -> None:
    """Raise where a file is in both splits."""
    seen: dict[Path, str] = {}
    for photograph, split in zip(photographs, splits, strict=True):
        if seen.setdefault(photograph.image_path, split) != split:
            raise ViewnetError(
                f"{photograph.image_path}: is both calibrated on and scored: list it in one split, as the score would be"
                " of an image that has been seen"
            )


def _decoded(photograph: Photograph, crop: Crop, upright: bool) -> tuple[np.ndarray, bytes]:
    """The crop, and a digest of the image's bytes."""
    try:
        content = photograph.image_path.read_bytes()
    except FileNotFoundError:
        raise ViewnetError("no such image") from None
    except (OSError, ValueError) as error:
        raise ViewnetError(f"image cannot be read ({type(error).__name__})") from None
    with opened(io.BytesIO(content)) as image:
        image.load()
        turned = ImageOps.exif_transpose(image) if upright else image.copy()
    return cut(turned, photograph.box, crop), hashlib.sha256(content).digest()


def _within(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix()


def _batches(crops: Sequence[np.ndarray], size: int = 256) -> Iterator[np.ndarray]:
    for start in range(0, len(crops), size):
        yield np.stack(crops[start : start + size])
