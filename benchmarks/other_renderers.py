"""Rays a second of the volume renderer and of two libraries, nerfacc and PyTorch3D, on the same grids on a CPU.

    python benchmarks/other_renderers.py [--sizes 32 64] [--volumes 4] [--repeat 5] [--threads 1] [-o FOLDER]

The libraries are no dependencies: one that is not installed is left out. All render the same images of the same voxel
grids, three of each volume, along the same rays, which is checked, and so are the gradients. They take turns.
`other_renderers.csv` has seconds a call (median, least, most) and rays a second, forward and with gradients of volumes,
cameras and focal length; `times_as_long` is beside the package's exact gradients, the median of the rounds' ratios.
`viewnet, as in training` leaves out the gradients of voxels in the midst of nowhere, which no other does.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import statistics
import sys
import types
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.bench.contestants import FOCAL, VIEWS, camera_frames, in_turn, logits
from viewnet.model import volume
from viewnet.model.kernels import volume_cpu
from viewnet.runtime import provenance
from viewnet.runtime.files import replacing, write_json

Render = Callable[[Tensor, Tensor, Tensor, int], Tensor]
"""Images (N, 4, S, S) of volumes (B, 4, n, n, n) from camera frames (N, 3, 3), the focal scalar and S."""
OURS, TRAINING = "viewnet", "viewnet, as in training"
DISTRIBUTIONS = {"nerfacc": ("nerfacc",), "PyTorch3D": ("pytorch3d", "easypytorch3d")}
"""Library -> names that it is installed by."""


def rays(frames: Tensor, focal: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Origins and directions (N, S, S, 3) and places (S,) of the samples: origin + place * direction."""
    pixel = (torch.arange(size) * 2 + 1) / size - 1
    y, x = torch.meshgrid(-pixel, pixel, indexing="ij")
    origins, directions = torch.stack([x, y, 0 * x], -1), torch.stack([-focal * x, -focal * y, 0 * x + 1], -1)
    turned = (torch.einsum("nij,hwj->nhwi", frames, part) for part in (origins, directions))
    return next(turned), next(turned), -pixel  # nearest first


def by_nerfacc() -> Render:
    """nerfacc's batched rendering; its sampler that skips empty space is for CUDA only."""
    import nerfacc

    def render(shape: Tensor, frames: Tensor, focal: Tensor, size: int) -> Tensor:
        origins, directions, places = rays(frames, focal, size)
        begin = (1 - places - 1 / size).expand(len(frames) * size * size, -1)  # (rays, S), growing from the camera

        def sample(start: Tensor, end: Tensor, index: None) -> tuple[Tensor, Tensor]:
            depth = (1 - (start + end) / 2).unflatten(0, (len(frames), size, size))[..., None]  # (N, S, S, S, 1)
            points = origins[:, :, :, None] + depth * directions[:, :, :, None]
            grid = points.unflatten(0, (len(shape), -1)).flatten(1, 2)  # a volume's views one below the other
            found = F.grid_sample(shape, grid, align_corners=False).permute(0, 2, 3, 4, 1).reshape(len(begin), size, 4)
            return found[..., :3], found[..., 3]

        colours, mask, _, _ = nerfacc.rendering(begin, begin + 2 / size, rgb_alpha_fn=sample)
        return torch.cat([colours, mask], -1).view(-1, size, size, 4).permute(0, 3, 1, 2)

    return render


def by_pytorch3d() -> Render:
    """PyTorch3D's sampler and ray marcher for volumes, which are plain PyTorch."""
    try:
        from pytorch3d import _C  # noqa: F401
    except ImportError:  # built for another PyTorch, or not at all: it is imported, and not used here
        stub: Any = types.ModuleType("pytorch3d._C")
        stub.__getattr__ = lambda name: object
        sys.modules["pytorch3d._C"] = stub
    from pytorch3d.renderer import EmissionAbsorptionRaymarcher, RayBundle, VolumeSampler
    from pytorch3d.structures import Volumes

    march = EmissionAbsorptionRaymarcher()

    def render(shape: Tensor, frames: Tensor, focal: Tensor, size: int) -> Tensor:
        count, side = len(shape), shape.shape[-1]
        ends = [part.unflatten(0, (count, -1)).flatten(1, 2) for part in rays(frames, focal, size)[:2]]
        lengths = rays(frames, focal, size)[2].expand(*ends[0].shape[:-1], -1)  # (B, K S, S, S)
        grid = Volumes(shape[:, 3:], shape[:, :3], voxel_size=2 / side)
        density, colours = VolumeSampler(grid)(RayBundle(*ends, lengths, None))
        return march(density, colours).view(len(frames), size, size, 4).permute(0, 3, 1, 2)

    return render


