"""The networks: encoder, AdaIN generator and the decoders of the ablation (the supplement's architecture tables).

Layers of viewnet.model.fast_layers stand for PyTorch's, as their names say.

Where the paper is silent or contradicts itself, docs/decisions.md says what was chosen and why.
"""

import math
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from viewnet.config import ModelConfig
from viewnet.errors import ViewnetError
from viewnet.model.fast_layers import FirstDeconv, FixedCodeDeconv, LastConv, Stride2Conv, Upsample2x, batch_norm_relu
from viewnet.model.kernels import norm_relu_cpu
from viewnet.model.volume import joined, ray_points


def power_of_two(size: int, at_least: int, what: str) -> int:
    """The exponent of `size`; ViewnetError unless it is a power of two of `at_least` or more."""
    if size < at_least or size & (size - 1):  # a power of two has a single bit
        raise ViewnetError(f"{what} {size}: expected a power of two of {at_least} or more")
    return size.bit_length() - 1


class Encoder(nn.Sequential):
    """Images (N, 3, S, S) in [0, 1] -> features (N, outputs): the supplement's encoder table.

    Stride-2 convolutions down to 2x2, a 2x2 convolution and a 1x1 one. The table ends with batch normalisation and
    ReLU; left out here as in the released code, since a ReLU would confine view vectors to one octant.

    Raises ViewnetError for a number of widths that does not fit the images.
    """

    def __init__(self, channels: tuple[int, ...], outputs: int, image_size: int):
        levels = power_of_two(image_size, 8, "image_size")
        if len(channels) < levels:
            raise ViewnetError(f"encoder_channels {channels}: {levels} are needed for images of {image_size} pixels")
        layers: list[nn.Module] = []
        previous = 3
        for width in channels[: levels - 1]:  # each halves the side, until it is 2
            layers += [Stride2Conv(previous, width, 3, stride=2, bias=False)]
            layers += [nn.BatchNorm2d(width), nn.ReLU(inplace=True)]  # takes the mean away: convolutions need no bias
            previous = width
        last = channels[levels - 1]
        layers += [LastConv(previous, last, 2, bias=False), nn.BatchNorm2d(last), nn.ReLU(inplace=True)]
        layers += [LastConv(last, outputs, 1), nn.Flatten()]  # (N, outputs, 1, 1) -> (N, outputs)
        super().__init__(*layers)
        self.to(memory_format=torch.channels_last)  # a pixel's features side by side, as norm_relu reads them

    def forward(self, images: Tensor) -> Tensor:
        """Features (N, outputs) of images (N, 3, S, S)."""
        x = images.contiguous(memory_format=torch.channels_last)
        for layer in self:
            if isinstance(layer, _BatchNorm):
                x = batch_norm_relu(layer, x)  # with the ReLU behind it, which is passed over
            elif not isinstance(layer, nn.ReLU):
                x = layer(x)
        return x


class AdaIN(nn.Module):
    """Adaptive instance normalisation: features normalised a channel, then scaled and shifted by the appearance.

    With the ReLU that follows it everywhere.
    """

    def __init__(self, channels: int, appearance: int):
        super().__init__()
        self.affine = nn.Linear(appearance, 2 * channels)
        nn.init.zeros_(self.affine.bias)
        with torch.no_grad():
            self.affine.bias[:channels] = 1  # starts as plain instance normalisation

    def forward(self, x: Tensor, appearance: Tensor) -> Tensor:
        """Features (N, C, ...) and appearances (N, A) -> features (N, C, ...), 0 or more."""
        scale, shift = self.affine(appearance).chunk(2, dim=1)  # (N, C) each
        if norm_relu_cpu.usable(x):
            last = x.movedim(1, -1)  # (N, ..., C)
            out, _, _ = norm_relu_cpu.norm_relu(last.flatten(1, -2), scale, shift)  # (N, P, C)
            return out.view(last.shape).movedim(-1, 1)  # (N, C, ...)
        shape = (*scale.shape, *[1] * (x.dim() - 2))  # (N, C, 1, ...)
        return F.relu(torch.addcmul(shift.to(x.dtype).view(shape), F.instance_norm(x), scale.to(x.dtype).view(shape)))


