"""Parts of aeroplanes: bodies of revolution with painted cells, lifting surfaces, engines, propellers, wheels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from viewnet.cad.builder import Array, Builder, rotation_about

# Rows of a fuselage from the keel to the crown of one side, degrees above the horizontal; cell r lies above angle r.
ANGLES = (-90.0, -52.0, -18.0, 6.0, 19.0, 48.0, 90.0)
KEEL, BELLY, STRIPE, WINDOW, SHOULDER, CROWN = range(6)

Painter = Callable[[int, float], str]


@dataclass(frozen=True)
class Section:
    """A point of a lifting surface's leading edge with the chord behind it and the thickness there."""

    edge: tuple[float, float, float]
    chord: float
    thick: float


def fuselage(
    builder: Builder, stations: Sequence[tuple[float, float, float, float]], painter: Painter, square: float = 2.0
) -> None:
    """A body along x: stations (x, z of the middle, half-width, half-height) from nose to tail.

    `painter(row, x)` names the material of a cell. `square` is the exponent of the superellipse: 2 is round, 4 boxy.
    """
    angle = np.deg2rad(ANGLES)
    c, s = np.cos(angle), np.sin(angle)
    c[0] = c[-1] = 0.0
    y, z = np.abs(c) ** (2 / square), np.sign(s) * np.abs(s) ** (2 / square)
    left = np.stack([y, z], -1)
    right = left[-2:0:-1] * np.array([-1.0, 1.0])
    outline = np.concatenate([left, right])
    rings, strips = [], []
    for x, height, width, tall in stations:
        ring = np.empty((len(outline), 3))
        ring[:, 0] = x
        ring[:, 1] = outline[:, 0] * width
        ring[:, 2] = height + outline[:, 1] * tall
        rings.append(ring)
    for near, far in pairwise(stations):
        half = [painter(row, (near[0] + far[0]) / 2) for row in range(len(ANGLES) - 1)]
        strips.append([*half, *half[::-1]])
    builder.loft(rings, strips)


def round_body(
    length: float,
    radius: float,
    nose: float,
    tail: float,
    droop: float,
    rise: float,
    tip: float = 0.12,
    middle: int = 3,
) -> list[tuple[float, float, float, float]]:
    """Stations of a tube with a rounded nose and a tapering tail, the nose at x = 0.

    `nose` and `tail` are the lengths of the ends, `droop` and `rise` how far their tips are off the axis, in radii;
    `tip` is the radius left at the tail; `middle` the number of strips of the straight part.
    """
    stations = []
    for u in (0.0, 0.04, 0.16, 0.34, 0.55, 0.78, 1.0):
        r = radius * max(1 - (1 - u) ** 2.1, 0.0) ** 0.62
        stations.append((-u * nose, -droop * radius * (1 - u) ** 1.6, max(r, 0.03 * radius), max(r, 0.03 * radius)))
    stations += [(-nose - (length - nose - tail) * k / middle, 0.0, radius, radius) for k in range(1, middle + 1)]
    for u in (0.25, 0.5, 0.75, 1.0):
        r = radius * (tip + (1 - tip) * (1 - u**1.7))
        stations.append((-(length - tail) - u * tail, rise * (radius - r), r, r))
    return stations


def surface(
    builder: Builder, sections: Sequence[Section], materials: str | Sequence[str], upright: bool = False
) -> None:
    """A wing or a tailplane through `sections` from root to tip, thick along z; `upright` ones (fins) along y."""
    rings = []
    shape = np.array([(0.0, 0.0), (0.12, 0.75), (0.4, 1.0), (1.0, 0.06), (1.0, -0.06), (0.4, -0.7), (0.12, -0.6)])
    for section in sections:
        ring = np.tile(np.asarray(section.edge, dtype=np.float64), (len(shape), 1))
        ring[:, 0] -= shape[:, 0] * section.chord
        up = shape[:, 1] * section.thick / 2
        if upright:
            up = np.array([0.0, 0.8, 1.0, 0.06, -0.06, -1.0, -0.8]) * section.thick / 2
        ring[:, 1 if upright else 2] += up
        rings.append(ring)
    builder.loft(rings, materials if isinstance(materials, str) else list(materials))


