"""One training step: the terms of the loss on a batch of pairs (sections 3.1 to 3.4)."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data import augment
from viewnet.data.pairs import resize, tight_crop
from viewnet.geometry import look_at, view_vector
from viewnet.model.losses import PerceptualLoss, composite, cycle_loss, pixel_loss
from viewnet.model.precision import autocast
from viewnet.model.reconstruction import Reconstruction, reconstruct
from viewnet.model.viewnet import Hypotheses, ViewNet
from viewnet.runtime import distributed
from viewnet.runtime.random import RandomSource, rand, repeated
from viewnet.training.pose_search import PoseSearch, Search


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
    if config.jitter:
        viewpoint_input = augment.jitter(viewpoint_input, config.jitter, generator)  # f^v cannot rely on colours
    target = resize(target, model.config.render_size)  # (N, 4, S, S), S = render_size
    if config.mirror:  # of a symmetric object the mirrored image is another of its views
        mirrored = (rand(len(target), 1, 1, 1, generator=generator) < 0.5).to(device)  # (N, 1, 1, 1)
        viewpoint_input, target = (
            torch.where(mirrored, images.flip(-1), images) for images in (viewpoint_input, target)
        )
    background = None
    if backgrounds is not None:
        times = config.photo.views_per_target
        viewpoint_input = viewpoint_input.repeat(times, 1, 1, 1)  # (K N, 4, S, S)
        viewpoint_input = augment.photograph(viewpoint_input, backgrounds, config.photo, repeated(generator, times))
        background = augment.windows(backgrounds, len(appearance), appearance.shape[-1], generator, device)

    # ---- reconstruction from the best viewpoint (equations 1 and 2)
    own_shape = min(1.0, progress / config.shared_shape) if config.shared_shape else 1.0  # one for all at first
    choose = pose_search(config, progress, generator)
    result = reconstruct(model, appearance, target, viewpoint_input, config, choose, own_shape, background)

    # ---- losses on images
    if config.target == "mask":
        image, reference = result.rendered[:, 3:], result.target[:, 3:]  # (N, 1, S, S)
    else:
        colour = background_colours(config, len(target), generator, device)
        image, reference = composite(result.rendered, colour), composite(result.target, colour)
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
    if config.comparison.pull_weight:
        pulled = hypotheses.of_heads(choice.head)  # (N, 3)
        terms["pull"] = config.comparison.pull_weight * (choice.viewpoint - pulled).square().sum(-1).mean()
    if model.config.heads > 1:
        right = hypotheses.of_heads(choice.label).detach()  # (N, 3)
        terms["selection"] = config.selection.weight * selection_loss(
            hypotheses, choice.label, right, config.selection.angle
        )
    if len(result.repeated.logits):  # K > 0 more images of each target
        terms["repeated_views"] = repeated_views_loss(result, config)
    ramp = min(1.0, (progress - config.cycle.start) / 0.1) if config.cycle.start else 1.0  # over a tenth of training
    if config.cycle.on and ramp > 0:
        terms["cycle"] = ramp * config.cycle.weight * _cycle(model, result, config, generator, backgrounds)
    return terms


def pose_search(config: TrainConfig, progress: float, generator: RandomSource) -> PoseSearch:
    """How viewpoints are chosen when the share `progress` of training is done."""
    searching = progress < config.search.share
    # The noise is gone half-way through the search.
    noise = max(0.0, 1 - 2 * progress / config.search.share) if searching else 0.0
    return PoseSearch(
        search=Search(config.search.views, noise, generator) if searching else None,
        # A selection that has seen little knows little.
        trust=config.selection.trust if progress >= 0.5 else 0.0,
    )


def background_colours(config: TrainConfig, count: int, generator: RandomSource, device: torch.device) -> Tensor:
    """Colours (count, 3) behind target and reconstruction: black as reported, or one random colour a sample."""
    if config.background == "black":
        return torch.zeros(count, 3, device=device)  # (N, 3)
    return rand(count, 3, generator=generator).to(device)


def repeated_views_loss(result: Reconstruction, config: TrainConfig) -> Tensor:
    """What one reconstruction teaches of a target's other images: its viewpoint, and which head to select.

    As for the image it was made for, the closest head is pulled, and the one closest to the head to select is selected.
    """
    hypotheses, choice = result.repeated, result.choice
    times = len(hypotheses.logits) // len(choice.label)
    viewpoint, right = (
        view.detach().repeat(times, 1)  # (K N, 3)
        for view in (choice.viewpoint, result.hypotheses.of_heads(choice.label))
    )
    closest, label = ((hypotheses.vectors - view[:, None]).square().sum(-1).argmin(1) for view in (viewpoint, right))
    loss = config.comparison.pull_weight * (viewpoint - hypotheses.of_heads(closest)).square().sum(-1).mean()
    if hypotheses.logits.shape[1] > 1:
        loss = loss + config.selection.weight * selection_loss(hypotheses, label, right, config.selection.angle)
    return times * loss  # K images count K times


def selection_loss(hypotheses: Hypotheses, label: Tensor, right: Tensor, angle: float) -> Tensor:
    """Cross-entropy of selecting the head `label` (N,), or any other within `angle` degrees of `right` (N, 3).

    Where two heads predict the same, which of them explains an image better is random: there is nothing to learn.
    """
    vectors, logits = hypotheses.vectors.detach(), hypotheses.logits
    accepted = F.one_hot(label, logits.shape[1]).bool()  # (N, M)
    if angle:
        accepted |= (vectors * right[:, None]).sum(-1) > math.cos(math.radians(angle))  # (N, M)
    return -logits.log_softmax(1).masked_fill(~accepted, -math.inf).logsumexp(1).mean()  # (N,), averaged


def _cycle(
    model: ViewNet, result: Reconstruction, config: TrainConfig, generator: RandomSource, backgrounds: Tensor | None
) -> Tensor:
    """Section 3.4: the same objects rendered from random viewpoints, which the viewpoint network is to predict."""
    count = len(result.objects.code)
    low, high = config.cycle.elevation
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
