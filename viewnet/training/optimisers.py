"""Optimisers and the learning rate over time: Adam (section 4.1), and Muon (Jordan et al. 2024) beside it (ours)."""

import math
from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor

from viewnet.config import OptimiserConfig, TrainConfig
from viewnet.model.precision import half_precision
from viewnet.model.viewnet import ViewNet

INNER_LAYERS = (torch.nn.Conv2d, torch.nn.ConvTranspose3d)
BFLOAT16_FROM = 128  # rows from which matrices are made orthogonal in bfloat16


class Muon(torch.optim.Optimizer):
    """Steps along each weight's momentum, made orthogonal as a matrix (first dimension, all others).

    A network learns viewpoints in about half the steps that Adam takes. `torch.optim.Muon` takes matrices only, and
    works in bfloat16, which is slow where the processor has none, and for small matrices everywhere.
    """

    def __init__(self, params: Iterable[Tensor], lr: float = 0.02, momentum: float = 0.95, half: bool = False):
        super().__init__(params, {"lr": lr, "momentum": momentum})
        self.half = half  # bfloat16 for matrices that are large enough to gain by it

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        """One step along the gradients there are; `closure` is not called."""
        for group in self.param_groups:
            for weight in group["params"]:
                if weight.grad is None:
                    continue
                state: dict[str, Any] = self.state[weight]
                if not state:
                    state["momentum"] = torch.zeros_like(weight)  # a running mean of gradients
                state["momentum"].lerp_(weight.grad, 1 - group["momentum"])
                direction = weight.grad.lerp(state["momentum"], group["momentum"]).flatten(1)  # (first, all others)
                rows, columns = direction.shape  # of Nesterov's direction
                scale = max(1.0, rows / columns) ** 0.5  # a unit change of outputs, tall or wide
                weight.add_(orthogonal(direction, half=self.half).view_as(weight), alpha=-group["lr"] * scale)


def orthogonal(matrix: Tensor, iterations: int = 4, half: bool = False) -> Tensor:
    """The matrix (a, b) with its singular values brought near 1, by Newton-Schulz iterations of degree five."""
    a, b, c = 3.4445, -4.7750, 2.0315  # steep at 0: singular values end in about 0.7 to 1.2, not at 1
    x = matrix.T if matrix.shape[0] > matrix.shape[1] else matrix  # a <= b: the smaller Gram matrix
    x = x / (x.norm() + 1e-7)  # singular values of 1 at most: else it diverges
    if half and len(x) >= BFLOAT16_FROM:
        x = x.bfloat16()
    # Every iteration multiplies by a polynomial of the Gram matrix, and these commute: they are gathered first.
    gram, product = x @ x.T, None  # (a, a)
    # The Gram matrix's norm bounds the largest singular value more tightly than the matrix's, which is worth an
    # iteration where there are many of one size.
    size = gram.norm() + 1e-7
    gram, x = gram / size, x / size.sqrt()
    for left in reversed(range(iterations)):
        factor = torch.addmm(gram, gram, gram, beta=b, alpha=c)  # a I + b G + c G^2, with the next line
        factor.diagonal().add_(a)
        product = factor if product is None else factor @ product
        if left:
            gram = factor @ gram @ factor  # of the next iterate
    x = (x if product is None else product @ x).to(matrix.dtype)
    return x.T if matrix.shape[0] > matrix.shape[1] else x  # (a, b), as it came


def make_optimisers(model: ViewNet, config: TrainConfig) -> list[torch.optim.Optimizer]:
    """Adam, and Muon for the inner convolutions of encoders and generator where the settings ask for it."""
    settings = config.optimiser
    parts = [*model.viewpoint.encoder, *model.appearance, *getattr(model.decoder, "stages", [])]
    # Neither a first layer, which sees colours, nor any last one: those are no maps from features to features.
    matrices = [
        layer.weight
        for part in (parts if settings.muon else [])
        for layer in part.modules()  # module by module, within stages too
        if isinstance(layer, INNER_LAYERS) and layer.in_channels > 3 and layer.kernel_size[0] > 1
    ]
    taken = {id(weight) for weight in matrices}  # by identity: == compares elements
    others = [weight for weight in model.parameters() if id(weight) not in taken]
    optimisers: list[torch.optim.Optimizer] = [
        torch.optim.Adam(others, lr=settings.learning_rate, betas=settings.betas, fused=True)  # fused: one pass
    ]
    if matrices:
        optimisers.append(Muon(matrices, settings.muon, half=half_precision(matrices[0].device, config)))
    for optimiser in optimisers:
        for group in optimiser.param_groups:
            group["initial_lr"] = group["lr"]  # what a schedule scales
    return optimisers


def set_learning_rates(optimisers: list[torch.optim.Optimizer], config: OptimiserConfig, progress: float) -> None:
    """Learning rates when the share `progress` of training is done, by `config.schedule`."""
    factor = 1.0
    if config.schedule != "constant":
        held = 0.6 if config.schedule == "hold" else 0.0  # share of training at the full rate
        factor = 0.5 * (1 + math.cos(math.pi * max(0.0, progress - held) / (1 - held)))  # 1 -> 0
    for optimiser in optimisers:
        for group in optimiser.param_groups:
            group["lr"] = group["initial_lr"] * factor
