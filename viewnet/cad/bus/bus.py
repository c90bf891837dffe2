"""Buses: city buses, coaches, double deckers, school buses, minibuses."""

from dataclasses import dataclass

import numpy as np

from viewnet.cad import palette
from viewnet.cad.builder import Builder
from viewnet.cad.car.parts import wheel
from viewnet.cad.tube_shell import edges, flat_end, tube, window_row

# Rows of the cross-section: cell r lies above point r.
FLOOR, WELL, SKIRT, LOWER, WAIST, GLASS, CANTRAIL, CURVE, ROOF = range(9)
KINDS = {"city": 40, "coach": 28, "double": 14, "school": 9, "mini": 9}


@dataclass(frozen=True)
class _Size:
    length: float
    width: float
    height: float
    floor: float
    sill: float  # lower edge of the side windows
    head: float  # upper edge of the side windows
    wheel: float


def bus(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A bus: city bus, coach, double decker, school bus with a bonnet, or minibus."""
    builder = Builder()
    kind = palette.pick(rng, KINDS, kind)
    size = _draw_size(rng, kind)
    colors = _colors(rng, builder, kind)
    bonnet = (
        rng.uniform(1.0, 1.7)
        if kind == "school"
        else rng.uniform(0.5, 0.9)
        if kind == "mini" and rng.random() < 0.5
        else 0.0
    )
    front, rear = size.length / 2 - bonnet, -size.length / 2
    half = size.width / 2

    inner = half - 0.42
    low, waist = size.floor, size.floor + 0.45 * (size.sill - size.floor)
    tuck = rng.uniform(0.90, 0.98)
    outline = np.array(
        [
            (inner, low), (inner, low), (half * 0.985, low), (half, low + 0.32), (half, waist + 0.12),
            (half, size.sill), (half * rng.uniform(0.96, 1.0), size.head), (half * tuck, size.height - 0.12),
            (half * 0.72, size.height),
        ]
    )  # fmt: skip
    outline[4, 1] = min(outline[4, 1], size.sill - 0.05)
    rows = len(outline)
    slope = rng.uniform(0.25, 0.7) if kind == "coach" else rng.uniform(0.0, 0.22)
    lean = slope * np.clip((outline[:, 1] - size.sill) / (size.height - size.sill), 0, 1) ** 1.3
    head = flat_end(rows, rng.uniform(0.2, 0.5), [float(v) for v in lean])
    tail = flat_end(rows, rng.uniform(0.12, 0.3), [float(v) for v in lean * rng.uniform(0.0, 0.4)])

    axles = _axles(rng, size, kind)
    count = int(rng.integers(4, 8)) if kind != "mini" else int(rng.integers(2, 4))
    gap = rng.uniform(0.06, 0.22)
    windows = window_row(front - rng.uniform(0.6, 1.1), rear + rng.uniform(0.25, 0.8), count, gap)
    doors = _doors(rng, kind, front, axles)
    style = palette.choose(rng, {"plain": 3, "stripe": 3, "lower": 2, "rear": 2, "roof": 1, "front": 1})
    band = bool(rng.random() < 0.45)
    sign = bool(kind in ("city", "double") or rng.random() < 0.3)
    back_glass = bool(rng.random() < 0.75)
    big_screen = bool(rng.random() < 0.6)
    swoosh, slant = rear + rng.uniform(0.15, 0.4) * size.length, rng.uniform(-0.4, 0.4)
    c = colors

    def painter(row: int, x: float, share: float, side: int, end: str) -> str:
        if end == "floor" or row in (FLOOR, WELL):
            return c["dark"]
        if end == "front":
            return _front(c, row, share, sign, big_screen, bonnet > 0)
        if end == "rear":
            return _rear(c, row, share, back_glass, style)
        if side < 0 and any(a < x < b for a, b in doors) and SKIRT <= row <= GLASS:
            return c["door"]
        if row == GLASS and windows[-1][0] < x:
            if any(a < x < b for a, b in windows):
                return c["glass"]
            return c["glass"] if band and x < windows[0][1] else c["base"]
        if row in (SKIRT, LOWER, WAIST) and style == "lower" and row != WAIST:
            return c["second"]
        if row == LOWER and style == "stripe":
            return c["second"]
        if style == "rear" and x < swoosh + slant * (row - 3):
            return c["second"]
        if style == "front" and x > -swoosh + slant * (row - 3):
            return c["second"]
        if row >= CURVE and style == "roof":
            return c["second"]
        return c["base"]

    reach = size.wheel * 1.2
    cuts = [*edges(windows), *edges(doors), swoosh, -swoosh]
    tube(builder, outline, (front, rear), (head, tail), cuts, painter, [(a, reach) for a in axles], size.wheel + reach)
    if kind == "double":
        _upper_windows(builder, rng, size, front, rear, c, count)
    if bonnet:
        _bonnet(rng, builder, size, front, bonnet, c)
    for axle in axles:
        with builder.both_sides():
            wheel(builder, (axle, half - 0.17, size.wheel), size.wheel, 0.3, c["tyre"], c["rim"], c["dark"], 0, 0.6, 14)
    _extras(rng, builder, size, kind, front, c, [*lean])
    return builder


def _draw_size(rng: np.random.Generator, kind: str) -> _Size:
    u = rng.uniform
    length, width, height, floor, sill, head = {
        "city": (u(9, 13.5), u(2.4, 2.6), u(2.85, 3.25), u(0.28, 0.42), u(1.35, 1.6), u(2.35, 2.6)),
        "coach": (u(10, 14), u(2.45, 2.6), u(3.3, 3.9), u(0.32, 0.5), u(1.75, 2.1), u(2.75, 3.1)),
        "double": (u(8.5, 11.5), u(2.4, 2.6), u(4.1, 4.5), u(0.28, 0.4), u(1.3, 1.5), u(2.05, 2.2)),
        "school": (u(8.5, 12), u(2.3, 2.5), u(2.8, 3.2), u(0.55, 0.8), u(1.65, 1.85), u(2.3, 2.5)),
        "mini": (u(5.6, 7.5), u(1.95, 2.2), u(2.4, 2.9), u(0.32, 0.45), u(1.25, 1.45), u(1.95, 2.15)),
    }[kind]
    return _Size(
        length, width, height, floor, sill, min(head, height - 0.3), u(0.42, 0.52) if kind != "mini" else u(0.33, 0.38)
    )


def _axles(rng: np.random.Generator, size: _Size, kind: str) -> list[float]:
    if kind == "school":
        first, last = size.length / 2 - rng.uniform(0.8, 1.2), -size.length / 2 + rng.uniform(0.22, 0.28) * size.length
    else:
        first = size.length / 2 - rng.uniform(0.17, 0.23) * size.length
        last = -size.length / 2 + rng.uniform(0.20, 0.28) * size.length
    if kind in ("coach", "double") and rng.random() < 0.3:
        return [first, last, last - 2.4 * size.wheel]
    return [first, last]


def _doors(rng: np.random.Generator, kind: str, front: float, axles: list[float]) -> list[tuple[float, float]]:
    """Doors on the right side, (low x, high x)."""
    ahead = front - 0.35
    limit = axles[0] + 0.65 if kind != "school" else front - 1.4
    doors = [(max(limit, ahead - 1.3), ahead)] if ahead - limit > 0.5 else []
    if kind == "city":
        middle = (axles[0] + axles[1]) / 2 + rng.uniform(-0.3, 0.6)
        doors.append((middle - 0.65, middle + 0.65))
    return doors


def _colors(rng: np.random.Generator, builder: Builder, kind: str) -> dict[str, str]:
    draw = rng.random()
    base = (
        palette.gray(rng, 0.85, 0.96)
        if draw < 0.42
        else palette.vivid(rng, 0.55, 0.4)
        if draw < 0.85
        else palette.gray(rng, 0.3, 0.8)
    )
    if kind == "school":
        base = palette.jitter(rng, (0.93, 0.68, 0.08), 0.03)
    elif kind == "double" and rng.random() < 0.55:
        base = palette.jitter(rng, (0.75, 0.08, 0.08))
    second = (
        palette.gray(rng, 0.85, 0.95)
        if max(base) - min(base) > 0.3 and rng.random() < 0.5
        else palette.vivid(rng, 0.5, 0.3)
    )
    if kind == "school":
        second = (0.06, 0.06, 0.06)
    glass = (
        palette.jitter(rng, (0.08, 0.09, 0.10), 0.03)
        if rng.random() < 0.75
        else palette.jitter(rng, (0.30, 0.38, 0.44))
    )
    return {
        "base": builder.material("base", base),
        "second": builder.material("second", second),
        "glass": builder.material("glass", glass),
        "door": builder.material("door", palette.gray(rng, 0.12, 0.4)),
        "dark": builder.material("dark", palette.gray(rng, 0.03, 0.1)),
        "trim": builder.material("trim", palette.gray(rng, 0.08, 0.3)),
        "lamp": builder.material("lamp", (0.95, 0.95, 0.88)),
        "tail": builder.material("tail", palette.jitter(rng, (0.72, 0.05, 0.05), 0.04)),
        "sign": builder.material("sign", (0.95, 0.62, 0.12) if rng.random() < 0.6 else (0.85, 0.85, 0.8)),
        "roof": builder.material("roof", palette.gray(rng, 0.6, 0.92)),
        "tyre": builder.material("tyre", palette.rubber(rng)),
        "rim": builder.material("rim", palette.gray(rng, 0.4, 0.8)),
    }


def _front(c: dict[str, str], row: int, share: float, sign: bool, big: bool, bonnet: bool) -> str:
    if row == GLASS or (row == WAIST and big and not bonnet):
        return c["glass"]
    if row == CANTRAIL and sign and not bonnet:
        return c["sign"] if share < 0.6 else c["glass"]
    if row == LOWER and not bonnet and share > 0.5:
        return c["lamp"]
    return c["trim"] if row == SKIRT else c["base"]


def _rear(c: dict[str, str], row: int, share: float, glass: bool, style: str) -> str:
    if row == GLASS and glass and share < 0.9:
        return c["glass"]
    if row in (LOWER, WAIST) and share > 0.8:
        return c["tail"]
    if row == LOWER and share < 0.5:
        return c["trim"]
    if row == SKIRT:
        return c["trim"]
    return c["second"] if style == "rear" else c["base"]


def _upper_windows(
    builder: Builder, rng: np.random.Generator, size: _Size, front: float, rear: float, c: dict[str, str], count: int
) -> None:
    """The second deck's windows, as panels just outside the skin."""
    low, high = size.head + 0.55, size.height - 0.35
    y = size.width / 2 + 0.012
    for a, b in window_row(front - 0.35, rear + 0.3, count, 0.12):
        with builder.both_sides():
            builder.quad([(b, y, low), (a, y, low), (a, y, high), (b, y, high)], c["glass"])
    half = size.width / 2 * 0.8
    builder.box((front - 0.09, 0, (low + high) / 2), (0.24, 2 * half, high - low), c["glass"])
    if rng.random() < 0.8:
        builder.box((rear + 0.08, 0, (low + high) / 2), (0.2, 1.6 * half, 0.9 * (high - low)), c["glass"])


def _bonnet(
    rng: np.random.Generator, builder: Builder, size: _Size, front: float, long: float, c: dict[str, str]
) -> None:
    """An engine bonnet with grille and head lights before the windscreen."""
    wide, top = size.width * rng.uniform(0.72, 0.9), size.sill - rng.uniform(0.05, 0.25)
    middle = (size.floor + top) / 2
    builder.box((front + long / 2 - 0.1, 0, middle), (long + 0.2, wide, top - size.floor), c["base"], taper=(0.9, 0.86))
    face = front + long
    builder.box((face - 0.01, 0, middle - 0.05), (0.08, wide * 0.5, 0.5 * (top - size.floor)), c["trim"])
    builder.box((face, 0, size.floor + 0.1), (0.2, size.width * 0.96, 0.24), c["trim"])
    with builder.both_sides():
        builder.box((face - 0.01, wide * 0.37, middle), (0.09, 0.26, 0.26), c["lamp"])


def _extras(
    rng: np.random.Generator,
    builder: Builder,
    size: _Size,
    kind: str,
    front: float,
    c: dict[str, str],
    lean: list[float],
) -> None:
    """Mirrors, roof units, lamps of school buses, licence plates."""
    half, rear = size.width / 2, -size.length / 2
    if kind == "coach" and rng.random() < 0.75:
        with builder.both_sides():
            x, z = front - lean[GLASS + 1] + 0.02, size.head + 0.12
            builder.tube(
                [(x - 0.1, half * 0.93, z), (x + 0.4, half * 1.04, z), (x + 0.42, half * 1.06, z - 0.4)],
                0.05,
                c["dark"],
                5,
            )
            builder.box((x + 0.42, half * 1.06, z - 0.65), (0.12, 0.22, 0.5), c["dark"])
    elif rng.random() < 0.8:
        with builder.both_sides():
            builder.box((front - 0.05, half + 0.14, size.sill + 0.45), (0.12, 0.26, 0.42), c["dark"])
    if rng.random() < 0.6 and kind != "mini":
        for _ in range(int(rng.integers(1, 3))):
            x = rng.uniform(-0.38, 0.3) * size.length
            long, tall = rng.uniform(0.9, 2.8), rng.uniform(0.12, 0.3)
            builder.box(
                (x, 0, size.height + tall / 2 - 0.02),
                (long, half * rng.uniform(0.9, 1.4), tall),
                c["roof"],
                taper=(0.9, 0.85),
            )
    if kind == "school":
        red = builder.material("beacon", (0.85, 0.1, 0.08))
        for x in (front + 0.02, rear - 0.02):
            with builder.both_sides():
                builder.box((x, half * 0.6, size.height - 0.22), (0.08, 0.2, 0.16), red)
        if rng.random() < 0.7:
            with builder.both_sides():
                builder.box((0, half + 0.015, size.sill - 0.3), (size.length * 0.7, 0.04, 0.09), c["second"])
    builder.box((rear - 0.02, 0, size.floor + 0.45), (0.08, 0.52, 0.13), c["lamp"])
