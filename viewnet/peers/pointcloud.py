"""Insafutdinov and Dosovitskiy, "Unsupervised Learning of Shape and Pose with Differentiable Point Clouds" (2018).

A point cloud from one view of an object is to have the silhouettes of all its views, as cameras see it that are
predicted from these views. Each view has a few candidates for its camera; the one whose silhouette is closest learns,
and a student learns to predict what it says. "released" is what the authors' code has, "ours" what it has not.
"""

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import ModelConfig
from viewnet.errors import ViewnetError
from viewnet.model.kernels import numba_call
from viewnet.model.networks import power_of_two
from viewnet.model.viewnet import Hypotheses
from viewnet.peers.peer import Batch, Peer
from viewnet.render.camera import DISTANCE, FOCAL
from viewnet.runtime.images import resize
from viewnet.runtime.random import RandomSource, rand, randint

GRID = 64  # voxels a side at which the numbers below are released
BLUR = (1.5, 0.2)  # standard deviation in voxels of that grid, when training begins and ends; linear (released: from 3)
KEPT = (0.25, 1.0)  # share of the points that are drawn, likewise (released: 0.07, of seven times as many points)
STUDENT_WEIGHT = 60.0  # of the student's loss, beside a sum over that grid's pixels (released: 20)
DECAY = 0.001  # of half the sum of squared weights, likewise
SPREAD = 0.3  # of the candidates' last weights, so that cameras start near the ones below (ours)
HIDDEN = 32  # width of each head's two layers (released)
SLOPE = 0.2  # of leaky ReLUs


