"""Upholstered seating of one or several seats: bodies, arms, backs, cushions and feet of armchairs and sofas.

Units: metres. The seat faces +x.
"""

from dataclasses import dataclass

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.finishes import Finish, Finishes
from viewnet.cad.parts import bar, block, choose, cushion, put, ring_faces, shell, sweep

# Cross-section of a soft block: flat sides, rounded edges.
SOFT = np.array([[-1, -0.9], [-0.9, -1], [0.9, -1], [1, -0.9], [1, 0.75], [0.75, 1], [-0.75, 1], [-1, 0.75]])
_ROUND_TOP = np.array([[-1, -1], [1, -1], [1, 0.3], [0.8, 0.75], [0.4, 0.97], [-0.4, 0.97], [-0.8, 0.75], [-1, 0.3]])


@dataclass(frozen=True)
class Body:
    """Measures of an upholstered seat: inner width, overall depth, arm width; heights of seat, arms, back, gap."""

    inner: float
    depth: float
    arm: float
    seat: float
    arm_top: float
    back: float
    clear: float
    back_thick: float
    lean: float


def soft_legs(
    builder: Builder,
    rng: np.random.Generator,
    fin: Finishes,
    half_width: float,
    half_depth: float,
    clear: float,
    style: str | None = None,
    middle: bool = False,
) -> None:
    """Feet under a body whose underside is at height `clear`: block, taper, metal or frame (sled)."""
    style = style or choose(rng, {"block": 0.35, "taper": 0.35, "metal": 0.2, "frame": 0.1})
    wood = fin.wood(0.1)[0] if style in ("block", "taper") else fin.metal()
    half = float(rng.uniform(0.018, 0.035))
    inset = half + float(rng.uniform(0.01, 0.06))
    splay = float(rng.choice([0.0, rng.uniform(0.02, 0.06)])) if style != "block" else 0.0
    if style == "frame":
        loop = [
            [half_depth - inset, half_width - inset, clear],
            [half_depth - inset, half_width - inset, 0.01],
            [inset - half_depth, half_width - inset, 0.01],
            [inset - half_depth, half_width - inset, clear],
        ]
        sweep(builder, loop, (0.012, 0.012), wood, mirror=True)
        return
    spots = [half_width - inset] + ([0.0] if middle else [])
    for x in (half_depth - inset, inset - half_depth):
        for y in spots:
            foot = np.array([x + np.sign(x) * splay, y + splay * (y > 0), 0.0])
            narrow = half * {"block": 1.0, "taper": 0.55, "metal": 0.5}[style]
            wide = half * {"block": 1.0, "taper": 1.0, "metal": 0.5}[style]
            section = "square" if style == "block" else "round"
            bar(builder, foot, (x, y, clear + 0.01), narrow, wood, section, end_half=wide, mirror=y > 0)


def add_arms(builder: Builder, rng: np.random.Generator, body: Body, style: str, finish: Finish, wood: Finish) -> None:
    """Both arms: box, slim, round, rolled, scooped (falls towards the front), sloped, flared, wood (boards on top)."""
    middle, half = body.inner / 2 + body.arm / 2, body.arm / 2
    rear, front = -body.depth / 2, body.depth / 2 - float(rng.choice([0.0, rng.uniform(0.0, 0.06)]))
    low, high = body.clear, body.arm_top
    centre = (low + high) / 2
    if style in ("box", "slim", "round", "wood"):
        section = _ROUND_TOP if style == "round" else SOFT if style == "box" else "square"
        ends = [[rear + 0.02, middle, centre], [front, middle, centre]]
        # Sections lie in the y-z plane: the third axis of the sweep points up when the path runs forwards.
        sweep(builder, ends, (half, (high - low) / 2), finish, section, mirror=True)
        if style == "wood":
            top = [[rear + 0.05, middle, high + 0.012], [front + 0.02, middle, high + 0.012]]
            sweep(builder, top, (half * 1.05, 0.014), wood, mirror=True)
    elif style == "rolled":
        roll = half * float(rng.uniform(0.85, 1.15))
        slab = [
            [rear + 0.02, middle - 0.15 * half, (low + high - roll) / 2],
            [front - 0.01, middle - 0.15 * half, (low + high - roll) / 2],
        ]
        sweep(builder, slab, (half * 0.8, (high - roll - low) / 2), finish, mirror=True)
        over = middle + float(rng.uniform(0.1, 0.35)) * half
        sweep(builder, [[rear, over, high - roll], [front, over, high - roll]], roll, finish, "fine", mirror=True)
    else:
        fall = {"scooped": rng.uniform(0.1, 0.2), "sloped": rng.uniform(0.06, 0.16), "flared": 0.0}[style]
        share = np.linspace(0, 1, 6)
        shape = share**2 * (3 - 2 * share) if style == "scooped" else share
        # Never below the seat, or the arm would vanish behind the cushion.
        tops = np.maximum(high - float(fall) * shape, body.seat + 0.02)
        lean_out = float(rng.uniform(0.03, 0.08)) if style == "flared" else 0.0
        x = rear + (front - rear) * share
        rings = np.stack(
            [
                np.stack([x, np.full(6, middle - half), np.full(6, low)], 1),
                np.stack([x, np.full(6, middle + half), np.full(6, low)], 1),
                np.stack([x, np.full(6, middle + half + lean_out), tops - half * 0.4], 1),
                np.stack([x, np.full(6, middle + half * 0.5 + lean_out), tops], 1),
                np.stack([x, np.full(6, middle - half * 0.5 + lean_out * 0.7), tops], 1),
                np.stack([x, np.full(6, middle - half), tops - half * 0.4], 1),
            ],
            axis=1,
        )
        put(builder, rings.reshape(-1, 3), ring_faces(6, 6, True), finish, mirror=True)


