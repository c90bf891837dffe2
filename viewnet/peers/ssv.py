"""SSV (Mustikovela et al., CVPR 2020), reduced in size: a network that draws objects teaches viewpoints to another.

A generator draws objects from a code and a viewpoint. A critic tells its images from real ones and is the viewpoint
network as well: it says which code and viewpoint an image has. It learns these from generated images, whose code and
viewpoint are known, and is held to them on real ones: what it says of a real image has to draw that image again, and of
the mirrored image it has to say the mirrored viewpoint. docs/peers.md lists what the paper, the released code and this
file do.
"""

import math
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import ModelConfig
from viewnet.geometry import look_at, view_vector
from viewnet.model.fast_layers import LastConv
from viewnet.model.networks import AdaIN, Stage, power_of_two
from viewnet.model.viewnet import Hypotheses
from viewnet.peers.peer import Batch, Peer, frozen
from viewnet.runtime.random import RandomSource, rand

GENERATED = 0.8  # weight of codes, and of viewpoints, of generated images [released]
CONSISTENCY = 1.0  # of real images drawn again [ours, of pixels; released: 0.16 of AlexNet's features]
MIRRORED, MIRRORED_GENERATED = 0.4, 0.5  # of mirrored real images, and of mirrored generated ones [released]
PENALTY = 0.05  # of half the squared slope of real images' scores: R1 [ours; released: WGAN's penalty, 10]
WARM_UP = 0.3  # share of training over which the generator's viewpoints come to their weight [ours]
SHARE = 4  # what needs further images drawn, and the penalty, is of every fourth image [ours]
ELEVATIONS = (-20.0, 40.0)  # degrees, of generated images, where the settings have no limits
LEAK = 0.2  # slope of leaky ReLUs below 0
SIGNS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))  # of cosine and sine in each quadrant
ANGLE = 6  # outputs for an angle: logits of two squares and of four quadrants