def along_edge(sections: Sequence[Section], y: float) -> tuple[float, float, float, float]:
    """Leading edge x, height z, chord and thickness of a wing at a distance y from the middle."""
    ys = [s.edge[1] for s in sections]
    table = [[s.edge[0], s.edge[2], s.chord, s.thick] for s in sections]
    x, z, chord, thick = (float(np.interp(y, ys, column)) for column in zip(*table, strict=True))
    return x, z, chord, thick


def turbofan(
    builder: Builder, front: tuple[float, float, float], radius: float, length: float, cowl: str, lip: str, dark: str
) -> None:
    """An engine nacelle whose intake is at `front`: bright lip, dark fan, cone behind."""
    x, y, z = front
    angle = np.arange(10) * (np.pi / 5) + np.pi / 10
    circle = np.stack([np.zeros(10), np.cos(angle), np.sin(angle)], -1)

    def ring(back: float, r: float) -> Array:
        return circle * r * radius + np.array([x - back * length, y, z])

    rings = [ring(0.10, 0.2), ring(0.08, 0.80), ring(0.0, 0.88), ring(0.06, 0.97), ring(0.35, 1.0), ring(0.75, 0.78)]
    rings += [ring(0.76, 0.5), ring(1.0, 0.22)]
    builder.loft(rings, [dark, dark, lip, cowl, cowl, dark, dark])


def propeller(
    builder: Builder,
    hub: tuple[float, float, float],
    radius: float,
    blades: int,
    blade: str,
    spinner: str,
    turn: float = 0.0,
    disc: bool = False,
) -> None:
    """A propeller in front of `hub`: spinner and blades, or the disc of a turning one."""
    x, y, z = hub
    width = radius * 0.16
    builder.cylinder((x - 0.02 * radius, y, z), (x + 0.3 * radius, y, z), 0.16 * radius, spinner, 0.03 * radius, 8)
    if disc:
        builder.cylinder((x + 0.08 * radius, y, z), (x + 0.10 * radius, y, z), radius, blade, sections=18)
        return
    for k in range(blades):
        with builder.placed((x + 0.09 * radius, y, z), rotation_about("x", turn + 360 * k / blades)):
            builder.box((0, 0, 0.55 * radius), (0.05 * radius, width, 0.9 * radius), blade, taper=(0.6, 0.6))


def gear(
    builder: Builder,
    top: tuple[float, float, float],
    length: float,
    radius: float,
    leg: str,
    tyre: str,
    pair: bool = True,
) -> None:
    """A leg below `top` with one wheel, or two beside it."""
    x, y, z = top
    low = z - length
    builder.cylinder(top, (x, y, low), radius * 0.22, leg, sections=5)
    for offset in (-0.7, 0.7) if pair else (0.0,):
        a, b = y + (offset - 0.3) * radius, y + (offset + 0.3) * radius
        builder.cylinder((x, a, low), (x, b, low), radius, tyre, sections=10)


def fin_sections(
    x: float,
    z: float,
    height: float,
    chord: float,
    taper: float,
    sweep: float,
    thick: float,
    y: float = 0.0,
    lean: float = 0.0,
) -> list[Section]:
    """A fin with its root's leading edge at (x, y, z); `sweep` and `lean` (outwards) are lengths at the tip."""
    return [
        Section((x, y, z), chord, thick * chord),
        Section((x - sweep, y + lean, z + height), chord * taper, thick * chord * taper),
    ]


def wing_sections(
    x: float,
    y: float,
    z: float,
    tip: tuple[float, float, float],
    chords: tuple[float, float],
    thick: float,
    kink: float = 0.0,
) -> list[Section]:
    """The left half of a wing from its root's leading edge to its tip's; `kink` makes the inner rear edge straight."""
    root = np.array([x, y, z])
    end = np.array(tip)
    sections = [Section((x, y, z), chords[0], thick * chords[0])]
    if kink:
        at = root + kink * (end - root)
        chord = chords[0] + kink * (chords[1] - chords[0])
        # With the rear edge unswept as far as the kink, the chord there is what the leading edge leaves.
        straight = chords[0] - (x - at[0])
        chord = min(chord, max(straight, chords[1])) if straight < chord else chord
        sections.append(Section((float(at[0]), float(at[1]), float(at[2])), chord, 0.8 * thick * chord))
    sections.append(Section(tip, chords[1], 0.7 * thick * chords[1]))
    return sections
