"""Errors in degrees, what is made of them, and how sure it is.

The headline error is the geodesic angle between camera frames. Two other definitions are in print and in code around
this paper; they are here by name so that an audit can compute them, and nothing else uses them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Floats

THRESHOLDS = (10, 15, 30)
FLIP = 150.0
"""An error above so many degrees is a flip: the object seen from the opposite side."""


def geodesic_error(predicted: Floats, truth: Floats, ups: Floats | None = None) -> Floats:
    """Angles (...), [0, 180] degrees, between the camera frames of view vectors (..., 3), both held level.

    With predicted up vectors `ups` (..., 3) the predicted frame has the tilt they give it; the true one stays level.

    A quarter turn around an object is 90 degrees from whatever height; view vectors alone come closer to each other:

    >>> high = np.sqrt(3) / 2  # 60 degrees above the horizon
    >>> front, left = np.array([[0.5, 0, high]]), np.array([[0, 0.5, high]])
    >>> geodesic_error(left, front).round(1), vector_error(left, front).round(1)
    (array([90.]), array([41.4]))
    """
    frames = geometry.look_at(_tensor(predicted), None if ups is None else _tensor(ups))
    return geometry.rotation_angle(frames, geometry.look_at(_tensor(truth))).numpy()


def vector_error(predicted: Floats, truth: Floats) -> Floats:
    """Angles (...) between the view vectors (..., 3) themselves: never more than the geodesic error. A diagnostic."""
    return geometry.vector_angle(_tensor(predicted), _tensor(truth)).numpy()


def folded(errors: Floats) -> Floats:
    """What the arcsine of the relative rotation's antisymmetric part makes of geodesic errors e (...): min(e, 180 - e).

    A prediction from the opposite side counts as right. For the audit of printed numbers only.

    >>> folded(np.array([10.0, 170.0]))
    array([10., 10.])
    """
    return np.minimum(errors, 180 - errors)


def scaled(errors: Floats) -> Floats:
    """What |log(A^T B)|_F / 2 makes of geodesic errors e (...): e / sqrt(2). For the audit of printed numbers only."""
    return errors / np.sqrt(2)


DEFINITIONS: dict[str, Callable[[Floats], Floats]] = {"geodesic": np.asarray, "folded": folded, "scaled": scaled}
"""Name -> what a definition of the error in print makes of geodesic errors (...). Only the first is an angle between
camera frames."""


def accuracy(errors: Floats, threshold: float) -> float:
    """Per cent of errors strictly below `threshold` degrees.

    >>> accuracy(np.array([5.0, 29.9, 30.0, 170.0]), 30)
    50.0
    """
    return 100 * float(np.mean(np.asarray(errors) < threshold))


def median(errors: Floats) -> float:
    """The median, degrees; of an even number of errors the mean of the middle two.

    >>> median(np.array([1.0, 2.0, 4.0, 90.0]))
    3.0
    """
    return float(np.median(errors))


AZIMUTH_BINS = 12
"""Of 30 degrees each, the first from 0 (supplement, Discretized Viewpoint Accuracy)."""
CONFIDENT = 10
"""A bin counts for the confidence index that has more images than this."""


def azimuth_bins(azimuths: Floats) -> NDArray[np.intp]:
    """In which of the twelve bins azimuths (N,), degrees, lie: 0 to 11.

    >>> azimuth_bins(np.array([0.0, 29.9, 30.0, 359.9]))
    array([ 0,  0,  1, 11])
    """
    return (np.floor(np.asarray(azimuths, dtype=np.float64) / (360 / AZIMUTH_BINS)) % AZIMUTH_BINS).astype(np.intp)


def bin_accuracies(errors: Floats, azimuths: Floats, threshold: float = 30) -> Floats:
    """Per cent of errors (..., N) below `threshold` degrees in each bin, not empty, of azimuths (N,): (..., B)."""
    bins, right = azimuth_bins(azimuths), np.asarray(errors) < threshold
    return np.stack([100 * right[..., bins == part].mean(axis=-1) for part in np.unique(bins)], axis=-1)


def dva(errors: Floats, azimuths: Floats) -> float:
    """Discretized viewpoint accuracy, per cent, of errors (N,) at true azimuths (N,): the mean over bins not empty.

    Three images from the front and one from the left, all but one of the front's right: 75 % of the images, but

    >>> round(dva(np.array([10.0, 10.0, 100.0, 10.0]), np.array([5.0, 6.0, 7.0, 95.0])), 1)
    83.3
    """
    return float(bin_accuracies(errors, azimuths).mean())


def confidence_index(azimuths: Floats) -> float:
    """The share of the twelve bins that hold more than ten of the true azimuths (N,), degrees.

    >>> round(confidence_index(np.repeat([15.0, 45.0, 75.0], [20, 11, 10])), 3)  # two bins of twelve
    0.167
    """
    return float(np.mean(np.bincount(azimuth_bins(azimuths), minlength=AZIMUTH_BINS) > CONFIDENT))


def flips(errors: Floats) -> float:
    """Per cent of errors over 150 degrees."""
    return 100 * float(np.mean(np.asarray(errors) > FLIP))


STATISTICS: dict[str, Callable[[Floats], float]] = {
    **{f"acc{threshold}": partial(accuracy, threshold=threshold) for threshold in THRESHOLDS},
    "median": median,
    "flips": flips,
}
"""Name -> function of errors (N,): acc10, acc15, acc30 and flips in per cent, median in degrees."""


def summary(errors: Floats) -> dict[str, float]:
    """Every one of `STATISTICS` of errors (N,).

    >>> summary(np.array([5.0, 12.0, 40.0, 175.0]))
    {'acc10': 25.0, 'acc15': 50.0, 'acc30': 50.0, 'median': 26.0, 'flips': 25.0}
    """
    return {name: statistic(errors) for name, statistic in STATISTICS.items()}


def bootstrap_intervals(
    errors: Sequence[Floats],
    objects: Sequence[NDArray[Any]],
    rng: np.random.Generator,
    draws: int = 1000,
    level: float = 0.95,
    statistics: Sequence[str] = ("acc30", "median"),
    azimuths: Sequence[Floats] = (),
) -> dict[str, tuple[float, float] | None]:
    """Percentile intervals of statistics, by resampling objects and not images: views of one object err together.

    `errors` and `objects` hold one array (N,) for each run (seed); the statistic is the mean over runs, and a draw
    takes the same objects in every run. None stands for an interval that does not exist: fewer than two objects. The
    statistic "dva" needs the true `azimuths` (N,) of each run, degrees; bins that a draw leaves empty are left out of
    its mean, as `dva` does. Raises ViewnetError for "dva" without azimuths of every run.

    >>> errors, objects = np.array([5.0, 6.0, 7.0, 90.0]), np.array(["a", "b", "c", "d"])
    >>> bootstrap_intervals([errors], [objects], np.random.default_rng(0), statistics=["acc30"])
    {'acc30': (25.0, 100.0)}
    """
    if "dva" in statistics and len(azimuths) != len(errors):
        raise ViewnetError(f"bootstrap: dva of {len(errors)} runs needs their true azimuths, got {len(azimuths)}")
    names, owners = _owners(objects)
    if len(names) < 2:
        return dict.fromkeys(statistics)
    # Sorted once, so that every resampled array is sorted and its median found at once.
    order = [np.argsort(e, kind="stable") for e in errors]
    runs = [(np.asarray(e)[o], w[o]) for e, w, o in zip(errors, owners, order, strict=True)]
    places = [(azimuth_bins(a), np.asarray(e) < 30, w) for a, e, w in zip(azimuths, errors, owners, strict=False)]
    values: dict[str, list[float]] = {name: [] for name in statistics}
    for _ in range(draws):
        times = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))
        samples = [np.repeat(e, times[w]) for e, w in runs]
        if all(len(sample) for sample in samples):
            for name in statistics:
                found = [_weighted_dva(*place, times) for place in places] if name == "dva" else None
                values[name].append(float(np.mean(found or [STATISTICS[name](sample) for sample in samples])))
    tail = 100 * (1 - level) / 2
    bounds = {name: np.percentile(v, [tail, 100 - tail]) for name, v in values.items()}
    return {name: (float(low), float(high)) for name, (low, high) in bounds.items()}


def mean_interval(
    values: Sequence[Floats], objects: Sequence[NDArray[Any]], draws: int = 1000, seed: int = 0
) -> tuple[float, float] | None:
    """95 % percentile interval of the mean over runs of the means of values (N,), by resampling objects (N,).

    A draw takes the same objects in every run. None with fewer than two objects, and for values that are NaN.
    """
    names, owners = _owners(objects)
    if len(names) < 2 or any(np.isnan(v).any() for v in values):
        return None
    drawn = np.random.default_rng(seed).integers(len(names), size=(draws, len(names)))
    times = np.stack([np.bincount(d, minlength=len(names)) for d in drawn]).astype(np.float64)  # (draws, objects)
    means = []
    for value, owner in zip(values, owners, strict=True):
        total, count = (np.bincount(owner, weights, len(names)) for weights in (value, np.ones(len(value))))
        means.append((times @ total) / np.maximum(times @ count, 1))
    low, high = np.percentile(np.mean(means, axis=0), [2.5, 97.5])
    return float(low), float(high)


def _owners(objects: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], list[NDArray[np.intp]]]:
    """The names of all objects of several runs, and the number of each image's object among them, for each run."""
    names, owner = np.unique(np.concatenate([np.asarray(o, dtype=str) for o in objects]), return_inverse=True)
    return names, np.split(owner, np.cumsum([len(o) for o in objects])[:-1])


def _weighted_dva(
    bins: NDArray[np.intp], right: NDArray[np.bool_], owner: NDArray[np.intp], times: NDArray[np.intp]
) -> float:
    """`dva` of images (N,) that each count as often as their owner was drawn."""
    weights = times[owner].astype(np.float64)
    total, hits = (np.bincount(bins, w, AZIMUTH_BINS) for w in (weights, weights * right))
    return 100 * float((hits[total > 0] / total[total > 0]).mean())


def _tensor(values: Floats) -> torch.Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float64))
