"""Image grids of finished runs: figure 3 (d); the supplement's reconstructions, views around an object and volumes.

Every function takes runs and `stores`, which gives the views of a run (by default its own). Photographs will do for all
but novel views of their objects, whose true appearance is unknown. Rendered images are on white, but those of the
HoloGAN decoder on its own black.
"""

import itertools
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure

from viewnet.data import augment
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.run import Run, run_name
from viewnet.geometry import look_at, view_vector
from viewnet.model.reconstruction import reconstruct
from viewnet.model.rendering import to_uint8
from viewnet.runtime.images import resize
from viewnet.tables.layouts import LABELS
from viewnet.tables.plots import STYLE
from viewnet.tables.run_renderer import RunRenderer, Stores, own_views, renderers

CELL = 0.78  # inches: the side of an image in a grid
Ranked = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Views (N, H, W, 3), reconstructions (N, M, H, W, 3) uint8, their errors and the heads, (N, M)."""


def reconstructions(runs: Sequence[Run], stores: Stores = own_views, count: int = 3) -> Figure:
    """`count` test images of each category, and their reconstruction by each run at the viewpoint that it selects.

    Objects are evenly spaced over the test split. Runs of one category stand side by side (ViewNet and ViewNet + cycle
    in the paper) and must have the same views, or ViewnetError is raised.
    """
    all_renderers = renderers(runs, stores)
    columns: list[tuple[str, np.ndarray]] = []  # title and images
    gaps: list[int] = []
    for category in dict.fromkeys(run.config.category for run in runs):
        group = [r for r in all_renderers if r.config.category == category]
        rows = _rows(group[0], count)
        gaps.append(len(columns))
        columns.append((category, group[0].test_images(rows)))
        for renderer in group:
            if renderer.store.identity != group[0].store.identity:
                names = " and ".join(run_name(r.config) for r in (group[0], renderer))
                raise ViewnetError(f"{names} have other views: they cannot be shown the same images")
            columns.append((_label(renderer, group), renderer.displayed(renderer.reconstruct(rows))))
    lines = [[images[i] if i < len(images) else None for _, images in columns] for i in range(count)]
    return image_grid(lines, columns=[title for title, _ in columns], gaps=gaps[1:])


def around(
    runs: Sequence[Run],
    stores: Stores = own_views,
    azimuths: Sequence[float] = tuple(range(0, 360, 45)),
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
    angles = torch.tensor(azimuths, dtype=torch.float32)
    lines, labels = [], []
    variants = [r.config.variant for r in all_renderers]
    for renderer in sorted(all_renderers, key=lambda r: variants.index(r.config.variant)):
        first = renderer.views.first
        if object_number is not None and not 0 <= object_number < len(first):
            raise ViewnetError(f"object {object_number}: the test split has {len(first)}: choose one from 0 on")
        row = int(first[len(first) // 2 if object_number is None else object_number])
        frames = renderer.level(angles, torch.full_like(angles, elevation))
        rendered = renderer.displayed(renderer.render(renderer.encode([row]), frames))
        lines.append([renderer.test_images([row])[0], *rendered])
        labels.append(_label(renderer, all_renderers) + (f"\n{renderer.config.category}" if several else ""))
    return image_grid(lines, labels, ["appearance", *(f"{azimuth:g}°" for azimuth in azimuths)], gaps=[1])


def volumes(
    runs: Sequence[Run],
    stores: Stores = own_views,
    count: int = 14,
    columns: int = 7,
    viewpoint: tuple[float, float] = (40.0, 25.0),
) -> Figure:
    """Images of `count` test objects, and below each its volume from one annotated `viewpoint` (azimuth, elevation)."""
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


@torch.no_grad()
def ranked_reconstructions(folder: Path, store: ViewStore, rows: list[int]) -> Ranked:
    """Some test views of a run, each reconstructed by every head, by rising reconstruction error; see Ranked.

    The appearance comes from the object's next view, the background is white. ViewnetError as of RunRenderer.of.
    """
    renderer = RunRenderer.of(folder, store)
    network, train, views = renderer.network, renderer.config.train, renderer.views
    size, small, index = network.config.render_size, network.config.input_size, torch.tensor(rows)
    images, background = views.viewpoint_input(index, small, renderer.device), None
    if renderer.backgrounds is not None:
        generator = torch.Generator().manual_seed(0)
        images = augment.photograph(images, renderer.backgrounds, train.photo, generator)
        background = augment.windows(renderer.backgrounds, len(rows), small, generator, renderer.device)
    target = renderer.images(rows, small)
    target = resize(target, size)
    appearance = renderer.images(renderer.next_views(rows), small)
    result = reconstruct(network, appearance, target, images, train, background=background)
    cameras = result.hypotheses.world_from_camera.flatten(0, 1)  # (N M, 3, 3)
    rendered = to_uint8(network.render(result.objects.volume, result.objects.code, cameras))
    errors, heads = (x.cpu().numpy() for x in result.choice.errors.sort(1))
    by_head = rendered.reshape(len(rows), -1, *rendered.shape[1:])  # (N, M, H, W, 3)
    return to_uint8(renderer.images(rows, size)), by_head[np.arange(len(rows))[:, None], heads], errors, heads


@matplotlib.rc_context(STYLE)
def candidate_figure(
    runs: Sequence[Run],
    stores: Stores = own_views,
    ranked: Callable[[Path, ViewStore, list[int]], Ranked] = ranked_reconstructions,
    count: int = 1,
) -> Figure:
    """Figure 3 (d) of trained runs of the same number of heads, `count` test images of each, evenly spaced.

    Raises ViewnetError without runs, for untrained ones and for images of different sizes.
    """
    parts, labels = [], []
    for run in runs:
        if not run.trained:
            raise ViewnetError(f"figure 3: {run.config.variant} renders nothing: choose a trained variant")
        aligned = align(run.predictions, run.alignment)
        rows = np.linspace(0, len(aligned.predictions) - 1, count + 2).round().astype(int)[1:-1]
        inputs, rendered, errors, heads = ranked(run.folder, stores(run), rows.tolist())
        parts.append((inputs, rendered, errors, np.take_along_axis(aligned.errors[rows], heads, axis=1)))
        labels += [run.config.category] * len(rows)
    if not parts:
        raise ViewnetError("figure 3: no runs to show: train some first")
    if len(sizes := {part[1].shape[1:] for part in parts}) > 1:
        raise ViewnetError(f"figure 3: images of {len(sizes)} sizes cannot share a grid: show runs of one profile")
    inputs, rendered, errors, angles = (np.concatenate(column) for column in zip(*parts, strict=True))
    n, m = rendered.shape[:2]
    figure = Figure(figsize=(0.9 * (m + 1), 1.05 * n + 0.2), layout="constrained")
    grid = figure.subplots(n, m + 1, squeeze=False)
    for (i, j), axes in np.ndenumerate(grid):
        axes.imshow(rendered[i, j - 1] if j else inputs[i], interpolation="nearest")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        if j:
            axes.set_xlabel(f"{errors[i, j - 1]:.3f} / {angles[i, j - 1]:.0f}°", labelpad=2, fontsize=7)
        else:
            axes.set_ylabel(labels[i])
    grid[0, 0].set_title("input", fontsize=8)
    grid[0, 1].set_title("error / angle", fontsize=8, loc="left")
    return figure


@matplotlib.rc_context(STYLE)
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
    figure = Figure(figsize=(width, height))
    for i, j in np.ndindex(len(lines), len(lines[0])):
        box = (x[j] / width, 1 - (y[i] + CELL) / height, CELL / width, CELL / height)
        axes = figure.add_axes(box, label=f"{i} {j}")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        if (image := lines[i][j]) is not None:
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
    steps = (step + (0.09 if place in wide else 0) for place in range(1, count + 1))
    return list(itertools.accumulate(steps, initial=start))


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
