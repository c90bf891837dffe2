"""Predictors that need no training: from the index of a view store to Predictions of its splits "val" and "test"."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from viewnet import geometry
from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import draw_calibration
from viewnet.evaluation.predictions import Floats, Predictions, object_names, true_vectors

RIDGE = 1e3  # of the view regression, chosen on real cars with SqueezeNet's features
SPLITS = ("val", "test")


def constant(index: pd.DataFrame, source: str = "train", mean: str = "vector") -> Predictions:
    """The mean viewpoint of the split `source`, for every image (the rows "Constant").

    The supplement takes the mean over training data, the main text over validation data. There are two means, `mean`,
    which agree where viewpoints lie close together; of cameras all around an object, whose azimuths cancel out,

    vector    the mean view vector, normalised, points to the sky, where no camera was
    rotation  the level camera frame closest to those of `source` (Frobenius) has their mean elevation

    Raises ViewnetError for a missing split, an unknown mean, and where view vectors cancel out altogether.
    """
    mean_of = MEANS[known(mean, MEANS, "mean")]
    return _same_for_all(index, mean_of(true_vectors(_rows(index, (source,)))))


def mean_vector(truth: Floats) -> Floats:
    """The normalised mean (3,) of view vectors (N, 3). ViewnetError where they cancel out."""
    mean = truth.mean(axis=0)
    if (length := float(np.linalg.norm(mean))) < 1e-9:
        raise ViewnetError("constant predictor: the viewpoints cancel out, so they have no mean direction")
    return mean / length


def mean_level_view(truth: Floats) -> Floats:
    """The view vector (3,) of the level camera frame closest to those of view vectors (N, 3), in squared entries.

    It has the largest sum of products of entries with the mean of the frames, (right, up, back). At a given azimuth
    it is a + b cos(e) + c sin(e), largest at the elevation atan2(c, b): only the azimuth is searched, to 0.01 degrees.
    """
    right, up, back = geometry.look_at(torch.from_numpy(np.array(truth))).numpy().mean(axis=0).T  # (3,) each
    angles = np.deg2rad(np.arange(0, 360, 0.01))
    c, s = np.cos(angles), np.sin(angles)  # (36000,)
    level = (up[2] + c * back[0] + s * back[1]).clip(min=0)  # or the frame would be upside down: 90 degrees is best
    height = back[2] - c * up[0] - s * up[1]
    best = int(np.argmax(c * right[1] - s * right[0] + np.hypot(level, height)))
    elevation = np.arctan2(height[best], level[best])
    return np.array([np.cos(elevation) * c[best], np.cos(elevation) * s[best], np.sin(elevation)])


MEANS = {"vector": mean_vector, "rotation": mean_level_view}


def view_regression(
    index: pd.DataFrame, features: NDArray[np.float32], ridge: float = RIDGE, source: str = "val"
) -> Predictions:
    """Ridge regression from features (N, D), in the order of `index`, to view vectors (the row "VGG view").

    Fitted on "val" it is SSV's setup: no more labels than the alignment of unsupervised predictions uses (see
    `calibrating`). `ridge` is the weight of squared coefficients against the sum of squared errors, with features and
    view vectors centred. Raises ViewnetError for features that do not fit the index and a `ridge` not above 0.
    """
    if features.ndim != 2 or len(features) != len(index):
        raise ViewnetError(f"view regression: features are {features.shape} for {len(index)} images")
    if not ridge > 0:
        raise ViewnetError(f"ridge {ridge}: expected more than 0: features outnumber the images to fit on")
    ids, fit = _rows(index), (index["split"] == source).to_numpy()
    x, y = features[fit].astype(np.float64), true_vectors(_rows(index, (source,)))  # (n, D), (n, 3)
    x_mean, y_mean = x.mean(axis=0), y.mean(axis=0)  # (D,), (3,)
    x -= x_mean
    # Solved in the space of the images, which are far fewer than features.
    dual = np.linalg.solve(x @ x.T + ridge * np.eye(len(x)), y - y_mean)  # (n, 3)
    vectors = (features[index["split"].isin(SPLITS).to_numpy()] - x_mean) @ (x.T @ dual) + y_mean
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    if (lengths < 1e-12).any():
        raise ViewnetError("view regression: a prediction is the zero vector, which has no direction: use more images")
    return Predictions(ids, (vectors / lengths)[:, None], np.zeros((len(ids), 1)))


def calibrating(index: pd.DataFrame, count: int | None = None, seed: int = 0) -> NDArray[np.bool_]:
    """A mask (N,) of an index without the images of "val" that are not among `count` calibration images (None: all).

    A baseline fitted on them uses the labels that an alignment does. ViewnetError as of `alignment.draw_calibration`.
    """
    mask = (index["split"] != "val").to_numpy(copy=True)
    val = np.flatnonzero(~mask)
    mask[val[draw_calibration(object_names(index.iloc[val]), count, seed)]] = True
    return mask


def best_constant(index: pd.DataFrame) -> Predictions:
    """The one viewpoint that is within 30 degrees (geodesic) of the most training views, on a grid of 2 degrees.

    The strongest constant: the mean of viewpoints all around an object points to the sky, where no camera was.
    """
    truth = geometry.look_at(torch.from_numpy(true_vectors(_rows(index, ("train",)))))  # (N, 3, 3)
    azimuths, elevations = (torch.arange(start, end, 2, dtype=torch.float64) for start, end in ((0, 360), (-88, 90)))
    grid = geometry.view_vector(*torch.cartesian_prod(azimuths, elevations).unbind(1))  # (G, 3)
    # The angle of A^T B is below t where its trace, the sum of products of entries, exceeds 1 + 2 cos t.
    bound = 1 + 2 * np.cos(np.deg2rad(30))
    frames, flat = geometry.look_at(grid).reshape(-1, 9), truth.reshape(-1, 9).T  # (G, 9), (9, N)
    hits = torch.cat([(part @ flat > bound).double().mean(1) for part in frames.split(500)])  # (G,)
    return _same_for_all(index, grid[hits.argmax()].numpy())


def random(index: pd.DataFrame, seed: int = 0) -> Predictions:
    """One viewpoint per image, uniform in azimuth and in elevation from -20 to 40 degrees, from `seed`."""
    ids, rng = _rows(index), np.random.default_rng(seed)
    azimuth, elevation = (torch.from_numpy(rng.uniform(*bounds, (len(ids), 1))) for bounds in ((0, 360), (-20, 40)))
    return Predictions(ids, geometry.view_vector(azimuth, elevation).numpy(), rng.standard_normal((len(ids), 1)))


def oracle(index: pd.DataFrame, rotation: Floats | None = None) -> Predictions:
    """The true viewpoints, in a frame rotated by `rotation` (3, 3): what alignment must undo."""
    ids = _rows(index)
    vectors = true_vectors(ids) if rotation is None else true_vectors(ids) @ np.asarray(rotation).T  # (N, 3)
    return Predictions(ids, vectors[:, None], np.zeros((len(ids), 1)))


def _rows(index: pd.DataFrame, splits: tuple[str, ...] = SPLITS) -> pd.DataFrame:
    if missing := [split for split in splits if not (index["split"] == split).any()]:
        raise ViewnetError(f"view store: no views of split {missing[0]!r}")
    return index[index["split"].isin(splits)]


def _same_for_all(index: pd.DataFrame, vector: Floats) -> Predictions:
    ids = _rows(index)
    return Predictions(ids, np.broadcast_to(vector, (len(ids), 1, 3)), np.zeros((len(ids), 1)))


# Fitted on training views, by variant: runs of the run store (viewnet.runs.run_store.untrained).
UNTRAINED: dict[str, Callable[[pd.DataFrame], Predictions]] = {
    "constant": constant,
    "best_constant": best_constant,
    "random": random,
}
# Fitted on calibration photographs, the split "val"; "photographs" is the truth, to describe the set.
ON_CALIBRATION: dict[str, Callable[[pd.DataFrame], Predictions]] = {
    "constant": partial(constant, source="val"),
    "constant_rotation": partial(constant, source="val", mean="rotation"),
    "photographs": oracle,
    "random": random,
}
