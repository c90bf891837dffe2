"""Plots: predicted over true azimuth (figure 3 a-c), training curves, scores by calibration; and saving of figures."""

import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import torch
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation.confidence import BINS, calibration_error
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
# Distinct for colour-blind readers too (Okabe and Ito 2008).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
LINE: Any = {"linewidth": 1, "marker": "o", "markersize": 2}
# Columns of a run's log that are drawn, and their titles.
MEASURES = {
    "val_accuracy": "validation\naccuracy (%)",
    "val_folded": "opposite sides\ncounted as one (%)",
    "val_reconstruction": "validation error\n(of the best head)",
    "val_focal": "focal parameter f\n(pinhole at 1 / f)",
    "loss": "training loss\n(sum of its terms)",
}
ALIGNMENTS = {"procrustes": "rotation", "robust": "robust rotation", "linear": "linear", "per_angle": "angle by angle"}
RELIABLE = 10  # photographs of a tenth of confidence, for a share that is drawn
NOTE = "Description"
"""The name of the text in a PNG file that says of what runs the figure is."""


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
    """Validation accuracy and error and the loss over the target images seen, of `training_logs`.

    A row of panels a measure, a column a category; a line a row and recipe: the mean of its seeds, the thin lines.
    """
    known = logs.dropna(axis=1, how="all")
    measures = {column: title for column, title in MEASURES.items() if column in known}
    recipes = logs["recipe"].nunique() > 1
    names = logs["row"] + " (" + logs["recipe"] + ")" if recipes else logs["row"]
    colours = dict(zip(names.unique(), itertools.cycle(COLOURS), strict=False))
    figure, panels = _panels(logs["category"].unique(), measures, "target images seen")
    for (column, category), axes in panels.items():
        mine = logs[(logs["category"] == category) & logs[column].notna()]
        for name, part in mine.groupby(names, sort=False):
            seeds = part.pivot_table(column, "targets", "seed")
            axes.plot(seeds.index, seeds, color=colours[name], linewidth=0.5, alpha=0.4)
            axes.plot(seeds.index, seeds.mean(axis=1), color=colours[name], label=name, **LINE)
        if recipes:  # trainings by different recipes see numbers of images that are far apart
            axes.set_xscale("log")
            plain_ticks(axes.xaxis)
        else:
            axes.set_xlim(left=0)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    for (column, _), axes in panels.items():
        axes.set_ylim(bottom=min(0, logs[column].min()), top=100 if "%" in measures[column] else None)
    _label_ends(panels.values())
    return figure


@matplotlib.rc_context(STYLE)
def calibration_curves(scores: pd.DataFrame) -> Figure:
    """Accuracy over the number of calibration photographs, a row of panels a predictor and a column a category.

    `scores` is that of viewnet.experiments.alignment_study.Study: a line is the median over draws and seeds by an
    alignment, the shade from the lowest to the highest. Grey lines are of what was fitted and needs no alignment.
    """
    fitted = scores.loc[scores["alignment"] == "none", "predictor"].unique()
    aligned = [name for name in scores["predictor"].unique() if name not in {*fitted, "Random"}]
    titles = {name: f"{name}:\naccuracy (%)" for name in aligned}
    figure, panels = _panels(scores["category"].unique(), titles, "calibration photographs")
    for (predictor, category), axes in panels.items():
        here = scores[scores["category"] == category]
        shown = [(ALIGNMENTS[kind], colour, here[(here["predictor"] == predictor) & (here["alignment"] == kind)])
                 for kind, colour in zip(ALIGNMENTS, COLOURS, strict=False)]  # fmt: skip
        shown += [(name, "0.55", here[(here["predictor"] == name) & (here["alignment"] == "none")]) for name in fitted]
        for label, colour, rows in shown:
            if len(rows) and label != "Constant (rotation)":  # as the other constant
                of_draws = rows.groupby("images")["acc30"].agg(["median", "min", "max"])
                images = of_draws.index.to_numpy(dtype=float)
                axes.plot(images, of_draws["median"], color=colour, label=label, **LINE)
                axes.fill_between(images, of_draws["min"], of_draws["max"], color=colour, alpha=0.1, linewidth=0)
        axes.set_ylim(0, 100)
        axes.set_xscale("log", base=2)  # counts double
        axes.xaxis.set_major_formatter("{x:.0f}")
    _label_ends(panels.values())
    return figure