def add_back(builder: Builder, rng: np.random.Generator, body: Body, style: str, finish: Finish, width: float) -> None:
    """The back's body: straight, round (rolled top), camel (arched top), slab without curve; leaning by body.lean."""
    foot_x = -body.depth / 2 + body.back_thick / 2
    columns = 9 if style == "camel" else 6
    u, t = np.linspace(-1, 1, columns)[None, :], np.linspace(0, 1, 5)[:, None]
    arch = float(rng.uniform(0.06, 0.14)) if style == "camel" else 0.0
    height = body.back - body.clear - arch
    x = foot_x - body.lean * t**1.2 + 0 * u
    z = body.clear + height * t + arch * t * np.cos(u * np.pi / 2) ** 1.5
    y = u * width / 2 + 0 * t
    grid = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    full = np.full((5, columns), body.back_thick)
    if style == "straight":
        full[-1] *= 0.75
    elif style in ("round", "camel"):
        full[-1] *= 0.4
        full[-2] *= 1.15
    shell(builder, grid[::-1], full[::-1], finish)
    if style == "round" and rng.random() < 0.6:
        top = grid[-1] + np.array([-0.02, 0, -0.02])
        sweep(builder, top[[0, -1]], float(rng.uniform(0.05, 0.09)), finish, "fine", side=(0, 0, 1))


def seat_cushions(builder: Builder, body: Body, count: int, thick: float, finish: Finish, forward: float) -> None:
    """`count` loose seat cushions side by side, their upper side at body.seat."""
    each = body.inner / count
    inner_depth = body.depth - body.back_thick * 0.8 + forward
    x = body.depth / 2 + forward - inner_depth / 2
    for k in range(count):
        y = (k - (count - 1) / 2) * each
        cushion(
            builder,
            (x, y, body.seat - thick / 2),
            (inner_depth, each * 0.985, thick * 1.08),
            finish,
            0.06,
            0.62,
            rows=5,
            columns=6,
        )


def back_cushions(
    builder: Builder, body: Body, count: int, thick: float, height: float, finish: Finish, tilt: float
) -> None:
    """`count` loose back cushions that lean on the back with `tilt` (share of their height)."""
    each = body.inner / count
    up = np.array([-tilt, 0.0, 1.0])
    up /= np.linalg.norm(up)
    axes = np.stack([up, [0.0, 1.0, 0.0], np.cross(up, [0.0, 1.0, 0.0])])
    x = -body.depth / 2 + body.back_thick - body.lean * 0.5 + thick / 2
    for k in range(count):
        y = (k - (count - 1) / 2) * each
        centre = np.array([x + tilt * height * 0.25, y, body.seat + height / 2 - 0.01])
        cushion(builder, centre, (height, each * 0.97, thick), finish, 0.12, 0.35, axes)


def tufts(builder: Builder, body: Body, rows: int, columns: int, finish: Finish, width: float) -> None:
    """Buttons on the back's front side."""
    for i in range(rows):
        # Every other row has one button less, so that the rows interlock and stay symmetric.
        count = columns - i % 2
        for j in range(count):
            y = (j - (count - 1) / 2) * width / columns
            t = (i + 1) / (rows + 1)
            z = body.seat + (body.back - body.seat) * t
            share = (z - body.clear) / (body.back - body.clear)
            x = -body.depth / 2 + body.back_thick - body.lean * share**1.2
            block(builder, (x + 0.004, y, z), (0.02, 0.03, 0.03), finish)


