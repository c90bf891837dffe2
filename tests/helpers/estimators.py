"""Estimators of untrained networks of the profile smoke, and photographs for them."""

from __future__ import annotations

import numpy as np
import torch
from PIL import Image

from viewnet.estimator import ViewpointEstimator, turntable
from viewnet.estimator.viewpoints import Viewpoints
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.tables.run_renderer import RunRenderer

SQUARE = {"crop": "square"}
STRETCHED = {"recipe": "photos", "backgrounds": None}
PHOTOS = {"recipe": "photos"}
"""Settings that decide how an image is cut; without any the networks see whole views."""


def untrained(in_plane: bool = False, rotation: np.ndarray | None = None, **settings: object) -> ViewpointEstimator:
    """The estimator of a network with random weights."""
    config = make_config(profile="smoke", in_plane=in_plane, **settings)
    torch.manual_seed(0)
    return ViewpointEstimator(ViewNet(config.model).eval(), config, rotation)


def estimator_of(renderer: RunRenderer) -> ViewpointEstimator:
    """The estimator of the same network and alignment."""
    return ViewpointEstimator(renderer.network, renderer.config, renderer.aligned.alignment.rotation)


def turntable_of(renderer: RunRenderer, row: int, **options: int) -> list[np.ndarray]:
    """The turntable of a test view."""
    image, encoded, pose = renderer.test_images([row])[0], renderer.encode([row]), renderer.predicted_frames([row])[0]
    return turntable.animate(renderer, image, encoded, pose, **options)


def photograph(width: int = 90, height: int = 60, seed: int = 0) -> np.ndarray:
    """Smooth random colours (height, width, 3)."""
    rng = np.random.default_rng(seed)
    small = Image.fromarray(rng.integers(60, 220, (6, 9, 3), dtype=np.uint8))
    return np.asarray(small.resize((width, height), Image.Resampling.BICUBIC))


def same(one: Viewpoints, other: Viewpoints, tolerance: float = 1e-6) -> bool:
    """Whether hypotheses and probabilities are the same."""
    return np.allclose(one.hypotheses, other.hypotheses, atol=tolerance) and np.allclose(
        one.probabilities, other.probabilities, atol=tolerance
    )
