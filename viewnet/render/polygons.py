"""Polygons in space as triangles within their outlines: as fans where these lie within, else by clipping ears."""

import numpy as np

MAX_OUTLINE = 4096  # corners of a polygon whose ears are clipped: the time grows with their square
BLOCK = 2**18  # corners of polygons that are worked on at once, which bounds memory
NEAR = 1e-5  # of a polygon's extent: what is no farther into a triangle than that only touches it


def triangles(vertices: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner numbers (F, 3) of the triangles of polygons, and the number (F,) of the polygon that each is of.

    `corners` (C,) are those of all polygons, into `vertices` (V, 3), and `sizes` (P,) how many each has. With fewer
    than three it has no triangle. Where an outline crosses itself, or has too many corners, the triangles are a fan's.
    """
    if (sizes == 3).all():
        return np.arange(len(corners)).reshape(-1, 3), np.arange(len(sizes))
    count = np.maximum(sizes - 2, 0)
    ends = np.cumsum(count)
    owner = np.repeat(np.arange(len(sizes)), count)
    step = np.arange(len(owner)) - (ends - count)[owner]
    starts = np.cumsum(sizes) - sizes
    result = starts[owner, None] + np.stack([np.zeros_like(step), step + 1, step + 2], axis=1)
    points = vertices[corners]
    edge, other = (points[result[:, i]] - points[result[:, 0]] for i in (1, 2))
    with np.errstate(over="ignore", invalid="ignore"):  # the normalisation of the mesh rejects what is too large
        areas = np.cross(edge, other)
        normals = np.stack([np.bincount(owner, part, len(sizes)) for part in areas.T], axis=1)
        folded = np.einsum("fi,fi->f", areas, normals[owner]) < -1e-6 * np.square(normals).sum(axis=1)[owner]
    bent = np.unique(owner[folded])
    bent = bent[sizes[bent] <= MAX_OUTLINE]
    for size in np.unique(sizes[bent]):
        mine = bent[sizes[bent] == size]
        for block in np.array_split(mine, -(-len(mine) * size // BLOCK)):
            outlines = points[starts[block, None] + np.arange(size)]
            # Seen along the axis that is closest to their normals, counter-clockwise.
            axis = np.abs(normals[block]).argmax(axis=1)[:, None]
            turned = np.take_along_axis(normals[block], axis, axis=1) < 0
            axes = (axis + np.where(turned, [2, 1], [1, 2])) % 3
            rows = (ends - count)[block, None] + np.arange(size - 2)
            result[rows] = starts[block, None, None] + _ears(np.take_along_axis(outlines, axes[:, None], axis=2))
    return result, owner


def _ears(outlines: np.ndarray) -> np.ndarray:
    """Corner numbers (P, n - 2, 3) of the triangles of outlines (P, n, 2) that go counter-clockwise."""
    count, size = outlines.shape[:2]
    outlines = outlines / np.maximum(np.ptp(outlines, axis=1).max(axis=1), 1e-300)[:, None, None]
    left = np.tile(np.arange(size), (count, 1))  # the corners of what is not clipped yet
    ears = np.zeros((count, size - 2, 3), int)
    chosen = np.zeros(count, int)
    for clipped in range(size - 3):
        have = size - clipped
        waiting = np.arange(count)
        for _ in range(have):
            ring = np.take_along_axis(outlines[waiting], left[waiting, :, None], axis=1)
            waiting = waiting[~_is_ear(ring, chosen[waiting])]
            if not len(waiting):
                break
            chosen[waiting] = (chosen[waiting] + 1) % have
        around = (chosen[:, None] + np.array([-1, 0, 1])) % have
        ears[:, clipped] = np.take_along_axis(left, around, axis=1)
        left = left[np.arange(have) != chosen[:, None]].reshape(count, have - 1)
        chosen %= have - 1
    ears[:, -1] = left
    return ears


def _is_ear(ring: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """(Q,) bool: whether the triangle at a corner (Q,) of outlines (Q, m, 2) lies within: no edge leads through it.

    That holds for outlines that touch themselves too. A corner without an area can always be clipped.
    """
    around = (corner[:, None] + np.array([-1, 0, 1])) % ring.shape[1]
    ear = np.take_along_axis(ring, around[..., None], axis=1)  # (Q, 3, 2)
    sides = np.roll(ear, -1, axis=1) - ear
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    lengths = np.linalg.norm(sides, axis=2, keepdims=True)
    sides /= np.maximum(lengths, 1e-300)
    # How far the ends of the edges lie within each side (Q, 3, m), and which part of each edge lies within all.
    offset = ring[:, None] - ear[:, :, None]
    here = sides[..., None, 0] * offset[..., 1] - sides[..., None, 1] * offset[..., 0] - NEAR
    there = np.roll(here, -1, axis=2)
    cut = here / np.where(here == there, 1, here - there)
    begin = np.where(here < 0, np.where(there > 0, cut, 1), 0).max(axis=1)
    end = np.where(there < 0, np.where(here > 0, cut, 0), 1).min(axis=1)
    flat = np.abs(area) <= NEAR * lengths.max(axis=(1, 2))
    return flat | ((area > 0) & (begin >= end).all(axis=1))
