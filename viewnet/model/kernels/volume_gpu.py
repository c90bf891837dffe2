"""The volume renderer for GPUs: one compiled pass a ray, forward and backward, with nothing stored in between.

As in viewnet.model.kernels.volume_cpu each ray is walked once, and the backward pass walks it again. A ray ends where
hardly any light is left, and empty space is passed over. What a GPU keeps from forward to backward is the volume
itself, laid out for the kernels.

Images, and the gradients of frames and focal parameter, are the same bits each time. Rays that run in parallel add to
the gradient of the same voxel in any order, so its last bits vary from run to run.
"""

import functools
import os
import warnings
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from viewnet.model.kernels.volume_cpu import unpadded

CHOICES = {"draw": ((1, 2), (1, 4), (4, 4)), "draw_backward": ((1, 1), (1, 2), (4, 1))}
"""Warps, of 32 rays each, in a program and steps in a chunk; the fastest is found on the device at the first call."""


@functools.cache
def available() -> bool:
    """Whether the kernels run on this machine's GPU; says once why not."""
    if not torch.cuda.is_available():
        problem = "PyTorch finds none"
    else:
        try:
            pack(torch.zeros(1, 4, 1, 1, 1, device="cuda"))  # the smallest kernel: compiled, launched, run
            return True
        except Exception as error:  # no Triton, no C compiler for its launchers, a GPU it has no code for
            problem = f"{type(error).__name__}: {error}".splitlines()[0]
    warnings.warn(
        f"Triton has no usable GPU ({problem}): volumes are rendered by the slower PyTorch path", stacklevel=2
    )
    return False


def render(volume: Tensor, frames: Tensor, focal: Tensor, size: int, steps: int, sparse: bool) -> Tensor:
    """As viewnet.model.volume.render, in float32 on the GPU."""
    return _Render.apply(volume, frames, focal, size, steps, sparse)


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, volume: Tensor, frames: Tensor, focal: Tensor, size: int, steps: int, sparse: bool) -> Tensor:
        (voxels, cells), frames = pack(volume), frames.contiguous()
        image = volume.new_empty(len(frames), size, size, 4)  # a pixel's values side by side, as a voxel's
        numbers = (len(frames) // len(volume), *volume.shape[2:], size, steps)  # views a volume, Z, Y, X, S, steps
        _launch("draw", voxels, cells, frames, focal, image, *numbers, size=size)
        ctx.save_for_backward(voxels, cells, frames, focal)
        ctx.numbers, ctx.sparse = numbers, sparse
        return image.permute(0, 3, 1, 2)  # (N, 4, S, S)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> Any:
        voxels, cells, frames, focal = ctx.saved_tensors
        *shape, size = ctx.numbers[1:5]
        grad = grads[0].permute(0, 2, 3, 1).contiguous()  # (N, S, S, 4)
        grad_voxels, tiles = torch.zeros_like(voxels), _tiles(size, 32)  # 32 rays: the most tiles there can be
        partial = voxels.new_zeros(len(frames), tiles, 10)  # a tile's own row: no atomics, a fixed order
        arguments = (voxels, cells, frames, focal, grad, grad_voxels, partial, *ctx.numbers, tiles, ctx.sparse)
        _launch("draw_backward", *arguments, size=size)
        turned = partial.sum(1)  # (N, 10)
        grad_frames, grad_focal = turned[:, :9].view(-1, 3, 3), turned[:, 9].sum().reshape(focal.shape)  # (N, 3, 3)
        return unpadded(grad_voxels, tuple(shape)), grad_frames, grad_focal, None, None, None


def pack(volume: Tensor) -> tuple[Tensor, Tensor]:
    """The volume (B, 4, Z, Y, X) as voxels (B, P, 4) in a frame of zeros, and which cells (B, P) hold anything."""
    from viewnet.model.kernels import volume_triton

    count, _, nz, ny, nx = volume.shape
    voxels = volume.new_empty(count, (nz + 2) * (ny + 2) * (nx + 2), 4)
    cells = torch.empty(voxels.shape[:2], dtype=torch.uint8, device=volume.device)
    block = 256  # voxels a program
    with torch.cuda.device_of(volume):  # not the current GPU, maybe another
        volume_triton.pack[(-(-voxels.shape[1] // block), count)](
            volume, voxels, cells, *volume.stride(), nz, ny, nx, BLOCK=block, enable_fp_fusion=True
        )
    return voxels, cells


def _tiles(size: int, rays: int) -> int:
    """Tiles, eight pixels wide, in an image."""
    return -(-size // 8) * -(-size // (rays // 8))  # eight pixels wide, rays / 8 high


def _launch(name: str, voxels: Tensor, cells: Tensor, frames: Tensor, *arguments: Any, size: int) -> None:
    """Calls a kernel on every tile of every image."""
    with torch.cuda.device_of(voxels):
        kernel(name)[lambda chosen: (len(frames) * _tiles(size, chosen["RAYS"]),)](
            voxels, cells, frames, *arguments, enable_fp_fusion=True
        )


@functools.cache
def kernel(name: str) -> Any:
    """A kernel that tries its choices at the first call for a size; the interpreter takes the first."""
    import triton

    from viewnet.model.kernels import volume_triton

    configs = [triton.Config({"RAYS": 32 * w, "CHUNK": chunk}, num_warps=w) for w, chunk in CHOICES[name]]
    if os.environ.get("TRITON_INTERPRET") == "1":
        configs = configs[:1]  # nothing is timed where there is no choice
    summed, flags = ([], []) if name == "draw" else (["grad_voxels", "partial"], ["SPARSE"])
    tuned = triton.autotune(configs, key=["size", "steps", *flags], reset_to_zero=summed)  # runs that are timed add up
    return tuned(getattr(volume_triton, name))
