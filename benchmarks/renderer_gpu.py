"""Speed of rendering on a GPU: the fused kernels against the definition, and against the device's ceilings.

    python benchmarks/renderer_gpu.py [--volumes 32 64 128] [--batch 64] [--views 3] [--occupied 0.1] [--seconds 1]

Prints one JSON object. For every size of volume, and for empty space passed over backwards (`sparse`) or not:
milliseconds (median of as many runs as fit the time), peak memory, and what these amount to beside two ceilings that
are measured in the same run: a copy of memory, and multiply-add on registers. Bytes and operations are counted, not
measured: `floor_bytes` is the volume read once and the image written once, `sample_bytes` eight corners of 16 bytes
for each step that falls into an occupied cell (most of them served by caches), `sample_flops` what it computes.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from viewnet.geometry import look_at, view_vector
from viewnet.model import volume
from viewnet.model.kernels import volume_gpu

FLOPS = 100
"""Of a step forwards: place 9, weights 14, four values from eight corners 64, stopping 13."""


def milliseconds(work: Callable[[], Any], seconds: float) -> float:
    """Median duration on the device, after three runs that warm up."""
    for _ in range(3):
        work()
    torch.cuda.synchronize()
    durations: list[float] = []
    while sum(durations) < 1000 * seconds or len(durations) < 5:
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()
        work()
        end.record()
        torch.cuda.synchronize()
        durations.append(start.elapsed_time(end))
    return statistics.median(durations)


def ceilings(seconds: float) -> dict[str, float]:
    """What the device does at best: bytes a second of a copy, read and written, and float32 operations a second."""
    source = torch.rand(1 << 28, device="cuda")
    target = torch.empty_like(source)
    copy = milliseconds(lambda: target.copy_(source), seconds)
    # A polynomial by Horner's rule, compiled into one kernel: 512 multiply-adds for every number read and written.
    small = source[: 1 << 24]

    @torch.compile
    def polynomial(x: Tensor) -> Tensor:
        y = x
        for _ in range(512):
            y = y * x + 0.5
        return y

    arithmetic = milliseconds(lambda: polynomial(small), seconds)
    return {
        "copy_bytes_per_s": 2 * source.nbytes / copy * 1e3,
        "multiply_add_flops_per_s": 2 * 512 * small.numel() / arithmetic * 1e3,
    }


def scene(side: int, batch: int, views: int, occupied: float) -> list[Tensor]:
    """A ball that fills the share `occupied` of each volume, mostly opaque; frames all around; the focal parameter."""
    axis = (torch.arange(side, device="cuda") * 2 + 1) / side - 1
    radius = (axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2).sqrt()
    within = (8 * occupied / (4 / 3 * torch.pi)) ** (1 / 3)
    voxels = torch.rand(batch, 4, side, side, side, device="cuda")
    voxels[:, 3] = ((within - radius) * side / 4).clamp(0, 1) * (0.5 + 0.5 * voxels[:, 3])
    azimuth, elevation = 360 * torch.rand(batch * views), 60 * torch.rand(batch * views) - 20
    return [voxels, look_at(view_vector(azimuth, elevation)).cuda(), torch.tensor(0.3, device="cuda")]


def met(inputs: list[Tensor], size: int, steps: int) -> int:
    """Steps, of all rays, that fall into cells with occupancy; those behind opaque ones are not left out."""
    voxels, frames, focal = inputs
    # Of the first volume; all are alike.
    held = torch.nn.functional.max_pool3d(torch.nn.functional.pad((voxels[:1, 3:] > 0).float(), [1] * 6), 2, 1)
    points, count = volume.ray_points(size, steps, focal), 0
    nz, ny, nx = voxels.shape[2:]
    for frame in frames:
        u, v, w = ((points @ frame.T + 1) / 2 * points.new_tensor([nx, ny, nz]) + 0.5).floor().long().unbind(-1)
        inside = (u >= 0) & (v >= 0) & (w >= 0) & (u <= nx) & (v <= ny) & (w <= nz)
        count += int((inside & (held[0, 0, w.clamp(0, nz), v.clamp(0, ny), u.clamp(0, nx)] > 0)).sum())
    return count


def passes(draw: Callable[..., Tensor], inputs: list[Tensor], seconds: float) -> dict[str, float]:
    """Milliseconds and peak bytes, beyond the inputs, of drawing and of drawing with all gradients."""
    leaves = [x.detach().requires_grad_() for x in inputs]
    weights = torch.rand_like(draw(*inputs))
    results: dict[str, float] = {}

    def forward() -> None:
        with torch.no_grad():
            draw(*inputs)

    def both() -> None:
        torch.autograd.grad(draw(*leaves), leaves, weights)

    for name, work in (("forward", forward), ("forward_backward", both)):
        results[f"{name}_ms"] = milliseconds(work, seconds)
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        work()
        torch.cuda.synchronize()
        results[f"{name}_peak_bytes"] = torch.cuda.max_memory_allocated() - before
    return results


def measure(side: int, options: argparse.Namespace, device: dict[str, float]) -> dict[str, Any]:
    """All ways of drawing volumes of one size, on images of as many pixels and rays of as many steps."""
    inputs = scene(side, options.batch, options.views, options.occupied)
    ways: dict[str, Callable[..., Tensor]] = {
        "fused": lambda v, r, f: volume_gpu.render(v, r, f, side, side, False),
        "fused_sparse": lambda v, r, f: volume_gpu.render(v, r, f, side, side, True),
        "reference": lambda v, r, f: volume.render_reference(v, r, f, side, side),
    }
    row: dict[str, Any] = {"volume": side, "batch": options.batch, "views": options.views, "size": side, "steps": side}
    for name, draw in ways.items():
        try:
            row[name] = passes(draw, inputs, options.seconds)
        except torch.OutOfMemoryError:
            row[name] = None  # more than the device has
        torch.cuda.empty_cache()
    samples, forward = met(inputs, side, side), row["fused"]["forward_ms"] / 1e3
    floor = inputs[0].nbytes + len(inputs[1]) * side * side * 16
    row |= {"floor_bytes": floor, "sample_bytes": 128 * samples, "sample_flops": FLOPS * samples}
    row["forward_floor_share_of_copy"] = floor / forward / device["copy_bytes_per_s"]
    row["forward_sample_bytes_per_s"] = 128 * samples / forward
    row["forward_share_of_multiply_add"] = FLOPS * samples / forward / device["multiply_add_flops_per_s"]
    if row["reference"]:
        for name in ("forward", "forward_backward"):
            row[f"{name}_speedup"] = row["reference"][f"{name}_ms"] / row["fused"][f"{name}_ms"]
    with torch.no_grad():
        few = [inputs[0][:1], inputs[1][: options.views], inputs[2]]
        row["largest_difference"] = (ways["fused"](*few) - ways["reference"](*few)).abs().max().item()
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--volumes", type=int, nargs="+", default=[32, 64, 128], help="voxels a side")
    parser.add_argument("--batch", type=int, default=64, help="volumes")
    parser.add_argument("--views", type=int, default=3, help="images of each volume")
    parser.add_argument("--occupied", type=float, default=0.1, help="share of a volume that is filled")
    parser.add_argument("--seconds", type=float, default=1.0, help="time for each figure")
    options = parser.parse_args()
    if not volume_gpu.available():
        print(json.dumps({"measured": None, "reason": "no usable GPU on this machine: nothing was measured"}))
        return
    torch.manual_seed(0)
    device = ceilings(options.seconds)
    torch.cuda.empty_cache()
    report = {
        "device": torch.cuda.get_device_name(),
        "torch": torch.__version__,
        "ceilings": device,
        "measured": [measure(side, options, device) for side in options.volumes],
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
