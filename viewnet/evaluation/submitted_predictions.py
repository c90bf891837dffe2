"""Predictions that another program wrote, as parquet or CSV, checked against the images they are for.

A row is an image. Its columns are those that `Predictions.to_parquet` writes:

    category, model_id, view    the image, as in a view store's index
    h0_x h0_y h0_z              a unit view vector in the method's own frame; h1_x and so on for further hypotheses
    logit_0, logit_1 ...        the hypothesis of the largest is the prediction; required where there are several
    up0_x up0_y up0_z ...       unit up vectors, of methods that predict in-plane rotation
    split, azimuth, elevation   optional; where present they must be the store's

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

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import UNIT_TOLERANCE, Floats, Predictions, read_parquet
from viewnet.runtime.lists import read_list

IMAGE = ["category", "model_id", "view"]
ANGLE_TOLERANCE = 0.01  # degrees by which a file's angles may differ from the store's: it may have rounded them


def read(path: Path | str, ids: pd.DataFrame) -> Predictions:
    """A file's predictions for the images `ids` (predictions.ID_COLUMNS), which are of one category, in their order.

    Rows of other categories are ignored; of this one every image must appear once, and no other. True angles are taken
    from `ids`. Raises ViewnetError naming the file and the first row at fault (1 is the first below a header).
    """
    frame = _frame(path := Path(path))
    if missing := [name for name in (*IMAGE, "h0_x") if name not in frame.columns]:
        raise ViewnetError(f"{path}: column {missing[0]!r} is missing: expected {', '.join(IMAGE)}, h0_x, h0_y, h0_z")
    for name in ("category", "model_id"):
        others = frame[name].map(lambda value: not isinstance(value, str)).to_numpy(dtype=bool)  # (N,)
        if (row := _first(frame, others)) is not None:
            raise ViewnetError(f"{path}: row {row}: {name} {frame.at[row, name]} is no text: write ids as text")
    category = ids["category"].iloc[0]
    frame = frame[frame["category"] == category]  # one file may be for several tables
    if frame.empty:
        raise ViewnetError(f"{path}: no row of category {category}")
    rows = _matched(path, frame, ids)  # (N,)
    _check_truth(path, frame, ids.iloc[rows])
    heads = sum(name.startswith("h") and name.endswith("_x") and name[1:-2].isdigit() for name in frame.columns)
    kinds = ["h{}_x", "h{}_y", "h{}_z"] + (["up{}_x", "up{}_y", "up{}_z"] if "up0_x" in frame.columns else [])
    if heads > 1 or "logit_0" in frame.columns:
        kinds.append("logit_{}")
    names = [kind.format(m) for m in range(heads) for kind in kinds]
    numbers = pd.DataFrame({"logit_0": 0.0} | {name: _numbers(path, frame, name) for name in names}, frame.index)
    _check_units(path, numbers)
    in_order = numbers.iloc[np.argsort(rows)].reset_index(drop=True)
    return Predictions.from_frame(pd.concat([ids.reset_index(drop=True), in_order], axis=1))


def _frame(path: Path) -> pd.DataFrame:
    """The file's rows, numbered from 1."""
    if path.suffix not in (".parquet", ".csv"):
        raise ViewnetError(f"{path}: expected a file of predictions, .parquet or .csv")
    if path.suffix == ".csv":
        frame = read_list(path, (*IMAGE, "h0_x"), lambda name: name not in ("category", "model_id", "split"))
    else:
        frame = read_parquet(path)
    return frame.set_axis(pd.RangeIndex(1, len(frame) + 1))  # as a reader of the file counts them


def _first(frame: pd.DataFrame, mask: NDArray[np.bool_]) -> int | None:
    """The number of the first row of a mask (N,), None for an empty one."""
    return int(frame.index[mask][0]) if mask.any() else None


def _numbers(path: Path, frame: pd.DataFrame, name: str) -> Floats:
    """A column (N,) of finite numbers."""
    if name not in frame.columns:
        raise ViewnetError(f"{path}: column {name!r} is missing")
    values = np.array(pd.to_numeric(frame[name], errors="coerce"), dtype=np.float64)  # what is no number becomes NaN
    if (row := _first(frame, ~np.isfinite(values))) is not None:
        raise ViewnetError(f"{path}: row {row}: {name} is {str(frame.at[row, name])!r}: expected a finite number")
    return values


def _check_units(path: Path, numbers: pd.DataFrame) -> None:
    """ViewnetError for the first vector, the columns <name>_x, <name>_y and <name>_z, that is no unit vector."""
    for name in [column.removesuffix("_x") for column in numbers.columns if column.endswith("_x")]:
        lengths = np.linalg.norm(numbers[[f"{name}_{axis}" for axis in "xyz"]], axis=1)  # (N,)
        wrong = np.abs(lengths - 1) > UNIT_TOLERANCE  # (N,)
        if (row := _first(numbers, wrong)) is not None:
            raise ViewnetError(f"{path}: row {row}: {name} has length {lengths[wrong][0]:g}: expected a unit vector")


def _matched(path: Path, frame: pd.DataFrame, ids: pd.DataFrame) -> NDArray[np.intp]:
    """The position in `ids` of each row of the file; ViewnetError unless it has each image once and no other."""
    views, category = _numbers(path, frame, "view"), ids["category"].iloc[0]
    expected = pd.MultiIndex.from_frame(ids[["model_id", "view"]])
    submitted = pd.MultiIndex.from_arrays([frame["model_id"], views])
    rows = expected.get_indexer(submitted)  # (N,), -1 where there is no such image
    unknown, twice = "is not among the images to calibrate on and to score", "appears twice"
    for wrong, problem in ((rows < 0, unknown), (submitted.duplicated(), twice)):
        if (row := _first(frame, wrong)) is not None:
            image = f"view {views[wrong][0]:g} of {category} {frame.at[row, 'model_id']}"
            raise ViewnetError(f"{path}: row {row}: {image} {problem}")
    if len(rows) < len(ids):
        missing = np.setdiff1d(np.arange(len(ids)), rows)
        (model, view), count = expected[missing[0]], f"{len(missing)} of {len(ids)}"
        raise ViewnetError(f"{path}: no row for view {view} of {category} {model} ({count} are missing)")
    return rows


def _check_truth(path: Path, frame: pd.DataFrame, ids: pd.DataFrame) -> None:
    """ViewnetError where a file's splits or true angles are not the store's: it was made for other images."""
    for name in [name for name in ("split", "azimuth", "elevation") if name in frame.columns]:
        if name == "split":
            wrong = frame[name].to_numpy() != ids[name].to_numpy()
        else:
            away = np.abs(_numbers(path, frame, name) - ids[name].to_numpy())
            wrong = (np.minimum(away, 360 - away) if name == "azimuth" else away) > ANGLE_TOLERANCE
        if (row := _first(frame, wrong)) is not None:
            known = f"but that image's is {ids[name].to_numpy()[wrong][0]}: the file was made for other images"
            raise ViewnetError(f"{path}: row {row}: {name} is {frame.at[row, name]}, {known}")
