"""Errors of viewpoints in degrees, statistics of them, and bootstrap intervals.

The error is the geodesic angle between camera frames. Other definitions are for the audit of reported numbers only.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Floats

THRESHOLDS = (10, 15, 30)  # degrees
FLIP = 150.0  # degrees above which an error is a flip: the object seen from the opposite side
AZIMUTH_BINS = 12  # of 30 degrees, the first from 0 (supplement, Discretized Viewpoint Accuracy)
CONFIDENT = 10  # bins with more images than this count for the confidence index


def geodesic_error(predicted: Floats, truth: Floats, ups: Floats | None = None, turns: int = 1) -> Floats:
    """Angles (...), [0, 180] degrees, between the level camera frames of view vectors (..., 3).

    With predicted up vectors `ups` (..., 3) the predicted frame is tilted by them; the true one stays level. `turns` of
    the object count as one viewpoint, see viewnet.evaluation.symmetry.

    A quarter turn around an object is 90 degrees at any height, while the angle between view vectors is smaller:

    >>> high = np.sqrt(3) / 2  # 60 degrees above the horizon
    >>> front, left = np.array([[0.5, 0, high]]), np.array([[0, 0.5, high]])
    >>> geodesic_error(left, front).round(1), vector_error(left, front).round(1)
    (array([90.]), array([41.4]))
    """
    frames = geometry.look_at(_tensor(predicted), None if ups is None else _tensor(ups))
    return geometry.rotation_angle(frames, geometry.look_at(_tensor(truth)), turns).numpy()


def vector_error(predicted: Floats, truth: Floats) -> Floats:
    """Angles (...) between view vectors (..., 3), never more than the geodesic error. A diagnostic."""
    return geometry.vector_angle(_tensor(predicted), _tensor(truth)).numpy()


def folded(errors: Floats) -> Floats:
    """Geodesic errors e (...) as the arcsine of the relative rotation's antisymmetric part gives them: min(e, 180 - e).

    Counts a prediction from the opposite side as right.
    """
    return np.minimum(errors, 180 - errors)


def scaled(errors: Floats) -> Floats:
    """Geodesic errors e (...) as |log(A^T B)|_F / 2 gives them: e / sqrt(2)."""
    return errors / np.sqrt(2)


def clustering(flags: NDArray[np.bool_], objects: NDArray[Any]) -> float:
    """How much flags (N,) of views are a matter of their objects (N,): 0 tossed for view by view, 1 the same on each.

    The intraclass correlation by pairs of views of one object; NaN where all flags are alike, or no object has two.

    >>> objects = np.array(["a", "a", "b", "b"])
    >>> clustering(np.array([True, True, False, False]), objects), clustering(np.array([True, False] * 2), objects)
    (1.0, -1.0)
    """
    parts = np.unique(objects, return_inverse=True)[1]
    apart = flags - np.mean(flags)  # (N,)
    views, sums, squares = (np.bincount(parts, weights) for weights in (None, apart, apart**2))  # (O,) each
    pairs = float((views * (views - 1)).sum())
    spread = float(np.mean(apart**2))
    return float((sums**2 - squares).sum() / pairs / spread) if pairs and spread else float("nan")


DEFINITIONS: dict[str, Callable[[Floats], Floats]] = {"geodesic": np.asarray, "folded": folded, "scaled": scaled}
"""Definitions in the literature, as functions of geodesic errors (...); only the first is an angle between frames."""


def hits(errors: Floats) -> Floats:
    """Whether geodesic errors (...) are right for Acc@30, in per cent: 100 or 0, so that their mean is the accuracy."""
    return np.where(np.asarray(errors) < 30, 100.0, 0.0)


def accuracy(errors: Floats, threshold: float) -> float:
    """Accuracy: per cent of errors strictly below `threshold` degrees (Acc@30)."""
    return 100 * float(np.mean(np.asarray(errors) < threshold))


def median(errors: Floats) -> float:
    """The median error in degrees; of an even number the mean of the middle two."""
    return float(np.median(errors))


def azimuth_bins(azimuths: Floats) -> NDArray[np.intp]:
    """The bins, 0 to 11, of azimuths (N,) in degrees."""
    return (np.floor(np.asarray(azimuths, dtype=np.float64) / (360 / AZIMUTH_BINS)) % AZIMUTH_BINS).astype(np.intp)


def bin_accuracies(errors: Floats, azimuths: Floats, threshold: float = 30) -> Floats:
    """Per cent of errors (..., N) below `threshold` degrees in each non-empty bin of azimuths (N,): (..., B)."""
    bins, correct = azimuth_bins(azimuths), np.asarray(errors) < threshold
    return np.stack([100 * correct[..., bins == part].mean(axis=-1) for part in np.unique(bins)], axis=-1)


def dva(errors: Floats, azimuths: Floats) -> float:
    """Discretized viewpoint accuracy, per cent, of errors (N,) at true azimuths (N,): the mean over non-empty bins.

    Two of three images from the front and one of one from the left are right: 75 % of the images, but

    >>> round(dva(np.array([10.0, 10.0, 100.0, 10.0]), np.array([5.0, 6.0, 7.0, 95.0])), 1)
    83.3
    """
    return float(bin_accuracies(errors, azimuths).mean())


def confidence_index(azimuths: Floats) -> float:
    """The share of the twelve bins that hold more than ten of the true azimuths (N,), degrees."""
    return float(np.mean(np.bincount(azimuth_bins(azimuths), minlength=AZIMUTH_BINS) > CONFIDENT))


COUNTED: dict[str, Callable[[Floats], NDArray[np.bool_]]] = {
    **{f"acc{threshold}": partial(np.greater, threshold) for threshold in THRESHOLDS},
    "flips": partial(np.less, FLIP),
}
"""Statistics that are the share of errors (N,) of which something is true, in per cent: what that is."""
STATISTICS: dict[str, Callable[[Floats], float]] = {
    **{f"acc{threshold}": partial(accuracy, threshold=threshold) for threshold in THRESHOLDS},
    "median": median,
    "flips": lambda errors: 100 * float(np.mean(COUNTED["flips"](errors))),
}
"""Statistics of errors (N,) by name: acc10, acc15, acc30 and flips in per cent, median in degrees."""


def summary(errors: Floats, azimuths: Floats) -> dict[str, float]:
    """Of errors (N,) at true azimuths (N,), degrees: all `STATISTICS`, then "dva" and "confidence_index"."""
    of_errors = {name: statistic(errors) for name, statistic in STATISTICS.items()}
    return of_errors | {"dva": dva(errors, azimuths), "confidence_index": confidence_index(azimuths)}


def bootstrap_intervals(
    errors: Sequence[Floats],
    objects: Sequence[NDArray[Any]],
    draws: int = 1000,
    statistics: Sequence[str] = ("acc30", "median"),
    azimuths: Sequence[Floats] = (),
    seed: int = 0,
) -> dict[str, tuple[float, float] | None]:
    """95 % percentile intervals of statistics by resampling runs (seeds) and objects.

    Objects, since errors of one object's views are correlated. `errors` and `objects` hold one array (N,) for each run;
    the statistic is the mean over runs, and a draw takes as many runs, with replacement, and the same objects in each.
    None where there are fewer than two objects. ViewnetError for the statistic "dva" without the true `azimuths` (N,),
    degrees, of every run; bins that a draw leaves empty do not count.
    """
    if "dva" in statistics and len(azimuths) != len(errors):
        raise ViewnetError(f"bootstrap: dva of {len(errors)} runs needs their true azimuths, got {len(azimuths)}")
    names, owners = _owners(objects)
    if len(names) < 2 or not statistics:
        return dict.fromkeys(statistics)
    times, shares, _ = _resamples(len(names), len(errors), draws, seed)  # (draws, K), (draws, R)
    values: dict[str, list[Floats]] = {name: [] for name in statistics}  # for each run (draws,)
    for run, (error, owner) in enumerate(zip(errors, owners, strict=True)):
        bins = azimuth_bins(azimuths[run]) if "dva" in statistics else None
        for name, of_runs in values.items():
            of_runs.append(_of_draws(name, np.asarray(error), owner, times, bins))
    whole = ~np.isnan(next(iter(values.values()))).any(axis=0)  # a run without any of the drawn objects has none
    bounds = {
        name: np.percentile((shares.T * of_runs).sum(axis=0)[whole], [2.5, 97.5]) for name, of_runs in values.items()
    }  # of 95 %
    return {name: (float(low), float(high)) for name, (low, high) in bounds.items()}


def _of_draws(
    name: str, errors: Floats, owner: NDArray[np.intp], times: NDArray[np.intp], bins: NDArray[np.intp] | None
) -> Floats:
    """A statistic (draws,) of errors (N,), each counted as often as its object is drawn; NaN where none is.

    `times` (draws, K), `owner` (N,); the statistic "dva" needs the `bins` (N,) of true azimuths.
    """
    with np.errstate(invalid="ignore"):  # 0 / 0
        if name == "median":
            order = np.argsort(errors, kind="stable")  # (N,)
            ends = np.cumsum(times[:, owner[order]], axis=1)  # (draws, N), where the copies of each error end
            middle = [(ends[:, -1:] - 1) // 2, ends[:, -1:] // 2]  # (draws, 1) each
            places = [(ends <= place).sum(axis=1).clip(max=len(order) - 1) for place in middle]  # (draws,)
            found = sum(errors[order][place] for place in places) / 2  # (draws,)
            return np.where(ends[:, -1] > 0, found, np.nan)
        parts = bins if name == "dva" and bins is not None else np.zeros(len(errors), dtype=np.intp)
        flags = COUNTED["acc30" if name == "dva" else name](errors)  # (N,)
        shape = (times.shape[1], AZIMUTH_BINS)
        cells = owner * AZIMUTH_BINS + parts  # (N,), of objects and bins
        right, all_ = (np.bincount(cells, weights, np.prod(shape)).reshape(shape) for weights in (flags, None))
        drawn = times @ all_  # (draws, 12), images
        of_bins = (times @ right) / np.maximum(drawn, 1)
        return 100 * of_bins.sum(axis=1) / (drawn > 0).sum(axis=1)  # (draws,), over bins that are not empty


def mean_interval(
    values: Sequence[Floats], objects: Sequence[NDArray[Any]], draws: int = 1000, minus: Sequence[Floats] = ()
) -> tuple[float, float] | None:
    """95 % percentile interval of the mean over runs of means of values (N,), by resampling runs and objects (N,).

    `minus` are the values of runs of another row, whose mean is subtracted. A draw takes the same objects for both
    rows, since one object is hard for either, and runs of each by themselves; `objects` then has those of `values`
    first. None with fewer than two objects, and for values that are NaN.
    """
    names, owners = _owners(objects)
    if len(names) < 2 or any(np.isnan(v).any() for v in values):
        return None
    drawn, shares, others = _resamples(len(names), len(values), draws, 0, len(minus))  # (draws, K), (draws, R or R')
    times = drawn.astype(np.float64)
    means = _means(values, owners[: len(values)], times, shares)  # (draws,)
    if minus:
        means -= _means(minus, owners[len(values) :], times, others)
    low, high = np.percentile(means, [2.5, 97.5])  # of 95 %
    return float(low), float(high)


def _means(values: Sequence[Floats], owners: Sequence[NDArray[np.intp]], times: Floats, shares: Floats) -> Floats:
    """Of each draw, (draws,), the mean over runs, by their `shares` (draws, R), of means of values (N,).

    An image counts as often as its object is drawn: `times` (draws, K), `owners` (N,) for each run.
    """
    means = []
    for value, owner in zip(values, owners, strict=True):
        total, count = (np.bincount(owner, each, times.shape[1]) for each in (value, np.ones(len(value))))  # (K,)
        means.append((times @ total) / np.maximum(times @ count, 1))  # (draws,)
    return np.sum(shares.T * means, axis=0)  # (draws,)


@lru_cache(maxsize=16)  # rows of one table have the same objects
def _resamples(
    objects: int, runs: int, draws: int, seed: int, others: int = 0
) -> tuple[NDArray[np.intp], Floats, Floats]:
    """How often each draw takes each object, with replacement, (draws, objects), and the shares of runs (draws, runs).

    Then those of the runs of another row, (draws, others).
    """
    rng = np.random.default_rng(seed)
    times, (shares, other_shares) = np.empty((draws, objects), np.intp), (np.empty((draws, n)) for n in (runs, others))
    for of_objects, of_runs in zip(times, shares, strict=True):
        of_objects[:] = np.bincount(rng.integers(objects, size=objects), minlength=objects)
        of_runs[:] = _shares(runs, rng)
    for of_runs in other_shares if others else ():
        of_runs[:] = _shares(others, rng)
    for array in (times, shares, other_shares):
        array.flags.writeable = False  # it is kept
    return times, shares, other_shares


def _shares(runs: int, rng: np.random.Generator) -> Floats:
    """The share of each of so many runs (runs,) in a draw of as many, with replacement."""
    return np.bincount(rng.integers(runs, size=runs), minlength=runs) / runs


def _owners(objects: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], list[NDArray[np.intp]]]:
    """The names of all objects of several runs, and the number of each image's object among them, for each run."""
    names, owner = np.unique(np.concatenate([np.asarray(o, dtype=str) for o in objects]), return_inverse=True)
    return names, np.split(owner, np.cumsum([len(o) for o in objects])[:-1])


def _tensor(values: Floats) -> torch.Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float64))
