"""MVC: Tulsiani, Efros and Malik, "Multi-view Consistency as Supervisory Signal for Learning Shape and Pose
Prediction", CVPR 2018, where masks are given and the camera's rotation is not.

A volume is made of one view of an object, the viewpoint of every other view is predicted from that view alone, and the
volume seen from there is to cover the view's mask. A view has eight hypotheses, of which one is drawn; which of them to
draw is learned by REINFORCE. docs/peers.md compares with the paper and the released code, line by line.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import ModelConfig
from viewnet.errors import ViewnetError
from viewnet.geometry import look_at, view_vector
from viewnet.model import volume
from viewnet.model.fast_layers import batch_norm_relu
from viewnet.model.networks import Encoder
from viewnet.model.viewnet import Hypotheses
from viewnet.peers.peer import Batch, Peer, frozen
from viewnet.render.camera import FOCAL
from viewnet.runtime.images import resize
from viewnet.runtime.random import RandomSource, rand

BACKGROUND = 0.2  # weight of rays beside the object; released
PRIOR = 0.1  # weight of the adversary, with masks; released
MOMENTUM = 0.95  # of the baseline; released
ELEVATIONS = (-20.0, 40.0)  # degrees: the known distribution is uniform there, and all around in azimuth; released


class MVC(Peer):
    """Two encoders, a volume, and an adversary that tells predicted viewpoints from those of the known distribution.

    Raises ViewnetError where views are cut: their camera is not the one that is known.
    """

    supervision = "pairs + masks, camera distance and focal length, distribution of viewpoints"
    judged = ("view",)
    baseline: Tensor

    def __init__(self, config: ModelConfig):
        if config.crop != "none":
            raise ViewnetError(f"crop {config.crop}: MVC knows the camera, so it needs whole views: train without crop")
        super().__init__(config)
        self.shape = Encoder(config.encoder_channels, config.appearance_size, config.input_size)
        self.decoder = Decoder(config)
        self.pose = Encoder(config.encoder_channels, 3 * config.heads, config.input_size)
        last = self.pose[-2]
        assert isinstance(last, nn.Conv2d) and last.bias is not None
        nn.init.normal_(last.weight, std=0.02)  # released: heads start 360 / heads degrees apart
        nn.init.zeros_(last.bias)
        self.adversary = nn.Sequential(  # released
            nn.Linear(4, 10), nn.LeakyReLU(0.2), nn.Linear(10, 10), nn.LeakyReLU(0.2), nn.Linear(10, 1)
        )
        # A volume whose sides at its centre are the image's edges, seen by the renders' camera.
        self.focal = torch.tensor(1 / (2 * FOCAL))  # half sides over the camera's distance
        self.register_buffer("baseline", torch.zeros(()))

    def angles(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Azimuths and elevations in degrees and selection logits, (N, M) each, of images (N, 3, S, S)."""
        azimuth, elevation, logits = self.pose(images).float().unflatten(1, (3, -1)).unbind(1)  # (N, M) each
        apart = torch.arange(self.config.heads, device=images.device) * (360 / self.config.heads)  # (M,)
        low, high = ELEVATIONS
        return 360 * azimuth.sigmoid() + apart, low + (high - low) * elevation.sigmoid(), logits

    def viewpoint(self, images: Tensor) -> Hypotheses:
        """The hypotheses for images (N, 3, S, S)."""
        azimuth, elevation, logits = self.angles(images)
        return Hypotheses(view_vector(azimuth, elevation), logits)

    def volumes(self, images: Tensor) -> Tensor:
        """Volumes (B, 4, n, n, n) of images (B, 3, S, S); of their channels only occupancy, the last, is learned."""
        return volume.squash(self.decoder(self.shape(images)), None)

    def losses(self, batch: Batch, progress: float, generator: RandomSource) -> dict[str, Tensor]:
        """See Peer. The hypothesis with the largest logit stands for the one drawn in validation."""
        azimuth, elevation, logits = self.angles(self.composite(batch.images))  # (N, M) each
        shares = logits.softmax(1)  # (N, M)
        draws = rand(len(shares), generator=generator).to(shares.device)  # (N,)
        drawn = (shares.cumsum(1) < draws[:, None]).sum(1).clamp(max=self.config.heads - 1)  # (N,)
        head = (drawn if self.training else logits.argmax(1))[:, None]  # (N, 1)
        azimuth, elevation = azimuth.gather(1, head)[:, 0], elevation.gather(1, head)[:, 0]  # (N,) each
        view = self.view_costs(self.volumes(self.composite(batch.first)), azimuth, elevation, batch.images)  # (N,)

        unlikely, told = self.prior(azimuth, elevation, generator)  # (N,) each

        # REINFORCE: the gradient of the expected cost by the logits is that of the mean of (cost - baseline) log share.
        cost = (view + unlikely).detach()  # (N,)
        chosen = logits.log_softmax(1).gather(1, head)[:, 0]  # (N,)
        selection = ((cost - self.baseline) * chosen).mean()
        if self.training:
            self.baseline = MOMENTUM * self.baseline + (1 - MOMENTUM) * cost.mean()
        return {"view": view.mean(), "prior": unlikely.mean(), "selection": selection, "adversary": told.mean()}

    def prior(self, azimuth: Tensor, elevation: Tensor, generator: RandomSource) -> tuple[Tensor, Tensor]:
        """What the adversary makes of viewpoints (N,) in degrees: their cost (N,), and its own (N,).

        Viewpoints learn from the adversary as it is, and the adversary from viewpoints as they are.
        """
        fake = quaternion(azimuth, elevation)  # (N, 4)
        draws = rand(3, len(fake), generator=generator, dim=1).to(fake.device)  # (3, N)
        low, high = ELEVATIONS
        true = quaternion(360 * draws[0], low + (high - low) * draws[1])  # (N, 4)
        sign = torch.where(draws[2] < 0.5, -1.0, 1.0)[:, None]  # (N, 1): a rotation is two quaternions
        belief = frozen(self.adversary, fake * sign)[:, 0]  # (N,), that they are true
        told = F.softplus(self.adversary(fake.detach() * sign)) + F.softplus(-self.adversary(true * sign))  # (N, 1)
        return PRIOR * F.softplus(-belief), told[:, 0]

    def view_costs(self, volumes: Tensor, azimuth: Tensor, elevation: Tensor, images: Tensor) -> Tensor:
        """(N,): how badly volumes (B, ...), N = K B, seen from viewpoints (N,), cover the masks of (N, 4, S, S).

        The mean over rays of their expected cost: 1 for what passes through where the object is, 0.2 for what stops
        where it is not. A ray through the object's edge is of both kinds, by shares.
        """
        cameras = look_at(view_vector(azimuth, elevation))  # (N, 3, 3)
        size = self.config.render_size
        stopped = volume.render(volumes, cameras, self.focal, size, sparse=True)[:, 3]  # (N, R, R)
        mask = resize(images[:, 3:], size)[:, 0]  # (N, R, R)
        return (mask * (1 - stopped) + BACKGROUND * (1 - mask) * stopped).mean((1, 2))


