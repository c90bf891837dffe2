"""Cells of tables: a measured number with its spread and interval, and the best of each column."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from viewnet.tables.columns import lower_is_better

Key = tuple[str, str, str]
"""Row, category and metric of a cell."""
_NAN = float("nan")
UNMEASURED: dict[str, Any] = {
    "measured": _NAN, "sd": _NAN, "low": _NAN, "high": _NAN, "seeds": 0, "images": 0, "objects": 0,
}  # fmt: skip


def measured(
    values: Sequence[float], interval: tuple[float, float] | None, objects: Sequence[np.ndarray]
) -> dict[str, Any]:
    """The measured part of a cell, keys as UNMEASURED: mean and standard deviation over seeds, interval, counts.

    `values` has a number and `objects` an array (N,) of object names for each seed.
    """
    low, high = interval or (_NAN, _NAN)
    return {
        "measured": float(np.mean(values)),
        "sd": float(np.std(values, ddof=1)) if len(values) > 1 else _NAN,
        "low": low,
        "high": high,
        "seeds": len(objects),
        "images": len(objects[0]),
        "objects": len(set(objects[0])),
    }


def best(cells: pd.DataFrame, digits: Callable[[str], int]) -> set[Key]:
    """The measured cells that are the best of their column when rounded to `digits`, ties included.

    Columns with a single measured row have no best.
    """
    keys: set[Key] = set()
    for (category, metric), column in cells.dropna(subset="measured").groupby(["category", "metric"]):
        rounded = column["measured"].astype(float).round(digits(metric))
        if len(rounded) > 1:
            top = rounded.min() if lower_is_better(metric) else rounded.max()
            keys |= {(row, category, metric) for row in column.loc[rounded == top, "row"]}
    return keys


def by_key(cells: pd.DataFrame) -> dict[Key, dict[str, Any]]:
    """(row, category, metric) -> cell."""
    return {(cell["row"], cell["category"], cell["metric"]): cell for cell in cells.to_dict("records")}
