"""The numbers that the paper reports, as data (`paper_tables/published/*.csv`), apart from the measured ones."""

from pathlib import Path

import pandas as pd

from viewnet import paths
from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.runtime.files import read_csv
from viewnet.tables.layouts import LAYOUTS

TABLES = tuple(name for name, layout in LAYOUTS.items() if layout.reported)
"""Each has a file of its name."""
COLUMNS = ("row", "metric", "category", "value", "bold", "source")


def folder() -> Path:
    """The folder of the files: under the project's root, else in the checkout that contains this package."""
    return paths.part("paper_tables", "published")


def load(table: str) -> pd.DataFrame:
    """A table of the paper, a line per number: `row` is the paper's label, `value` its text, "" where it has a dash.

    Metrics are acc30 and dva (per cent), median (degrees) and confidence_index. ViewnetError for other columns.
    """
    path = folder() / f"{known(table, TABLES, 'table')}.csv"
    frame = read_csv(path, dtype=str, keep_default_na=False)
    if tuple(frame.columns) != COLUMNS:
        raise ViewnetError(f"{path}: columns are {', '.join(frame.columns)}, expected {', '.join(COLUMNS)}")
    return frame.assign(bold=frame["bold"] == "1")  # values stay text, with the digits of the paper


def none() -> pd.DataFrame:
    """As `load`, of a table that is not in the paper."""
    return pd.DataFrame(columns=COLUMNS)  # so that such a table is made like the others


def architecture(part: str) -> pd.DataFrame:
    """The supplement's table of the "encoder" or the "generator", a line a layer. ViewnetError for a missing column."""
    known(part, ("encoder", "generator"), "part")  # the supplement has no other
    path = folder() / "architecture.csv"
    frame = read_csv(path, dtype=str, keep_default_na=False)
    if missing := [name for name in ("part", "layer", "channels", "kernel", "stride") if name not in frame.columns]:
        raise ViewnetError(f"{path}: column {missing[0]!r} is missing")
    return frame[frame["part"] == part].drop(columns="part").reset_index(drop=True)
