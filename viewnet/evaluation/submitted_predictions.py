"""Predictions that another program wrote, as parquet or CSV: read, and held against the images they are of.

A row is an image. Its columns are those that `Predictions.to_parquet` writes:

    category, model_id, view    which image, as in a view store's index
    h0_x h0_y h0_z              a unit view vector in the method's own frame; h1_x and so on for further hypotheses
    logit_0, logit_1 ...        the largest names the hypothesis that counts; needed where there are several
    up0_x up0_y up0_z ...       unit up vectors, of methods that tell a camera's roll
    split, azimuth, elevation   are not needed; where they are there they must be the store's

A file may hold several categories.

>>> import tempfile
>>> ids = pd.DataFrame({"model_id": "a", "category": "car", "split": ["val", "test"], "view": [0, 1],
...                     "azimuth": [0.0, 90.0], "elevation": 0.0})
>>> with tempfile.TemporaryDirectory() as folder:
...     path = Path(folder, "mine.csv")
...     _ = path.write_text("category,model_id,view,h0_x,h0_y,h0_z\\ncar,a,1,0,1,0\\ncar,a,0,1,0,0\\n")
...     read(path, ids).selected
array([[1., 0., 0.],
       [0., 1., 0.]])
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import UNIT_TOLERANCE, Floats, Predictions

IMAGE = ["category", "model_id", "view"]
ANGLE_TOLERANCE = 0.01
"""Degrees by which a file's angles may differ from the store's: it may have rounded them."""


def read(path: Path | str, ids: pd.DataFrame) -> Predictions:
    """What a file says of the images `ids` (predictions.ID_COLUMNS), which are of one category, in their order.

    Rows of other categories are left alone; of this one every image must be there once, and no other. True angles are
    taken from `ids`. Raises ViewnetError naming the file and the first row at fault (1 is the first below a header).
    """
    path = Path(path)
    frame = _frame(path)
    for name in (*IMAGE, "h0_x"):
        if name not in frame.columns:
            raise ViewnetError(f"{path}: column {name!r} is missing: expected {', '.join(IMAGE)}, h0_x, h0_y, h0_z")
    _check_text(path, frame, ("category", "model_id"))
    category = ids["category"].iloc[0]
    frame = frame[frame["category"] == category]
    if frame.empty:
        raise ViewnetError(f"{path}: no row of category {category}")
    rows = _matched(path, frame, ids)
    _check_angles(path, frame, ids.iloc[rows])
    heads = sum(name.startswith("h") and name.endswith("_x") and name[1:-2].isdigit() for name in frame.columns)
    hypotheses = _vectors(path, frame, [f"h{m}" for m in range(heads)])
    ups = _vectors(path, frame, [f"up{m}" for m in range(heads)]) if "up0_x" in frame.columns else None
    named = heads > 1 or "logit_0" in frame.columns
    logits = np.stack([_numbers(path, frame, f"logit_{m}") for m in range(heads)], axis=1) if named else None
    order = np.argsort(rows)
    return Predictions(
        ids,
        hypotheses[order],
        np.zeros((len(ids), 1)) if logits is None else logits[order],
        None if ups is None else ups[order],
    )


def _frame(path: Path) -> pd.DataFrame:
    """The file's rows, numbered from 1."""
    if path.suffix not in _READERS:
        raise ViewnetError(f"{path}: expected a file of predictions, {' or '.join(_READERS)}")
    try:
        frame = _READERS[path.suffix](path)
    except FileNotFoundError:
        raise ViewnetError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # the readers' own errors are ValueErrors
        raise ViewnetError(f"{path}: not a readable {path.suffix[1:]} file ({type(error).__name__})") from error
    return frame.set_axis(pd.RangeIndex(1, len(frame) + 1))


_READERS: dict[str, Callable[[Path], pd.DataFrame]] = {
    ".parquet": pd.read_parquet,
    ".csv": lambda path: pd.read_csv(path, dtype=str, keep_default_na=False),  # as text ids keep their zeros
}


def _check_text(path: Path, frame: pd.DataFrame, names: tuple[str, ...]) -> None:
    for name in names:
        text = frame[name].map(lambda value: isinstance(value, str)).to_numpy(dtype=bool)
        if not text.all():
            row = frame.index[~text][0]
            raise ViewnetError(f"{path}: row {row}: {name} {frame.at[row, name]} is no text: write ids as text")


def _numbers(path: Path, frame: pd.DataFrame, name: str) -> Floats:
    """A column (N,) of finite numbers."""
    if name not in frame.columns:
        raise ViewnetError(f"{path}: column {name!r} is missing")
    values = np.array(pd.to_numeric(frame[name], errors="coerce"), dtype=np.float64)
    if not (finite := np.isfinite(values)).all():
        row = frame.index[~finite][0]
        raise ViewnetError(f"{path}: row {row}: {name} is {str(frame.at[row, name])!r}: expected a finite number")
    return values


def _vectors(path: Path, frame: pd.DataFrame, names: list[str]) -> Floats:
    """Unit vectors (N, M, 3) of the columns <name>_x, <name>_y and <name>_z."""
    found = []
    for name in names:
        vectors = np.stack([_numbers(path, frame, f"{name}_{axis}") for axis in "xyz"], axis=1)
        lengths = np.linalg.norm(vectors, axis=1)
        if (off := np.abs(lengths - 1) > UNIT_TOLERANCE).any():
            row = frame.index[off][0]
            raise ViewnetError(f"{path}: row {row}: {name} has length {lengths[off][0]:g}: expected a unit vector")
        found.append(vectors)
    return np.stack(found, axis=1)


def _matched(path: Path, frame: pd.DataFrame, ids: pd.DataFrame) -> np.ndarray:
    """Which row of `ids` each row of the file is of; ViewnetError unless it has each of them once and no other."""
    views = _numbers(path, frame, "view")
    wanted = pd.MultiIndex.from_frame(ids[["model_id", "view"]])
    given = pd.MultiIndex.from_arrays([frame["model_id"], views])
    rows = wanted.get_indexer(given)
    category = ids["category"].iloc[0]
    for bad, problem in ((rows < 0, "is not among the images to calibrate on and to score"),
                         (given.duplicated(), "is there twice")):  # fmt: skip
        if bad.any():
            at = int(np.flatnonzero(bad)[0])
            image = f"view {views[at]:g} of {category} {frame['model_id'].iloc[at]}"
            raise ViewnetError(f"{path}: row {frame.index[at]}: {image} {problem}")
    if len(rows) < len(ids):
        left = np.setdiff1d(np.arange(len(ids)), rows)
        model, view = wanted[left[0]]
        raise ViewnetError(
            f"{path}: no row for view {view} of {category} {model} ({len(left)} of {len(ids)} are missing)"
        )
    return rows


def _check_angles(path: Path, frame: pd.DataFrame, ids: pd.DataFrame) -> None:
    """What a file says of split and truth must be so, else it is of other images."""
    for name in ("split", "azimuth", "elevation"):
        if name not in frame.columns:
            continue
        if name == "split":
            off = frame[name].to_numpy() != ids[name].to_numpy()
        else:
            away = np.abs(_numbers(path, frame, name) - ids[name].to_numpy())
            off = (np.minimum(away, 360 - away) if name == "azimuth" else away) > ANGLE_TOLERANCE
        if off.any():
            at = int(np.flatnonzero(off)[0])
            raise ViewnetError(
                f"{path}: row {frame.index[at]}: {name} is {frame[name].iloc[at]}, but that image's is"
                f" {ids[name].iloc[at]}: the file was made for other images"
            )
