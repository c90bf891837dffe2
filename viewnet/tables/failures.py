"""What goes wrong where viewpoints are wrong: the worst errors of a run by cause, images beside drawings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from matplotlib.figure import Figure

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.evaluate import Aligned
from viewnet.evaluation.predictions import Floats
from viewnet.evaluation.run import Run
from viewnet.tables.image_grids import image_grid
from viewnet.tables.run_renderer import Stores, own_views, renderers

THRESHOLD = 30.0
"""Degrees: an error of so much or more is a failure, and a cause explains an azimuth to within so much."""
CAUSES = ("half a turn", "front and back mirrored", "elevation", "other")


def causes(predicted: Floats, truth: Floats) -> np.ndarray:
    """The cause (N,), one of CAUSES, of each error of aligned view vectors (N, 3); "" where the error is below 30.

    Azimuths tell, whatever the elevations, by what explains the predicted one to within 30 degrees: if a, the true one,
    the elevation is wrong; if a + 180, it is half a turn; if 180 - a, front and back are mirrored. Where the last is
    one of the others too, from the side or from the front and from behind, it is the other that counts.
    """
    (azimuth, _), (said, _) = _angles(truth), _angles(predicted)
    turned, mirrored, same = (_apart(said, a) < THRESHOLD for a in (azimuth + 180, 180 - azimuth, azimuth))
    found = np.select([same, turned, mirrored], [CAUSES[2], CAUSES[0], CAUSES[1]], default=CAUSES[3])
    return np.where(metrics.geodesic_error(predicted, truth) < THRESHOLD, "", found)


@dataclass(frozen=True)
class Failures:
    """The failures of one cause: the rows of test views, the worst first, and how many views there are in all."""

    cause: str
    rows: list[int]
    views: int


def by_cause(aligned: Aligned) -> list[Failures]:
    """Failures by cause, in the order of CAUSES, causes without any left out."""
    why, order = (
        causes(aligned.selected, aligned.predictions.truth),
        np.argsort(-aligned.selected_errors, kind="stable"),
    )
    groups = [Failures(cause, [int(i) for i in order if why[i] == cause], len(why)) for cause in CAUSES]
    return [group for group in groups if group.rows]


def gallery(run: Run, stores: Stores = own_views, count: int = 4) -> Figure:
    """The `count` worst failures of each cause: image, and what is drawn of it at the selected viewpoint.

    Under an image stands the true viewpoint, under its drawing the predicted one: azimuth, elevation. Raises
    ViewnetError for a run without failures.
    """
    (drawer,) = renderers([run], stores)
    groups = by_cause(drawer.aligned)
    if not groups:
        raise ViewnetError(f"{run.name}: no error of {THRESHOLD:g} degrees or more: there is nothing to show")
    true, said = (_angles(vectors) for vectors in (drawer.aligned.predictions.truth, drawer.aligned.selected))
    lines, captions, labels = [], [], []
    for group in groups:
        rows = group.rows[:count]
        images, drawn = drawer.shown(rows), drawer.painted(drawer.reconstruct(rows))
        line: list[np.ndarray | None] = []
        told: list[str] = []
        for row, image, drawing in zip(rows, images, drawn, strict=True):
            line += [image, drawing]
            told += [_told("true", true, row), _told("predicted", said, row)]
        empty = 2 * (count - len(rows))
        lines.append(line + [None] * empty)
        captions.append(told + [""] * empty)
        labels.append(f"{group.cause}\n{len(group.rows)} of {group.views}")
    return image_grid(lines, labels, captions=captions, gaps=range(2, 2 * count, 2))


def _told(what: str, angles: tuple[Floats, Floats], row: int) -> str:
    azimuth, elevation = round(angles[0][row]) % 360, round(angles[1][row])
    return f"{what}\n{azimuth}°, {elevation}°"


def _angles(vectors: Floats) -> tuple[Floats, Floats]:
    azimuth, elevation = geometry.azimuth_elevation(torch.from_numpy(np.array(vectors)))
    return azimuth.numpy(), elevation.numpy()


def _apart(one: Floats, other: Floats) -> Floats:
    """Degrees between azimuths (N,), the short way round."""
    return np.abs((one - other + 180) % 360 - 180)
