"""Corners of the box around an object, then PnP (Grabner, Roth, Lepetit, CVPR 2018), learned from viewpoints and boxes.

The network predicts where the eight corners of the object's box appear and how long its sides are; the rotation between
camera and box follows from both. There is no released code: docs/peers.md says what is ours.
"""

from itertools import product

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import ModelConfig
from viewnet.model.viewnet import Hypotheses
from viewnet.peers.imagenet import ImageNetTrunk
from viewnet.peers.peer import Batch, Peer
from viewnet.render.camera import DISTANCE
from viewnet.runtime.random import RandomSource

CORNERS = tuple(product((-0.5, 0.5), repeat=3))  # in sides along the object's own x, y and z
HUBER = 0.1  # error from which the loss is linear: half sides of the image's box, or diagonals [ours]
THINNEST = 0.05  # least side over the diagonal: a flat box has no corners to tell apart [ours]
ROUNDS = 10  # of Gauss and Newton's method
STEP = 1e-2  # radians, of its central differences: errors of derivatives are a hundredth of a per cent
DAMPING = 1e-3  # of its steps, over the mean curvature


def corners_of(sides: Tensor) -> Tensor:
    """Corners (N, 8, 3) of boxes centred at the origin, with sides (N, 3) along x, y and z."""
    return sides[:, None] * sides.new_tensor(CORNERS)


def project(corners: Tensor, world_from_camera: Tensor) -> Tensor:
    """Where corners (..., 8, 3) appear to cameras (..., 3, 3): (..., 8, 2), x right and y up, over the focal length.

    The camera is the renderer's: it looks at the origin from DISTANCE diagonals.
    """
    camera = corners @ world_from_camera  # (..., 8, 3): rows are R^T p
    return camera[..., :2] / (DISTANCE - camera[..., 2:])


def framed(points: Tensor) -> Tensor:
    """Points (N, 8, 2) in their own box, which becomes [-1, 1] along both axes.

    So neither the focal length nor how a view was cropped, scaled or stretched makes a difference.
    """
    low, high = points.amin(1, keepdim=True), points.amax(1, keepdim=True)  # (N, 1, 2)
    return (2 * points - low - high) / (high - low).clamp(min=1e-6)


def pnp(points: Tensor, sides: Tensor) -> Tensor:
    """world_from_camera (N, 3, 3) of a camera that sees the corners of boxes with sides (N, 3) at `points` (N, 8, 2).

    Points may have been scaled and moved along both axes. A linear solution for a camera without perspective (DLT),
    then Gauss and Newton's method for one at DISTANCE diagonals, on the sum of squared distances in the image.
    """
    sides = sides.clamp(min=THINNEST)
    corners = corners_of(sides / sides.norm(dim=1, keepdim=True))  # (N, 8, 3), their diagonal is 1
    points = points - points.mean(1, keepdim=True)
    # Corners are uncorrelated, so the affine camera of least squares is a quotient.
    affine = corners.transpose(1, 2) @ points / corners.square().sum(1)[..., None]  # (N, 3, 2)
    u, _, vt = torch.linalg.svd(F.normalize(affine, dim=1), full_matrices=False)
    right, up = (u @ vt).unbind(-1)  # (N, 3) each: the closest orthonormal pair
    rotation = torch.stack([right, up, torch.linalg.cross(right, up)], -1)  # (N, 3, 3)
    none, steps = torch.zeros_like(sides), STEP * torch.eye(3).to(sides)[:, None].expand(-1, len(sides), 3)  # (3, N, 3)
    for _ in range(ROUNDS):
        residual = _residual(none, rotation, corners, points)  # (N, 16)
        turned = [[_residual(turn, rotation, corners, points) for turn in (step, -step)] for step in steps]
        jacobian = torch.stack([(after - before) / (2 * STEP) for after, before in turned], -1)  # (N, 16, 3)
        curvature = jacobian.transpose(1, 2) @ jacobian  # (N, 3, 3)
        damping = DAMPING * curvature.diagonal(dim1=1, dim2=2).mean(1) + 1e-9  # (N,)
        curvature = curvature + damping[:, None, None] * torch.eye(3).to(curvature)
        slope = (jacobian.transpose(1, 2) @ residual[..., None])[..., 0]  # (N, 3)
        turn = -torch.linalg.solve(curvature, slope)  # (N, 3)
        rotation = rotation @ torch.linalg.matrix_exp(_cross(turn))
    return rotation


def _residual(turn: Tensor, rotation: Tensor, corners: Tensor, points: Tensor) -> Tensor:
    """Distances (..., 16) of projected corners from centred points, after a small `turn` (..., 3), in radians.

    The scale and the shift along each axis are those that fit best.
    """
    seen = project(corners, rotation + rotation @ _cross(turn))  # (..., 8, 2)
    seen = seen - seen.mean(-2, keepdim=True)
    scale = (seen * points).sum(-2, keepdim=True) / seen.square().sum(-2, keepdim=True)  # (..., 1, 2)
    return (scale * seen - points).flatten(-2)


def _cross(turn: Tensor) -> Tensor:
    """The matrices (..., 3, 3) of cross products with vectors (..., 3)."""
    x, y, z = turn.unbind(-1)
    none = torch.zeros_like(x)
    rows = [torch.stack(row, -1) for row in ((none, -z, y), (z, none, -x), (-y, x, none))]
    return torch.stack(rows, -2)


class BoxCorners(Peer):
    """A trunk with 19 outputs: 16 coordinates of corners, 3 sides."""

    supervision = "absolute viewpoints, boxes"
    needs = ("viewpoints", "boxes")
    absolute = True
    judged = ("corners", "sides")

    def __init__(self, config: ModelConfig):
        super().__init__(config)
        self.outputs = self.trunk(19)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Corners (N, 8, 2), as `framed` has them, and sides (N, 3) over the diagonal, for images (N, 3, S, S)."""
        out = self.outputs(images).float()  # (N, 19)
        return out[:, :16].unflatten(1, (8, 2)), out[:, 16:]

    def viewpoint(self, images: Tensor) -> Hypotheses:
        """One hypothesis for each image, in the annotated frame; its rotation in the image plane is left out."""
        vectors = pnp(*self(images))[..., 2]  # (N, 3)
        return Hypotheses(vectors[:, None], torch.zeros_like(vectors[:, :1]))

    def losses(self, batch: Batch, progress: float, generator: RandomSource) -> dict[str, Tensor]:
        """Huber's loss of the corners and of the sides."""
        if self.training:
            batch = batch.mirrored(generator)
        assert batch.world_from_camera is not None and batch.boxes is not None
        corners, sides = self(self.composite(batch.images))
        true_sides = F.normalize(batch.boxes, dim=1)
        true_corners = framed(project(corners_of(true_sides), batch.world_from_camera))
        return {
            "corners": F.huber_loss(corners, true_corners, delta=HUBER),
            "sides": F.huber_loss(sides, true_sides, delta=HUBER),
        }


class BoxCornersImageNet(ImageNetTrunk, BoxCorners):
    """The same on features of ImageNet."""
