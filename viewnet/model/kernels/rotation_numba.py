"""Features of volumes seen from cameras: the HoloGAN decoder's rotation for CPUs, on float32 or on bfloat16's bits.

PyTorch samples a channel at a time and one behind the other; what learned layers read is a pixel's features side by
side. Here eight corners are runs of channels, and so is what is written.
"""

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from viewnet.model.kernels import numba_call
from viewnet.model.kernels.bfloat16_numba import FLAGS, compiled, narrowed, widened

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)


def rotated(features: Tensor, frames: Tensor) -> Tensor:
    """Features (B, C, s, s, s) at the s^3 points of each camera frame (N, 3, 3): (N, s, s, s, C), depth third.

    By rows and columns of the image and from near to far, between the voxels trilinear and beyond them as at the edge;
    N is a multiple of B as in viewnet.model.volume.
    """
    return _Rotate.apply(features.permute(0, 2, 3, 4, 1), frames)


class _Rotate(torch.autograd.Function):
    @staticmethod
    def forward(ctx, features, frames):
        features, frames = features.contiguous(), frames.float().contiguous()  # (B, s, s, s, C), (N, 3, 3)
        out = features.new_empty(len(frames), *features.shape[1:])  # (N, s, s, s, C)
        numba_call.run(rotate, features, frames, out)
        ctx.save_for_backward(features, frames)
        return out

    @staticmethod
    def backward(ctx, grad):
        features, frames = ctx.saved_tensors
        grad_features, grad_frames = torch.empty_like(features), torch.empty_like(frames)
        grad = grad.to(features.dtype).contiguous()
        numba_call.run(rotate_backward, features, frames, grad, grad_features, grad_frames)
        return grad_features, grad_frames


@njit(inline="always", **FLAGS)
def _along(place, size):
    """Of a place in [-1, 1] along an axis: the voxel before it, how far behind that it is, and what a move changes."""
    u = ((place + ONE) * np.float32(size) - ONE) * HALF
    moves = HALF * np.float32(size) if u > ZERO and u < np.float32(size - 1) else ZERO
    u = u if u > ZERO else ZERO  # so that NaN, too, is inside
    u = u if u < np.float32(size - 1) else np.float32(size - 1)
    u0 = min(int(u), size - 2)
    return np.uintp(u0), u - np.float32(u0), moves


@njit(inline="always", **FLAGS)
def _cell(frame, i, j, k, size):
    """Of pixel (i, j) at depth k: its camera coordinates, the cell's lowest corner, and `_along` of the axes."""
    x, y = np.float32(2 * j + 1) / np.float32(size) - ONE, ONE - np.float32(2 * i + 1) / np.float32(size)
    z = ONE - np.float32(2 * k + 1) / np.float32(size)
    u0, u, mu = _along(frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z, size)
    v0, v, mv = _along(frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z, size)
    w0, w, mw = _along(frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z, size)
    n = np.uintp(size)
    return (x, y, z), (w0 * n + v0) * n + u0, (u, v, w), (mu, mv, mw)


@njit(inline="always", **FLAGS)
def _weights(into):
    """Of the eight corners, u first, w last."""
    u, v, w = into
    a, b, c, d = (ONE - u) * (ONE - v), u * (ONE - v), (ONE - u) * v, u * v
    return a * (ONE - w), b * (ONE - w), c * (ONE - w), d * (ONE - w), a * w, b * w, c * w, d * w


