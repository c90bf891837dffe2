"""Boats and ships: rowing, motor and sailing boats, yachts, fishing boats, tugs, freighters, liners, warships."""

from collections.abc import Callable

import numpy as np

from viewnet.cad import palette
from viewnet.cad.boat.hull import Hull, deckhouse, hull, mast_and_sails, outboard, railing, windscreen
from viewnet.cad.boat.ships import freighter, liner, warship
from viewnet.cad.builder import Builder

KINDS = {
    "rowing": 12, "motor": 20, "sail": 22, "cruiser": 14, "fishing": 8, "tug": 4, "freighter": 7, "liner": 4,
    "warship": 6, "raft": 3, "longship": 3,
}  # fmt: skip


def boat(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A boat or ship with its bow forward."""
    builder = Builder()
    kind = palette.pick(rng, KINDS, kind)
    makers: dict[str, Callable[[np.random.Generator, Builder, dict[str, str]], None]] = {
        "rowing": _rowing,
        "motor": _motor,
        "sail": _sail,
        "cruiser": _cruiser,
        "fishing": _fishing,
        "tug": _fishing,
        "freighter": freighter,
        "liner": liner,
        "warship": warship,
        "raft": _raft,
        "longship": _longship,
    }
    makers[kind](rng, builder, _materials(rng, builder, kind))
    return builder


def _materials(rng: np.random.Generator, builder: Builder, kind: str) -> dict[str, str]:
    wood = palette.jitter(rng, [(0.45, 0.29, 0.17), (0.60, 0.42, 0.24), (0.32, 0.19, 0.12)][int(rng.integers(3))], 0.03)
    wooden = kind == "longship" or rng.random() < {"rowing": 0.6, "sail": 0.25, "fishing": 0.25, "motor": 0.12}.get(
        kind, 0.0
    )
    draw = rng.random()
    side = (
        wood
        if wooden
        else palette.gray(rng, 0.85, 0.96)
        if draw < 0.55
        else palette.vivid(rng, 0.5, 0.25)
        if draw < 0.85
        else palette.gray(rng, 0.05, 0.3)
    )
    if kind == "warship":
        side = palette.jitter(rng, (0.48, 0.51, 0.54))
    if kind in ("freighter", "tug"):
        side = palette.vivid(rng, 0.5, 0.2) if rng.random() < 0.55 else palette.gray(rng, 0.05, 0.2)
    if kind == "raft":
        side = palette.vivid(rng, 0.6, 0.5) if rng.random() < 0.6 else palette.gray(rng, 0.2, 0.6)
    bottom = palette.jitter(rng, (0.55, 0.10, 0.08)) if rng.random() < 0.5 else palette.gray(rng, 0.05, 0.25)
    if wooden and rng.random() < 0.6:
        bottom = wood
    elif rng.random() < 0.25:
        bottom = side
    deck = palette.jitter(rng, (0.68, 0.52, 0.34)) if rng.random() < 0.45 else palette.gray(rng, 0.6, 0.9)
    house = palette.gray(rng, 0.84, 0.96) if rng.random() < 0.8 else palette.vivid(rng, 0.4, 0.4)
    if kind == "warship":
        deck, house, bottom = palette.gray(rng, 0.3, 0.4), palette.jitter(rng, (0.55, 0.58, 0.60)), (0.4, 0.12, 0.1)
    stripe = palette.vivid(rng, 0.6, 0.3) if rng.random() < 0.6 else side
    return {
        "side": builder.material("side", side),
        "bottom": builder.material("bottom", bottom),
        "stripe": builder.material("stripe", stripe),
        "deck": builder.material("deck", wood if wooden else deck),
        "inside": builder.material(
            "inside", palette.jitter(rng, np.array(wood) * 0.9) if wooden else palette.gray(rng, 0.55, 0.9)
        ),
        "wood": builder.material("wood", wood),
        "house": builder.material("house", house),
        "glass": builder.material("glass", palette.jitter(rng, (0.09, 0.11, 0.14), 0.03)),
        "dark": builder.material("dark", palette.gray(rng, 0.03, 0.15)),
        "metal": builder.material("metal", palette.metal(rng)),
        "accent": builder.material("accent", palette.vivid(rng, 0.6, 0.35)),
        "sail": builder.material(
            "sail", palette.gray(rng, 0.86, 0.97) if rng.random() < 0.75 else palette.vivid(rng, 0.3, 0.5)
        ),
        "seat": builder.material(
            "seat", palette.gray(rng, 0.75, 0.95) if rng.random() < 0.5 else palette.vivid(rng, 0.4, 0.3)
        ),
    }


def _rowing(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    length, beam = 4.0, rng.uniform(1.2, 1.9)
    depth = rng.uniform(0.45, 0.75)
    pointed = rng.random() < 0.25
    form = Hull(
        length,
        beam,
        depth,
        rng.uniform(0.05, 0.3),
        0.0 if pointed else rng.uniform(0.55, 0.85),
        rng.uniform(0.15, 0.45),
        True,
        floor=rng.uniform(0.2, 0.4),
    )
    hull(builder, form, c)
    for share in np.linspace(-0.3, 0.25, int(rng.integers(2, 4))):
        builder.box(
            (share * length, 0, 0.68 * depth),
            (0.24, form.beam_at(float(share) * length) * 0.9, 0.05),
            c["wood"] if rng.random() < 0.6 else c["seat"],
        )
    if rng.random() < 0.5:
        out = rng.uniform(0.6, 1.4)
        with builder.both_sides():
            foot, blade = (-0.3, beam * 0.2, depth * 1.1), (-0.3 - 0.4 * out, beam * 0.5 + out, 0.35 * depth)
            builder.tube([foot, blade], 0.03, c["wood"], 5)
            builder.box(blade, (0.12, 0.4, 0.04), c["wood"])
    if rng.random() < 0.25 and not pointed:
        outboard(builder, form, c)


def _motor(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    length, beam, depth = 6.0, rng.uniform(1.7, 2.4), rng.uniform(0.8, 1.2)
    form = Hull(
        length,
        beam,
        depth,
        rng.uniform(0.1, 0.3),
        rng.uniform(0.8, 0.98),
        rng.uniform(0.1, 0.5),
        True,
        floor=0.45,
        cockpit=(-0.46, rng.uniform(-0.02, 0.15)),
        vee=0.5,
    )
    hull(builder, form, c)
    windscreen(builder, form, c, rng.uniform(0.3, 0.6))
    start, end = form.cockpit
    for share in ((0.25, 0.75), (0.6,), (0.3, 0.55, 0.85))[int(rng.integers(3))]:
        x = (end - share * (end - start)) * length
        builder.box((x, 0, 0.55 * depth), (0.5, beam * 0.6, 0.4 * depth), c["seat"])
        builder.box((x - 0.25, 0, 0.8 * depth), (0.14, beam * 0.6, 0.5 * depth), c["seat"])
    if rng.random() < 0.6:
        outboard(builder, form, c, 2 if rng.random() < 0.25 else 1)
    if rng.random() < 0.2:
        arch_x = start * 0.5 * length
        points = [(arch_x, beam * 0.48, depth), (arch_x - 0.2, beam * 0.42, depth + 1.2)]
        builder.tube([*points, *[(x, -y, z) for x, y, z in reversed(points)]], 0.06, c["metal"], 5)
    if rng.random() < 0.25:
        builder.box((0.2, 0, depth + 1.4), (2.0, beam * 0.8, 0.08), c["sail"])
        for x in (-0.6, 1.0):
            with builder.both_sides():
                builder.cylinder(
                    (x, beam * 0.36, depth * 0.8), (x, beam * 0.36, depth + 1.4), 0.04, c["metal"], sections=4
                )


def _sail(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    length, beam = 9.0, rng.uniform(2.2, 3.0)
    depth = rng.uniform(1.0, 1.6)
    form = Hull(
        length,
        beam,
        depth,
        rng.uniform(0.1, 0.4),
        rng.uniform(0.3, 0.75),
        rng.uniform(0.3, 0.9),
        True,
        floor=0.6,
        cockpit=(-0.42, -0.12),
        vee=0.4,
    )
    hull(builder, form, c)
    builder.box((0.08 * length, 0, depth + 0.15), (0.36 * length, beam * 0.52, 0.45), c["house"], taper=(0.85, 0.85))
    with builder.both_sides():
        builder.box((0.08 * length, beam * 0.25, depth + 0.18), (0.26 * length, 0.06, 0.16), c["glass"])
    if rng.random() < 0.6:
        keel = [(0.1 * length, 0.1), (-0.12 * length, 0.1), (-0.08 * length, -1.3), (0.03 * length, -1.3)]
        builder.extrude(keel, "y", -0.08, 0.08, c["bottom"])
        builder.extrude(
            [(-0.42 * length, 0.2), (-0.48 * length, 0.2), (-0.47 * length, -0.8), (-0.44 * length, -0.8)],
            "y",
            -0.05,
            0.05,
            c["bottom"],
        )
    mast_and_sails(rng, builder, form, c)


def _cruiser(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    """Cabin cruisers and motor yachts with one to three decks."""
    decks = int(rng.integers(1, 4))
    length = (9.0, 14.0, 24.0)[decks - 1]
    beam, depth = length * rng.uniform(0.22, 0.32), length * rng.uniform(0.10, 0.15)
    form = Hull(
        length,
        beam,
        depth,
        rng.uniform(0.1, 0.3),
        rng.uniform(0.8, 0.98),
        0.05 * length * rng.uniform(0.4, 1.2),
        False,
        vee=0.5,
    )
    hull(builder, form, c)
    z, rear, front = depth * 0.92, -rng.uniform(0.2, 0.42), rng.uniform(0.12, 0.26)
    for deck in range(decks):
        tall = length * rng.uniform(0.065, 0.10) if decks > 1 else rng.uniform(0.9, 1.5)
        wide = beam * (0.72 - 0.1 * deck)
        deckhouse(
            builder, (rear * length, front * length), wide, z, tall, rng.uniform(0.6, 1.5) * tall, c, round_front=True
        )
        z += tall
        rear, front = rear + rng.uniform(0.0, 0.08), front - rng.uniform(0.08, 0.15)
        if front - rear < 0.12:
            break
    if rng.random() < 0.7:
        builder.cylinder(
            ((rear + front) / 2 * length, 0, z),
            ((rear + front) / 2 * length - 0.3, 0, z + 0.1 * length),
            0.006 * length,
            c["metal"],
            sections=5,
        )
    if rng.random() < 0.7:
        railing(builder, form, c, 0.07 * length if length < 20 else 0.045 * length)


def _fishing(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    """Fishing boats and tugs: high bow, wheelhouse, mast, rubbing strake."""
    length, beam, depth = 14.0, rng.uniform(4.0, 5.4), rng.uniform(1.9, 2.7)
    form = Hull(
        length, beam, depth, rng.uniform(0.15, 0.4), rng.uniform(0.55, 0.9), rng.uniform(0.8, 1.8), False, vee=0.3
    )
    hull(builder, form, c)
    forward = rng.random() < 0.6
    middle = rng.uniform(0.05, 0.2) if forward else -rng.uniform(0.2, 0.3)
    long, tall = length * rng.uniform(0.16, 0.28), rng.uniform(2.0, 2.8)
    a, b = middle * length - long / 2, middle * length + long / 2
    deckhouse(builder, (a, b), beam * rng.uniform(0.45, 0.7), depth * 0.9, tall, -0.1, c, round_front=False)
    builder.box(((a + b) / 2, 0, depth * 0.9 + tall + 0.08), (long * 1.15, beam * 0.7, 0.16), c["accent"])
    if rng.random() < 0.5:
        x = a - 0.4
        builder.cylinder((x, 0, depth), (x, 0, depth + tall + 1.2), 0.45, c["accent"], sections=10)
        builder.cylinder((x, 0, depth + tall + 1.2), (x, 0, depth + tall + 1.6), 0.46, c["dark"], sections=10)
    pole = rng.uniform(-0.35, 0.3) * length
    high = depth + rng.uniform(4, 7)
    builder.cylinder((pole, 0, depth), (pole, 0, high), 0.12, c["metal"], sections=5)
    if rng.random() < 0.6:
        builder.tube([(pole, 0, depth + 1.5), (pole - 0.25 * length, 0, high - 0.6)], 0.09, c["metal"], 5)
    with builder.both_sides():
        points = [
            (x * length, form.beam_at(x * length) / 2, form.rail_at(x * length)) for x in (-0.48, -0.2, 0.1, 0.3, 0.42)
        ]
        builder.tube(points, 0.14, c["dark"] if rng.random() < 0.5 else c["stripe"], 5)
    for _ in range(int(rng.integers(0, 4))):
        x = rng.uniform(-0.42, 0.3) * length
        if not a - 0.5 < x < b + 0.5:
            builder.box(
                (x, rng.uniform(-0.2, 0.2) * beam, depth + 0.3),
                (1.0, 0.9, 0.7),
                c["wood"] if rng.random() < 0.5 else c["accent"],
            )


def _raft(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    """Inflatables: a tube around a floor, open or closed at the stern, perhaps with an engine."""
    length, beam = 4.0, rng.uniform(1.6, 2.2)
    r = rng.uniform(0.2, 0.28)
    half = beam / 2 - r
    bow = [
        (length * x, half * y, r * (1 + z))
        for x, y, z in ((-0.5, 1, 0), (0.1, 1, 0), (0.3, 0.85, 0.3), (0.42, 0.5, 0.8), (0.47, 0, 1.1))
    ]
    names = [c["side"], c["side"]]
    builder.tube([*bow, *[(x, -y, z) for x, y, z in bow[-2::-1]]], r, names[0], 8)
    builder.box((-0.05 * length, 0, r * 0.6), (0.8 * length, 2 * half, 0.1), c["dark"])
    if rng.random() < 0.5:
        builder.box((-0.44 * length, 0, r * 1.3), (0.1, 2 * half, 2 * r), c["wood"])
        outboard(builder, Hull(length, beam, 2 * r, 0.0, 1.0, 0.0, True), c)
    else:
        builder.tube([(-0.46 * length, half, r), (-0.46 * length, -half, r)], r, c["side"], 8)
    for x in np.linspace(-0.25, 0.2, int(rng.integers(1, 4))) * length:
        builder.cylinder((float(x), -half, 1.2 * r), (float(x), half, 1.2 * r), 0.6 * r, c["seat"], sections=8)


def _longship(rng: np.random.Generator, builder: Builder, c: dict[str, str]) -> None:
    length, beam, depth = 16.0, rng.uniform(3.0, 4.2), rng.uniform(1.1, 1.5)
    form = Hull(length, beam, depth, 0.1, 0.0, rng.uniform(1.0, 1.8), True, floor=0.4, both_rise=True)
    hull(builder, form, c)
    for way, high in ((1, rng.uniform(1.2, 2.6)), (-1, rng.uniform(0.8, 2.2))):
        x = way * length * 0.49
        top = form.rail_at(x)
        builder.tube(
            [
                (x, 0, top - 0.8),
                (x + way * 0.5, 0, top + 0.5 * high),
                (x + way * 0.1, 0, top + high),
                (x + way * 0.6, 0, top + high),
            ],
            [0.3, 0.2, 0.16, 0.05],
            c["wood"],
            6,
        )
    shields = rng.random() < 0.6
    for x in np.linspace(-0.3, 0.3, 7) * length:
        y, z = form.beam_at(float(x)) / 2, form.rail_at(float(x))
        with builder.both_sides():
            if shields:
                builder.cylinder(
                    (float(x), y, z), (float(x), y + 0.1, z), 0.4, c["accent"] if int(x) % 2 else c["sail"], sections=8
                )
            else:
                builder.tube([(float(x), y * 0.8, z), (float(x) - 0.6, y + 2.2, 0.2)], 0.07, c["wood"], 4)
    tall = rng.uniform(5, 8)
    builder.cylinder((0, 0, 0.3), (0, 0, tall + 0.6), 0.14, c["wood"], sections=6)
    builder.cylinder((0.05, -2.6, tall), (0.05, 2.6, tall), 0.08, c["wood"], sections=5)
    stripes = 7
    ys = np.linspace(-2.4, 2.4, stripes + 1)
    for k in range(stripes):
        sheet = []
        for z, belly in ((tall, 0.1), (tall * 0.75, 0.8), (tall * 0.5, 0.9), (tall * 0.32, 0.5)):
            sheet += [(belly, ys[k], z), (belly, ys[k + 1], z)]
        faces = [f for r in range(3) for f in ((2 * r, 2 * r + 2, 2 * r + 3), (2 * r, 2 * r + 3, 2 * r + 1))]
        builder.add(sheet, faces, c["sail"] if k % 2 else c["accent"])
