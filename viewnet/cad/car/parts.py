"""Wheels, mirrors, plates, wings, roof signs and the other parts attached to a car's body."""

from dataclasses import dataclass

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.car.shell import Shape


@dataclass(frozen=True)
class Finish:
    """Names of the materials of a car."""

    paint: str
    second: str
    glass: str
    trim: str
    dark: str
    lamp: str
    tail: str
    amber: str
    chrome: str
    tyre: str
    rim: str
    plate: str
    seat: str


def wheel(
    builder: Builder,
    center: tuple[float, float, float],
    radius: float,
    width: float,
    tyre: str,
    rim: str,
    hub: str,
    spokes: int = 5,
    share: float = 0.66,
    sections: int = 14,
) -> None:
    """A wheel whose outer face points to +y, with its middle at `center`. `share` is the rim's share of the radius;
    with `spokes`, part of the disc is of the hub's material."""
    x, y, z = center
    angle = (np.arange(sections) + 0.5) * (2 * np.pi / sections)
    circle = np.stack([np.cos(angle), np.zeros(sections), -np.sin(angle)], -1)

    def ring(r: float, offset: float) -> np.ndarray:
        return circle * r + np.array([x, y + offset, z])

    half = width / 2
    rings = [
        ring(radius * 0.97, -half),
        ring(radius, half * 0.6),
        ring(radius * 0.93, half),
        ring(radius * share, half),
    ]
    rings += [ring(radius * share * 0.93, half * 0.75), ring(radius * 0.14, half * 0.7)]
    disc: str | list[str] = rim
    if spokes:
        # A cell is dark where it falls into the gap between two spokes.
        turn = np.arange(sections) * spokes / sections % 1
        disc = [hub if 0.3 < t < 0.75 else rim for t in turn]
    builder.loft(rings, [tyre, tyre, tyre, rim, disc], caps=(False, True))


def wheels(rng: np.random.Generator, builder: Builder, shape: Shape, finish: Finish, toy: bool) -> None:
    """The four wheels."""
    share = rng.uniform(0.5, 0.62) if toy else rng.uniform(0.58, 0.76)
    spokes = int(rng.choice([0, 0, 4, 5, 5, 6]))
    out = rng.uniform(-0.03, 0.02) + shape.flare * 0.6 + (0.04 if toy else 0.0)
    sections = 10 if toy else 14
    for axle in shape.axles:
        half = shape.width / 2 * (1 - 0.05 * abs(2 * axle / shape.length - 1) ** 4)
        center = (shape.length / 2 - axle, half - shape.tread / 2 + out, shape.wheel)
        with builder.both_sides():
            wheel(
                builder, center, shape.wheel, shape.tread, finish.tyre, finish.rim, finish.dark, spokes, share, sections
            )


