"""The metrics that tables have columns of: headings and digits, in one place for text, LaTeX and the overview page."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

HEADLINE = ("acc30", "median")
"""The two metrics of the paper's tables."""
FIDELITY = ("psnr", "ssim", "iou")
"""The metrics of rendered novel views against the test views."""
DASH = "--"
"""Stands where nothing was reported or measured."""


class Column(NamedTuple):
    """A metric: heading as plain text, in LaTeX (short) and on the page (in full), digits in LaTeX and on the page."""

    name: str
    latex: str
    page: str
    digits: int = 1
    page_digits: int = 1


COLUMNS = {
    "acc30": Column(
        "acc@30, %", r"Accuracy (\%) $\uparrow$",
        "Accuracy within 30°, % (higher is better)", digits=0),
    "median": Column(
        "median, degrees", r"Median error ($^\circ$) $\downarrow$",
        "Median error, degrees (lower is better)"),
    "dva": Column(
        "DVA, %", r"Discretized viewpoint accuracy (\%) $\uparrow$",
        "Discretized viewpoint accuracy (DVA), % (higher is better)", digits=0),
    "confidence_index": Column(
        "confidence index", "",
        "Confidence index: share of azimuth bins with more than ten photographs", 2, 2),
    "psnr": Column("PSNR, dB", r"PSNR (dB) $\uparrow$", "PSNR of novel views, dB (higher is better)"),
    "ssim": Column("SSIM", r"SSIM $\uparrow$", "SSIM of novel views (higher is better)", 3, 3),
    "iou": Column("mask IoU", r"IoU $\uparrow$", "IoU of masks of novel views (higher is better)", 3, 3),
    "consistency_acc30": Column(
        "consistent within 30, %", r"acc (\%) $\uparrow$",
        "Rendered views whose viewpoint the model's own network predicts within 30°, %"),
    "consistency_median": Column(
        "inconsistency, median degrees", r"med ($^\circ$) $\downarrow$",
        "Error of the model's own network on rendered views, median degrees"),
    "judged_acc30": Column(
        "judged consistent within 30, %", r"judged acc (\%) $\uparrow$",
        "Rendered views whose viewpoint ViewNet's network predicts within 30°, %"),
    "judged_median": Column(
        "judged inconsistency, median degrees", r"judged med ($^\circ$) $\downarrow$",
        "Error of ViewNet's network on rendered views, median degrees"),
}  # fmt: skip
"""Metric -> its column. The digits in LaTeX are those the paper has."""
NOVEL_VIEWS = tuple(list(COLUMNS)[4:])
"""The metrics of novel views (viewnet.tables.novel_view_scores)."""


def lower_is_better(metric: str) -> bool:
    """Whether a metric is an error."""
    return metric.endswith("median")


def text(value: float, metric: str) -> str:
    """A number with the digits that the paper has, -- for NaN."""
    return DASH if math.isnan(value) else f"{value:.{COLUMNS[metric].digits}f}"


def names(metrics: Iterable[str]) -> dict[str, str]:
    """Metric -> heading as plain text."""
    return {metric: COLUMNS[metric].name for metric in metrics}