class Stage(nn.Module):
    """Transposed convolution, normalisation, ReLU: one row of the supplement's generator table.

    With `appearance` None the normalisation is by batch and takes no condition (the encoder-decoder ablation).
    """

    def __init__(self, convolution: nn.ConvTranspose2d | nn.ConvTranspose3d | FixedCodeDeconv, appearance: int | None):
        super().__init__()
        self.convolution, outputs = convolution, convolution.out_channels
        self.norm = nn.BatchNorm3d(outputs) if appearance is None else AdaIN(outputs, appearance)

    def forward(self, x: Tensor, appearance: Tensor) -> Tensor:
        """Features (N, inputs, ...), or (1, ...) for all, and appearances (N, A) -> features (N, outputs, ...)."""
        x = self.convolution(x)
        if len(x) < len(appearance):
            x = x.expand(len(appearance), *x.shape[1:])  # (N, outputs, ...)
        return self.norm(x, appearance) if isinstance(self.norm, AdaIN) else batch_norm_relu(self.norm, x)


class Generator(nn.Module):
    """Appearance (N, A) -> volume logits (N, 4, n, n, n), the last channel the occupancy's (section 3.2, supplement).

    Refines a code drawn once from a normal distribution and never trained. `adain` conditions every stage on the
    appearance; without it the appearance takes the code's place (the encoder-decoder row of Table 2).

    Raises ViewnetError for a number of widths that does not fit the volume.
    """

    code: Tensor

    def __init__(self, config: ModelConfig):
        super().__init__()
        levels = power_of_two(config.volume_size, 8, "volume_size") - 2  # 4 voxels a side, then doublings
        widths = config.generator_channels[:levels]
        if len(widths) < levels:
            raise ViewnetError(
                f"generator_channels {widths}: {levels} are needed for a volume of {config.volume_size} voxels a side"
            )
        self.adain = config.decoder != "encoder_decoder"
        appearance = config.appearance_size if self.adain else None
        self.register_buffer("code", torch.randn(1, config.code_size, 1, 1, 1))  # z of section 3.2
        opening = (
            FixedCodeDeconv(self.code, widths[0]) if self.adain else FirstDeconv(config.appearance_size, widths[0])
        )
        stages = [Stage(opening, appearance)]
        for before, width in pairwise(widths):
            stages.append(Stage(nn.ConvTranspose3d(before, width, 4, 2, 1, bias=False), appearance))
            if config.generator_refine:
                stages.append(Stage(nn.ConvTranspose3d(width, width, 3, 1, 1, bias=False), appearance))
        self.stages = nn.ModuleList(stages).to(memory_format=torch.channels_last_3d)
        kernel = config.generator_last_kernel
        self.last = Upsample2x(widths[-1]) if kernel == 2 else nn.ConvTranspose3d(widths[-1], 4, kernel, 2, 1)

    def blocks(self, appearance: Tensor) -> Tensor:
        """The logits as viewnet.model.volume.squash takes them."""
        # The first layer's result is one for all objects until AdaIN tells them apart.
        x = self.code if self.adain else appearance[:, :, None, None, None]  # (1 or N, C, 1, 1, 1)
        for stage in self.stages:
            x = stage(x.contiguous(memory_format=torch.channels_last_3d), appearance)
        if isinstance(self.last, Upsample2x):
            return self.last.blocks(x)
        logits = self.last(x).permute(0, 2, 3, 4, 1)  # (N, n, n, n, 4)
        return logits.reshape(*logits.shape[:4], 1, 1, 1, 4)  # (N, n, n, n, 1, 1, 1, 4)

    def forward(self, appearance: Tensor) -> Tensor:
        """Logits (N, 4, n, n, n) of appearances (N, A)."""
        return joined(self.blocks(appearance))


