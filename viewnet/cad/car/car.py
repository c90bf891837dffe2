"""Cars of many kinds: their random dimensions and finishes, and how the parts are assembled."""

from dataclasses import replace

import numpy as np

from viewnet.cad import palette
from viewnet.cad.builder import Builder, Color
from viewnet.cad.car.parts import Finish, convertible_top, details, number, pickup_cover, roof_extras, wheels, wing
from viewnet.cad.car.shell import BELT, EDGE, FLOOR, HALF, HIGH, LOW, MID, RAIL, SILL, TOP, WELL, Shape, body
from viewnet.cad.car.special import cargo_box, single_seater, veteran

_Range = tuple[float, float]

# Ranges: metres for length, width, height, clearance and wheel radius; positions along the car as shares of the length
# behind the foremost point; heights as shares of the whole height.
_KINDS: dict[str, dict[str, _Range]] = {
    "sedan": {
        "length": (4.2, 5.1), "width": (1.70, 1.92), "height": (1.38, 1.50), "clearance": (0.16, 0.24),
        "wheel": (0.29, 0.35), "front": (0.175, 0.205), "base": (0.56, 0.62), "nose": (0.44, 0.53),
        "cowl": (0.25, 0.33), "cowl_z": (0.62, 0.68), "screen": (0.11, 0.16), "roof_end": (0.66, 0.74),
        "back": (0.81, 0.89), "deck": (0.64, 0.73), "tail": (0.60, 0.70), "roof_width": (0.60, 0.72),
    },
    "hatchback": {
        "length": (3.5, 4.4), "width": (1.62, 1.82), "height": (1.38, 1.56), "clearance": (0.15, 0.22),
        "wheel": (0.28, 0.34), "front": (0.175, 0.21), "base": (0.58, 0.64), "nose": (0.44, 0.54), "cowl": (0.22, 0.29),
        "cowl_z": (0.60, 0.66), "screen": (0.11, 0.19), "roof_end": (0.80, 0.90), "back": (0.94, 0.98),
        "deck": (0.60, 0.68), "tail": (0.48, 0.60), "roof_width": (0.62, 0.76),
    },
    "estate": {
        "length": (4.3, 5.0), "width": (1.70, 1.90), "height": (1.40, 1.54), "clearance": (0.15, 0.22),
        "wheel": (0.29, 0.35), "front": (0.175, 0.205), "base": (0.56, 0.61), "nose": (0.44, 0.53),
        "cowl": (0.25, 0.31), "cowl_z": (0.61, 0.67), "screen": (0.10, 0.15), "roof_end": (0.88, 0.93),
        "back": (0.96, 0.985), "deck": (0.60, 0.66), "tail": (0.50, 0.60), "roof_width": (0.64, 0.76),
    },
    "suv": {
        "length": (4.0, 5.1), "width": (1.76, 2.0), "height": (1.60, 1.92), "clearance": (0.24, 0.38),
        "wheel": (0.34, 0.42), "front": (0.17, 0.20), "base": (0.57, 0.62), "nose": (0.48, 0.60), "cowl": (0.23, 0.30),
        "cowl_z": (0.60, 0.66), "screen": (0.06, 0.13), "roof_end": (0.87, 0.95), "back": (0.955, 0.985),
        "deck": (0.60, 0.66), "tail": (0.52, 0.62), "roof_width": (0.68, 0.84),
    },
    "minivan": {
        "length": (4.1, 5.2), "width": (1.72, 1.98), "height": (1.60, 1.95), "clearance": (0.15, 0.22),
        "wheel": (0.29, 0.35), "front": (0.17, 0.20), "base": (0.58, 0.63), "nose": (0.40, 0.50), "cowl": (0.15, 0.22),
        "cowl_z": (0.54, 0.60), "screen": (0.14, 0.22), "roof_end": (0.89, 0.95), "back": (0.965, 0.985),
        "deck": (0.54, 0.62), "tail": (0.45, 0.55), "roof_width": (0.70, 0.82),
    },
    "van": {
        "length": (4.4, 6.0), "width": (1.78, 2.05), "height": (1.85, 2.65), "clearance": (0.18, 0.28),
        "wheel": (0.30, 0.36), "front": (0.15, 0.19), "base": (0.56, 0.63), "nose": (0.36, 0.46), "cowl": (0.08, 0.18),
        "cowl_z": (0.48, 0.56), "screen": (0.08, 0.15), "roof_end": (0.95, 0.97), "back": (0.975, 0.988),
        "deck": (0.50, 0.56), "tail": (0.40, 0.50), "roof_width": (0.80, 0.92),
    },
    "pickup": {
        "length": (4.8, 5.9), "width": (1.75, 2.0), "height": (1.62, 1.90), "clearance": (0.26, 0.40),
        "wheel": (0.34, 0.42), "front": (0.165, 0.19), "base": (0.58, 0.63), "nose": (0.50, 0.60), "cowl": (0.24, 0.29),
        "cowl_z": (0.60, 0.66), "screen": (0.06, 0.11), "roof_end": (0.46, 0.62), "back": (0.50, 0.66),
        "deck": (0.58, 0.64), "tail": (0.57, 0.63), "roof_width": (0.66, 0.80),
    },
    "coupe": {
        "length": (4.0, 4.8), "width": (1.72, 1.92), "height": (1.22, 1.40), "clearance": (0.13, 0.19),
        "wheel": (0.30, 0.36), "front": (0.18, 0.21), "base": (0.55, 0.60), "nose": (0.44, 0.52), "cowl": (0.29, 0.38),
        "cowl_z": (0.64, 0.69), "screen": (0.11, 0.17), "roof_end": (0.60, 0.70), "back": (0.83, 0.94),
        "deck": (0.64, 0.74), "tail": (0.60, 0.70), "roof_width": (0.56, 0.68),
    },
    "sports": {
        "length": (4.0, 4.8), "width": (1.80, 2.02), "height": (1.06, 1.24), "clearance": (0.09, 0.15),
        "wheel": (0.31, 0.36), "front": (0.19, 0.24), "base": (0.54, 0.59), "nose": (0.34, 0.46), "cowl": (0.20, 0.30),
        "cowl_z": (0.60, 0.67), "screen": (0.15, 0.23), "roof_end": (0.55, 0.66), "back": (0.80, 0.95),
        "deck": (0.62, 0.76), "tail": (0.60, 0.74), "roof_width": (0.48, 0.62),
    },
    "micro": {
        "length": (2.5, 3.3), "width": (1.46, 1.64), "height": (1.42, 1.60), "clearance": (0.15, 0.20),
        "wheel": (0.26, 0.31), "front": (0.17, 0.21), "base": (0.62, 0.69), "nose": (0.46, 0.54), "cowl": (0.12, 0.20),
        "cowl_z": (0.58, 0.63), "screen": (0.16, 0.24), "roof_end": (0.80, 0.90), "back": (0.94, 0.975),
        "deck": (0.58, 0.66), "tail": (0.48, 0.58), "roof_width": (0.66, 0.78),
    },
    "retro": {
        "length": (3.6, 4.9), "width": (1.56, 1.82), "height": (1.36, 1.52), "clearance": (0.18, 0.24),
        "wheel": (0.28, 0.34), "front": (0.165, 0.20), "base": (0.54, 0.60), "nose": (0.52, 0.58), "cowl": (0.27, 0.33),
        "cowl_z": (0.61, 0.65), "screen": (0.05, 0.10), "roof_end": (0.68, 0.74), "back": (0.76, 0.82),
        "deck": (0.60, 0.65), "tail": (0.56, 0.63), "roof_width": (0.70, 0.80),
    },
}  # fmt: skip
KINDS = {
    "sedan": 20, "hatchback": 15, "estate": 8, "suv": 14, "minivan": 6, "van": 6, "pickup": 6, "coupe": 11,
    "sports": 10, "micro": 4, "retro": 6, "truck": 4, "veteran": 3, "formula": 2.5,
}  # fmt: skip
_SERVICES = {"private": 86.0, "taxi": 5.0, "police": 5.0, "ambulance": 2.0, "racing": 7.0}


