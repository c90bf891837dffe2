"""One training step: target views drawn again from another view's appearance and the best of M viewpoint hypotheses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data import augment
from viewnet.data.pairs import resize, tight_crop
from viewnet.geometry import azimuth_elevation, look_at, view_vector
from viewnet.model.losses import PerceptualLoss, composite, cycle_loss, head_errors, pixel_loss
from viewnet.model.precision import autocast
from viewnet.model.viewnet import Hypotheses, ViewNet
from viewnet.model.volume import halved
from viewnet.runtime import distributed
from viewnet.runtime.random import RandomSource, rand, repeated

SECTORS = 4
"""Of azimuth: of viewpoints tried all around, the best of each is compared with the heads'."""


@dataclass(frozen=True)
class Stage:
    """What is at work at one point of training only. As it stands: nothing, as in evaluation."""

    search: Search | None = None  # what it finds is drawn instead of a head's viewpoint
    own: float = 1.0  # how much of its own shape each object has (ViewNet.imagine)
    trust: float = 0.0  # how much the selection counts in which head is drawn (TrainConfig.trust)


@dataclass
class Reconstruction:
    """One pass over target views: what was said of them and how they were drawn."""

    hypotheses: Hypotheses
    others: Hypotheses  # (K N, ...) of the targets as they were seen another K times; they are not drawn
    errors: Tensor  # (N, M) of each head
    best: Tensor  # (N,) the head to teach: with the least, or the closest to what the search found
    better: Tensor  # (N, 3) the viewpoint near that head's, or found by the search, that explains the target best
    label: Tensor  # (N,) the head that the selection is to choose
    drawn: Tensor  # (N, 4, S, S) from the head's viewpoint, or the one that the search found
    target: Tensor  # the target view at the same size
    shape: Tensor
    appearance: Tensor


def reconstruct(
    model: ViewNet,
    appearance: Tensor,
    target: Tensor,
    seen: Tensor,
    config: TrainConfig,
    stage: Stage | None = None,
    behind: Tensor | None = None,
) -> Reconstruction:
    """Draws targets (N, 4, s, s) from appearance views (B, 4, s, s), N = B K (equations 1 and 2).

    All heads are compared without gradients; only the best is drawn with them ("gradients will only be propagated
    through m*"). `seen` (N, 4, s, s) is what the viewpoint network sees of the targets: themselves, or cut and
    augmented; (N + K N, 4, s, s) where it sees each more than once, all targets in turn. `behind` (B, 3, s, s): what
    the appearance network sees behind the object, if not the backdrop.
    """
    stage, size = stage or Stage(), model.config.render_size
    with autocast(appearance.device, config):
        code, shape = model.imagine(appearance, stage.own, behind)
        sightings = model.viewpoint(model.see(seen))
    hypotheses, others = sightings.part(slice(len(target))), sightings.part(slice(len(target), None))
    target = target if target.shape[-1] == size else resize(target, size)
    with torch.no_grad():
        best, better, label, errors = _choose(model, shape, code, hypotheses, target, config, stage)
    drawn_from = look_at(better) if stage.search else hypotheses.frames[torch.arange(len(best)), best]
    with autocast(appearance.device, config):
        drawn = model.draw(shape, code, drawn_from)
    return Reconstruction(hypotheses, others, errors, best, better, label, drawn, target, shape, code)


@dataclass
class Search:
    """Viewpoints that are tried beside the heads', all around the object.

    Early on a viewpoint network answers from what little it has learned, and the volume settles on its mistakes: turned
    inside out, or with two sides folded into one. Tried viewpoints owe it nothing. `noise` is added to
    the errors before the choice, as a multiple of their spread over a target's viewpoints.
    """

    views: int
    noise: float
    generator: RandomSource

    def grid(self, count: int, limits: tuple[float, float]) -> Tensor:
        """View vectors (count, views, 3): azimuths evenly spaced and jittered, elevations uniform within limits."""
        places = torch.arange(self.views) + rand(count, self.views, generator=self.generator)
        elevation = rand(count, self.views, generator=self.generator) * (limits[1] - limits[0]) + limits[0]
        return view_vector(360 / self.views * places, elevation)

    def perturb(self, errors: Tensor) -> Tensor:
        """Errors (N, T) with Gumbel noise, so that the least is drawn from their Boltzmann distribution."""
        uniform = rand(*errors.shape, generator=self.generator).clamp(1e-9, 1 - 1e-7).to(errors.device)
        return errors + self.noise * errors.std(1, keepdim=True) * uniform.log().neg().log()


