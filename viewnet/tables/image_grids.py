"""Image grids of finished runs: figure 3 (d); the supplement's reconstructions, views around an object and volumes.

Failures are shown by cause: how far a wrong viewpoint is explained by a flip, with images of the worst.

Every function takes runs and `stores`, which gives the views of a run (by default its own), or photographs. Rendered
images are on white, but those of the HoloGAN decoder on its own black.
"""

import itertools
import textwrap
from collections.abc import Iterable, Sequence

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure

from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.evaluate import Aligned
from viewnet.evaluation.predictions import Floats
from viewnet.evaluation.run import Run, run_name
from viewnet.geometry import look_at, view_vector
from viewnet.tables import plots
from viewnet.tables.layouts import LABELS
from viewnet.tables.run_renderer import RunRenderer, Stores, own_views, renderers

CELL = 0.78  # inches: the side of an image in a grid
AZIMUTHS = tuple(range(0, 360, 45))  # degrees, of views around an object
ELEVATION = 20.0  # the same: low enough to tell front from rear, high enough to see the top
VIEWPOINT = (40.0, 25.0)  # annotated azimuth and elevation that volumes are shown from
ACROSS = 7  # volumes in a line
# Degrees: an error of this size or more is a failure, and a cause explains an azimuth to within less than this.
THRESHOLD = 30.0
CAUSES = ("half a turn", "front and back mirrored", "elevation", "other")


def reconstructions(runs: Sequence[Run], stores: Stores = own_views, count: int = 3) -> Figure:
    """`count` test images of each category, and their reconstruction by each run at the viewpoint that it selects.

    Objects are evenly spaced over the test split. Those of a category side by side: ViewnetError for unlike views.
    """
    all_renderers = renderers(runs, stores)
    columns: list[tuple[str, np.ndarray]] = []  # title and images
    gaps: list[int] = []
    for category in dict.fromkeys(run.config.category for run in runs):
        group = [r for r in all_renderers if r.config.category == category]
        rows = _rows(group[0], count)  # the same of all runs of a category, to be compared
        gaps.append(len(columns))  # before each category
        columns.append((category, group[0].test_images(rows)))
        for renderer in group:
            if renderer.store.identity != group[0].store.identity:
                names = " and ".join(run_name(r.config) for r in (group[0], renderer))
                raise ViewnetError(f"{names} have other views: they cannot be shown the same images")
            columns.append((_label(renderer, group), renderer.displayed(renderer.reconstruct(rows))))
    lines = [list(line) for line in itertools.zip_longest(*(images for _, images in columns))]
    return image_grid(lines, columns=[title for title, _ in columns], gaps=gaps[1:])


