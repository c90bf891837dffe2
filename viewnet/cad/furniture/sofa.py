"""Sofas of one to four seats: upholstered, chesterfield, open frames, without arms, settees, corner sofas. Metres."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.chair.frames import cross_bar, four_legs, stretchers
from viewnet.cad.chair.soft import tub
from viewnet.cad.finishes import Finishes
from viewnet.cad.parts import BackSurface, bar, block, choose, cushion, patch, pillow, rail, shell, sweep
from viewnet.cad.upholstery import (
    Body,
    add_arms,
    add_back,
    back_cushions,
    pillows,
    random_body,
    seat_cushions,
    soft_legs,
    upholstered,
)

Kind = Callable[[Builder, np.random.Generator, Finishes], None]


def _seats(rng: np.random.Generator) -> int:
    return int(rng.choice([1, 2, 3, 4], p=[0.08, 0.42, 0.43, 0.07]))


def standard(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A closed upholstered sofa."""
    upholstered(builder, rng, fin, _seats(rng), float(rng.uniform(0.5, 0.8)))


def chesterfield(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Arms as high as the back, rolled outwards and tufted."""
    cover = fin.leather() if rng.random() < 0.7 else fin.fabric(0.1)
    seats = int(rng.choice([2, 3], p=[0.45, 0.55]))
    body = replace(random_body(rng, float(rng.uniform(0.52, 0.68)), seats), lean=float(rng.uniform(0.0, 0.05)))
    high = body.seat + float(rng.uniform(0.24, 0.36))
    body = replace(
        body, arm=float(rng.uniform(0.14, 0.22)), arm_top=high, back=high, clear=float(rng.uniform(0.04, 0.14))
    )
    thick = float(rng.uniform(0.1, 0.16))
    base = body.seat - thick * 0.85
    block(builder, (0, 0, (base + body.clear) / 2), (body.depth - 0.03, body.inner + 0.02, base - body.clear), cover)
    add_arms(builder, rng, body, "rolled", cover, cover)
    add_back(builder, rng, body, "straight", cover, body.inner + body.arm)
    roll = body.arm * 0.5
    y = body.inner / 2 + body.arm * 0.6
    x = -body.depth / 2 + body.back_thick * 0.35 - body.lean
    bar(builder, (x, -y, high - roll), (x, y, high - roll), roll, cover, "fine", side=(0, 0, 1))
    seat_cushions(builder, body, seats if rng.random() < 0.6 else 1, thick, cover, 0.01)
    button = fin.dark() if rng.random() < 0.5 else fin.solid((0.2, 0.1, 0.08))
    columns = 3 * seats
    for row in range(2):
        for k in range(columns - row):
            side = ((k + 0.5 + 0.5 * row) / columns - 0.5) * body.inner
            z = body.seat + (high - body.seat) * (0.3 + 0.35 * row)
            block(builder, (-body.depth / 2 + body.back_thick, side, z), (0.03, 0.025, 0.025), button)
    soft_legs(
        builder,
        rng,
        fin,
        body.inner / 2 + body.arm * 0.9,
        body.depth / 2,
        body.clear,
        choose(rng, {"block": 1, "taper": 2}),
    )


def framed(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Loose cushions in an open frame of wood or metal: tube cube, slatted wooden sides, or a futon."""
    metal = rng.random() < 0.45
    frame = fin.metal() if metal else fin.wood(0.15)[0]
    cover = fin.upholstery()
    seats = _seats(rng)
    inner = seats * float(rng.uniform(0.52, 0.7))
    depth, seat_top = float(rng.uniform(0.68, 0.88)), float(rng.uniform(0.38, 0.46))
    arm_top, back_top = seat_top + float(rng.uniform(0.12, 0.24)), seat_top + float(rng.uniform(0.28, 0.48))
    thick = float(rng.uniform(0.1, 0.2))
    lean = float(rng.uniform(0.03, 0.2))
    x, y = depth / 2, inner / 2 + 0.035
    section = "round" if metal and rng.random() < 0.6 else "square"
    half = 0.016 if metal else float(rng.uniform(0.02, 0.032))
    board = half if metal else float(rng.uniform(0.02, 0.05))
    for post_x, top in ((x - half, arm_top), (half - x, arm_top if rng.random() < 0.5 else back_top - 0.05)):
        bar(builder, (post_x, y, 0), (post_x, y, top), half, frame, section, mirror=True)
    sweep(builder, [[-x - 0.02, y, arm_top], [x + 0.01, y, arm_top]], (board, half * 0.8), frame, section, mirror=True)
    under = seat_top - thick
    bar(builder, (-x, y, under), (x, y, under), (half * 0.7, half), frame, section, mirror=True)
    for spot in (x - half, half - x):
        cross_bar(builder, spot, under, y, (half, half * 0.7), frame, section)
    if not metal and rng.random() < 0.5:
        for k in range(int(rng.integers(3, 7))):
            slat_x = -x * 0.75 + k * depth * 0.75 / 6
            bar(builder, (slat_x, y, under), (slat_x, y, arm_top), 0.009, frame, mirror=True)
    surface = BackSurface(-x + 0.03, under, back_top - under, inner / 2, inner / 2, lean)
    rail(builder, surface, 1.0, (half, half * 0.8), frame, reach=1.03, points=2, section=section)
    bar(builder, surface.at(1.03, 0), surface.at(1.03, 1), half * 0.8, frame, section, mirror=True)
    # Slats or bars are visible behind the cushions.
    if rng.random() < 0.6:
        count = int(rng.integers(4, 8)) * seats
        for u in np.linspace(-0.95, 0.95, count):
            bar(builder, surface.at(u, 0), surface.at(u, 1), (0.012, 0.006), frame)
    elif rng.random() < 0.6:
        for t in (0.35, 0.65):
            rail(builder, surface, t, (0.03, 0.008), frame, points=2)
    body = Body(inner, depth, 0.07, seat_top, arm_top, back_top, 0.1, 0.06, lean)
    futon = rng.random() < 0.25
    count = 1 if futon else seats
    seat_cushions(builder, body, count, thick, cover, 0.0)
    high = (back_top - seat_top) * float(rng.uniform(0.95, 1.25))
    back_cushions(builder, body, count, float(rng.uniform(0.1, 0.17)), high, cover, lean + 0.08)
    if rng.random() < 0.3:
        pillows(builder, rng, fin, body, seats)


def armless(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A sofa bed or bench without arms: a thick seat, a leaning back of the same width, on feet or a box."""
    cover = fin.upholstery()
    seats = int(rng.choice([2, 3], p=[0.5, 0.5]))
    width, depth = seats * float(rng.uniform(0.6, 0.75)), float(rng.uniform(0.72, 0.95))
    seat_top, tall = float(rng.uniform(0.34, 0.44)), float(rng.uniform(0.34, 0.55))
    clear = float(rng.choice([0.02, rng.uniform(0.1, 0.2)]))
    thick = float(rng.uniform(0.12, 0.2))
    edge = float(rng.uniform(0.5, 0.85))
    cushion(builder, (0.02, 0, seat_top - thick / 2), (depth, width, thick), cover, 0.04, edge, rows=5, columns=9)
    back_thick = float(rng.uniform(0.1, 0.18))
    surface = BackSurface(
        -depth / 2 + 0.05, seat_top - 0.08, tall + 0.08, width / 2, width / 2, tall * float(rng.uniform(0.1, 0.45))
    )
    flat = patch(5, 9, 0.05)
    shell(builder, surface.at(flat[..., 1], (flat[..., 0] + 1) / 2)[::-1], pillow(5, 9, back_thick, edge), cover)
    low = max(seat_top - thick, clear + 0.03)
    under = fin.dark() if rng.random() < 0.4 else fin.wood(0.1)[0] if rng.random() < 0.5 else cover
    block(builder, (0, 0, (low + clear) / 2 + 0.01), (depth * 0.92, width * 0.97, low - clear + 0.02), under)
    body = Body(width, depth, 0.0, seat_top, seat_top, seat_top + tall, clear, back_thick, 0.1)
    if clear > 0.05:
        soft_legs(builder, rng, fin, width / 2 - 0.03, depth / 2 - 0.04, clear)
    if rng.random() < 0.3:
        pillows(builder, rng, fin, body, seats)
    if rng.random() < 0.2:
        roll = float(rng.uniform(0.07, 0.1))
        ends = [[-depth * 0.3, width / 2 - roll, seat_top + roll], [depth * 0.42, width / 2 - roll, seat_top + roll]]
        sweep(builder, ends, roll, cover, "fine", mirror=True)


def settee(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A period bench for two or three: show-wood frame, arched back, open or stuffed arms, turned or cabriole legs."""
    frame = fin.wood(0.2)[0] if rng.random() < 0.75 else fin.solid((0.76, 0.6, 0.28))
    cover = fin.fabric(0.45)
    width, depth, top = float(rng.uniform(1.1, 1.75)), float(rng.uniform(0.52, 0.66)), float(rng.uniform(0.4, 0.47))
    half = float(rng.uniform(0.02, 0.03))
    style = choose(rng, {"cabriole": 0.4, "turned": 0.3, "tapered": 0.3})
    lines = four_legs(builder, rng, style, width, depth, top - 0.06, half, frame, 0.01, 0.03, int(rng.integers(3)))
    if rng.random() < 0.2:
        stretchers(builder, rng, "box", *lines, top, 0.014, frame)
    block(builder, (0, 0, top - 0.06), (depth, width, 0.06), frame)
    cushion(
        builder,
        (0.01, 0, top),
        (depth * 0.97, width * 0.97, float(rng.uniform(0.1, 0.18))),
        cover,
        0.04,
        0.5,
        columns=8,
    )
    tall = float(rng.uniform(0.4, 0.56))
    crown = float(rng.uniform(0.05, 0.3))
    surface = BackSurface(
        -depth / 2 + 0.03, top, tall, width / 2 - half, width / 2, tall * float(rng.uniform(0.1, 0.3))
    )
    u = np.linspace(-1, 1, 11)
    bumps = np.cos(u * np.pi / 2) ** 1.2 if rng.random() < 0.6 else 0.5 - 0.5 * np.cos(2 * np.pi * u)
    ceiling = 1 - crown * (1 - bumps)
    sweep(builder, surface.at(u, ceiling), half * 0.9, frame, "soft", side=(1, 0, 0))
    t = np.linspace(0.08, 1, 5)[:, None]
    grid = surface.at(u[None] * 0.97, t * (ceiling[None] - 0.03))
    shell(builder, grid[::-1], pillow(5, 11, float(rng.uniform(0.05, 0.1)), 0.4), cover)
    bar(builder, surface.at(1.0, 0), surface.at(1.0, float(ceiling[0])), half, frame, mirror=True)
    high = top + float(rng.uniform(0.18, 0.26))
    reach = depth * float(rng.uniform(0.25, 0.45))
    back_at = surface.at(1.0, (high - top) / tall)
    path = np.stack([back_at, [0, width / 2 + 0.03, high], [reach, width / 2 + 0.02, high - 0.03]])
    sweep(builder, path, (half * 1.1, half * 0.8), frame, "soft", mirror=True)
    bar(builder, (reach - 0.03, width / 2 - 0.01, top - 0.02), path[-1], half * 0.9, frame, "round", mirror=True)
    if rng.random() < 0.5:
        ends = np.array(
            [[back_at[0], width / 2 - 0.02, (top + high) / 2], [reach - 0.03, width / 2 - 0.02, (top + high) / 2]]
        )
        sweep(builder, ends, (0.02, (high - top) / 2), cover, mirror=True)


def curved(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A sofa whose back runs round into the arms."""
    tub(builder, rng, fin, width=float(rng.uniform(1.2, 2.0)), deep=float(rng.uniform(1.05, 1.3)))


def corner(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A sofa with a chaise or a full wing on one side: the one kind that is not symmetric."""
    cover = fin.leather() if rng.random() < 0.35 else fin.fabric(0.12)
    inside = cover if rng.random() < 0.75 else fin.upholstery()
    seats = int(rng.choice([2, 3], p=[0.4, 0.6]))
    each = float(rng.uniform(0.6, 0.75))
    body = random_body(rng, each, seats + 1)
    body = replace(
        body, depth=float(rng.uniform(0.8, 0.95)), lean=float(rng.uniform(0, 0.06)), arm=float(rng.uniform(0.1, 0.22))
    )
    side = float(rng.choice([-1.0, 1.0]))
    long = body.depth + float(rng.uniform(0.4, 0.9))
    thick = float(rng.uniform(0.11, 0.18))
    base = body.seat - thick * 0.85
    wing = rng.random() < 0.35
    y_wing = side * (body.inner / 2 - each / 2)
    tall = base - body.clear
    block(builder, (0, 0, body.clear + tall / 2), (body.depth - 0.02, body.inner, tall), cover)
    extra = long - body.depth
    x_extra = body.depth / 2 + extra / 2 - 0.01
    block(builder, (x_extra, y_wing, body.clear + tall / 2), (extra, each, tall), cover)
    add_back(builder, rng, body, choose(rng, {"straight": 0.6, "slab": 0.4}), cover, body.inner)
    rear = -body.depth / 2
    arm_half = body.arm / 2
    # The arm at the short side, and on the long side an arm, a wing of the back, or nothing.
    middle = -side * (body.inner / 2 + arm_half)
    height = body.arm_top - body.clear
    block(builder, (0, middle, body.clear + height / 2), (body.depth, body.arm, height), cover)
    far = side * (body.inner / 2 + arm_half)
    if wing:
        full = body.back - body.clear - 0.02
        block(builder, (rear + long / 2, far, body.clear + full / 2), (long, body.arm * 1.2, full), cover)
    elif rng.random() < 0.7:
        length = body.depth if rng.random() < 0.5 else long
        block(builder, (rear + length / 2, far, body.clear + height / 2), (length, body.arm, height), cover)
    front = body.depth / 2
    start = rear + body.back_thick * 0.8
    for k in range(seats + 1):
        y = ((k - seats / 2) * each) * -side
        end = rear + long if k == seats else front
        size = (end - start, each * 0.985, thick * 1.08)
        cushion(builder, ((start + end) / 2, y, body.seat - thick / 2), size, inside, 0.05, 0.65)
    back_cushions(builder, body, seats + 1, float(rng.uniform(0.12, 0.2)), (body.back - body.seat) * 1.05, inside, 0.2)
    if body.clear > 0.025:
        foot = fin.wood(0.2)[0] if rng.random() < 0.6 else fin.metal()
        reach = body.inner / 2 - 0.03
        spots = [
            (rear + 0.06, reach),
            (rear + 0.06, -reach),
            (front - 0.06, -side * reach),
            (rear + long - 0.06, side * reach),
            (rear + long - 0.06, side * (body.inner / 2 - each + 0.05)),
        ]
        for x, y in spots:
            block(builder, (x, y, body.clear / 2), (0.05, 0.05, body.clear), foot)
    if rng.random() < 0.35:
        pillows(builder, rng, fin, body, seats + 1)


KINDS: dict[str, tuple[float, Kind]] = {
    "standard": (0.53, standard),
    "chesterfield": (0.08, chesterfield),
    "framed": (0.12, framed),
    "armless": (0.07, armless),
    "settee": (0.06, settee),
    "curved": (0.05, curved),
    "corner": (0.09, corner),
}


def sofa(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A sofa of a random kind, or of the given one (a key of KINDS). Raises KeyError for another."""
    builder = Builder()
    chosen = choose(rng, {name: weight for name, (weight, _) in KINDS.items()})
    KINDS[kind or chosen][1](builder, rng, Finishes(builder, rng))
    return builder
