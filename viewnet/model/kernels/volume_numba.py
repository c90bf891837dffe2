"""Numba kernels of viewnet.model.kernels.volume_cpu that walk along rays, float32.

`voxels` is (B, P, 4) with P = (nz + 2) (ny + 2) (nx + 2): one empty voxel around the volume spares every bounds check.
Along a ray the position in the volume is linear in the step, so the steps inside are an interval, found in advance. A
ray's steps are placed all at once, those in empty cells are dropped, and the others are interpolated LANES at a time.
"""

import numpy as np
from numba import njit, prange

from viewnet.model.kernels.bfloat16_numba import FLAGS, compiled
from viewnet.model.kernels.trilinear_llvm import LANES, deposit, interpolate, locate, march, slopes

# u, v, w: position in padded voxels along x, y, z; q: occupancy there; light: the share of the ray that reaches the
# step; stop: the share that ends at it.
OPAQUE = np.float32(1e-5)  # a ray with so little light left has stopped: nothing behind can change a pixel visibly
ONE = np.float32(1.0)  # float32: with a Python float every sum would be of float64
HALF = np.float32(0.5)
ZERO = np.float32(0.0)
TINY = np.float32(1e-9)


@njit(inline="always", **FLAGS)
def _camera(frame, focal, steps, shape):
    """What all rays of an image share: right, up and back as (u, v, w) in voxels, and depth and scale of step 0.

    The place at step k is (right px + up py) (s0 + k ds) + start + k back.
    """
    z0, dz = ONE - ONE / np.float32(steps), np.float32(-2.0) / np.float32(steps)  # depth of step 0, its change a step
    s0, ds = ONE - focal * z0, -focal * dz  # perspective 1 - f z, linear in the step as well
    nz, ny, nx = shape
    hx, hy, hz = np.float32(nx) * HALF, np.float32(ny) * HALF, np.float32(nz) * HALF  # half sides: [-1, 1] to voxels
    right = frame[0, 0] * hx, frame[1, 0] * hy, frame[2, 0] * hz
    up = frame[0, 1] * hx, frame[1, 1] * hy, frame[2, 1] * hz
    back = frame[0, 2] * hx, frame[1, 2] * hy, frame[2, 2] * hz
    # World coordinate x has the padded index (x + 1) n / 2 + 1/2: half a voxel to its centre, one for the frame.
    start = back[0] * z0 + hx + HALF, back[1] * z0 + hy + HALF, back[2] * z0 + hz + HALF
    return right, up, start, (back[0] * dz, back[1] * dz, back[2] * dz), s0, ds


@njit(inline="always", **FLAGS)
def _line(camera, px, py):
    """u, v and w of the ray through (px, py) at step 0, and their changes a step."""
    right, up, start, back, s0, ds = camera
    a, b, c = right[0] * px + up[0] * py, right[1] * px + up[1] * py, right[2] * px + up[2] * py
    ahead = a * ds + back[0], b * ds + back[1], c * ds + back[2]
    return a * s0 + start[0], b * s0 + start[1], c * s0 + start[2], *ahead


@njit(inline="always", **FLAGS)
def _clip(low, high, start, step, bottom, top):
    """The part of [low, high] where bottom <= start + k step <= top."""
    step = TINY if abs(step) < TINY else step  # parallel to both planes: between them for ever, or never
    inverse = ONE / step
    a, b = (bottom - start) * inverse, (top - start) * inverse  # where it crosses them, in steps
    return max(low, min(a, b)), min(high, max(a, b))


@njit(inline="always", **FLAGS)
def _pixel(j, size):
    return np.float32(np.int32(2) * np.int32(j) + np.int32(1)) / np.float32(size) - ONE  # its centre, in [-1, 1]


@njit(inline="always", **FLAGS)
def _enter(camera, box, steps, py, spans):
    """Fills `spans` (size,) for a row of pixels: which steps are inside `box` (6,), as first + 2^16 count."""
    for j in range(len(spans)):  # without conditions: vectorised
        u, v, w, du, dv, dw = _line(camera, _pixel(j, len(spans)), py)
        low, high = _clip(ZERO, np.float32(steps - 1), u, du, box[0], box[1])
        low, high = _clip(low, high, v, dv, box[2], box[3])
        low, high = _clip(low, high, w, dw, box[4], box[5])
        first = np.ceil(low)
        count = np.floor(high) - first + ONE  # a float: what is far outside fits no integer
        spans[j] = (np.int32(count) << np.int32(16)) | np.int32(first) if count >= ONE else np.int32(0)


@njit(inline="always", **FLAGS)
def _memory(size, steps):
    """What a row of rays is worked out in: spans, places, into, lit and values."""
    most = steps + LANES
    cells, lit = np.empty(most, np.uint32), np.empty(most, np.uint32)
    return np.empty(size, np.int32), cells, np.empty((3, most), np.float32), lit, np.empty(4 * most, np.float32)


