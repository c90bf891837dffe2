"""Steam locomotives with or without a tender."""

import numpy as np

from viewnet.cad import palette
from viewnet.cad.builder import Builder


def steam(rng: np.random.Generator, builder: Builder) -> None:
    """A steam locomotive: boiler with chimney and domes, cab, spoked driving wheels with rods, tender or side tanks."""
    draw = rng.random()
    coat = palette.gray(rng, 0.04, 0.16) if draw < 0.5 else palette.vivid(rng, 0.5, 0.25)
    paint = builder.material("paint", coat)
    second = builder.material("second", palette.gray(rng, 0.05, 0.2) if draw >= 0.5 else palette.vivid(rng, 0.6, 0.35))
    black = builder.material("black", palette.gray(rng, 0.03, 0.1))
    red = builder.material(
        "wheel", palette.jitter(rng, (0.7, 0.08, 0.06)) if rng.random() < 0.5 else palette.gray(rng, 0.1, 0.45)
    )
    brass = builder.material(
        "brass", palette.jitter(rng, (0.82, 0.66, 0.25)) if rng.random() < 0.6 else palette.metal(rng)
    )
    lamp = builder.material("lamp", (0.95, 0.93, 0.8))
    glass = builder.material("glass", palette.gray(rng, 0.1, 0.3))
    toy = rng.random() < 0.3
    length = rng.uniform(6.0, 8.5) if toy else rng.uniform(9.0, 13.0)
    half, floor = 1.4, 1.25
    radius = rng.uniform(0.72, 0.95)
    axis = floor + radius + rng.uniform(0.15, 0.45)
    front, rear = length / 2, -length / 2
    cab = rng.uniform(1.6, 2.4)
    smokebox = front - rng.uniform(0.5, 1.2)

    boiler = paint if rng.random() < 0.7 else black
    builder.cylinder((rear + cab, 0, axis), (smokebox - 1.2, 0, axis), radius, boiler, sections=14)
    builder.cylinder((smokebox - 1.2, 0, axis), (smokebox, 0, axis), radius * 1.04, black, sections=14)
    builder.cylinder(
        (smokebox, 0, axis), (smokebox + 0.14, 0, axis), radius * 0.8, second if toy else black, radius * 0.6, 12
    )
    for x in np.linspace(rear + cab + 0.5, smokebox - 1.3, int(rng.integers(2, 5))):
        builder.cylinder((float(x), 0, axis), (float(x) + 0.1, 0, axis), radius * 1.025, brass, sections=14)
    top = axis + radius
    tall = rng.uniform(0.6, 1.3)
    flare = rng.uniform(1.0, 2.0)
    chimney = smokebox - 0.6
    builder.cylinder((chimney, 0, top - 0.1), (chimney, 0, top + tall), 0.24, black, 0.24 * flare, 10)
    builder.cylinder((chimney, 0, top + tall), (chimney, 0, top + tall + 0.08), 0.26 * flare, brass, sections=10)
    for share in ((0.55,), (0.35, 0.65))[int(rng.random() < 0.5)]:
        x = rear + cab + share * (smokebox - rear - cab)
        builder.cylinder((x, 0, top - 0.1), (x, 0, top + 0.4), 0.32, brass if rng.random() < 0.5 else paint, 0.22, 8)

    builder.box((0, 0, floor), (length, 2 * half * 0.95, 0.14), second)
    roof = top + rng.uniform(0.3, 0.8)
    wall = floor + 0.5 * (roof - floor)
    builder.box((rear + cab / 2, 0, (floor + wall) / 2), (cab, 2 * half, wall - floor), paint)
    for x in (rear + 0.08, rear + cab - 0.08):
        with builder.both_sides():
            builder.box((x, half - 0.1, (wall + roof) / 2), (0.16, 0.2, roof - wall), paint)
    builder.box((rear + cab - 0.1, 0, (wall + roof) / 2), (0.12, 1.9 * half, roof - wall), paint)
    with builder.both_sides():
        builder.box((rear + cab - 0.02, half * 0.62, (wall + roof) / 2 + 0.1), (0.06, 0.5, 0.45 * (roof - wall)), glass)
    arc = [
        (-half * 1.08, roof),
        (half * 1.08, roof),
        (half * 0.8, roof + 0.22),
        (0, roof + 0.32),
        (-half * 0.8, roof + 0.22),
    ]
    builder.extrude(arc, "x", rear - 0.25, rear + cab + 0.25, second if rng.random() < 0.4 else black)
    if rng.random() < 0.45:
        long = 0.6 * (smokebox - rear - cab)
        with builder.both_sides():
            builder.box((rear + cab + long / 2, half * 0.8, floor + 0.55), (long, 0.5, 1.0), paint)

    driving = rng.uniform(0.55, 0.9)
    count = int(rng.integers(2, 5))
    first, last = smokebox - 1.4, rear + 0.7
    count = max(2, min(count, int((first - last) / (2.1 * driving)) + 1))
    spots = [float(x) for x in np.linspace(first - 0.3, last + 0.5, count)]
    with builder.both_sides():
        for x in spots:
            builder.cylinder((x, half * 0.62, driving), (x, half * 0.76, driving), driving, red, sections=14)
            builder.cylinder((x, half * 0.76, driving), (x, half * 0.78, driving), driving * 0.78, black, sections=12)
            builder.cylinder((x, half * 0.76, driving), (x, half * 0.82, driving), driving * 0.2, red, sections=6)
            for turn in (0.0, 1.05, 2.1):
                dx, dz = 0.76 * driving * np.cos(turn), 0.76 * driving * np.sin(turn)
                builder.tube([(x - dx, half * 0.79, driving - dz), (x + dx, half * 0.79, driving + dz)], 0.05, red, 4)
        builder.box(
            ((spots[0] + spots[-1]) / 2, half * 0.86, driving - 0.2), (spots[0] - spots[-1] + 0.3, 0.08, 0.12), brass
        )
        builder.cylinder(
            (first + 0.4, half * 0.78, floor - 0.35), (first + 1.5, half * 0.78, floor - 0.35), 0.34, black, sections=8
        )
        for x in (front - 0.5, front - 1.5)[: int(rng.integers(1, 3))]:
            builder.cylinder((x, half * 0.6, 0.42), (x, half * 0.74, 0.42), 0.42, red, sections=10)
        builder.cylinder((front, half * 0.6, floor - 0.1), (front + 0.4, half * 0.6, floor - 0.1), 0.14, black, 0.22, 6)
        if rng.random() < 0.6:
            builder.cylinder(
                (front - 0.2, half * 0.55, floor + 0.3),
                (front + 0.05, half * 0.55, floor + 0.3),
                0.15,
                lamp,
                sections=8,
            )
    builder.box((front, 0, floor - 0.12), (0.14, 2 * half * 0.95, 0.36), red if rng.random() < 0.6 else black)
    if rng.random() < 0.4:
        outline = [(-half, 0.9), (half, 0.9), (half * 0.9, 0.25), (-half * 0.9, 0.25)]
        ring = [(front, y, z) for y, z in outline]
        builder.loft([ring, [(front + 0.7, 0.2 * y, 0.15 + 0.3 * z) for y, z in outline]], black)
    if rng.random() < 0.6:
        builder.cylinder((smokebox + 0.1, 0, top - 0.1), (smokebox + 0.4, 0, top - 0.1), 0.2, lamp, sections=8)
    if not toy and rng.random() < 0.55:
        _tender(rng, builder, rear, half, floor, paint, black, red)


def _tender(
    rng: np.random.Generator,
    builder: Builder,
    rear: float,
    half: float,
    floor: float,
    paint: str,
    coal: str,
    wheel: str,
) -> None:
    long, tall = rng.uniform(4.5, 7.0), rng.uniform(1.3, 1.9)
    middle = rear - 0.4 - long / 2
    builder.box((middle, 0, floor + tall / 2), (long, 1.9 * half, tall), paint)
    builder.ellipsoid((middle + 0.1 * long, 0, floor + tall), (0.36 * long, 0.8 * half, 0.45), coal, (8, 4))
    for x in np.linspace(middle - 0.36 * long, middle + 0.36 * long, int(rng.integers(3, 5))):
        with builder.both_sides():
            builder.cylinder((float(x), half * 0.6, 0.5), (float(x), half * 0.76, 0.5), 0.5, wheel, sections=10)
