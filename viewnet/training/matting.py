"""What our recipe adds to the paper's step: other viewpoints than the heads' to reconstruct from, and further terms.

Early on the viewpoint network answers from what little it has learned, and the volume settles on its mistakes: turned
inside out, or with two sides folded into one. Viewpoints of a search do not depend on it.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.geometry import azimuth_elevation, view_vector
from viewnet.model.losses import pixel_loss, pull_loss, selection_target
from viewnet.model.reconstruction import Choice, Encoded, Reconstruction, compare
from viewnet.model.viewnet import Hypotheses, ViewNet
from viewnet.model.volume import halved
from viewnet.runtime import distributed
from viewnet.runtime.images import resize
from viewnet.runtime.random import RandomSource, rand
from viewnet.training.paper import compared

SECTORS = 4
"""Of azimuth: of a search's viewpoints, the best of each sector is compared with the heads'."""


Coarse = tuple[Encoded, Tensor]
"""Objects and targets (N, 4, S, S) at half the resolution."""


def terms(result: Reconstruction, config: TrainConfig) -> dict[str, Tensor]:
    """Name -> weighted term, a scalar: "pixels", "masks", "pull" and "repeated_views", each where settings have it."""
    found: dict[str, Tensor] = {}
    # Relative to how much of the image objects fill, or thin ones would count for less than other terms.
    filled = distributed.mean(result.target[:, 3].mean()).clamp(min=0.01)
    if config.pixel_weight:
        found["pixels"] = config.pixel_weight * pixel_loss(*compared(result, config)) / filled
    if config.mask_weight:
        found["masks"] = config.mask_weight * pixel_loss(result.rendered[:, 3:], result.target[:, 3:]) / filled
    if config.comparison.pull_weight and (config.comparison.neighbours or config.search.share):
        chosen = result.hypotheses.of_heads(result.choice.head)  # (N, 3)
        found["pull"] = config.comparison.pull_weight * pull_loss(chosen, result.choice.viewpoint)
    if len(result.repeated.logits):  # K > 0 more images of each target
        found["repeated_views"] = repeated_views_loss(result, config)
    return found


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
    closest = hypotheses.closest(viewpoint)  # (K N,)
    loss = config.comparison.pull_weight * pull_loss(hypotheses.of_heads(closest), viewpoint)
    if heads.shape[1] > 1:
        wanted = selection_target(choice.errors, config.comparison.temperature).repeat(times, 1)  # (K N, M)
        same = (hypotheses.vectors[:, :, None] - heads[:, None]).square().sum(-1).argmin(1)  # (K N, M)
        shares = torch.zeros_like(wanted).scatter_add_(1, same, wanted)  # (K N, M)
        loss = loss + F.cross_entropy(hypotheses.logits, shares)
    return times * loss  # K images count K times


@dataclass
class Search:
    """Viewpoints all around the object. `noise`, added to errors, is a multiple of their spread over a target's."""

    views: int
    noise: float
    generator: RandomSource

    def grid(self, count: int, limits: tuple[float, float]) -> Tensor:
        """View vectors (count, views, 3): azimuths evenly spaced and jittered, elevations uniform within limits."""
        places = torch.arange(self.views) + rand(count, self.views, generator=self.generator)  # (N, T), one a sector
        elevation = rand(count, self.views, generator=self.generator) * (limits[1] - limits[0]) + limits[0]
        return view_vector(360 / self.views * places, elevation)  # (N, T, 3)

    def perturb(self, errors: Tensor) -> Tensor:
        """Errors (N, T) with Gumbel noise, so that the least is a sample of their Boltzmann distribution."""
        uniform = rand(*errors.shape, generator=self.generator).clamp(1e-9, 1 - 1e-7).to(errors.device)  # 0 < U < 1
        # log(-log U) is minus a Gumbel variable: minus, as the least error wins.
        return errors + self.noise * errors.std(1, keepdim=True) * uniform.log().neg().log()


