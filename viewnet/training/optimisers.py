"""The optimisers of a training, and the learning rate over time (section 4.1; Muon and its schedule are ours)."""

import math

import torch

from viewnet.config import OptimiserConfig, TrainConfig
from viewnet.model.precision import half_precision
from viewnet.model.viewnet import ViewNet
from viewnet.training.muon import Muon

INNER_LAYERS = (torch.nn.Conv2d, torch.nn.ConvTranspose3d)


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
