"""The volume renderer for processors: one compiled pass a ray, forward and backward, with nothing stored in between.

The plain PyTorch renderer writes the rotated volume to memory and reads it back several times. Here each ray is
walked once: sample, weigh, stop; the backward pass walks it again. Numba compiles it without a C compiler.
Volumes are handled in parallel, each by one thread, so that gradients are summed in a fixed order: results are
the same bits whatever the number of threads.
"""

from __future__ import annotations

import functools
import warnings
from typing import Any

import numpy as np
import torch
from torch import Tensor


@functools.cache
def available() -> bool:
    """Whether the compiled path can be used; says once why not."""
    try:
        import numba  # noqa: F401
    except ImportError as error:
        warnings.warn(f"numba is not usable ({error}): volumes are drawn by the slower PyTorch path", stacklevel=2)
        return False
    return True


def warm_up() -> None:
    """Loads the kernels, and puts back the number of threads, which loading them resets behind PyTorch's back."""
    threads = torch.get_num_threads()
    if available():
        volume = torch.rand(1, 4, 2, 2, 2, generator=torch.Generator().manual_seed(0)).requires_grad_()
        render(volume, torch.eye(3)[None], torch.zeros(()), 2, 2, sparse=False).sum().backward()
    torch.set_num_threads(threads)


def render(volume: Tensor, frames: Tensor, focal: Tensor, size: int, steps: int, sparse: bool) -> Tensor:
    """As viewnet.volume.render_reference, in float32 on the CPU.

    `sparse` leaves out the gradient of voxels without an occupied neighbour, which is most of the work.
    """
    return _Render.apply(volume, frames, focal, size, steps, sparse)


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, volume: Tensor, frames: Tensor, focal: Tensor, size: int, steps: int, sparse: bool) -> Tensor:
        voxels, frames = _padded(volume.detach()), frames.detach().contiguous()
        cells = torch.zeros(voxels.shape[:2], dtype=torch.uint8)
        picture = torch.empty(len(frames), size, size, 4)
        shape = tuple(volume.shape[2:])
        _run("occupied", voxels, shape, cells)
        _run("forward", voxels, cells, shape, frames, focal, steps, picture)
        ctx.save_for_backward(voxels, cells if sparse else torch.ones_like(cells), frames, focal)
        ctx.shape, ctx.steps = shape, steps
        return picture.permute(0, 3, 1, 2)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        voxels, cells, frames, focal = ctx.saved_tensors
        nz, ny, nx = ctx.shape
        grad = grads[0].permute(0, 2, 3, 1).contiguous()
        grad_voxels, grad_frames = torch.zeros_like(voxels), torch.empty_like(frames)
        grad_focal = torch.zeros(len(voxels))
        _run("backward", voxels, cells, ctx.shape, frames, focal, ctx.steps, grad, grad_voxels, grad_frames, grad_focal)
        grad_volume = grad_voxels.view(-1, nz + 2, ny + 2, nx + 2, 4)[:, 1:-1, 1:-1, 1:-1]
        return grad_volume.permute(0, 4, 1, 2, 3), grad_frames, grad_focal.sum().reshape(focal.shape), None, None, None


def _padded(volume: Tensor) -> Tensor:
    """(B, 4, Z, Y, X) -> (B, P, 4): an empty voxel all around, and the four values of a voxel side by side."""
    count, _, nz, ny, nx = volume.shape
    voxels = torch.zeros(count, nz + 2, ny + 2, nx + 2, 4)
    voxels[:, 1:-1, 1:-1, 1:-1] = volume.permute(0, 2, 3, 4, 1)
    return voxels.view(count, -1, 4)


def _run(kernel: str, *arguments: Any) -> None:
    """Calls a kernel on as many threads as PyTorch may use; single numbers are passed as such, tensors as arrays."""
    import numba

    from viewnet import _volume_kernels

    threads = min(torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if threads > 1:
        numba.set_num_threads(threads)
    plain = [(np.float32(a.item()) if a.dim() == 0 else a.numpy()) if isinstance(a, Tensor) else a for a in arguments]
    getattr(_volume_kernels, kernel)[threads > 1](*plain)
