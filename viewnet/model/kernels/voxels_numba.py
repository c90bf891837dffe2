"""Numba kernels that make volumes for the renderer: of logits, at half the resolution, and which cells hold anything.

Layouts as in viewnet.model.kernels.volume_numba.
"""

import numpy as np
from numba import njit, prange

from viewnet.model.kernels.bfloat16_numba import FLAGS, compiled, narrowed, sigmoid, widened

ONE, ZERO = np.float32(1.0), np.float32(0.0)


def _occupied(voxels, shape, cells, boxes):
    """Marks in `cells` (B, P) every cell, named by its lowest corner, that has a corner with occupancy.

    `boxes` (B, 6) get the smallest box around them: from where to where in u, v and w; all 0 around nothing.
    """
    row, plane = shape[2] + 2, (shape[1] + 2) * (shape[2] + 2)  # voxels to the next one along v and w
    for b in prange(len(voxels)):
        u_low, u_high, v_low, v_high, w_low, w_high = shape[2], 0, shape[1], 0, shape[0], 0  # empty
        for w in range(shape[0]):
            for v in range(shape[1]):
                at = (w + 1) * plane + (v + 1) * row + 1
                for u in range(shape[2]):
                    p = at + u
                    if voxels[b, p, 3] != 0:  # Q
                        for dw in (0, plane):  # the eight cells that have this corner
                            for dv in (0, row):
                                cells[b, p - dw - dv] = 1
                                cells[b, p - dw - dv - 1] = 1
                        u_low, u_high = min(u_low, u), max(u_high, u + 2)  # cells (u, u + 1), (u + 1, u + 2), padded
                        v_low, v_high = min(v_low, v), max(v_high, v + 2)
                        w_low, w_high = min(w_low, w), max(w_high, w + 2)
        boxes[b] = 0
        if u_high:
            boxes[b, 0], boxes[b, 1], boxes[b, 2] = u_low, u_high, v_low
            boxes[b, 3], boxes[b, 4], boxes[b, 5] = v_high, w_low, w_high


@njit(inline="always", **FLAGS)
def _sigmoids(line, values):
    """Fills `values` from the logits `line`."""
    for t in range(len(values)):  # without conditions: exponentials vectorise
        values[t] = sigmoid(widened(line[t]))


@njit(inline="always", **FLAGS)
def _repeated(numbers, run):
    """Four numbers over and over, `run` in all."""
    repeated = np.empty(run, np.float32)
    for t in range(run):
        repeated[t] = numbers[t % 4]
    return repeated


@njit(inline="always", **FLAGS)
def _empty_frame(voxels, nz, ny, nx):
    """Zeros in the voxels (P 4,) around the volume."""
    row, plane = 4 * (nx + 2), 4 * (ny + 2) * (nx + 2)
    voxels[:plane] = ZERO
    voxels[(nz + 1) * plane :] = ZERO
    for w in range(plane, (nz + 1) * plane, plane):
        voxels[w : w + row] = ZERO
        voxels[w + plane - row : w + plane] = ZERO
        for v in range(w + row, w + plane - row, row):
            for c in range(4):
                voxels[v + c] = voxels[v + row - 4 + c] = ZERO


@njit(inline="always", **FLAGS)
def _copy(source, at, target, to, count):
    if count == 8:  # a pair of voxels, of blocks of 2^3: one register
        for c in range(8):
            target[to + c] = source[at + c]
    else:
        target[to : to + count] = source[at : at + count]


@njit(inline="always", **FLAGS)
def _any(numbers, at, count):
    """Whether one of `count` numbers is not zero, as a sum: unlike a search it vectorises."""
    total = ZERO
    for t in range(at, at + count):
        total += abs(numbers[t])
    return total != ZERO  # NaN is not zero


