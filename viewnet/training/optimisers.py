"""Adam (section 4.1), and Muon (Jordan et al. 2024) beside it (ours): their learning rates over time, and a step."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.optimizer import ParamsT

from viewnet.config import OptimiserConfig, TrainConfig
from viewnet.errors import ViewnetError
from viewnet.model.fast_layers import FixedCodeDeconv
from viewnet.model.precision import half_precision
from viewnet.model.viewnet import ViewNet
from viewnet.runtime import distributed

INNER_LAYERS = (nn.Conv2d, nn.ConvTranspose3d)
BFLOAT16_FROM = 2**16  # numbers from which matrices are made orthogonal in bfloat16
POLYNOMIALS = ((7.711, -22.1138, 16.2487), (3.2153, -2.4112, 0.5013), (2.2183, -1.594, 0.4107))
"""Of degree five, a x + b x^3 + c x^5, one after the other: together they bring singular values in [0.02, 1] to within
0.1 of 1. Each is the closest to 1 on the interval that the one before leaves (a linear program on a fine grid)."""


class Muon(Optimizer):
    """Steps along each weight's momentum, made orthogonal as a matrix (first dimension, all others).

    A network learns viewpoints in about half the steps that Adam takes. `torch.optim.Muon` takes matrices only, and
    works in bfloat16, which is slow where the processor has none, and for small matrices everywhere.
    """

    def __init__(self, params: ParamsT, lr: float = 0.02, momentum: float = 0.95, half: bool = False):
        super().__init__(params, {"lr": lr, "momentum": momentum})
        self.half = half  # bfloat16 for matrices that are large enough to gain by it

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        """One step along the gradients there are; `closure` is not called."""
        for group in self.param_groups:
            weights = [weight for weight in group["params"] if weight.grad is not None]
            matrices = []
            for weight in weights:
                state = self.state[weight]
                if not state:
                    state["momentum"] = torch.zeros_like(weight)
                state["momentum"].lerp_(weight.grad, 1 - group["momentum"])  # a running mean of gradients
                ahead = weight.grad.lerp(state["momentum"], group["momentum"])  # Nesterov's
                # (first, all others), the second last of them: as channels-last weights lie in memory
                matrices.append(ahead.movedim(1, -1).flatten(1))
            for weight, direction in zip(weights, orthogonal(matrices, self.half), strict=True):
                # A unit change of outputs, tall or wide.
                rate = group["lr"] * max(1.0, direction.shape[0] / direction.shape[1]) ** 0.5
                last = weight.movedim(1, -1)  # (first, ..., second)
                last.add_(direction.view(last.shape), alpha=-rate)


def orthogonal(matrices: Sequence[Tensor], half: bool = False) -> list[Tensor]:
    """The matrices (a, b) with their singular values brought near 1, by POLYNOMIALS of their Gram matrices.

    Gram matrices of one size are worked on together: most of them are so small that calls take longer than products.
    """
    wide = [matrix.T if matrix.shape[0] > matrix.shape[1] else matrix for matrix in matrices]  # a <= b: smaller Grams
    wide = [x.bfloat16() if half and x.numel() >= BFLOAT16_FROM else x for x in wide]
    found = list(matrices)
    for rows, dtype in {(len(x), x.dtype) for x in wide}:
        members = [k for k, x in enumerate(wide) if (len(x), x.dtype) == (rows, dtype)]
        gram, product = torch.stack([wide[k] @ wide[k].T for k in members]), None  # (K, a, a)
        # Singular values of 1 at most, or it diverges: the Gram matrix's norm bounds the largest more tightly than the
        # matrix's, which is worth a step where there are many of one size.
        size = gram.flatten(1).norm(dim=1)[:, None, None] + 1e-30  # (K, 1, 1), not 0
        gram = gram / size
        # Every step multiplies by a polynomial of the Gram matrix, and these commute: they are gathered first.
        for step, (a, b, c) in enumerate(POLYNOMIALS, 1):
            factor = torch.baddbmm(gram, gram, gram, beta=b, alpha=c)  # a I + b G + c G^2, with the next line
            factor.diagonal(dim1=1, dim2=2).add_(a)
            product = factor if product is None else factor @ product
            if step < len(POLYNOMIALS):
                gram = factor @ gram @ factor  # of what this step makes of x
        assert product is not None
        product = product / size.sqrt()
        for k, by in zip(members, product, strict=True):
            x = (by @ wide[k]).to(matrices[k].dtype)
            found[k] = x.T if matrices[k].shape[0] > matrices[k].shape[1] else x  # (a, b), as it came
    return found


def make_optimisers(model: ViewNet, config: TrainConfig) -> list[Optimizer]:
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
    openings = [part.output for part in model.decoder.modules() if isinstance(part, FixedCodeDeconv)]
    taken = {id(weight) for weight in (*matrices, *openings)}  # by identity: == compares elements
    others = [weight for weight in model.parameters() if id(weight) not in taken]
    # Where a layer's output is learned in the place of its weights, rates are those of its weights.
    rate, norm = (settings.muon, 2) if settings.muon else (settings.learning_rate, 1)
    opening = [{"params": openings, "lr": rate * model.decoder.code.norm(norm).item()}] if openings else []
    adam = [{"params": others}, *([] if settings.muon else opening)]
    optimisers: list[Optimizer] = [
        torch.optim.Adam(adam, lr=settings.learning_rate, betas=settings.betas, fused=True)  # fused: one pass
    ]
    if matrices:
        half = half_precision(matrices[0].device, config)
        optimisers.append(Muon([{"params": matrices}, *opening], settings.muon, half=half))
    return optimisers


def set_learning_rates(optimisers: Sequence[Optimizer], config: OptimiserConfig, progress: float) -> None:
    """Learning rates when the share `progress` of training is done, by `config.schedule`."""
    factor = 1.0
    if config.schedule != "constant":
        held = 0.6 if config.schedule == "hold" else 0.0  # share of training at the full rate
        factor = 0.5 * (1 + math.cos(math.pi * max(0.0, progress - held) / (1 - held)))  # 1 -> 0
    for optimiser in optimisers:
        for group in optimiser.param_groups:
            group["lr"] = group.setdefault("initial_lr", group["lr"]) * factor  # as it was at the first call


def descend(
    model: nn.Module, optimisers: Sequence[Optimizer], terms: dict[str, Tensor], step: int, what: Path | str
) -> dict[str, float]:
    """One step of training along the sum of a loss's weighted terms; returns the terms, means over all processes.

    ViewnetError, naming `what` is trained, for a loss that is not finite: the weights then are as they were.
    """
    values = torch.stack(list(terms.values()))  # (terms,)
    logged = dict(zip(terms, distributed.mean(values.detach()).tolist(), strict=True))  # one copy to the CPU
    if not math.isfinite(sum(logged.values())):
        names = ", ".join(f"{name} {value:.3g}" for name, value in logged.items())
        raise ViewnetError(f"{what}: the loss is not finite at step {step} ({names}): lower the learning rate")
    model.zero_grad(set_to_none=True)
    values.sum().backward()  # the sum: terms stay apart only in the log
    distributed.average_gradients(model.parameters())
    for optimiser in optimisers:  # Adam, and perhaps Muon
        optimiser.step()
    return logged
