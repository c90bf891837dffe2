"""Plots: predicted over true azimuth (figure 3 a-c), training curves, scores by calibration; and saving of figures."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import torch
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predictions import Floats
from viewnet.evaluation.run import Run
from viewnet.runtime.files import replacing
from viewnet.tables.layouts import LABELS

STYLE: Any = {
    "font.size": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,  # TrueType: text stays text
    "svg.hashsalt": "viewnet",
    "text.parse_math": False,  # names are text, whatever is in them
}
INK = "#1f4e79"
STYLES = {"none": "-", "procrustes": "-", "robust": "-.", "linear": "--", "per_angle": ":"}
# Distinct for colour-blind readers too (Okabe and Ito 2008).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES: Any = ("-", "--", ":", "-.")
# Columns of a run's log that are no term of its loss, and their titles.
LOGGED = {"val_accuracy": "validation accuracy (%)", "val_folded": "the same, folded (%)",
    "val_robust": "robust alignment (%)", "val_reconstruction": "validation error",
    "val_least_used": "least used head (%)", "val_focal": "focal length", "loss": "training loss"}  # fmt: skip
COUNTED = ("epoch", "step", "seconds")  # columns that only say where the training is
AXES = {"acc30": "accuracy (%)", "median": "median error (degrees)", "dva": "DVA (%)"}
NOTE = "Description"
"""The name of the text in a PNG file that says of what runs the figure is."""
LEGEND: Any = {"loc": "outside right upper", "frameon": False, "fontsize": 7}


def angles(vectors: Floats) -> tuple[Floats, Floats]:
    """Azimuths in [0, 360) and elevations (N,) of view vectors (N, 3), degrees."""
    azimuth, elevation = geometry.azimuth_elevation(torch.from_numpy(np.array(vectors)))
    return azimuth.numpy(), elevation.numpy()


def plain_ticks(axis: Axis) -> None:
    """Numbers along a logarithmic axis that are not written as powers, which would need mathtext."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


@matplotlib.rc_context(STYLE)
def azimuth_scatter(runs: Sequence[Run]) -> Figure:
    """Figure 3 (a)-(c): predicted azimuth after alignment over the true one, a panel a run. ViewnetError if none."""
    if not runs:
        raise ViewnetError("figure 3: no runs to show: train some first")
    figure = Figure(figsize=(2.2 * len(runs), 2.5), layout="constrained")
    ticks = [0, 90, 180, 270, 360]
    for axes, run in zip(figure.subplots(1, len(runs), sharey=True, squeeze=False)[0], runs, strict=True):
        aligned = align(run.predictions, run.alignment)
        true, predicted = aligned.predictions.ids["azimuth"], angles(aligned.selected)[0]
        axes.plot([0, 360], [0, 360], color="0.8", linewidth=0.6, zorder=0)  # where right predictions lie
        axes.scatter(true, predicted, s=2, linewidths=0, alpha=0.5, color=INK)
        axes.set(title=run.config.category, xlabel="true azimuth (degrees)")
        axes.set(xlim=(0, 360), ylim=(0, 360), xticks=ticks, yticks=ticks, aspect="equal")
    figure.axes[0].set_ylabel("predicted azimuth (degrees)")
    return figure


def training_logs(runs: Sequence[Run]) -> pd.DataFrame:
    """The logs of runs one below the other: row, recipe, category, seed, `targets` seen so far, and the log's columns.

    Raises ViewnetError without runs, and for a run that has not been validated yet.
    """
    if not runs:
        raise ViewnetError("training curves: no runs to show: train some first")
    logs = []
    for run in runs:
        log, config = run.log, run.config
        if log.empty:
            raise ViewnetError(f"{run.name}: its log is empty: wait for the first validation")
        about: dict[str, Any] = {"row": LABELS.get(config.variant, config.variant), "recipe": config.recipe}
        about |= {"category": config.category, "seed": config.seed}
        log = log.assign(targets=log["step"] * config.train.batch_size, **about)  # recipes differ in batch size
        logs.append(log[[*about, "targets", *(column for column in log if column not in {*about, "targets"})]])
    return pd.concat(logs, ignore_index=True)


