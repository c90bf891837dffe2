"""The volume renderer for CPUs: one compiled pass a ray, forward and backward, with nothing stored in between.

The plain PyTorch renderer writes the rotated volume to memory and reads it back several times. Here each ray is
walked once: sample, weigh, stop; the backward pass walks it again. Numba compiles it without a C compiler.
Volumes are handled in parallel, each by one thread, so that gradients are summed in a fixed order: results are
the same bits whatever the number of threads.
"""

import math
import weakref
from typing import Any

import torch
from torch import Tensor

from viewnet.model.kernels import numba_call

available = numba_call.available


def warm_up() -> None:
    """Loads the kernels."""
    if not available():
        return
    blocks = torch.zeros(1, 2, 2, 2, 1, 1, 1, 4).requires_grad_()  # types choose the compiled kernel, not sizes
    render(squash(blocks, None, None), torch.eye(3)[None], torch.zeros(()), 2, 2, sparse=False).sum().backward()


def render(volume: Tensor, frames: Tensor, focal: Tensor, size: int, steps: int, sparse: bool) -> Tensor:
    """As viewnet.model.volume.render_reference, in float32 on the CPU.

    `sparse` leaves out the gradient of voxels without an occupied neighbour, which is most of the work.
    """
    return _Render.apply(volume, frames, focal, size, steps, sparse)


def squash(blocks: Tensor, colour: Tensor | None, prior: Tensor | None) -> Tensor:
    """As viewnet.model.volume.squash, to a volume that lies in memory as the renderer wants it."""
    return _Squash.apply(blocks, colour, prior)


def halved(volume: Tensor) -> Tensor:
    """As viewnet.model.volume.halved, of volumes with four channels and without gradient."""
    shape = tuple(volume.shape[2:])
    small = tuple(side // 2 for side in shape)
    halves = torch.zeros(len(volume), math.prod(side + 2 for side in small), 4)  # (B, P', 4), zeros all around
    _run("halve", padded(volume.detach()), shape, halves)
    return unpadded(halves, small)


class _Squash(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, blocks: Tensor, colour: Tensor | None, prior: Tensor | None) -> Tensor:
        count, *sides = blocks.shape[:4]
        nz, ny, nx = (side * blocks.shape[4] for side in sides)  # voxels a side
        blocks = blocks.contiguous()
        added = torch.zeros(count, 4)  # occupancy's stays 0
        if colour is not None:
            added[:, :3] = colour
        offset = torch.zeros(nz, ny, nx) if prior is None else prior.contiguous()  # (Z, Y, X)
        voxels = torch.empty(count, (nz + 2) * (ny + 2) * (nx + 2), 4)  # (B, P, 4), framed by the kernel
        _run("squash", blocks, added, offset, voxels)
        ctx.save_for_backward(blocks, added, offset)  # voxels are computed again from these: less to keep
        return unpadded(voxels, (nz, ny, nx))  # a view: no copy before rendering

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        blocks, added, offset = ctx.saved_tensors
        grad = torch.empty_like(blocks)
        _run("squash_backward", blocks, added, offset, padded(grads[0]), grad)
        return grad, None, None  # mean colour and prior are data


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, volume: Tensor, frames: Tensor, focal: Tensor, size: int, steps: int, sparse: bool) -> Tensor:
        voxels, frames = padded(volume.detach(), empty=True), frames.detach().contiguous()
        image = torch.empty(len(frames), size, size, 4)  # a pixel's values side by side, as a voxel's
        shape = tuple(volume.shape[2:])
        cells, boxes = _occupied(volume, voxels, shape)
        _run("forward", voxels, cells, boxes, shape, frames, focal, steps, image)
        if not sparse:  # empty voxels are due their gradient too: backward walks the whole frame
            whole = [float(end) for side in reversed(shape) for end in (0, side + 1)]
            cells, boxes = torch.ones_like(cells), torch.tensor(whole).expand_as(boxes).contiguous()  # (B, P), (B, 6)
        ctx.save_for_backward(voxels, cells, boxes, frames, focal)
        ctx.shape, ctx.steps = shape, steps
        return image.permute(0, 3, 1, 2)  # (N, 4, S, S)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        voxels, cells, boxes, frames, focal = ctx.saved_tensors
        grad = grads[0].permute(0, 2, 3, 1).contiguous()  # (N, S, S, 4)
        grad_voxels, grad_frames = torch.zeros_like(voxels), torch.empty_like(frames)
        grad_focal = torch.zeros(len(voxels))  # one sum a volume, which one thread fills
        found = (grad_voxels, grad_frames, grad_focal)
        arguments = (voxels, cells, boxes, ctx.shape, frames, focal, ctx.steps, grad, *found)
        _run("backward", *arguments)
        grad_volume = unpadded(grad_voxels, ctx.shape)  # (B, 4, Z, Y, X); the frame's is dropped
        return grad_volume, grad_frames, grad_focal.sum().reshape(focal.shape), None, None, None  # focal's is a scalar


