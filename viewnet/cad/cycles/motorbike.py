"""Motorbikes: sport bikes, naked bikes, cruisers and choppers, tourers, off-road bikes, scooters."""

import numpy as np

from viewnet.cad import palette
from viewnet.cad.builder import Builder
from viewnet.cad.cycles.parts import Point, blob, disc, fender, mix, spokes, tyre
from viewnet.cad.cycles.scooter import scooter_body

KINDS = {"sport": 27, "naked": 16, "cruiser": 20, "tourer": 8, "dirt": 13, "scooter": 16}


def motorbike(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A motorbike or scooter; the exhaust is on its right side, or on both."""
    builder = Builder()
    kind = palette.pick(rng, KINDS, kind)
    c = _materials(rng, builder, kind)
    u = rng.uniform
    base = {
        "sport": u(1.36, 1.46),
        "naked": u(1.38, 1.5),
        "cruiser": u(1.55, 1.9),
        "tourer": u(1.5, 1.65),
        "dirt": u(1.40, 1.52),
        "scooter": u(1.2, 1.38),
    }[kind]
    big = {"scooter": u(0.21, 0.27), "dirt": u(0.33, 0.36), "cruiser": u(0.31, 0.36)}.get(kind, u(0.30, 0.32))
    small = big * {"dirt": 0.92, "cruiser": u(0.88, 1.0), "scooter": u(0.95, 1.0)}.get(kind, u(0.98, 1.03))
    rear: Point = (-base * 0.48, 0.0, small)
    front: Point = (rear[0] + base, 0.0, big)
    lean = {"cruiser": u(0.5, 0.8), "scooter": u(0.4, 0.5), "dirt": u(0.42, 0.52)}.get(kind, u(0.38, 0.48))
    height = {"scooter": u(0.85, 0.98), "dirt": u(0.98, 1.1), "cruiser": u(0.85, 0.98)}.get(kind, u(0.86, 0.96))
    head: Point = (front[0] - lean * (height - big), 0.0, height)
    _wheels(rng, builder, c, kind, rear, front, small, big)
    _fork(rng, builder, c, kind, front, head)
    if kind == "scooter":
        scooter_body(rng, builder, c, rear, front, head, small, big)
    else:
        _machine(rng, builder, c, kind, rear, front, head, small, big)
    _bars(rng, builder, c, kind, head)
    if rng.random() < 0.85:
        tail_x = rear[0] - small * u(0.5, 0.95)
        builder.box((tail_x, 0, small * 1.9), (0.03, 0.17, 0.13), c["plate"])
        builder.box((tail_x + 0.03, 0, small * 1.9 + 0.12), (0.08, 0.15, 0.07), c["tail"])
    return builder


def _materials(rng: np.random.Generator, builder: Builder, kind: str) -> dict[str, str]:
    draw = rng.random()
    base = (
        palette.vivid(rng, 0.6, 0.35)
        if draw < 0.62
        else palette.gray(rng, 0.04, 0.14)
        if draw < 0.82
        else palette.gray(rng, 0.55, 0.95)
    )
    second = (
        palette.gray(rng, 0.85, 0.95)
        if rng.random() < 0.4
        else palette.gray(rng, 0.05, 0.2)
        if rng.random() < 0.6
        else palette.vivid(rng, 0.5, 0.3)
    )
    chrome = kind == "cruiser" or rng.random() < 0.3
    return {
        "paint": builder.material("paint", base),
        "second": builder.material("second", second),
        "frame": builder.material(
            "frame", palette.gray(rng, 0.05, 0.3) if rng.random() < 0.7 else palette.vivid(rng, 0.5, 0.3)
        ),
        "tyre": builder.material("tyre", palette.rubber(rng)),
        "rim": builder.material("rim", palette.metal(rng) if rng.random() < 0.55 else palette.gray(rng, 0.06, 0.25)),
        "metal": builder.material("metal", palette.metal(rng) if chrome else palette.gray(rng, 0.35, 0.6)),
        "engine": builder.material(
            "engine", palette.gray(rng, 0.25, 0.6) if rng.random() < 0.7 else palette.gray(rng, 0.08, 0.2)
        ),
        "dark": builder.material("dark", palette.gray(rng, 0.04, 0.13)),
        "seat": builder.material(
            "seat", palette.gray(rng, 0.04, 0.13) if rng.random() < 0.8 else palette.jitter(rng, (0.4, 0.24, 0.14))
        ),
        "glass": builder.material(
            "glass",
            palette.jitter(rng, (0.2, 0.24, 0.28)) if rng.random() < 0.6 else palette.jitter(rng, (0.6, 0.7, 0.76)),
        ),
        "lamp": builder.material("lamp", palette.jitter(rng, (0.93, 0.93, 0.85), 0.02)),
        "tail": builder.material("tail", (0.76, 0.05, 0.05)),
        "amber": builder.material("amber", (0.93, 0.52, 0.1)),
        "plate": builder.material("plate", (0.88, 0.88, 0.85)),
    }


def _wheels(
    rng: np.random.Generator,
    builder: Builder,
    c: dict[str, str],
    kind: str,
    rear: Point,
    front: Point,
    small: float,
    big: float,
) -> None:
    wire = kind == "dirt" or (kind == "cruiser" and rng.random() < 0.6)
    fat = {"dirt": 0.05, "scooter": 0.045, "cruiser": rng.uniform(0.06, 0.085)}.get(kind, 0.06)
    count = int(rng.choice([3, 5, 6]))
    for hub, radius, width in ((rear, small, 1.35), (front, big, 1.0)):
        if kind in ("cruiser", "scooter", "dirt"):
            width = 1.1
        tyre(builder, hub[0], hub[2], radius, fat, c["tyre"], (18, 6), width)
        tyre(builder, hub[0], hub[2], radius - 1.5 * fat, 0.022, c["rim"], (16, 4), 1.6)
        if kind == "cruiser" and rng.random() < 0.2:
            disc(builder, hub[0], 0, hub[2], radius - 1.6 * fat, 0.05, c["rim"], 14)
        elif wire:
            spokes(builder, hub[0], hub[2], radius - 1.6 * fat, 0.05, c["metal"], 14, 0.008)
        else:
            spokes(builder, hub[0], hub[2], radius - 1.6 * fat, 0.03, c["rim"], count, 0.05)
            spokes(builder, hub[0], hub[2], radius - 1.6 * fat, -0.03, c["rim"], count, 0.05)
        builder.cylinder((hub[0], -0.08, hub[2]), (hub[0], 0.08, hub[2]), 0.045, c["engine"], sections=8)
        if rng.random() < 0.75:
            with builder.both_sides():
                disc(builder, hub[0], 0.065, hub[2], radius * 0.48, 0.008, c["metal"], 12)


def _fork(rng: np.random.Generator, builder: Builder, c: dict[str, str], kind: str, front: Point, head: Point) -> None:
    half = 0.09
    top = mix(front, head, 1.06)
    with builder.both_sides():
        middle = mix(front, head, 0.45)
        builder.tube(
            [(front[0], half, front[2]), (middle[0], half, middle[2])],
            0.03,
            c["engine"] if kind != "cruiser" else c["metal"],
            6,
        )
        builder.tube([(middle[0], half, middle[2]), (top[0], half, top[2])], 0.022, c["metal"], 6)
    builder.box((top[0], 0, top[2]), (0.07, 0.24, 0.04), c["dark"])


def _bars(rng: np.random.Generator, builder: Builder, c: dict[str, str], kind: str, head: Point) -> None:
    x, _, z = head
    half, rise, back = {
        "sport": (0.32, 0.0, 0.1),
        "cruiser": (0.40, rng.uniform(0.08, 0.4), rng.uniform(0.15, 0.32)),
        "dirt": (0.40, 0.12, 0.12),
        "scooter": (0.33, 0.1, 0.1),
    }.get(kind, (0.36, rng.uniform(0.06, 0.16), 0.14))
    points = [
        (x, 0.0, z + 0.05),
        (x - 0.02, half * 0.4, z + 0.05 + rise),
        (x - 0.05, half * 0.65, z + 0.06 + rise),
        (x - back, half, z + 0.04 + rise),
    ]
    with builder.both_sides():
        builder.tube(points[:3], 0.016, c["metal"] if kind != "sport" else c["dark"], 5)
        builder.tube(points[2:], 0.024, c["dark"], 6)
    if rng.random() < 0.8 and kind != "dirt":
        out, up = rng.uniform(0.3, 0.42), rng.uniform(0.1, 0.24)
        ahead = 0.12 if kind in ("sport", "tourer") else 0.0
        with builder.both_sides():
            builder.tube([(x + ahead, half * 0.6, z + rise), (x + ahead, out, z + rise + up)], 0.01, c["dark"], 4)
            builder.box(
                (x + ahead, out + 0.03, z + rise + up + 0.02),
                (0.03, 0.14, 0.08),
                c["dark"] if rng.random() < 0.6 else c["metal"],
            )
    if kind != "dirt" and rng.random() < 0.6:
        with builder.both_sides():
            builder.box((x + 0.06, 0.2, z - 0.12), (0.05, 0.09, 0.05), c["amber"])


def _machine(
    rng: np.random.Generator,
    builder: Builder,
    c: dict[str, str],
    kind: str,
    rear: Point,
    front: Point,
    head: Point,
    small: float,
    big: float,
) -> None:
    """Frame, engine, tank, seat, exhaust and clothing of everything but scooters."""
    u = rng.uniform
    low = {"dirt": 0.36, "cruiser": 0.2}.get(kind, 0.24)
    seat_z = {"cruiser": u(0.64, 0.72), "dirt": u(0.88, 0.96), "sport": u(0.78, 0.84)}.get(kind, u(0.74, 0.82))
    belly = ((rear[0] + front[0]) / 2 + 0.02, 0.0, low + 0.2)
    tank_x = head[0] - u(0.22, 0.32)
    tank_z = max(seat_z + u(0.06, 0.16), head[2] - 0.12) if kind != "cruiser" else seat_z + u(0.1, 0.18)
    pivot: Point = (belly[0] - 0.22, 0.0, small + 0.06)
    neck: Point = (head[0] - 0.02, 0.0, head[2] - 0.12)
    with builder.both_sides():
        builder.tube(
            [
                (neck[0], 0.05, neck[2]),
                (tank_x, 0.11, tank_z - 0.16),
                (pivot[0], 0.12, seat_z - 0.1),
                (pivot[0], 0.12, pivot[2]),
            ],
            0.025,
            c["frame"],
            5,
        )
        builder.tube(
            [(neck[0], 0.05, neck[2]), (belly[0] + 0.2, 0.1, low + 0.12), (pivot[0], 0.11, low + 0.1)],
            0.022,
            c["frame"],
            5,
        )
        builder.tube(
            [pivot, (pivot[0], 0.1, pivot[2]), (rear[0], 0.1, rear[2])],
            0.032,
            c["frame"] if rng.random() < 0.5 else c["metal"],
            5,
        )
        builder.tube(
            [(rear[0] + 0.05, 0.12, rear[2] + 0.05), (rear[0] + 0.2, 0.11, seat_z - 0.05)], 0.03, c["metal"], 5
        )
    twin = kind == "cruiser" or rng.random() < 0.25
    builder.box(belly, (0.42, 0.30, 0.26), c["engine"], taper=(0.9, 0.9))
    for tilt in (0.35, -0.35) if twin else (0.2,):
        start = (belly[0] + 0.1 * np.sign(tilt), 0.0, belly[2] + 0.08)
        end = (start[0] + 0.3 * np.sin(tilt), 0.0, start[2] + 0.3 * np.cos(tilt) * (0.9 if twin else 0.8))
        builder.cylinder(start, end, 0.11, c["metal"] if rng.random() < 0.5 else c["engine"], sections=8)
    with builder.both_sides():
        disc(builder, belly[0] - 0.08, 0.17, belly[2] - 0.02, 0.1, 0.05, c["metal"], 10)

    long = u(0.42, 0.56)
    half = u(0.12, 0.17) if kind != "dirt" else 0.11
    tank = [
        (tank_x + 0.5 * long, tank_z - 0.03, half * 0.55, 0.05),
        (tank_x + 0.3 * long, tank_z, half, 0.10),
        (tank_x - 0.1 * long, tank_z, half * 0.95, 0.10),
    ]
    tank.append((tank_x - 0.5 * long, tank_z - 0.09, half * 0.6, 0.05))
    stripe = rng.random() < 0.3
    blob(builder, tank, [c["paint"], c["second"] if stripe else c["paint"], c["paint"]])
    tail = {"sport": u(0.12, 0.24), "dirt": u(0.05, 0.12)}.get(kind, u(0.0, 0.08))
    seat_front, seat_rear = tank_x - 0.42 * long, rear[0] - u(-0.12, 0.12)
    if kind == "cruiser":
        seat_rear = rear[0] + u(-0.1, 0.12)
    middle = (seat_front + seat_rear) / 2
    wide = u(0.11, 0.15) if kind != "cruiser" else u(0.15, 0.2)
    seat = [
        (seat_front, seat_z + 0.02, 0.08, 0.05),
        (middle + 0.05, seat_z - 0.01, wide, 0.055),
        (middle - 0.05, seat_z + 0.04 + 0.4 * tail, wide * 0.9, 0.06),
    ]
    blob(builder, [*seat, (seat_rear, seat_z + 0.05 + tail, wide * 0.6, 0.035)], c["seat"], 8)
    if kind in ("sport", "naked", "tourer", "dirt"):
        body = [(middle + 0.1, seat_z - 0.1, 0.11, 0.06), (middle - 0.15, seat_z - 0.03 + 0.5 * tail, 0.12, 0.07)]
        blob(
            builder,
            [*body, (seat_rear - 0.12, seat_z + 0.01 + tail, 0.05, 0.025)],
            c["paint"] if rng.random() < 0.75 else c["second"],
        )
    else:
        with builder.both_sides():
            builder.box((middle + 0.05, 0.14, seat_z - 0.2), (0.26, 0.05, 0.16), c["paint"], taper=(0.8, 1))

    if kind == "dirt":
        fender(builder, front[0] - 0.05, front[2] + 0.12, big + 0.09, 0.16, (30, 125), c["paint"])
        builder.box((head[0] + 0.07, 0, head[2] - 0.02), (0.04, 0.2, 0.24), c["second"])
        with builder.both_sides():
            builder.box((tank_x + 0.12, half + 0.03, tank_z - 0.15), (0.34, 0.03, 0.24), c["paint"], taper=(0.7, 1))
    else:
        fender(
            builder,
            front[0],
            front[2],
            big + 0.03,
            0.15,
            (25, 165) if kind == "cruiser" else (40, 130),
            c["paint"] if rng.random() < 0.8 else c["dark"],
        )
        reach = (10, 150) if kind == "cruiser" else (60, 160)
        fender(
            builder,
            rear[0],
            rear[2],
            small + 0.04,
            0.2,
            (reach[0] + 30, reach[1] + 20),
            c["paint"] if kind == "cruiser" else c["dark"],
        )
    _clothing(rng, builder, c, kind, head, front, belly, low)
    _exhaust(rng, builder, c, kind, belly, rear, low, seat_z)
    if kind in ("tourer", "cruiser") and rng.random() < (0.75 if kind == "tourer" else 0.25):
        bag = c["paint"] if rng.random() < 0.6 else c["dark"]
        with builder.both_sides():
            builder.box((rear[0] - 0.05, 0.27, small + 0.28), (0.5, 0.2, 0.34), bag, taper=(0.9, 0.8))
        if rng.random() < 0.5:
            builder.box((rear[0] - 0.22, 0, seat_z + 0.24), (0.36, 0.42, 0.3), bag, taper=(0.85, 0.9))


def _clothing(
    rng: np.random.Generator,
    builder: Builder,
    c: dict[str, str],
    kind: str,
    head: Point,
    front: Point,
    belly: Point,
    low: float,
) -> None:
    """Fairing with lamps and screen, or a round head lamp."""
    x, _, z = head
    if kind in ("sport", "tourer"):
        nose = front[0] + rng.uniform(-0.08, 0.06)
        wide = rng.uniform(0.17, 0.22) if kind == "sport" else rng.uniform(0.22, 0.3)
        tall = 0.17 if kind == "sport" else 0.22
        stations = [
            (nose, z - 0.14, 0.05, 0.06),
            (nose - 0.09, z - 0.10, wide * 0.75, tall * 0.75),
            (x + 0.02, z - 0.10, wide, tall),
        ]
        blob(builder, [*stations, (x - 0.15, z - 0.16, wide * 0.95, 0.12)], [c["lamp"], c["paint"], c["paint"]])
        up = rng.uniform(0.1, 0.2) if kind == "sport" else rng.uniform(0.25, 0.4)
        glass = [
            (nose - 0.1, 0, z + 0.02),
            (x - 0.02, wide * 0.8, z + 0.05),
            (x - 0.1, wide * 0.55, z + 0.05 + up),
            (x - 0.1, 0, z + 0.1 + up),
        ]
        with builder.both_sides():
            builder.quad(glass, c["glass"])
            side = [
                (x + 0.12, z - 0.12),
                (x - 0.32, z - 0.22),
                (belly[0] - 0.25, low + 0.22),
                (belly[0] - 0.15, low - 0.02),
                (belly[0] + 0.32, low + 0.06),
            ]
            builder.extrude(side, "y", wide * 0.85, wide * 0.85 + 0.03, c["paint"])
            patch = [
                (x - 0.02, z - 0.24),
                (x - 0.22, z - 0.3),
                (belly[0] - 0.1, low + 0.12),
                (belly[0] + 0.12, low + 0.1),
            ]
            builder.extrude(patch, "y", wide * 0.85 + 0.03, wide * 0.85 + 0.036, c["second"])
        return
    if kind == "dirt":
        builder.box((x + 0.095, 0, z - 0.06), (0.03, 0.12, 0.09), c["lamp"])
        return
    size = rng.uniform(0.085, 0.11)
    lamp = (x + 0.16, 0.0, z - 0.08)
    builder.cylinder(
        (lamp[0] - 0.13, 0, lamp[2]), lamp, size * 0.5, c["metal"] if rng.random() < 0.5 else c["paint"], size, 10
    )
    builder.cylinder(lamp, (lamp[0] + 0.02, 0, lamp[2]), size, c["lamp"], size * 0.8, 10)
    if rng.random() < 0.25:
        half, up = 0.22, rng.uniform(0.25, 0.45)
        builder.quad(
            [(x + 0.14, -half, z), (x + 0.14, half, z), (x, half * 0.8, z + up), (x, -half * 0.8, z + up)], c["glass"]
        )


def _exhaust(
    rng: np.random.Generator,
    builder: Builder,
    c: dict[str, str],
    kind: str,
    belly: Point,
    rear: Point,
    low: float,
    seat_z: float,
) -> None:
    high = kind == "dirt" or (kind in ("sport", "naked") and rng.random() < 0.4)
    both = kind in ("cruiser", "tourer", "sport") and rng.random() < 0.35
    end = (rear[0] - rng.uniform(0.0, 0.25), -0.2, seat_z - 0.08 if high else rear[2] + rng.uniform(-0.02, 0.12))
    pipe = [
        (belly[0] + 0.22, -0.08, belly[2] + 0.15),
        (belly[0] + 0.25, -0.13, low + 0.05),
        (belly[0] - 0.1, -0.17, low + 0.05),
    ]
    start = (rear[0] + 0.3, -0.2, seat_z - 0.28 if high else rear[2] - 0.04)
    for side in (-1, 1) if both else (-1,):
        flip = np.array([1.0, -side, 1.0])
        builder.tube(np.array([*pipe, start]) * flip, 0.026, c["metal"], 5)
        builder.tube(
            np.array([start, mix(start, end, 0.15), end]) * flip,
            [0.03, 0.062, 0.058],
            c["metal"] if rng.random() < 0.7 else c["dark"],
            8,
        )
