"""Points spread over the voxels of a grid, for CPUs: PyTorch's eight weights and places a point fill the memory."""

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from viewnet.model.kernels import numba_call
from viewnet.model.kernels.bfloat16_numba import FLAGS, compiled

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)


def splat(places: Tensor, size: int) -> Tensor:
    """viewnet.peers.pointcloud.splat of float32 on the CPU."""
    return _Splat.apply(places, size)


class _Splat(torch.autograd.Function):
    @staticmethod
    def forward(ctx, places, size):
        places = places.contiguous()  # (N, P, 3)
        grid = places.new_zeros(len(places), size, size, size)  # (N, n, n, n)
        numba_call.run(spread, places, grid)
        ctx.save_for_backward(places)
        return grid

    @staticmethod
    def backward(ctx, grad):
        (places,) = ctx.saved_tensors
        moved = torch.zeros_like(places)  # (N, P, 3)
        numba_call.run(spread_backward, places, grad.contiguous(), moved)
        return moved, None


@njit(inline="always", **FLAGS)
def _along(place, size):
    """Of a place in [0, 1] along an axis: the voxel before it, how far behind that it is, and what a move changes."""
    u = place * np.float32(size) - HALF
    moves = np.float32(size) if u > ZERO and u < np.float32(size - 1) else ZERO
    u = min(max(u, ZERO), np.float32(size - 1))
    before = min(int(u), size - 2)
    return np.uintp(before), u - np.float32(before), moves


@njit(inline="always", **FLAGS)
def _inside(z, y, x):
    return z >= ZERO and z <= ONE and y >= ZERO and y <= ONE and x >= ZERO and x <= ONE  # NaN is not


@compiled
def spread(places, grid):
    """Adds the points at places (N, P, 3) to the grids (N, n, n, n)."""
    size = grid.shape[1]
    for n in prange(len(places)):
        for p in range(places.shape[1]):
            if not _inside(places[n, p, 0], places[n, p, 1], places[n, p, 2]):
                continue
            k, c, _ = _along(places[n, p, 0], size)
            i, b, _ = _along(places[n, p, 1], size)
            j, a, _ = _along(places[n, p, 2], size)
            for dk in range(2):
                depth = c if dk else ONE - c
                for di in range(2):
                    share = depth * (b if di else ONE - b)
                    grid[n, k + dk, i + di, j] += share * (ONE - a)
                    grid[n, k + dk, i + di, j + 1] += share * a


@compiled
def spread_backward(places, grad, moved):
    """Fills gradients (N, P, 3), zero before, of the places (N, P, 3) from the grids' (N, n, n, n)."""
    size = grad.shape[1]
    for n in prange(len(places)):
        for p in range(places.shape[1]):
            if not _inside(places[n, p, 0], places[n, p, 1], places[n, p, 2]):
                continue
            k, c, moves_k = _along(places[n, p, 0], size)
            i, b, moves_i = _along(places[n, p, 1], size)
            j, a, moves_j = _along(places[n, p, 2], size)
            z, y, x = ZERO, ZERO, ZERO
            for dk in range(2):
                depth, sign_k = (c, ONE) if dk else (ONE - c, -ONE)
                for di in range(2):
                    row, sign_i = (b, ONE) if di else (ONE - b, -ONE)
                    first, second = grad[n, k + dk, i + di, j], grad[n, k + dk, i + di, j + 1]
                    along = first + a * (second - first)
                    z += sign_k * row * along
                    y += sign_i * depth * along
                    x += depth * row * (second - first)
            moved[n, p, 0], moved[n, p, 1], moved[n, p, 2] = z * moves_k, y * moves_i, x * moves_j
