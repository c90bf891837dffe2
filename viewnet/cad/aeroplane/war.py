"""Fighters and flying wings."""

import numpy as np

from viewnet.cad import palette
from viewnet.cad.aeroplane.parts import Section, fin_sections, fuselage, surface
from viewnet.cad.builder import Builder, Color


def _coat(rng: np.random.Generator, builder: Builder) -> tuple[str, str, str]:
    """Upper, lower and accent paint of a military machine."""
    colors: dict[str, tuple[Color, Color]] = {
        "gray": ((0.50, 0.53, 0.56), (0.60, 0.63, 0.66)),
        "dark": ((0.24, 0.26, 0.28), (0.32, 0.34, 0.36)),
        "olive": ((0.30, 0.32, 0.20), (0.56, 0.58, 0.58)),
        "sand": ((0.66, 0.56, 0.40), (0.60, 0.66, 0.70)),
        "blue": ((0.32, 0.45, 0.58), (0.55, 0.66, 0.74)),
        "white": ((0.88, 0.88, 0.88), (0.84, 0.84, 0.84)),
        "display": (palette.vivid(rng, 0.6, 0.4), (0.9, 0.9, 0.9)),
        "silver": ((0.70, 0.71, 0.72), (0.70, 0.71, 0.72)),
    }
    shares = {"gray": 40, "dark": 12, "olive": 12, "sand": 8, "blue": 8, "white": 6, "display": 8, "silver": 6}
    top, low = colors[palette.choose(rng, shares)]
    top = palette.jitter(rng, top, 0.05)
    upper = builder.material("upper", top)
    lower = builder.material("lower", palette.jitter(rng, low, 0.04) if rng.random() < 0.5 else top)
    mark = palette.vivid(rng, 0.6, 0.3) if rng.random() < 0.25 else palette.jitter(rng, np.array(top) * 0.75, 0.03)
    return upper, lower, builder.material("mark", mark)


def fighter(rng: np.random.Generator, builder: Builder) -> None:
    """A jet fighter or trainer: pointed nose, canopy, side intakes, swept or delta wings, one or two fins, nozzles."""
    upper, lower, mark = _coat(rng, builder)
    dark = builder.material("dark", palette.gray(rng, 0.03, 0.14))
    glass = builder.material(
        "glass", palette.jitter(rng, (0.12, 0.14, 0.18) if rng.random() < 0.7 else (0.45, 0.4, 0.25))
    )
    length = 15.0
    front = length / 2
    width, tall = length * rng.uniform(0.050, 0.075), length * rng.uniform(0.045, 0.062)
    twin = rng.random() < 0.55
    wide = width * (rng.uniform(1.3, 1.8) if twin else 1.05)
    nose = builder.material("nose", palette.gray(rng, 0.1, 0.4)) if rng.random() < 0.4 else upper
    camouflage = rng.random() < 0.25
    patches = rng.integers(0, 3, size=(8, 16))

    def paint(row: int, x: float) -> str:
        if x > front - 0.08 * length:
            return nose
        if row < 3:
            return lower
        patch = patches[row, int((front - x) / length * 15) % 16]
        return mark if camouflage and patch == 0 else upper

    stations = [
        (front, -0.1 * tall, 0.02 * width, 0.02 * tall),
        (front - 0.06 * length, -0.05 * tall, 0.34 * width, 0.36 * tall),
        (front - 0.16 * length, 0.0, 0.66 * width, 0.72 * tall),
        (front - 0.28 * length, 0.0, 0.82 * width, 0.95 * tall),
        (front - 0.42 * length, 0.0, wide, 1.0 * tall),
        (front - 0.60 * length, 0.0, wide * 1.02, 0.95 * tall),
        (front - 0.80 * length, 0.0, wide * 0.96, 0.82 * tall),
        (front - 0.95 * length, 0.0, wide * 0.72, 0.62 * tall),
    ]
    fuselage(builder, stations, paint, square=2.0 if not twin else 2.8)
    cabin = front - rng.uniform(0.20, 0.26) * length
    long = length * rng.uniform(0.075, 0.12)
    builder.ellipsoid((cabin, 0, 0.72 * tall), (long, 0.48 * width, 0.62 * tall), glass, (10, 6))
    if rng.random() < 0.6:
        stations = [
            (cabin - 0.5 * long, 0.85 * tall, 0.35 * width, 0.4 * tall),
            (cabin - 1.2 * long, 0.8 * tall, 0.35 * width, 0.42 * tall),
        ]
        fuselage(builder, [*stations, (-0.3 * length, 0.6 * tall, 0.2 * width, 0.2 * tall)], lambda row, x: upper)
    # Intakes beside the cockpit, or one below the nose.
    if rng.random() < 0.75:
        x = front - rng.uniform(0.30, 0.38) * length
        size = (0.3 * length, 0.55 * width, 1.1 * tall)
        with builder.both_sides():
            builder.box((x - 0.15 * length, wide * 0.82, -0.1 * tall), size, upper)
            builder.box((x + 0.003 * length, wide * 0.82, -0.1 * tall), (0.02, 0.47 * width, 0.95 * tall), dark)
    else:
        x = front - 0.30 * length
        builder.box((x - 0.18 * length, 0, -0.75 * tall), (0.36 * length, 1.0 * width, 0.8 * tall), lower)
        builder.box((x + 0.003 * length, 0, -0.75 * tall), (0.02, 0.9 * width, 0.65 * tall), dark)
    for y in (-0.45 * wide, 0.45 * wide) if twin else (0.0,):
        r = 0.5 * tall if twin else 0.62 * tall
        builder.cylinder((-front + 0.08 * length, y, 0), (-front - 0.01 * length, y, 0), r * 1.15, dark, r * 0.85, 10)

    plan = palette.choose(rng, {"delta": 3, "trapezoid": 4, "swept": 3})
    span = length * rng.uniform(0.28, 0.36)
    z = tall * rng.uniform(-0.3, 0.5)
    if plan == "delta":
        root, tip, sweep = rng.uniform(0.42, 0.55), rng.uniform(0.03, 0.08), rng.uniform(0.36, 0.46)
        place = front - rng.uniform(0.34, 0.40) * length
    elif plan == "trapezoid":
        root, tip, sweep = rng.uniform(0.28, 0.36), rng.uniform(0.06, 0.12), rng.uniform(0.17, 0.28)
        place = front - rng.uniform(0.38, 0.45) * length
    else:
        root, tip, sweep = rng.uniform(0.20, 0.28), rng.uniform(0.07, 0.13), rng.uniform(0.22, 0.38)
        place = front - rng.uniform(0.36, 0.44) * length
    wing = [
        Section((place, 0.6 * wide, z), root * length, 0.018 * length),
        Section((place - sweep * length, span, z + rng.uniform(-0.03, 0.03) * span), tip * length, 0.006 * length),
    ]
    with builder.both_sides():
        surface(builder, wing, upper)
        if plan != "swept" and rng.random() < 0.5:
            strake = Section((place + 0.16 * length, 0.55 * width, z), 0.3 * length, 0.01 * length)
            surface(
                builder, [strake, Section((place - 0.02 * length, 1.3 * wide, z), 0.1 * length, 0.008 * length)], upper
            )
        if rng.random() < 0.45:
            tip_x, y, tip_z = wing[1].edge
            missile = builder.material("missile", palette.gray(rng, 0.6, 0.9))
            builder.cylinder(
                (tip_x + 0.06 * length, y, tip_z),
                (tip_x - 0.10 * length, y, tip_z),
                0.008 * length,
                missile,
                sections=6,
            )
    stores = rng.random() < 0.4
    if stores:
        pod = builder.material("pod", palette.gray(rng, 0.3, 0.8))
        with builder.both_sides():
            y = span * rng.uniform(0.45, 0.65)
            x = place - sweep * length * (y - 0.6 * wide) / (span - 0.6 * wide)
            builder.ellipsoid(
                (x - 0.1 * length, y, z - 0.035 * length), (0.11 * length, 0.017 * length, 0.017 * length), pod, (8, 6)
            )

    height = length * rng.uniform(0.12, 0.19)
    chord = length * rng.uniform(0.14, 0.20)
    lean, taper = height * rng.uniform(0.5, 1.1), rng.uniform(0.3, 0.5)
    fin_x = -front + chord + lean * 0.75
    if twin and rng.random() < 0.8:
        fin = fin_sections(
            fin_x, 0.5 * tall, height, chord, taper, lean, 0.05, 0.62 * wide, height * rng.uniform(0.0, 0.5)
        )
        with builder.both_sides():
            surface(builder, fin, mark if rng.random() < 0.4 else upper, upright=True)
    else:
        fin = fin_sections(fin_x, 0.6 * tall, height * 1.2, chord * 1.15, taper, lean, 0.05)
        surface(builder, fin, mark if rng.random() < 0.4 else upper, upright=True)
    if plan != "delta" or rng.random() < 0.3:
        _tailplane(builder, upper, -front + 0.14 * length, wide, 0.0, length * rng.uniform(0.15, 0.2), length * 0.13)
    elif rng.random() < 0.7:
        _tailplane(
            builder, upper, place + 0.13 * length, width, 0.3 * tall, length * rng.uniform(0.12, 0.16), length * 0.09
        )