def around(runs: Sequence[Run], stores: Stores = own_views) -> Figure:
    """Views all around one object at constant elevation: a row for each run, the appearance image first.

    Runs are grouped by variant, as in the paper; within a category all have the same object, the middle one of the test
    split. Own azimuths are shifted to the annotated ones and nothing else is aligned, so a network without a common
    frame is shown in its own.
    """
    all_renderers = renderers(runs, stores)
    several = len({r.config.category for r in all_renderers}) > 1
    angles = torch.tensor(AZIMUTHS, dtype=torch.float32)
    lines, labels = [], []
    variants = [r.config.variant for r in all_renderers]
    # Stable: categories keep their order.
    for renderer in sorted(all_renderers, key=lambda r: variants.index(r.config.variant)):
        first = renderer.views.first
        row = int(first[len(first) // 2])  # one object for all runs of a category
        frames = renderer.level(angles, torch.full_like(angles, ELEVATION))
        rendered = renderer.displayed(renderer.render(renderer.encode([row]), frames))
        lines.append([renderer.test_images([row])[0], *rendered])
        labels.append(_label(renderer, all_renderers) + (f"\n{renderer.config.category}" if several else ""))
    return image_grid(lines, labels, ["appearance", *(f"{azimuth}°" for azimuth in AZIMUTHS)], gaps=[1])


def volumes(runs: Sequence[Run], stores: Stores = own_views, count: int = 2 * ACROSS) -> Figure:
    """Images of `count` test objects, and below each its volume, all from VIEWPOINT."""
    lines: list[list[np.ndarray]] = []
    labels, gaps = [], []
    for renderer in renderers(runs, stores):
        rows = _rows(renderer, count)
        frames = look_at(view_vector(*(torch.tensor([angle]) for angle in VIEWPOINT))).expand(len(rows), 3, 3)
        size = 2 * renderer.network.config.render_size  # volumes hold more detail than images of the learned size show
        images = renderer.test_images(rows)
        rendered = renderer.displayed(renderer.render(renderer.encode(rows), renderer.in_own_frame(frames), size))
        for start in range(0, len(rows), ACROSS):
            lines += [list(part[start : start + ACROSS]) for part in (images, rendered)]
            labels += ["image", "volume"]
            gaps.append(len(lines))  # below an image and its volume
    return image_grid(lines, labels, row_gaps=gaps[:-1])


def candidate_figure(runs: Sequence[Run], stores: Stores = own_views, count: int = 1) -> Figure:
    """Figure 3 (d): `count` test images of each run, evenly spaced, and their reconstruction by every head.

    Heads stand by rising reconstruction error (equation 2), which is written below with the angle between viewpoint and
    truth. The appearance comes from the object's next view. ViewnetError without runs, and for untrained ones.
    """
    lines, captions, labels = [], [], []
    for renderer in renderers(runs, stores):
        # Neither the first nor the last.
        rows = np.linspace(0, len(renderer) - 1, count + 2).round().astype(int)[1:-1].tolist()
        angles = renderer.aligned.errors[rows]  # (N, M) degrees
        errors, rendered = candidates(renderer, rows)
        for image, of_heads, error, angle in zip(renderer.test_images(rows), rendered, errors, angles, strict=True):
            order = np.argsort(error)
            lines.append([image, *of_heads[order]])
            captions.append(["error / angle", *(f"{error[m]:.3f} / {angle[m]:.0f}°" for m in order)])
            labels.append(renderer.config.category)
    return image_grid(lines, labels, captions=captions, gaps=[1])


@torch.no_grad()
def candidates(renderer: RunRenderer, rows: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Reconstruction errors (N, M) of N test views by M heads, as in training, and the images (N, M, S, S, 3) uint8."""
    vectors, ups = renderer.heads(rows)  # (N, M, 3)
    objects = renderer.encode(renderer.next_views(rows))  # never from the target itself, as in training
    errors = renderer.reconstruction_errors(objects, rows)  # (N, M)
    images = renderer.displayed(renderer.render(objects, look_at(vectors, ups).flatten(0, 1)))  # (N M, S, S, 3)
    return errors.cpu().numpy(), images.reshape(*errors.shape, *images.shape[1:])


def causes(predicted: Floats, truth: Floats) -> np.ndarray:
    """The cause (N,), one of CAUSES, of each error of aligned view vectors (N, 3); "" where the error is below 30.

    The first that explains the predicted azimuth to within 30 degrees: the true azimuth a (then the elevation is
    wrong), a + 180 (half a turn), or 180 - a (front and back mirrored).
    """
    azimuth, estimate = plots.angles(truth)[0], plots.angles(predicted)[0]
    # Differences of azimuths in degrees, the short way round.
    near = [np.abs((estimate - a + 180) % 360 - 180) < THRESHOLD for a in (azimuth, azimuth + 180, 180 - azimuth)]
    cause = np.select(near, [CAUSES[2], CAUSES[0], CAUSES[1]], default=CAUSES[3])
    return np.where(metrics.geodesic_error(predicted, truth) < THRESHOLD, "", cause)


def by_cause(aligned: Aligned) -> dict[str, list[int]]:
    """Cause -> the rows of test views that fail by it, the worst first; of CAUSES those that occur, in their order."""
    why = causes(aligned.selected, aligned.predictions.truth)
    order = np.argsort(-aligned.selected_errors, kind="stable")  # the worst first, equal ones in the order of the store
    return {cause: [int(i) for i in order if why[i] == cause] for cause in CAUSES if cause in why}


def failures(run: Run, stores: Stores = own_views, count: int = 4) -> Figure:
    """The `count` worst failures of each cause: image, and its reconstruction at the selected viewpoint.

    The true azimuth and elevation stand under an image, the predicted ones under its reconstruction. Raises
    ViewnetError for a run without failures.
    """
    (renderer,) = renderers([run], stores)
    groups = by_cause(renderer.aligned)
    if not groups:
        raise ViewnetError(f"{run.name}: no error of {THRESHOLD:g} degrees or more: there is nothing to show")
    truth, predicted = renderer.aligned.predictions.truth, renderer.aligned.selected
    kinds = {"true": plots.angles(truth), "predicted": plots.angles(predicted)}
    lines, captions, labels = [], [], []
    for cause, failed in groups.items():
        rows = failed[:count]  # all are counted in the label
        pairs = zip(renderer.test_images(rows), renderer.displayed(renderer.reconstruct(rows)), strict=True)
        each = itertools.product(rows, kinds.items())
        lines.append(list(itertools.chain.from_iterable(pairs)))
        captions.append([f"{kind}\n{round(a[row]) % 360}°, {round(e[row])}°" for row, (kind, (a, e)) in each])
        labels.append(f"{cause}\n{len(failed)} of {len(renderer)}")
    return image_grid(lines, labels, captions=captions, gaps=range(2, 2 * count, 2))  # between image and next image


@matplotlib.rc_context(plots.STYLE)
def image_grid(
    lines: Sequence[Sequence[np.ndarray | None]],
    rows: Sequence[str] = (),
    columns: Sequence[str] = (),
    captions: Sequence[Sequence[str]] = (),
    gaps: Iterable[int] = (),
    row_gaps: Iterable[int] = (),
) -> Figure:
    """Images (H, W, 3) uint8 in a grid, None for an empty cell: labels of `rows` and `columns`, captions below images.

    Lines may differ in length. A little space is left before the columns `gaps` and the lines `row_gaps`.
    """
    titles = [_wrapped(title) for title in columns]
    left, under = 0.42 if rows else 0.04, 0.27 if captions else 0.03
    top = 0.06 + 0.12 * max((title.count("\n") + 1 for title in titles), default=0)  # inches; 0.12 a line
    x = _places(max(map(len, lines)), CELL + 0.03, gaps, left)
    y = _places(len(lines), CELL + under, row_gaps, top)
    width, height = x[-1], y[-1] + 0.02
    figure = Figure(figsize=(width, height))  # placed by hand: layouts of matplotlib leave cells of unequal sizes
    for i, j, image in ((i, j, image) for i, line in enumerate(lines) for j, image in enumerate(line)):
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
    # Wide enough to see, at little cost.
    steps = (step + (0.09 if place in wide else 0) for place in range(1, count + 1))
    return list(itertools.accumulate(steps, initial=start))


def _wrapped(label: str) -> str:
    return "\n".join(textwrap.fill(part, 13) for part in label.split("\n"))  # 13 letters are as wide as an image


def _rows(renderer: RunRenderer, count: int) -> list[int]:
    """The first views of `count` objects, or of all where there are fewer, evenly spaced over the test split."""
    first = renderer.views.first
    return first[np.linspace(0, len(first), min(count, len(first)), endpoint=False).astype(int)].tolist()


def _label(renderer: RunRenderer, among: Sequence[RunRenderer]) -> str:
    """The variant's label in the tables, with the seed where there are several of one variant and category."""
    config = renderer.config
    alike = [r for r in among if (r.config.variant, r.config.category) == (config.variant, config.category)]
    label = LABELS.get(config.variant, config.variant)
    return f"{label}\nseed {config.seed}" if len(alike) > 1 else label
