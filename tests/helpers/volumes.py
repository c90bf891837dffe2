"""Volumes and cameras to render, and the comparison of two renderers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from viewnet.geometry import look_at
from viewnet.model import volume


def random_frames(count: int, rng: np.random.Generator) -> torch.Tensor:
    """Camera frames with any tilt: samples then never lie exactly between two voxels, where gradients jump."""
    return torch.from_numpy(Rotation.random(count, rng=rng).as_matrix()).float()


def random_volume(count: int, shape: tuple[int, int, int], rng: np.random.Generator) -> torch.Tensor:
    """Colours in [0, 1], occupancies in [0.02, 0.5]: most rays pass through all of it."""
    values = rng.uniform(0, 1, (count, 4, *shape))
    values[:, 3] = 0.02 + 0.48 * values[:, 3]
    return torch.from_numpy(values).float()


def gradients(draw, inputs: list[torch.Tensor], weights: torch.Tensor) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """An image and the gradients of its weighted sum."""
    inputs = [x.detach().clone().requires_grad_() for x in inputs]
    image = draw(*inputs)
    return image.detach(), list(torch.autograd.grad((image * weights.to(image)).sum(), inputs))


def close(result: torch.Tensor, expected: torch.Tensor, tolerance: float) -> bool:
    """Within `tolerance` of the largest value expected."""
    scale = expected.abs().max().clamp(min=1e-6)
    return bool(((result.double() - expected).abs().max() / scale) < tolerance)


@dataclass(frozen=True)
class Case:
    """Inputs of a rendering, and a weight for each pixel."""

    shape: tuple[int, int, int]
    volumes: int
    share: int
    size: int
    steps: int
    focal: float
    solid: bool  # with whole boxes and single voxels of occupancy exactly 0 and exactly 1
    seed: int

    def inputs(self) -> tuple[list[torch.Tensor], torch.Tensor]:
        """Volume, frames and focal parameter; weights (N, 4, size, size)."""
        rng = np.random.default_rng(self.seed)
        voxels = random_volume(self.volumes, self.shape, rng)
        if self.solid:
            for value in (0.0, 1.0, 0.0, 1.0):
                low = [rng.integers(0, side) for side in self.shape]
                box = [slice(a, rng.integers(a, side) + 1) for a, side in zip(low, self.shape, strict=True)]
                voxels[(slice(None), 3, *box)] = value
                voxels[:, 3][torch.from_numpy(rng.random((self.volumes, *self.shape)) < 0.1)] = value
        count = self.volumes * self.share
        weights = torch.from_numpy(rng.standard_normal((count, 4, self.size, self.size)))
        return [voxels, random_frames(count, rng), torch.tensor(self.focal)], weights


CASES = st.builds(
    Case,
    shape=st.tuples(*[st.integers(3, 9)] * 3),
    volumes=st.integers(1, 2),
    share=st.integers(1, 3),
    size=st.integers(3, 9),
    steps=st.integers(3, 11),
    focal=st.floats(0, 0.6),
    solid=st.booleans(),
    seed=st.integers(0, 2**31),
)


def check_against_definition(draw, case: Case, device: str = "cpu", by_vector: bool = False) -> None:
    """That `draw`, like `viewnet.model.volume.render_reference`, gives the definition's image and gradients, to 1e-4.

    Those of volume, frames and focal parameter; with `by_vector` the frames are those that look along view vectors, and
    the gradient is the vectors'.
    """
    (voxels, frames, focal), weights = case.inputs()
    frame = look_at if by_vector else lambda frames: frames
    inputs = [voxels, frames[:, :, 2] if by_vector else frames, focal]
    shape = (case.size, case.steps)
    result, grads = gradients(
        lambda v, r, f: draw(v, frame(r), f, *shape), [x.to(device) for x in inputs], weights.to(device)
    )
    reference, expected = gradients(
        lambda v, r, f: volume.render_reference(v, frame(r), f, *shape), [x.double() for x in inputs], weights
    )
    assert (result.cpu().double() - reference).abs().max() < 1e-4
    assert close(grads[0].cpu(), expected[0], 1e-4), "volume"
    # The focal parameter's gradient is one sum, which may cancel by chance: its scale is the frames'.
    camera, required = (torch.cat([x.flatten().cpu() for x in both[1:]]) for both in (grads, expected))
    assert close(camera, required, 1e-4), "frames and focal parameter"
