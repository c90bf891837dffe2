"""Image grids of the paper's supplement, from finished runs: reconstructions, views around an object, volumes.

Every function takes runs and `stores`, which gives the views of a run (by default its own). Photographs will do for all
but novel views of their objects, whose true appearance is unknown. Rendered images are on white, but those of the
HoloGAN decoder on its own black.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

import matplotlib
import numpy as np
import torch
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
    """`count` test images of each category, and their reconstruction by each run at the viewpoint that it selects.

    Objects are evenly spaced over the test split. Runs of one category stand side by side (ViewNet and ViewNet + cycle
    in the paper) and must have the same views, or ViewnetError is raised.
    """
    all_renderers = renderers(runs, stores)
    columns: list[np.ndarray] = []
    titles: list[str] = []
    gaps: list[int] = []
    for category in dict.fromkeys(run.config.category for run in runs):
        group = [r for r in all_renderers if r.config.category == category]
        rows = _rows(group[0], count)
        gaps.append(len(columns))
        columns.append(group[0].test_images(rows))
        titles.append(category)
        for renderer in group:
            if renderer.store.identity != group[0].store.identity:
                one, other = run_name(group[0].config), run_name(renderer.config)
                raise ViewnetError(f"{one} and {other} have other views: they cannot be shown the same images")
            columns.append(renderer.displayed(renderer.reconstruct(rows)))
            titles.append(_label(renderer, group))
    lines = [[column[i] if i < len(column) else None for column in columns] for i in range(count)]
    return image_grid(lines, columns=titles, gaps=gaps[1:])


def around(
    runs: Sequence[Run],
    stores: Stores = own_views,
    azimuths: Sequence[float] = AZIMUTHS,
    elevation: float = 20.0,
    object_number: int | None = None,
) -> Figure:
    """Views all around one object at constant elevation: a row for each run, the appearance image first.

    Runs are grouped by variant, as in the paper; within a category all have the same object (`object_number` of the
    test split, the middle one if None). Own azimuths are shifted to the annotated ones and nothing else is aligned, so
    a network without a common frame is shown in its own. Raises ViewnetError for an object that does not exist.
    """
    all_renderers = renderers(runs, stores)
    several = len({r.config.category for r in all_renderers}) > 1
    angles = torch.tensor([float(a) for a in azimuths])
    lines, labels = [], []
    for variant in dict.fromkeys(r.config.variant for r in all_renderers):
        for renderer in (r for r in all_renderers if r.config.variant == variant):
            first = renderer.views.first
            if object_number is not None and not 0 <= object_number < len(first):
                raise ViewnetError(f"object {object_number}: the test split has {len(first)}: choose one from 0 on")
            row = int(first[len(first) // 2 if object_number is None else object_number])
            frames = renderer.level(angles, torch.full_like(angles, elevation))
            rendered = renderer.displayed(renderer.render(renderer.encode([row]), frames))
            lines.append([renderer.test_images([row])[0], *rendered])
            labels.append(_label(renderer, all_renderers) + (f"\n{renderer.config.category}" if several else ""))
    titles = ["appearance", *(f"{azimuth:g}°" for azimuth in azimuths)]
    return image_grid(lines, labels, titles, gaps=[1])


def volumes(
    runs: Sequence[Run],
    stores: Stores = own_views,
    count: int = 14,
    columns: int = 7,
    viewpoint: tuple[float, float] = (40.0, 25.0),
) -> Figure:
    """The volumes of many objects, all rendered from one `viewpoint` (azimuth, elevation; degrees).

    In pairs of lines: images of `count` test objects, and below each its volume, turned to the annotated frame.
    """
    lines: list[list[np.ndarray | None]] = []
    labels, gaps = [], []
    for renderer in renderers(runs, stores):
        rows = _rows(renderer, count)
        frames = look_at(view_vector(*(torch.tensor([angle]) for angle in viewpoint))).expand(len(rows), 3, 3)
        size = 2 * renderer.network.config.render_size
        images = renderer.test_images(rows)
        rendered = renderer.displayed(renderer.render(renderer.encode(rows), renderer.in_own_frame(frames), size))
        for start in range(0, len(rows), columns):
            for part in (images, rendered):
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
    """Images (H, W, 3) uint8 in a grid, None for an empty cell: labels of `rows` and `columns`, captions below images.

    A little space is left before the columns `gaps` and the lines `row_gaps`.
    """
    titles = [_wrapped(title) for title in columns]
    left, under = 0.42 if rows else 0.04, 0.27 if captions else 0.03
    top = 0.06 + 0.12 * max((title.count("\n") + 1 for title in titles), default=0)
    x = _places(len(lines[0]), CELL + 0.03, gaps, left)
    y = _places(len(lines), CELL + under, row_gaps, top)
    width, height = x[-1], y[-1] + 0.02
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        for i, line in enumerate(lines):
            for j, image in enumerate(line):
                box = (x[j] / width, 1 - (y[i] + CELL) / height, CELL / width, CELL / height)
                axes = figure.add_axes(box, label=f"{i} {j}")
                axes.set(xticks=[], yticks=[])
                axes.spines[:].set_visible(False)
                if image is not None:
                    axes.imshow(image, interpolation="nearest")
                if captions and captions[i][j]:
                    axes.set_xlabel(captions[i][j], fontsize=5.5, labelpad=1.5, linespacing=1.0)
                if j == 0 and rows:
                    axes.set_ylabel(_wrapped(rows[i]), fontsize=6.5, labelpad=2, linespacing=1.0)
                if i == 0 and columns:
                    axes.set_title(titles[j], fontsize=7, pad=3, linespacing=1.0)
    return figure


def _places(count: int, step: float, gaps: Iterable[int], start: float) -> list[float]:
    """The starts of `count` cells in inches, and the end of the last one."""
    wide = set(gaps)
    places = [start]
    for place in range(count):
        places.append(places[-1] + step + (0.09 if place + 1 in wide else 0))
    return places


def _wrapped(label: str) -> str:
    return "\n".join(textwrap.fill(part, 13) for part in label.split("\n"))


def _rows(renderer: RunRenderer, count: int) -> list[int]:
    """The first views of `count` objects, or of all where there are fewer, evenly spaced over the test split."""
    first = renderer.views.first
    places = np.linspace(0, len(first), min(count, len(first)), endpoint=False).astype(int)
    return [int(first[place]) for place in places]


def _label(renderer: RunRenderer, among: Sequence[RunRenderer]) -> str:
    """The variant's label in the tables, with the seed where there are several of one variant and category."""
    config = renderer.config
    alike = [r for r in among if (r.config.variant, r.config.category) == (config.variant, config.category)]
    label = LABELS.get(config.variant, config.variant)
    return f"{label}\nseed {config.seed}" if len(alike) > 1 else label