class HoloGANDecoder(nn.Module):
    """Appearance (N, A) and camera frames -> images with learned layers after the rotation (Table 2, last row).

    Features, a quarter of the image's side as in HoloGAN, are made as volumes are, rotated rigidly, and pass two 3-D
    convolutions. Then their depth is folded into channels, and 2-D transposed convolutions make colours and mask, with
    AdaIN again: without it logits run away within thirty steps, and images stay empty. Nothing ties one view's pixels
    to another's.
    """

    def __init__(self, config: ModelConfig):
        super().__init__()
        size = max(config.render_size // 4, 8)  # less could not be told from another viewpoint
        levels = power_of_two(size, 8, "render_size / 4") - 2
        widths = (*config.generator_channels[: levels + 1], *[config.generator_channels[-1]] * 8)[: levels + 1]
        self.code = nn.Parameter(0.02 * torch.randn(1, widths[0], 4, 4, 4))
        self.enter = AdaIN(widths[0], config.appearance_size)
        self.stages = nn.ModuleList(
            Stage(nn.ConvTranspose3d(a, b, 4, 2, 1, bias=False), config.appearance_size) for a, b in pairwise(widths)
        )
        thin = max(widths[-1] // 2, 4)
        self.seen = nn.Sequential(
            nn.Conv3d(widths[-1], thin, 3, padding=1), nn.ReLU(), nn.Conv3d(thin, thin, 3, padding=1), nn.ReLU()
        )
        flat = thin * size  # channels once depth is folded into them
        self.fold = nn.Sequential(nn.Conv2d(flat, flat, 1), nn.ReLU())
        painted = [max(flat >> 2 * level, 16) for level in range(power_of_two(config.render_size // size, 1, "") + 1)]
        self.paint = nn.ModuleList(
            Stage(nn.ConvTranspose2d(a, b, 4, 2, 1, bias=False), config.appearance_size) for a, b in pairwise(painted)
        )
        self.last = nn.Conv2d(painted[-1], 4, 3, padding=1)
        for painting in (self.fold, self.paint, self.last):
            painting.to(memory_format=torch.channels_last)
        self.seen.to(memory_format=torch.channels_last_3d)

    def features(self, appearance: Tensor) -> Tensor:
        """Feature volumes (N, C, s, s, s), before any rotation, zero at their sides and so beyond them."""
        x = self.enter(self.code.expand(len(appearance), -1, -1, -1, -1), appearance)  # (N, C, 4, 4, 4)
        for stage in self.stages:
            x = stage(x, appearance)
        return F.pad(x[:, :, 1:-1, 1:-1, 1:-1], (1,) * 6)  # (N, C, s, s, s)

    def render(self, features: Tensor, appearance: Tensor, world_from_camera: Tensor) -> Tensor:
        """Images (N, 4, S, S), RGB times mask and mask, of feature volumes (B, ...) and appearances (B, A); N = K B."""
        views = _rotated(features, world_from_camera)  # (N, s, s, s, C), depth third
        x = self.seen(views.movedim(-1, 1))  # (N, c, s, s, s)
        x = self.fold(x.movedim(1, -1).flatten(3).movedim(-1, 1))  # (N, s c, s, s), of a pixel all depths and channels
        appearance = appearance.repeat_interleave(len(x) // len(appearance), 0)  # (N, A)
        for stage in self.paint:
            x = stage(x, appearance)
        colour, mask = torch.sigmoid(self.last(x)).float().split((3, 1), 1)
        return torch.cat([colour * mask, mask], 1)  # (N, 4, S, S)


def _rotated(features: Tensor, world_from_camera: Tensor) -> Tensor:
    """Feature volumes (B, C, s, s, s) as cameras (N, 3, 3) see them: (N, s, s, s, C), depth third, near first."""
    if norm_relu_cpu.usable(features):
        from viewnet.model.kernels import rotation_numba  # imported late: Numba takes a second to load

        return rotation_numba.rotated(features, world_from_camera)
    size, share = features.shape[-1], len(world_from_camera) // len(features)
    points = ray_points(size, size, world_from_camera.new_zeros(()))
    # A volume's K views are one grid (B, K s, s, s, 3), one behind the other: no copy of the volume for each.
    grid = torch.einsum("nij,dhwj->ndhwi", world_from_camera, points).unflatten(0, (-1, share)).flatten(1, 2)
    rotated = F.grid_sample(features, grid.to(features.dtype), padding_mode="border", align_corners=False)
    return rotated.unflatten(2, (share, size)).permute(0, 2, 4, 5, 3, 1).flatten(0, 1)  # (N, s, s, s, C)


def gaussian_prior(size: int, width: float = 0.05) -> Tensor:
    """S of section 3.3 on a volume of `size` voxels a side: exp(-r^2 / width), r in half sides of the volume."""
    axis = (torch.arange(size) * 2 + 1) / size - 1  # (n,), the voxels' centres
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    return torch.exp(-(x**2 + y**2 + z**2) / width)  # (n, n, n)


def parameters(module: nn.Module) -> int:
    """Number of learned parameters."""
    return sum(math.prod(p.shape) for p in module.parameters())
