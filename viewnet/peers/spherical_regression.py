"""Spherical regression of azimuth and elevation (Liao, Gavves, Snoek, CVPR 2019), learned from absolute viewpoints.

A point (cos a, sin a) of the circle is predicted as its squares, which add up to 1 as a softmax does, and as the
quadrant it is in. docs/peers.md lists what the paper, the released code and this file do.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import ModelConfig
from viewnet.geometry import azimuth_elevation, view_vector
from viewnet.model.viewnet import Hypotheses
from viewnet.peers.imagenet import ImageNetTrunk
from viewnet.peers.peer import Batch, Peer
from viewnet.runtime.random import RandomSource, rand

SHIFT = (45.0, 0.0)  # degrees added to azimuth and elevation [released]: front and side views are amid a quadrant
MAGNITUDE_WEIGHT = 4.0  # of the squares beside the quadrants [released]
HIDDEN = 256  # units of each angle's hidden layer [released: 1024]
DROPOUT = 0.5  # of them [released]
SIGNS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))  # of cosine and sine in each quadrant


def encode(angles: Tensor) -> tuple[Tensor, Tensor]:
    """Squares (..., 2) of cosine and sine, and quadrants (...) from 0 to 3, of angles (...) in degrees.

    >>> encode(torch.tensor([120.0]))
    (tensor([[0.2500, 0.7500]]), tensor([1]))
    """
    radians = torch.deg2rad(angles)
    squares = torch.stack([radians.cos(), radians.sin()], -1).square()  # (..., 2)
    return squares, (angles / 90).floor().long() % 4


def decode(squares: Tensor, quadrants: Tensor) -> Tensor:
    """The inverse of `encode`: angles (...) in [-180, 180] degrees."""
    point = squares.sqrt() * squares.new_tensor(SIGNS)[quadrants]  # (..., 2)
    return torch.rad2deg(torch.atan2(point[..., 1], point[..., 0]))


class SphericalRegression(Peer):
    """A trunk, and for each of the two angles a hidden layer, two squares and four quadrants."""

    supervision = "absolute viewpoints"
    needs = ("viewpoints",)
    absolute = True
    judged = ("magnitude", "quadrant")

    def __init__(self, config: ModelConfig):
        super().__init__(config)
        self.hidden = self.trunk(2 * HIDDEN)  # its last layer is the hidden layer of both angles
        self.heads = nn.ModuleList(_head() for _ in SHIFT)

    def forward(self, images: Tensor, generator: RandomSource | None = None) -> tuple[Tensor, Tensor]:
        """Logits of squares (N, 2, 2) and quadrants (N, 2, 4), azimuth's then elevation's, of images (N, 3, S, S)."""
        hidden = self.hidden(images).float().relu().unflatten(1, (2, HIDDEN))  # (N, 2, HIDDEN)
        if self.training and generator is not None:
            kept = rand(*hidden.shape, generator=generator) >= DROPOUT
            hidden = hidden * kept.to(hidden) / (1 - DROPOUT)
        out = torch.stack([head(hidden[:, angle]) for angle, head in enumerate(self.heads)], 1)  # (N, 2, 6)
        return out[..., :2], out[..., 2:]

    def viewpoint(self, images: Tensor) -> Hypotheses:
        """One hypothesis for each image, in the annotated frame."""
        squares, quadrants = self(images)
        angles = decode(squares.softmax(-1), quadrants.argmax(-1)) - squares.new_tensor(SHIFT)  # (N, 2)
        return Hypotheses(view_vector(*angles.unbind(1))[:, None], torch.zeros_like(angles[:, :1]))

    def losses(self, batch: Batch, progress: float, generator: RandomSource) -> dict[str, Tensor]:
        """The cross-entropies of squares, which are taken for probabilities, and of quadrants, summed over angles."""
        if self.training:
            batch = batch.mirrored(generator)  # ours
        assert batch.world_from_camera is not None
        back = batch.world_from_camera[..., 2]  # (N, 3), view vectors
        angles = torch.stack(azimuth_elevation(back), 1) + back.new_tensor(SHIFT)  # (N, 2)
        true_squares, true_quadrants = encode(angles)
        squares, quadrants = self(self.composite(batch.images), generator)
        magnitude = -(true_squares * squares.log_softmax(-1)).sum(-1)  # (N, 2)
        quadrant = F.cross_entropy(quadrants.transpose(1, 2), true_quadrants, reduction="none")  # (N, 2)
        return {"magnitude": MAGNITUDE_WEIGHT * magnitude.sum(1).mean(), "quadrant": quadrant.sum(1).mean()}


def _head() -> nn.Linear:
    """Two squares' and four quadrants' logits, which start nearly even [released]."""
    head = nn.Linear(HIDDEN, 6)
    nn.init.normal_(head.weight, std=0.005)
    nn.init.zeros_(head.bias)
    return head


class SphericalRegressionImageNet(ImageNetTrunk, SphericalRegression):
    """The same on features of ImageNet."""


class SphericalRegressionFrozen(SphericalRegressionImageNet):
    """The same on features that stay as they are [ours]."""

    slower = 0.0
