"""Cars that are not one closed body: lorries and ambulances with a box, veterans with fenders, single-seater racers."""

import numpy as np

from viewnet.cad import palette
from viewnet.cad.builder import Builder
from viewnet.cad.car.parts import Finish, wheel
from viewnet.cad.car.shell import Shape
from viewnet.cad.cycles.parts import blob


def cargo_box(rng: np.random.Generator, builder: Builder, shape: Shape, finish: Finish, service: str) -> None:
    """A box (of an ambulance, a removal van or a camper) or a flat bed behind the cab of a pickup's body."""
    s = shape
    front = s.length / 2
    start, end = front - s.back - 0.02, -s.length / 2 - 0.06
    floor = s.clearance + 0.32
    if service != "ambulance" and rng.random() < 0.2:
        builder.box(((start + end) / 2, 0, s.deck_z), (start - end, s.width * 1.04, 0.12), finish.dark)
        for x in np.linspace(start - 0.5, end + 0.6, int(rng.integers(1, 4))):
            high = rng.uniform(0.4, 0.9)
            builder.box(
                (float(x), 0, s.deck_z + high / 2), (0.7, s.width * 0.8, high), finish.second, taper=(0.95, 0.95)
            )
        return
    wide, top = s.width * rng.uniform(1.02, 1.14), s.height * rng.uniform(1.0, 1.45)
    skin = finish.paint if rng.random() < 0.6 else builder.material("box", palette.gray(rng, 0.75, 0.96))
    middle, long = (start + end) / 2, start - end
    builder.box((middle, 0, (floor + top) / 2), (long, wide, top - floor), skin)
    if rng.random() < 0.3:
        builder.box(
            (start + 0.45, 0, (s.height + top) / 2 + 0.05), (1.0, wide, max(top - s.height, 0.12)), skin, taper=(0.8, 1)
        )
    if service == "ambulance" or rng.random() < 0.4:
        low = floor + rng.uniform(0.2, 0.45) * (top - floor)
        builder.box((middle, 0, low), (long + 0.02, wide + 0.02, rng.uniform(0.12, 0.35)), finish.second)
    glass_z = floor + 0.68 * (top - floor)
    with builder.both_sides():
        if rng.random() < 0.6:
            builder.box((middle + rng.uniform(-0.2, 0.3) * long, wide / 2, glass_z), (0.7, 0.04, 0.4), finish.glass)
        builder.box((end, wide * 0.2, glass_z), (0.04, 0.3 * wide, 0.45), finish.glass)
        builder.box((end, wide * 0.44, floor + 0.25), (0.05, 0.12, 0.24), finish.tail)
    if service == "ambulance":
        red = builder.material("beacon", (0.85, 0.08, 0.08))
        with builder.both_sides():
            builder.box((start - 0.05, wide * 0.35, top + 0.05), (0.2, 0.35, 0.12), red)
            cross = builder.material("cross", (0.1, 0.2, 0.7))
            x, z = middle - 0.1 * long, floor + 0.72 * (top - floor)
            for size in ((0.6, 0.02, 0.18), (0.18, 0.02, 0.6)):
                builder.box((x, wide / 2 + 0.01, z), size, cross)


