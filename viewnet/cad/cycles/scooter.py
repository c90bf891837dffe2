"""The body of a scooter. Units: metres."""

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.cycles.parts import Point, blob, fender


def scooter_body(
    rng: np.random.Generator,
    builder: Builder,
    c: dict[str, str],
    rear: Point,
    front: Point,
    head: Point,
    small: float,
    big: float,
) -> None:
    """Leg shield, footboard, rounded rear body with the seat on top."""
    u = rng.uniform
    floor = u(0.28, 0.36)
    board = head[0] - 0.12
    seat_z = u(0.72, 0.82)
    wide = u(0.17, 0.21)
    shield = [
        (board + 0.02, floor, wide * 0.8),
        (board + 0.10, floor + 0.2, wide),
        (head[0] + 0.07, head[2] - 0.2, wide * 0.95),
        (head[0] + 0.03, head[2] + 0.02, wide * 0.5),
    ]
    rings = [
        [(x, y, z), (x - 0.05, y, z), (x - 0.05, -y, z), (x, -y, z), (x + 0.05, -0.5 * y, z), (x + 0.05, 0.5 * y, z)]
        for x, z, y in shield
    ]
    back = c["second"] if rng.random() < 0.4 else c["paint"]
    builder.loft(rings, [[c["paint"], back, c["paint"], c["paint"], c["paint"], c["paint"]]] * 3)
    builder.box(
        ((board + rear[0] + 0.5) / 2, 0, floor),
        (board - rear[0] - 0.3, 2 * wide * 0.85, 0.09),
        c["dark"] if rng.random() < 0.5 else c["second"],
    )
    tail_x = rear[0] - small * u(0.7, 1.1)
    body = [
        (rear[0] + 0.52, floor + 0.2, wide * 0.6, 0.2),
        (rear[0] + 0.35, (floor + seat_z) / 2 + 0.02, wide * 0.85, (seat_z - floor) / 2),
    ]
    body += [(rear[0] + 0.05, seat_z - 0.17, wide, 0.17), (tail_x, seat_z - 0.08, wide * 0.45, 0.06)]
    blob(builder, body, c["paint"])
    seat = [
        (rear[0] + 0.52, seat_z, 0.09, 0.04),
        (rear[0] + 0.3, seat_z + 0.02, 0.14, 0.055),
        (rear[0], seat_z + 0.05, 0.15, 0.055),
    ]
    blob(builder, [*seat, (tail_x + 0.1, seat_z + 0.05, 0.08, 0.03)], c["seat"])
    builder.box((rear[0] + 0.12, 0.1, small), (0.42, 0.12, 0.18), c["engine"])
    builder.tube(
        [(rear[0] + 0.25, -0.14, small - 0.05), (rear[0] + 0.1, -0.16, small), (rear[0] - 0.2, -0.16, small + 0.05)],
        [0.03, 0.06, 0.06],
        c["metal"],
        7,
    )
    fender(builder, front[0], front[2], big + 0.035, 0.17, (15, 165), c["paint"])
    cover = [
        (head[0] + 0.1, head[2] + 0.06, 0.07, 0.06),
        (head[0] + 0.02, head[2] + 0.08, 0.14, 0.09),
        (head[0] - 0.1, head[2] + 0.08, 0.1, 0.05),
    ]
    blob(builder, cover, c["paint"])
    lamp = (head[0] + 0.10, head[2] + 0.06) if rng.random() < 0.6 else (head[0] + 0.11, head[2] - 0.18)
    builder.cylinder((lamp[0] - 0.03, 0, lamp[1]), (lamp[0] + 0.03, 0, lamp[1]), 0.075, c["lamp"], 0.06, 8)
    if rng.random() < 0.25:
        builder.box(
            (tail_x - 0.08, 0, seat_z + 0.2),
            (0.3, 0.34, 0.28),
            c["dark"] if rng.random() < 0.6 else c["paint"],
            taper=(0.85, 0.9),
        )
    if rng.random() < 0.15:
        x, z = head[0] + 0.06, head[2] + 0.1
        builder.quad([(x, -0.18, z), (x, 0.18, z), (x - 0.1, 0.16, z + 0.4), (x - 0.1, -0.16, z + 0.4)], c["glass"])
