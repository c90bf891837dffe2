"""Views that say their azimuth, and a network that reads it: for what is learned from answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import nn

from viewnet.data.store import COLUMNS, ViewStore
from viewnet.geometry import view_vector
from viewnet.model import viewnet

TURN = 40.0  # degrees of azimuth from the true frame to a reader's own


def dials(count: int, val: int = 0, seed: int = 0) -> ViewStore:
    """Views that say their azimuth: its cosine in green, its sine as what the right half has more red than the left.

    So a mirrored view shows what it would from the mirrored viewpoint. Every fourth is bluish, but none of the
    `val` that are for validation.
    """
    azimuth = np.random.default_rng(seed).uniform(0, 360, count + val)
    images = np.zeros((count + val, 32, 32, 4), np.uint8)
    images[..., 3] = 255
    images[..., 1] = np.round(127 * (1 + np.cos(np.radians(azimuth))))[:, None, None]
    for half, sign in ((slice(0, 16), -1), (slice(16, 32), 1)):
        images[:, :, half, 0] = np.round(127 * (1 + sign * np.sin(np.radians(azimuth))))[:, None, None]
    images[:count:4, ..., 2] = 25
    index = pd.DataFrame({name: [""] * len(azimuth) for name in COLUMNS})
    split = ["train"] * count + ["val"] * val
    index = index.assign(model_id=np.arange(len(azimuth)) // 5, split=split, azimuth=azimuth, elevation=10.0)
    return ViewStore(Path(), images, index, {})


class Reader(nn.Module):
    """Reads dials in a frame of its own; doubts bluish ones, of which it prefers the opposite."""

    def forward(self, images: torch.Tensor) -> viewnet.Hypotheses:
        green, red = images[:, 1].mean((1, 2)), images[:, 0]
        sine = (red[:, :, 16:].mean((1, 2)) - red[:, :, :16].mean((1, 2))) / 2
        azimuth = torch.rad2deg(torch.atan2(sine, green - 0.5)) + TURN
        doubt = images[:, 2].mean((1, 2)) > 0.05
        right, opposite = (view_vector(azimuth + turn, torch.full_like(azimuth, 10)) for turn in (0, 180))
        logits = torch.where(doubt[:, None], torch.tensor([0.0, 0.3, -9.0]), torch.tensor([4.0, 0.0, -9.0]))
        return viewnet.Hypotheses(torch.stack([right, opposite, right], 1), logits)