def details(
    rng: np.random.Generator, builder: Builder, shape: Shape, finish: Finish, kind: str, open_top: bool
) -> None:
    """Mirrors, plates, exhausts, handles, roof rails and bull bars."""
    s = shape
    front, rear = s.length / 2, -s.length / 2
    if rng.random() < 0.9:
        mirror_x = front - s.cowl - 0.35 * max(s.screen - s.cowl, 0.2)
        with builder.both_sides():
            size = (0.11, rng.uniform(0.2, 0.28), rng.uniform(0.10, 0.15))
            name = finish.paint if rng.random() < 0.7 else finish.trim
            builder.box((mirror_x, s.width / 2 - 0.01, s.belt[0] + 0.08), size, name, taper=(0.7, 0.9))
    base = s.clearance + 0.05
    plate_z = base + rng.uniform(0.18, 0.32) * (s.nose_z - base)
    if rng.random() < 0.75:
        builder.box((front, 0, plate_z), (0.06, 0.48, 0.11), finish.plate)
    if rng.random() < 0.85:
        height = base + rng.uniform(0.25, 0.6) * (s.tail_z - base)
        builder.box((rear, 0, height), (0.06, 0.48, 0.11), finish.plate)
    if kind in ("sedan", "coupe", "sports", "estate") and rng.random() < 0.5:
        at = rng.uniform(0.25, 0.38) * s.width
        with builder.both_sides():
            start = (rear + 0.1, at, s.clearance + 0.10)
            builder.cylinder(start, (rear - 0.05, at, s.clearance + 0.10), 0.045, finish.chrome, sections=6)
    if kind in ("suv", "estate", "minivan") and rng.random() < 0.45:
        rail = s.width / 2 * s.roof_width * 0.95
        with builder.both_sides():
            a, b = front - s.screen - 0.1, front - s.roof_end + 0.1
            builder.box(((a + b) / 2, rail, s.height + 0.02), (a - b, 0.05, 0.05), finish.trim)
    if kind == "retro":
        bar = s.clearance + 0.16
        for x in (front + 0.02, rear - 0.02):
            builder.box((x, 0, bar), (0.12, s.width * 0.98, 0.12), finish.chrome)
        if rng.random() < 0.5:
            with builder.both_sides():
                height = s.clearance + 0.74 * (s.nose_z - s.clearance)
                start = (front - 0.10, s.width * 0.37, height)
                builder.cylinder(start, (front + 0.03, s.width * 0.37, height), 0.11, finish.lamp, sections=10)
    if kind in ("suv", "pickup") and rng.random() < 0.2:
        points = [(front + 0.06, s.width * 0.3, s.clearance + 0.1), (front + 0.12, s.width * 0.3, s.nose_z)]
        points += [(front + 0.12, -s.width * 0.3, s.nose_z), (front + 0.06, -s.width * 0.3, s.clearance + 0.1)]
        builder.tube(points, 0.035, finish.chrome, sections=6)
    if kind == "suv" and rng.random() < 0.25:
        radius = s.wheel * 0.95
        middle = s.clearance + 0.62 * (s.tail_z - s.clearance)
        builder.cylinder((rear + 0.02, 0, middle), (rear - 0.2, 0, middle), radius, finish.tyre, sections=14)
        builder.cylinder((rear - 0.2, 0, middle), (rear - 0.215, 0, middle), radius * 0.7, finish.rim, sections=12)


def roof_extras(
    rng: np.random.Generator, builder: Builder, shape: Shape, finish: Finish, kind: str, service: str
) -> None:
    """Taxi signs, light bars, roof boxes and racks, aerials."""
    s = shape
    middle = s.length / 2 - (s.screen + rng.uniform(0.2, 0.5) * (s.roof_end - s.screen))
    if service == "taxi":
        sign = builder.material("sign", (0.95, 0.9, 0.75) if rng.random() < 0.6 else (0.35, 0.36, 0.38))
        size = (rng.uniform(0.18, 0.3), rng.uniform(0.4, 0.7), rng.uniform(0.14, 0.24))
        builder.box((middle, 0, s.height + size[2] / 2 - 0.01), size, sign, taper=(0.6, 0.85))
    elif service in ("police", "ambulance"):
        blue = builder.material("blue", (0.1, 0.2, 0.85))
        red = builder.material("red", (0.85, 0.08, 0.08)) if rng.random() < 0.6 else blue
        half = s.width * s.roof_width * 0.42
        for side, name in ((1, blue), (-1, red)):
            builder.box((middle, side * half / 2, s.height + 0.06), (0.28, half, 0.15), name, taper=(0.8, 0.95))
    elif kind in ("suv", "estate", "van", "sedan") and rng.random() < 0.05:
        size = (min(1.4, 0.8 * (s.roof_end - s.screen)), rng.uniform(0.5, 0.9), rng.uniform(0.25, 0.4))
        builder.box((s.length / 2 - (s.screen + s.roof_end) / 2, 0, s.height + size[2] / 2 + 0.03), size, finish.dark)


