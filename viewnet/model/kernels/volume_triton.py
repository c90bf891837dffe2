"""Triton kernels of viewnet.model.kernels.volume_gpu, float32.

`voxels` is (B, P, 4) with P = (nz + 2) (ny + 2) (nx + 2): red, green, blue and occupancy side by side, so that a corner
is one load of 16 bytes, and a voxel of zeros all around, so that no corner lies outside. `cells` (B, P) says which
cells, named by their lowest corner, have any occupancy. A program draws a tile of RAYS pixels of one image; CHUNK
steps at a time it asks `cells` first, and leaves out the chunk where none of its rays meets anything.
"""

import triton
import triton.language as tl

# u, v, w, k, q, light and stop as in viewnet.model.kernels.volume_numba; all but k for the RAYS of a tile at once.
OPAQUE = tl.constexpr(1e-5)  # a ray that so little light passes has stopped, as in viewnet.model.kernels.volume_numba
TILE = tl.constexpr(8)  # pixels in a row of a tile: the rays of a warp, 8 x 4, stay close together in the volume
DARK = tl.constexpr(0.02)  # what a step lets through is not divided by if less; behind four of them a ray is OPAQUE
MARGIN = tl.constexpr(0.01)  # of a step: what rounding may shift the ends of a ray by


@triton.jit
def pack(volume, voxels, cells, along_b, along_c, along_z, along_y, along_x, nz, ny, nx, BLOCK: tl.constexpr):
    """Fills `voxels` and `cells` from a volume (B, 4, nz, ny, nx) of any strides."""
    # b: 64 bits, as a batch of large volumes may have more than 2^31 numbers.
    b, p = tl.program_id(1).to(tl.int64), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    row, plane = nx + 2, (ny + 2) * (nx + 2)  # padded: to the next voxel along y and z
    x, y, z = p % row - 1, p // row % (ny + 2) - 1, p // plane - 1  # -1 and n are the frame's
    source = volume + b * along_b + z.to(tl.int64) * along_z + y.to(tl.int64) * along_y + x.to(tl.int64) * along_x
    inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny) & (z >= 0) & (z < nz)  # all else stays 0
    red = tl.load(source, mask=inside, other=0.0)
    green = tl.load(source + along_c, mask=inside, other=0.0)
    blue = tl.load(source + 2 * along_c, mask=inside, other=0.0)
    occupancy = tl.load(source + 3 * along_c, mask=inside, other=0.0)
    values = tl.reshape(tl.join(tl.join(red, blue), tl.join(green, occupancy)), (BLOCK, 4))  # (BLOCK, 4): r, g, b, q
    total = (nz + 2) * plane
    to = voxels + b * total * 4 + p[:, None] * 4 + tl.arange(0, 4)[None, :]  # (BLOCK, 4)
    tl.store(to, values, mask=(p < total)[:, None])
    held = occupancy != 0  # the lowest corner; the other seven follow
    for corner in tl.static_range(1, 8):
        dx, dy, dz = corner % 2, corner // 2 % 2, corner // 4  # u first, w last
        there = (x + dx >= 0) & (x + dx < nx) & (y + dy >= 0) & (y + dy < ny) & (z + dz >= 0) & (z + dz < nz)
        at = source + 3 * along_c + dz * along_z + dy * along_y + dx * along_x
        held |= tl.load(at, mask=there, other=0.0) != 0
    tl.store(cells + b * total + p, held.to(tl.uint8), mask=p < total)


