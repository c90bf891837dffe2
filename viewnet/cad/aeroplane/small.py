"""Small propeller planes, warbirds, biplanes and gliders."""

from collections.abc import Callable

import numpy as np

from viewnet.cad import palette
from viewnet.cad.aeroplane.parts import (
    STRIPE,
    WINDOW,
    Section,
    fin_sections,
    fuselage,
    gear,
    propeller,
    surface,
    wing_sections,
)
from viewnet.cad.builder import Builder


def _paints(rng: np.random.Generator, builder: Builder, military: bool) -> dict[str, str]:
    base = palette.gray(rng, 0.85, 0.96) if rng.random() < 0.6 else palette.vivid(rng, 0.5, 0.4)
    accent = palette.vivid(rng, 0.6, 0.3)
    belly = base
    if military:
        coats = [(0.30, 0.32, 0.20), (0.35, 0.38, 0.36), (0.24, 0.30, 0.38), (0.74, 0.75, 0.76), (0.5, 0.42, 0.28)]
        base = palette.jitter(rng, coats[int(rng.integers(len(coats)))])
        belly = palette.jitter(rng, (0.6, 0.66, 0.7)) if rng.random() < 0.6 else base
    wing = (
        base if rng.random() < 0.7 else accent if rng.random() < 0.5 and not military else palette.gray(rng, 0.6, 0.9)
    )
    return {
        "base": builder.material("base", base),
        "accent": builder.material("accent", accent),
        "belly": builder.material("belly", belly),
        "wing": builder.material("wing", wing),
        "glass": builder.material(
            "glass", palette.jitter(rng, (0.12, 0.15, 0.18) if rng.random() < 0.75 else (0.5, 0.7, 0.8))
        ),
        "dark": builder.material("dark", palette.gray(rng, 0.04, 0.16)),
        "metal": builder.material("metal", palette.metal(rng)),
        "tail": builder.material("tail", accent if rng.random() < 0.4 else base),
    }


def _painter(rng: np.random.Generator, p: dict[str, str], front: float, cowl: float) -> Callable[[int, float], str]:
    stripe, nose = rng.random() < 0.5, rng.random() < 0.35

    def paint(row: int, x: float) -> str:
        if nose and x > front - cowl:
            return p["accent"]
        if row < 2:
            return p["belly"]
        return p["accent"] if stripe and row == STRIPE else p["base"]

    return paint


def _tail(
    rng: np.random.Generator, builder: Builder, p: dict[str, str], rear: float, z: float, length: float, swept: float
) -> None:
    """A fin and a tailplane at the rear end of the body."""
    height, chord = length * rng.uniform(0.14, 0.19), length * rng.uniform(0.12, 0.16)
    lean = height * swept
    fin = fin_sections(rear + chord + 0.35 * lean, z, height, chord * 1.15, rng.uniform(0.5, 0.7), lean, 0.08)
    surface(builder, fin, p["tail"], upright=True)
    half, depth = length * rng.uniform(0.18, 0.23), length * rng.uniform(0.09, 0.12)
    level = z + rng.uniform(-0.01, 0.02) * length
    x = rear + depth * 1.2
    with builder.both_sides():
        tip = (x - 0.15 * half, half, level)
        surface(
            builder,
            wing_sections(x, 0.0, level, tip, (depth, depth * 0.65), 0.08),
            p["tail"] if rng.random() < 0.4 else p["wing"],
        )