@matplotlib.rc_context(STYLE)
def training_curves(logs: pd.DataFrame) -> Figure:
    """Validation accuracy and error, the loss and each of its terms over the target images seen, of `training_logs`.

    A colour a row and recipe, a dash a category. Terms are weighted, so they sum to the loss. Seeds look alike.
    """
    columns = list(logs.columns[logs.columns.get_loc("targets") + 1 :])
    titles = {column: title for column, title in LOGGED.items() if column in columns}
    titles |= {term: f"loss: {term}" for term in columns if term not in {*LOGGED, *COUNTED}}
    recipes = logs["recipe"].nunique() > 1
    names = logs["row"] + " (" + logs["recipe"] + ")" if recipes else logs["row"]
    colours = dict(zip(names.unique(), itertools.cycle(COLOURS), strict=False))
    dashes = dict(zip(logs["category"].unique(), itertools.cycle(DASHES), strict=False))
    across = min(4, len(titles))  # panels in a line: more would be too narrow to read
    down = -(-len(titles) // across)
    figure = Figure(figsize=(1.75 * across + 1.4, 1.5 * down + 0.2), layout="constrained")
    grid = figure.subplots(down, across, squeeze=False).ravel()
    for axes, (column, title) in zip(grid, titles.items(), strict=False):
        for (name, category, _), log in logs.groupby([names, "category", "seed"], sort=False):
            if log[column].notna().any():  # not every run has every term
                style: Any = {"color": colours[name], "linestyle": dashes[category]}
                axes.plot(log["targets"], log[column], linewidth=1, marker="o", markersize=2, **style)
        axes.set_title(title, fontsize=8)
        shares = column in ("val_accuracy", "val_folded", "val_robust")
        axes.set_ylim(min(0, logs[column].min()), 100 if shares else None)
        if recipes:
            # Trainings by different recipes see numbers of images that are far apart.
            axes.set(xscale="log", xlim=(logs["targets"].min() * 0.8, logs["targets"].max() * 1.25))
            plain_ticks(axes.xaxis)
        else:
            axes.set_xlim(left=0)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    for axes in grid[len(titles) :]:
        axes.remove()
    for axes in grid[max(0, len(titles) - across) : len(titles)]:
        axes.set_xlabel("target images")
    # A line for each style, not each run.
    handles = [Line2D([], [], color=c, linewidth=1, label=name) for name, c in colours.items()]
    if len(dashes) > 1:
        handles += [Line2D([], [], color="0.3", linestyle=d, linewidth=1, label=name) for name, d in dashes.items()]
    figure.legend(handles=handles, **LEGEND)
    return figure


@matplotlib.rc_context(STYLE)
def calibration_curves(scores: pd.DataFrame) -> Figure:
    """Scores over the number of calibration photographs, a row a metric and a column a category.

    `scores` is that of viewnet.experiments.alignment_study.Study: a line is the median over draws and seeds of a
    predictor (colour) by an alignment (style), the shade from the lowest to the highest.
    """
    categories = list(dict.fromkeys(scores["category"]))
    fitted = set(scores.loc[scores["alignment"] == "none", "predictor"])
    colours = {predictor: f"C{i}" for i, predictor in enumerate(dict.fromkeys(scores["predictor"]))}
    figure = Figure(figsize=(2.3 * len(categories) + 1.6, 1.7 * len(AXES)), layout="constrained")
    grid = figure.subplots(len(AXES), len(categories), squeeze=False, sharex=True, sharey="row")
    for (predictor, kind), rows in scores.groupby(["predictor", "alignment"], sort=False):
        if (predictor in fitted) != (kind == "none"):  # what was fitted needs no alignment, all else needs one
            continue
        colour, label = colours[predictor], predictor if kind == "none" else f"{predictor}, {kind}"
        style: Any = {"color": colour, "linestyle": STYLES[kind], "label": label}
        for (i, metric), (j, category) in itertools.product(enumerate(AXES), enumerate(categories)):
            shown = rows[rows["category"] == category].groupby("images")[metric].agg(["median", "min", "max"])
            images, axes = shown.index.to_numpy(dtype=float), grid[i, j]
            axes.plot(images, shown["median"], linewidth=1, markersize=2, marker="o", **style)
            axes.fill_between(images, shown["min"], shown["max"], color=colour, alpha=0.1, linewidth=0)
    for j, category in enumerate(categories):
        grid[0, j].set_title(category)
        grid[0, j].set_xscale("log", base=2)  # counts double
        grid[-1, j].xaxis.set_major_formatter("{x:.0f}")
        grid[-1, j].set_xlabel("calibration photographs")
    for i, title in enumerate(AXES.values()):
        grid[i, 0].set_ylabel(title)
        grid[i, 0].set_ylim(bottom=0)  # so that small differences look small
    figure.legend(*grid[0, 0].get_legend_handles_labels(), **LEGEND)
    return figure


@matplotlib.rc_context(STYLE)
def collapse_curves(collapse: pd.DataFrame) -> Figure:
    """Linear alignment over the one-sidedness of photographs, a colour a category and a style a predictor.

    `collapse` is that of viewnet.experiments.alignment_study.Study. Left: the spread of aligned predictions, as a share
    of the truth's. Middle and right: the accuracy and the DVA added to rigid alignment, points.
    """
    styles = dict(zip(dict.fromkeys(collapse["predictor"]), itertools.cycle(DASHES), strict=False))
    colours = {category: f"C{i}" for i, category in enumerate(dict.fromkeys(collapse["category"]))}
    gains = {metric: collapse[f"{metric}_linear"] - collapse[f"{metric}_rigid"] for metric in ("acc30", "dva")}
    titles = {"spread_linear": "spread left", "acc30": "accuracy added, points", "dva": "DVA added, points"}
    figure = Figure(figsize=(8.2, 2.5), layout="constrained")
    for axes, (column, title) in zip(figure.subplots(1, 3), titles.items(), strict=True):
        axes.axhline(0, color="0.8", linewidth=0.6, zorder=0)  # a constant, or nothing added
        for (category, predictor), rows in collapse.assign(**gains).groupby(["category", "predictor"], sort=False):
            means = rows.groupby("concentration")[["side", column]].mean()  # over seeds
            style: Any = {"color": colours[category], "linestyle": styles[predictor]}
            label = f"{category}, {predictor}"
            axes.plot(means["side"], means[column], linewidth=1, markersize=2.5, marker="o", label=label, **style)
        axes.set(title=title, xlabel="share of the commonest 30 degrees")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), **LEGEND)
    return figure


@matplotlib.rc_context(STYLE)
def save(figure: Figure, folder: Path, name: str, note: str = "") -> list[Path]:
    """`<name>.png` and `<name>.pdf`, the same bytes each time; the first says of what runs it is, in `note`."""
    files = [folder / f"{name}.png", folder / f"{name}.pdf"]
    written = {"Software": None, **({NOTE: note} if note else {})}
    for path, metadata in zip(files, (written, {"CreationDate": None, "ModDate": None}), strict=True):
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=200, metadata=metadata)  # no date and no version: the same bytes each time
    return files
