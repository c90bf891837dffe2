"""Failures of a run by cause: how far a wrong viewpoint is explained by a flip, with images of the worst."""

import itertools

import numpy as np
from matplotlib.figure import Figure

from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.evaluate import Aligned
from viewnet.evaluation.predictions import Floats
from viewnet.evaluation.run import Run
from viewnet.tables.image_grids import image_grid
from viewnet.tables.plots import angles
from viewnet.tables.run_renderer import Stores, own_views, renderers

# Degrees: an error of this size or more is a failure, and a cause explains an azimuth to within less than this.
THRESHOLD = 30.0
CAUSES = ("half a turn", "front and back mirrored", "elevation", "other")


def causes(predicted: Floats, truth: Floats) -> np.ndarray:
    """The cause (N,), one of CAUSES, of each error of aligned view vectors (N, 3); "" where the error is below 30.

    The first that explains the predicted azimuth to within 30 degrees: the true azimuth a (then the elevation is
    wrong), a + 180 (half a turn), or 180 - a (front and back mirrored).
    """
    azimuth, estimate = angles(truth)[0], angles(predicted)[0]
    # Differences of azimuths in degrees, the short way round.
    near = [np.abs((estimate - a + 180) % 360 - 180) < THRESHOLD for a in (azimuth, azimuth + 180, 180 - azimuth)]
    cause = np.select(near, [CAUSES[2], CAUSES[0], CAUSES[1]], default=CAUSES[3])
    return np.where(metrics.geodesic_error(predicted, truth) < THRESHOLD, "", cause)


def by_cause(aligned: Aligned) -> dict[str, list[int]]:
    """Cause -> the rows of test views that fail by it, the worst first; of CAUSES those that occur, in their order."""
    why = causes(aligned.selected, aligned.predictions.truth)
    order = np.argsort(-aligned.selected_errors, kind="stable")  # the worst first, equal ones in the order of the store
    return {cause: [int(i) for i in order if why[i] == cause] for cause in CAUSES if cause in why}


def gallery(run: Run, stores: Stores = own_views, count: int = 4) -> Figure:
    """The `count` worst failures of each cause: image, and its reconstruction at the selected viewpoint.

    The true azimuth and elevation stand under an image, the predicted ones under its reconstruction. Raises
    ViewnetError for a run without failures.
    """
    (renderer,) = renderers([run], stores)
    groups = by_cause(renderer.aligned)
    if not groups:
        raise ViewnetError(f"{run.name}: no error of {THRESHOLD:g} degrees or more: there is nothing to show")
    kinds = {"true": angles(renderer.aligned.predictions.truth), "predicted": angles(renderer.aligned.selected)}
    lines, captions, labels = [], [], []
    for cause, failed in groups.items():
        rows = failed[:count]  # all are counted in the label
        pairs = zip(renderer.test_images(rows), renderer.displayed(renderer.reconstruct(rows)), strict=True)
        each = itertools.product(rows, kinds.items())
        texts = (f"{kind}\n{round(a[row]) % 360}°, {round(e[row])}°" for row, (kind, (a, e)) in each)
        lines.append(list(itertools.chain.from_iterable(pairs)))
        captions.append(list(texts))
        labels.append(f"{cause}\n{len(failed)} of {len(renderer)}")
    return image_grid(lines, labels, captions=captions, gaps=range(2, 2 * count, 2))  # between image and next image
