"""Bicycles: road, mountain, city, step-through, BMX, folding, cruisers and children's bicycles."""

import numpy as np

from viewnet.cad import palette
from viewnet.cad.builder import Builder
from viewnet.cad.cycles.parts import Point, blob, disc, fender, mix, spokes, tyre

KINDS = {"road": 22, "mountain": 24, "city": 18, "step": 12, "bmx": 9, "folding": 4, "cruiser": 6, "child": 5}


def bicycle(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A bicycle; the chain is on its right side."""
    builder = Builder()
    kind = palette.pick(rng, KINDS, kind)
    c = _materials(rng, builder, kind)
    u = rng.uniform
    small = kind in ("bmx", "folding", "child")
    radius = u(0.22, 0.27) if small else u(0.31, 0.36)
    thick = {"road": u(0.012, 0.018), "mountain": u(0.024, 0.034), "cruiser": u(0.026, 0.036)}.get(
        kind, u(0.016, 0.026)
    )
    base = u(0.86, 0.98) if small else u(0.98, 1.12)
    rear: Point = (-base * 0.44, 0.0, radius)
    front: Point = (rear[0] + base, 0.0, radius)
    bottom: Point = (rear[0] + u(0.40, 0.45) * base / 1.05, 0.0, radius * u(0.78, 0.95) if not small else radius * 1.1)
    frame = u(0.40, 0.56) if not small else u(0.24, 0.34)
    seat_top: Point = (bottom[0] - 0.30 * frame, 0.0, bottom[2] + frame)
    lean = u(0.28, 0.42)
    head_low: Point = (front[0] - lean * (radius + 0.12) - 0.03, 0.0, 2 * radius + u(0.03, 0.12))
    head_high: Point = (head_low[0] - lean * u(0.10, 0.18), 0.0, head_low[2] + u(0.12, 0.2))
    if kind != "step" and not small:
        high = head_high[2] - u(-0.02, 0.05)
        seat_top = (seat_top[0], 0.0, min(seat_top[2], high) if kind != "mountain" else high - u(0.05, 0.15))
    tube = u(0.014, 0.024) * (1.25 if kind == "mountain" else 1.0)

    stays = 0.05
    top_low = mix(bottom, seat_top, u(0.35, 0.55)) if kind == "step" else mix(bottom, seat_top, 0.94)
    if kind == "folding":
        top_low = mix(bottom, seat_top, 0.2)
    line = [(top_low, mix(head_low, head_high, 0.85)), (bottom, mix(head_low, head_high, 0.2))]
    if kind == "folding":
        line = [(top_low, mix(head_low, head_high, 0.5)), (rear, top_low)]
    for a, b in line:
        if kind in ("step", "cruiser"):
            sag = mix(a, b, 0.5)
            points = [a, mix(a, b, 0.2), (sag[0], 0.0, sag[2] - (0.05 if kind == "step" else -0.05)), mix(a, b, 0.8), b]
            builder.tube(points, tube, c["frame"], 6)
        else:
            builder.tube([a, b], tube, c["frame"], 6)
    builder.tube([bottom, seat_top], tube * 0.95, c["frame"], 6)
    builder.tube([mix(head_low, head_high, -0.1), head_high], tube * 1.15, c["frame"], 6)
    with builder.both_sides():
        for start in (bottom, mix(bottom, seat_top, 0.93)):
            builder.tube([start, (rear[0], stays, rear[2])], tube * 0.6, c["frame"], 5)
        crown = (head_low[0] + 0.01, 0.045, head_low[2] - 0.02)
        name = c["fork"]
        builder.tube(
            [(head_low[0], 0, head_low[2]), crown, (front[0], 0.045, front[2])],
            tube * (1.3 if kind == "mountain" else 0.7),
            name,
            6,
        )

    solid = rng.random() < 0.08
    many = int(rng.integers(9, 17))
    for hub in (rear, front):
        tyre(builder, hub[0], hub[2], radius, thick, c["tyre"], (18 if small else 20, 5))
        tyre(builder, hub[0], hub[2], radius - 1.7 * thick, 0.009, c["rim"], (18, 3))
        if solid:
            disc(builder, hub[0], 0.0, hub[2], radius - 1.8 * thick, 0.012, c["rim"], 16)
        else:
            spokes(builder, hub[0], hub[2], radius - 2 * thick, 0.03, c["spoke"], many, u(0.004, 0.007), u(0, 1))
        builder.cylinder((hub[0], -0.05, hub[2]), (hub[0], 0.05, hub[2]), 0.022, c["metal"], sections=6)
    _drive(rng, builder, c, bottom, rear, small)
    _saddle(rng, builder, c, kind, seat_top, bottom, small)
    _handlebar(rng, builder, c, kind, head_high, lean)
    fitted = {"city": 0.85, "step": 0.9, "cruiser": 0.7, "folding": 0.5, "child": 0.4}.get(kind, 0.06)
    if rng.random() < fitted:
        fender(builder, rear[0], rear[2], radius + 0.025, 0.055, (65, 190), c["fender"])
        fender(builder, front[0], front[2], radius + 0.025, 0.055, (50, 150), c["fender"])
    if rng.random() < fitted * 0.8:
        top = 2 * radius + 0.06
        builder.box((rear[0] - 0.02, 0, top), (0.34, 0.12, 0.015), c["metal"])
        with builder.both_sides():
            builder.tube([(rear[0] - 0.1, 0.06, top), (rear[0], 0.06, rear[2])], 0.006, c["metal"], 4)
            if rng.random() < 0.2:
                builder.box((rear[0] - 0.03, 0.11, top - 0.16), (0.3, 0.1, 0.28), c["bag"])
    if rng.random() < fitted * 0.5:
        builder.box((head_high[0] + 0.2, 0, head_high[2] + 0.03), (0.26, 0.34, 0.22), c["bag"], taper=(1.15, 1.15))
    if rng.random() < fitted:
        builder.ellipsoid((head_low[0] + 0.09, 0, head_low[2] + 0.06), (0.04, 0.04, 0.04), c["lamp"], (6, 4))
        builder.box((rear[0] - radius - 0.03, 0, 1.5 * radius), (0.025, 0.05, 0.05), c["tail"])
    if kind == "child" and rng.random() < 0.6:
        with builder.both_sides():
            disc(builder, rear[0], 0.14, radius * 0.42, radius * 0.4, 0.03, c["tyre"], 10)
            builder.tube([(rear[0], 0.05, rear[2]), (rear[0], 0.13, radius * 0.42)], 0.01, c["metal"], 4)
    return builder


def _materials(rng: np.random.Generator, builder: Builder, kind: str) -> dict[str, str]:
    draw = rng.random()
    frame = (
        palette.vivid(rng, 0.5, 0.35)
        if draw < 0.6
        else palette.gray(rng, 0.04, 0.15)
        if draw < 0.8
        else palette.gray(rng, 0.5, 0.95)
    )
    if rng.random() < 0.08:
        frame = palette.gray(rng, 0.3, 0.7)
    fork = frame if rng.random() < 0.6 else palette.gray(rng, 0.05, 0.8)
    rubber = palette.rubber(rng) if rng.random() < 0.93 else palette.jitter(rng, (0.6, 0.45, 0.3))
    saddle = palette.gray(rng, 0.04, 0.15) if rng.random() < 0.75 else palette.jitter(rng, (0.42, 0.26, 0.14))
    return {
        "frame": builder.material("frame", frame),
        "fork": builder.material("fork", fork),
        "tyre": builder.material("tyre", rubber),
        "rim": builder.material("rim", palette.metal(rng) if rng.random() < 0.6 else palette.gray(rng, 0.05, 0.2)),
        "spoke": builder.material(
            "spoke", palette.gray(rng, 0.3, 0.8) if rng.random() < 0.75 else palette.gray(rng, 0.05, 0.2)
        ),
        "metal": builder.material("metal", palette.metal(rng)),
        "dark": builder.material("dark", palette.gray(rng, 0.04, 0.14)),
        "saddle": builder.material("saddle", saddle),
        "grip": builder.material("grip", saddle),
        "fender": builder.material("fender", frame if rng.random() < 0.5 else palette.gray(rng, 0.05, 0.85)),
        "bag": builder.material(
            "bag", palette.jitter(rng, (0.5, 0.36, 0.2)) if rng.random() < 0.5 else palette.gray(rng, 0.1, 0.7)
        ),
        "lamp": builder.material("lamp", (0.93, 0.92, 0.82)),
        "tail": builder.material("tail", (0.75, 0.06, 0.06)),
    }


def _drive(
    rng: np.random.Generator, builder: Builder, c: dict[str, str], bottom: Point, rear: Point, small: bool
) -> None:
    """Chain, chain ring and sprocket on the right side; cranks with pedals."""
    ring, cog, y = rng.uniform(0.06, 0.1), rng.uniform(0.03, 0.05), -0.05
    disc(builder, bottom[0], y, bottom[2], ring, 0.008, c["metal"] if rng.random() < 0.6 else c["dark"])
    disc(builder, rear[0], y, rear[2], cog, 0.012, c["metal"], 8)
    if rng.random() < 0.2:
        a, b = bottom[0] + ring * 1.2, rear[0] - cog
        builder.box(((a + b) / 2, y, (bottom[2] + rear[2]) / 2), (a - b, 0.03, 2.1 * ring), c["fender"])
    else:
        for way in (1, -1):
            builder.tube(
                [(bottom[0], y, bottom[2] + way * ring), (rear[0], y, rear[2] + way * cog)], 0.006, c["dark"], 4
            )
    turn, crank = rng.uniform(0, 2 * np.pi), 0.12 if small else 0.17
    for side, way in ((1, 1), (-1, -1)):
        x, z = bottom[0] + way * crank * np.cos(turn), bottom[2] + way * crank * np.sin(turn)
        builder.tube([(bottom[0], side * 0.065, bottom[2]), (x, side * 0.075, z)], 0.01, c["metal"], 5)
        builder.box((x, side * 0.125, z), (0.09, 0.09, 0.022), c["dark"])


def _saddle(
    rng: np.random.Generator, builder: Builder, c: dict[str, str], kind: str, top: Point, bottom: Point, small: bool
) -> None:
    high = rng.uniform(0.04, 0.1) if kind == "bmx" else rng.uniform(0.1, 0.24)
    share = high / max(float(np.linalg.norm(np.subtract(top, bottom))), 0.1)
    seat = mix(bottom, top, 1 + share)
    builder.tube([top, seat], 0.013, c["metal"], 5)
    x, _, z = seat
    wide = rng.uniform(0.065, 0.08) if kind in ("road", "mountain", "bmx") else rng.uniform(0.085, 0.115)
    stations = [
        (x - 0.13, z + 0.035, wide, 0.03),
        (x - 0.08, z + 0.035, wide * 0.95, 0.032),
        (x + 0.02, z + 0.022, 0.035, 0.024),
    ]
    blob(builder, [*stations, (x + 0.13, z + 0.02, 0.018, 0.015)], c["saddle"], 6)


def _handlebar(
    rng: np.random.Generator, builder: Builder, c: dict[str, str], kind: str, head: Point, lean: float
) -> None:
    rise = rng.uniform(0.02, 0.09)
    stem: Point = (head[0] - lean * rise, 0.0, head[2] + rise)
    reach = rng.uniform(0.04, 0.11) if kind in ("road", "mountain") else rng.uniform(0.0, 0.05)
    clamp: Point = (stem[0] + reach, 0.0, stem[2] + 0.02)
    builder.tube([head, stem, clamp], 0.014, c["metal"], 5)
    x, _, z = clamp
    if kind == "road":
        half = rng.uniform(0.19, 0.23)
        points = [
            (x, 0, z),
            (x, half * 0.9, z),
            (x + 0.07, half, z),
            (x + 0.10, half, z - 0.04),
            (x + 0.07, half, z - 0.11),
            (x - 0.03, half, z - 0.13),
        ]
        grip, bar = 2, c["dark"]
    elif kind in ("bmx", "child"):
        half, up = rng.uniform(0.28, 0.36), rng.uniform(0.12, 0.22)
        points = [(x, 0, z), (x, 0.06, z), (x, 0.15, z + up), (x - 0.03, half, z + up * 1.05)]
        grip, bar = 2, c["frame"] if rng.random() < 0.4 else c["dark"]
        builder.tube([(x, 0.12, z + 0.6 * up), (x, -0.12, z + 0.6 * up)], 0.009, bar, 5)
    elif kind == "mountain":
        half = rng.uniform(0.28, 0.36)
        points = [(x, 0, z), (x - 0.02, half * 0.6, z + 0.02), (x - 0.05, half, z + 0.02)]
        grip, bar = 1, c["dark"]
    else:
        half = rng.uniform(0.24, 0.32)
        back = rng.uniform(0.1, 0.26)
        points = [
            (x, 0, z),
            (x + 0.03, half * 0.4, z + 0.04),
            (x - 0.02, half * 0.85, z + 0.07),
            (x - back, half, z + 0.05),
        ]
        grip, bar = 2, c["metal"]
    with builder.both_sides():
        builder.tube(points[: grip + 1], 0.012, bar, 5)
        builder.tube(points[grip:], 0.017, c["grip"], 5)
    if kind in ("city", "step", "cruiser") and rng.random() < 0.15:
        with builder.both_sides():
            builder.cylinder((x, 0.18, z + 0.06), (x - 0.02, 0.2, z + 0.2), 0.006, c["metal"], sections=4)
            builder.ellipsoid((x - 0.02, 0.2, z + 0.22), (0.01, 0.045, 0.035), c["metal"], (6, 4))