def wing(rng: np.random.Generator, builder: Builder, shape: Shape, finish: Finish, large: bool) -> None:
    """A rear wing on two posts, or a lip over the rear window of a hatchback."""
    s = shape
    name = finish.second if rng.random() < 0.4 else finish.paint if rng.random() < 0.6 else finish.dark
    if s.back > 0.93 * s.length:
        edge = s.length / 2 - s.roof_end
        builder.box((edge - 0.12, 0, s.roof_end_z), (0.34, s.width * s.roof_width * 0.9, 0.05), name)
        return
    span = s.width * rng.uniform(0.8, 0.98)
    chord, x = rng.uniform(0.22, 0.42), -s.length / 2 + rng.uniform(0.05, 0.25)
    top = min(s.tail_z + (rng.uniform(0.2, 0.42) if large else rng.uniform(0.08, 0.25)), s.height + 0.12)
    builder.box((x, 0, top), (chord, span, 0.045), name)
    with builder.both_sides():
        at = span * rng.uniform(0.25, 0.42)
        builder.box((x, at, (top + s.tail_z) / 2 - 0.05), (chord * 0.6, 0.04, top - s.tail_z + 0.1), finish.dark)
        if large:
            builder.box((x, span / 2, top + 0.03), (chord * 1.15, 0.03, 0.2), name)


def number(rng: np.random.Generator, builder: Builder, shape: Shape, finish: Finish) -> None:
    """A race number: a pale or dark disc with bars on the doors and on the bonnet."""
    s = shape
    radius = rng.uniform(0.2, 0.32)
    ground = builder.material("roundel", (0.95, 0.95, 0.93) if rng.random() < 0.7 else (0.95, 0.8, 0.1))
    x, z = s.length / 2 - (s.screen + 0.1 * (s.roof_end - s.screen)), s.clearance + 0.55 * (s.belt[0] - s.clearance)
    bars = [(-0.25, 0.0, 0.0), (0.2, 0.0, 0.5)] if rng.random() < 0.5 else [(0.0, 0.0, 0.0)]
    with builder.both_sides():
        y = s.width / 2 + 0.008
        builder.cylinder((x, y - 0.06, z), (x, y, z), radius, ground, sections=10)
        for shift, _, wide in bars:
            builder.box((x + shift * radius, y, z), (radius * (0.2 + 0.4 * wide), 0.012, radius * 1.1), finish.dark)
    if rng.random() < 0.7:
        hood_x = s.length / 2 - 0.55 * s.cowl
        hood_z = s.nose_z + 0.75 * (s.cowl_z - s.nose_z) + 0.4 * s.crown + 0.012
        builder.box((hood_x, 0, hood_z), (radius * 1.6, radius * 1.6, 0.03), ground)
        builder.box((hood_x, 0, hood_z + 0.005), (radius * 1.1, radius * 0.3, 0.03), finish.dark)


def convertible_top(rng: np.random.Generator, builder: Builder, shape: Shape, finish: Finish) -> None:
    """The visible parts of an open car: windscreen with its frame, seats, steering wheel, a folded hood."""
    s = shape
    if s.trough is None:
        raise ValueError("an open car needs a cockpit")
    start, end, floor = s.trough
    front = s.length / 2
    foot, head = front - s.cowl, front - s.cowl - rng.uniform(0.3, 0.5)
    low, high = s.cowl_z - 0.02, s.cowl_z + rng.uniform(0.32, 0.44)
    wide, narrow = s.width / 2 * 0.86, s.width / 2 * 0.68
    builder.quad([(foot, -wide, low), (foot, wide, low), (head, narrow, high), (head, -narrow, high)], finish.glass)
    frame = [(foot, wide, low), (head, narrow, high), (head, -narrow, high), (foot, -wide, low)]
    builder.tube(frame, 0.035, finish.paint if rng.random() < 0.5 else finish.chrome, sections=6)
    with builder.both_sides():
        x, y = front - (start + 0.55 * (end - start)), s.width * 0.2
        builder.box((x, y, floor + 0.12), (0.5, 0.46, 0.24), finish.seat)
        builder.box((x - 0.3, y, floor + 0.42), (0.16, 0.46, 0.72), finish.seat, taper=(0.7, 0.8))
    if rng.random() < 0.5:
        x = front - end
        builder.box((x, 0, s.belt[1] + 0.04), (0.35, s.width * 0.76, 0.16), finish.dark, taper=(0.7, 0.9))


def pickup_cover(builder: Builder, shape: Shape, finish: Finish) -> None:
    """A hard cover flush with the sides of the bed."""
    if shape.trough is None:
        raise ValueError("a cover needs a bed")
    start, end, _ = shape.trough
    middle = shape.length / 2 - (start + end) / 2
    builder.box((middle, 0, shape.deck_z), (end - start, shape.width * 0.88, 0.06), finish.dark)
