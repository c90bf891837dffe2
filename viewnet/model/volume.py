"""The volume renderer: rotation, perspective and ray stopping in one pass (section 3.3).

A volume fills the cube [-1, 1]^3 of the object frame with red, green, blue and occupancy Q; voxel i of n along an axis
has its centre at (2 i + 1) / n - 1. The camera looks at the centre. In camera coordinates (x right, y up, z towards the
camera) the ray through pixel (x, y) visits the points

    p(z) = (x (1 - f z), y (1 - f z), z)        z from near +1 to far -1 in equal steps

which is an exact pinhole at distance 1 / f from the centre: the rays converge towards the camera and the image's edge
is the cube's edge at z = 0. f = 0 is orthographic. A ray stops at step k with probability Q_k prod_{l<k} (1 - Q_l)
(equation 3), and the pixel is the sum of the colours it stops at (equation 4). The probabilities' sum is the mask.

`render_reference` is the definition, in plain PyTorch. `render` gives the same image and gradients by the fastest way
the tensors' device has: viewnet.model.kernels.volume_cpu on CPUs, viewnet.model.kernels.volume_gpu on GPUs, and the
definition where these cannot be used, after a warning that says why. The environment variable VIEWNET_RENDERER forces
a way: `fused` is the device's own or an error, `reference` the definition, `auto` (or nothing) the choice described.
"""

import os
from types import ModuleType
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.errors import ViewnetError
from viewnet.model.kernels import numba_call, volume_cpu, volume_gpu

FUSED = {"cpu": volume_cpu, "cuda": volume_gpu}
"""Device types with a renderer of their own."""


def ray_points(size: int, steps: int, focal: Tensor) -> Tensor:
    """Sampling points (steps, size, size, 3) in camera coordinates, nearest first, image rows from the top.

    >>> ray_points(2, 4, torch.tensor(0.5))[0, 0, 0]  # the nearest of the upper left pixel: rays converge to the camera
    tensor([-0.3125,  0.3125,  0.7500])
    """
    pixel = (torch.arange(size, device=focal.device, dtype=focal.dtype) * 2 + 1) / size - 1  # (size,), pixels' centres
    depth = 1 - (torch.arange(steps, device=focal.device, dtype=focal.dtype) * 2 + 1) / steps  # (steps,), near to far
    z, y, x = torch.meshgrid(depth, -pixel, pixel, indexing="ij")  # (steps, size, size) each
    scale = 1 - focal * z  # 0 at z = 1 / f, where the rays meet: the camera
    return torch.stack([x * scale, y * scale, z], dim=-1)  # (steps, size, size, 3)


def halved(volume: Tensor) -> Tensor:
    """Volumes (B, 4, Z, Y, X) at half the resolution, averaged: a pooling that keeps the order in memory."""
    if not torch.is_grad_enabled() and volume.device.type == "cpu" and volume.shape[1] == 4 and numba_call.available():
        return volume_cpu.halved(volume.float())
    for axis in (2, 3, 4):
        even, odd = volume.unflatten(axis, (-1, 2)).unbind(axis + 1)  # (..., n / 2, ...) each
        volume = even + odd
    return volume / 8


def joined(blocks: Tensor) -> Tensor:
    """Volumes (B, 4, s z, s y, s x) of blocks (B, z, y, x, s, s, s, 4), each the s^3 voxels of one place."""
    return blocks.permute(0, 7, 1, 4, 2, 5, 3, 6).flatten(6, 7).flatten(4, 5).flatten(2, 3)  # (B, 4, s z, s y, s x)


def squash(blocks: Tensor, prior: Tensor | None) -> Tensor:
    """Logits as `joined` takes them to volumes: colours sigmoid(x), occupancy Q = 2 sigmoid(x) - 1 + S in [0, 1].

    `prior` (n, n, n) is S; 0 where None. Voxels outside [0, 1] still take the gradient that pulls them back in: a plain
    clamp gives those that were once emptied none, so that thin parts, once lost, never come back.
    """
    if blocks.device.type == "cpu" and numba_call.available():
        return volume_cpu.squash(blocks, prior)
    values = torch.sigmoid(joined(blocks).float())  # (B, 4, n, n, n)
    occupancy = 2 * values[:, 3:] - 1 + (0 if prior is None else prior)  # (B, 1, n, n, n), Q = Q' + S
    return torch.cat([values[:, :3], _Clamp.apply(occupancy)], 1)  # (B, 4, n, n, n)


