"""Wheels and other parts of bicycles and motorbikes."""

from collections.abc import Sequence

import numpy as np

from viewnet.cad.builder import Array, Builder

Point = tuple[float, float, float]


def tyre(
    builder: Builder,
    x: float,
    z: float,
    radius: float,
    thick: float,
    name: str,
    sections: tuple[int, int] = (18, 5),
    wide: float = 1.0,
) -> None:
    """A torus in the plane y = 0: outer `radius`, cross-section of half-height `thick` and `wide` times that across."""
    turn = np.arange(sections[0]) * (2 * np.pi / sections[0])
    # A corner of the cross-section on the tread keeps the full radius.
    around = np.arange(sections[1]) * (2 * np.pi / sections[1])
    distance = radius - thick + thick * np.cos(around)
    across = thick * wide * np.sin(around)
    points = np.empty((sections[0], sections[1], 3))
    points[..., 0] = x + np.cos(turn)[:, None] * distance
    points[..., 1] = across
    points[..., 2] = z + np.sin(turn)[:, None] * distance
    i, j = np.meshgrid(np.arange(sections[0]), np.arange(sections[1]), indexing="ij")
    k, m = (i + 1) % sections[0], (j + 1) % sections[1]
    a, b, c, d = (p * sections[1] + q for p, q in ((i, j), (k, j), (k, m), (i, m)))
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    builder.add(points.reshape(-1, 3), faces[:, ::-1], name)


def spokes(
    builder: Builder,
    x: float,
    z: float,
    radius: float,
    half: float,
    name: str,
    count: int,
    width: float,
    turn: float = 0.0,
) -> None:
    """Flat spokes from the hub (of half-width `half`) to the rim, alternately from the left and the right flange."""
    for k in range(count):
        a = turn + 2 * np.pi * k / count
        along = np.array([np.cos(a), 0.0, np.sin(a)])
        side = np.array([-np.sin(a), 0.0, np.cos(a)]) * width / 2
        hub = np.array([x, half if k % 2 else -half, z]) + along * 0.04
        rim = np.array([x, 0.0, z]) + along * radius
        builder.quad([hub - side, rim - side, rim + side, hub + side], name)


def disc(
    builder: Builder, x: float, y: float, z: float, radius: float, thick: float, name: str, sections: int = 12
) -> None:
    """A round plate in the plane of the wheels."""
    builder.cylinder((x, y - thick / 2, z), (x, y + thick / 2, z), radius, name, sections=sections)


def fender(
    builder: Builder,
    x: float,
    z: float,
    radius: float,
    wide: float,
    span: tuple[float, float],
    name: str,
    steps: int = 6,
) -> None:
    """A mudguard over a wheel between two angles (degrees from the front, over the top)."""
    angles = np.deg2rad(np.linspace(span[0], span[1], steps + 1))
    rings = []
    for a in angles:
        direction = np.array([np.cos(a), 0.0, np.sin(a)])
        middle = np.array([x, 0.0, z])
        shape: Sequence[tuple[float, float]] = [(-1, 0.93), (-0.8, 1.0), (0.8, 1.0), (1, 0.93)]
        rings.append([middle + direction * radius * r + np.array([0, wide / 2 * y, 0]) for y, r in shape])
    builder.loft(rings, name, caps=False)


def blob(
    builder: Builder,
    stations: Sequence[tuple[float, float, float, float]],
    name: str | Sequence[str],
    points: int = 8,
    square: float = 2.5,
) -> None:
    """A body along x through (x, z of the middle, half-width, half-height), of rounded cross-section."""
    angle = (np.arange(points) + 0.5) * (2 * np.pi / points)
    c, s = np.cos(angle), np.sin(angle)
    y, z = np.sign(c) * np.abs(c) ** (2 / square), np.sign(s) * np.abs(s) ** (2 / square)
    rings: list[Array] = []
    for x, height, half, tall in stations:
        rings.append(np.stack([np.full(points, x), y * half, height + z * tall], -1))
    builder.loft(rings, name if isinstance(name, str) else list(name))


def mix(a: Point, b: Point, share: float) -> Point:
    """The point at a share of the way from a to b."""
    x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z