def random_body(rng: np.random.Generator, seat_width: float, seats: int) -> Body:
    """Measures of an armchair or sofa of `seats` seats of a given width."""
    seat_height = float(rng.uniform(0.37, 0.46))
    clear = float(rng.choice([0.015, rng.uniform(0.03, 0.1), rng.uniform(0.1, 0.19)], p=[0.2, 0.45, 0.35]))
    return Body(
        inner=seat_width * seats,
        depth=float(rng.uniform(0.74, 0.98)),
        arm=float(rng.uniform(0.08, 0.28)) * (0.75 if seats == 1 else 1.0),
        seat=seat_height,
        arm_top=seat_height + float(rng.uniform(0.1, 0.26)),
        back=seat_height + float(rng.uniform(0.27, 0.52)),
        clear=clear,
        back_thick=float(rng.uniform(0.12, 0.26)),
        lean=float(rng.uniform(0.0, 0.14)),
    )


def upholstered(
    builder: Builder,
    rng: np.random.Generator,
    fin: Finishes,
    seats: int,
    seat_width: float,
    arms: str | None = None,
    body: Body | None = None,
) -> Body:
    """A whole armchair (seats = 1) or sofa: base, arms, back, cushions, feet. Returns its measures."""
    body = body or random_body(rng, seat_width, seats)
    cover = fin.leather() if rng.random() < 0.38 else fin.fabric(0.22)
    inside = cover if rng.random() < 0.75 else fin.upholstery()
    wood = fin.wood(0.1)[0]
    arms = arms or choose(
        rng,
        {
            "box": 0.3,
            "slim": 0.1,
            "round": 0.14,
            "rolled": 0.2,
            "scooped": 0.08,
            "sloped": 0.06,
            "flared": 0.06,
            "wood": 0.03,
            "none": 0.03,
        },
    )
    width = body.inner + (0 if arms == "none" else 2 * body.arm)
    style = choose(rng, {"straight": 0.55, "round": 0.25, "camel": 0.12, "slab": 0.08})
    thick = float(rng.uniform(0.1, 0.2))
    base_top = body.seat - thick * 0.85
    front = body.depth / 2 - float(rng.uniform(0.0, 0.04))
    block(
        builder,
        ((front - body.depth / 2) / 2, 0, (base_top + body.clear) / 2),
        (front + body.depth / 2 - 0.02, body.inner + 0.01, base_top - body.clear),
        cover if rng.random() < 0.93 else wood,
    )
    if arms != "none":
        add_arms(builder, rng, body, arms, cover, wood)
    spans = (
        width - 0.01
        if style in ("round", "camel") or (body.back > body.arm_top + 0.15 and rng.random() < 0.6)
        else (body.inner + 0.01)
    )
    if arms in ("box", "slim", "wood") and rng.random() < 0.5:
        spans = body.inner + 0.01
    add_back(builder, rng, body, style, cover, spans)
    forward = float(rng.uniform(0, 0.03))
    cushions = seats if rng.random() < 0.75 else 1
    seat_cushions(builder, body, cushions, thick, inside, forward)
    if rng.random() < 0.72:
        count = seats if rng.random() < 0.85 else max(1, seats + 1 - 2 * (seats > 2))
        high = (body.back - body.seat) * float(rng.uniform(0.85, 1.18))
        back_cushions(builder, body, count, float(rng.uniform(0.12, 0.2)), high, inside, float(rng.uniform(0.12, 0.35)))
    elif rng.random() < 0.5:
        tufts(
            builder,
            body,
            int(rng.integers(2, 4)),
            2 * seats + 1,
            fin.dark() if rng.random() < 0.4 else cover,
            body.inner,
        )
    half_width = width / 2
    if body.clear > 0.025:
        soft_legs(
            builder, rng, fin, half_width, body.depth / 2 - 0.01, body.clear, middle=seats > 2 and rng.random() < 0.3
        )
    else:
        block(builder, (0, 0, 0.008), (body.depth * 0.94, width * 0.96, 0.016), fin.dark())
    if rng.random() < 0.28:
        pillows(builder, rng, fin, body, seats)
    return body


def pillows(builder: Builder, rng: np.random.Generator, fin: Finishes, body: Body, seats: int) -> None:
    """Scatter cushions: a pair at the arms, or one in the middle."""
    finish = fin.fabric(0.5)
    size = float(rng.uniform(0.32, 0.44))
    pairs = seats > 1 and rng.random() < 0.8
    spots = [(body.inner / 2 - size * 0.55, True)] if pairs else [(0.0, False)]
    if pairs and seats > 2 and rng.random() < 0.3:
        spots.append((body.inner / 2 - size * 1.5, True))
    for y, mirror in spots:
        up = np.array([-0.45, 0.0, 1.0])
        up /= np.linalg.norm(up)
        axes = np.stack([up, [0.0, 1.0, 0.0], np.cross(up, [0.0, 1.0, 0.0])])
        x = -body.depth / 2 + body.back_thick + 0.2 - body.lean * 0.4
        cushion(builder, (x, y, body.seat + size * 0.46), (size, size, 0.14), finish, 0.1, 0.15, axes, mirror, 5, 5)