def _rotate(features, frames, out):
    """Fills `out` (N, s, s, s, C) from `features` (B, s, s, s, C), axes z, y, x, and `frames` (N, 3, 3)."""
    share = len(frames) // len(features)  # views a volume
    for n in prange(len(frames)):  # images share nothing
        _view(features[n // share].reshape(-1, features.shape[4]), frames[n], out[n])


# Inlined: a function of its own is optimised on its own, and again in what calls it; which of the two runs depends on
# whether this process compiled it or loaded it, and their sums differ in the last bits.
@njit(forceinline=True, nogil=True, **FLAGS)
def _view(voxels, frame, out):
    size, channels = out.shape[0], out.shape[3]
    row, plane = np.uintp(size), np.uintp(size * size)
    for i, j, k in np.ndindex(size, size, size):
        _, p, into, _ = _cell(frame, i, j, k, size)
        w0, w1, w2, w3, w4, w5, w6, w7 = _weights(into)
        q, line = p + plane, out[i, j, k]
        for c in range(channels):  # innermost, where memory is contiguous: vectorised
            near = w0 * widened(voxels[p, c]) + w1 * widened(voxels[p + np.uintp(1), c])
            near += w2 * widened(voxels[p + row, c]) + w3 * widened(voxels[p + row + np.uintp(1), c])
            far = w4 * widened(voxels[q, c]) + w5 * widened(voxels[q + np.uintp(1), c])
            far += w6 * widened(voxels[q + row, c]) + w7 * widened(voxels[q + row + np.uintp(1), c])
            line[c] = narrowed(near + far, line[c])


def _rotate_backward(features, frames, grad, grad_features, grad_frames):
    """Fills the gradients (B, s, s, s, C) and (N, 3, 3) for `grad` (N, s, s, s, C)."""
    share = len(frames) // len(features)
    for b in prange(len(features)):  # one volume a thread, its views in turn: sums have one order
        _volume_backward(
            features[b].reshape(-1, features.shape[4]),
            frames[b * share : (b + 1) * share],
            grad[b * share : (b + 1) * share],
            grad_features[b].reshape(-1, features.shape[4]),
            grad_frames[b * share : (b + 1) * share],
        )


@njit(forceinline=True, nogil=True, **FLAGS)
def _volume_backward(voxels, frames, grad, grad_voxels, grad_frames):
    size, channels = grad.shape[1], grad.shape[4]
    one, row, plane = np.uintp(1), np.uintp(size), np.uintp(size * size)
    total = np.zeros(voxels.shape, np.float32)
    for n in range(len(frames)):
        grad_frames[n] = 0
        for i, j, k in np.ndindex(size, size, size):
            point, p, into, moves = _cell(frames[n], i, j, k, size)
            w0, w1, w2, w3, w4, w5, w6, w7 = _weights(into)
            q, line = p + plane, grad[n, i, j, k]
            d0 = d1 = d2 = d3 = d4 = d5 = d6 = d7 = ZERO  # of the corners' features with the gradient
            for c in range(channels):
                g = widened(line[c])
                d0 += g * widened(voxels[p, c])
                d1 += g * widened(voxels[p + one, c])
                d2 += g * widened(voxels[p + row, c])
                d3 += g * widened(voxels[p + row + one, c])
                d4 += g * widened(voxels[q, c])
                d5 += g * widened(voxels[q + one, c])
                d6 += g * widened(voxels[q + row, c])
                d7 += g * widened(voxels[q + row + one, c])
            for c in range(channels):  # trilinear's transpose
                g = widened(line[c])
                total[p, c] += w0 * g
                total[p + one, c] += w1 * g
                total[p + row, c] += w2 * g
                total[p + row + one, c] += w3 * g
                total[q, c] += w4 * g
                total[q + one, c] += w5 * g
                total[q + row, c] += w6 * g
                total[q + row + one, c] += w7 * g
            u, v, w = into
            near_u, far_u = (d1 - d0) * (ONE - v) + (d3 - d2) * v, (d5 - d4) * (ONE - v) + (d7 - d6) * v
            near_v, far_v = (d2 - d0) * (ONE - u) + (d3 - d1) * u, (d6 - d4) * (ONE - u) + (d7 - d5) * u
            near_w, far_w = (d4 - d0) * (ONE - u) + (d5 - d1) * u, (d6 - d2) * (ONE - u) + (d7 - d3) * u
            gx = moves[0] * (near_u * (ONE - w) + far_u * w)  # dL/dp, world coordinates
            gy = moves[1] * (near_v * (ONE - w) + far_v * w)
            gz = moves[2] * (near_w * (ONE - v) + far_w * v)
            for axis in range(3):  # dL/dR: the sum of dL/dp p^T
                grad_frames[n, 0, axis] += gx * point[axis]
                grad_frames[n, 1, axis] += gy * point[axis]
                grad_frames[n, 2, axis] += gz * point[axis]
    for p in range(len(total)):
        for c in range(channels):
            grad_voxels[p, c] = narrowed(total[p, c], grad_voxels[p, c])


rotate, rotate_backward = compiled(_rotate), compiled(_rotate_backward)