def _tailplane(builder: Builder, name: str, x: float, wide: float, z: float, span: float, chord: float) -> None:
    root = Section((x, 0.5 * wide, z), chord, 0.05 * chord)
    with builder.both_sides():
        surface(builder, [root, Section((x - 0.62 * span, span, z), 0.45 * chord, 0.02 * chord)], name)


def flying_wing(rng: np.random.Generator, builder: Builder) -> None:
    """A tailless bomber or drone with a sawtooth rear edge."""
    upper, _, _ = _coat(rng, builder)
    dark = builder.material("dark", palette.gray(rng, 0.03, 0.14))
    span, depth = 26.0, rng.uniform(9.0, 13.0)
    sweep = span * rng.uniform(0.55, 0.75)
    chord = rng.uniform(2.4, 3.6)
    sections: list[Section] = [
        Section((depth / 2, 0.0, 0.0), depth, 2.2),
        Section((depth / 2 - 0.16 * sweep, 0.16 * span, 0.0), depth * 0.62, 1.3),
        Section((depth / 2 - 0.4 * sweep, 0.4 * span, 0.0), chord * 1.3, 0.6),
        Section((depth / 2 - 0.92 * sweep, 0.92 * span, 0.0), chord, 0.35),
        Section((depth / 2 - sweep, span, 0.0), 0.3, 0.05),
    ]
    with builder.both_sides():
        surface(builder, sections, upper)
        builder.ellipsoid((0.05 * depth, 0.12 * span, 0.75), (0.22 * depth, 1.1, 0.7), upper, (8, 6))
        builder.box((0.22 * depth, 0.12 * span, 0.95), (0.5, 1.3, 0.35), dark)
    builder.ellipsoid((0.2 * depth, 0, 0.9), (0.22 * depth, 1.3, 0.9), upper, (10, 6))
    builder.ellipsoid((0.27 * depth, 0, 1.05), (0.12 * depth, 1.1, 0.72), dark, (10, 6))
