"""Armchairs, parsons, wing and tub chairs. Units: metres."""

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.chair.frames import four_legs, pedestal_base, seat_grid, star_base
from viewnet.cad.finishes import Finishes
from viewnet.cad.parts import BackSurface, block, choose, patch, pillow, shell, sweep
from viewnet.cad.upholstery import SOFT, Body, add_arms, add_back, seat_cushions, soft_legs, tufts, upholstered


def armchair(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A club chair or easy chair: a sofa of one seat."""
    upholstered(builder, rng, fin, 1, float(rng.uniform(0.48, 0.64)))


def parsons(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A dining chair covered all over: stuffed seat and full back on four legs, sometimes with low stuffed arms."""
    cover = fin.upholstery()
    back = cover if rng.random() < 0.85 else fin.upholstery()
    wood = fin.wood(0.1)[0] if rng.random() < 0.75 else fin.metal()
    width, depth, top = float(rng.uniform(0.42, 0.56)), float(rng.uniform(0.42, 0.52)), float(rng.uniform(0.44, 0.5))
    thick = float(rng.uniform(0.06, 0.16))
    tall, lean = float(rng.uniform(0.4, 0.62)), float(rng.uniform(0.04, 0.15))
    x = depth / 2
    shell(builder, seat_grid(width, depth, top - thick / 2, 0.04, 0.08), pillow(5, 7, thick, 0.8), cover)
    half = width / 2 * float(rng.uniform(0.86, 1.0))
    surface = BackSurface(
        -x + 0.03,
        top - thick,
        tall + thick,
        half,
        half * float(rng.uniform(0.85, 1.05)),
        lean,
        dish=float(rng.choice([0.0, rng.uniform(0.01, 0.06)])),
    )
    flat = patch(6, 7, float(rng.uniform(0, 0.22)))
    t = (flat[..., 0] + 1) / 2
    crown = float(rng.choice([0.0, rng.uniform(-0.05, 0.08)]))
    stuffed = pillow(6, 7, float(rng.uniform(0.05, 0.09)), 0.65)
    if rng.random() < 0.25:
        stuffed = stuffed * (1 - 0.3 * (np.arange(6) % 2))[:, None]
    shell(builder, surface.at(flat[..., 1], t + crown * t * (1 - flat[..., 1] ** 2))[::-1], stuffed[::-1], cover, back)
    style = choose(rng, {"square": 0.35, "tapered": 0.4, "round": 0.25})
    base = rng.random()
    if base < 0.86:
        four_legs(
            builder,
            rng,
            style,
            width,
            depth,
            top - thick * 0.8,
            float(rng.uniform(0.016, 0.024)),
            wood,
            float(rng.choice([0.0, rng.uniform(0.02, 0.06)])),
        )
    elif base < 0.93:
        pedestal_base(builder, top - thick * 0.8, 0.22, fin.metal())
    else:
        star_base(builder, rng, top - thick * 0.8, 0.28, fin.metal(), fin.dark(), 4, False)
    if rng.random() < 0.28:
        high = top + float(rng.uniform(0.15, 0.22))
        y = width / 2 + 0.01
        start = surface.at(1.0, (high - top + thick) / (tall + thick))
        path = [[start[0], y, (high + top) / 2], [x * float(rng.uniform(0.3, 0.9)), y, (high + top) / 2 - 0.02]]
        tall_arm = (high - top + thick) / 2
        sweep(builder, path, np.array([[0.03, tall_arm], [0.028, tall_arm * 0.9]]), cover, SOFT, mirror=True)


def wingback(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A high-backed easy chair with wings beside the head."""
    cover = fin.upholstery()
    body = Body(
        inner=float(rng.uniform(0.5, 0.6)),
        depth=float(rng.uniform(0.68, 0.84)),
        arm=float(rng.uniform(0.07, 0.13)),
        seat=float(rng.uniform(0.4, 0.47)),
        arm_top=0.0,
        back=float(rng.uniform(0.98, 1.18)),
        clear=float(rng.uniform(0.1, 0.22)),
        back_thick=float(rng.uniform(0.09, 0.15)),
        lean=float(rng.uniform(0.08, 0.2)),
    )
    arm_top = body.seat + float(rng.uniform(0.14, 0.22))
    body = Body(**{**body.__dict__, "arm_top": arm_top})
    block(
        builder,
        (0, 0, (body.clear + body.seat - 0.08) / 2),
        (body.depth - 0.02, body.inner + 0.01, body.seat - 0.08 - body.clear),
        cover,
    )
    add_arms(builder, rng, body, choose(rng, {"rolled": 0.4, "round": 0.3, "sloped": 0.3}), cover, cover)
    add_back(
        builder, rng, body, choose(rng, {"round": 0.3, "camel": 0.4, "straight": 0.3}), cover, body.inner + body.arm
    )
    seat_cushions(builder, body, 1, 0.13, cover if rng.random() < 0.7 else fin.upholstery(), 0.01)
    # Wings: boards at the sides of the back, deepest at head height.
    t = np.linspace(0, 1, 5)[:, None]
    reach = float(rng.uniform(0.14, 0.26)) * np.array([0.75, 1.0, 1.0, 0.9, 0.35])[:, None]
    s = np.linspace(0, 1, 3)[None, :]
    z = arm_top - 0.06 + (body.back - 0.02 - arm_top + 0.06) * t + 0 * s
    share = (z - body.clear) / (body.back - body.clear)
    x = -body.depth / 2 + body.back_thick * 0.4 - body.lean * share**1.2 + (reach + body.back_thick * 0.4) * s
    y = body.inner / 2 + body.arm * 0.35 + float(rng.uniform(0.0, 0.05)) * s + 0 * t
    shell(builder, np.stack([x, y, z], axis=-1), pillow(5, 3, float(rng.uniform(0.05, 0.08)), 0.7), cover, mirror=True)
    if rng.random() < 0.35:
        tufts(builder, body, 4, 4, cover, body.inner)
    soft_legs(
        builder,
        rng,
        fin,
        body.inner / 2 + body.arm * 0.8,
        body.depth / 2,
        body.clear,
        choose(rng, {"taper": 0.6, "block": 0.2, "metal": 0.2}),
    )


def tub(
    builder: Builder, rng: np.random.Generator, fin: Finishes, width: float | None = None, deep: float = 1.0
) -> None:
    """A chair (or, with a larger `width`, a sofa) whose back runs round into the arms in one curve."""
    cover = fin.upholstery()
    wide = width or float(rng.uniform(0.62, 0.82))
    depth = float(rng.uniform(0.6, 0.78)) * deep
    seat_top = float(rng.uniform(0.38, 0.46))
    clear = float(rng.choice([0.02, rng.uniform(0.05, 0.12), rng.uniform(0.15, 0.24)]))
    high = seat_top + float(rng.uniform(0.24, 0.46))
    arm_high = seat_top + (high - seat_top) * float(rng.choice([1.0, rng.uniform(0.35, 0.85)]))
    thick = float(rng.uniform(0.06, 0.15))
    count = 15
    angle = np.linspace(-0.5, 0.5, count) * np.pi
    # A half of a superellipse: arms run forwards from the curve.
    power = float(rng.uniform(0.45, 1.0))
    ring_y = np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** power * (wide - thick) / 2
    ring_x = -(np.cos(angle) ** power) * (depth - thick) + depth / 2
    flare = float(rng.uniform(0, 0.1))
    drop = np.abs(np.sin(angle)) ** float(rng.uniform(1.5, 5))
    tops = high + (arm_high - high) * drop
    t = np.linspace(0, 1, 4)[:, None]
    x = ring_x - t * flare * np.cos(angle)
    y = ring_y + t * flare * np.sin(angle) * 0.6
    z = clear + (tops - clear) * t
    full = np.full((4, count), thick)
    full[-1] *= 0.55
    inside = cover if rng.random() < 0.8 else fin.upholstery()
    grid = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    shell(builder, grid, full, inside, cover)
    if rng.random() < 0.3:
        sweep(builder, grid[-1], thick * 0.55, cover, "coarse", side=(0, 0, 1))
    cushion_thick = float(rng.uniform(0.1, 0.17))
    flat = patch(6, 7, 0.0)
    s = (flat[..., 0] + 1) / 2
    half = np.interp(s, [0, 0.3, 1], [0.66, 0.9, 1.0]) * (wide - 1.7 * thick) / 2
    back_x, front_x = -depth / 2 + thick * 0.8, depth / 2 - 0.01
    seat_z = seat_top - cushion_thick / 2
    pad = np.stack([back_x + (front_x - back_x) * s, flat[..., 1] * half, np.full_like(s, seat_z)], axis=-1)
    shell(builder, pad, pillow(6, 7, cushion_thick, 0.65), inside)
    under = pad * (1, 1, 0) + np.array([0, 0, (clear + seat_top - cushion_thick) / 2])
    shell(builder, under, max(seat_top - cushion_thick - clear, 0.02) + 0.04, cover)
    if clear > 0.1 and width is None and rng.random() < 0.2:
        star_base(builder, rng, clear + 0.02, 0.27, fin.metal(), fin.dark(), 4, False)
    elif clear > 0.03:
        # Well inside: the corners are round.
        soft_legs(builder, rng, fin, wide * (0.3 if width is None else 0.37), depth * 0.3, clear)
    else:
        block(builder, (0.02, 0, 0.01), (depth * 0.8, wide * 0.8, 0.02), fin.dark())
