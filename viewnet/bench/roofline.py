"""The least time a machine needs: arithmetic counted from shapes, over measured rates of multiplying and copying."""

import time
from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.modules.module import register_module_forward_hook
from torch.utils.flop_counter import FlopCounterMode

from viewnet import reference
from viewnet.config import ModelConfig

SAMPLE = 36
"""Multiply-adds at a point of a ray: eight corners of four values, and four sums. Backward takes twice as many."""
OPAQUE = 1e-5
"""A ray ends when less light than this is left."""
COUNTED = (nn.modules.conv._ConvNd, nn.Linear)


@dataclass(frozen=True)
class Rates:
    """Multiply-adds per second in float32 and bfloat16 matrix products; bytes per second read and written by copies."""

    float32: float
    bfloat16: float
    copy: float

    @classmethod
    def measure(cls, device: torch.device, quick: bool = False) -> "Rates":
        """The best of several tries. bfloat16 is far slower than float32 on CPUs without it."""
        side = 256 if quick else 8192 if device.type == "cuda" else 2048

        def best(call: Callable[..., Any], *tensors: Tensor) -> float:
            call(*tensors)  # not timed
            return min(seconds(lambda: call(*tensors), device) for _ in range(5))

        source = torch.ones((4 if quick else 64) * 2**20, device=device)
        copying = best(torch.empty_like(source).copy_, source)
        matrices = torch.randn(2, side, side, device=device)
        full, half = (best(torch.mm, *matrices.to(kind)) for kind in (torch.float32, torch.bfloat16))
        return cls(side**3 / full, side**3 / half, 2 * source.nbytes / copying)


def synchronise(device: torch.device) -> None:
    """Wait for a GPU to finish."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def seconds(call: Callable[[], Any], device: torch.device, times: int = 1) -> float:
    """Seconds per call, the mean of `times` in a row."""
    synchronise(device)
    start = time.perf_counter()
    for _ in range(times):
        call()
    synchronise(device)
    return (time.perf_counter() - start) / times


@dataclass(frozen=True)
class Need:
    """The least amount of work: multiply-adds of layers and of ray samples, numbers moved from and to memory."""

    products: float = 0.0
    samples: float = 0.0
    layer_values: float = 0.0  # in the precision of the layers
    values: float = 0.0  # in float32

    def __add__(self, other: "Need") -> "Need":
        return Need(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def seconds(self, rates: Rates) -> float:
        """At a machine's rates, layers in the faster precision: arithmetic or memory, whichever takes longer."""
        times = []
        for rate, width in ((rates.float32, 4), (rates.bfloat16, 2)):
            arithmetic = self.products / rate + self.samples / rates.float32
            times.append(max(arithmetic, (width * self.layer_values + 4 * self.values) / rates.copy))
        return min(times)


def network_need(run: Callable[[], Tensor], parameters: int, scale: float) -> Need:
    """One training pass through the networks that `run` gives the outputs of, `scale` times over.

    Layers read their inputs and write their outputs once; backward they read both again and write the inputs' gradient.
    Adam reads and writes its weights and both moments.
    """
    moved = 0

    def count(module: nn.Module, inputs: tuple[Any, ...], output: Tensor) -> None:
        nonlocal moved
        if isinstance(module, COUNTED):
            moved += inputs[0].numel() + output.numel()

    with register_module_forward_hook(count), FlopCounterMode(display=False) as counter:
        run().backward()
    return Need(scale * counter.get_total_flops() / 2, 0.0, 3 * scale * moved, 8.0 * parameters)


def step_need(config: ModelConfig, batch: int) -> Need:
    """The networks' part of a training step with `batch` targets."""
    with torch.device("meta"):
        net = reference.ViewNet(config)
        images = torch.zeros(2, 3, config.input_size, config.input_size)

    def run() -> Tensor:
        vectors, logits = net.viewpoints(images)
        return net.volumes(images).sum() + vectors.sum() + logits.sum()

    return network_need(run, sum(weight.numel() for weight in net.parameters()), batch / 2)


def render_need(samples: float, voxels: int, pixels: int, backward: bool) -> Need:
    """Rendering with so many ray samples: volumes are read once and images written; backward, gradients as well."""
    values = 4 * (voxels + pixels)
    return Need(samples=(3 if backward else 1) * SAMPLE * samples, values=values + (values + 4 * voxels) * backward)


@torch.no_grad()
def lit_samples(rotated: Tensor) -> float:
    """The number of points of volumes (N, 4, D, H, W), nearest slice first, that are occupied and lit."""
    occupancy = rotated[:, 3]
    light = torch.cumprod(1 - occupancy, 1)
    before = torch.cat([torch.ones_like(light[:, :1]), light[:, :-1]], 1)
    return float(((occupancy > 0) & (before > OPAQUE)).sum())