def veteran(rng: np.random.Generator, builder: Builder, finish: Finish) -> None:
    """A car of the twenties or thirties: upright grille, long bonnet, free fenders, running boards, spoked wheels."""
    u = rng.uniform
    length, width = u(3.4, 4.6), u(1.45, 1.7)
    radius, front = u(0.34, 0.42), length / 2
    axle_front, axle_rear = front - u(0.45, 0.75), -front + u(0.55, 0.8)
    floor, hood, belt = 0.42, u(0.95, 1.12), u(1.02, 1.18)
    cowl = front - u(0.36, 0.44) * length
    narrow, wide = width * u(0.22, 0.28), width * u(0.34, 0.40)
    rings = []
    for x, half, top in (
        (front - 0.28, narrow * 0.8, hood - 0.03),
        (cowl, narrow * 1.25, hood + 0.04),
        (cowl - 0.25, wide, belt),
        (-front + 0.5, wide * 0.96, belt),
    ):
        rings.append(
            [
                (x, half, floor),
                (x, half, top - 0.15),
                (x, 0.6 * half, top),
                (x, -0.6 * half, top),
                (x, -half, top - 0.15),
                (x, -half, floor),
            ]
        )
    tail = [(x - 0.35, 0.8 * y, floor + 0.1 + (z - floor) * 0.7) for x, y, z in rings[-1]]
    builder.loft([*rings, tail], [finish.second if rng.random() < 0.3 else finish.paint, *[finish.paint] * 3])
    builder.box(
        (front - 0.25, 0, (floor + hood) / 2), (0.1, narrow * 1.35, hood - floor - 0.05), finish.chrome, taper=(1, 0.9)
    )
    builder.box(
        (front - 0.19, 0, (floor + hood) / 2), (0.03, narrow * 1.1, hood - floor - 0.16), finish.dark, taper=(1, 0.9)
    )
    fender = finish.paint if rng.random() < 0.4 else finish.dark if rng.random() < 0.5 else finish.second
    reach = radius * 1.28
    half = width / 2
    with builder.both_sides():
        for axle in (axle_front, axle_rear):
            wheel(
                builder,
                (axle, half - 0.1, radius),
                radius,
                0.15,
                finish.tyre,
                finish.rim,
                finish.dark,
                int(rng.choice([0, 6, 7])),
                0.72,
            )
        path = [(axle_front + reach * np.cos(a), radius + reach * np.sin(a)) for a in np.deg2rad([5, 45, 90, 130])]
        path += [(axle_front - 1.35 * reach, floor + 0.05), (axle_rear + 1.15 * reach, floor + 0.05)]
        path += [(axle_rear + reach * np.cos(a), radius + reach * np.sin(a)) for a in np.deg2rad([40, 90, 140, 178])]
        strip = [
            [(x, half, z), (x, half - 0.3, z), (x, half - 0.3, z + 0.05), (x, half - 0.06, z + 0.06)] for x, z in path
        ]
        builder.loft(strip, fender)
        lamp = (front - 0.2, narrow * 1.25, hood - 0.12)
        builder.ellipsoid(lamp, (0.1, 0.12, 0.12), finish.chrome, (8, 6))
        builder.cylinder(
            (lamp[0] + 0.06, lamp[1], lamp[2]), (lamp[0] + 0.11, lamp[1], lamp[2]), 0.1, finish.lamp, sections=8
        )
        builder.box((-front + 0.2, half - 0.25, radius + 0.35), (0.08, 0.1, 0.1), finish.tail)
    for x in (front - 0.04, -front + 0.12):
        builder.box((x, 0, 0.48), (0.07, width * 0.94, 0.09), finish.chrome)
    roof = u(1.55, 1.75)
    rear = -front + u(0.35, 0.7)
    if rng.random() < 0.6:
        base = [(cowl - 0.25, wide * 0.95), (rear, wide * 0.95)]
        low = [(base[0][0], y, belt - 0.05) for y in (wide * 0.95, -wide * 0.95)] + [
            (rear, -wide * 0.95, belt - 0.05),
            (rear, wide * 0.95, belt - 0.05),
        ]
        high = [(x - 0.08 if x > 0 else x + 0.06, 0.92 * y, roof - 0.14) for x, y, _ in low]
        lid = [(0.92 * x, 0.75 * y, roof) for x, y, _ in high]
        builder.loft([low, high, lid], [finish.glass, finish.dark if rng.random() < 0.4 else finish.paint])
        for x in (base[0][0] - 0.05, (base[0][0] + rear) / 2, rear + 0.04):
            with builder.both_sides():
                builder.box((x, wide * 0.93, (belt + roof) / 2 - 0.09), (0.1, 0.08, roof - belt - 0.08), finish.paint)
    else:
        builder.box((cowl - 0.26, 0, belt + 0.2), (0.04, wide * 1.7, 0.42), finish.glass)
        builder.box((cowl - 1.1, 0, belt + 0.06), (0.2, wide * 1.6, 0.3), finish.seat)
        builder.box(
            ((cowl - 0.3 + rear) / 2 + 0.1, 0, belt + 0.005), ((cowl - 0.3 - rear) * 0.7, wide * 1.5, 0.02), finish.seat
        )
        builder.box((rear + 0.25, 0, belt + 0.12), (0.4, wide * 1.8, 0.26), finish.dark, taper=(0.8, 0.95))
    if rng.random() < 0.5:
        builder.cylinder((-front + 0.12, 0, 0.85), (-front - 0.03, 0, 0.85), radius * 0.95, finish.tyre, sections=14)
        builder.cylinder((-front - 0.03, 0, 0.85), (-front - 0.04, 0, 0.85), radius * 0.6, finish.rim, sections=12)


