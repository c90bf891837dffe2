"""Freighters, liners and warships. Units: metres."""

import numpy as np

from viewnet.cad import palette
from viewnet.cad.boat.hull import Hull, deckhouse, hull
from viewnet.cad.builder import Builder


def freighter(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    """Freighters: a hull with its bridge aft, and cargo."""
    length = 120.0
    beam, depth = length * rng.uniform(0.13, 0.18), length * rng.uniform(0.075, 0.11)
    form = Hull(length, beam, depth, rng.uniform(0.0, 0.1), rng.uniform(0.75, 0.95), 0.02 * length, False, full=True)
    hull(builder, form, c)
    tall = length * rng.uniform(0.10, 0.16)
    a = -0.44 * length
    long = length * rng.uniform(0.07, 0.12)
    deckhouse(builder, (a, a + long), beam * 0.86, depth * 0.95, tall, 0.0, c, round_front=False)
    builder.box((a + 0.7 * long, 0, depth + tall - 2.0), (0.5 * long, beam * 1.05, 2.4), c["house"])
    builder.box(
        (a - 0.01 * length, 0, depth + 0.45 * tall),
        (0.05 * length, 0.4 * beam, 0.9 * tall),
        c["accent"],
        taper=(0.8, 0.8),
    )
    style = palette.choose(rng, {"containers": 3, "tanker": 2, "cranes": 2})
    if style == "containers":
        names = [
            builder.material(
                f"box{k}", palette.vivid(rng, 0.5, 0.35) if rng.random() < 0.8 else palette.gray(rng, 0.5, 0.9)
            )
            for k in range(5)
        ]
        bays, rows = int(rng.integers(5, 9)), 3
        pitch = (0.40 * length - a - long) / bays
        for bay in range(bays):
            x = a + long + pitch * (bay + 0.6)
            for row in range(rows):
                high = 2.6 * int(rng.integers(1, 5))
                wide = beam * 0.88 / rows
                y = (row - (rows - 1) / 2) * wide
                builder.box((x, y, depth + high / 2), (pitch * 0.9, wide * 0.95, high), names[int(rng.integers(5))])
    elif style == "tanker":
        builder.box((0.05 * length, 0, depth + 1.2), (0.75 * length, 0.06 * beam, 1.4), c["accent"])
        for x in (-0.15, 0.05, 0.2):
            builder.box((x * length, 0, depth + 1.0), (0.02 * length, 0.8 * beam, 1.6), c["metal"])
    else:
        for x in np.linspace(-0.24, 0.3, int(rng.integers(3, 5))) * length:
            builder.box((float(x), 0, depth + 1.2), (0.1 * length, 0.6 * beam, 2.6), c["deck"])
            post = float(x) - 0.07 * length
            builder.cylinder((post, 0, depth), (post, 0, depth + 0.11 * length), 1.0, c["metal"], sections=6)
            builder.tube(
                [(post, 0, depth + 0.09 * length), (post + 0.11 * length, 0, depth + 0.12 * length)], 0.6, c["metal"], 5
            )


def liner(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    """Passenger liners and ferries: decks of windows, lifeboats, funnels."""
    length = 160.0
    beam, depth = length * rng.uniform(0.12, 0.16), length * rng.uniform(0.07, 0.10)
    form = Hull(length, beam, depth, rng.uniform(0.1, 0.3), rng.uniform(0.6, 0.9), 0.02 * length, False, full=True)
    hull(builder, form, c)
    z, a, b = depth * 0.95, -0.44 * length, rng.uniform(0.26, 0.36) * length
    for deck in range(int(rng.integers(3, 6))):
        tall = 0.022 * length
        deckhouse(builder, (a, b), beam * (0.92 - 0.02 * deck), z, tall, 0.5 * tall, c, round_front=True)
        z, a, b = z + tall, a + rng.uniform(0.0, 0.04) * length, b - rng.uniform(0.005, 0.03) * length
    boats = builder.material("boats", (0.93, 0.5, 0.1))
    for x in np.linspace(-0.3, 0.2, int(rng.integers(3, 7))) * length:
        with builder.both_sides():
            builder.box(
                (float(x), beam * 0.48, depth + 0.035 * length), (0.045 * length, 0.015 * length, 0.015 * length), boats
            )
    count = int(rng.integers(1, 5))
    for x in np.linspace(-0.12 if count > 1 else -0.2, 0.12, count) * length:
        top = z + length * rng.uniform(0.05, 0.08)
        builder.cylinder(
            (float(x), 0, z - 2), (float(x) - 0.01 * length, 0, top), 0.018 * length, c["accent"], 0.016 * length, 10
        )
        builder.cylinder(
            (float(x) - 0.01 * length, 0, top),
            (float(x) - 0.012 * length, 0, top + 2.5),
            0.0165 * length,
            c["dark"],
            sections=10,
        )
    builder.cylinder((b - 5, 0, z), (b - 6, 0, z + 0.07 * length), 0.5, c["metal"], sections=5)


def warship(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    """Warships: a narrow hull with superstructure, masts and guns."""
    length = 140.0
    beam, depth = length * rng.uniform(0.10, 0.14), length * rng.uniform(0.05, 0.07)
    form = Hull(length, beam, depth, rng.uniform(0.15, 0.35), rng.uniform(0.6, 0.9), 0.02 * length, False)
    hull(builder, form, c)
    z, a, b = depth * 0.95, -0.22 * length, 0.2 * length
    for deck in range(int(rng.integers(2, 4))):
        tall = 0.03 * length
        deckhouse(builder, (a, b), beam * (0.75 - 0.12 * deck), z, tall, 0.3 * tall, c, round_front=False)
        z, a, b = z + tall, a + rng.uniform(0.05, 0.16) * length, b - rng.uniform(0.01, 0.05) * length
        if b - a < 0.08 * length:
            break
    middle = (a + b) / 2
    builder.cylinder((middle, 0, z - 1), (middle, 0, z + rng.uniform(0.06, 0.12) * length), 1.4, c["house"], 0.4, 5)
    builder.box((middle - 0.02 * length, 0, z + 0.05 * length), (1.5, 0.09 * length, 0.8), c["metal"])
    for x in (-0.1, -0.18)[: int(rng.integers(1, 3))]:
        builder.cylinder(
            (x * length, 0, depth),
            ((x - 0.015) * length, 0, depth + 0.085 * length),
            0.018 * length,
            c["house"],
            sections=8,
        )
    turrets = [(0.27, 1), (0.34, 1), (-0.3, -1)][: int(rng.integers(1, 4))] if rng.random() < 0.7 else [(0.3, 1)]
    for share, way in turrets:
        x, base = share * length, depth * 1.0
        builder.box((x, 0, base + 1.8), (0.05 * length, 0.6 * beam, 3.6), c["house"], taper=(0.7, 0.8))
        for y in (-0.12 * beam, 0.12 * beam):
            builder.cylinder((x, y, base + 2.2), (x + way * 0.075 * length, y, base + 3.4), 0.5, c["dark"], sections=5)
