"""Chairs with wooden frames; other kinds are in the modules modern, soft and rare. Units: metres."""

from collections.abc import Callable

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.chair import modern, rare, soft
from viewnet.cad.chair.frames import (
    BACK_FILLS,
    LegLine,
    cross_bar,
    fill_back,
    four_legs,
    leg,
    seat,
    seat_grid,
    stretchers,
    wooden_arms,
)
from viewnet.cad.chair.reclining import lounge
from viewnet.cad.finishes import Finishes
from viewnet.cad.parts import BackSurface, bar, choose, patch, pillow, rail, shell, sweep, turned

Kind = Callable[[Builder, np.random.Generator, Finishes], None]


def _frame_chair(
    builder: Builder,
    rng: np.random.Generator,
    fin: Finishes,
    width: float,
    depth: float,
    top: float,
    tall: float,
    fills: dict[str, float],
) -> None:
    """A chair whose rear legs continue as back posts; width, depth of the seat, its height and the back's above it."""
    plain, grained = fin.wood()
    if rng.random() < 0.12:
        plain = grained = fin.metal()
    cover = fin.upholstery()
    if rng.random() < 0.08:
        cover = fin.cane()
    fill = choose(rng, fills)
    half = float(rng.uniform(0.014, 0.026)) * (1.25 if rng.random() < 0.15 else 1)
    wide = width / 2 * float(rng.uniform(0.8, 1.0)) - half
    surface = BackSurface(
        x0=-depth / 2 + half,
        z0=top,
        height=tall,
        half0=wide,
        half1=wide * float(rng.choice([1.0, rng.uniform(0.85, 1.1)])),
        lean=tall * float(rng.uniform(0.0, 0.25)),
        bow=tall * float(rng.choice([0.0, rng.uniform(0, 0.1)])),
        dish=float(rng.choice([0.0, rng.uniform(0.01, 0.06)])),
    )
    post_section = choose(rng, {"square": 0.75, "round": 0.25})
    up = np.linspace(0, 1, 4 if surface.bow or post_section == "round" else 3)
    posts = surface.at(1.0, up)
    back_splay = float(rng.uniform(0, 0.09))
    foot = posts[0] + np.array([-back_splay, float(rng.choice([0, rng.uniform(0, 0.02)])), -top])
    path = np.concatenate([[foot], posts])
    finial = 1.0 if rng.random() < 0.8 else 0.85
    thick = np.full((len(path), 2), half)
    thick[0], thick[-1] = half * 0.85, half * finial * 0.8
    sweep(builder, path, thick, plain, post_section, mirror=True, upright=post_section == "square")
    if rng.random() < 0.1:
        turned(
            builder,
            posts[-1],
            posts[-1] + [0, 0, 0.05],
            [(0, 0.6 * half), (0.5, 1.2 * half), (1, 0.3 * half)],
            plain,
            mirror=True,
        )
    style = choose(
        rng, {"square": 0.38, "tapered": 0.24, "round": 0.1, "turned": 0.16, "dowel": 0.06, "cabriole": 0.06}
    )
    leg_top = np.array([depth / 2 - half, width / 2 - half - 0.004, top - 0.02])
    spread = float(rng.choice([0.0, rng.uniform(0, 0.05)]))
    front = LegLine(leg_top, leg_top * (1, 1, 0) + np.array([spread, spread * 0.5, 0]))
    leg(builder, front, style, half, plain, int(rng.integers(3)))
    rear = LegLine(posts[0], foot)
    thick_seat = float(rng.uniform(0.02, 0.035))
    seat_style = choose(rng, {"board": 0.3, "saddle": 0.1, "pad": 0.28, "dropin": 0.24, "slats": 0.08})
    if fill in ("upholstered", "cane"):
        seat_style = choose(rng, {"pad": 0.6, "dropin": 0.4})
    if seat_style in ("pad", "dropin"):
        thick_seat = float(rng.uniform(0.035, 0.085))
    overhang = float(rng.uniform(0, 0.02))
    size = (width + 2 * overhang, depth + overhang, thick_seat)
    taper = max(0.0, 1 - (wide + half) * 2 / width) * float(rng.uniform(0.6, 1.1))
    rounded = float(rng.choice([0.0, rng.uniform(0.02, 0.25)]))
    seat(
        builder,
        seat_style,
        size,
        top + thick_seat / 2,
        cover if seat_style in ("pad", "dropin") else grained,
        plain,
        taper,
        rounded,
    )
    under = top - thick_seat / 2
    if rng.random() < 0.75:
        deep = float(rng.uniform(0.02, 0.04))
        z = under - deep
        cross_bar(builder, float(leg_top[0]), z, float(leg_top[1]), (deep, 0.009), plain)
        cross_bar(builder, float(posts[0][0]), z, wide, (deep, 0.009), plain)
        ends = (front.at(z), rear.at(z))
        bar(builder, ends[0], ends[1], (0.009, deep), plain, mirror=True)
    bars = choose(
        rng,
        {"none": 0.42, "h": 0.18, "box": 0.16, "high": 0.16, "ladder": 0.08}
        if top < 0.55
        else {"box": 0.5, "high": 0.35, "ladder": 0.15},
    )
    stretchers(
        builder,
        rng,
        bars,
        front,
        rear,
        top,
        float(rng.uniform(0.008, 0.014)),
        plain,
        choose(rng, {"square": 0.6, "coarse": 0.4}),
    )
    fill_back(builder, rng, fill, surface, plain, grained, cover)
    if seat_style in ("board", "saddle", "slats") and rng.random() < 0.2:
        grid = seat_grid(width * 0.86, depth * 0.86, top + thick_seat + 0.01, taper, 0.2)
        shell(builder, grid, pillow(5, 7, 0.04, 0.4), cover if cover != plain else fin.fabric())
    if rng.random() < (0.25 if top < 0.55 else 0.12) and tall > 0.35:
        wooden_arms(builder, rng, surface, width, depth, top, plain, cover if rng.random() < 0.3 else None)


