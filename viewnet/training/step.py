"""One training step: the terms of the loss on a batch of pairs (sections 3.1 to 3.4)."""

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data import augment
from viewnet.data.pairs import resize, tight_crop
from viewnet.geometry import look_at, view_vector
from viewnet.model.losses import PerceptualLoss, cycle_loss, pixel_loss
from viewnet.model.precision import autocast
from viewnet.model.reconstruction import Reconstruction, reconstruct
from viewnet.model.viewnet import ViewNet
from viewnet.runtime import distributed
from viewnet.runtime.random import RandomSource, rand, repeated
from viewnet.training.pose_search import PoseSearch, Search

RELEASED_ELEVATIONS = (-36.0, 72.0)
"""Degrees of the novel views of cycles where a model's elevations have no limits, as released."""


def step_loss(
    model: ViewNet,
    batch: tuple[Tensor, Tensor, Tensor],
    config: TrainConfig,
    perceptual: PerceptualLoss | None,
    progress: float,
    generator: RandomSource,
    backgrounds: Tensor | None = None,
) -> dict[str, Tensor]:
    """The weighted terms of one step's loss, whose sum is minimised. `progress` is the share of training done.

    `batch` is appearance images (B, 4, S, S), targets (N, 4, S, S) and these as the viewpoint network sees them
    (N, 4, S, S), N a multiple of B. `backgrounds`, images (K, 3, 2S, 2S) uint8, are put behind both networks' inputs,
    never behind the target.
    """
    appearance, target, viewpoint_input = batch
    device = appearance.device
    # ---- what the networks see
    if config.augment:
        viewpoint_input = augment.crop_and_rotate(viewpoint_input, generator)  # as in the released code
    target = resize(target, model.config.render_size)  # (N, 4, S, S), S = render_size
    background = None
    if backgrounds is not None:
        times = config.photo.views_per_target
        viewpoint_input = viewpoint_input.repeat(times, 1, 1, 1)  # (K N, 4, S, S)
        viewpoint_input = augment.photograph(viewpoint_input, backgrounds, config.photo, repeated(generator, times))
        background = augment.windows(backgrounds, len(appearance), appearance.shape[-1], generator, device)

    # ---- reconstruction from the best viewpoint (equations 1 and 2)
    choose = pose_search(config, progress, generator)
    result = reconstruct(model, appearance, target, viewpoint_input, config, choose, background)

    # ---- losses on images
    if config.target == "mask":
        image, reference = result.rendered[:, 3:], result.target[:, 3:]  # (N, 1, S, S)
    else:
        image, reference = result.rendered[:, :3], result.target[:, :3]  # (N, 3, S, S), over black
    terms: dict[str, Tensor] = {}
    if perceptual is not None:
        terms["perceptual"] = perceptual(image.expand(-1, 3, -1, -1), reference.expand(-1, 3, -1, -1))  # (N, 3, S, S)
    # Relative to how much of the image objects fill, or thin ones would count for less than other terms.
    filled = distributed.mean(target[:, 3].mean()).clamp(min=0.01)
    if config.pixel_weight:
        terms["pixels"] = config.pixel_weight * pixel_loss(image, reference) / filled
    if config.mask_weight:
        terms["masks"] = config.mask_weight * pixel_loss(result.rendered[:, 3:], result.target[:, 3:]) / filled

    # ---- losses on viewpoints
    choice, hypotheses = result.choice, result.hypotheses
    if config.comparison.pull_weight and (config.comparison.neighbours or config.search.share):
        pulled = hypotheses.of_heads(choice.head)  # (N, 3)
        terms["pull"] = config.comparison.pull_weight * (choice.viewpoint - pulled).square().sum(-1).mean()
    if model.config.heads > 1:
        wanted = selection_target(choice.errors, config.comparison.temperature)  # (N, M)
        terms["selection"] = F.cross_entropy(hypotheses.logits, wanted)
    if len(result.repeated.logits):  # K > 0 more images of each target
        terms["repeated_views"] = repeated_views_loss(result, config)
    if config.cycle.on:
        terms["cycle"] = config.cycle.weight * _cycle(model, result, config, generator, backgrounds)
    return terms


def pose_search(config: TrainConfig, progress: float, generator: RandomSource) -> PoseSearch:
    """How viewpoints are chosen when the share `progress` of training is done."""
    searching = progress < config.search.share
    # The noise is gone half-way through the search.
    noise = max(0.0, 1 - 2 * progress / config.search.share) if searching else 0.0
    return PoseSearch(Search(config.search.views, noise, generator) if searching else None)


def selection_target(errors: Tensor, temperature: float) -> Tensor:
    """How the selection should share itself out among heads with these reconstruction errors (N, M): (N, M).

    All of it for the best, as reported (section 3.1). With a temperature, heads that explain an image nearly as well
    have nearly the same share: which of them has the lower error is often chance, and nothing to learn.
    """
    least, best = errors.min(1, keepdim=True)  # (N, 1) each
    if not temperature:
        return torch.zeros_like(errors).scatter_(1, best, 1.0)
    return (-errors / (temperature * least.clamp(min=1e-9))).softmax(1)


def repeated_views_loss(result: Reconstruction, config: TrainConfig) -> Tensor:
    """What one reconstruction teaches of a target's other images: its viewpoint, and which heads to select.

    As for the image it was made for: the head closest to the viewpoint is pulled, and each head's share of the
    selection is that of those heads of the first image which it is closest to.
    """
    hypotheses, choice = result.repeated, result.choice
    times = len(hypotheses.logits) // len(choice.head)
    viewpoint, heads = (
        view.detach().repeat(times, *[1] * (view.dim() - 1))  # (K N, 3) and (K N, M, 3)
        for view in (choice.viewpoint, result.hypotheses.vectors)
    )
    closest = (hypotheses.vectors - viewpoint[:, None]).square().sum(-1).argmin(1)  # (K N,)
    loss = config.comparison.pull_weight * (viewpoint - hypotheses.of_heads(closest)).square().sum(-1).mean()
    if heads.shape[1] > 1:
        wanted = selection_target(choice.errors, config.comparison.temperature).repeat(times, 1)  # (K N, M)
        same = (hypotheses.vectors[:, :, None] - heads[:, None]).square().sum(-1).argmin(1)  # (K N, M)
        shares = torch.zeros_like(wanted).scatter_add_(1, same, wanted)  # (K N, M)
        loss = loss + F.cross_entropy(hypotheses.logits, shares)
    return times * loss  # K images count K times


def _cycle(
    model: ViewNet, result: Reconstruction, config: TrainConfig, generator: RandomSource, backgrounds: Tensor | None
) -> Tensor:
    """Section 3.4: the same objects rendered from random viewpoints, which the viewpoint network is to predict."""
    count = len(result.objects.code)
    low, high = model.config.elevation_limits or RELEASED_ELEVATIONS
    azimuth = 360 * rand(count, generator=generator)  # (B,)
    elevation = low + (high - low) * rand(count, generator=generator)
    truth = view_vector(azimuth, elevation).to(result.objects.code.device)  # (B, 3)
    with torch.no_grad(), autocast(truth.device, config):  # f^v alone learns from the cycle
        novel = model.render(result.objects.volume, result.objects.code, look_at(truth), model.config.input_size)
        if model.config.crop != "none":
            novel = tight_crop(novel, model.config.input_size, model.config.crop == "stretched")  # (B, 4, s, s)
        if backgrounds is not None:
            novel = augment.photograph(novel, backgrounds, config.photo, generator)
    with autocast(truth.device, config):
        return cycle_loss(model.viewpoint(model.composite(novel)), truth, config.cycle)
