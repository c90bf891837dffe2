"""Augmentation: views of CAD models cut and rotated, and made to look like photographs (section 4.3 and ours).

Backgrounds are images (K, 3, B, B) uint8, B twice the side of the networks' input (viewnet.data.backgrounds). Only what
the networks see is changed, never the target: the object alone is reconstructed. Random numbers are a generator's.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import DataConfig, PhotoAugmentationConfig
from viewnet.data.backgrounds import Backgrounds
from viewnet.data.backgrounds import load as load_backgrounds
from viewnet.runtime.images import CROP_MARGIN, composite
from viewnet.runtime.random import RandomSource, rand, randint, randn

COUNT = 1000  # backgrounds at most; many windows are cut from each


def load(config: DataConfig, size: int, device: torch.device) -> Tensor | None:
    """Backgrounds (K, 3, 2 size, 2 size) uint8 for inputs of `size` pixels a side, None where `config` has none.

    So a window is a quarter of an image.
    """
    backgrounds = made(config, size, progress=False)
    return None if backgrounds is None else torch.from_numpy(backgrounds.images).to(device)


def made(config: DataConfig, size: int, progress: bool = True) -> Backgrounds | None:
    """The same with their identity; made where they are not there yet."""
    if config.backgrounds is None:
        return None
    return load_backgrounds(config.backgrounds, 2 * size, COUNT, progress=progress)


def windows(images: Tensor, count: int, size: int, generator: RandomSource, device: torch.device) -> Tensor:
    """`count` random windows (count, 3, size, size) in [0, 1] of images (K, 3, B, B), half of them mirrored."""
    room = images.shape[-1] - size + 1  # places for a window's corner
    chosen = randint(len(images), count, generator=generator).tolist()
    places = randint(room, count, 2, generator=generator).tolist()
    parts = [images[k, :, y : y + size, x : x + size] for k, (y, x) in zip(chosen, places, strict=True)]
    mirrored = (rand(count, 1, 1, 1, generator=generator) < 0.5).to(device)
    result = torch.stack(parts).to(device).float() / 255  # (count, 3, size, size)
    return torch.where(mirrored, result.flip(-1), result)


def over(images: Tensor, background: Tensor) -> Tensor:
    """Images (N, 4, S, S), RGB times alpha and alpha, over backgrounds (N, 3, S, S): the same, without transparency."""
    return torch.cat([composite(images, background), torch.ones_like(images[:, 3:])], 1)


def appearance(images: Tensor, backgrounds: Tensor, config: PhotoAugmentationConfig, generator: RandomSource) -> Tensor:
    """What the appearance network sees of images (N, 4, S, S): a random background behind each, unless `cut_out`."""
    if config.cut_out:
        return images
    return over(images, windows(backgrounds, len(images), images.shape[-1], generator, images.device))


def crop_and_rotate(images: Tensor, generator: RandomSource) -> Tensor:
    """Random crops of 80 to 100 % of the area and rotations within 3 degrees of images (N, C, S, S)."""
    count = len(images)
    scale = (0.8 + 0.2 * rand(count, generator=generator)).sqrt()  # the root: of the side
    shift = (2 * rand(count, 2, generator=generator) - 1) * (1 - scale)[:, None]  # (N, 2); crops stay within the image
    angle = torch.deg2rad(6 * rand(count, generator=generator) - 3)
    return _sampled(images, scale.expand(2, -1), shift, angle)


def _sampled(images: Tensor, scale: Tensor, shift: Tensor, angle: Tensor) -> Tensor:
    """Parts of images (N, C, S, S): a `scale` (2, N) of their width and height, moved by `shift` (N, 2), rotated."""
    rows = [  # (N, 3) each: affine maps in [-1, 1]
        torch.stack([scale[0] * angle.cos(), -scale[0] * angle.sin(), shift[:, 0]], 1),
        torch.stack([scale[1] * angle.sin(), scale[1] * angle.cos(), shift[:, 1]], 1),
    ]
    grid = F.affine_grid(torch.stack(rows, 1).to(images), list(images.shape), align_corners=False)  # (N, 2, 3)
    return F.grid_sample(images, grid, align_corners=False)


def photograph(crops: Tensor, backgrounds: Tensor, config: PhotoAugmentationConfig, generator: RandomSource) -> Tensor:
    """Crops of views (N, 4, S, S), RGB times alpha and alpha, as if cut from photographs: (N, 4, S, S) with alpha 1.

    Crops have CROP_MARGIN about the object, photographs' boxes none. In this order: the box is off by up to `box_error`
    of its sides and tilted by up to `tilt` degrees; a background is put behind the object; light, contrast, blur and
    noise vary with strength `exposure`.
    """
    count, size, device = len(crops), crops.shape[-1], crops.device
    crops = _shifted(crops, config, generator)
    images = composite(crops, windows(backgrounds, count, size, generator, device))  # (N, 3, S, S)
    if config.exposure:
        images = expose(images, config.exposure, generator)
    return torch.cat([images, torch.ones_like(crops[:, 3:])], 1)


def expose(images: Tensor, strength: float, generator: RandomSource) -> Tensor:
    """Images (N, 3, S, S) in [0, 1] with other brightness, contrast and gamma, blurred and noisy.

    Colours stay: red lamps are what tells the rear of many a car from its front.
    """
    count, device = len(images), images.device
    each = (count, 1, 1, 1)  # one number an image
    contrast, gamma = (torch.exp(strength * _uniform(-0.4, 0.4, each, generator)).to(device) for _ in range(2))
    light = (strength * _uniform(-0.15, 0.15, each, generator)).to(device)
    mean = images.mean((1, 2, 3), keepdim=True)  # (N, 1, 1, 1)
    images = ((images - mean) * contrast + mean + light).clamp(0, 1) ** gamma
    blurred = F.avg_pool2d(F.pad(images, (1, 1, 1, 1), mode="replicate"), 3, 1)  # 3x3 box
    images = torch.lerp(images, blurred, _uniform(0, min(1.0, strength), each, generator).to(device))
    deviation = (strength * _uniform(0, 0.05, each, generator)).to(device)
    noise = randn(*images.shape, generator=generator).to(device)
    return (images + deviation * noise).clamp(0, 1)


def _shifted(crops: Tensor, config: PhotoAugmentationConfig, generator: RandomSource) -> Tensor:
    """Crops (N, 4, S, S) scaled, moved and rotated; what comes in from outside is empty."""
    count = len(crops)
    scale = (1 + config.box_error * _uniform(-1, 1, (2, count), generator, dim=1)) / (1 + 2 * CROP_MARGIN)  # (2, N)
    shift = config.box_error * _uniform(-1, 1, (count, 2), generator)
    angle = torch.deg2rad(config.tilt * _uniform(-1, 1, (count,), generator))
    return _sampled(crops, scale, shift, angle)


def _uniform(low: float, high: float, shape: tuple[int, ...], generator: RandomSource, dim: int = 0) -> Tensor:
    return low + (high - low) * rand(*shape, generator=generator, dim=dim)
