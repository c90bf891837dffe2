"""Figure 3: true against predicted azimuth, and what each head draws; and what alignment is worth on photographs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import Aligned, align
from viewnet.evaluation.predictions import Floats
from viewnet.evaluation.run import Run
from viewnet.runtime.files import replacing

STYLE: Any = {
    "font.size": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,  # TrueType: text stays text
    "svg.hashsalt": "viewnet",
}
COLUMN = 3.25  # inches: a column of the paper; the page is twice as wide and a gap
INK = "#1f4e79"
STYLES = {"none": "-", "procrustes": "-", "robust": "-.", "linear": "--", "per_angle": ":"}
AXES = {"acc30": "accuracy (%)", "median": "median error (degrees)", "dva": "DVA (%)"}


def azimuth_scatter(runs: Sequence[Run]) -> Figure:
    """Figure 3 (a)-(c): predicted azimuth after alignment over the true one, a panel for each run (category).

    ViewnetError without runs.
    """
    if not runs:
        raise ViewnetError("figure 3: no runs to show")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(2.2 * len(runs), 2.5), layout="constrained")
        for axes, run in zip(np.atleast_1d(figure.subplots(1, len(runs), sharey=True)), runs, strict=True):
            aligned = align(run.predictions, run.alignment)
            axes.plot([0, 360], [0, 360], color="0.8", linewidth=0.6, zorder=0)
            axes.scatter(*azimuths(aligned), s=2, linewidths=0, alpha=0.5, color=INK)
            axes.set_title(run.config.category)
            axes.set_xlabel("true azimuth (degrees)")
            ticks = [0, 90, 180, 270, 360]
            axes.set(xlim=(0, 360), ylim=(0, 360), xticks=ticks, yticks=ticks, aspect="equal")
        figure.axes[0].set_ylabel("predicted azimuth (degrees)")
    return figure


def azimuths(aligned: Aligned) -> tuple[Floats, Floats]:
    """True and predicted azimuths (N,), in [0, 360)."""
    predicted, _ = geometry.azimuth_elevation(torch.from_numpy(np.array(aligned.selected)))
    return aligned.predictions.ids["azimuth"].to_numpy(), predicted.numpy()


def candidate_grid(
    inputs: np.ndarray, drawings: np.ndarray, errors: np.ndarray, angles: np.ndarray, labels: Sequence[str]
) -> Figure:
    """Figure 3 (d): each row an image and what the heads draw of it, by rising reconstruction error.

    inputs (N, H, W, 3) and drawings (N, M, H, W, 3) uint8; errors (N, M) of reconstruction, angles (N, M) of viewpoint
    in degrees, both in the order of the drawings; labels (N,) beside the rows.
    """
    n, m = drawings.shape[:2]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(0.9 * (m + 1), 1.05 * n + 0.2), layout="constrained")
        grid = figure.subplots(n, m + 1, squeeze=False)
        for i in range(n):
            for j, axes in enumerate(grid[i]):
                axes.imshow(inputs[i] if j == 0 else drawings[i, j - 1], interpolation="nearest")
                axes.set(xticks=[], yticks=[])
                axes.spines[:].set_visible(False)
                if j:
                    axes.set_xlabel(f"{errors[i, j - 1]:.3f} / {angles[i, j - 1]:.0f}°", labelpad=2, fontsize=7)
            grid[i, 0].set_ylabel(labels[i])
        grid[0, 0].set_title("input", fontsize=8)
        grid[0, 1].set_title("error / angle", fontsize=8, loc="left")
    return figure


def candidates(
    runs: Sequence[Run], views: Callable[..., Any] | None = None, draw: Callable[..., Any] | None = None, count: int = 1
) -> Figure:
    """Figure 3 (d) of trained runs of the same number of heads, `count` test images of each, evenly spaced.

    `views` and `draw` stand in for viewnet.data.build.view_store and viewnet.evaluation.predict.candidates. Raises ViewnetError
    without runs, for untrained ones and for drawings of different sizes.
    """
    if views is None or draw is None:
        from viewnet.data.build import view_store
        from viewnet.evaluation.predict import candidates as drawn

        views, draw = views or view_store, draw or drawn
    parts, labels = [], []
    for run in runs:
        if not run.trained:
            raise ViewnetError(f"figure 3: {run.config.variant} draws nothing: choose a trained variant")
        aligned = align(run.predictions, run.alignment)
        rows = np.linspace(0, len(aligned.predictions) - 1, count + 2).round().astype(int)[1:-1]
        inputs, drawings, errors, heads = draw(run.folder, views(run.config.data, progress=False), rows.tolist())
        parts.append((inputs, drawings, errors, np.take_along_axis(aligned.errors[rows], heads, axis=1)))
        labels += [run.config.category] * len(rows)
    if not parts:
        raise ViewnetError("figure 3: no runs to show")
    if len(sizes := {part[1].shape[1:] for part in parts}) > 1:
        raise ViewnetError(f"figure 3: drawings of {len(sizes)} sizes cannot share a grid: show runs of one profile")
    inputs, drawings, errors, angles = (np.concatenate(column) for column in zip(*parts, strict=True))
    return candidate_grid(inputs, drawings, errors, angles, labels)


def calibration_curves(scores: pd.DataFrame, metrics: Sequence[str] = ("acc30", "median", "dva")) -> Figure:
    """Scores over the number of calibration photographs, a row a metric and a column a category.

    `scores` is viewnet.experiments.alignment_study.Study.scores: a line is the median over draws and seeds of a predictor (colour)
    by an alignment (style), the shade from the lowest to the highest. What was fitted on the photographs is shown as it
    is, without an alignment on top of that.
    """
    categories = list(dict.fromkeys(scores["category"]))
    names = list(dict.fromkeys(scores["predictor"]))
    fitted = set(scores.loc[scores["alignment"] == "none", "predictor"])
    colours = {name: f"C{i}" for i, name in enumerate(names)}
    with matplotlib.rc_context(STYLE):
        size = (2.3 * len(categories) + 1.6, 1.7 * len(metrics))
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(len(metrics), len(categories), squeeze=False, sharex=True, sharey="row")
        for (name, kind), rows in scores.groupby(["predictor", "alignment"], sort=False):
            if (name in fitted) != (kind == "none"):
                continue
            for i, metric in enumerate(metrics):
                for j, category in enumerate(categories):
                    found = rows[rows["category"] == category].groupby("images")[metric].agg(["median", "min", "max"])
                    axes, images = grid[i, j], found.index.to_numpy(dtype=float)
                    told = {"color": colours[name], "linestyle": STYLES[kind]}
                    label = name if kind == "none" else f"{name}, {kind}"
                    axes.plot(images, found["median"], linewidth=1, markersize=2, marker="o", label=label, **told)
                    axes.fill_between(images, found["min"], found["max"], color=colours[name], alpha=0.1, linewidth=0)
        for j, category in enumerate(categories):
            grid[0, j].set_title(category)
            grid[0, j].set_xscale("log", base=2)
            grid[-1, j].xaxis.set_major_formatter("{x:.0f}")
            grid[-1, j].set_xlabel("calibration photographs")
        for i, metric in enumerate(metrics):
            grid[i, 0].set_ylabel(AXES[metric])
            grid[i, 0].set_ylim(bottom=0)
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=7)
    return figure


def collapse_curves(collapse: pd.DataFrame) -> Figure:
    """What linear alignment does the more one-sided photographs are, a colour a category and a style a predictor.

    `collapse` is viewnet.experiments.alignment_study.Study.collapse. Left: how far aligned predictions are spread, as a share of
    the true viewpoints' spread. Middle and right: the accuracy and the DVA that it adds to rigid alignment, in points.
    """
    names = list(dict.fromkeys(collapse["predictor"]))
    categories = list(dict.fromkeys(collapse["category"]))
    styles = dict(zip(names, ["-", "--", ":", "-."] * len(names), strict=False))
    shown = collapse.assign(
        acc30=collapse["acc30_linear"] - collapse["acc30_rigid"], dva=collapse["dva_linear"] - collapse["dva_rigid"]
    )
    titles = {"spread_linear": "spread left", "acc30": "accuracy added, points", "dva": "DVA added, points"}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.2, 2.5), layout="constrained")
        for axes, (column, title) in zip(figure.subplots(1, 3), titles.items(), strict=True):
            axes.axhline(0, color="0.8", linewidth=0.6, zorder=0)
            for (category, name), rows in shown.groupby(["category", "predictor"], sort=False):
                means = rows.groupby("concentration")[["side", column]].mean()
                told = {"color": f"C{categories.index(category)}", "linestyle": styles[name]}
                axes.plot(means["side"], means[column], linewidth=1, markersize=2.5, marker="o",
                          label=f"{category}, {name}", **told)  # fmt: skip
            axes.set_title(title)
            axes.set_xlabel("share of the commonest 30 degrees")
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside right upper", frameon=False, fontsize=7)
    return figure


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """`<name>.png` and `<name>.pdf`, the same bytes each time."""
    files = [folder / f"{name}.png", folder / f"{name}.pdf"]
    with matplotlib.rc_context(STYLE):
        for path, metadata in zip(files, ({"Software": None}, {"CreationDate": None, "ModDate": None}), strict=True):
            with replacing(path) as temporary:
                figure.savefig(temporary, dpi=200, metadata=metadata)
    return files