class Pointcloud(Peer):
    """`config.heads` viewpoints: the student's, which is the prediction, and those of the candidates after it.

    The grid has n = `config.volume_size` voxels a side, the cloud P = 2 n^2 points (8,192 at n = 64; released: 8,000).
    Raises ViewnetError for less than two heads, and for a number of widths that does not fit the images.
    """

    supervision = "pairs + masks, camera distance and focal length"
    judged = ("silhouette",)

    def __init__(self, config: ModelConfig):
        super().__init__(config)
        if config.heads < 2:
            raise ViewnetError(f"heads {config.heads}: pointcloud needs a student and a candidate, 2 or more")
        self.points = 2 * config.volume_size**2
        width, channels = config.code_size, config.encoder_channels
        levels = power_of_two(config.input_size, 8, "input_size") - 2  # halved until 4 pixels a side are left
        if len(channels) < levels:
            raise ViewnetError(f"encoder_channels {channels}: {levels} are needed for {config.input_size} pixels")
        layers: list[nn.Module] = [nn.Conv2d(3, channels[0], 5, 2, 2), nn.LeakyReLU(SLOPE)]
        for before, after in pairwise(channels[:levels]):
            layers += [nn.Conv2d(before, after, 3, 2, 1), nn.LeakyReLU(SLOPE)]
            layers += [nn.Conv2d(after, after, 3, 1, 1), nn.LeakyReLU(SLOPE)]
        layers += [nn.Flatten(), nn.Linear(16 * channels[levels - 1], width), nn.LeakyReLU(SLOPE)]
        layers += [nn.Linear(width, width), nn.LeakyReLU(SLOPE)]
        self.encoder = nn.Sequential(*layers)  # one for shape and pose
        self.shape = nn.Sequential(nn.Linear(width, width), nn.LeakyReLU(SLOPE))
        self.cloud, self.scale = nn.Linear(width, 3 * self.points), nn.Linear(width, 1)
        self.pose = nn.Sequential(nn.Linear(width, width), nn.ReLU())
        self.hidden = nn.ModuleList(_hidden(width) for _ in range(config.heads))
        last = [nn.Linear(HIDDEN, 4) for _ in range(config.heads)]  # quaternions, the student's first
        self.last = nn.ModuleList(last)
        for name, parameter in self.named_parameters():
            if name.endswith("bias"):
                nn.init.zeros_(parameter)
            else:
                nn.init.kaiming_normal_(parameter, SLOPE)
        nn.init.normal_(self.cloud.weight, std=0.025)  # released
        with torch.no_grad():  # ours: level cameras, evenly around the object
            for c, head in enumerate(last[1:]):
                half = torch.tensor(torch.pi * c / (config.heads - 1))  # of the azimuth, radians
                head.bias.copy_(torch.stack([half.cos() - half.sin(), half.cos() + half.sin()]).repeat_interleave(2))
                head.weight.mul_(SPREAD)

    def quaternions(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Features (N, F) of images (N, 3, S, S) as `composite` gives them, and quaternions (N, M, 4) of any length."""
        features = self.encoder(2 * images - 1)  # (N, F)
        pose = self.pose(features)  # (N, F)
        found = [last(hidden(pose)) for hidden, last in zip(self.hidden, self.last, strict=True)]
        return features, torch.stack(found, 1)  # (N, M, 4)

    def viewpoint(self, images: Tensor) -> Hypotheses:
        """The student's and the candidates' cameras for images (N, 3, S, S); the student counts."""
        frames = rotation(self.quaternions(images)[1])  # (N, M, 3, 3)
        logits = torch.zeros(frames.shape[:2], device=frames.device)  # (N, M)
        logits[:, 0] = 1.0
        return Hypotheses(frames[..., 2], logits, frames[..., 1])

    def decode(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Points (B, P, 3) in [-1/2, 1/2], and occupancy scales (B,) in [0, 1], of features (B, F)."""
        code = self.shape(features)  # (B, F)
        points = torch.tanh(self.cloud(code)).unflatten(1, (-1, 3)) / 2  # (B, P, 3)
        return points, torch.sigmoid(self.scale(code))[:, 0]  # (B,)

    def losses(self, batch: Batch, progress: float, generator: RandomSource) -> dict[str, Tensor]:
        """The best candidate's "silhouette", and the "student", its distance from that candidate; means over views."""
        size, count = self.config.volume_size, len(batch.first)
        images = torch.cat([batch.first, batch.images])  # (N, 4, S, S), N = B (1 + K)
        device = images.device
        features, found = self.quaternions(self.composite(images))  # (N, F), (N, 1 + C, 4)
        points, scales = self.decode(features[:count])  # shape from the first view alone
        owner = torch.arange(count, device=device)  # (B,)
        owner = torch.cat([owner, owner.repeat_interleave(len(batch.images) // count)])  # (N,), each view's object
        masks = resize(images[:, 3:], size)[:, 0]  # (N, n, n)
        sigma = (BLUR[0] + (BLUR[1] - BLUR[0]) * progress) * size / GRID
        kept = max(1, round((KEPT[0] + (KEPT[1] - KEPT[0]) * progress) * self.points))
        candidates, scales = found[:, 1:], scales[owner]  # (N, C, 4), (N,)
        subsets = draw(self.points, kept, candidates.shape[:2].numel(), generator).to(device)
        subsets = subsets.unflatten(0, candidates.shape[:2])  # (N, C, K), each candidate's own points
        views = torch.arange(len(images), device=device)
        with torch.no_grad():  # only the best one learns, so only that one is drawn with gradients
            errors = torch.stack(
                [
                    distance(points[owner[:, None], subsets[:, c]], candidates[:, c], scales, masks, sigma)
                    for c in range(candidates.shape[1])
                ],
                1,
            )  # (N, C)
            best = errors.argmin(1)  # (N,)
        chosen = candidates[views, best]  # (N, 4)
        error = distance(points[owner[:, None], subsets[views, best]], chosen, scales, masks, sigma)  # (N,)
        likeness = F.cosine_similarity(found[:, 0], chosen.detach(), dim=1)  # (N,), 1 or -1 where rotations are one
        weight = STUDENT_WEIGHT * (size / GRID) ** 2  # errors are sums over pixels
        return {"silhouette": error.mean(), "student": weight * (1 - likeness**2).mean()}

    def parameter_groups(self, learning_rate: float) -> list[dict[str, object]]:
        """Weights with decay, which Adam adds to their gradient: half their squared norm in the loss; and biases."""
        decay = DECAY * (self.config.volume_size / GRID) ** 2
        weights, biases = ([p for p in self.parameters() if (p.dim() > 1) == yes] for yes in (True, False))
        return [
            {"params": weights, "lr": learning_rate, "weight_decay": decay},
            {"params": biases, "lr": learning_rate},
        ]


def _hidden(width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(width, HIDDEN), nn.LeakyReLU(SLOPE), nn.Linear(HIDDEN, HIDDEN), nn.LeakyReLU(SLOPE))


def rotation(quaternions: Tensor) -> Tensor:
    """Camera frames (..., 3, 3), world from camera, of quaternions (..., 4), real part first, of any length."""
    w, x, y, z = F.normalize(quaternions, dim=-1).unbind(-1)  # (...)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)  # (..., 3, 3)


def draw(points: int, kept: int, rows: int, generator: RandomSource) -> Tensor:
    """Numbers of `kept` points of 0 to `points` - 1 for each of `rows`, none twice in a row: (rows, kept).

    Stretches of one random order, each from its own place: as random as an order each, at a fraction of the time.
    """
    order = rand(points, generator=generator).argsort().repeat(2)  # (2 P,)
    return order[randint(points, rows, generator=generator)[:, None] + torch.arange(kept)]  # (rows, kept)


def project(points: Tensor, quaternions: Tensor) -> Tensor:
    """Points (N, P, 3) as cameras (N, 4) see them: depth, row and column (N, P, 3), all in [0, 1] where seen."""
    right, up, back = (rotation(quaternions).mT @ points.mT).unbind(1)  # (N, P) each, camera coordinates
    nearness = FOCAL / (DISTANCE - back)
    return torch.stack([0.5 - back, 0.5 - nearness * up, 0.5 + nearness * right], -1)  # (N, P, 3)


def splat(places: Tensor, size: int) -> Tensor:
    """Grids (N, n, n, n) to which each of the places (N, P, 3) in [0, 1] adds 1, shared by its eight nearest voxels.

    Places beyond the cube are left out. The sides of a voxel at the border keep what lies beyond its centre.
    """
    if places.device.type == "cpu" and numba_call.available():
        from viewnet.peers import splat_numba  # imported late: Numba takes a second to load

        return splat_numba.splat(places, size)
    inside = ((places >= 0) & (places <= 1)).all(-1)  # (N, P)
    at = (places * size - 0.5).clamp(0, size - 1)  # (N, P, 3), in voxels' centres
    low = at.detach().floor().clamp(max=size - 2)
    share = at - low  # (N, P, 3), of the voxel after
    depth, row, column = torch.stack([1 - share, share], -1).unbind(2)  # (N, P, 2) each
    weights = (depth * inside[..., None])[..., :, None, None] * row[..., None, :, None] * column[..., None, None, :]
    strides = torch.tensor([size * size, size, 1], device=places.device)
    start = (low.long() * strides).sum(-1) + size**3 * torch.arange(len(places), device=places.device)[:, None]
    corners = torch.tensor([0, 1], device=places.device)
    offsets = corners[:, None, None] * strides[0] + corners[:, None] * strides[1] + corners  # (2, 2, 2)
    index = start[..., None, None, None] + offsets  # (N, P, 2, 2, 2)
    grid = weights.new_zeros(len(places) * size**3).index_add(0, index.flatten(), weights.flatten())
    return grid.view(-1, size, size, size)  # (N, n, n, n)


def kernel(size: int, sigma: float, device: torch.device | None = None) -> Tensor:
    """The matrix (n, n) that blurs an axis: a row has a Gaussian around its diagonal that sums to 1 if it fits in."""
    offsets = torch.arange(1 - size, size, device=device)  # (2 n - 1,)
    gaussian = torch.softmax(-0.5 * (offsets / sigma) ** 2, 0)
    places = torch.arange(size, device=device)
    return gaussian[places[:, None] - places + size - 1]  # (n, n)


def blur(grids: Tensor, sigma: float) -> Tensor:
    """Grids (N, n, n, n) blurred along each axis by a Gaussian of `sigma` voxels."""
    matrix = kernel(grids.shape[-1], sigma, grids.device)  # (n, n), symmetric
    grids = matrix @ (grids @ matrix)  # columns, then rows
    return torch.bmm(matrix.expand(len(grids), -1, -1), grids.flatten(2)).view_as(grids)  # depths


def silhouette(grids: Tensor, scales: Tensor, sigma: float) -> Tensor:
    """Silhouettes (N, n, n) of grids (N, n, n, n), depth first, and scales of their occupancy (N,).

    A ray's probabilities to stop at each voxel sum up to 1 less that of passing all.
    """
    passed = 1 - blur(grids.clamp(max=1), sigma) * scales[:, None, None, None]
    return 1 - passed.clamp(min=1e-5).prod(1)  # (N, n, n)


def distance(points: Tensor, quaternions: Tensor, scales: Tensor, masks: Tensor, sigma: float) -> Tensor:
    """Half the sum over pixels of squared differences (N,) between silhouettes of points and masks (N, n, n)."""
    grids = splat(project(points, quaternions), masks.shape[-1])
    return (silhouette(grids, scales, sigma) - masks).square().sum((1, 2)) / 2  # (N,)