def light_plane(rng: np.random.Generator, builder: Builder) -> None:
    """A touring plane: high wing with struts or low wing, fixed wheels, one propeller in front or two engines."""
    p = _paints(rng, builder, False)
    length = 8.0
    front, radius = length / 2, length * rng.uniform(0.062, 0.078)
    high, twin = rng.random() < 0.5, rng.random() < 0.2
    cabin = (front - 0.26 * length, front - rng.uniform(0.48, 0.6) * length)
    top = radius * rng.uniform(1.25, 1.5)
    stations = [
        (front, 0.1 * radius, 0.45 * radius, 0.45 * radius),
        (front - 0.03 * length, 0.05 * radius, 0.75 * radius, 0.75 * radius),
        (front - 0.22 * length, 0.0, 0.95 * radius, 0.95 * radius),
        (front - 0.34 * length, 0.5 * (top - radius), radius, 0.5 * (top + radius)),
        (front - 0.50 * length, 0.5 * (top - radius), radius, 0.5 * (top + radius)),
        (front - 0.66 * length, 0.1 * radius, 0.72 * radius, 0.75 * radius),
        (front - 0.98 * length, 0.35 * radius, 0.14 * radius, 0.28 * radius),
    ]
    base = _painter(rng, p, front, 0.12 * length)
    paint = base
    fuselage(
        builder,
        stations,
        lambda row, x: p["glass"] if row in (WINDOW, 4) and cabin[1] < x < cabin[0] else paint(row, x),
        2.8,
    )
    z = top * 0.93 if high else -0.75 * radius
    span, chord = length * rng.uniform(0.60, 0.74), length * rng.uniform(0.16, 0.22)
    place = front - length * rng.uniform(0.26, 0.32)
    tip = (place - rng.uniform(0.0, 0.06) * span, span, z + (0.02 if high else rng.uniform(0.06, 0.11)) * span)
    wing = wing_sections(place, 0.0, z, tip, (chord, chord * rng.uniform(0.6, 1.0)), 0.13)
    tips = p["accent"] if rng.random() < 0.4 else p["wing"]
    cut = 0.85
    a, b = wing[0], wing[-1]
    at = tuple(a.edge[i] + cut * (b.edge[i] - a.edge[i]) for i in range(3))
    middle = Section((at[0], at[1], at[2]), a.chord + cut * (b.chord - a.chord), 0.12 * b.chord)
    with builder.both_sides():
        surface(builder, [a, middle, b], [p["wing"], tips])
        if high:
            strut = (place - 0.4 * chord, 0.55 * span, z + 0.01 * span)
            builder.cylinder(
                (place - 0.4 * chord, 0.8 * radius, -0.7 * radius), strut, 0.012 * length, p["wing"], sections=5
            )
        size = length * 0.028
        leg = radius * (0.9 if high else 0.55)
        gear(
            builder, (place - 0.55 * chord, 1.6 * radius, -0.75 * radius), leg, size, p["metal"], p["dark"], pair=False
        )
    size = length * 0.024
    gear(
        builder,
        (front - 0.12 * length, 0, -0.6 * radius),
        radius * (1.0 if high else 0.7),
        size,
        p["metal"],
        p["dark"],
        False,
    )
    blades, disc, turn = int(rng.integers(2, 4)), rng.random() < 0.15, rng.uniform(0, 180)
    if twin:
        y = 0.3 * span
        body = [
            (place + 0.45 * chord, z, 0.3 * radius, 0.3 * radius),
            (place + 0.2 * chord, z, 0.5 * radius, 0.5 * radius),
        ]
        with builder.both_sides():
            with builder.placed((0, y, 0)):
                fuselage(
                    builder, [*body, (place - 0.8 * chord, z, 0.2 * radius, 0.2 * radius)], lambda row, x: p["base"]
                )
            propeller(builder, (place + 0.45 * chord, y, z), 0.115 * length, blades, p["dark"], p["accent"], turn, disc)
    else:
        propeller(builder, (front, 0, 0.1 * radius), 0.13 * length, blades, p["dark"], p["accent"], turn, disc)
    _tail(rng, builder, p, -front, 0.3 * radius, length, rng.uniform(0.2, 0.9))


def warbird(rng: np.random.Generator, builder: Builder) -> None:
    """A propeller fighter or racer of the forties: long nose, bubble canopy, elliptical or straight low wing."""
    p = _paints(rng, builder, rng.random() < 0.75)
    length = 9.0
    front, radius = length / 2, length * rng.uniform(0.052, 0.07)
    stations = [
        (front, 0.0, 0.5 * radius, 0.5 * radius),
        (front - 0.04 * length, 0.0, 0.85 * radius, 0.88 * radius),
        (front - 0.18 * length, 0.0, radius, 1.05 * radius),
        (front - 0.42 * length, 0.0, radius, 1.1 * radius),
        (front - 0.62 * length, 0.05 * radius, 0.75 * radius, 0.85 * radius),
        (front - 0.98 * length, 0.25 * radius, 0.12 * radius, 0.25 * radius),
    ]
    fuselage(builder, stations, _painter(rng, p, front, 0.14 * length))
    cabin = front - length * rng.uniform(0.36, 0.46)
    builder.ellipsoid((cabin, 0, 0.85 * radius), (0.11 * length, 0.6 * radius, 0.75 * radius), p["glass"], (10, 6))
    span, chord = length * rng.uniform(0.52, 0.64), length * rng.uniform(0.22, 0.28)
    place, z = front - length * rng.uniform(0.24, 0.30), -0.6 * radius
    rise = rng.uniform(0.06, 0.12)
    elliptic = rng.random() < 0.4
    sections = []
    for u in (0.0, 0.35, 0.7, 0.9, 1.0):
        share = np.sqrt(max(1 - u**2.2, 0.02)) if elliptic else 1 - 0.5 * u
        c = chord * float(share)
        sections.append(
            Section((place - 0.35 * (chord - c), max(u * span, 0.1 * radius), z + rise * u * span), c, 0.12 * c)
        )
    mark = p["accent"] if rng.random() < 0.3 else p["wing"]
    with builder.both_sides():
        surface(builder, sections, [p["wing"], p["wing"], p["wing"], mark])
        if rng.random() < 0.35:
            x = place - 0.3 * chord
            gear(builder, (x, 0.28 * span, z), 1.5 * radius, 0.035 * length, p["metal"], p["dark"], pair=False)
    blades, disc, turn = int(rng.integers(3, 5)), rng.random() < 0.15, rng.uniform(0, 120)
    propeller(builder, (front, 0, 0), 0.17 * length, blades, p["dark"], p["accent"], turn, disc)
    _tail(rng, builder, p, -front, 0.3 * radius, length, rng.uniform(0.2, 0.6))