def _choose(
    model: ViewNet,
    shape: Tensor,
    code: Tensor,
    hypotheses: Hypotheses,
    target: Tensor,
    config: TrainConfig,
    stage: Stage,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The head to teach (N,), the viewpoint to teach it (N, 3), the head to select (N,), every head's error (N, M)."""
    vectors, rows = hypotheses.vectors, torch.arange(len(target), device=target.device)
    heads, limits = vectors.shape[1], model.config.elevation_limits or (-90.0, 90.0)
    better, errors = _compare_heads(model, shape, code, hypotheses, target, config)
    if not model.training:
        best = errors.argmin(1)
        return best, better[rows, best], best, errors
    score = errors
    if stage.trust and heads > 1:
        spread = distributed.mean(errors.std(1, keepdim=True).mean())
        score = errors - stage.trust * spread * hypotheses.logits.log_softmax(1)
    if stage.search:
        grid = stage.search.grid(len(target), limits).to(vectors)
        tried, found = _compare_grid(model, shape, code, grid, target, config)
        better, score = torch.cat([better, tried], 1), stage.search.perturb(torch.cat([score, found], 1))
    if config.search.balance and score.shape[1] > 1:
        score = _balanced(score, better, model.viewpoint.shares, limits, config.search.balance)
    winner = score.argmin(1)
    view = better[rows, winner]
    if config.search.balance:
        shares = model.viewpoint.shares
        counts = torch.bincount(_part(view, limits, shares.shape[1]), minlength=shares.numel())
        shares.lerp_(distributed.mean(counts / len(view)).view_as(shares), 0.02)
    closest = (vectors - view[:, None]).square().sum(-1).argmin(1)
    best = torch.where(winner < heads, winner, closest)
    # Were the selection taught what it had a say in, it would confirm itself.
    return best, view, errors.argmin(1) if stage.trust else best, errors


def _compare_heads(
    model: ViewNet, shape: Tensor, code: Tensor, hypotheses: Hypotheses, target: Tensor, config: TrainConfig
) -> tuple[Tensor, Tensor]:
    """Viewpoints (N, M, 3), each the head's own or its best neighbour, and how well they explain the targets (N, M).

    Neighbours are told apart at half the resolution; what tells two sides of an object apart is often smaller, so
    heads are compared at the full one.
    """
    better = hypotheses.vectors
    if model.training and config.comparison.neighbours:
        tried = _neighbours(better, config.comparison.neighbours)
        coarse, small = _half(model, shape, target)
        better, errors = compare(model, coarse, code, tried, hypotheses.ups, small, config)
        if coarse is shape or better.shape[1] == 1:
            return better, errors
    return compare(model, shape, code, better[:, :, None], hypotheses.ups, target, config)


def _compare_grid(
    model: ViewNet, shape: Tensor, code: Tensor, grid: Tensor, target: Tensor, config: TrainConfig
) -> tuple[Tensor, Tensor]:
    """Of viewpoints all around (N, T, 3) the best in each sector, (N, SECTORS, 3), and their errors (N, SECTORS).

    Within a sector half the resolution will do. Sectors are compared at the full one: at half of it the fin that tells
    an aeroplane's tail from its nose is gone, and a group of aeroplanes that is laid wrong then stays so.
    """
    coarse, small = _half(model, shape, target)
    if coarse is shape or grid.shape[1] <= SECTORS:
        return grid, compare(model, shape, code, grid[:, :, None], None, target, config)[1]
    whole = torch.cat([grid, grid[:, : -grid.shape[1] % SECTORS]], 1)
    best, _ = compare(model, coarse, code, whole.unflatten(1, (SECTORS, -1)), None, small, config)
    return compare(model, shape, code, best[:, :, None], None, target, config)


def _half(model: ViewNet, shape: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Volumes and targets at half the resolution; themselves where that is too low, or the decoder has one only."""
    if target.shape[-1] <= 16 or model.config.decoder == "hologan":
        return shape, target
    return halved(shape), resize(target, target.shape[-1] // 2)


def _balanced(score: Tensor, views: Tensor, shares: Tensor, limits: tuple[float, float], strength: float) -> Tensor:
    """Scores (N, T) of viewpoints (N, T, 3), raised where more than are due are chosen, as `shares` (12, bands) tell.

    A volume that has grown alike on two sides explains images of either from one of them, is never drawn from the
    other, and would stay as it is. Images are taken from all around and from all elevations within the limits, so no
    part of that is due more than its share.
    """
    smooth = (2 * shares + shares.roll(1, 0) + shares.roll(-1, 0)) / 4
    excess = torch.log(smooth * smooth.numel() + 0.05).flatten()[_part(views, limits, shares.shape[1])]
    return score + strength * score.std(1, keepdim=True) * excess


def _part(views: Tensor, limits: tuple[float, float], bands: int) -> Tensor:
    """In which part of the sphere view vectors (..., 3) lie: one of 12 sectors of azimuth times bands of elevation."""
    azimuth, elevation = azimuth_elevation(views)
    band = ((elevation - limits[0]) / (limits[1] - limits[0]) * bands).long().clamp(0, bands - 1)
    return (azimuth / 30).long() % 12 * bands + band


def compare(
    model: ViewNet,
    shape: Tensor,
    code: Tensor,
    tried: Tensor,
    ups: Tensor | None,
    target: Tensor,
    config: TrainConfig,
) -> tuple[Tensor, Tensor]:
    """How well viewpoints explain targets (equation 2): T are tried for each head, as view vectors (N, M, T, 3).

    Returns each head's best (N, M, 3) and its error (N, M). Colours are compared over black, and masks apart from
    them: over a random background the silhouette is hidden where it happens to have the object's colour.
    """
    heads, count = tried.shape[1:3]
    if ups is not None:
        ups = ups[:, :, None].expand_as(tried).flatten(0, 2)
    with autocast(shape.device, config):
        drawn = model.draw(shape, code, look_at(tried.flatten(0, 2), ups), target.shape[-1])
    drawn = drawn.unflatten(0, (-1, heads * count))
    image = config.target == "image"
    weights = (config.comparison.colours if image else 0.0, config.comparison.masks if image else 1.0)
    found = drawn.new_zeros(drawn.shape[:2])
    for channels, weight in zip((slice(0, 3), slice(3, 4)), weights, strict=True):
        if weight:
            found = found + weight * head_errors(drawn[:, :, channels], target[:, channels])
    errors, which = found.unflatten(1, (heads, count)).min(2)
    return tried.gather(2, which[:, :, None, None].expand(-1, -1, 1, 3))[:, :, 0], errors


def _neighbours(vectors: Tensor, angle: float) -> Tensor:
    """View vectors (N, M, 3) and those `angle` degrees to the left, right, above and below: (N, M, 5, 3)."""
    azimuth, elevation = azimuth_elevation(vectors)
    step = vectors.new_tensor([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]]) * angle
    higher = (elevation[..., None] + step[:, 1] / 2).clamp(-89, 89)
    return view_vector(azimuth[..., None] + step[:, 0], higher)


def backgrounds(config: TrainConfig, count: int, generator: RandomSource, device: torch.device) -> Tensor:
    """Colours (count, 3) behind target and reconstruction: black as printed, or one random colour a sample."""
    if config.background == "black":
        return torch.zeros(count, 3, device=device)
    return rand(count, 3, generator=generator).to(device)


def step_loss(
    model: ViewNet,
    batch: tuple[Tensor, Tensor, Tensor],
    config: TrainConfig,
    perceptual: PerceptualLoss | None,
    progress: float,
    generator: RandomSource,
    scenery: Tensor | None = None,
) -> dict[str, Tensor]:
    """The terms of one step's loss, weighted; their sum is minimised. `progress` is the share of training done.

    With `scenery`, images (K, 3, S, S) uint8, there is something behind both inputs, never behind the target.
    """
    appearance, target, seen = batch
    device = appearance.device
    seen = augment.crop_and_rotate(seen, generator) if config.augment else seen
    seen = augment.jitter(seen, config.jitter, generator) if config.jitter else seen
    if config.mirror:
        mirrored = (rand(len(target), 1, 1, 1, generator=generator) < 0.5).to(device)
        seen, target = (torch.where(mirrored, images.flip(-1), images) for images in (seen, target))
    behind = None
    if scenery is not None:
        several = repeated(generator, config.photo.views_per_target)
        seen = augment.photograph(seen.repeat(config.photo.views_per_target, 1, 1, 1), scenery, config, several)
        behind = augment.behind(scenery, len(appearance), appearance.shape[-1], generator, device)
    stage = _stage(model, config, progress, generator)
    found = reconstruct(model, appearance, target, seen, config, stage, behind)
    if config.target == "mask":
        image, wanted = found.drawn[:, 3:], found.target[:, 3:]
    else:
        colour = backgrounds(config, len(target), generator, device)
        image, wanted = composite(found.drawn, colour), composite(found.target, colour)
    terms: dict[str, Tensor] = {}
    if perceptual is not None:
        terms["perceptual"] = perceptual(image.expand(-1, 3, -1, -1), wanted.expand(-1, 3, -1, -1))
    # Relative to how much of the image the objects fill, or thin ones would count for less than other terms.
    filled = distributed.mean(target[:, 3].mean()).clamp(min=0.01)
    if config.pixel_weight:
        terms["pixels"] = config.pixel_weight * pixel_loss(image, wanted) / filled
    if config.mask_weight:
        terms["masks"] = config.mask_weight * pixel_loss(found.drawn[:, 3:], found.target[:, 3:]) / filled
    if config.comparison.pull_weight:
        pulled = found.hypotheses.pick(found.best)
        terms["pull"] = config.comparison.pull_weight * (found.better - pulled).square().sum(-1).mean()
    if model.config.heads > 1:
        wanted = found.hypotheses.pick(found.label).detach()
        terms["selection"] = config.selection.weight * _selection(
            found.hypotheses, found.label, wanted, config.selection.angle
        )
    if len(found.others.logits):
        terms["sightings"] = _sightings(found, config)
    ramp = min(1.0, (progress - config.cycle.start) / 0.1) if config.cycle.start else 1.0
    if config.cycle.on and ramp > 0:
        terms["cycle"] = ramp * config.cycle.weight * _cycle(model, found, config, generator, scenery)
    return terms


def _stage(model: ViewNet, config: TrainConfig, progress: float, generator: RandomSource) -> Stage:
    """What is at work when the share `progress` of training is done."""
    # The noise is gone half-way through the search.
    noise = max(0.0, 1 - 2 * progress / config.search.share) if config.search.share else 0.0
    return Stage(
        search=Search(config.search.views, noise, generator) if progress < config.search.share else None,
        own=min(1.0, progress / config.shared_shape) if config.shared_shape else 1.0,
        # A selection that has seen little says little.
        trust=config.selection.trust if progress >= 0.5 else 0.0,
    )


def _sightings(found: Reconstruction, config: TrainConfig) -> Tensor:
    """What the target's one drawing teaches of its other images: the viewpoint drawn from, and which head to select.

    As for the image it was drawn for, the closest head is pulled, and the one closest to the head to select selected.
    """
    times = len(found.others.logits) // len(found.label)
    drawn, wanted = (view.detach().repeat(times, 1) for view in (found.better, found.hypotheses.pick(found.label)))
    closest, label = ((found.others.vectors - view[:, None]).square().sum(-1).argmin(1) for view in (drawn, wanted))
    loss = config.comparison.pull_weight * (drawn - found.others.pick(closest)).square().sum(-1).mean()
    if found.others.logits.shape[1] > 1:
        loss = loss + config.selection.weight * _selection(found.others, label, wanted, config.selection.angle)
    return times * loss


def _selection(hypotheses: Hypotheses, label: Tensor, wanted: Tensor, angle: float) -> Tensor:
    """Cross-entropy of choosing the head `label` (N,), or any other within `angle` degrees of `wanted` (N, 3).

    Where two heads answer the same, which of them explains an image better is chance: there is nothing to learn.
    """
    vectors, logits = hypotheses.vectors.detach(), hypotheses.logits
    right = F.one_hot(label, logits.shape[1]).bool()
    if angle:
        right |= (vectors * wanted[:, None]).sum(-1) > math.cos(math.radians(angle))
    return -logits.log_softmax(1).masked_fill(~right, -math.inf).logsumexp(1).mean()


def _cycle(
    model: ViewNet,
    found: Reconstruction,
    config: TrainConfig,
    generator: RandomSource,
    scenery: Tensor | None,
) -> Tensor:
    """Section 3.4: new views of the same objects at random viewpoints, and what the viewpoint network says of them."""
    count = len(found.appearance)
    low, high = config.cycle.elevation
    azimuth = 360 * rand(count, generator=generator)
    elevation = low + (high - low) * rand(count, generator=generator)
    truth = view_vector(azimuth, elevation).to(found.appearance.device)
    with torch.no_grad(), autocast(truth.device, config):
        novel = model.draw(found.shape, found.appearance, look_at(truth), model.config.input_size)
        if model.config.crop != "none":
            novel = tight_crop(novel, model.config.input_size, model.config.crop == "stretched")
        if scenery is not None:
            novel = augment.photograph(novel, scenery, config, generator)
    with autocast(truth.device, config):
        return cycle_loss(model.viewpoint(model.see(novel)), truth, config)
