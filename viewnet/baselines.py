"""Predictors that need no training. Each returns Predictions, to be scored by the same function as ViewNet."""

from __future__ import annotations

import numpy as np
import pandas as pd
import torch

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.predictions import Floats, Predictions, true_vectors


def constant(index: pd.DataFrame, splits: tuple[str, ...] = ("val", "test")) -> Predictions:
    """The normalised mean view vector of the training views, for every image (the rows "Constant").

    `index` has the columns of a view store; its "train" rows give the constant, its rows of `splits` are predicted. The
    supplement takes the mean over training data, the main text over validation data; training is used here.
    """
    mean = true_vectors(_rows(index, ("train",))).mean(axis=0)
    if (length := float(np.linalg.norm(mean))) < 1e-9:
        raise ViewnetError("constant predictor: the training viewpoints cancel out, so they have no mean direction")
    return _same(index, splits, mean / length)


def best_constant(index: pd.DataFrame, splits: tuple[str, ...] = ("val", "test")) -> Predictions:
    """The one viewpoint that is within 30 degrees (geodesic) of the most training views, on a grid of 2 degrees.

    The mean of viewpoints all around an object points to the sky, where no camera was; this is the strongest constant.
    """
    truth = geometry.look_at(torch.from_numpy(true_vectors(_rows(index, ("train",)))))
    azimuth, elevation = torch.meshgrid(
        torch.arange(0.0, 360.0, 2.0, dtype=torch.float64),
        torch.arange(-88.0, 90.0, 2.0, dtype=torch.float64),
        indexing="ij",
    )
    grid = geometry.view_vector(azimuth.reshape(-1), elevation.reshape(-1))
    # The angle of A^T B is below t where its trace, the sum of products of entries, exceeds 1 + 2 cos t.
    bound = 1 + 2 * np.cos(np.deg2rad(30))
    frames, flat = geometry.look_at(grid).reshape(-1, 9), truth.reshape(-1, 9).T
    hits = torch.cat([(part @ flat > bound).double().mean(1) for part in frames.split(500)])
    return _same(index, splits, grid[hits.argmax()].numpy())


def random(
    index: pd.DataFrame,
    splits: tuple[str, ...] = ("val", "test"),
    seed: int = 0,
    heads: int = 1,
    azimuth_range: tuple[float, float] = (0.0, 360.0),
    elevation_range: tuple[float, float] = (-20.0, 40.0),
) -> Predictions:
    """`heads` viewpoints an image, uniform in azimuth and in elevation within the ranges (degrees), from `seed`."""
    ids, rng = _rows(index, splits), np.random.default_rng(seed)
    azimuth = torch.from_numpy(rng.uniform(*azimuth_range, (len(ids), heads)))
    elevation = torch.from_numpy(rng.uniform(*elevation_range, (len(ids), heads)))
    return Predictions(ids, geometry.view_vector(azimuth, elevation).numpy(), rng.standard_normal((len(ids), heads)))


def oracle(
    index: pd.DataFrame, splits: tuple[str, ...] = ("val", "test"), rotation: Floats | None = None
) -> Predictions:
    """The true viewpoints, in a frame turned by `rotation` (3, 3): what alignment must undo."""
    ids = _rows(index, splits)
    vectors = true_vectors(ids) if rotation is None else true_vectors(ids) @ np.asarray(rotation).T
    return Predictions(ids, vectors[:, None], np.zeros((len(ids), 1)))


def _rows(index: pd.DataFrame, splits: tuple[str, ...]) -> pd.DataFrame:
    for split in splits:
        if not (index["split"] == split).any():
            raise ViewnetError(f"view store: no views of split {split!r}")
    return index[index["split"].isin(splits)]


def _same(index: pd.DataFrame, splits: tuple[str, ...], vector: Floats) -> Predictions:
    ids = _rows(index, splits)
    return Predictions(ids, np.broadcast_to(vector, (len(ids), 1, 3)), np.zeros((len(ids), 1)))