def biplane(rng: np.random.Generator, builder: Builder) -> None:
    """A biplane (sometimes a triplane) with struts, open cockpit and spoked wheels."""
    p = _paints(rng, builder, rng.random() < 0.4)
    length = 7.0
    front, radius = length / 2, length * rng.uniform(0.058, 0.075)
    stations = [
        (front, 0.0, 0.8 * radius, 0.8 * radius),
        (front - 0.05 * length, 0.0, radius, radius),
        (front - 0.40 * length, 0.0, radius, 1.05 * radius),
        (front - 0.98 * length, 0.2 * radius, 0.15 * radius, 0.3 * radius),
    ]
    fuselage(builder, stations, _painter(rng, p, front, 0.06 * length), rng.uniform(2.0, 3.5))
    builder.ellipsoid(
        (front - 0.45 * length, 0, 0.9 * radius), (0.07 * length, 0.55 * radius, 0.3 * radius), p["dark"], (8, 4)
    )
    span, chord = length * rng.uniform(0.56, 0.68), length * rng.uniform(0.17, 0.22)
    place = front - length * rng.uniform(0.13, 0.18)
    low, high = -0.75 * radius, radius * rng.uniform(2.3, 3.0)
    stagger = rng.uniform(0.0, 0.3) * chord
    levels = [(low, 0.0), (high, stagger)]
    if rng.random() < 0.12:
        levels.insert(1, ((low + high) / 2, stagger / 2))
    for z, ahead in levels:
        with builder.both_sides():
            half = span * (1.0 if z == high else 0.94)
            tip = (place + ahead, half, z + 0.02 * half)
            surface(builder, wing_sections(place + ahead, 0.0, z, tip, (chord, chord * 0.95), 0.09), p["wing"])
    with builder.both_sides():
        for back in (0.15, 0.75):
            for y in (0.25 * span, 0.72 * span):
                foot = (
                    place - back * chord,
                    y if y > 0.3 * span else 0.7 * radius,
                    low if y > 0.3 * span else 0.6 * radius,
                )
                builder.cylinder(foot, (place + stagger - back * chord, y, high), 0.008 * length, p["dark"], sections=4)
        gear(
            builder,
            (place - 0.3 * chord, 0.9 * radius, -0.6 * radius),
            1.3 * radius,
            0.045 * length,
            p["metal"],
            p["dark"],
            False,
        )
    propeller(builder, (front, 0, 0), 0.16 * length, 2, p["dark"], p["metal"], rng.uniform(0, 180), rng.random() < 0.1)
    _tail(rng, builder, p, -front, 0.2 * radius, length, rng.uniform(0.1, 0.5))


def glider(rng: np.random.Generator, builder: Builder) -> None:
    """A sailplane: very long thin wings, tadpole body, T-tail."""
    p = _paints(rng, builder, False)
    length = 7.0
    front, radius = length / 2, length * rng.uniform(0.042, 0.055)
    stations = [
        (front, -0.2 * radius, 0.05 * radius, 0.05 * radius),
        (front - 0.05 * length, -0.1 * radius, 0.55 * radius, 0.6 * radius),
        (front - 0.18 * length, 0.0, 0.95 * radius, radius),
        (front - 0.36 * length, 0.0, 0.9 * radius, 1.05 * radius),
        (front - 0.55 * length, 0.2 * radius, 0.4 * radius, 0.45 * radius),
        (front - 0.98 * length, 0.3 * radius, 0.2 * radius, 0.25 * radius),
    ]
    paint = _painter(rng, p, front, 0.03 * length)
    fuselage(builder, stations, paint)
    builder.ellipsoid(
        (front - 0.17 * length, 0, 0.5 * radius), (0.13 * length, 0.72 * radius, 0.85 * radius), p["glass"], (10, 6)
    )
    span, chord = length * rng.uniform(1.0, 1.4), length * rng.uniform(0.10, 0.14)
    place, z = front - 0.34 * length, 0.7 * radius
    tip = (place - 0.02 * span, span, z + rng.uniform(0.03, 0.07) * span)
    with builder.both_sides():
        surface(builder, wing_sections(place, 0.0, z, tip, (chord, chord * 0.4), 0.12, 0.5), p["wing"])
    height, base = length * rng.uniform(0.15, 0.19), length * 0.12
    fin = fin_sections(-front + base, 0.3 * radius, height, base, 0.65, 0.2 * height, 0.1)
    surface(builder, fin, p["tail"], upright=True)
    half, level, x = length * rng.uniform(0.17, 0.22), height + 0.25 * radius, fin[1].edge[0]
    with builder.both_sides():
        surface(
            builder,
            wing_sections(x, 0.0, level, (x - 0.1 * half, half, level), (0.08 * length, 0.045 * length), 0.1),
            p["wing"],
        )
    builder.cylinder(
        (front - 0.38 * length, -0.02, -radius), (front - 0.38 * length, 0.02, -radius), 0.022 * length, p["dark"]
    )