def car(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A car: sedan, hatchback, estate, SUV, van, pickup, coupe, convertible, sports car, toy, police car ..."""
    builder = Builder()
    drawn = kind is None
    kind = palette.pick(rng, KINDS, kind)
    toy = rng.random() < 0.12
    service = palette.choose(rng, _SERVICES)
    if service == "racing" and drawn:
        kind = palette.choose(rng, {"sports": 3, "coupe": 2, "hatchback": 0.6})
    if service == "ambulance" and drawn:
        kind = "van" if rng.random() < 0.4 else "truck"
    if kind in ("veteran", "formula"):
        finish = draw_finish(rng, builder, "racing" if kind == "formula" else "private", toy, kind)
        (veteran if kind == "veteran" else single_seater)(rng, builder, finish)
        return builder
    shape = draw_shape(rng, "pickup" if kind == "truck" else kind, toy)
    open_top = kind in ("sports", "coupe") and service == "private" and rng.random() < 0.22
    if open_top:
        shape = replace(shape, trough=(shape.screen - 0.02, shape.roof_end + 0.35 * (shape.back - shape.roof_end), 0.0))
    finish = draw_finish(rng, builder, service, toy, kind)
    if kind == "pickup":
        shape = replace(shape, trough=(shape.back + 0.06, shape.length - 0.12, 0.42 * shape.height))
    if open_top:
        shape = _opened(shape)
    body(builder, shape, Painting(rng, shape, finish, kind, open_top))
    # A few collections hold bodies whose wheels are models of their own.
    if rng.random() > 0.015:
        wheels(rng, builder, shape, finish, toy)
    details(rng, builder, shape, finish, kind, open_top)
    roof_extras(rng, builder, shape, finish, kind, service)
    if service == "racing":
        number(rng, builder, shape, finish)
    if open_top:
        convertible_top(rng, builder, shape, finish)
    if kind == "truck":
        cargo_box(rng, builder, shape, finish, service)
    if kind == "pickup" and rng.random() < 0.25:
        pickup_cover(builder, shape, finish)
    wanted = {"racing": 0.9, "private": {"sports": 0.35, "coupe": 0.15, "hatchback": 0.08}.get(kind, 0.0)}
    if not open_top and rng.random() < wanted.get(service, 0.0):
        wing(rng, builder, shape, finish, large=service == "racing")
    return builder


# Standard deviations of the logarithms of factors.
_STRETCH = {"length": 0.1, "width": 0.06, "height": 0.1, "wheel": 0.08, "clearance": 0.2}
_BEYOND = 1.5


def _beyond(rng: np.random.Generator, low: float, high: float) -> float:
    """A number around the middle of a range, up to _BEYOND times as far from it as its ends."""
    return (low + high) / 2 + _BEYOND * float(rng.uniform(-1, 1)) * (high - low) / 2


def draw_shape(rng: np.random.Generator, kind: str, toy: bool) -> Shape:
    """Random dimensions of a kind of car; toys are short and tall with large wheels and few facets."""
    v = {name: _beyond(rng, *limits) for name, limits in _KINDS[kind].items()}
    # Whole bodies differ more in their proportions than any one measure of a kind.
    for name, spread in _STRETCH.items():
        v[name] *= float(np.exp(rng.normal(0, spread)))
    length, height = v["length"], v["height"]
    if toy:
        length *= rng.uniform(0.72, 0.92)
        v["wheel"] *= rng.uniform(1.05, 1.3)
        v["clearance"] *= rng.uniform(1.0, 1.4)
    v["wheel"] = min(v["wheel"], 0.3 * height if not toy else 0.34 * height, 0.11 * length)
    v["clearance"] = min(v["clearance"], 0.85 * v["wheel"])
    v["tail"] = min(v["tail"], v["deck"])
    v["nose"] = min(v["nose"], v["cowl_z"] - 0.02)
    cowl = max(v["cowl"], 0.08) * length
    screen = cowl + max(v["screen"], 0.03) * length
    roof_end = min(v["roof_end"], 0.97) * length
    back = min(max(v["back"], v["roof_end"] + 0.02), 0.988) * length
    front_axle = max(v["front"] * length, 1.16 * v["wheel"] + 0.12)
    rear_axle = min(front_axle + v["base"] * length, length - 1.16 * v["wheel"] - 0.12)
    cowl_z = v["cowl_z"] * height
    belt = (cowl_z - 0.01 * height, min(cowl_z + rng.uniform(-0.02, 0.07) * height, v["deck"] * height + 0.02))
    sharp = kind in ("retro", "van") or toy
    fastback = kind in ("coupe", "sports", "hatchback", "sedan", "micro")
    roof_drop = rng.uniform(0.0, 0.12) if fastback else rng.uniform(0.0, 0.04)
    return Shape(
        length=length,
        width=v["width"],
        height=height,
        clearance=v["clearance"],
        wheel=v["wheel"],
        tread=v["wheel"] * rng.uniform(0.55, 0.75),
        axles=(front_axle, rear_axle),
        nose_z=v["nose"] * height,
        cowl=cowl,
        cowl_z=cowl_z,
        screen=screen,
        roof_end=max(roof_end, screen + 0.25),
        roof_end_z=height * (1 - roof_drop),
        back=max(back, screen + 0.4),
        deck_z=v["deck"] * height,
        tail_z=v["tail"] * height,
        belt=belt,
        roof_width=min(v["roof_width"], 0.95),
        nose_depth=rng.uniform(0.05, 0.14) if sharp else rng.uniform(0.22, 0.55),
        tail_depth=rng.uniform(0.04, 0.10) if sharp else rng.uniform(0.12, 0.35),
        nose_rake=rng.uniform(0.0, 0.08) if sharp else rng.uniform(0.05, 0.22),
        tail_rake=rng.uniform(0.0, 0.08) if sharp else rng.uniform(0.03, 0.16),
        crown=rng.uniform(0.01, 0.03) if sharp else rng.uniform(0.02, 0.08),
        flare=float(rng.choice([0.0, 0.0, 0.03, 0.05])),
        windows=_windows(rng, kind, cowl, screen, roof_end, back, length),
        coarse=toy,
        stripe=rng.uniform(0.18, 0.45),
        bonnet=(rng.uniform(0.15, 0.5), rng.uniform(0.65, 0.9)),
        taper=rng.uniform(0.0, 0.12),
        bumper=rng.uniform(0.04, 0.1) if sharp or rng.random() < 0.2 else 0.0,
        plan=(0.0, 0.5, 0.94, 1.0) if sharp else (0.0, 0.42, 0.74, 0.91, 1.0),
    )


def _windows(
    rng: np.random.Generator, kind: str, cowl: float, screen: float, roof_end: float, back: float, length: float
) -> tuple[tuple[float, float], ...]:
    """Side windows from the door mirror to the last pillar, cut by the pillars between the doors."""
    start = cowl + rng.uniform(0.35, 0.6) * (screen - cowl)
    pillar = rng.uniform(0.04, 0.12)
    end = roof_end + rng.uniform(0.1, 0.7) * (back - roof_end)
    middle = screen + rng.uniform(0.36, 0.5) * (min(roof_end, screen + 0.45 * length) - screen)
    if kind == "van":
        second = middle + pillar, end - rng.uniform(0.1, 0.3)
        return ((start, middle), second) if rng.random() < 0.3 else ((start, max(middle, start + 0.6)),)
    if kind == "pickup" or kind in ("coupe", "sports", "micro"):
        end = roof_end if kind == "pickup" else end
        if rng.random() < 0.5 or end - start < 1.3:
            return ((start, end),)
        return (start, middle), (middle + pillar, end)
    if kind in ("estate", "suv", "minivan") and rng.random() < 0.75:
        end = back - rng.uniform(0.08, 0.2)
        third = rng.uniform(0.66, 0.74) * end
        if third > middle + pillar + 0.3:
            return (start, middle), (middle + pillar, third), (third + pillar, end)
    return (start, middle), (middle + pillar, end)


def _opened(shape: Shape) -> Shape:
    """The same car without its roof: the top runs along the belt line behind the windscreen."""
    floor = shape.clearance + 0.30 * (shape.cowl_z - shape.clearance)
    start, end = shape.cowl + 0.08, 0.0
    if shape.trough:
        end = shape.trough[1]
    rim = shape.belt[0] + 0.05
    return replace(
        shape,
        height=rim + 0.01,
        roof_end_z=rim,
        deck_z=max(shape.belt[1], rim - 0.02),
        windows=(),
        trough=(start, end, floor),
        crown=0.02,
    )


def draw_finish(rng: np.random.Generator, builder: Builder, service: str, toy: bool, kind: str) -> Finish:
    """Declare the materials of a car."""
    base: Color = palette.vivid(rng) if kind == "formula" and rng.random() < 0.7 else palette.paint(rng)
    second = base
    if service == "taxi":
        base = second = palette.jitter(rng, (0.92, 0.72, 0.08) if rng.random() < 0.75 else (0.08, 0.08, 0.08))
    elif service == "police":
        base, second = [((0.06, 0.06, 0.08), (0.92, 0.92, 0.92)), ((0.93, 0.93, 0.93), (0.08, 0.16, 0.5))][
            int(rng.random() < 0.5)
        ]
    elif service == "ambulance":
        base, second = palette.jitter(rng, (0.92, 0.92, 0.9), 0.02), (0.78, 0.1, 0.08)
    elif service == "racing":
        second = palette.vivid(rng) if rng.random() < 0.7 else (0.95, 0.95, 0.95)
    elif rng.random() < 0.18:
        second = palette.gray(rng, 0.03, 0.1) if rng.random() < 0.5 else palette.gray(rng, 0.8, 0.95)
    glass = palette.jitter(rng, (0.5, 0.76, 0.84)) if toy and rng.random() < 0.6 else palette.glass(rng)
    if max(base) < 0.15 and max(glass) < 0.15 and rng.random() < 0.6:
        glass = palette.gray(rng, 0.2, 0.45)
    trim = palette.gray(rng, 0.04, 0.22) if rng.random() < 0.8 else palette.metal(rng)
    light = (0.95, 0.95, 0.88) if rng.random() < 0.75 else palette.jitter(rng, (0.78, 0.8, 0.82))
    return Finish(
        paint=builder.material("paint", base),
        second=builder.material("second", second),
        glass=builder.material("glass", glass),
        trim=builder.material("trim", trim),
        dark=builder.material("dark", palette.gray(rng, 0.02, 0.10)),
        lamp=builder.material("lamp", palette.jitter(rng, light, 0.02)),
        tail=builder.material("tail", palette.jitter(rng, (0.68, 0.05, 0.05), 0.05)),
        amber=builder.material("amber", palette.jitter(rng, (0.92, 0.50, 0.10), 0.03)),
        chrome=builder.material("chrome", palette.metal(rng)),
        tyre=builder.material("tyre", palette.rubber(rng)),
        rim=builder.material("rim", palette.metal(rng) if rng.random() < 0.8 else palette.gray(rng, 0.12, 0.3)),
        plate=builder.material("plate", (0.9, 0.9, 0.88) if rng.random() < 0.75 else (0.9, 0.8, 0.2)),
        seat=builder.material(
            "seat", palette.jitter(rng, (0.35, 0.22, 0.14) if rng.random() < 0.4 else (0.1, 0.1, 0.1))
        ),
    )


class Painting:
    """Which material each cell of the body has."""

    def __init__(self, rng: np.random.Generator, shape: Shape, finish: Finish, kind: str, open_top: bool) -> None:
        self.shape, self.finish, self.kind, self.open_top = shape, finish, kind, open_top
        self.style = palette.choose(
            rng, {"plain": 6, "stripe": 0.8, "roof": 1.0, "doors": 0.6, "lower": 0.8, "hood": 0.5, "patches": 0.6}
        )
        self.patches = rng.random((HALF, 12)) < rng.uniform(0.15, 0.45)
        self.cladding = bool(rng.random() < (0.5 if kind in ("suv", "pickup", "van") else 0.15))
        self.bumpers = bool(shape.bumper > 0 and rng.random() < 0.6) or bool(shape.coarse and rng.random() < 0.7)
        self.pillars = bool(rng.random() < 0.5)
        self.tall_lamps = kind in ("estate", "suv", "minivan", "van", "micro", "hatchback") and bool(rng.random() < 0.5)
        self.lamp_reach = 1.0 if rng.random() < 0.6 else 0.9
        self.grille = palette.choose(rng, {"dark": 6, "chrome": 2, "none": 1.5})
        self.intake = bool(rng.random() < 0.6)
        self.tail_bar = bool(rng.random() < 0.12)
        self.black_roof = bool(rng.random() < 0.05)
        self.dark_screen = not open_top

    def __call__(self, row: int, x: float, across: float, end: str) -> str:
        s, f = self.shape, self.finish
        if row in (-1, FLOOR, WELL):
            return f.dark
        if end == "front" and row <= BELT:
            return self._front(row, across)
        if end == "rear" and row <= BELT:
            return self._rear(row, across, x)
        if s.trough and s.trough[0] < x < s.trough[1] and row >= EDGE - 1:
            return f.seat if self.open_top else f.trim if row == TOP else f.dark
        if row == SILL:
            return f.trim if self.cladding else self._side(row, x)
        if row in (LOW, MID, HIGH):
            return self._side(row, x)
        if row == BELT:
            if any(a < x < b for a, b in s.windows):
                return f.glass
            inside = s.windows and s.windows[0][0] < x < s.windows[-1][1]
            return f.dark if inside and self.pillars else self._roof(row, x)
        if row == RAIL:
            return self._roof(row, x)
        if not self.open_top and s.cowl < x < s.screen:
            return f.glass
        if not self.open_top and s.roof_end < x < s.back and not (self.kind == "van" and not self.tall_lamps):
            return f.glass
        return self._roof(row, x)

    def _side(self, row: int, x: float) -> str:
        s, f = self.shape, self.finish
        doors = s.cowl + 0.2 < x < s.roof_end
        if self.style == "patches" and self.patches[row, int(12 * x / s.length) % 12]:
            return f.second
        if self.style == "doors" and doors:
            return f.second
        if self.style == "lower" and row in (SILL, LOW):
            return f.second
        return f.second if self.style == "hood" and x < s.cowl else f.paint

    def _roof(self, row: int, x: float) -> str:
        s, f = self.shape, self.finish
        cabin = s.screen - 0.05 < x < s.roof_end + 0.05
        if self.style == "stripe" and row == TOP:
            return f.second
        if self.style == "patches" and self.patches[row, int(12 * x / s.length) % 12]:
            return f.second
        if (self.style in ("roof", "doors") and cabin) or (self.style == "hood" and x < s.cowl):
            return f.second
        return f.dark if self.black_roof and cabin else f.paint

    def _front(self, row: int, across: float) -> str:
        f = self.finish
        if row == SILL:
            return f.trim if self.bumpers or self.cladding else f.dark if self.intake and across < 0.5 else f.paint
        if row == LOW:
            return f.trim if self.bumpers else f.dark if self.intake and across < 0.3 else f.paint
        if row in (MID, HIGH):
            if row == MID and 0.3 < across < self.lamp_reach:
                return f.lamp
            if across > (0.3 if row == MID else 0.5):
                return f.paint
            return {"dark": f.dark, "chrome": f.chrome, "none": f.paint}[self.grille]
        return self._side(row, 0.0)

    def _rear(self, row: int, across: float, x: float) -> str:
        f = self.finish
        if row in (SILL, LOW) and self.bumpers:
            return f.trim
        if row == SILL:
            return f.trim if self.cladding else f.paint
        if row == MID and (across > 0.3 or self.tail_bar):
            return f.tail
        if row == HIGH and across > 0.6 and self.tall_lamps:
            return f.tail
        if row == BELT and across > 0.8 and self.tall_lamps and self.shape.back > 0.93 * self.shape.length:
            return f.tail
        return self._side(row, x)
