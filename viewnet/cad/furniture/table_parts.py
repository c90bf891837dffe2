"""Tops, materials, sizes and benches of tables. Units: metres."""

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.finishes import Finish, Finishes, jitter
from viewnet.cad.parts import block, choose, put, ring_faces

_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def outline(shape: str, length: float, width: float, rng: np.random.Generator) -> np.ndarray:
    """A table top's rim (K, 2), symmetric about both axes, counter-clockwise from above; `length` is along y.

    Shapes: rectangle, rounded, oval (ellipse), stadium (round ends), boat (bowed sides), octagon.
    """
    if shape == "rectangle":
        return _CORNERS * (width / 2, length / 2)
    if shape == "octagon":
        cut = float(rng.uniform(0.15, 0.3)) * width
        x, y = width / 2, length / 2
        return np.array(
            [
                [x, y - cut],
                [x - cut, y],
                [cut - x, y],
                [-x, y - cut],
                [-x, cut - y],
                [cut - x, -y],
                [x - cut, -y],
                [x, cut - y],
            ]
        )
    angle = 2 * np.pi * (np.arange(24) + 0.5) / 24
    if shape == "oval":
        return np.stack([np.cos(angle) * width / 2, np.sin(angle) * length / 2], 1)
    if shape == "boat":
        share = np.linspace(-1, 1, 7)
        bulge = width / 2 * (1 - float(rng.uniform(0.1, 0.3)) * share**2)
        right = np.stack([bulge, share * length / 2], 1)
        return np.concatenate([right, -right])
    radius = width / 2 if shape == "stadium" else float(rng.uniform(0.04, 0.16)) * width
    corner = np.sign(np.stack([np.cos(angle), np.sin(angle)], 1)) * (width / 2 - radius, length / 2 - radius)
    return corner + radius * np.stack([np.cos(angle), np.sin(angle)], 1)


def add_top(
    builder: Builder,
    rim: np.ndarray,
    top: float,
    thick: float,
    finish: Finish,
    bevel: float = 0.0,
    edge: Finish | None = None,
) -> None:
    """A table top with its upper side at height `top`; `bevel` insets the lower edge; `edge`: finish of its rim."""
    count = len(rim)
    low = np.column_stack([rim * (1 - bevel), np.full(count, top - thick)])
    high = np.column_stack([rim, np.full(count, top)])
    if edge is None:
        put(builder, np.concatenate([low, high]), ring_faces(2, count, True), finish)
        return
    put(builder, np.concatenate([low, high]), ring_faces(2, count, False), edge)
    fan = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    put(builder, high, fan, finish)
    put(builder, low, fan[:, ::-1], finish)


def table_materials(rng: np.random.Generator, fin: Finishes) -> tuple[Finish, Finish, Finish]:
    """(legs, thin members; top; rim) of a table: all wood, wood on metal, glass or stone on something, or painted."""
    kind = choose(rng, {"wood": 0.52, "metal": 0.2, "glass": 0.1, "stone": 0.06, "two": 0.12})
    plain, grained = fin.wood(0.22)
    if kind == "wood":
        return plain, grained, plain
    if kind == "metal":
        metal = fin.metal()
        return metal, (grained if rng.random() < 0.6 else fin.plastic()), plain if rng.random() < 0.5 else metal
    if kind == "two":
        other, board = fin.wood(0.1)
        return plain, board, other
    legs = plain if rng.random() < 0.4 else fin.metal()
    if kind == "glass":
        tint = [(0.72, 0.82, 0.84), (0.6, 0.7, 0.78), (0.85, 0.9, 0.9), (0.25, 0.3, 0.32), (0.55, 0.68, 0.64)][
            int(rng.integers(5))
        ]
        glass = fin.solid(jitter(rng, (tint[0], tint[1], tint[2])))
        return legs, glass, glass if rng.random() < 0.7 else legs
    stone = [(0.9, 0.9, 0.88), (0.2, 0.2, 0.22), (0.6, 0.56, 0.5), (0.45, 0.47, 0.46)][int(rng.integers(4))]
    slab = fin.solid(jitter(rng, (stone[0], stone[1], stone[2])))
    return legs, slab, slab


def table_sizes(rng: np.random.Generator) -> tuple[float, float, float]:
    """(length along y, width along x, height) of a dining, kitchen, coffee or side table."""
    use = choose(rng, {"dining": 0.55, "square": 0.15, "coffee": 0.2, "high": 0.1})
    if use == "dining":
        return float(rng.uniform(1.2, 2.3)), float(rng.uniform(0.75, 1.05)), float(rng.uniform(0.7, 0.78))
    if use == "square":
        side = float(rng.uniform(0.7, 1.1))
        return side * float(rng.choice([1.0, rng.uniform(1.0, 1.25)])), side, float(rng.uniform(0.68, 0.78))
    if use == "coffee":
        return float(rng.uniform(0.8, 1.4)), float(rng.uniform(0.5, 0.8)), float(rng.uniform(0.3, 0.5))
    side = float(rng.uniform(0.5, 0.75))
    return side * float(rng.uniform(1, 1.6)), side, float(rng.uniform(0.75, 1.05))


def benches(
    builder: Builder, rng: np.random.Generator, length: float, width: float, wood: Finish, board: Finish
) -> None:
    """A bench at each long side."""
    high, deep = float(rng.uniform(0.42, 0.47)), float(rng.uniform(0.25, 0.35))
    reach = length * float(rng.uniform(0.38, 0.48))
    for sign in (1.0, -1.0):
        x = sign * (width / 2 + 0.12 + deep / 2)
        block(builder, (x, 0, high - 0.02), (deep, 2 * reach, 0.04), board)
        block(builder, (x, reach * 0.85, (high - 0.04) / 2), (deep * 0.9, 0.05, high - 0.04), wood, mirror=True)