class Decoder(nn.Module):
    """Codes (B, A) -> logits of occupancy, and nothing for colours, as volume.squash takes them."""

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.side, (wide, narrow) = config.volume_size // 4, config.generator_channels[:2]
        self.first = nn.Linear(config.appearance_size, self.side**3 * wide, bias=False)
        self.wide = nn.BatchNorm3d(wide)
        self.second = nn.ConvTranspose3d(wide, narrow, 4, 2, 1, bias=False)
        self.narrow = nn.BatchNorm3d(narrow)
        self.last = nn.Linear(narrow, 8)  # a voxel's own eight, so that nothing is summed
        nn.init.normal_(self.last.weight, std=0.02)  # released
        nn.init.constant_(self.last.bias, 0.1)  # ours: a haze to begin with, as what is empty everywhere stays so

    def forward(self, code: Tensor) -> Tensor:
        """(B, n / 2, n / 2, n / 2, 2, 2, 2, 4)."""
        x = self.first(code).unflatten(1, (self.side, self.side, self.side, -1)).movedim(-1, 1)  # (B, C, n/4, n/4, n/4)
        x = batch_norm_relu(self.wide, x)
        x = batch_norm_relu(self.narrow, self.second(x))  # (B, c, n/2, n/2, n/2)
        logits = self.last(x.movedim(1, -1)).unflatten(-1, (2, 2, 2, 1))  # (B, n/2, n/2, n/2, 2, 2, 2, 1)
        return F.pad(logits, (3, 0))  # (B, n/2, n/2, n/2, 2, 2, 2, 4)


def quaternion(azimuth: Tensor, elevation: Tensor) -> Tensor:
    """Unit quaternions (N, 4), real part first, of rotations about z by azimuth, then about y by minus elevation.

    >>> quaternion(torch.tensor([180.0]), torch.tensor([0.0])).round(decimals=4).abs()
    tensor([[0., 0., 0., 1.]])
    """
    a, e = torch.deg2rad(azimuth) / 2, torch.deg2rad(elevation) / 2
    return torch.stack([a.cos() * e.cos(), a.sin() * e.sin(), -a.cos() * e.sin(), a.sin() * e.cos()], 1)  # (N, 4)
