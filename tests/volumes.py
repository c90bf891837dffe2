"""Volumes and cameras to draw, and what two renderers make of them."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation


def random_frames(count: int, rng: np.random.Generator) -> torch.Tensor:
    """Camera frames with any tilt: samples then never lie exactly between two voxels, where gradients jump."""
    return torch.from_numpy(Rotation.random(count, rng=rng).as_matrix()).float()


def random_volume(count: int, shape: tuple[int, int, int], rng: np.random.Generator) -> torch.Tensor:
    """Colours in [0, 1], occupancies in [0.02, 0.5]: most rays pass through all of it."""
    values = rng.uniform(0, 1, (count, 4, *shape))
    values[:, 3] = 0.02 + 0.48 * values[:, 3]
    return torch.from_numpy(values).float()


def gradients(draw, inputs: list[torch.Tensor], weights: torch.Tensor) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """A picture and the gradients of its weighted sum."""
    inputs = [x.detach().clone().requires_grad_() for x in inputs]
    picture = draw(*inputs)
    return picture.detach(), list(torch.autograd.grad((picture * weights.to(picture)).sum(), inputs))


def close(found: torch.Tensor, expected: torch.Tensor, tolerance: float) -> bool:
    """Within `tolerance` of the largest value expected."""
    scale = expected.abs().max().clamp(min=1e-6)
    return bool(((found.double() - expected).abs().max() / scale) < tolerance)