_known: tuple[weakref.ref[Tensor], int, tuple[Tensor, Tensor]] | None = None  # weak: memory is freed


def _occupied(volume: Tensor, voxels: Tensor, shape: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Which cells of `voxels` (B, P, 4) hold anything, (B, P), and the box around them, (B, 6).

    Remembered for the volume rendered last.
    """
    global _known
    # Tensors made under inference_mode do not count their changes.
    version = -1 if volume.is_inference() else volume._version
    if version >= 0 and _known is not None and _known[0]() is volume and _known[1] == version:
        return _known[2]  # heads, search and reconstruction share one
    found = torch.zeros(voxels.shape[:2], dtype=torch.uint8), torch.empty(len(voxels), 6)
    _run("occupied", voxels, shape, *found)
    _known = weakref.ref(volume), version, found
    return found


def unpadded(voxels: Tensor, shape: tuple[int, ...]) -> Tensor:
    """The volume (B, 4, Z, Y, X) in `voxels` (B, P, 4), without the voxel all around."""
    nz, ny, nx = shape
    return voxels.view(-1, nz + 2, ny + 2, nx + 2, 4)[:, 1:-1, 1:-1, 1:-1].permute(0, 4, 1, 2, 3)  # (B, 4, Z, Y, X)


def padded(volume: Tensor, empty: bool = False) -> Tensor:
    """(B, 4, Z, Y, X) -> (B, P, 4): a voxel more all around, and the four values of a voxel side by side.

    A volume that lies inside such a frame already is not copied; with `empty` only where the frame holds zeros.
    """
    count, _, nz, ny, nx = volume.shape
    whole = (count, nz + 2, ny + 2, nx + 2, 4)
    strides = torch.empty(whole, device="meta").stride()  # strides without memory
    corner = sum(strides[1:4])  # the frame's first voxel to the volume's
    if volume.stride() == (strides[0], 1, *strides[1:4]) and volume.dtype == torch.float32:  # maybe a view of a frame
        start, storage = volume.storage_offset() - corner, volume.untyped_storage().nbytes()
        if start >= 0 and 4 * (start + count * strides[0]) <= storage:  # and all of that frame is in memory
            framed = volume.as_strided(whole, strides, start)  # (B, Z + 2, Y + 2, X + 2, 4)
            sides = [framed.select(axis, end) for axis in (1, 2, 3) for end in (0, -1)]  # six
            if not empty or not any(side.any() for side in sides):  # or the view is a part of a larger volume
                return framed.view(count, -1, 4)  # (B, P, 4)
    voxels = torch.zeros(whole)
    voxels[:, 1:-1, 1:-1, 1:-1] = volume.permute(0, 2, 3, 4, 1)  # (B, Z, Y, X, 4)
    return voxels.view(count, -1, 4)  # (B, P, 4)


def _run(kernel: str, *arguments: Any) -> None:
    from viewnet.model.kernels import volume_numba

    numba_call.run(getattr(volume_numba, kernel), *arguments)
