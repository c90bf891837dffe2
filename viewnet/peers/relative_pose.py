"""Rotations from pairs of views with a learned uncertainty, after VpDR-Net's viewpoint branch (Novotny, Larlus,
Vedaldi, ICCV 2017).

One network gives each view a rotation in a frame that all objects share, and a scale of its error. What is known is how
two views of one object are rotated to each other; nothing says how objects are turned to one another, so that objects
agree only as far as the network finds them alike. docs/peers.md says what is ours.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import ModelConfig
from viewnet.errors import ViewnetError
from viewnet.geometry import look_at
from viewnet.model.viewnet import Hypotheses
from viewnet.peers.peer import Batch, Peer
from viewnet.runtime.random import RandomSource

FLOOR = 0.05  # least scale of an error [ours]


def relative(world_from_camera: Tensor) -> Tensor:
    """Rotations (B, P, 3, 3) from one camera to another of each pair of K cameras (B, K, 3, 3) of B objects.

    A rotation of the object's world, G R for all R of an object, changes none of them: R^T G^T G R' = R^T R'.
    """
    one, two = torch.triu_indices(world_from_camera.shape[1], world_from_camera.shape[1], 1)  # (P,) each
    return world_from_camera[:, one].transpose(-1, -2) @ world_from_camera[:, two]


class RelativePose(Peer):
    """A trunk that gives a view vector, with `in_plane` an up vector too, and a scale.

    Without `in_plane` cameras are level in a world whose up is z.
    """

    supervision = "relative rotations"
    needs = ("viewpoints",)  # of which only `relative` is used
    judged = ("relative",)

    def __init__(self, config: ModelConfig):
        super().__init__(config)
        self.outputs = self.trunk(7 if config.in_plane else 4)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor | None, Tensor]:
        """View vectors (N, 3), up vectors (N, 3) or None, and raw scales (N,) of images (N, 3, S, S)."""
        out = self.outputs(images).float()  # (N, 4 or 7)
        ups = F.normalize(out[:, 4:], dim=1) if self.config.in_plane else None
        return F.normalize(out[:, 1:4], dim=1), ups, out[:, 0]

    def viewpoint(self, images: Tensor) -> Hypotheses:
        """One hypothesis for each image, in a frame of the network's own."""
        vectors, ups, scales = self(images)
        return Hypotheses(vectors[:, None], torch.zeros_like(scales[:, None]), None if ups is None else ups[:, None])

    def losses(self, batch: Batch, progress: float, generator: RandomSource) -> dict[str, Tensor]:
        """The negative log-likelihood of each pair's relative rotation; ViewnetError for one view of each object.

        A Laplace distribution of the distance d of rotation matrices (Frobenius), deviation s: log s + sqrt(2) d / s.
        """
        if self.training:
            batch = batch.mirrored(generator)  # ours
        assert batch.world_from_camera is not None
        views = len(batch.images) // len(batch.first)  # K, of each object
        if views < 2:
            raise ViewnetError("relative_pose learns from pairs: targets_per_object 1: expected 2 or more")
        vectors, ups, scales = self(self.composite(batch.images))
        predicted = look_at(vectors, ups).unflatten(0, (-1, views))  # (B, K, 3, 3)
        true = batch.world_from_camera.unflatten(0, (-1, views))  # (B, K, 3, 3)
        distance = (relative(predicted) - relative(true)).flatten(-2).norm(dim=-1)  # (B, P)
        one, two = torch.triu_indices(views, views, 1)  # (P,) each
        both = scales.unflatten(0, (-1, views))  # (B, K)
        scale = FLOOR + F.softplus(both[:, one] + both[:, two])  # (B, P)
        return {"relative": (scale.log() + math.sqrt(2) * distance / scale).mean()}
