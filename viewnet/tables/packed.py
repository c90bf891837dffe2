"""Predictions as they are kept beside a table: with few digits, so that files are small."""

import numpy as np
import pandas as pd
import torch

from viewnet import geometry
from viewnet.evaluation.predictions import ID_COLUMNS, Floats, Predictions

STEP = 2.0**-10
"""Of angles in degrees, and of logits: kept are multiples of it."""
ANGLES = ("azimuth", "elevation")


def packed(predictions: Predictions) -> pd.DataFrame:
    """A column for each number: the ids, then logit_0, h0_azimuth, h0_elevation (up0_azimuth, up0_elevation) and so on.

    Viewpoints move by less than 0.001 degrees. Logits are less the largest of their image, and every choice stays.
    """
    below = predictions.logits - predictions.logits.max(axis=1, keepdims=True)  # (N, M)
    parts = {"logit_{}": np.where(below < 0, np.minimum(_in_steps(below), -STEP), 0.0)}
    for name, vectors in (("h{}", predictions.hypotheses), ("up{}", predictions.ups)):
        if vectors is not None:
            angles = geometry.azimuth_elevation(torch.tensor(vectors))  # (N, M) each
            parts |= {f"{name}_{angle}": _in_steps(x.numpy()) for angle, x in zip(ANGLES, angles, strict=True)}
    numbers = {name.format(m): x[:, m] for m in range(predictions.heads) for name, x in parts.items()}
    return predictions.ids.assign(**numbers)


def single(frame: pd.DataFrame) -> pd.DataFrame:
    """The same in single precision, as files have it."""
    return frame.astype(dict.fromkeys(frame.columns[frame.dtypes == "float64"], "float32"))


def unpacked(frame: pd.DataFrame) -> Predictions:
    """The predictions of `packed`, or of Predictions.to_frame as once kept. KeyError for a missing column."""
    if "h0_x" in frame:
        return Predictions.from_frame(frame)
    heads = range(sum(name.startswith("logit_") for name in frame.columns))

    def vectors(name: str) -> Floats:
        columns = ([f"{name}{m}_{angle}" for m in heads] for angle in ANGLES)
        azimuth, elevation = (torch.tensor(frame[each].to_numpy(np.float64)) for each in columns)
        return geometry.view_vector(azimuth, elevation).numpy()  # (N, M, 3)

    ups = vectors("up") if "up0_azimuth" in frame else None
    return Predictions(frame[list(ID_COLUMNS)], vectors("h"), frame[[f"logit_{m}" for m in heads]].to_numpy(), ups)


def as_kept(predictions: Predictions) -> Predictions:
    """What whoever reads the file of these predictions gets."""
    return unpacked(single(packed(predictions)))


def _in_steps(values: Floats) -> Floats:
    return np.asarray((values / STEP).round() * STEP)
