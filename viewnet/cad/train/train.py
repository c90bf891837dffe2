"""Trains: steam, diesel and electric locomotives, high-speed heads, railcars and metro cars, carriages, trams."""

import numpy as np

from viewnet.cad import palette
from viewnet.cad.builder import Builder
from viewnet.cad.train.steam import steam
from viewnet.cad.tube_shell import End, edges, flat_end, tube, window_row

KINDS = {"highspeed": 20, "electric": 16, "diesel": 16, "metro": 18, "carriage": 8, "tram": 8, "steam": 16}
# Rows of the cross-section of cars with windows.
SKIRT, LOWER, WAIST, GLASS, CANTRAIL, CURVE, ROOF = range(7)


def train(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A locomotive, a railcar, a tram or the head of a train; sometimes with a second car behind."""
    builder = Builder()
    kind = palette.pick(rng, KINDS, kind)
    if kind == "steam":
        steam(rng, builder)
    elif kind == "diesel" and rng.random() < 0.5:
        hood_unit(rng, builder)
    else:
        car(rng, builder, kind)
    return builder


def _materials(rng: np.random.Generator, builder: Builder) -> dict[str, str]:
    draw = rng.random()
    base = (
        palette.gray(rng, 0.85, 0.96)
        if draw < 0.3
        else palette.gray(rng, 0.5, 0.8)
        if draw < 0.48
        else palette.vivid(rng, 0.5, 0.3)
    )
    second = palette.vivid(rng, 0.55, 0.3) if rng.random() < 0.7 else palette.gray(rng, 0.05, 0.9)
    return {
        "base": builder.material("base", base),
        "second": builder.material("second", second),
        "roof": builder.material("roof", palette.gray(rng, 0.25, 0.75) if rng.random() < 0.7 else base),
        "glass": builder.material("glass", palette.jitter(rng, (0.08, 0.09, 0.11), 0.03)),
        "door": builder.material("door", second if rng.random() < 0.4 else palette.gray(rng, 0.2, 0.7)),
        "dark": builder.material("dark", palette.gray(rng, 0.04, 0.14)),
        "wheel": builder.material("wheel", palette.gray(rng, 0.15, 0.4)),
        "lamp": builder.material("lamp", (0.96, 0.95, 0.86)),
        "tail": builder.material("tail", (0.75, 0.06, 0.06)),
        "metal": builder.material("metal", palette.metal(rng)),
        "warning": builder.material("warning", (0.93, 0.75, 0.08)),
    }


def car(rng: np.random.Generator, builder: Builder, kind: str) -> None:
    """A vehicle with a smooth body: its front is a cab, its rear a cab, a gangway or a blunt end."""
    c = _materials(rng, builder)
    u = rng.uniform
    length, width, height = {
        "highspeed": (u(20, 27), u(2.8, 3.3), u(3.5, 4.0)),
        "electric": (u(14, 20), u(2.8, 3.1), u(3.7, 4.2)),
        "diesel": (u(15, 21), u(2.8, 3.1), u(3.8, 4.4)),
        "metro": (u(15, 22), u(2.6, 3.0), u(3.4, 3.8)),
        "carriage": (u(18, 26), u(2.7, 3.1), u(3.7, 4.2)),
        "tram": (u(10, 18), u(2.3, 2.65), u(3.2, 3.6)),
    }[kind]
    floor = u(0.25, 0.5) if kind in ("tram", "highspeed") else u(0.75, 1.0)
    half, front, rear = width / 2, length / 2, -length / 2
    sill, head = floor + 0.42 * (height - floor), floor + u(0.68, 0.76) * (height - floor)
    round_top = u(0.5, 0.8)
    outline = np.array(
        [
            (half * 0.9, floor), (half * 0.99, floor + 0.25), (half, floor + 0.25 * (height - floor)), (half, sill),
            (half * u(0.96, 1.0), head), (half * u(0.86, 0.95), floor + 0.88 * (height - floor)),
            (half * round_top * 0.8, height),
        ]
    )  # fmt: skip
    rows = len(outline)
    rise = np.clip((outline[:, 1] - floor) / (height - floor), 0, 1)
    if kind == "highspeed":
        depth = u(3.0, 8.0)
        sharp = u(0.25, 0.5)
        grow = np.array([0.0, 0.06, 0.16, 0.34, 0.58, 0.8, 1.0])
        tall = sharp + (1 - sharp) * np.sin(grow * np.pi / 2) ** 0.9
        nose = End(
            (0.0, 0.42, 0.62, 0.78, 0.90, 0.97, 1.0), tuple(grow * depth), tuple(tall), tuple(0.12 * depth * rise**2)
        )
    else:
        lean = u(0.0, 0.9 if kind in ("electric", "tram", "metro") else 0.5) * np.clip((rise - 0.4) / 0.6, 0, 1)
        if rng.random() < 0.3:
            lean = lean + u(0.2, 0.5) * np.clip(0.4 - rise, 0, 1)
        nose = flat_end(rows, u(0.15, 0.6), [float(v) for v in lean])
    symmetric = kind in ("electric", "tram") or (kind == "metro" and rng.random() < 0.5)
    end = nose if symmetric else flat_end(rows, u(0.05, 0.12))
    cab = symmetric or (kind == "diesel" and rng.random() < 0.5)

    count = int(rng.integers(5, 10)) if kind in ("metro", "carriage", "highspeed") else int(rng.integers(3, 6))
    clear = (nose.depth[-1] if kind == "highspeed" else 0.4) + u(0.3, 1.2)
    windows = window_row(front - clear, rear + u(0.5, 1.2), count, u(0.2, 0.7))
    blind = kind in ("electric", "diesel") and rng.random() < 0.6
    doors = []
    if kind in ("metro", "tram", "carriage"):
        doors = [
            (x - 0.65, x + 0.65)
            for x in np.linspace(rear + 0.14 * length, front - 0.14 * length, int(rng.integers(2, 5)))
        ]
    style = palette.choose(rng, {"plain": 2, "stripe": 4, "lower": 2, "upper": 1, "front": 2})
    swoosh = front - u(0.12, 0.4) * length
    yellow = bool(rng.random() < 0.15)

    def painter(row: int, x: float, share: float, side: int, place: str) -> str:
        if place == "floor":
            return c["dark"]
        faced = place == "front" or (place == "rear" and cab)
        if kind == "highspeed" and place == "front":
            return _nose(c, row, x, front, nose.depth[-1], style)
        if faced:
            if row == GLASS and share < 0.97:
                return c["glass"]
            if row == LOWER and share > 0.5:
                return c["lamp"] if place == "front" else c["tail"]
            if yellow and row in (LOWER, WAIST):
                return c["warning"]
            return c["dark"] if row == SKIRT else c["second"] if style == "front" and row <= WAIST else c["base"]
        if place == "rear":
            return (
                c["dark"]
                if share < 0.4 and row < CANTRAIL
                else c["tail"]
                if row == LOWER and share > 0.8
                else c["base"]
            )
        if row >= CURVE:
            return c["roof"]
        if any(a < x < b for a, b in doors) and row in (LOWER, WAIST, GLASS):
            return c["glass"] if row == GLASS else c["door"]
        if row == GLASS and not blind and any(a < x < b for a, b in windows):
            return c["glass"]
        if row == GLASS and blind and (x > front - 1.6 or (cab and x < rear + 1.6)):
            return c["glass"]
        banded = {"stripe": (WAIST,), "lower": (SKIRT, LOWER), "upper": (GLASS, CANTRAIL)}.get(style, ())
        if row in banded or (style == "front" and x > swoosh):
            return c["second"]
        return c["base"]

    cuts = [*edges(windows), *edges(doors), swoosh, front - 0.75, front - 1.6, rear + 1.6]
    tube(builder, outline, (front, rear), (nose, end), cuts, painter)
    _bogies(rng, builder, c, length, half, floor)
    _roof(rng, builder, c, kind, length, half, height)
    if kind in ("electric", "diesel", "metro", "carriage"):
        _buffers(builder, c, front, rear, half, floor)


def _nose(c: dict[str, str], row: int, x: float, front: float, depth: float, style: str) -> str:
    """The head of a high-speed train: windscreen high on the nose, lamps low."""
    u = (front - x) / depth
    if row in (CANTRAIL, CURVE, ROOF) and 0.2 < u < 0.62:
        return c["glass"]
    if row == WAIST and 0.03 < u < 0.3:
        return c["lamp"]
    if row == SKIRT:
        return c["dark"] if style == "plain" else c["second"]
    if style in ("stripe", "lower") and row in (LOWER, WAIST):
        return c["second"]
    return c["second"] if style == "front" else c["base"]


def _bogies(
    rng: np.random.Generator, builder: Builder, c: dict[str, str], length: float, half: float, floor: float
) -> None:
    """Two bogies with their wheels, and the equipment between them."""
    radius = 0.42
    axles = 3 if rng.random() < 0.2 else 2
    for sign in (1, -1):
        middle = sign * length * rng.uniform(0.30, 0.36)
        builder.box((middle, 0, 0.55), (axles * 1.5, half * 1.6, 0.4), c["dark"])
        for k in range(axles):
            x = middle + (k - (axles - 1) / 2) * 1.6
            with builder.both_sides():
                builder.cylinder((x, half * 0.62, radius), (x, half * 0.8, radius), radius, c["wheel"], sections=10)
    if rng.random() < 0.8:
        builder.box((0, 0, 0.55), (length * rng.uniform(0.15, 0.3), half * 1.5, floor), c["dark"])


def _roof(
    rng: np.random.Generator, builder: Builder, c: dict[str, str], kind: str, length: float, half: float, height: float
) -> None:
    """Pantographs, air conditioning, exhausts."""
    if kind in ("electric", "tram") or (kind == "highspeed" and rng.random() < 0.4):
        places = (0.3, -0.3) if kind == "electric" and rng.random() < 0.6 else (float(rng.choice([0.0, 0.3, -0.3])),)
        for place in places:
            x, top = place * length, height + rng.uniform(0.5, 1.1)
            reach = 0.9 if place > 0 else -0.9
            with builder.both_sides():
                points = [(x, 0.35, height), (x - reach, 0.3, (height + top) / 2), (x, 0.25, top)]
                builder.tube(points, 0.05, c["dark"], 4)
            builder.box((x, 0, top), (0.3, half * 1.1, 0.06), c["dark"])
    if kind != "electric" and rng.random() < 0.7:
        for x in np.linspace(-0.3, 0.25, int(rng.integers(1, 4))) * length:
            builder.box((float(x), 0, height + 0.08), (length * 0.12, half * 1.0, 0.24), c["roof"], taper=(0.95, 0.85))


def _buffers(builder: Builder, c: dict[str, str], front: float, rear: float, half: float, floor: float) -> None:
    for x, out in ((front, 1), (rear, -1)):
        with builder.both_sides():
            builder.cylinder(
                (x - 0.1 * out, half * 0.58, floor + 0.1),
                (x + 0.45 * out, half * 0.58, floor + 0.1),
                0.13,
                c["dark"],
                0.2,
                6,
            )


def hood_unit(rng: np.random.Generator, builder: Builder) -> None:
    """A freight diesel: short nose, cab, long engine hood narrower than the running board with handrails."""
    c = _materials(rng, builder)
    length, half, floor = rng.uniform(14, 21), rng.uniform(1.4, 1.55), 1.2
    front, rear, height = length / 2, -length / 2, rng.uniform(4.1, 4.6)
    builder.box((0, 0, floor - 0.1), (length, 2 * half, 0.35), c["dark"] if rng.random() < 0.6 else c["second"])
    short = rng.uniform(0.12, 0.2) * length
    low = rng.random() < 0.6
    top = floor + (height - floor) * (0.55 if low else 0.85)
    long = rng.uniform(1.8, 2.6)
    cab = front - short - 0.6

    def block(a: float, b: float, wide: float, low_z: float, high_z: float, name: str) -> None:
        builder.box(
            ((a + b) / 2, 0, (low_z + high_z) / 2), (abs(b - a), 2 * wide, high_z - low_z), name, taper=(0.98, 0.92)
        )

    nose = c["second"] if rng.random() < 0.5 else c["base"]
    block(front - 0.6, cab, half * 0.62, floor, top, nose)
    block(cab, cab - long, half * 0.98, floor, height, c["base"])
    block(cab - long, rear + 0.8, half * 0.62, floor, height - rng.uniform(0.1, 0.4), c["base"])
    block(cab - long - 0.02, rear + 0.85, half * 0.64, floor + 0.5, floor + 0.95, c["second"])
    glass_z = height - 0.75
    for x, wide in ((cab + 0.01, 1.5), (cab - long - 0.01, 1.5)):
        with builder.both_sides():
            builder.box((x, half * 0.45, glass_z), (0.06, 0.3 * wide, 0.55), c["glass"])
    with builder.both_sides():
        builder.box((cab - long / 2, half * 0.95, glass_z), (long * 0.6, 0.14, 0.6), c["glass"])
        builder.tube(
            [
                (rear + 0.6, half * 0.97, floor),
                (rear + 0.6, half * 0.97, floor + 1.0),
                (cab - long, half * 0.97, floor + 1.0),
            ],
            0.05,
            c["metal"],
            4,
        )
        builder.box((front - 0.56, half * 0.3, top - 0.25), (0.12, 0.2, 0.2), c["lamp"])
        builder.box((rear + 0.76, half * 0.3, floor + 0.8), (0.12, 0.2, 0.2), c["tail"])
    builder.box(
        (front, 0, floor - 0.35),
        (0.3, 1.8 * half, 0.6),
        c["warning"] if rng.random() < 0.4 else c["dark"],
        taper=(0.4, 1),
    )
    builder.box((rear, 0, floor - 0.35), (0.3, 1.8 * half, 0.6), c["dark"])
    for x in np.linspace(rear + 0.2 * length, cab - long - 1.5, int(rng.integers(1, 4))):
        builder.cylinder(
            (float(x), 0, height - 0.4), (float(x), 0, height + 0.15), rng.uniform(0.3, 0.7), c["dark"], sections=8
        )
    _bogies(rng, builder, c, length, half, 0.8)
    if rng.random() < 0.5:
        _buffers(builder, c, front, rear, half, floor - 0.3)