@njit(inline="always", **FLAGS)
def _sum(vector):
    return vector[0] + vector[1] + vector[2]


@njit(nogil=True, **FLAGS)
def _draw(voxels, cells, box, shape, camera, steps, i, memory, pixels):
    """Fills row `i` of an image, `pixels` (size, 4)."""
    size = len(pixels)
    strides = np.uintp(shape[2] + 2), np.uintp((shape[1] + 2) * (shape[2] + 2))  # voxels to the next along v and w
    last = np.int32(shape[2]), np.int32(shape[1]), np.int32(shape[0])
    spans, places, into, lit, _ = memory
    py = -_pixel(i, size)  # rows from the top
    _enter(camera, (box[0], box[1], box[2], box[3], box[4], box[5]), steps, py, spans)
    right, up, start, back, s0, ds = camera
    nothing = ZERO * (_sum(right) + _sum(up) + _sum(start) + _sum(back) + s0 + ds)  # NaN for a camera that is none
    for j in range(size):
        red = green = blue = mask = ZERO
        span = spans[j]
        if span:
            line, first = _line(camera, _pixel(j, size), py), span & np.int32(0xFFFF)
            count = locate(cells, line, first, span >> 16, last, strides, places, into, lit)
            red, green, blue, mask = march(voxels, strides, places, into, lit, count, OPAQUE)
        pixels[j, 0], pixels[j, 1] = red + nothing, green + nothing
        pixels[j, 2], pixels[j, 3] = blue + nothing, mask + nothing


def _forward(voxels, cells, boxes, shape, frames, focal, steps, image):
    """Fills `image` (N, 4, size, size); cells that `cells` (B, P) says are empty are passed over.

    Rays are walked inside `boxes` (B, 6) only: from where to where in u, v and w.
    """
    share = len(frames) // len(voxels)  # views a volume
    for n in prange(len(frames)):  # images share nothing
        b, size = n // share, image.shape[2]
        camera, memory = _camera(frames[n], focal, steps, shape), _memory(size, steps)
        pixels = np.empty((size, 4), np.float32)
        for i in range(size):
            _draw(voxels[b], cells[b], boxes[b], shape, camera, steps, i, memory, pixels)
            for j in range(size):
                for c in range(4):
                    image[n, c, i, j] = pixels[j, c]


def _compare(voxels, cells, boxes, shape, frames, focal, target, weights, best, errors):
    """Of every group's views the one that explains an image best: fills `best` (N, G) and `errors` (N, G).

    `frames` are (N, G, T, 3, 3), `target` (N, size, size, 4), `weights` (4 size,) of a row's squared errors. No image
    is kept. All views of a group are begun, from the middle outwards, and the best so far is drawn first: another one
    only until it is worse.
    """
    share, size = len(target) // len(voxels), target.shape[1]
    groups, views = frames.shape[1:3]
    begun = size // 4 if views > 1 else 0  # rows of all views
    for n in prange(len(target)):
        b, memory, pixels = n // share, _memory(size, size), np.empty((size, 4), np.float32)
        found = np.empty(views, np.float32)
        for g in range(groups):
            found[:] = ZERO
            for t in range(views * (begun > 0)):
                camera = _camera(frames[n, g, t], focal, size, shape)
                for row in range(begun):
                    i = _outwards(row, size)
                    _draw(voxels[b], cells[b], boxes[b], shape, camera, size, i, memory, pixels)
                    found[t] += _row_error(pixels, target[n, i], weights)
            least = np.float32(np.inf)
            best[n, g] = first = np.argmin(found)
            for turn in range(views):
                t = first if turn == 0 else turn - 1 if turn <= first else turn
                camera = _camera(frames[n, g, t], focal, size, shape)
                for row in range(begun, size):
                    if found[t] >= least:
                        break
                    i = _outwards(row, size)
                    _draw(voxels[b], cells[b], boxes[b], shape, camera, size, i, memory, pixels)
                    found[t] += _row_error(pixels, target[n, i], weights)
                if not found[t] >= least:  # NaN is kept, to be noticed
                    least = found[t]
                    best[n, g] = t
            errors[n, g] = least


@njit(inline="always", **FLAGS)
def _outwards(row, size):
    return size // 2 + (row // 2 if row % 2 == 0 else -(row // 2) - 1)  # objects are in the middle


@njit(inline="always", **FLAGS)
def _row_error(pixels, wanted, weights):
    pixels, wanted = pixels.reshape(-1), wanted.reshape(-1)  # (4 size,) each: one loop, vectorised
    total = ZERO
    for t in range(len(weights)):
        total += weights[t] * (pixels[t] - wanted[t]) ** 2
    return total