def kitchen(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A wooden (sometimes metal) dining chair."""
    width, depth = float(rng.uniform(0.39, 0.5)), float(rng.uniform(0.37, 0.47))
    tall = float(rng.uniform(0.38, 0.58)) if rng.random() < 0.8 else float(rng.uniform(0.58, 0.75))
    _frame_chair(builder, rng, fin, width, depth, float(rng.uniform(0.42, 0.48)), tall, BACK_FILLS)


def bar_chair(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A high chair of the frame kind, with foot rests, or a stool with a low back."""
    width, depth = float(rng.uniform(0.34, 0.44)), float(rng.uniform(0.33, 0.42))
    low = rng.random() < 0.55
    tall = float(rng.uniform(0.14, 0.28)) if low else float(rng.uniform(0.28, 0.45))
    fills = {"top": 0.3, "two": 0.2, "panel": 0.2, "upholstered": 0.2, "slats": 0.1} if low else BACK_FILLS
    top = float(rng.uniform(0.58, 0.78)) if rng.random() < 0.75 else float(rng.uniform(0.36, 0.46))
    _frame_chair(builder, rng, fin, width, depth, top, tall, fills)


def antique(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A period chair: framed, upholstered, often oval or arched back, turned or cabriole legs, open arms."""
    if rng.random() < 0.3:
        frame = fin.solid((0.78, 0.6, 0.25) if rng.random() < 0.5 else (0.9, 0.88, 0.82))
    else:
        frame = fin.wood(0.1)[0]
    cover = fin.cane() if rng.random() < 0.15 else fin.fabric(0.45)
    width, depth, top = float(rng.uniform(0.46, 0.6)), float(rng.uniform(0.42, 0.52)), float(rng.uniform(0.4, 0.47))
    tall = float(rng.uniform(0.45, 0.7))
    half = float(rng.uniform(0.017, 0.026))
    style = choose(rng, {"cabriole": 0.5, "turned": 0.3, "tapered": 0.2})
    front, rear = four_legs(
        builder, rng, style, width, depth, top - 0.04, half, frame, 0.01, 0.02, int(rng.integers(3))
    )
    if rng.random() < 0.3:
        stretchers(builder, rng, choose(rng, {"h": 0.7, "box": 0.3}), front, rear, top, 0.011, frame)
    taper = float(rng.uniform(0.1, 0.25))
    shell(builder, seat_grid(width, depth, top - 0.035, taper, 0.15), 0.06, frame)
    thick = float(rng.uniform(0.06, 0.12))
    shell(builder, seat_grid(width * 0.93, depth * 0.93, top + 0.01, taper, 0.2), pillow(5, 7, thick, 0.35, 3), cover)
    wide = width / 2 * float(rng.uniform(0.72, 0.9))
    surface = BackSurface(
        -depth / 2 + 0.03,
        top + 0.02,
        tall,
        wide,
        wide,
        tall * float(rng.uniform(0.12, 0.28)),
        dish=float(rng.uniform(0, 0.05)),
    )
    shape = choose(rng, {"oval": 0.4, "arch": 0.35, "square": 0.25})
    bottom = float(rng.uniform(0.1, 0.22))
    if shape == "oval":
        angle = np.linspace(0, 2 * np.pi, 17)
        outline = np.stack([np.sin(angle), (1 + bottom) / 2 - (1 - bottom) / 2 * np.cos(angle)], 1)
        roundness = 1.0
        bar(builder, surface.at(0.55, -0.02), surface.at(0.5, bottom + 0.05), half, frame, mirror=True)
    else:
        crown = float(rng.uniform(0.05, 0.16)) if shape == "arch" else 0.0
        u = np.linspace(-1, 1, 9)
        arc = np.stack([u, 1 - crown * u**2], 1)
        outline = np.concatenate([[[-1, bottom]], arc, [[1, bottom], [-1, bottom]]])
        roundness = 0.0
        bar(builder, surface.at(0.97, -0.02), surface.at(1.0, bottom), half, frame, mirror=True)
    sweep(builder, surface.at(outline[:, 0], outline[:, 1]), half * 0.95, frame, side=(1, 0, 0))
    rounded = patch(5, 7, roundness)
    u, t = rounded[..., 1], (rounded[..., 0] + 1) / 2
    ceiling = 1.0 if roundness else 1 - (crown * u**2)
    grid = surface.at(u * 0.97, bottom + (ceiling - bottom) * t)
    shell(
        builder,
        grid[::-1],
        pillow(5, 7, float(rng.uniform(0.03, 0.07)), 0.35, 2.5),
        cover,
        cover if rng.random() < 0.6 else fin.fabric(0),
    )
    if rng.random() < 0.55:
        wooden_arms(builder, rng, surface, width, depth, top, frame, cover if rng.random() < 0.6 else None)


def windsor(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A saddle seat on splayed legs, with spindles in a hoop or under a comb, an arm bow, sometimes on rockers."""
    plain, grained = fin.wood(0.25)
    width, depth, top = float(rng.uniform(0.42, 0.54)), float(rng.uniform(0.4, 0.48)), float(rng.uniform(0.41, 0.46))
    tall = float(rng.uniform(0.4, 0.72))
    rocking = rng.random() < 0.25
    turning = int(rng.integers(3))
    lines = []
    for sign in (1.0, -1.0):
        high = np.array([sign * (depth / 2 - 0.09), width / 2 - 0.1, top])
        low = np.array([sign * (depth / 2 - 0.02), width / 2 - 0.02, 0.05 if rocking else 0.0])
        lines.append(LegLine(high, low))
        leg(builder, lines[-1], "turned" if rng.random() < 0.7 else "dowel", 0.021, plain, turning)
    stretchers(builder, rng, "h" if rng.random() < 0.8 else "box", lines[0], lines[1], top, 0.011, plain, "coarse")
    if rocking:
        x = np.linspace(-depth * 0.85, depth * 0.75, 7)
        path = np.stack([x, np.full(7, width / 2 - 0.02), 0.03 + 0.11 * (x / depth) ** 2 * 1.2], 1)
        sweep(builder, path, (0.012, 0.02), plain, mirror=True)
    shell(builder, seat_grid(width, depth, top, 0.12, 0.45, 0.025), 0.04, grained)
    surface = BackSurface(
        -depth / 2 + 0.04,
        top + 0.01,
        tall,
        width * 0.4,
        width * float(rng.uniform(0.38, 0.5)),
        tall * float(rng.uniform(0.15, 0.32)),
        dish=float(rng.uniform(0.02, 0.07)),
    )
    count = int(rng.integers(5, 10))
    spots = np.linspace(-1, 1, count + 2)[1:-1]
    if rng.random() < 0.55:
        angle = np.linspace(-np.pi / 2, np.pi / 2, 11)
        power = float(rng.uniform(0.5, 1.0))
        bend = np.stack([np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** 0.8, np.cos(angle) ** power], 1)
        sweep(builder, surface.at(bend[:, 0], bend[:, 1]), 0.012, plain, "coarse", side=(1, 0, 0))
        ends = np.clip((1 - np.abs(spots) ** 2.5) ** (power / 2), 0.2, 1)
    else:
        bar(builder, surface.at(0.97, -0.02), surface.at(1.0, 0.97), 0.013, plain, "coarse", mirror=True)
        rail(
            builder,
            surface,
            0.95,
            (float(rng.uniform(0.025, 0.05)), 0.01),
            plain,
            reach=1.08,
            arch=float(rng.uniform(0, 0.05)),
        )
        ends = np.full(count, 0.95)
    for u, end in zip(spots, ends, strict=True):
        bar(builder, surface.at(u * 0.85, 0), surface.at(u, end), 0.007, plain, "coarse")
    if rng.random() < 0.5:
        wooden_arms(builder, rng, surface, width, depth, top, plain)


def bentwood(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A café chair: round seat, thin bent members, a hoop back, sometimes continuing into arms."""
    frame, board = fin.wood(0.35)
    if rng.random() < 0.25:
        frame = fin.metal()
    cover = fin.cane() if rng.random() < 0.4 else (fin.upholstery() if rng.random() < 0.4 else board)
    width, top = float(rng.uniform(0.4, 0.48)), float(rng.uniform(0.43, 0.47))
    depth = width * float(rng.uniform(0.92, 1.0))
    shell(builder, seat_grid(width, depth, top - 0.02, 0.0, 1.0), 0.04, frame)
    shell(builder, seat_grid(width * 0.86, depth * 0.86, top + 0.004, 0.0, 1.0), pillow(5, 7, 0.03, 0.3), cover)
    half = float(rng.uniform(0.011, 0.016))
    front = LegLine(np.array([depth * 0.33, width * 0.36, top]), np.array([depth * 0.45, width * 0.44, 0]))
    leg(builder, front, "round", half * 1.3, frame)
    tall, lean = float(rng.uniform(0.38, 0.5)), float(rng.uniform(0.05, 0.13))
    if rng.random() < 0.4:
        high = top + float(rng.uniform(0.22, 0.34))
        share = np.linspace(0, 1, 13)
        angle = np.pi * (share - 0.5) * 1.55
        hoop = np.stack(
            [-np.cos(angle) * depth * 0.55 - 0.02, np.sin(angle) * width * 0.6, high + 0.1 * np.cos(angle)], 1
        )
        sweep(builder, hoop, half, frame, "coarse", side=(0, 0, 1))
        bar(builder, hoop[-1], [hoop[-1][0] - 0.05, width * 0.44, top - 0.02], half, frame, "coarse", mirror=True)
        rear = [[-depth * 0.55, width * 0.36, 0], [-depth * 0.42, width * 0.3, top], hoop[8]]
        sweep(builder, rear, half, frame, "coarse", mirror=True)
        inner = hoop[3:10] * (1, 0.7, 1) + np.array([0.02, 0, -0.02])
        inner[[0, -1], 2] = top
        if rng.random() < 0.6:
            sweep(builder, inner, half * 0.8, frame, "coarse", side=(0, 0, 1))
    else:
        surface = BackSurface(
            -depth * 0.4, top, tall, width * 0.36, width * float(rng.uniform(0.36, 0.46)), lean, dish=0.03
        )
        for scale, thick in ((1.0, half), (float(rng.uniform(0.55, 0.75)), half * 0.8)):
            angle = np.linspace(-np.pi / 2, np.pi / 2, 11)
            points = surface.at(np.sin(angle) * scale, np.cos(angle) ** 0.6 * (0.4 + 0.6 * scale))
            sweep(builder, points, thick, frame, "coarse", side=(1, 0, 0))
        end = surface.at(1.0, 0.0)
        bar(builder, end, [-depth * 0.55, width * 0.42, 0], half, frame, "coarse", mirror=True)
    if rng.random() < 0.6:
        angle = np.linspace(0, 2 * np.pi, 13)
        ring = np.stack([0.4 * depth * np.cos(angle), 0.4 * width * np.sin(angle), np.full(13, top * 0.55)], 1)
        sweep(builder, ring, half * 0.7, frame, "coarse", side=(0, 0, 1))


KINDS: dict[str, tuple[float, Kind]] = {
    "kitchen": (0.28, kitchen),
    "bar": (0.06, bar_chair),
    "antique": (0.06, antique),
    "windsor": (0.06, windsor),
    "bentwood": (0.04, bentwood),
    "office": (0.12, modern.office),
    "moulded": (0.1, modern.moulded),
    "cantilever": (0.06, modern.cantilever),
    "folding": (0.05, modern.folding),
    "stacking": (0.05, modern.stacking),
    "lounge": (0.03, lounge),
    "parsons": (0.06, soft.parsons),
    "armchair": (0.09, soft.armchair),
    "wingback": (0.03, soft.wingback),
    "tub": (0.05, soft.tub),
    "chunky": (0.025, rare.chunky),
    "floor": (0.01, rare.floor_chair),
    "chaise": (0.015, rare.chaise),
    "wheelchair": (0.015, rare.wheelchair),
    "high_chair": (0.02, rare.high_chair),
}


def chair(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A chair of a random kind, or of the given one (a key of KINDS). Raises KeyError for another."""
    builder = Builder()
    chosen = choose(rng, {name: weight for name, (weight, _) in KINDS.items()})
    KINDS[kind or chosen][1](builder, rng, Finishes(builder, rng))
    return builder


__all__ = ["KINDS", "chair"]
