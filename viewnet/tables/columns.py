"""Columns of tables, one a metric: headings and digits for text, LaTeX and the overview page; and measured cells."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

HEADLINE = ("acc30", "median")
"""The two metrics of the paper's tables."""
FIDELITY = ("psnr", "ssim", "iou")
"""The metrics of rendered novel views against the test views."""
NOVEL_VIEWS = (
    *FIDELITY, "consistency_acc30", "consistency_median", "judged_acc30", "judged_median",
    "reconstructing_acc30", "misled",
)  # fmt: skip
"""The metrics of novel views, from left to right (viewnet.tables.novel_view_scores)."""
DASH = "--"
"""Stands where nothing was reported or measured."""


class Column(NamedTuple):
    """A metric: heading as plain text, in LaTeX (short) and on the page (in full), and how its numbers are shown."""

    name: str
    latex: str
    page: str
    digits: int = 1  # in text and LaTeX: those the paper has
    page_digits: int = 1
    lower_is_better: bool = False


METRICS = {
    "acc30": Column("acc@30, %", r"Accuracy (\%) $\uparrow$", "Accuracy within 30°, % (higher is better)", digits=0),
    "median": Column("median, degrees", r"Median error ($^\circ$) $\downarrow$",
        "Median error, degrees (lower is better)", lower_is_better=True),
    "flips": Column("half turns, %", r"Half turns (\%) $\downarrow$",
        "Views off by more than 150°, % (lower is better)", lower_is_better=True),
    "dva": Column("DVA, %", r"Discretized viewpoint accuracy (\%) $\uparrow$",
        "Discretized viewpoint accuracy (DVA), % (higher is better)", digits=0),
    "confidence_index": Column("confidence index", "",
        "Confidence index: share of azimuth bins with more than ten photographs", 2, 2),
    "psnr": Column("PSNR, dB", r"PSNR (dB) $\uparrow$", "PSNR of novel views, dB (higher is better)"),
    "ssim": Column("SSIM", r"SSIM $\uparrow$", "SSIM of novel views (higher is better)", 3, 3),
    "iou": Column("mask IoU", r"IoU $\uparrow$", "IoU of masks of novel views (higher is better)", 3, 3),
    "consistency_acc30": Column("consistent within 30, %", r"acc (\%) $\uparrow$",
        "Rendered views whose viewpoint the model's own network predicts within 30°, %"),
    "consistency_median": Column("inconsistency, median degrees", r"med ($^\circ$) $\downarrow$",
        "Error of the model's own network on rendered views, median degrees", lower_is_better=True),
    "judged_acc30": Column("judged consistent within 30, %", r"judged acc (\%) $\uparrow$",
        "Rendered views whose viewpoint ViewNet's network predicts within 30°, %"),
    "judged_median": Column("judged inconsistency, median degrees", r"judged med ($^\circ$) $\downarrow$",
        "Error of ViewNet's network on rendered views, median degrees", lower_is_better=True),
    "reconstructing_acc30": Column("best reconstructing hypothesis within 30, %", r"best rec.\ acc (\%) $\uparrow$",
        "Views whose hypothesis that reconstructs them best is within 30°, %"),
    "misled": Column("misled by reconstruction, %", r"misled (\%) $\downarrow$",
        "Views that another hypothesis than the closest reconstructs best, %", lower_is_better=True),
}  # fmt: skip
"""Metric -> its column."""


def column_of(metric: str) -> Column:
    """The column of a metric; one that is not in METRICS, as a file of another version may have, is headed by name."""
    return METRICS.get(metric) or Column(metric, metric, metric, 2, 2)


def text(value: float, metric: str, degenerate: float = 0) -> str:
    """A number with the digits that the paper has, -- for NaN; in brackets where alignments are `degenerate`."""
    number = DASH if math.isnan(value) else f"{value:.{METRICS[metric].digits}f}"
    return f"({number})" if degenerate else number


Key = tuple[str, str, str]
"""Row, category and metric of a cell."""
UNMEASURED: dict[str, Any] = {
    **dict.fromkeys(("measured", "sd", "low", "high"), math.nan),
    **dict.fromkeys(("seeds", "images", "objects", "degenerate"), 0),
}


def measured(
    values: Sequence[float], interval: tuple[float, float] | None, objects: Sequence[np.ndarray]
) -> dict[str, Any]:
    """The measured part of a cell, keys as UNMEASURED: mean and standard deviation over seeds, interval, counts.

    `values` has a number and `objects` an array (N,) of object names for each seed.
    """
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else math.nan
    numbers = (float(np.mean(values)), spread, *(interval or (math.nan, math.nan)))
    return dict(zip(UNMEASURED, (*numbers, len(objects), len(objects[0]), len(set(objects[0])), 0), strict=True))


def upper_bound(supervision: str) -> bool:
    """Whether a row learns from viewpoints, which the others are not told: it stands apart, below a rule."""
    return supervision.startswith(("absolute viewpoints", "relative rotations"))


def best(cells: pd.DataFrame, digits: Callable[[str], int]) -> set[Key]:
    """The best measured cells of each column when rounded to `digits`, ties included; none in a column of one.

    Those of degenerate alignments and of upper bounds are not among them.
    """
    keys: set[Key] = set()
    scores = cells.dropna(subset="measured")
    scores = scores[(scores["degenerate"] == 0) & ~scores["supervision"].map(upper_bound)]
    for (category, metric), column in scores.groupby(["category", "metric"]):
        rounded = column["measured"].astype(float).round(digits(metric))
        if len(rounded) > 1:
            top = rounded.min() if column_of(metric).lower_is_better else rounded.max()
            keys |= {(row, category, metric) for row in column.loc[rounded == top, "row"]}
    return keys


def by_key(cells: pd.DataFrame) -> dict[Key, dict[str, Any]]:
    """(row, category, metric) -> cell."""
    return {(cell["row"], cell["category"], cell["metric"]): cell for cell in cells.to_dict("records")}