def renderers() -> dict[str, Render]:
    """Those that are there, the package's own first."""
    found: dict[str, Render] = {
        OURS: lambda *inputs: volume.render(*inputs, sparse=False),
        TRAINING: lambda *inputs: volume.render(*inputs, sparse=True),
    }
    for name, make in (("nerfacc", by_nerfacc), ("PyTorch3D", by_pytorch3d)):
        try:
            found[name] = make()
        except ImportError as error:
            print(f"{name} is left out: {error}")
    return found


def inputs(occupancy: str, size: int, volumes: int) -> tuple[Tensor, Tensor, Tensor, int]:
    """What all are given."""
    shape = volume.squash(logits(occupancy, size, volumes), None)
    return shape, camera_frames(VIEWS * volumes), torch.tensor(FOCAL), size


def call(render: Render, given: tuple[Any, ...], gradients: bool) -> tuple[Tensor, list[Tensor]]:
    """Images, and gradients of volumes, cameras and focal length where asked for."""
    *leaves, size = given
    leaves = [leaf.detach().requires_grad_(gradients) for leaf in leaves]
    image = render(*leaves, size)
    if gradients:
        weights = torch.randn(image.shape, generator=torch.Generator().manual_seed(0))
        image.backward(weights)
    return image.detach(), [leaf.grad for leaf in leaves if leaf.grad is not None]


def differences(render: Render, given: tuple[Any, ...]) -> tuple[float, list[float]]:
    """The largest difference from the definition's images, and from its gradients, relative to their norms."""
    image, gradients = call(render, given, True)
    expected, wanted = call(lambda *parts: volume.render_reference(*parts, given[-1]), given, True)
    pairs = zip(gradients, wanted, strict=True)
    return float((image - expected).abs().max()), [float((a - b).norm() / b.norm()) for a, b in pairs]


def measure(sizes: list[int], volumes: int, repeat: int) -> pd.DataFrame:
    """A row for each grid, work and renderer. AssertionError where one renders something else."""
    rows = []
    found = renderers()
    for occupancy in ("object", "dense"):
        for size in sizes:
            given = inputs(occupancy, size, volumes)
            for name, render in found.items():
                image, gradients = differences(render, given)
                assert image < 1e-4, f"{name}: images differ by {image}"
                # Those of cameras and focal length are sums that nearly cancel, of slopes that jump between voxels.
                same = gradients[0] < 1e-3 and max(gradients) < 0.05
                assert name == TRAINING or same, f"{name}: gradients differ by {gradients}"
            for work, gradients in (("forward", False), ("forward + backward", True)):
                calls = {name: partial(call, render, given, gradients) for name, render in found.items()}
                times = in_turn(calls, repeat, torch.device("cpu"), 0.2)
                for name, values in times.items():
                    ratios = [other / ours for other, ours in zip(values, times[OURS], strict=True)]
                    row: dict[str, Any] = {"volume": occupancy, "size": size, "work": work, "renderer": name}
                    row |= {"s": statistics.median(values), "low": min(values), "high": max(values)}
                    row |= {"rays_per_s": len(given[1]) * size**2 / row["s"]}
                    row |= {"times_as_long": statistics.median(ratios), "least": min(ratios), "most": max(ratios)}
                    rows.append(row)
    return pd.DataFrame(rows)


def versions() -> dict[str, str]:
    """Of the libraries, "" for one that is not installed."""
    installed = {each.metadata["Name"]: each.version for each in importlib.metadata.distributions()}
    return {
        library: next((f"{name} {installed[name]}" for name in names if name in installed), "")
        for library, names in DISTRIBUTIONS.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[32, 64], help="voxels along a side, and pixels")
    parser.add_argument("--volumes", type=int, default=4)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=Path("paper_tables/benchmarks"))
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    volume_cpu.warm_up()
    table = measure(given.sizes, given.volumes, given.repeat)
    with replacing(given.output / "other_renderers.csv") as path:
        table.to_csv(path, index=False, lineterminator="\n")
    about = {
        "settings": {"sizes": given.sizes, "volumes": given.volumes, "views": VIEWS, "repeat": given.repeat},
        "hardware": provenance.hardware(given.threads),
        "versions": provenance.versions(provenance.LIBRARIES) | versions(),
        "git": provenance.commit(),
    }
    write_json(given.output / "other_renderers.json", about)
    print(table.round(4).to_string(index=False))


if __name__ == "__main__":
    main()