def _backward(voxels, cells, boxes, shape, frames, focal, steps, grad, grad_voxels, grad_frames, grad_focal):
    """For `grad` (N, 4, size, size) fills `grad_voxels` (B, P, 4), `grad_frames` (N, 3, 3); adds to `grad_focal` (B,).

    Cells that `cells` (B, P) leaves out, and what is outside `boxes` (B, 6), get no gradient.
    """
    share = len(frames) // len(voxels)
    for b in prange(len(voxels)):  # one volume a thread, its views in turn: sums have one order
        grad_voxels[b] = ZERO  # here, where it stays in the cache
        for n in range(b * share, (b + 1) * share):
            grad_focal[b] += _draw_backward(
                voxels[b], cells[b], boxes[b], shape, frames[n], focal, steps, grad[n], grad_voxels[b], grad_frames[n]
            )


@njit(nogil=True, **FLAGS)
def _draw_backward(voxels, cells, box, shape, frame, focal, steps, grad, grad_voxels, grad_frame):
    size = grad.shape[1]
    strides = np.uintp(shape[2] + 2), np.uintp((shape[1] + 2) * (shape[2] + 2))
    last = np.int32(shape[2]), np.int32(shape[1]), np.int32(shape[0])
    camera, (spans, places, into, lit, values) = _camera(frame, focal, steps, shape), _memory(size, steps)
    hx, hy, hz = np.float32(shape[2]) * HALF, np.float32(shape[1]) * HALF, np.float32(shape[0]) * HALF
    lights, seen = np.empty(steps, np.float32), np.empty(steps, np.float32)
    grad_frame[:] = ZERO
    total_focal = ZERO
    for i in range(size):
        py = -_pixel(i, size)
        _enter(camera, (box[0], box[1], box[2], box[3], box[4], box[5]), steps, py, spans)
        for j in range(size):
            g0, g1, g2, g3 = grad[0, i, j], grad[1, i, j], grad[2, i, j], grad[3, i, j]
            span = spans[j]
            if not span or (g0 == 0 and g1 == 0 and g2 == 0 and g3 == 0):  # nothing to hand back
                continue
            px, first = _pixel(j, size), span & np.int32(0xFFFF)
            count = locate(cells, _line(camera, px, py), first, span >> 16, last, strides, places, into, lit)
            # What is behind an opaque voxel has a say in its gradient, so a ray goes on behind the first one: it ends
            # where hardly any light would pass even with the most opaque of its steps taken away.
            light = rest = least = ONE
            visits = 0
            while visits < count and rest >= OPAQUE:
                end = min(visits + LANES, count)
                interpolate(voxels, strides, places, into, lit, visits, end, values)
                for n in range(visits, end):
                    r, g, b, q = values[4 * n], values[4 * n + 1], values[4 * n + 2], values[4 * n + 3]
                    seen[n] = g0 * r + g1 * g + g2 * b + g3  # the loss's view of the colour and the mask
                    lights[n] = light
                    light *= ONE - q  # light in front of the next step
                    rest *= max(ONE - q, least)
                    least = min(ONE - q, least)
                visits = end
            # `beyond`: what the pixel's gradient makes of the light that passes a step; from the far end to the near.
            beyond = ZERO
            gx = gy = gz = gx_z = gy_z = gz_z = ZERO  # sums of dL/dp, world coordinates, and of z times it
            for n in range(visits - 1, -1, -1):
                q = values[4 * n + 3]
                stop = q * lights[n]  # equation 3
                back = lights[n] * (seen[n] - beyond)  # dL/dq: seen here against seen behind
                beyond = q * seen[n] + (ONE - q) * beyond  # the same for the step before
                change = stop * g0, stop * g1, stop * g2, back  # dL/d(r, g, b, q)
                step = np.intp(lit[n])
                su, sv, sw = slopes(voxels, strides, places, into, step, change)  # d(values . change) / d(u, v, w)
                deposit(grad_voxels, strides, places, into, step, change)  # trilinear's transpose
                z = ONE - np.float32(2 * (first + step) + 1) / np.float32(steps)
                gx += su
                gy += sv
                gz += sw
                gx_z += z * su
                gy_z += z * sv
                gz_z += z * sw
            gx, gy, gz, gx_z, gy_z, gz_z = gx * hx, gy * hy, gz * hz, gx_z * hx, gy_z * hy, gz_z * hz
            # The place is R (px (1 - f z), py (1 - f z), z): dL/dR is the sum of dL/dp times it.
            for axis, total, with_z in ((0, gx, gx_z), (1, gy, gy_z), (2, gz, gz_z)):
                grad_frame[axis, 0] += px * (total - focal * with_z)
                grad_frame[axis, 1] += py * (total - focal * with_z)
                grad_frame[axis, 2] += with_z
                total_focal -= with_z * (frame[axis, 0] * px + frame[axis, 1] * py)  # d/df: -z R (px, py, 0)
    return total_focal


forward, compare, backward = compiled(_forward), compiled(_compare), compiled(_backward)