@triton.jit
def _tile(size, RAYS: tl.constexpr):
    """Of this program: its image, and its pixels' rows, columns and places (x, y)."""
    # Tiles of one image follow each other: its volume stays in the cache.
    across, down = tl.cdiv(size, TILE), tl.cdiv(size, RAYS // TILE)
    n, tile, lane = tl.program_id(0) // (across * down), tl.program_id(0) % (across * down), tl.arange(0, RAYS)
    i, j = tile // across * (RAYS // TILE) + lane // TILE, tile % across * TILE + lane % TILE
    return n, i, j, (2 * j + 1).to(tl.float32) / size - 1, 1 - (2 * i + 1).to(tl.float32) / size


@triton.jit
def _clip(low, high, start, step, limit):
    """Narrows the interval [low, high] of steps k to 0 <= start + k step <= limit."""
    moves = tl.abs(step) > 1e-9  # else parallel to both planes: `_look` decides
    step = tl.where(moves, step, 1.0)
    a, b = -start / step, (limit - start) / step  # where it crosses them, in steps
    low = tl.where(moves, tl.maximum(low, tl.minimum(a, b)), low)
    return low, tl.where(moves, tl.minimum(high, tl.maximum(a, b)), high)


@triton.jit
def _ray(frame, focal, steps, shape, px, py, drawn):
    """Position (u, v, w) in padded voxels at step 0, its change a step, and between which steps it may be inside.

    The interval is empty where `drawn` is false. It errs on the side of length: `_look` checks each step.
    """
    nz, ny, nx = shape
    z0, dz = 1 - 1.0 / steps, -2.0 / steps  # depth of step 0, its change a step
    s0, ds = 1 - focal * z0, -focal * dz  # perspective 1 - f z, linear in k as well
    hx, hy, hz = nx * 0.5, ny * 0.5, nz * 0.5  # half sides: [-1, 1] to voxels
    a = tl.load(frame) * px + tl.load(frame + 1) * py  # R (px, py, 0), by row
    b = tl.load(frame + 3) * px + tl.load(frame + 4) * py
    c = tl.load(frame + 6) * px + tl.load(frame + 7) * py
    back_x, back_y, back_z = tl.load(frame + 2), tl.load(frame + 5), tl.load(frame + 8)
    u, du = (a * s0 + back_x * z0 + 1) * hx + 0.5, (a * ds + back_x * dz) * hx  # as in volume_numba
    v, dv = (b * s0 + back_y * z0 + 1) * hy + 0.5, (b * ds + back_y * dz) * hy
    w, dw = (c * s0 + back_z * z0 + 1) * hz + 0.5, (c * ds + back_z * dz) * hz
    low, high = tl.zeros_like(px), tl.zeros_like(px) + (steps - 1)
    low, high = _clip(low, high, u, du, nx + 1.0)
    low, high = _clip(low, high, v, dv, ny + 1.0)
    low, high = _clip(low, high, w, dw, nz + 1.0)
    first = tl.minimum(tl.ceil(low - MARGIN), steps * 1.0).to(tl.int32)  # a step more rather than one lost
    end = tl.maximum(tl.floor(high + MARGIN) + 1, 0.0).to(tl.int32)
    return (u, v, w, du, dv, dw), tl.maximum(first, 0), tl.where(drawn, tl.minimum(end, steps), 0)


@triton.jit
def _place(ray, shape, k):
    """The cell that step k lies in, and how far into it along each axis."""
    u, v, w, du, dv, dw = ray
    u, v, w = u + k * du, v + k * dv, w + k * dw
    u0, v0, w0 = u.to(tl.int32), v.to(tl.int32), w.to(tl.int32)  # truncation is floor: 0 or more where it counts
    return (w0 * (shape[1] + 2) + v0) * (shape[2] + 2) + u0, (u - u0, v - v0, w - w0)


@triton.jit
def _look(ray, shape, first, low, high, cells, EVERY: tl.constexpr, STRIDE: tl.constexpr, CHUNK: tl.constexpr):
    """Which of the CHUNK steps from `first` count, a mask each, and whether there is any.

    A step in [low, high) counts inside the volume and, unless EVERY cell is wanted, in a cell with occupancy.
    """
    u0, v0, w0, du, dv, dw = ray
    met, some = (), tl.zeros_like(first)
    for c in tl.static_range(CHUNK):
        k = first + c * STRIDE
        u, v, w = u0 + k * du, v0 + k * dv, w0 + k * dw
        counts = (k >= low) & (k < high) & (u >= 0) & (v >= 0) & (w >= 0)
        counts &= (u < shape[2] + 1) & (v < shape[1] + 1) & (w < shape[0] + 1)  # the far corners are in the frame
        if not EVERY:
            at, _ = _place(ray, shape, k)
            counts = tl.load(cells + at, mask=counts, other=0) != 0  # a byte instead of eight corners
        met = met + (counts,)
        some |= counts.to(tl.int32)
    return met, tl.max(some, axis=0) > 0  # one branch for all rays


@triton.jit
def _weights(into):
    """Of a cell's corners, in the order of their voxels: along u first, along w last."""
    fu, fv, fw = into
    gu, gv, gw = 1 - fu, 1 - fv, 1 - fw
    a, b, c, d = gw * gv, gw * fv, fw * gv, fw * fv  # weights along w and v
    return a * gu, a * fu, b * gu, b * fu, c * gu, c * fu, d * gu, d * fu


@triton.jit
def _values(shape, corner: tl.constexpr):
    """How many numbers a corner's voxel lies behind the cell's lowest."""
    return (((corner // 4) * (shape[1] + 2) + corner // 2 % 2) * (shape[2] + 2) + corner % 2) * 4


@triton.jit
def _four(base, at):
    """Pointers (R, 4) to the values of voxels `at` (R,)."""
    return base + at[:, None] * 4 + tl.arange(0, 4)[None, :]  # (R, 4)


@triton.jit
def _last(values):
    """The occupancies (R,) in values (R, 4)."""
    return tl.sum(tl.where(tl.arange(0, 4)[None, :] == 3, values, 0.0), axis=1)  # (R,); registers have no index


@triton.jit
def draw(voxels, cells, frames, focal, image, share, nz, ny, nx, size, steps, RAYS: tl.constexpr, CHUNK: tl.constexpr):
    """Fills `image` (N, size, size, 4)."""
    n, i, j, px, py = _tile(size, RAYS)
    shape, drawn = (nz, ny, nx), (i < size) & (j < size)
    start = (n // share).to(tl.int64) * ((nz + 2) * (ny + 2) * (nx + 2))
    voxels, cells = voxels + start * 4, cells + start
    ray, low, high = _ray(frames + n * 9, tl.load(focal), steps, shape, px, py, drawn)
    k = low
    total, light = tl.zeros((RAYS, 4), tl.float32), tl.full((RAYS,), 1.0, tl.float32)  # RGB and mask; transmittance
    while tl.max(tl.where(light >= OPAQUE, high - k, 0), axis=0) > 0:  # while any ray goes on
        met, some = _look(ray, shape, k, low, tl.where(light >= OPAQUE, high, 0), cells, False, 1, CHUNK)
        if some:  # else no corner is loaded
            for c in tl.static_range(CHUNK):
                at, into = _place(ray, shape, k + c)
                corners, weights, value = _four(voxels, at), _weights(into), tl.zeros((RAYS, 4), tl.float32)
                for corner in tl.static_range(8):
                    there = tl.load(corners + _values(shape, corner), mask=met[c][:, None], other=0.0)  # (R, 4)
                    value += weights[corner][:, None] * there  # (R, 4)
                q = tl.where(light >= OPAQUE, _last(value), 0.0)  # 0 for rays that have stopped
                shown = tl.where(tl.arange(0, 4)[None, :] == 3, 1.0, value)  # a mask's colour is 1
                total += (q * light)[:, None] * shown  # equations 3 and 4
                light *= 1 - q  # what reaches the next step
        k += CHUNK
    to = image + n.to(tl.int64) * size * size * 4
    tl.store(_four(to, i * size + j), total, mask=drawn[:, None])


@triton.jit
def _trilinear(corners, into):
    """Between the values of eight corners: the value, and its derivatives along u, v and w."""
    fu, fv, fw = into
    c0, c1, c2, c3, c4, c5, c6, c7 = corners
    u00, u01, u10, u11 = c1 - c0, c3 - c2, c5 - c4, c7 - c6  # the four edges along u
    a00, a01, a10, a11 = c0 + fu * u00, c2 + fu * u01, c4 + fu * u10, c6 + fu * u11
    v0, v1, u0, u1 = a01 - a00, a11 - a10, u00 + fv * (u01 - u00), u10 + fv * (u11 - u10)  # along v; d/du on the faces
    b0, b1 = a00 + fv * v0, a10 + fv * v1
    return b0 + fw * (b1 - b0), u0 + fw * (u1 - u0), v0 + fw * (v1 - v0), b1 - b0  # value and slopes


@triton.jit
def draw_backward(
    voxels, cells, frames, focal, grad, grad_voxels, partial, share, nz, ny, nx, size, steps, tiles,
    SPARSE: tl.constexpr, RAYS: tl.constexpr, CHUNK: tl.constexpr,
):  # fmt: skip
    """For `grad` (N, size, size, 4): adds to `grad_voxels` (B, P, 4) and fills `partial` (N, tiles, 10).

    The ten are what a tile adds to the gradients of the image's frame, row by row, and of the focal parameter. With
    SPARSE, cells without occupancy get no gradient.

    The gradient of a step's occupancy is T (seen there - seen behind it), T the light that reaches it. The first walk,
    from near to far, finds the light that is left; the second, from far to near, sums up what is seen behind and has T
    by dividing by what each step lets through. Where that is next to nothing the first walk has kept T. What is behind
    an opaque voxel has a say in its gradient, so a ray goes on behind the first one: it ends where hardly any light
    would pass even with the most opaque of its steps taken away.
    """
    n, i, j, px, py = _tile(size, RAYS)
    shape, drawn = (nz, ny, nx), (i < size) & (j < size)
    start = (n // share).to(tl.int64) * ((nz + 2) * (ny + 2) * (nx + 2))
    voxels, cells, grad_voxels = voxels + start * 4, cells + start, grad_voxels + start * 4
    channel = tl.arange(0, 4)[None, :]  # (1, 4)
    g = tl.load(_four(grad + n.to(tl.int64) * size * size * 4, i * size + j), mask=drawn[:, None], other=0.0)  # (R, 4)
    frame, f = frames + n * 9, tl.load(focal)
    ray, low, high = _ray(frame, f, steps, shape, px, py, drawn & (tl.max((g != 0).to(tl.int32), axis=1) > 0))

    zero = tl.zeros((RAYS,), tl.float32)
    light, rest, least = zero + 1, zero + 1, zero + 1  # as in volume_numba
    dark0, dark1, dark2, dark3 = low - 1, low - 1, low - 1, low - 1  # no step yet
    light0, light1, light2, light3 = light, light, light, light  # T in front of each
    k = low
    while tl.max(high - k, axis=0) > 0:
        met, some = _look(ray, shape, k, low, high, cells, False, 1, CHUNK)
        if some:
            for c in tl.static_range(CHUNK):
                at, into = _place(ray, shape, k + c)
                corners, weights, q = voxels + at * 4 + 3, _weights(into), tl.zeros((RAYS,), tl.float32)
                for corner in tl.static_range(8):
                    q += weights[corner] * tl.load(corners + _values(shape, corner), mask=met[c], other=0.0)
                passing = tl.where(k + c < high, 1 - q, 1.0)  # beyond its end a ray loses nothing
                dark = passing < DARK
                # Push the step onto a stack of four, the newest on top: behind four of them a ray is OPAQUE.
                dark3, light3 = tl.where(dark, dark2, dark3), tl.where(dark, light2, light3)
                dark2, light2 = tl.where(dark, dark1, dark2), tl.where(dark, light1, light2)
                dark1, light1 = tl.where(dark, dark0, dark1), tl.where(dark, light0, light1)
                dark0, light0 = tl.where(dark, k + c, dark0), tl.where(dark, light, light0)
                light *= passing
                rest *= tl.maximum(passing, least)  # without the darkest step
                least = tl.minimum(passing, least)
                high = tl.where(rest < OPAQUE, tl.minimum(high, k + c + 1), high)  # ends here
        k += CHUNK

    mask_grad = tl.sum(tl.where(channel == 3, g, 0.0), axis=1)  # dL/dmask
    # Sums of the gradient by u, v and w times (1 - f z), and times z: all that frame and focal need.
    behind, scaled_u, scaled_v, scaled_w, deep_u, deep_v, deep_w = zero, zero, zero, zero, zero, zero, zero
    k = high - 1
    while tl.max(k - low, axis=0) >= 0:  # from far to near
        met, some = _look(ray, shape, k, low, high, cells, not SPARSE, -1, CHUNK)
        if some:
            for c in tl.static_range(CHUNK):
                at, into = _place(ray, shape, k - c)
                corners, occupancies, colours = _four(voxels, at), (), ()
                for corner in tl.static_range(8):
                    value = tl.load(corners + _values(shape, corner), mask=met[c][:, None], other=0.0)  # (R, 4)
                    occupancies = occupancies + (_last(value),)
                    colours = colours + (tl.sum(tl.where(channel == 3, 0.0, value * g), axis=1),)
                q, q_u, q_v, q_w = _trilinear(occupancies, into)  # Q and its slopes
                s, s_u, s_v, s_w = _trilinear(colours, into)  # dL/dcolour times colour
                dark = k - c == dark0  # top of the stack: T is known
                light = tl.where(dark, light0, light / tl.where(dark, 1.0, 1 - q))
                dark0, light0 = tl.where(dark, dark1, dark0), tl.where(dark, light1, light0)
                dark1, light1 = tl.where(dark, dark2, dark1), tl.where(dark, light2, light1)
                dark2, light2 = tl.where(dark, dark3, dark2), tl.where(dark, light3, light2)
                stop, change = q * light, light * (s + mask_grad - behind)  # dL/d(r, g, b) / g; dL/dq
                behind += q * (s + mask_grad - behind)  # seen behind step k - 1
                z = 1 - (2 * (k - c) + 1).to(tl.float32) / steps
                scale = 1 - f * z  # p = (x scale, y scale, z)
                move = stop * s_u + change * q_u  # dL/du through colours and Q
                scaled_u, deep_u = scaled_u + move * scale, deep_u + move * z
                move = stop * s_v + change * q_v
                scaled_v, deep_v = scaled_v + move * scale, deep_v + move * z
                move = stop * s_w + change * q_w
                scaled_w, deep_w = scaled_w + move * scale, deep_w + move * z
                delta = tl.where(channel == 3, change[:, None], stop[:, None] * g)  # (R, 4), dL/d(r, g, b, q)
                corners, weights, taken = _four(grad_voxels, at), _weights(into), (met[c] & (light >= OPAQUE))[:, None]
                for corner in tl.static_range(8):
                    to = corners + _values(shape, corner)  # shared with other rays: added atomically
                    tl.atomic_add(to, weights[corner][:, None] * delta, mask=taken, sem="relaxed")  # (R, 4)
        k -= CHUNK

    scaled = (scaled_u * (nx * 0.5), scaled_v * (ny * 0.5), scaled_w * (nz * 0.5))  # dL/dp in world coordinates
    deep = (deep_u * (nx * 0.5), deep_v * (ny * 0.5), deep_w * (nz * 0.5))
    tile = tl.program_id(0) % (tl.cdiv(size, TILE) * tl.cdiv(size, RAYS // TILE))
    to, turned = partial + (n.to(tl.int64) * tiles + tile) * 10, zero  # one writer each: no atomics
    for axis in tl.static_range(3):  # dL/dR = sum of dL/dp p^T; dp/df = -z R (px, py, 0)
        tl.store(to + 3 * axis, tl.sum(px * scaled[axis], axis=0))  # right
        tl.store(to + 3 * axis + 1, tl.sum(py * scaled[axis], axis=0))  # up
        tl.store(to + 3 * axis + 2, tl.sum(deep[axis], axis=0))  # back
        turned += deep[axis] * (tl.load(frame + 3 * axis) * px + tl.load(frame + 3 * axis + 1) * py)
    tl.store(to + 9, -tl.sum(turned, axis=0))