def _squash(blocks, offset, scale, voxels):
    """Fills `voxels` (B, P, 4) from logits `blocks` (B, z, y, x, s, s, s, 4): sigmoid times `scale` plus `offset`.

    `offset` (z, y, x s^3 4) and `scale` (4,) turn sigmoids into occupancies.
    """
    side = blocks.shape[4]
    run = blocks.shape[3] * side**3 * 4  # numbers in a row of blocks
    pieces, count = (1, run) if side == 1 else (blocks.shape[3], 4 * side)  # of so many, side by side in the volume too
    nz, ny, nx = blocks.shape[1] * side, blocks.shape[2] * side, blocks.shape[3] * side
    scales = _repeated(scale, run)
    for b in prange(len(blocks)):
        volume = voxels[b].reshape(-1)  # (P 4,)
        _empty_frame(volume, nz, ny, nx)
        values = np.empty(run, np.float32)
        for z, y in np.ndindex(blocks.shape[1], blocks.shape[2]):
            _sigmoids(blocks[b, z, y].reshape(run), values)
            for t in range(run):
                value = values[t] * scales[t] + offset[z, y, t]
                value = ZERO if value < ZERO else value  # unlike max, lets NaN through to be noticed
                values[t] = ONE if value > ONE else value
            t = 0
            for x in range(pieces):
                for dz, dy in np.ndindex(side, side):  # the s^3 voxels of one place
                    w, v = z * side + dz + 1, y * side + dy + 1
                    _copy(values, t, volume, 4 * ((w * (ny + 2) + v) * (nx + 2) + x * side + 1), count)
                    t += count


def _squash_backward(blocks, offset, scale, grad_voxels, grad):
    """Fills `grad` (B, z, y, x, s, s, s, 4), the gradient of `blocks`; voxels outside [0, 1] are let back in."""
    side = blocks.shape[4]
    run = blocks.shape[3] * side**3 * 4
    pieces, count = (1, run) if side == 1 else (blocks.shape[3], 4 * side)
    ny, nx = blocks.shape[2] * side, blocks.shape[3] * side
    scales = _repeated(scale, run)
    for b in prange(len(blocks)):
        volume = grad_voxels[b].reshape(-1)
        values, change = np.empty(run, np.float32), np.empty(run, np.float32)
        for z, y in np.ndindex(blocks.shape[1], blocks.shape[2]):
            result = grad[b, z, y].reshape(run)
            changed = False
            for dz, dy in np.ndindex(side, side):
                w, v = z * side + dz + 1, y * side + dy + 1
                changed |= _any(volume, 4 * ((w * (ny + 2) + v) * (nx + 2) + 1), 4 * nx)
            if not changed:  # far from the object: most rows
                for t in range(run):
                    result[t] = 0  # of both types
                continue
            t = 0
            for x in range(pieces):
                for dz, dy in np.ndindex(side, side):
                    w, v = z * side + dz + 1, y * side + dy + 1
                    _copy(volume, 4 * ((w * (ny + 2) + v) * (nx + 2) + x * side + 1), change, t, count)
                    t += count
            _sigmoids(blocks[b, z, y].reshape(run), values)
            for t in range(run):  # vectorised again
                value = values[t] * scales[t] + offset[z, y, t]
                # Only gradients that point back inside pass, as in viewnet.model.volume.
                out = (value < ZERO and change[t] > ZERO) or (value > ONE and change[t] < ZERO)
                back = ZERO if out else change[t] * scales[t]
                result[t] = narrowed(values[t] * (ONE - values[t]) * back, result[t])


def _halve(voxels, shape, halves):
    """Fills `halves` (B, P', 4) with the means of every eight voxels; its frame stays as it is."""
    row, plane = shape[2] + 2, (shape[1] + 2) * (shape[2] + 2)
    small_row = shape[2] // 2 + 2
    small_plane = (shape[1] // 2 + 2) * small_row
    for b in prange(len(voxels)):
        for w, v in np.ndindex(shape[0] // 2, shape[1] // 2):
            for u in range(shape[2] // 2):
                p = (2 * w + 1) * plane + (2 * v + 1) * row + 2 * u + 1  # of the eight, the lowest corner
                at = (w + 1) * small_plane + (v + 1) * small_row + u + 1
                for c in range(4):
                    near = voxels[b, p, c] + voxels[b, p + 1, c] + voxels[b, p + row, c] + voxels[b, p + row + 1, c]
                    q = p + plane
                    far = voxels[b, q, c] + voxels[b, q + 1, c] + voxels[b, q + row, c] + voxels[b, q + row + 1, c]
                    halves[b, at, c] = (near + far) * np.float32(0.125)


occupied, halve = compiled(_occupied), compiled(_halve)
squash, squash_backward = compiled(_squash), compiled(_squash_backward)
