"""Numba kernels of viewnet.model.kernels.volume_cpu, float32.

`voxels` is (B, P, 4) with P = (nz + 2) (ny + 2) (nx + 2): one empty voxel around the volume spares every bounds check.
Along a ray the position in the volume is linear in the step k, so the steps inside are an interval, found in advance.
"""

import numpy as np
from numba import njit, prange

from viewnet.model.kernels.bfloat16_numba import FLAGS, compiled, narrowed, sigmoid, widened
from viewnet.model.kernels.trilinear_llvm import deposit, sampled, slopes

# u, v, w: position in padded voxels along x, y, z, of which u0, v0, w0 is the cell; k: step along the ray, near to far;
# q: occupancy there; light: the share of the ray that reaches the step; stop: the share that ends at it.
OPAQUE = np.float32(1e-5)  # a ray with so little light left has stopped: nothing behind can change a pixel visibly
ONE = np.float32(1.0)  # float32: with a Python float every sum would be of float64
HALF = np.float32(0.5)
ZERO = np.float32(0.0)


@njit(inline="always", **FLAGS)  # into its caller: one is called for every pixel
def _clip(low, high, start, step, bottom, top):
    """The steps k of [low, high) with bottom <= start + k step < top."""
    if abs(step) < 1e-9:  # parallel to both planes: all steps or none
        return (low, high) if bottom <= start < top else (low, low)
    a, b = (bottom - start) / step, (top - start) / step  # where it crosses them, in steps
    if a > b:
        a, b = b, a
    low, high = max(low, int(np.ceil(a))), min(high, int(np.floor(b)) + 1)
    # Rounding may put an end just outside; the caller reads memory there, so it is checked exactly.
    while low < high and not bottom <= start + np.float32(low) * step < top:
        low += 1
    while low < high and not bottom <= start + np.float32(high - 1) * step < top:
        high -= 1
    return low, high


@njit(inline="always", **FLAGS)
def _ray(frame, focal, steps, shape, box, px, py):
    """Position (u, v, w) in padded voxels at step 0, its change a step, and the interval of steps inside `box` (6,)."""
    z0, dz = ONE - ONE / np.float32(steps), np.float32(-2.0) / np.float32(steps)  # depth of step 0, its change a step
    s0, ds = ONE - focal * z0, -focal * dz  # perspective 1 - f z, linear in k as well
    nz, ny, nx = shape
    hx, hy, hz = np.float32(nx) * HALF, np.float32(ny) * HALF, np.float32(nz) * HALF  # half sides: [-1, 1] to voxels
    a = frame[0, 0] * px + frame[0, 1] * py  # R (px, py, 0), by row
    b = frame[1, 0] * px + frame[1, 1] * py
    c = frame[2, 0] * px + frame[2, 1] * py
    # World coordinate x has the padded index (x + 1) n / 2 + 1/2: half a voxel to its centre, one for the frame.
    u, du = (a * s0 + frame[0, 2] * z0 + ONE) * hx + HALF, (a * ds + frame[0, 2] * dz) * hx
    v, dv = (b * s0 + frame[1, 2] * z0 + ONE) * hy + HALF, (b * ds + frame[1, 2] * dz) * hy
    w, dw = (c * s0 + frame[2, 2] * z0 + ONE) * hz + HALF, (c * ds + frame[2, 2] * dz) * hz
    low, high = _clip(0, steps, u, du, box[0], box[1])
    if low < high:
        low, high = _clip(low, high, v, dv, box[2], box[3])
    if low < high:
        low, high = _clip(low, high, w, dw, box[4], box[5])
    return u, v, w, du, dv, dw, low, high


