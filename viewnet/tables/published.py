"""The numbers the paper prints, as data (`paper_tables/published/*.csv`), never mixed with measured ones."""

from __future__ import annotations

import math
from pathlib import Path

import pandas as pd

from viewnet import paths
from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.runtime.files import read_csv

TABLES = ("table1_shapenet", "table2_ablation", "table3_pascal3d", "table4_dva", "table5_freiburg", "objectron")
DIGITS = {"acc30": 0, "median": 1, "dva": 0, "confidence_index": 2}
"""After the point, as the paper prints each metric."""
DASH = "--"
"""What stands where nothing was printed or measured."""
COLUMNS = ("row", "metric", "category", "value", "bold", "source")


def folder() -> Path:
    """Where the files are: under the project's root, else in the checkout this package lies in."""
    return paths.part("paper_tables", "published")


def load(table: str) -> pd.DataFrame:
    """A printed table, one row a number: row (as printed), metric (acc30 in %, median in degrees, dva in %,
    confidence_index), category, value (the text as printed; "" where the paper has a dash), bold, source. Raises
    ViewnetError for a file with other columns.
    """
    path = folder() / f"{known(table, TABLES, 'table')}.csv"
    frame = read_csv(path, dtype=str, keep_default_na=False)
    if tuple(frame.columns) != COLUMNS:
        raise ViewnetError(f"{path}: columns are {', '.join(frame.columns)}, expected {', '.join(COLUMNS)}")
    return frame.assign(bold=frame["bold"] == "1")


def architecture(part: str) -> pd.DataFrame:
    """The supplement's table of the "encoder" or the "generator", a row a layer: layer, channels, kernel, stride.

    Raises ViewnetError for a file that lacks a column.
    """
    known(part, ("encoder", "generator"), "part")
    path = folder() / "architecture.csv"
    frame = read_csv(path, dtype=str, keep_default_na=False)
    if missing := [name for name in ("part", "layer", "channels", "kernel", "stride") if name not in frame.columns]:
        raise ViewnetError(f"{path}: column {missing[0]!r} is missing")
    return frame[frame["part"] == part].drop(columns="part").reset_index(drop=True)


def text(value: float, metric: str) -> str:
    """A number as the paper would print it, -- for NaN."""
    return DASH if math.isnan(value) else f"{value:.{DIGITS[metric]}f}"