@matplotlib.rc_context(STYLE)
def collapse_curves(collapse: pd.DataFrame) -> Figure:
    """Linear alignment over the one-sidedness of photographs, a row of panels a measure and a column a category.

    `collapse` is that of viewnet.experiments.alignment_study.Study: the spread of aligned predictions, the accuracy and
    the DVA that the linear alignment adds to the rotation; a line a predictor, the mean of its seeds.
    """
    shares = {"side": 100 * collapse["side"], "spread": 100 * collapse["spread_linear"]}
    gains = {metric: collapse[f"{metric}_linear"] - collapse[f"{metric}_rigid"] for metric in ("acc30", "dva")}
    titles = {"spread": "spread of predictions\n(% of the truth's)"}
    titles |= {"acc30": "accuracy, linear\nless rotation (points)", "dva": "DVA, linear\nless rotation (points)"}
    below = "photographs within the commonest\n30° of azimuth (%)"
    figure, panels = _panels(collapse["category"].unique(), titles, below)
    measured = collapse.assign(**shares, **gains)
    colours = dict(zip(collapse["predictor"].unique(), itertools.cycle(COLOURS), strict=False))
    for (column, category), axes in panels.items():
        axes.axhline(0, color="0.8", linewidth=0.6, zorder=0)  # a constant, or nothing added
        for name, rows in measured[measured["category"] == category].groupby("predictor", sort=False):
            means = rows.groupby("concentration")[["side", column]].mean()
            axes.plot(means["side"], means[column], color=colours[name], label=name, **LINE)
    _label_ends(panels.values())
    return figure


@matplotlib.rc_context(STYLE)
def reliability(answers: dict[str, tuple[Floats, NDArray[np.bool_]]]) -> Figure:
    """Share of right viewpoints over confidence, by its tenths, and how often each is said, for each predictor.

    `answers` are confidences (N,) and which viewpoints are right (N,). Tenths of fewer than RELIABLE are left out.
    """
    figure = Figure(figsize=(3.6, 4.6), layout="constrained")
    shares, counts = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    shares.plot([0, 100], [0, 100], color="0.8", linewidth=0.6, zorder=0)  # as sure as it is right
    edges = np.linspace(0, 100, BINS + 1)
    for (name, (sure, right)), colour in zip(answers.items(), itertools.cycle(COLOURS), strict=False):
        bins = np.minimum((sure * BINS).astype(int), BINS - 1)  # (N,)
        places = [place for place in range(BINS) if (bins == place).sum() >= RELIABLE]
        means = [[100 * values[bins == place].mean() for place in places] for values in (sure, right)]
        label = f"{name}: {calibration_error(sure, right):.1f} points"
        shares.plot(*means, color=colour, label=label, **LINE)
        counts.stairs(100 * np.bincount(bins, minlength=BINS) / len(bins), edges, color=colour, linewidth=1)
    figure.legend(loc="outside lower left", frameon=False, title="expected calibration error", alignment="left")
    shares.set(xlim=(0, 100), ylim=(0, 100), ylabel="within 30° (%)")
    counts.set(xlabel="confidence (%)", ylabel="photographs (%)")
    return figure


def _panels(columns: Sequence[str], rows: dict[str, str], below: str) -> tuple[Figure, dict[tuple[str, str], Any]]:
    """A figure of panels with room for words at the right of each, and its axes: row and column -> axes."""
    figure = Figure(figsize=(2.6 * len(columns) + 0.3, 1.55 * len(rows) + 0.4), layout="constrained")
    grid = figure.subplots(len(rows), len(columns), squeeze=False, sharex="col", sharey="row")
    for j, title in enumerate(columns):
        grid[0, j].set_title(title)
        grid[-1, j].set_xlabel(below)
    for i, title in enumerate(rows.values()):
        grid[i, 0].set_ylabel(title)
    return figure, dict(zip(itertools.product(rows, columns), grid.flat, strict=True))


def _label_ends(panels: Iterable[Any]) -> None:
    """Write the label of each line at its end, moved to where it stands on no other, in its panel's height."""
    for axes in panels:
        bottom, top = axes.get_ylim()
        gap, lowest, across = (top - bottom) / 11, bottom, axes.get_yaxis_transform()
        lines = [line for line in axes.lines if not line.get_label().startswith("_")]
        for above, line in zip(range(len(lines) - 1, -1, -1), sorted(lines, key=_end), strict=True):
            place = min(max(_end(line), lowest), top - gap * above)
            lowest, colour = place + gap, line.get_color()
            pointer: Any = {"arrowstyle": "-", "linewidth": 0.4, "color": colour, "relpos": (0, 0.5)}
            pointer |= {"shrinkA": 0, "shrinkB": 0}
            style: Any = {"textcoords": across, "color": colour, "fontsize": 6, "va": "center", "arrowprops": pointer}
            axes.annotate(line.get_label(), (1, _end(line)), (1.05, place), across, **style, annotation_clip=False)


def _end(line: Any) -> float:
    return float(line.get_ydata()[-1])


@matplotlib.rc_context(STYLE)
def save(figure: Figure, folder: Path, name: str, note: str = "") -> list[Path]:
    """`<name>.png` and `<name>.pdf`, the same bytes each time; the first says of what runs it is, in `note`."""
    files = [folder / f"{name}.png", folder / f"{name}.pdf"]
    written = {"Software": None, **({NOTE: note} if note else {})}
    for path, metadata in zip(files, (written, {"CreationDate": None, "ModDate": None}), strict=True):
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=200, metadata=metadata)  # no date and no version: the same bytes each time
    return files
