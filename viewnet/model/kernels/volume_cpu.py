"""The volume renderer for CPUs: one compiled pass a ray, forward and backward, with nothing stored in between.

The plain PyTorch renderer writes the rotated volume to memory and reads it back several times. Here each ray is
walked once: sample, weigh, stop; the backward pass walks it again. Numba compiles it without a C compiler.
Volumes are handled in parallel, each by one thread, so that gradients are summed in a fixed order: results are
the same bits whatever the number of threads.
"""

import math
from collections.abc import MutableMapping
from typing import Any

import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from viewnet.model.kernels import numba_call

available = numba_call.available


def warm_up() -> None:
    """Loads the kernels."""
    if not available():
        return
    blocks = torch.zeros(1, 2, 2, 2, 1, 1, 1, 4).requires_grad_()  # types choose the compiled kernel, not sizes
    render(squash(blocks, None), torch.eye(3)[None], torch.zeros(()), 2, 2, sparse=False).sum().backward()


def render(volume: Tensor, frames: Tensor, focal: Tensor, size: int, steps: int, sparse: bool) -> Tensor:
    """As viewnet.model.volume.render, in float32 on the CPU."""
    return _Render.apply(volume, frames, focal, size, steps, sparse)


def squash(blocks: Tensor, prior: Tensor | None) -> Tensor:
    """As viewnet.model.volume.squash, to a volume that lies in memory as the renderer wants it."""
    volume: Tensor = _Squash.apply(blocks, prior)
    _empty_around[volume] = True
    return volume


def halved(volume: Tensor) -> Tensor:
    """As viewnet.model.volume.halved, of volumes with four channels and without gradient."""
    shape = tuple(volume.shape[2:])
    small = tuple(side // 2 for side in shape)
    halves = torch.zeros(len(volume), math.prod(side + 2 for side in small), 4)  # (B, P', 4), zeros all around
    _run("halve", padded(volume.detach()), shape, halves)
    half = unpadded(halves, small)
    _empty_around[half] = True
    return half


class _Squash(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, blocks: Tensor, prior: Tensor | None) -> Tensor:
        count, z, y, x, side = blocks.shape[:5]
        shape = z * side, y * side, x * side  # voxels a side
        blocks = blocks.contiguous()
        scale, offset = torch.tensor([1.0, 1.0, 1.0, 2.0]), torch.zeros(z, side, y, side, x, side, 4)
        offset[..., 3] = -1.0 if prior is None else prior.view(z, side, y, side, x, side) - 1  # Q = 2 sigmoid - 1 + S
        offset = offset.permute(0, 2, 4, 1, 3, 5, 6).reshape(z, y, -1)  # (z, y, x s^3 4), as blocks lie
        voxels = torch.empty(count, math.prod(n + 2 for n in shape), 4)  # (B, P, 4), framed by the kernel
        _run("squash", blocks, offset, scale, voxels)
        ctx.save_for_backward(blocks, offset, scale)  # voxels are computed again from these: less to keep
        return unpadded(voxels, shape)  # a view: no copy before rendering

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        grad = torch.empty_like(ctx.saved_tensors[0])  # of the blocks
        _run("squash_backward", *ctx.saved_tensors, padded(grads[0]), grad)
        return grad, None  # the prior is data


def compare(
    volume: Tensor, cameras: Tensor, focal: Tensor, target: Tensor, weights: tuple[float, float]
) -> tuple[Tensor, Tensor]:
    """Of T views in each of G groups the one that explains a target best, (N, G) int64, and its error (N, G).

    `cameras` are frames (N, G, T, 3, 3), targets (N, 4, S, S), N a multiple of the B volumes. Errors are the mean
    squared ones of colours and of masks (equation 2) with their `weights`. Nothing takes a gradient.
    """
    size, (colours, masks) = target.shape[-1], weights
    # Means over pixels, and over the three colours; for each number in a row of pixels, (4 S,).
    shares = (torch.tensor([colours / 3, colours / 3, colours / 3, masks]) / size**2).repeat(size)
    best, errors = torch.empty(cameras.shape[:2], dtype=torch.int64), torch.empty(cameras.shape[:2])
    pixels = target.detach().float().permute(0, 2, 3, 1).contiguous()  # (N, S, S, 4)
    frames, shape, camera = cameras.detach().float().contiguous(), tuple(volume.shape[2:]), focal.detach()
    with torch.profiler.record_function("compare"):
        _run("compare", *_framed(volume.float()), shape, frames, camera, pixels, shares, best, errors)
    return best, errors


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, volume: Tensor, frames: Tensor, focal: Tensor, size: int, steps: int, sparse: bool) -> Tensor:
        frames, shape = frames.detach().contiguous(), tuple(volume.shape[2:])
        voxels, cells, boxes = _framed(volume)
        image = torch.empty(len(frames), 4, size, size)
        _run("forward", voxels, cells, boxes, shape, frames, focal, steps, image)
        if not sparse:  # empty voxels are due their gradient too: backward walks the whole frame
            whole = [float(end) for side in reversed(shape) for end in (0, side + 1)]
            cells, boxes = torch.ones_like(cells), torch.tensor(whole).expand_as(boxes).contiguous()  # (B, P), (B, 6)
            cells[:, -1] = 0  # the frame's last voxel, no cell's lowest corner, stands for none
        ctx.save_for_backward(voxels, cells, boxes, frames, focal)
        ctx.shape, ctx.steps = shape, steps
        return image

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        voxels, cells, boxes, frames, focal = ctx.saved_tensors
        grad = grads[0].contiguous()  # (N, 4, S, S)
        grad_voxels, grad_frames = torch.empty_like(voxels), torch.empty_like(frames)
        grad_focal = torch.zeros(len(voxels))  # one sum a volume, which one thread fills
        given = voxels, cells, boxes, ctx.shape, frames, focal, ctx.steps, grad
        _run("backward", *given, grad_voxels, grad_frames, grad_focal)
        grad_volume = unpadded(grad_voxels, ctx.shape)  # (B, 4, Z, Y, X); the frame's is dropped
        return grad_volume, grad_frames, grad_focal.sum().reshape(focal.shape), None, None, None  # focal's is a scalar


Framed = tuple[Tensor, Tensor, Tensor]
"""Voxels (B, P, 4), which of their cells hold anything (B, P), and the box around these (B, 6)."""
_known: MutableMapping[Tensor, tuple[int, Framed]] = WeakIdKeyDictionary()  # weak: memory is freed
_empty_around: MutableMapping[Tensor, bool] = WeakIdKeyDictionary()  # volumes made here, in frames that hold zeros


def _framed(volume: Tensor) -> Framed:
    """The volume as kernels read it; remembered, as heads, search and reconstruction share one."""
    # Tensors made under inference_mode do not count their changes.
    version = -1 if volume.is_inference() else volume._version
    known = _known.get(volume)
    if known is not None and known[0] == version >= 0:
        return known[1]
    voxels = padded(volume.detach(), empty=volume not in _empty_around)
    cells, boxes = torch.zeros(voxels.shape[:2], dtype=torch.uint8), torch.empty(len(voxels), 6)
    _run("occupied", voxels, tuple(volume.shape[2:]), cells, boxes)
    _known[volume] = version, (voxels, cells, boxes)
    return voxels, cells, boxes


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
    from viewnet.model.kernels import volume_numba, voxels_numba  # imported late: Numba takes a second to load

    module = volume_numba if hasattr(volume_numba, kernel) else voxels_numba
    numba_call.run(getattr(module, kernel), *arguments)
