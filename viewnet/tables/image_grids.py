"""The images of the paper's supplement, from finished runs: reconstructions, views around an object, volumes, curves.

Every function takes runs and, where it draws, `stores`: which views to show a run. These are its own unless told
otherwise; photographs will do for all but novel views of their objects, of which nobody knows what is right. Drawings
stand before white, but those of the HoloGAN decoder, which paints its own black.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

import matplotlib
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from viewnet.errors import ViewnetError
from viewnet.evaluation.run import Run, run_name
from viewnet.geometry import look_at, view_vector
from viewnet.tables.layouts import LABELS
from viewnet.tables.plots import STYLE
from viewnet.tables.run_renderer import RunRenderer, Stores, own_views, renderers

CELL = 0.78  # inches: the side of an image in a grid
AZIMUTHS = tuple(range(0, 360, 45))


def reconstructions(runs: Sequence[Run], stores: Stores = own_views, count: int = 3) -> Figure:
    """`count` test images of each category, and what each run makes of them at the viewpoint that it selects.

    Objects are evenly spaced over the test split and nothing but the image is used. Runs of one category stand side
    by side (ViewNet and ViewNet + cycle in the paper) and must have the same views.
    """
    found = renderers(runs, stores)
    columns: list[np.ndarray] = []
    titles: list[str] = []
    gaps: list[int] = []
    for category in dict.fromkeys(run.config.category for run in runs):
        group = [d for d in found if d.config.category == category]
        rows = _views(group[0], count)
        gaps.append(len(columns))
        columns.append(group[0].shown(rows))
        titles.append(category)
        for drawer in group:
            _check_same(group[0], drawer)
            columns.append(drawer.painted(drawer.reconstruct(rows)))
            titles.append(_label(drawer, group))
    lines = [[column[i] if i < len(column) else None for column in columns] for i in range(count)]
    return image_grid(lines, columns=titles, gaps=gaps[1:])


def around(
    runs: Sequence[Run],
    stores: Stores = own_views,
    azimuths: Sequence[float] = AZIMUTHS,
    elevation: float = 20.0,
    object_number: int | None = None,
) -> Figure:
    """Views all around one object at constant elevation: a row for each run, the image its appearance is from first.

    Runs are shown by variant, as in the paper; within a category all have the same object (`object_number` of the test
    split, the middle one if None). Own azimuths are turned to the annotated ones, and nothing else is aligned, so that
    a network which has learned no common frame is shown from where it learned to draw. Raises ViewnetError for an
    object that is not there.
    """
    found = renderers(runs, stores)
    several = len({d.config.category for d in found}) > 1
    lines, labels = [], []
    for variant in dict.fromkeys(d.config.variant for d in found):
        for drawer in (d for d in found if d.config.variant == variant):
            if object_number is not None and not 0 <= object_number < len(drawer.views.first):
                raise ViewnetError(
                    f"object {object_number}: the test split has {len(drawer.views.first)}: choose one from 0 on"
                )
            objects = len(drawer.views.first)
            row = int(drawer.views.first[objects // 2 if object_number is None else object_number])
            angles = torch.tensor([float(a) for a in azimuths])
            drawn = drawer.draw(drawer.imagine([row]), drawer.level(angles, torch.full_like(angles, elevation)))
            lines.append([drawer.shown([row])[0], *drawer.painted(drawn)])
            labels.append(_label(drawer, found) + (f"\n{drawer.config.category}" if several else ""))
    titles = ["appearance", *(f"{azimuth:g}°" for azimuth in azimuths)]
    return image_grid(lines, labels, titles, gaps=[1])


def volumes(
    runs: Sequence[Run],
    stores: Stores = own_views,
    count: int = 14,
    columns: int = 7,
    viewpoint: tuple[float, float] = (40.0, 25.0),
) -> Figure:
    """What many appearances make of the learned volume, all drawn from one `viewpoint` (azimuth, elevation; degrees).

    In pairs of lines: images of `count` test objects, and below each its volume, turned to the annotated frame.
    """
    lines: list[list[np.ndarray | None]] = []
    labels, gaps = [], []
    for drawer in renderers(runs, stores):
        rows = _views(drawer, count)
        frames = look_at(view_vector(*(torch.tensor([angle]) for angle in viewpoint))).expand(len(rows), 3, 3)
        size = 2 * drawer.network.config.render_size
        images = drawer.shown(rows)
        drawn = drawer.painted(drawer.draw(drawer.imagine(rows), drawer.own(frames), size))
        for start in range(0, len(rows), columns):
            for part in (images, drawn):
                line = list(part[start : start + columns])
                lines.append([*line, *[None] * (columns - len(line))])
            labels += ["image", "volume"]
            gaps.append(len(lines))
    return image_grid(lines, labels, row_gaps=gaps[:-1])


def image_grid(
    lines: Sequence[Sequence[np.ndarray | None]],
    rows: Sequence[str] = (),
    columns: Sequence[str] = (),
    captions: Sequence[Sequence[str]] = (),
    gaps: Iterable[int] = (),
    row_gaps: Iterable[int] = (),
) -> Figure:
    """Images (H, W, 3) uint8 in a grid, None for none: labels before `rows`, above `columns`, a caption under each.

    A little space is left before the columns `gaps` and the lines `row_gaps`.
    """
    down, across = len(lines), len(lines[0])
    titles = [_wrapped(title) for title in columns]
    left, under = 0.42 if rows else 0.04, 0.27 if captions else 0.03
    top = 0.06 + 0.12 * max((title.count("\n") + 1 for title in titles), default=0)
    x = _places(across, CELL + 0.03, gaps, left)
    y = _places(down, CELL + under, row_gaps, top)
    width, height = x[-1], y[-1] + 0.02
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        for i, line in enumerate(lines):
            for j, image in enumerate(line):
                box = (x[j] / width, 1 - (y[i] + CELL) / height, CELL / width, CELL / height)
                axes = figure.add_axes(box, label=f"{i} {j}")
                _show(axes, image)
                if captions and captions[i][j]:
                    axes.set_xlabel(captions[i][j], fontsize=5.5, labelpad=1.5, linespacing=1.0)
                if j == 0 and rows:
                    axes.set_ylabel(_wrapped(rows[i]), fontsize=6.5, labelpad=2, linespacing=1.0)
                if i == 0 and columns:
                    axes.set_title(titles[j], fontsize=7, pad=3, linespacing=1.0)
    return figure


def _places(count: int, step: float, gaps: Iterable[int], start: float) -> list[float]:
    """Where `count` cells begin, and where the last one ends."""
    wide = set(gaps)
    places = [start]
    for place in range(count):
        places.append(places[-1] + step + (0.09 if place + 1 in wide else 0))
    return places


def _wrapped(label: str) -> str:
    return "\n".join(textwrap.fill(part, 13) for part in label.split("\n"))


def _show(axes: Axes, image: np.ndarray | None) -> None:
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    if image is not None:
        axes.imshow(image, interpolation="nearest")


def _views(drawer: RunRenderer, count: int) -> list[int]:
    """The first views of `count` objects, or of all where there are fewer, evenly spaced over the test split."""
    first = drawer.views.first
    places = np.linspace(0, len(first), min(count, len(first)), endpoint=False).astype(int)
    return [int(first[place]) for place in places]


def _check_same(one: RunRenderer, other: RunRenderer) -> None:
    if one.store.identity != other.store.identity:
        raise ViewnetError(
            f"{run_name(one.config)} and {run_name(other.config)} have other views: they cannot be shown the same images"
        )


def _label(drawer: RunRenderer, among: Sequence[RunRenderer]) -> str:
    """The variant as the tables call it, with the seed where there are several of one variant and category."""
    config = drawer.config
    alike = [d for d in among if (d.config.variant, d.config.category) == (config.variant, config.category)]
    label = LABELS.get(config.variant, config.variant)
    return f"{label}\nseed {config.seed}" if len(alike) > 1 else label
