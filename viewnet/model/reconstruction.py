"""One pass of the method: targets reconstructed from another view's appearance and the best of M viewpoint hypotheses.

This is all of equations 1 and 2. Training hands in another choice among viewpoints (viewnet.training.matting).
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.geometry import look_at
from viewnet.model import volume
from viewnet.model.kernels import volume_cpu
from viewnet.model.losses import head_errors
from viewnet.model.precision import autocast
from viewnet.model.viewnet import Hypotheses, ViewNet


@dataclass
class Choice:
    """Which viewpoint explains each of N targets best, and what that teaches the M heads."""

    head: Tensor  # (N,) the head to teach
    viewpoint: Tensor  # (N, 3) the view vector to teach it
    errors: Tensor  # (N, M) reconstruction error of each head
    render_from: Tensor | None = None  # (N, 3) view vectors to reconstruct from; None: the hypothesis of `head`


@dataclass
class Encoded:
    """Objects as a network encodes them from appearance images."""

    code: Tensor  # (B, A) appearance codes
    volume: Tensor  # (B, 4, n, n, n), or the HoloGAN decoder's features


@dataclass
class Reconstruction:
    """Targets, the hypotheses for them, the choice among these, and the images rendered from it."""

    hypotheses: Hypotheses  # (N, M, ...)
    repeated: Hypotheses  # (K N, M, ...) for K more images of the targets, which are not reconstructed
    choice: Choice
    rendered: Tensor  # (N, 4, S, S)
    target: Tensor  # (N, 4, S, S)
    objects: Encoded


Choose = Callable[[ViewNet, Encoded, Hypotheses, Tensor, TrainConfig], Choice]
"""(model, objects, hypotheses, targets (N, 4, S, S), settings) -> Choice; called without gradients."""


def reconstruct(
    model: ViewNet,
    appearance: Tensor,
    target: Tensor,
    viewpoint_input: Tensor,
    config: TrainConfig,
    choose: Choose | None = None,
) -> Reconstruction:
    """Reconstructs targets (N, 4, S, S), S = render_size, from appearance images (B, 4, s, s), N = B K.

    All heads are compared without gradients; only the best is rendered with them ("gradients will only be propagated
    through m*", section 3.1). `viewpoint_input` (N, 4, s, s) are the targets as the viewpoint network sees them: whole,
    or cropped and augmented; (N + K N, 4, s, s) where it sees each more than once, all targets in turn.
    `choose` defaults to `best_head`.
    """
    with autocast(appearance.device, config):
        objects = Encoded(*model.encode(appearance))  # f^a and the generator
        predicted = model.viewpoint(model.composite(viewpoint_input))  # f^v, logits and vectors for all M
    hypotheses, repeated = predicted.rows(slice(len(target))), predicted.rows(slice(len(target), None))
    with torch.no_grad():  # equation 2 chooses; losing heads learn nothing
        choice = (choose or best_head)(model, objects, hypotheses, target, config)
    if choice.render_from is None:  # looked up here, with gradients
        cameras = hypotheses.world_from_camera[torch.arange(len(target)), choice.head]  # (N, 3, 3)
    else:
        cameras = look_at(choice.render_from)  # (N, 3, 3)
    with autocast(appearance.device, config):
        rendered = model.render(objects.volume, objects.code, cameras)
    return Reconstruction(hypotheses, repeated, choice, rendered, target, objects)


def best_head(model: ViewNet, objects: Encoded, hypotheses: Hypotheses, target: Tensor, config: TrainConfig) -> Choice:
    """The head with the least reconstruction error: m* of equation 2."""
    _, errors = compare(model, objects, hypotheses.vectors[:, :, None], hypotheses.ups, target, config)  # (N, M)
    head = errors.argmin(1)  # (N,)
    return Choice(head, hypotheses.of_heads(head), errors)


def compare(
    model: ViewNet, objects: Encoded, candidates: Tensor, ups: Tensor | None, target: Tensor, config: TrainConfig
) -> tuple[Tensor, Tensor]:
    """How well viewpoints explain targets (N, 4, S, S): T candidates for each head, as view vectors (N, M, T, 3).

    Returns each head's best candidate (N, M, 3) and its error (N, M), equation 2: of colours over black, and of masks.
    """
    if ups is not None:
        ups = ups[:, :, None].expand_as(candidates)  # (N, M, T, 3)
    cameras = look_at(candidates, ups)  # (N, M, T, 3, 3)
    # By the weights of the loss: "reconstruction error" is one word for both in the paper.
    weights = (config.pixel_weight or 1.0, config.mask_weight) if config.target == "image" else (0.0, 1.0)
    in_a_volume = model.config.decoder != "hologan"
    if in_a_volume and volume.fused_kernels(objects.volume.device) is volume_cpu:
        best, errors = volume_cpu.compare(objects.volume, cameras, model.focal, target, weights)  # (N, M) each
    else:
        with autocast(objects.volume.device, config):
            rendered = model.render(objects.volume, objects.code, cameras.flatten(0, 2), target.shape[-1])
        rendered = rendered.unflatten(0, (len(target), -1))  # (N, M T, 4, S, S)
        errors = rendered.new_zeros(rendered.shape[:2])
        for channels, weight in zip((slice(0, 3), slice(3, 4)), weights, strict=True):
            if weight:
                errors = errors + weight * head_errors(rendered[:, :, channels], target[:, channels])  # (N, M T)
        errors, best = errors.unflatten(1, candidates.shape[1:3]).min(2)  # (N, M)
    return candidates.take_along_dim(best[:, :, None, None], 2)[:, :, 0], errors  # (N, M, 3) and (N, M)
