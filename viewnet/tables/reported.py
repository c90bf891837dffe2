"""The numbers that the paper reports, as data (`paper_tables/published/*.csv`), apart from the measured ones."""

from pathlib import Path

import pandas as pd

from viewnet import paths
from viewnet.config import known
from viewnet.runtime.files import read_csv
from viewnet.tables.layouts import LAYOUTS

TABLES = tuple(name for name, layout in LAYOUTS.items() if layout.reported)
"""Each has a file of its name."""


def folder() -> Path:
    """The folder of the files: under the project's root, else in the checkout that contains this package."""
    return paths.part("paper_tables", "published")


def load(table: str) -> pd.DataFrame:
    """A table of the paper, a line per number: `row` is the paper's label, `value` its text, "" where it has a dash.

    Metrics are acc30 and dva (per cent), median (degrees) and confidence_index. ViewnetError for a missing column.
    """
    path = folder() / f"{known(table, TABLES, 'table')}.csv"
    columns = ("row", "metric", "category", "value", "bold", "source", "note")  # how it was measured, if not as ours
    frame = read_csv(path, columns, dtype=str, keep_default_na=False)
    return frame.assign(bold=frame["bold"] == "1")  # values stay text, with the digits of the paper


def notes(table: str) -> list[str]:
    """How the numbers of a table of the paper were measured otherwise than ours, a line for the rows of each note."""
    numbers, labels = load(table), {row: label for label, row in LAYOUTS[table].reported_as.items()}
    groups = numbers["row"].replace(labels).groupby(numbers["note"], sort=False)
    return [f"reported for {'; '.join(dict.fromkeys(rows))}: {note}" for note, rows in groups if note]


def architecture(part: str) -> pd.DataFrame:
    """The supplement's table of the "encoder" or the "generator", a line a layer. ViewnetError for a missing column."""
    known(part, ("encoder", "generator"), "part")  # the supplement has no other
    columns = ("part", "layer", "channels", "kernel", "stride")
    frame = read_csv(folder() / "architecture.csv", columns, dtype=str, keep_default_na=False)
    return frame[frame["part"] == part].drop(columns="part").reset_index(drop=True)