def _forward(voxels, cells, boxes, shape, frames, focal, steps, image):
    """Fills `image` (N, size, size, 4); cells that `cells` (B, P) says are empty are passed over.

    Rays are walked inside `boxes` (B, 6) only: from where to where in u, v and w.
    """
    share = len(frames) // len(voxels)  # views a volume
    for n in prange(len(frames)):  # images share nothing
        _draw(voxels[n // share], cells[n // share], boxes[n // share], shape, frames[n], focal, steps, image[n])


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


@njit(nogil=True, **FLAGS)
def _draw(voxels, cells, box, shape, frame, focal, steps, image):
    size = image.shape[0]
    row, plane = np.uintp(shape[2] + 2), np.uintp((shape[1] + 2) * (shape[2] + 2))
    for i in range(size):  # rows from the top
        py = ONE - np.float32(2 * i + 1) / np.float32(size)
        for j in range(size):
            px = np.float32(2 * j + 1) / np.float32(size) - ONE
            u_start, v_start, w_start, du, dv, dw, low, high = _ray(frame, focal, steps, shape, box, px, py)
            red = green = blue = mask = ZERO
            light = ONE  # transmittance: equation 3's product
            for k in range(low, high):  # near to far, inside the box only
                u = u_start + np.float32(k) * du
                v = v_start + np.float32(k) * dv
                w = w_start + np.float32(k) * dw
                u0, v0, w0 = int(u), int(v), int(w)  # truncation is floor: never negative
                p = np.uintp(w0) * plane + np.uintp(v0) * row + np.uintp(u0)  # the cell's lowest corner
                if not cells[p]:  # empty space: q is 0, light stays as it is
                    continue
                into = u - np.float32(u0), v - np.float32(v0), w - np.float32(w0)
                r, g, b, q = sampled(voxels, p, row, plane, into)  # q: occupancy between the corners
                stop = q * light  # equation 3
                red += stop * r  # equation 4
                green += stop * g
                blue += stop * b
                mask += stop
                light *= ONE - q  # what reaches step k + 1
                if light < OPAQUE:
                    break
            image[i, j, 0] = red
            image[i, j, 1] = green
            image[i, j, 2] = blue
            image[i, j, 3] = mask


def _backward(voxels, cells, boxes, shape, frames, focal, steps, grad, grad_voxels, grad_frames, grad_focal):
    """For `grad` (N, size, size, 4): adds to `grad_voxels` (B, P, 4), `grad_focal` (B,); fills `grad_frames` (N, 3, 3).

    Cells that `cells` (B, P) leaves out, and what is outside `boxes` (B, 6), get no gradient.
    """
    share = len(frames) // len(voxels)
    for b in prange(len(voxels)):  # one volume a thread, its views in turn: sums have one order
        for n in range(b * share, (b + 1) * share):
            grad_focal[b] += _draw_backward(
                voxels[b], cells[b], boxes[b], shape, frames[n], focal, steps, grad[n], grad_voxels[b], grad_frames[n]
            )


@njit(nogil=True, **FLAGS)
def _draw_backward(voxels, cells, box, shape, frame, focal, steps, grad, grad_voxels, grad_frame):
    size = grad.shape[0]
    row, plane = np.uintp(shape[2] + 2), np.uintp((shape[1] + 2) * (shape[2] + 2))
    hx, hy, hz = np.float32(shape[2]) * HALF, np.float32(shape[1]) * HALF, np.float32(shape[0]) * HALF
    visited = np.empty(steps, np.int64)  # steps of a ray that met something
    occupancy, lights, seen = np.empty(steps, np.float32), np.empty(steps, np.float32), np.empty(steps, np.float32)
    f00, f01 = frame[0, 0], frame[0, 1]
    f10, f11 = frame[1, 0], frame[1, 1]
    f20, f21 = frame[2, 0], frame[2, 1]
    a00 = a01 = a02 = a10 = a11 = a12 = a20 = a21 = a22 = total_focal = ZERO  # dL/dR and dL/df, in registers
    for i in range(size):
        py = ONE - np.float32(2 * i + 1) / np.float32(size)
        for j in range(size):
            g0, g1, g2, g3 = grad[i, j, 0], grad[i, j, 1], grad[i, j, 2], grad[i, j, 3]
            if g0 == 0 and g1 == 0 and g2 == 0 and g3 == 0:  # nothing to hand back
                continue
            px = np.float32(2 * j + 1) / np.float32(size) - ONE
            u_start, v_start, w_start, du, dv, dw, low, high = _ray(frame, focal, steps, shape, box, px, py)
            # What is behind an opaque voxel has a say in its gradient, so a ray goes on behind the first one: it ends
            # where hardly any light would pass even with the most opaque of its steps taken away.
            light = rest = least = ONE
            visits = 0
            for k in range(low, high):
                u = u_start + np.float32(k) * du
                v = v_start + np.float32(k) * dv
                w = w_start + np.float32(k) * dw
                u0, v0, w0 = int(u), int(v), int(w)
                p = np.uintp(w0) * plane + np.uintp(v0) * row + np.uintp(u0)
                if not cells[p]:
                    continue
                into = u - np.float32(u0), v - np.float32(v0), w - np.float32(w0)
                r, g, b, q = sampled(voxels, p, row, plane, into)
                s = g0 * r + g1 * g + g2 * b  # the loss's view of the colour
                visited[visits], occupancy[visits], seen[visits], lights[visits] = k, q, s + g3, light
                visits += 1
                light *= ONE - q  # light in front of step k + 1
                rest *= max(ONE - q, least)
                least = min(ONE - q, least)
                if rest < OPAQUE:
                    break
            # `beyond`: what the pixel's gradient makes of the light that passes step k; from the far end to the near.
            beyond = ZERO
            for visit in range(visits - 1, -1, -1):
                k, q = visited[visit], occupancy[visit]
                stop = q * lights[visit]  # equation 3
                d0, d1, d2 = stop * g0, stop * g1, stop * g2  # dL/d(r, g, b)
                d3 = lights[visit] * (seen[visit] - beyond)  # dL/dq: seen here against seen behind
                beyond = q * seen[visit] + (ONE - q) * beyond  # the same for step k - 1
                u = u_start + np.float32(k) * du
                v = v_start + np.float32(k) * dv
                w = w_start + np.float32(k) * dw
                u0, v0, w0 = int(u), int(v), int(w)
                into = u - np.float32(u0), v - np.float32(v0), w - np.float32(w0)
                p = np.uintp(w0) * plane + np.uintp(v0) * row + np.uintp(u0)
                change = d0, d1, d2, d3
                su, sv, sw = slopes(voxels, p, row, plane, into, change)  # d(values . change) / d(u, v, w)
                deposit(grad_voxels, p, row, plane, into, change)  # trilinear's transpose
                gx, gy, gz = su * hx, sv * hy, sw * hz  # dL/dp, world coordinates
                z = ONE - np.float32(2 * k + 1) / np.float32(steps)
                x, y = px * (ONE - focal * z), py * (ONE - focal * z)  # p(z), camera coordinates
                a00 += gx * x  # dL/dR: the sum of dL/dp p^T
                a01 += gx * y
                a02 += gx * z
                a10 += gy * x
                a11 += gy * y
                a12 += gy * z
                a20 += gz * x
                a21 += gz * y
                a22 += gz * z
                # The place is R (px (1 - f z), py (1 - f z), z); its derivative by f is -z R (px, py, 0).
                total_focal -= z * ((f00 * gx + f10 * gy + f20 * gz) * px + (f01 * gx + f11 * gy + f21 * gz) * py)
    grad_frame[0, 0], grad_frame[0, 1], grad_frame[0, 2] = a00, a01, a02
    grad_frame[1, 0], grad_frame[1, 1], grad_frame[1, 2] = a10, a11, a12
    grad_frame[2, 0], grad_frame[2, 1], grad_frame[2, 2] = a20, a21, a22
    return total_focal


@njit(inline="always", **FLAGS)
def _repeated(colour, run):
    """The four numbers of `colour` over and over, `run` in all."""
    added = np.empty(run, np.float32)  # as long as a row of logits: one loop adds all
    for t in range(run):
        added[t] = colour[t % 4]
    return added


@njit(inline="always", **FLAGS)
def _sigmoids(line, added, values):
    """Fills `values` from the logits `line` and what is added to them."""
    for t in range(len(values)):
        values[t] = sigmoid(widened(line[t]) + added[t])


def _squash(blocks, colour, prior, voxels):
    """Fills `voxels` (B, P, 4) from logits `blocks` (B, z, y, x, s, s, s, 4), `colour` (B, 4), `prior` (nz, ny, nx)."""
    side = blocks.shape[4]
    run = blocks.shape[3] * side**3 * 4  # numbers in a row of blocks
    row = blocks.shape[3] * side + 2  # of padded voxels
    plane = (blocks.shape[2] * side + 2) * row
    for b in prange(len(blocks)):
        voxels[b] = 0  # the frame with it
        added = _repeated(colour[b], run)
        values = np.empty(run, np.float32)
        for z, y in np.ndindex(blocks.shape[1], blocks.shape[2]):
            line = blocks[b, z, y].reshape(run)  # (run,)
            _sigmoids(line, added, values)  # without conditions: exponentials vectorise
            t = 0
            for x in range(blocks.shape[3]):
                for dz, dy in np.ndindex(side, side):  # the s^3 voxels of one place
                    w, v = z * side + dz, y * side + dy
                    for u in range(x * side, (x + 1) * side):
                        p = (w + 1) * plane + (v + 1) * row + u + 1
                        occupancy = 2 * values[t + 3] - ONE + prior[w, v, u]  # Q = Q' + S
                        voxels[b, p, 0] = values[t]
                        voxels[b, p, 1] = values[t + 1]
                        voxels[b, p, 2] = values[t + 2]
                        voxels[b, p, 3] = min(max(occupancy, ZERO), ONE)  # within [0, 1]
                        t += 4


def _squash_backward(blocks, colour, prior, grad_voxels, grad):
    """Fills `grad` (B, z, y, x, s, s, s, 4), the gradient of `blocks`; voxels outside [0, 1] are let back in."""
    side = blocks.shape[4]
    run = blocks.shape[3] * side**3 * 4
    row = blocks.shape[3] * side + 2
    plane = (blocks.shape[2] * side + 2) * row
    for b in prange(len(blocks)):
        added = _repeated(colour[b], run)
        values, change = np.empty(run, np.float32), np.empty(run, np.float32)
        for z, y in np.ndindex(blocks.shape[1], blocks.shape[2]):
            line, result = blocks[b, z, y].reshape(run), grad[b, z, y].reshape(run)  # (run,) each
            _sigmoids(line, added, values)
            t = 0
            for x in range(blocks.shape[3]):
                for dz, dy in np.ndindex(side, side):
                    w, v = z * side + dz, y * side + dy
                    for u in range(x * side, (x + 1) * side):
                        p = (w + 1) * plane + (v + 1) * row + u + 1
                        change[t] = grad_voxels[b, p, 0]
                        change[t + 1] = grad_voxels[b, p, 1]
                        change[t + 2] = grad_voxels[b, p, 2]
                        back = 2 * grad_voxels[b, p, 3]  # Q' = 2 sigmoid - 1
                        occupancy = 2 * values[t + 3] - ONE + prior[w, v, u]
                        # Only gradients that point back inside pass, as in viewnet.model.volume.
                        if (occupancy < 0 and back > 0) or (occupancy > 1 and back < 0):
                            back = ZERO
                        change[t + 3] = back
                        t += 4
            for t in range(run):  # vectorised again
                result[t] = narrowed(values[t] * (ONE - values[t]) * change[t], result[t])


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


forward, occupied, backward = compiled(_forward), compiled(_occupied), compiled(_backward)
squash, squash_backward, halve = compiled(_squash), compiled(_squash_backward), compiled(_halve)