class _Clamp(torch.autograd.Function):
    """To [0, 1], letting through the gradient that points back inside."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return x.clamp(0, 1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        (x,), grad = ctx.saved_tensors, grads[0]
        return grad.masked_fill((x < 0) & (grad > 0) | (x > 1) & (grad < 0), 0)  # would drive x further out


def render_reference(volume: Tensor, world_from_camera: Tensor, focal: Tensor, size: int, steps: int) -> Tensor:
    """Images (N, 4, size, size) of volumes (B, 4, Z, Y, X) from camera frames (N, 3, 3): RGB times mask, and mask.

    N is a multiple of B, and image n shows volume n // (N / B). `focal` is the scalar f above. Occupancy is expected
    in [0, 1]; outside the cube everything is 0. Differentiable in volume, camera frames and focal.

    A volume that is red, and opaque where y > 0, the object's left half: from the front that is on the right.

    >>> from viewnet.geometry import look_at, view_vector
    >>> volume = torch.zeros(1, 4, 4, 4, 4)  # channels red, green, blue and occupancy; axes z, y, x
    >>> volume[:, 0], volume[:, 3, :, 2:] = 1.0, 1.0
    >>> front = look_at(view_vector(torch.tensor([0.0]), torch.tensor([0.0])))
    >>> red, green, blue, mask = render_reference(volume, front, torch.tensor(0.0), size=4, steps=4)[0]
    >>> mask[0], torch.equal(red, mask), green.any().item()
    (tensor([0., 0., 1., 1.]), True, False)
    """
    points = ray_points(size, steps, focal)  # (steps, size, size, 3)
    grid = torch.einsum("nij,dhwj->ndhwi", world_from_camera, points)  # (N, steps, size, size, 3)
    volume = volume.repeat_interleave(len(world_from_camera) // len(volume), dim=0)  # (N, 4, Z, Y, X)
    sampled = F.grid_sample(volume, grid, mode="bilinear", padding_mode="zeros", align_corners=False)
    colour, occupancy = sampled[:, :3], sampled[:, 3:]  # (N, 3 and 1, steps, size, size)
    passing = torch.cumprod(1 - occupancy, dim=2)  # (N, 1, steps, size, size), the light left behind each step
    reaching = torch.cat([torch.ones_like(passing[:, :, :1]), passing[:, :, :-1]], dim=2)  # product over l < k
    stopping = occupancy * reaching  # (N, 1, steps, size, size), equation 3
    return torch.cat([(stopping * colour).sum(2), stopping.sum(2)], dim=1)  # (N, 4, size, size), equation 4


def render(
    volume: Tensor, world_from_camera: Tensor, focal: Tensor, size: int, steps: int | None = None, sparse: bool = False
) -> Tensor:
    """`render_reference` by the fastest path there is for the device; `steps` along a ray defaults to `size`.

    `sparse` leaves out the gradient of voxels without an occupied neighbour, which is most of the work of the backward
    pass: objects then grow from what there is of them, and nothing appears in the midst of nowhere. Raises ViewnetError
    for a VIEWNET_RENDERER that is none, or that cannot be had.

    >>> from viewnet.geometry import look_at, view_vector
    >>> sides = look_at(view_vector(torch.tensor([0.0, 90.0]), torch.tensor([0.0, 0.0])))
    >>> render(torch.zeros(1, 4, 8, 8, 8), sides, torch.tensor(0.268), size=16).shape  # two views of one empty volume
    torch.Size([2, 4, 16, 16])
    """
    steps = size if steps is None else steps
    if len(world_from_camera) % len(volume):
        raise ValueError(
            f"{len(world_from_camera)} camera frames cannot be shared out evenly over {len(volume)} volumes"
        )
    given = volume.float(), world_from_camera.float(), focal.float(), size, steps
    fused = fused_kernels(volume.device)
    return render_reference(*given) if fused is None else fused.render(*given, sparse)


def fused_kernels(device: torch.device) -> ModuleType | None:
    """The device's own renderer, if it can be used and is not refused; ViewnetError for a wrong VIEWNET_RENDERER."""
    choice = os.environ.get("VIEWNET_RENDERER") or "auto"
    if choice not in ("auto", "reference", "fused"):
        raise ViewnetError(f"VIEWNET_RENDERER is {choice!r}: set it to auto, reference or fused, or unset it")
    module = None if choice == "reference" else FUSED.get(device.type)
    if module is not None and module.available():
        return module
    if choice == "fused":
        raise ViewnetError(f"VIEWNET_RENDERER is fused, which cannot be had on {device.type} here: set it to auto")
    return None