def single_seater(rng: np.random.Generator, builder: Builder, finish: Finish) -> None:
    """An open-wheel racing car with wings, or one of the fifties without."""
    u = rng.uniform
    length = u(4.2, 5.2)
    front, width = length / 2, u(1.7, 2.0)
    old = rng.random() < 0.3
    radius = 0.33
    axles = front - u(0.75, 1.0), -front + u(0.55, 0.75)
    nose = 0.3 if old else u(0.14, 0.3)
    stations = [
        (front - 0.05, nose, 0.10 if not old else 0.2, 0.07 if not old else 0.2),
        (axles[0], nose + 0.1, 0.18 if not old else 0.34, 0.13 if not old else 0.28),
        (0.45, 0.42, 0.30 if not old else 0.4, 0.22 if not old else 0.32),
        (-0.1, 0.44, 0.42, 0.26 if not old else 0.34),
        (-0.8, 0.48, 0.38, 0.32 if not old else 0.36),
        (axles[1], 0.42, 0.2, 0.2 if not old else 0.28),
        (-front + 0.15, 0.4, 0.1, 0.1),
    ]
    blob(builder, stations, [finish.second if rng.random() < 0.5 else finish.paint, *[finish.paint] * 5], 10)
    builder.ellipsoid((0.05, 0, 0.66), (0.42, 0.25, 0.1), finish.dark, (10, 4))
    helmet = builder.material("helmet", palette.vivid(rng))
    builder.ellipsoid((-0.05, 0, 0.76), (0.14, 0.12, 0.14), helmet, (8, 6))
    if not old:
        with builder.both_sides():
            builder.box((-0.35, 0.55, 0.32), (1.5, 0.38, 0.38), finish.paint, taper=(0.8, 0.8))
            builder.box((0.4, 0.55, 0.34), (0.04, 0.3, 0.24), finish.dark)
        builder.box((-0.55, 0, 0.86), (0.5, 0.22, 0.3), finish.paint, taper=(0.5, 0.8))
        builder.box((front - 0.1, 0, 0.14), (0.38, width * 0.92, 0.04), finish.second)
        top = u(0.8, 0.98)
        builder.box((-front + 0.14, 0, top), (0.36, width * 0.52, 0.05), finish.second)
        builder.box((-front + 0.14, 0, top - 0.25), (0.25, width * 0.5, 0.04), finish.second)
        with builder.both_sides():
            builder.box((front - 0.1, width * 0.46, 0.2), (0.4, 0.03, 0.18), finish.paint)
            builder.box((-front + 0.14, width * 0.26, top - 0.18), (0.48, 0.03, 0.46), finish.paint)
    wide = 0.2 if old else 0.34
    with builder.both_sides():
        for axle in axles:
            wheel(
                builder,
                (axle, width / 2 - wide / 2, radius),
                radius,
                wide,
                finish.tyre,
                finish.rim,
                finish.dark,
                5,
                0.6,
            )
            for ahead in (0.2, -0.2):
                builder.tube([(axle + ahead, 0.15, 0.42), (axle, width / 2 - wide, 0.36)], 0.02, finish.dark, 4)
    builder.box((-front + 0.03, 0, 0.32), (0.04, 0.1, 0.12), finish.tail)
    builder.box((front - 0.28 if old else 0.62, 0, 0.36), (0.05, 0.18, 0.1), finish.lamp if old else finish.dark)