class Generator(nn.Module):
    """Codes (N, A) and camera frames (N, 3, 3) -> images (N, 3, S, S), which the critic wants in [0, 1].

    As HoloGAN: a learned constant is styled by the code up to a volume of features, which is turned. Two 3-D
    convolutions follow, depth is folded into channels, and 2-D convolutions lead to the image. What comes after the
    turn does not know the code [ours], so that an object looks the same from all sides.
    """

    points: Tensor

    def __init__(self, config: ModelConfig):
        super().__init__()
        size, channels = config.volume_size, config.generator_channels
        channels = channels[: power_of_two(size, 8, "volume_size") - 1]
        self.constant = nn.Parameter(torch.randn(1, channels[0], 4, 4, 4))
        self.enter = AdaIN(channels[0], config.code_size)
        self.stages = nn.ModuleList(
            Stage(nn.ConvTranspose3d(a, b, 4, 2, 1, bias=False), config.code_size) for a, b in pairwise(channels)
        )
        thin, flat = channels[-1] // 2, config.appearance_size
        self.seen = nn.Sequential(
            *(nn.Conv3d(channels[-1], thin, 3, padding=1), nn.LeakyReLU(LEAK)),
            *(nn.Conv3d(thin, thin, 3, padding=1), nn.LeakyReLU(LEAK)),
        ).to(memory_format=torch.channels_last_3d)
        layers: list[nn.Module] = [nn.Conv2d(thin * size, flat, 1), nn.LeakyReLU(LEAK)]
        for level in range(power_of_two(config.input_size // size, 1, "input_size / volume_size")):
            layers += [nn.ConvTranspose2d(flat >> level, flat >> level + 1, 4, 2, 1), nn.LeakyReLU(LEAK)]
        # No bounds: where most of an image is black, a sigmoid ends in black all over, without a gradient [ours].
        layers += [nn.Conv2d(flat >> level + 1, 3, 3, padding=1)]
        self.paint = nn.Sequential(*layers).to(memory_format=torch.channels_last)
        axis = (2 * torch.arange(size) + 1) / size - 1  # (s,), centres of voxels
        z, y, x = torch.meshgrid(-axis, -axis, axis, indexing="ij")  # near first, and the upper row
        self.register_buffer("points", torch.stack([x, y, z], -1), persistent=False)  # (s, s, s, 3), the camera's

    def forward(self, code: Tensor, world_from_camera: Tensor) -> Tensor:
        """Images of objects, their codes as `normalised` gives them, as cameras see them."""
        x = self.enter(self.constant.expand(len(code), -1, -1, -1, -1), code)  # (N, C, 4, 4, 4)
        for stage in self.stages:
            x = stage(x, code)
        places = torch.einsum("nij,dhwj->ndhwi", world_from_camera, self.points)  # (N, s, s, s, 3), the object's
        x = self.seen(F.grid_sample(x, places, align_corners=False))  # (N, c, s, s, s), trilinear, 0 outside
        x = x.movedim(2, -1).movedim(1, -1).flatten(3).movedim(-1, 1)  # (N, s c, s, s), of a pixel all depths
        return self.paint(x)


def normalised(code: Tensor) -> Tensor:
    """Codes (N, A) with a mean square of 1."""
    return code * torch.rsqrt(code.square().mean(1, keepdim=True) + 1e-8)


def angle_target(angle: Tensor) -> tuple[Tensor, Tensor]:
    """Squares (N, 2) of cosine and sine of angles (N,) in degrees, and shares (N, 4) of quadrants: all in one."""
    radians = torch.deg2rad(angle)
    quadrant = F.one_hot((angle / 90).floor().long() % 4, 4)
    return torch.stack([radians.cos(), radians.sin()], 1).square(), quadrant.to(radians)


class Angles:
    """One angle of N images, of outputs (N, ANGLE): logarithms of squares (N, 2) and of quadrants' shares (N, 4)."""

    def __init__(self, out: Tensor):
        self.squares, self.quadrants = out[:, :2].log_softmax(1), out[:, 2:].log_softmax(1)

    def point(self) -> Tensor:
        """Cosine and sine (N, 2), in the likeliest quadrant, which takes no gradient."""
        return torch.exp(self.squares / 2) * self.squares.new_tensor(SIGNS)[self.quadrants.argmax(1)]

    def divergence(self, target: tuple[Tensor, Tensor]) -> Tensor:
        """Of the predictions from targets as `angle_target` has them: 0 where they agree."""
        pairs = zip((self.squares, self.quadrants), target, strict=True)
        return torch.stack([F.kl_div(found, wanted, reduction="batchmean") for found, wanted in pairs]).sum()

    def as_target(self, negative: bool) -> tuple[Tensor, Tensor]:
        """The predictions, detached, as a target for the same angle or for its negative."""
        squares, quadrants = self.squares.detach().exp(), self.quadrants.detach().exp()
        return squares, quadrants.flip(1) if negative else quadrants


class Reading:
    """What the critic says of N images: scores (N,), more for more real; codes (N, A); azimuths and elevations."""

    def __init__(self, out: Tensor):
        score, azimuth, elevation, self.code = out.float().split([1, ANGLE, ANGLE, out.shape[1] - 1 - 2 * ANGLE], 1)
        self.score, self.azimuth, self.elevation = score[:, 0], Angles(azimuth), Angles(elevation)

    def vectors(self) -> Tensor:
        """View vectors (N, 3)."""
        level, height = self.elevation.point().split(1, 1)  # (N, 1) each
        return torch.cat([level * self.azimuth.point(), height], 1)


class Critic(nn.Sequential):
    """Images (N, 3, S, S) in [0, 1] -> outputs (N, 13 + A) for `Reading`: ViewNet's encoder without normalisation.

    The statistics of a batch would tell generated images from real ones, and the slope of an image's score would depend
    on other images.
    """

    def __init__(self, config: ModelConfig):
        channels, levels = config.encoder_channels, power_of_two(config.input_size, 8, "input_size")
        layers: list[nn.Module] = []
        for before, width in pairwise((3, *channels[: levels - 1])):  # each halves the side, until it is 2
            layers += [nn.Conv2d(before, width, 3, 2, 1), nn.LeakyReLU(LEAK)]
        layers += [LastConv(channels[levels - 2], channels[levels - 1], 2), nn.LeakyReLU(LEAK)]
        layers += [LastConv(channels[levels - 1], 1 + 2 * ANGLE + config.code_size, 1), nn.Flatten()]
        super().__init__(*layers)
        for layer in layers[:-2]:
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, LEAK)  # nothing else keeps features' size from layer to layer
        self.to(memory_format=torch.channels_last)

    def forward(self, images: Tensor) -> Tensor:
        """The outputs for `Reading`."""
        return super().forward((2 * images - 1).contiguous(memory_format=torch.channels_last))


class SSV(Peer):
    """Generator and critic, which one backward pass and one step serve.

    Critic's terms see generated images detached, and the generator's see the critic's weights detached. Every image
    stands alone: a batch's `first` is not used.
    """

    supervision = "single images, range of viewpoints, mirror symmetry"
    judged = ("consistency",)

    def __init__(self, config: ModelConfig):
        super().__init__(config)
        self.generator, self.critic = Generator(config), Critic(config)

    def viewpoint(self, images: Tensor) -> Hypotheses:
        """One hypothesis for each image (N, 3, S, S)."""
        vectors = Reading(self.critic(images)).vectors()[:, None]  # (N, 1, 3)
        return Hypotheses(vectors, vectors.new_zeros(len(vectors), 1))

    def losses(self, batch: Batch, progress: float, generator: RandomSource) -> dict[str, Tensor]:
        """The critic's terms, then the generator's; without gradients, as in validation, those of real images alone."""
        real = self.composite(batch.images)  # (N, 3, S, S)
        if not torch.is_grad_enabled():
            return self.of_real(real, *(Reading(self.critic(each)) for each in (real, real.flip(-1))))
        count, some = len(real), _some(len(real))
        code, azimuth, elevation = self.drawn(count, generator)
        azimuths, elevations = torch.cat([azimuth, -azimuth[:some]]), torch.cat([elevation, elevation[:some]])
        drawn = self.generator(torch.cat([code, code[:some]]), look_at(view_vector(azimuths, elevations)))
        images, opposite = drawn.split([count, some])  # (N, 3, S, S), (some, 3, S, S)
        seen, flipped, found = map(Reading, self.critic(torch.cat([real, real.flip(-1), images.detach()])).chunk(3))
        judged = Reading(frozen(self.critic, images))
        # A generator that sees to viewpoints first moves a blob about, as no real object does.
        warm = min(1.0, progress / WARM_UP)
        return self.of_real(real, seen, flipped) | {
            "critic": (F.softplus(-seen.score) + F.softplus(found.score)).mean(),
            "penalty": PENALTY / 2 * self.squared_slope(real[:some]),
            **_generated("", 1.0, found, code, azimuth, elevation),
            "adversary": F.softplus(-judged.score).mean(),
            **_generated("generator_", warm, judged, code, azimuth, elevation),
            "generator_mirrored": MIRRORED_GENERATED * F.l1_loss(opposite, images[:some].flip(-1)),
        }

    def drawn(self, count: int, generator: RandomSource) -> tuple[Tensor, Tensor, Tensor]:
        """Codes (count, A), azimuths and elevations (count,) in degrees: uniform, all around and within the limits."""
        draws = rand(count, self.config.code_size + 2, generator=generator).to(self.focal.device)
        low, high = self.config.elevation_limits or ELEVATIONS
        return normalised(2 * draws[:, 2:] - 1), 360 * draws[:, 0], low + (high - low) * draws[:, 1]

    def of_real(self, real: Tensor, seen: Reading, flipped: Reading) -> dict[str, Tensor]:
        """What real images (N, 3, S, S), read as they are and mirrored, teach of codes and viewpoints."""
        some = _some(len(real)) if self.training else len(real)
        again = frozen(self.generator, normalised(seen.code[:some]), look_at(seen.vectors()[:some]))  # (some, 3, S, S)
        azimuth = flipped.azimuth.divergence(seen.azimuth.as_target(negative=True))
        elevation = flipped.elevation.divergence(seen.elevation.as_target(negative=False))
        return {
            "consistency": CONSISTENCY * F.l1_loss(again, real[:some]),
            "mirrored": MIRRORED * (azimuth + elevation),
        }

    def squared_slope(self, real: Tensor) -> Tensor:
        """Of the scores of real images (N, 3, S, S): the mean squared norm of their gradients."""
        real = real.detach().requires_grad_()
        (slope,) = torch.autograd.grad(Reading(self.critic(real)).score.sum(), real, create_graph=True)
        return slope.square().sum((1, 2, 3)).mean()


def _some(count: int) -> int:
    return math.ceil(count / SHARE)


def _generated(
    name: str, share: float, found: Reading, code: Tensor, azimuth: Tensor, elevation: Tensor
) -> dict[str, Tensor]:
    viewpoint = found.azimuth.divergence(angle_target(azimuth)) + found.elevation.divergence(angle_target(elevation))
    return {f"{name}code": GENERATED * F.mse_loss(found.code, code), f"{name}viewpoint": share * GENERATED * viewpoint}
