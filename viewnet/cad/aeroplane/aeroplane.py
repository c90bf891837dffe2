"""Aeroplanes of many kinds: airliners, propeller planes, fighters, business jets, gliders, biplanes."""

from collections.abc import Callable

import numpy as np

from viewnet.cad import palette
from viewnet.cad.aeroplane.parts import (
    BELLY,
    CROWN,
    KEEL,
    SHOULDER,
    STRIPE,
    WINDOW,
    Section,
    along_edge,
    fin_sections,
    fuselage,
    gear,
    propeller,
    round_body,
    surface,
    turbofan,
    wing_sections,
)
from viewnet.cad.aeroplane.small import biplane, glider, light_plane, warbird
from viewnet.cad.aeroplane.war import fighter, flying_wing
from viewnet.cad.builder import Builder

KINDS = {
    "airliner": 42, "jumbo": 6, "rear_jet": 12, "turboprop": 8, "transport": 4, "fighter": 14, "light": 7, "warbird": 5,
    "glider": 3, "biplane": 3, "wing": 1.5, "delta": 1.5,
}  # fmt: skip


def aeroplane(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """An aeroplane: airliner, regional or business jet, turboprop, transport, fighter, light plane, glider, biplane."""
    builder = Builder()
    kind = palette.pick(rng, KINDS, kind)
    makers: dict[str, Callable[[np.random.Generator, Builder], None]] = {
        "fighter": fighter,
        "wing": flying_wing,
        "light": light_plane,
        "warbird": warbird,
        "glider": glider,
        "biplane": biplane,
        "delta": delta_airliner,
    }
    if kind in makers:
        makers[kind](rng, builder)
    else:
        airliner(rng, builder, kind)
    return builder


class Livery:
    """An airline's colours: which material each cell of the fuselage has, and those of the other parts."""

    def __init__(self, rng: np.random.Generator, builder: Builder, military: bool = False) -> None:
        base = palette.choose(rng, {"white": 62, "gray": 18, "color": 14, "dark": 3})
        color = {
            "white": palette.gray(rng, 0.86, 0.97),
            "gray": palette.gray(rng, 0.45, 0.8),
            "color": palette.vivid(rng, 0.4),
            "dark": palette.gray(rng, 0.12, 0.3),
        }[base]
        accent = palette.jitter(rng, (0.08, 0.14, 0.45)) if rng.random() < 0.35 else palette.vivid(rng, 0.6, 0.35)
        if military:
            color = palette.jitter(rng, (0.46, 0.49, 0.51) if rng.random() < 0.6 else (0.33, 0.36, 0.26))
            accent = color
        self.base = builder.material("base", color)
        self.accent = builder.material("accent", accent)
        self.second = builder.material("second", palette.vivid(rng, 0.6, 0.4))
        belly = palette.gray(rng, 0.5, 0.8) if rng.random() < 0.6 or military else accent
        self.belly = builder.material("belly", belly)
        self.glass = builder.material("glass", palette.gray(rng, 0.04, 0.2))
        window = palette.gray(rng, 0.08, 0.45)
        self.window = builder.material("window", window)
        wing = color if rng.random() < 0.35 else palette.gray(rng, 0.5, 0.85) if rng.random() < 0.8 else None
        self.wing = builder.material("wing", wing or palette.gray(rng, 0.2, 0.4))
        self.metal = builder.material("metal", palette.metal(rng))
        self.dark = builder.material("dark", palette.gray(rng, 0.03, 0.15))
        cowl = palette.choose(rng, {"base": 5, "accent": 2.5, "gray": 2.5})
        self.cowl = {"base": self.base, "accent": self.accent, "gray": self.wing}[cowl]
        self.tail = self.accent if rng.random() < 0.62 else self.base
        self.wraps = self.tail == self.accent and rng.random() < 0.45
        self.painted_belly = rng.random() < 0.35
        self.stripe = rng.random() < (0.0 if military else 0.28)
        self.crown = not military and rng.random() < 0.07
        self.windows = rng.random() < (0.1 if military else 0.75)
        self.tips = self.accent if rng.random() < 0.3 else self.wing
        self.slant = rng.uniform(-0.6, 1.0)

    def painter(
        self, cockpit: tuple[float, float], cabin: tuple[float, float], wrap: float
    ) -> Callable[[int, float], str]:
        """Painter of a fuselage: x ranges of the windows of cockpit and cabin, and where the tail's colour starts."""

        def paint(row: int, x: float) -> str:
            if cockpit[1] < x < cockpit[0] and row in (SHOULDER, WINDOW):
                return self.glass
            # The border of the tail's colour leans like the fin above it.
            if self.wraps and x < wrap + self.slant * (row - 3) * abs(wrap) * 0.05:
                return self.tail
            if row == KEEL or (row == BELLY and self.painted_belly):
                return self.belly if self.painted_belly else self.base
            if row == WINDOW and self.windows and cabin[1] < x < cabin[0]:
                return self.window
            if self.stripe and row in (STRIPE, WINDOW):
                return self.accent
            if self.crown and row in (CROWN, SHOULDER):
                return self.accent
            return self.base

        return paint


def airliner(rng: np.random.Generator, builder: Builder, kind: str) -> None:
    """A transport with a tubular body: jets with engines under the wings or at the tail, turboprops, freighters."""
    military = kind == "transport" or (kind == "turboprop" and rng.random() < 0.15)
    livery = Livery(rng, builder, military)
    high = kind in ("turboprop", "transport")
    small = kind == "rear_jet" and rng.random() < 0.55
    length = rng.uniform(28, 74) if kind == "airliner" else rng.uniform(45, 76)
    slender = rng.uniform(0.041, 0.060)
    if kind == "rear_jet":
        length, slender = (rng.uniform(13, 24), rng.uniform(0.055, 0.072)) if small else (rng.uniform(26, 50), 0.042)
    elif kind in ("turboprop", "transport"):
        slender = rng.uniform(0.046, 0.062) if kind == "turboprop" else rng.uniform(0.055, 0.075)
    radius = length * slender
    front = length / 2
    nose, tail = radius * rng.uniform(2.2, 3.4), length * rng.uniform(0.24, 0.34)
    rise = rng.uniform(0.55, 0.95)
    stations = round_body(length, radius, nose, tail, rng.uniform(0.1, 0.4), rise)
    body = [(front + x, z, w, 1.04 * h) for x, z, w, h in stations]
    if kind == "jumbo":
        body = _hump(body, front, length, radius, rng.uniform(0.28, 0.5) if rng.random() < 0.7 else 0.9)
    cockpit = (front - 0.22 * nose, front - 0.62 * nose)
    cabin = (front - 1.0 * nose, -front + 0.75 * tail)
    fuselage(builder, body, livery.painter(cockpit, cabin, -front + rng.uniform(0.4, 1.0) * tail))

    span = length * rng.uniform(0.82, 1.06) / 2
    if kind == "rear_jet":
        span = length * (rng.uniform(0.8, 1.0) if small else rng.uniform(0.62, 0.84)) / 2
    if high:
        span = length * rng.uniform(0.9, 1.15) / 2
    sweep = rng.uniform(0.0, 0.06) if kind == "turboprop" else rng.uniform(0.38, 0.66)
    root = length * (rng.uniform(0.15, 0.21) if kind != "turboprop" else rng.uniform(0.085, 0.11))
    tip = root * (rng.uniform(0.18, 0.32) if kind != "turboprop" else rng.uniform(0.45, 0.65))
    behind = 0.08 if kind == "rear_jet" else 0.07 if sweep < 0.1 else 0.0
    place = front - length * (rng.uniform(0.30, 0.37) + behind)
    z = 0.86 * radius if high else -0.55 * radius
    dihedral = (
        -rng.uniform(0.0, 0.05) if kind == "transport" else rng.uniform(0.0, 0.02) if high else rng.uniform(0.07, 0.13)
    )
    end = (place - sweep * span, span, z + dihedral * span)
    wing = wing_sections(
        place, 0.3 * radius, z, end, (root, tip), rng.uniform(0.10, 0.14), 0.36 if sweep > 0.2 else 0.0
    )
    _wings(rng, builder, wing, livery, winglet=sweep > 0.2)

    t_tail = kind == "rear_jet" or (high and rng.random() < 0.85)
    height = length * rng.uniform(0.115, 0.165) * (0.85 if t_tail else 1.0) * (1.25 if small or high else 1.0)
    chord = height * rng.uniform(0.85, 1.2)
    lean = height * (rng.uniform(0.8, 1.15) if sweep > 0.2 else rng.uniform(0.3, 0.7))
    fin_x = -front + chord + lean * rng.uniform(0.75, 1.0) + 0.01 * length
    fin_z = radius * (0.55 + 0.1 * rise)
    taper = rng.uniform(0.28, 0.45) if not t_tail else rng.uniform(0.6, 0.8)
    fin = fin_sections(fin_x, fin_z, height + 0.35 * radius, chord * 1.15, taper, lean, 0.10)
    two_tone = rng.random() < 0.25
    surface(builder, fin, livery.second if two_tone and livery.tail == livery.accent else livery.tail, upright=True)
    half = span * rng.uniform(0.30, 0.40) * (1.2 if kind == "rear_jet" else 1.0)
    level = fin[1].edge[2] - 0.02 * height if t_tail else radius * rng.uniform(0.25, 0.5)
    start = fin[1].edge[0] if t_tail else -front + rng.uniform(0.10, 0.14) * length
    stab = chord * rng.uniform(0.55, 0.75)
    back = half * (sweep + 0.1)
    plane = wing_sections(start, 0.0, level, (start - back, half, level + 0.06 * half), (stab, stab * 0.42), 0.09)
    with builder.both_sides():
        surface(builder, plane, livery.tail if rng.random() < 0.15 else livery.wing)

    if kind == "turboprop" or (kind == "transport" and rng.random() < 0.4):
        _turboprops(rng, builder, livery, wing, span, radius, 2 if kind == "turboprop" else 4)
    elif kind == "rear_jet":
        _rear_engines(rng, builder, livery, front, length, radius, fin)
    else:
        _hung_engines(
            rng, builder, livery, wing, span, radius, 4 if kind == "jumbo" or high else int(rng.choice([2, 2, 2, 2, 4]))
        )
    if rng.random() < 0.35:
        leg = radius * rng.uniform(0.8, 1.1)
        size = radius * 0.28
        gear(builder, (front - 0.9 * nose, 0, -0.85 * radius), leg, size * 0.75, livery.metal, livery.dark)
        with builder.both_sides():
            x, _, c, _ = along_edge(wing, 0.8 * radius)
            gear(
                builder,
                (x - 0.7 * c, radius * 1.1, -0.7 * radius),
                leg + 0.15 * radius,
                size,
                livery.metal,
                livery.dark,
            )
    if not high and rng.random() < 0.7:
        builder.ellipsoid(
            (place - 0.5 * root, 0, -0.72 * radius), (0.75 * root, 0.95 * radius, 0.5 * radius), livery.belly, (10, 6)
        )


def _hump(
    body: list[tuple[float, float, float, float]], front: float, length: float, radius: float, reach: float
) -> list[tuple[float, float, float, float]]:
    """The upper deck of a jumbo: the forward part of the tube made taller upwards."""
    tall = []
    xs = [x for x, *_ in body]
    extra = [front - reach * length, front - (reach + 0.08) * length]
    for x in sorted({*xs, *extra}, reverse=True):
        z, w, h = (float(np.interp(-x, [-b[0] for b in body], [b[i] for b in body])) for i in (1, 2, 3))
        t = (front - x) / length
        more = float(np.interp(t, [0, 0.035, 0.08, reach, reach + 0.08], [0, 0.1, 0.42, 0.42, 0])) * radius
        tall.append((x, z + more / 2, w, h + more / 2))
    return tall


def _wings(rng: np.random.Generator, builder: Builder, wing: list[Section], livery: Livery, winglet: bool) -> None:
    tip = wing[-1]
    sections, materials = list(wing), [livery.wing] * (len(wing) - 1)
    if winglet and rng.random() < 0.5:
        x, y, z = tip.edge
        rise = y * rng.uniform(0.06, 0.14)
        sections.append(Section((x - 0.7 * tip.chord, y + 0.35 * rise, z + rise), 0.4 * tip.chord, 0.05 * tip.chord))
        materials.append(livery.tips)
    with builder.both_sides():
        surface(builder, sections, materials)


def _hung_engines(
    rng: np.random.Generator,
    builder: Builder,
    livery: Livery,
    wing: list[Section],
    span: float,
    radius: float,
    count: int,
) -> None:
    size = radius * (rng.uniform(0.48, 0.72) if count == 2 else rng.uniform(0.38, 0.5))
    long = size * rng.uniform(3.4, 4.6)
    for share in (rng.uniform(0.30, 0.36),) if count == 2 else (0.33, 0.6):
        y = share * span
        x, z, chord, thick = along_edge(wing, y)
        drop = size * rng.uniform(0.95, 1.15) + 0.3 * thick
        with builder.both_sides():
            turbofan(builder, (x + 0.62 * long, y, z - drop), size, long, livery.cowl, livery.metal, livery.dark)
            ahead, behind = x + 0.3 * long, x - 0.5 * chord
            outline = [
                (behind, z - 0.2 * thick),
                (x - 0.1 * long, z - drop),
                (ahead, z - drop + 0.9 * size),
                (x, z + 0.2 * thick),
            ]
            builder.extrude(outline, "y", y - 0.07 * size, y + 0.07 * size, livery.wing)


def _rear_engines(
    rng: np.random.Generator,
    builder: Builder,
    livery: Livery,
    front: float,
    length: float,
    radius: float,
    fin: list[Section],
) -> None:
    size = radius * rng.uniform(0.42, 0.58)
    long = size * rng.uniform(4.5, 6.0)
    x, z = -front + length * rng.uniform(0.24, 0.29), radius * rng.uniform(0.35, 0.55)
    y = radius * 1.05 + size * 1.05
    with builder.both_sides():
        turbofan(builder, (x, y, z), size, long, livery.cowl, livery.metal, livery.dark)
        builder.box(
            (x - 0.5 * long, 0.8 * radius + 0.3 * size, z), (0.5 * long, y - 0.6 * radius, 0.25 * size), livery.base
        )
    if rng.random() < 0.15:
        level = fin[0].edge[2] + 0.9 * size
        turbofan(builder, (fin[0].edge[0] + 0.1 * long, 0, level), size, long, livery.tail, livery.metal, livery.dark)


def _turboprops(
    rng: np.random.Generator,
    builder: Builder,
    livery: Livery,
    wing: list[Section],
    span: float,
    radius: float,
    count: int,
) -> None:
    blades, disc, turn = int(rng.integers(3, 7)), rng.random() < 0.15, rng.uniform(0, 90)
    for share in (rng.uniform(0.28, 0.33),) if count == 2 else (0.27, 0.52):
        y = share * span
        x, z, chord, _ = along_edge(wing, y)
        size = radius * (0.42 if count == 2 else 0.36)
        nose = x + 0.55 * chord
        stations = [
            (nose, z - 0.2 * size, 0.5 * size, 0.5 * size),
            (nose - 0.3 * chord, z - 0.15 * size, 0.9 * size, size),
        ]
        stations += [(x - 0.4 * chord, z - 0.3 * size, 0.9 * size, size), (x - 1.3 * chord, z, 0.2 * size, 0.25 * size)]
        with builder.both_sides():
            with builder.placed((0, y, 0)):
                fuselage(builder, stations, lambda row, x: livery.cowl)
            propeller(builder, (nose, y, z - 0.2 * size), 1.15 * radius, blades, livery.dark, livery.metal, turn, disc)


def delta_airliner(rng: np.random.Generator, builder: Builder) -> None:
    """A supersonic airliner: needle nose, ogival delta wing, no tailplane."""
    livery = Livery(rng, builder)
    length = 60.0
    radius = length * rng.uniform(0.022, 0.03)
    front = length / 2
    stations = round_body(length, radius, radius * 7, length * 0.3, 0.3, 0.3, 0.08)
    body = [(front + x, z, w, h) for x, z, w, h in stations]
    fuselage(
        builder,
        body,
        livery.painter(
            (front - 3.2 * radius, front - 4.6 * radius), (front - 7 * radius, -0.2 * length), -0.3 * length
        ),
    )
    span = length * rng.uniform(0.19, 0.24)
    z = -0.6 * radius
    sections = [
        Section((0.22 * length, 0.3 * radius, z), 0.62 * length, 0.016 * length),
        Section((0.02 * length, 0.35 * span, z), 0.42 * length, 0.012 * length),
        Section((-0.16 * length, 0.75 * span, z), 0.23 * length, 0.008 * length),
        Section((-0.32 * length, span, z), 0.05 * length, 0.004 * length),
    ]
    with builder.both_sides():
        surface(builder, sections, livery.wing)
        builder.box(
            (-0.28 * length, 0.48 * span, z - 0.7 * radius), (0.24 * length, 2.0 * radius, 1.1 * radius), livery.cowl
        )
        builder.box(
            (-0.16 * length, 0.48 * span, z - 0.7 * radius), (0.01 * length, 1.8 * radius, 0.9 * radius), livery.dark
        )
    fin = fin_sections(-0.18 * length, 0.5 * radius, 0.14 * length, 0.26 * length, 0.25, 0.17 * length, 0.04)
    surface(builder, fin, livery.tail, upright=True)