@dataclass(frozen=True)
class PoseSearch:
    """The choice of viewpoints at one point of training; called as viewnet.model.reconstruction.Choose."""

    search: Search | None = None  # its viewpoints compete with the heads', and are reconstructed from

    def __call__(
        self, model: ViewNet, objects: Encoded, hypotheses: Hypotheses, target: Tensor, config: TrainConfig
    ) -> Choice:
        """The best viewpoint of each target, and what it teaches the heads."""
        vectors = hypotheses.vectors
        heads, limits = vectors.shape[1], model.config.elevation_limits or (-90.0, 90.0)
        coarse = objects, target
        if self.search or config.comparison.neighbours:
            coarse = half_resolution(model, objects, target)
        candidates, errors = compare_heads(model, objects, hypotheses, target, config, coarse)  # (N, M, 3), (N, M)
        score = errors
        if self.search:
            grid = self.search.grid(len(target), limits).to(vectors)
            searched, search_errors = compare_grid(model, objects, grid, target, config, coarse)
            candidates = torch.cat([candidates, searched], 1)  # (N, M + SECTORS, 3)
            score = self.search.perturb(torch.cat([score, search_errors], 1))  # (N, M + SECTORS)
        winner = score.argmin(1)
        viewpoint = candidates[torch.arange(len(target), device=target.device), winner]  # (N, 3)
        # A searched winner teaches the nearest head.
        head = torch.where(winner < heads, winner, hypotheses.closest(viewpoint))  # (N,)
        return Choice(head, viewpoint, errors, viewpoint if self.search else None)


def pose_search(config: TrainConfig, progress: float, generator: RandomSource) -> PoseSearch:
    """How viewpoints are chosen when the share `progress` of training is done."""
    searching = progress < config.search.share
    # The noise is gone half-way through the search.
    noise = max(0.0, 1 - 2 * progress / config.search.share) if searching else 0.0
    return PoseSearch(Search(config.search.views, noise, generator) if searching else None)


def compare_heads(
    model: ViewNet, objects: Encoded, hypotheses: Hypotheses, target: Tensor, config: TrainConfig, coarse: Coarse
) -> tuple[Tensor, Tensor]:
    """View vectors (N, M, 3), each the head's own or its best neighbour, and their errors (N, M).

    Neighbours are compared at half the resolution, `coarse`; what tells two sides of an object apart is often smaller,
    so heads are compared at the full one.
    """
    best = hypotheses.vectors
    if config.comparison.neighbours:
        candidates = neighbours(best, config.comparison.neighbours)  # (N, M, 5, 3)
        small_objects, small_target = coarse
        best, errors = compare(model, small_objects, candidates, hypotheses.ups, small_target, config)
        if small_objects is objects or best.shape[1] == 1:
            return best, errors
    return compare(model, objects, best[:, :, None], hypotheses.ups, target, config)  # candidates (N, M, 1, 3)


def compare_grid(
    model: ViewNet, objects: Encoded, grid: Tensor, target: Tensor, config: TrainConfig, coarse: Coarse
) -> tuple[Tensor, Tensor]:
    """Of viewpoints all around (N, T, 3) the best in each sector, (N, SECTORS, 3), and their errors (N, SECTORS).

    Within a sector half the resolution, `coarse`, is enough. Sectors are compared at the full one: at half of it the
    fin that tells an aeroplane's tail from its nose is gone, and aeroplanes that are laid wrong then stay so.
    """
    small_objects, small_target = coarse
    if small_objects is objects or grid.shape[1] <= SECTORS:
        return grid, compare(model, objects, grid[:, :, None], None, target, config)[1]  # candidates (N, T, 1, 3)
    whole = torch.cat([grid, grid[:, : -grid.shape[1] % SECTORS]], 1)  # T a multiple of SECTORS
    by_sector = whole.unflatten(1, (SECTORS, -1))  # (N, SECTORS, T / SECTORS, 3)
    best, _ = compare(model, small_objects, by_sector, None, small_target, config)
    return compare(model, objects, best[:, :, None], None, target, config)  # candidates (N, SECTORS, 1, 3)


def half_resolution(model: ViewNet, objects: Encoded, target: Tensor) -> Coarse:
    """Volumes and targets at half the resolution; themselves where that is too low, or the decoder has one only."""
    if target.shape[-1] <= 16 or model.config.decoder == "hologan":
        return objects, target
    return Encoded(objects.code, halved(objects.volume)), resize(target, target.shape[-1] // 2)


def neighbours(vectors: Tensor, angle: float) -> Tensor:
    """View vectors (N, M, 3) and those `angle` degrees to the left, right, above and below: (N, M, 5, 3)."""
    azimuth, elevation = azimuth_elevation(vectors)
    step = vectors.new_tensor([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]]) * angle  # (5, 2), azimuth and elevation
    higher = (elevation[..., None] + step[:, 1] / 2).clamp(-89, 89)  # (N, M, 5); azimuth means nothing at the poles
    return view_vector(azimuth[..., None] + step[:, 0], higher)  # (N, M, 5, 3)
