"""Tables: four-legged, pedestal, trestle, folding, glass, desks, low tables, with benches. Units: metres.

The long side faces the front. Most tables look the same from the front and from behind; those with drawers do not.
"""

from collections.abc import Callable

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.chair.frames import TURNINGS, LegLine, cross_bar, four_legs, stretchers
from viewnet.cad.finishes import Finishes
from viewnet.cad.furniture.table_parts import add_top, benches, outline, table_materials, table_sizes
from viewnet.cad.parts import bar, block, choose, sweep, turned

Kind = Callable[[Builder, np.random.Generator, Finishes], None]


def four_legged(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Four legs at the corners, usually with an apron, sometimes a shelf, drawers in the front or stretchers."""
    wood, top_finish, edge = table_materials(rng, fin)
    length, width, high = table_sizes(rng)
    shape = choose(rng, {"rectangle": 0.62, "rounded": 0.2, "boat": 0.05, "octagon": 0.04, "oval": 0.09})
    thick = float(rng.uniform(0.018, 0.05)) if rng.random() < 0.85 else float(rng.uniform(0.05, 0.1))
    rim = outline(shape, length, width, rng)
    add_top(
        builder, rim, high, thick, top_finish, float(rng.choice([0, 0, 0.02])), edge if rng.random() < 0.5 else None
    )
    style = choose(rng, {"square": 0.42, "tapered": 0.2, "round": 0.1, "turned": 0.14, "cabriole": 0.05, "metal": 0.09})
    half = float(rng.uniform(0.02, 0.045)) * (1.6 if rng.random() < 0.1 and style == "square" else 1)
    half *= 0.7 if style == "metal" else 1
    inset = half + float(rng.choice([0.0, rng.uniform(0.01, 0.1)]))
    squeeze = 0.74 if shape in ("oval",) else 0.95 if shape in ("octagon", "boat") else 1.0
    splay = float(rng.choice([0.0, 0.0, rng.uniform(0.02, 0.1)]))
    turning = int(rng.integers(3))
    lines = four_legs(
        builder, rng, style, length * squeeze, width * squeeze, high - thick, half, wood, splay, inset, turning
    )
    front, rear = lines
    apron = rng.random() < 0.75
    deep = float(rng.uniform(0.03, 0.055))
    z = high - thick - deep
    x, y = float(front.top[0]), float(front.top[1])
    if apron:
        for spot in (x, -x):
            cross_bar(builder, spot, z, y, (deep, 0.011), wood)
        bar(builder, (x, y, z), (-x, y, z), (0.011, deep), wood, mirror=True)
    drawers = apron and rng.random() < 0.16
    if drawers:
        count = int(rng.integers(1, 4))
        knob = fin.metal()
        face = wood if rng.random() < 0.6 else fin.wood(0.3)[0]
        for k in range(count):
            middle = ((k + 0.5) / count * 2 - 1) * y * 0.92
            block(builder, (x + 0.014, middle, z), (0.012, 2 * y * 0.86 / count, deep * 1.7), face)
            block(builder, (x + 0.028, middle, z), (0.02, 0.05, 0.022), knob)
    extra = choose(rng, {"none": 0.6, "shelf": 0.14, "h": 0.1, "box": 0.1, "cross": 0.06})
    level = float(rng.uniform(0.15, 0.35)) * high
    if extra == "shelf":
        block(builder, (0, 0, level), (2 * x, 2 * y, 0.022), top_finish if rng.random() < 0.6 else wood)
    elif extra in ("h", "box"):
        stretchers(builder, rng, extra, front, rear, high, float(rng.uniform(0.012, 0.022)), wood)
    elif extra == "cross":
        for sign in (1.0, -1.0):
            bar(builder, front.at(level) * (1, sign, 1), rear.at(level) * (1, -sign, 1), 0.014, wood, side=(0, 0, 1))
    if rng.random() < 0.07:
        benches(builder, rng, length, width, wood, top_finish)


def pedestal(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A round, oval or square top on one column (or two), with feet, a disc or a cross at the floor."""
    wood, top_finish, edge = table_materials(rng, fin)
    high = (
        float(rng.uniform(0.68, 0.78))
        if rng.random() < 0.75
        else float(rng.choice([0.45, 1.05])) * float(rng.uniform(0.92, 1.05))
    )
    double = rng.random() < 0.2 and high < 0.9
    width = float(rng.uniform(0.6, 1.3)) * (0.75 if high > 0.9 else 1)
    length = width * (
        float(rng.uniform(1.6, 2.2)) if double else float(rng.choice([1.0, 1.0, 1.0, rng.uniform(1.1, 1.45)]))
    )
    shape = choose(rng, {"oval": 0.75, "octagon": 0.07, "rounded": 0.08, "rectangle": 0.1})
    if double:
        shape = choose(rng, {"oval": 0.45, "stadium": 0.2, "rectangle": 0.35})
    thick = float(rng.uniform(0.02, 0.06))
    add_top(
        builder,
        outline(shape, length, width, rng),
        high,
        thick,
        top_finish,
        float(rng.choice([0, 0.03])),
        edge if rng.random() < 0.4 else None,
    )
    if rng.random() < 0.35 and not double:
        add_top(builder, outline("oval", length * 0.85, width * 0.85, rng), high - thick, 0.06, wood)
    radius = float(rng.uniform(0.025, 0.07)) * width
    foot = choose(rng, {"disc": 0.3, "claw": 0.45, "cross": 0.25})
    spots = [length * 0.26, -length * 0.26] if double else [0.0]
    reach = min(width * float(rng.uniform(0.28, 0.42)), 0.42)
    count = int(rng.choice([3, 4])) if not double else 2
    if rng.random() < 0.5:
        column = np.array(TURNINGS[int(rng.integers(3))]) * (1, radius * 1.6)
    else:
        column = np.array([[0, radius * 1.1], [0.5, radius * float(rng.uniform(0.6, 1.2))], [1, radius * 1.1]])
    start = np.pi / 4 if count == 4 and rng.random() < 0.5 else 0.0
    for y in spots:
        low = 0.02 if foot != "claw" else high * 0.12
        turned(builder, (0, y, low), (0, y, high - thick), column, wood, section="fine")
        if foot == "disc":
            flare = [(0, reach), (0.25, reach * 0.97), (0.5, reach * 0.6), (1, radius)]
            turned(builder, (0, y, 0), (0, y, 0.09), flare, wood, section="fine")
            continue
        for k in range(count):
            angle = start + 2 * np.pi * k / count
            out = np.array([np.cos(angle), np.sin(angle), 0.0])
            base = np.array([0, y, 0])
            across = (-out[1], out[0], 0)
            if foot == "cross":
                bar(
                    builder,
                    base + np.array([0, 0, 0.03]),
                    base + out * reach + np.array([0, 0, 0.02]),
                    (0.035, 0.025),
                    wood,
                    end_half=(0.03, 0.015),
                    side=across,
                )
            else:
                path = base + np.outer([0.0, 0.35, 0.75, 1.0], out * reach)
                path[:, 2] = np.array([0.3, 0.25, 0.06, 0.02]) * (high if high < 0.9 else 0.75)
                sweep(
                    builder,
                    path,
                    np.array([[0.028, 0.04], [0.026, 0.035], [0.022, 0.022], [0.028, 0.018]]),
                    wood,
                    "soft",
                    side=across,
                )
    if double:
        bar(builder, (0, -spots[0], high * 0.25), (0, spots[0], high * 0.25), (0.03, 0.018), wood, side=(0, 0, 1))


def trestle(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Two end supports: I frames with a long beam, A or X frames, closed panels, metal loops, or saw-horses."""
    wood, top_finish, edge = table_materials(rng, fin)
    length, width = float(rng.uniform(1.1, 2.2)), float(rng.uniform(0.6, 1.0))
    high = float(rng.uniform(0.7, 0.78)) if rng.random() < 0.8 else float(rng.uniform(0.35, 0.5))
    thick = float(rng.uniform(0.02, 0.06))
    shape = choose(rng, {"rectangle": 0.75, "rounded": 0.13, "stadium": 0.06, "boat": 0.06})
    add_top(
        builder, outline(shape, length, width, rng), high, thick, top_finish, edge=edge if rng.random() < 0.4 else None
    )
    style = choose(rng, {"i": 0.25, "a": 0.17, "x": 0.15, "panel": 0.13, "loop": 0.18, "horse": 0.12})
    y, x = length / 2 * float(rng.uniform(0.6, 0.94)), width / 2 * float(rng.uniform(0.7, 0.95))
    top, half = high - thick, float(rng.uniform(0.018, 0.04))
    if style == "i":
        bar(
            builder,
            (0, y, 0.03),
            (0, y, top),
            (half, float(rng.uniform(1, 3)) * half),
            wood,
            side=(0, 1, 0),
            mirror=True,
        )
        bar(builder, (-x, y, half), (x, y, half), (half, half), wood, mirror=True)
        bar(builder, (-x, y, top - half), (x, y, top - half), (half, half * 0.8), wood, mirror=True)
    elif style == "a":
        for sign in (1.0, -1.0):
            bar(builder, (sign * x, y, 0), (sign * x * float(rng.uniform(0.3, 0.5)), y, top), half, wood, mirror=True)
        bar(builder, (-x * 0.75, y, high * 0.35), (x * 0.75, y, high * 0.35), half * 0.7, wood, mirror=True)
    elif style == "x":
        for sign in (1.0, -1.0):
            bar(builder, (sign * x, y, 0), (-sign * x, y, top), (half, half), wood, mirror=True)
    elif style == "panel":
        bar(builder, (0, y, 0), (0, y, top), (half, x), wood, mirror=True)
    elif style == "loop":
        loop = [[-x, y, top - half], [-x, y, half], [x, y, half], [x, y, top - half]]
        metal = fin.metal() if rng.random() < 0.6 else wood
        sweep(builder, loop, (half, half * 0.6), metal, mirror=True)
        bar(builder, (-x, y, top - half * 0.6), (x, y, top - half * 0.6), (half, half * 0.6), metal, mirror=True)
    else:
        for sign in (1.0, -1.0):
            for out in (0.09, -0.09):
                bar(builder, (sign * x, y + out, 0), (sign * x * 0.85, y, top), half * 0.6, wood, mirror=True)
        bar(builder, (-x, y, top - 0.02), (x, y, top - 0.02), (half, half * 0.7), wood, mirror=True)
        bar(builder, (-x, y + 0.05, high * 0.3), (x, y + 0.05, high * 0.3), half * 0.5, wood, mirror=True)
        bar(builder, (-x, y - 0.05, high * 0.3), (x, y - 0.05, high * 0.3), half * 0.5, wood, mirror=True)
    if style in ("i", "a", "x", "panel") and rng.random() < 0.75:
        z = high * float(rng.uniform(0.18, 0.6))
        bar(builder, (0, -y, z), (0, y, z), (half * 1.4, half * 0.6), wood, side=(0, 0, 1))
    if rng.random() < 0.15 and high > 0.6:
        benches(builder, rng, length, width, wood, top_finish)


def round_legs(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A round or oval top on three or four legs: straight, splayed, turned, hairpin, or bent inwards."""
    wood, top_finish, edge = table_materials(rng, fin)
    high = float(rng.uniform(0.7, 0.77)) if rng.random() < 0.65 else float(rng.uniform(0.38, 0.52))
    width = float(rng.uniform(0.7, 1.35)) if high > 0.6 else float(rng.uniform(0.5, 1.0))
    length = width * float(rng.choice([1.0, 1.0, rng.uniform(1.2, 1.7)]))
    thick = float(rng.uniform(0.018, 0.045))
    add_top(
        builder, outline("oval", length, width, rng), high, thick, top_finish, edge=edge if rng.random() < 0.4 else None
    )
    if rng.random() < 0.5:
        add_top(builder, outline("oval", length * 0.82, width * 0.82, rng), high - thick, 0.07, wood)
    style = choose(rng, {"round": 0.35, "square": 0.2, "turned": 0.15, "hairpin": 0.15, "bent": 0.15})
    count = 3 if rng.random() < 0.12 and style != "turned" else 4
    half = float(rng.uniform(0.018, 0.032))
    turning = TURNINGS[int(rng.integers(3))]
    splay = float(rng.choice([0.0, rng.uniform(0.03, 0.12)]))
    finish = fin.metal() if style in ("hairpin", "bent") and rng.random() < 0.6 else wood
    for k in range(count):
        angle = 2 * np.pi * (k + (0.5 if count == 4 else 0)) / count
        out = np.array([np.cos(angle) * width, np.sin(angle) * length, 0]) / 2
        unit = out / np.linalg.norm(out)
        across = np.array([-unit[1], unit[0], 0])
        head, foot = out * 0.74 + np.array([0, 0, high - thick]), out * 0.74 + unit * splay
        if style == "turned":
            turned(builder, foot, head, np.array(turning) * (1, half * 1.2), finish)
        elif style == "hairpin":
            for shift in (-0.06, 0.06):
                bar(builder, out * 0.8 + unit * splay, head + across * shift, 0.007, finish, "coarse")
        elif style == "bent":
            share = np.linspace(0, 1, 5)
            path = out * (0.75 - 0.5 * np.sin(np.pi * share)[:, None]) + np.outer(share, [0, 0, high - thick])
            sweep(builder, path, half * 0.6, finish, "coarse", side=across)
        else:
            bar(builder, foot, head, half * 0.75, finish, style, end_half=half * 1.1, side=across)
    if rng.random() < 0.15:
        add_top(builder, outline("oval", length * 0.55, width * 0.55, rng), high * 0.3, 0.02, wood)


def desk(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A table with a front: drawers under one or both ends of the top, or cupboards below; sometimes a back panel."""
    plain, grained = fin.wood(0.25)
    top_finish = grained if rng.random() < 0.7 else fin.plastic()
    knob = fin.metal()
    length, width, high = float(rng.uniform(1.1, 1.8)), float(rng.uniform(0.55, 0.85)), float(rng.uniform(0.7, 0.78))
    if rng.random() < 0.25:
        length, high = float(rng.uniform(0.9, 1.4)), float(rng.uniform(0.4, 0.55))
    thick = float(rng.uniform(0.02, 0.04))
    add_top(builder, outline("rectangle", length, width, rng), high, thick, top_finish)
    both = rng.random() < 0.7
    cabinet = length * float(rng.uniform(0.22, 0.32))
    tall = (high - thick) * (1.0 if rng.random() < 0.6 else float(rng.uniform(0.4, 0.6)))
    y = length / 2 - cabinet / 2 - 0.03
    sides = (1.0, -1.0) if both else (float(rng.choice([-1.0, 1.0])),)
    front = width / 2 - 0.04
    face = plain if rng.random() < 0.6 else fin.wood(0.4)[0]
    drawers = int(rng.integers(1, 5)) if tall > 0.35 else int(rng.integers(1, 3))
    for sign in sides:
        block(builder, (0, sign * y, high - thick - tall / 2), (2 * front, cabinet, tall), plain)
        for k in range(drawers):
            z = high - thick - tall * (k + 0.5) / drawers
            block(builder, (front + 0.008, sign * y, z), (0.016, cabinet * 0.92, tall / drawers * 0.88), face)
            block(builder, (front + 0.025, sign * y, z), (0.02, cabinet * 0.3, 0.018), knob)
    if not both or tall < 0.9 * (high - thick):
        feet = (1.0, -1.0) if tall < 0.9 * (high - thick) else (-sides[0],)
        for sign in feet:
            for x in (front - 0.02, 0.02 - front):
                block(builder, (x, sign * (length / 2 - 0.05), (high - thick) / 2), (0.05, 0.05, high - thick), plain)
    if rng.random() < 0.6:
        panel = (high - thick) * float(rng.uniform(0.35, 0.9))
        block(builder, (0.02 - front, 0, high - thick - panel / 2), (0.02, length - 0.12, panel), plain)


def folding(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A folding or camping table, or a picnic table with its benches built in."""
    if rng.random() < 0.6:
        top_finish = fin.plastic() if rng.random() < 0.6 else fin.wood(0.2)[1]
        legs = fin.metal()
        length, width, high = (
            float(rng.uniform(0.9, 1.9)),
            float(rng.uniform(0.55, 0.8)),
            float(rng.uniform(0.65, 0.76)),
        )
        add_top(builder, outline("rounded", length, width, rng), high, float(rng.uniform(0.025, 0.05)), top_finish)
        y, x = length * float(rng.uniform(0.33, 0.42)), width * 0.42
        loop = [[-x, y, high - 0.03], [-x * 0.9, y + 0.05, 0.012], [x * 0.9, y + 0.05, 0.012], [x, y, high - 0.03]]
        sweep(builder, loop, 0.013, legs, "coarse", mirror=True)
        bar(builder, (0, y + 0.03, high * 0.5), (0, y * 0.45, high - 0.03), 0.008, legs, "coarse", mirror=True)
        bar(
            builder,
            (-x * 0.95, y + 0.03, high * 0.5),
            (x * 0.95, y + 0.03, high * 0.5),
            0.008,
            legs,
            "coarse",
            mirror=True,
        )
        return
    wood, board = fin.wood(0.15)
    length, high = float(rng.uniform(1.4, 2.0)), float(rng.uniform(0.7, 0.78))
    width, seat = float(rng.uniform(0.65, 0.8)), float(rng.uniform(0.42, 0.47))
    planks = int(rng.integers(3, 6))
    for k in range(planks):
        block(
            builder, (((k + 0.5) / planks - 0.5) * width, 0, high - 0.02), (width / planks * 0.92, length, 0.04), board
        )
    y, reach = length * 0.34, width / 2 + 0.38
    for sign in (1.0, -1.0):
        block(builder, (sign * (reach - 0.12), 0, seat - 0.02), (0.26, length, 0.04), board)
        bar(
            builder,
            (sign * (reach - 0.12), y, 0),
            (sign * width * 0.28, y, high - 0.04),
            (0.02, 0.045),
            wood,
            mirror=True,
        )
    bar(builder, (-reach, y - 0.04, seat - 0.08), (reach, y - 0.04, seat - 0.08), (0.02, 0.045), wood, mirror=True)


def box_frame(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A frame table: bars along all edges of a box, a top and perhaps a lower shelf; or a solid block or slab."""
    wood, top_finish, _ = table_materials(rng, fin)
    length, width, high = float(rng.uniform(0.5, 1.3)), float(rng.uniform(0.45, 0.8)), float(rng.uniform(0.32, 0.75))
    x, y = width / 2 - 0.02, length / 2 - 0.02
    if rng.random() < 0.25:
        inset = float(rng.uniform(0.7, 1.0))
        block(
            builder,
            (0, 0, high / 2 - 0.02),
            (width * inset, length * inset, high - 0.04),
            wood,
            taper=float(rng.uniform(0.8, 1.0)),
        )
        add_top(builder, outline("rectangle", length, width, rng), high, 0.04, top_finish)
        return
    half = float(rng.uniform(0.008, 0.02))
    line = LegLine(np.array([x, y, high - 0.02]), np.array([x, y, 0.0]))
    for sign in (1.0, -1.0):
        bar(builder, line.foot * (sign, 1, 1), line.top * (sign, 1, 1), half, wood, mirror=True)
        for z in (half, high - 0.02 - half):
            cross_bar(builder, sign * x, z, y, (half, half), wood)
    for z in (half, high - 0.02 - half):
        bar(builder, (-x, y, z), (x, y, z), half, wood, mirror=True)
    add_top(builder, outline("rectangle", length, width, rng), high, 0.022, top_finish)
    if rng.random() < 0.5:
        block(builder, (0, 0, float(rng.uniform(0.05, 0.45)) * high), (2 * x, 2 * y, 0.016), top_finish)


KINDS: dict[str, tuple[float, Kind]] = {
    "four_legged": (0.4, four_legged),
    "pedestal": (0.17, pedestal),
    "trestle": (0.14, trestle),
    "round": (0.12, round_legs),
    "desk": (0.06, desk),
    "folding": (0.06, folding),
    "frame": (0.05, box_frame),
}


def diningtable(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A table of a random kind, or of the given one (a key of KINDS). Raises KeyError for another."""
    builder = Builder()
    chosen = choose(rng, {name: weight for name, (weight, _) in KINDS.items()})
    KINDS[kind or chosen][1](builder, rng, Finishes(builder, rng))
    return builder
