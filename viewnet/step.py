"""One training step: target views drawn again from another view's appearance and the best of M viewpoint hypotheses."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data.pairs import resize, tight_crop
from viewnet.geometry import azimuth_elevation, look_at, view_vector
from viewnet.losses import PerceptualLoss, composite, cycle_loss, head_errors, pixel_loss
from viewnet.model import Hypotheses, ViewNet


@dataclass
class Reconstruction:
    """One pass over target views: what was said of them and how they were drawn."""

    hypotheses: Hypotheses
    errors: Tensor  # (N, M) of each head
    best: Tensor  # (N,) the head with the least
    nearby: Tensor  # (N, M, 3) the viewpoint around each head's that explains the target best
    picture: Tensor  # (N, 3 or 1, S, S) of the best head, over the background
    target: Tensor  # the same of the target view
    shape: Tensor
    appearance: Tensor


def reconstruct(
    model: ViewNet,
    appearance: Tensor,
    target: Tensor,
    seen: Tensor,
    config: TrainConfig,
    colour: Tensor,
    size: int | None = None,
) -> Reconstruction:
    """Draws targets (N, 4, s, s) from appearance views (B, 4, s, s), N = B K, over colours (N, 3) (equations 1 and 2).

    All heads are compared without gradients; only the best is drawn with them ("gradients will only be propagated
    through m*"). `seen` (N, 4, s, s) is what the viewpoint network sees of the targets: themselves, or cut and
    augmented. `size` is the drawings' side in pixels (default: the configuration's).
    """
    size, heads = size or model.config.render_size, model.config.heads
    with autocast(appearance.device, config):
        code = model.appearance(model.see(appearance))
        shape = model.shape(code, coarse=size < model.config.render_size)
        hypotheses = model.viewpoint(model.see(seen))
    wanted = _over(target if target.shape[-1] == size else resize(target, size), config, colour)
    frames = hypotheses.frames
    best = torch.zeros(len(target), dtype=torch.long, device=target.device)
    nearby, errors = hypotheses.vectors, None
    if heads > 1 or config.neighbours:
        with torch.no_grad():
            nearby, errors = compare(model, shape, code, hypotheses, wanted, config, colour)
        best = errors.argmin(1)
    with autocast(appearance.device, config):
        picture = _over(model.draw(shape, code, frames[torch.arange(len(best)), best], size), config, colour)
    if errors is None:
        errors = head_errors(picture.detach()[:, None], wanted)
    return Reconstruction(hypotheses, errors, best, nearby, picture, wanted, shape, code)


def compare(
    model: ViewNet,
    shape: Tensor,
    code: Tensor,
    hypotheses: Hypotheses,
    wanted: Tensor,
    config: TrainConfig,
    colour: Tensor,
) -> tuple[Tensor, Tensor]:
    """How well each head's viewpoint explains the targets (equation 2): viewpoints (N, M, 3) and errors (N, M).

    With `neighbours`, five viewpoints around each head's are drawn at half the resolution and the best counts. Two
    heads that are right up to a symmetry differ by their few degrees of error more than by the symmetry's traces; this
    takes the former out of the comparison.
    """
    heads, size = hypotheses.vectors.shape[1], wanted.shape[-1]
    vectors, ups = hypotheses.vectors[:, :, None], None
    if config.neighbours and model.training:
        vectors = _neighbours(hypotheses.vectors, config.neighbours)
        if size > 16 and model.config.decoder != "hologan":
            shape, wanted, size = F.avg_pool3d(shape, 2), resize(wanted, size // 2), size // 2
    tried = vectors.shape[2]
    if hypotheses.ups is not None:
        ups = hypotheses.ups[:, :, None].expand_as(vectors).flatten(0, 2)
    with autocast(shape.device, config):
        drawn = model.draw(shape, code, look_at(vectors.flatten(0, 2), ups), size)
    drawn = _over(drawn, config, colour.repeat_interleave(heads * tried, 0)).unflatten(0, (-1, heads * tried))
    errors, which = head_errors(drawn, wanted).unflatten(1, (heads, tried)).min(2)
    return vectors.gather(2, which[:, :, None, None].expand(-1, -1, 1, 3))[:, :, 0], errors


def _neighbours(vectors: Tensor, angle: float) -> Tensor:
    """View vectors (N, M, 3) and those `angle` degrees to the left, right, above and below: (N, M, 5, 3)."""
    azimuth, elevation = azimuth_elevation(vectors)
    step = vectors.new_tensor([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]]) * angle
    higher = (elevation[..., None] + step[:, 1] / 2).clamp(-89, 89)
    return view_vector(azimuth[..., None] + step[:, 0], higher)


def _over(picture: Tensor, config: TrainConfig, colour: Tensor) -> Tensor:
    return picture[:, 3:] if config.target == "mask" else composite(picture, colour)


def backgrounds(config: TrainConfig, count: int, generator: torch.Generator, device: torch.device) -> Tensor:
    """Colours (count, 3) behind target and reconstruction: black as printed, or one random colour a sample."""
    if config.background == "black":
        return torch.zeros(count, 3, device=device)
    return torch.rand(count, 3, generator=generator).to(device)


def autocast(device: torch.device, config: TrainConfig) -> torch.autocast:
    """bfloat16 for convolutions where the hardware computes in it, plain float32 elsewhere."""
    able = torch.cuda.is_bf16_supported() if device.type == "cuda" else bool(torch.cpu._is_amx_tile_supported())
    return torch.autocast(device.type, torch.bfloat16, enabled=able and config.amp == "auto")


def augment(pictures: Tensor, generator: torch.Generator) -> Tensor:
    """Random crops of 80 to 100 % of the area and rotations within 3 degrees of pictures (N, C, S, S)."""
    count = len(pictures)
    scale = (0.8 + 0.2 * torch.rand(count, generator=generator)).sqrt()
    shift = (2 * torch.rand(count, 2, generator=generator) - 1) * (1 - scale)[:, None]
    angle = torch.deg2rad(6 * torch.rand(count, generator=generator) - 3)
    rows = [
        torch.stack([scale * angle.cos(), -scale * angle.sin(), shift[:, 0]], 1),
        torch.stack([scale * angle.sin(), scale * angle.cos(), shift[:, 1]], 1),
    ]
    grid = F.affine_grid(torch.stack(rows, 1).to(pictures), list(pictures.shape), align_corners=False)
    return F.grid_sample(pictures, grid, align_corners=False)


def step_loss(
    model: ViewNet,
    batch: tuple[Tensor, Tensor, Tensor],
    config: TrainConfig,
    perceptual: PerceptualLoss | None,
    progress: float,
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """The terms of one step's loss, weighted; their sum is minimised. `progress` is the share of training done."""
    appearance, target, seen = batch
    device = appearance.device
    colour = backgrounds(config, len(target), generator, device)
    seen = augment(seen, generator) if config.augment else seen
    # The HoloGAN decoder's layers paint one size only.
    coarse = progress < config.coarse and model.config.decoder != "hologan"
    size = model.config.render_size // 2 if coarse else model.config.render_size
    found = reconstruct(model, appearance, target, seen, config, colour, size)
    terms: dict[str, Tensor] = {}
    if perceptual is not None:
        channels = (found.picture.expand(-1, 3, -1, -1), found.target.expand(-1, 3, -1, -1))
        terms["perceptual"] = perceptual(*channels)
    if config.pixel_weight:
        terms["pixels"] = config.pixel_weight * pixel_loss(found.picture, found.target)
    if config.neighbour_weight:
        rows = torch.arange(len(target), device=device)
        better = found.nearby[rows, found.best] - found.hypotheses.vectors[rows, found.best]
        terms["neighbour"] = config.neighbour_weight * better.square().sum(-1).mean()
    if model.config.heads > 1:
        terms["selection"] = config.selection_weight * F.cross_entropy(found.hypotheses.logits, found.best)
    ramp = min(1.0, (progress - config.cycle_start) / 0.1) if config.cycle_start else 1.0
    if config.cycle and ramp > 0:
        terms["cycle"] = ramp * config.cycle_weight * _cycle(model, found, config, generator)
    return terms


def _cycle(model: ViewNet, found: Reconstruction, config: TrainConfig, generator: torch.Generator) -> Tensor:
    """Section 3.4: new views of the same objects at random viewpoints, and what the viewpoint network says of them."""
    count = len(found.appearance)
    low, high = config.cycle_elevation
    azimuth = 360 * torch.rand(count, generator=generator)
    elevation = low + (high - low) * torch.rand(count, generator=generator)
    truth = view_vector(azimuth, elevation).to(found.appearance.device)
    with torch.no_grad(), autocast(truth.device, config):
        novel = model.draw(found.shape, found.appearance, look_at(truth), model.config.input_size)
        if model.config.crop:
            novel = tight_crop(novel, model.config.input_size)
    with autocast(truth.device, config):
        return cycle_loss(model.viewpoint(model.see(novel)), truth, config)
