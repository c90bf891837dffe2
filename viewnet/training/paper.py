"""The terms of the loss that the paper has: reconstruction, selection, cycle consistency (sections 3.1 to 3.4).

viewnet/reference.py has the same on one page; viewnet.training.matting is what our recipe adds.
"""

import torch
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data import augment
from viewnet.geometry import look_at, view_vector
from viewnet.model.losses import PerceptualLoss, cycle_loss, selection_loss
from viewnet.model.precision import autocast
from viewnet.model.reconstruction import Reconstruction
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.images import tight_crop
from viewnet.runtime.random import RandomSource, rand

RELEASED_ELEVATIONS = (-36.0, 72.0)
"""Degrees of the novel views of cycles where a model's elevations have no limits, as released."""


def terms(
    model: ViewNet,
    result: Reconstruction,
    config: TrainConfig,
    perceptual: PerceptualLoss | None,
    generator: RandomSource,
    backgrounds: Tensor | None = None,
) -> dict[str, Tensor]:
    """Name -> weighted term, a scalar: "perceptual", "selection" and "cycle", each where the settings have it."""
    found: dict[str, Tensor] = {}
    if perceptual is not None:  # the distance D of equation 1 (section 4.1)
        image, reference = (images.expand(-1, 3, -1, -1) for images in compared(result, config))  # (N, 3, S, S)
        found["perceptual"] = perceptual(image, reference)
    if model.config.heads > 1:  # which head is m* of equation 2 (section 3.1)
        found["selection"] = selection_loss(
            result.hypotheses.logits, result.choice.errors, config.comparison.temperature
        )
    if config.cycle.on:  # section 3.4
        novel, truth = novel_views(model, result, config, generator, backgrounds)
        with autocast(truth.device, config):
            predicted = model.viewpoint(model.composite(novel))
            found["cycle"] = config.cycle.weight * cycle_loss(predicted, truth, config.cycle)
    return found


def compared(result: Reconstruction, config: TrainConfig) -> tuple[Tensor, Tensor]:
    """Reconstructions and targets over black (N, 3, S, S); their masks (N, 1, S, S) where these are the target."""
    channels = slice(3, 4) if config.target == "mask" else slice(0, 3)
    return result.rendered[:, channels], result.target[:, channels]


@torch.no_grad()
def novel_views(
    model: ViewNet, result: Reconstruction, config: TrainConfig, generator: RandomSource, backgrounds: Tensor | None
) -> tuple[Tensor, Tensor]:
    """A batch's objects from random viewpoints (section 3.4): images (B, 4, s, s), and view vectors (B, 3).

    Without gradients: the viewpoint network alone learns from the cycle.
    """
    objects, settings = result.objects, model.config
    low, high = settings.elevation_limits or RELEASED_ELEVATIONS
    azimuth = 360 * rand(len(objects.code), generator=generator)  # (B,)
    elevation = low + (high - low) * rand(len(objects.code), generator=generator)
    truth = view_vector(azimuth, elevation).to(objects.code.device)  # (B, 3)
    with autocast(truth.device, config):
        novel = model.render(objects.volume, objects.code, look_at(truth), settings.input_size)
        if settings.crop != "none":
            novel = tight_crop(novel, settings.input_size, settings.crop == "stretched")  # (B, 4, s, s)
        if backgrounds is not None:
            novel = augment.photograph(novel, backgrounds, config.photo, generator)
    return novel, truth
