"""Synthetic indices of view stores and predictions, for tests of everything after the checkpoint."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from viewnet.evaluation.predictions import Predictions, true_vectors


def make_index(
    models: int = 60,
    views: int = 5,
    category: str = "car",
    seed: int = 0,
    splits: tuple[tuple[str, float], ...] = (("train", 0.5), ("val", 0.25), ("test", 0.25)),
) -> pd.DataFrame:
    """Azimuth uniform, elevation U[-20, 40], as the paper's renders."""
    rng = np.random.default_rng(seed)
    bounds = np.cumsum([0, *(share for _, share in splits)]) * models
    split_of = [splits[int(np.searchsorted(bounds, m, side="right")) - 1][0] for m in range(models)]
    return pd.DataFrame(
        {
            "model_id": np.repeat([f"{m:05d}" for m in range(models)], views),
            "category": category,
            "split": np.repeat(split_of, views),
            "view": np.tile(np.arange(views), models),
            "azimuth": rng.uniform(0, 360, models * views),
            "elevation": rng.uniform(-20, 40, models * views),
        }
    )


def noisy(
    index: pd.DataFrame, degrees: float = 5.0, heads: int = 3, seed: int = 0, mirrored: bool = False
) -> Predictions:
    """The truth in a random frame, jittered; the first head is right, the second faces back, the rest are random."""
    rng = np.random.default_rng(seed)
    ids = index[index["split"].isin(["val", "test"])]
    truth = true_vectors(ids)
    if mirrored:
        truth = truth * [1, -1, 1]
    turn = Rotation.random(rng=rng).as_matrix()
    hypotheses = rng.standard_normal((len(ids), heads, 3))
    jitter = np.deg2rad(degrees) / np.sqrt(2)
    hypotheses[:, 0] = truth + jitter * rng.standard_normal(truth.shape)
    if heads > 1:
        hypotheses[:, 1] = truth * [-1, -1, 1]
    hypotheses = hypotheses @ turn.T
    hypotheses /= np.linalg.norm(hypotheses, axis=-1, keepdims=True)
    logits = rng.standard_normal((len(ids), heads))
    logits[:, 0] += 2.0
    return Predictions(ids, hypotheses, logits)
