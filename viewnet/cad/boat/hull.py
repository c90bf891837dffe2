"""Hulls and the fittings that boats of many kinds share."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from viewnet.cad.builder import Builder

_ALONG = np.array([-0.5, -0.42, -0.25, -0.05, 0.15, 0.28, 0.38, 0.45, 0.49, 0.5])


@dataclass(frozen=True)
class Hull:
    """A hull from the keel at z = 0; lengths in metres, the bow at x = length / 2."""

    length: float
    beam: float
    depth: float  # height of the rail amidships
    rake: float  # how far the stem leans forward, shares of the depth times four
    stern: float  # width of the transom, share of the beam; 0 for a pointed stern
    sheer: float  # how much the rail rises to the bow
    hollow: bool  # open inside, or decked
    floor: float = 0.35  # height of the floor inside, share of the depth
    cockpit: tuple[float, float] = (-0.5, 0.5)  # the open part, shares of the length from the middle
    vee: float = 0.2  # how sharp the bottom is
    full: bool = False  # a ship's parallel middle body
    both_rise: bool = False  # the rail rises to the stern too

    def width_at(self, u: float) -> float:
        """Share of the beam at u = x / length."""
        bow = np.clip((0.5 - u) / (0.24 if self.full else 0.52), 0, 1)
        ahead = 1 - (1 - bow) ** (2.4 if self.full else 2.1)
        aft = np.clip((u + 0.5) / (0.2 if self.full else 0.42), 0, 1)
        behind = self.stern + (1 - self.stern) * (1 - (1 - aft) ** 2.0)
        return float(max(min(ahead, 1.0) * behind, 0.012))

    def beam_at(self, x: float) -> float:
        """Width between the rails at x."""
        return self.beam * self.width_at(x / self.length)

    def rail_at(self, x: float) -> float:
        """Height of the rail at x."""
        u = x / self.length
        rise = np.clip((u + 0.1) / 0.6, 0, 1) ** 2
        if self.both_rise:
            rise = max(rise, np.clip((-u - 0.1) / 0.4, 0, 1) ** 2)
        return float(self.depth + self.sheer * rise)


def hull(builder: Builder, form: Hull, c: dict[str, str]) -> None:
    """Add a hull with bottom, side, stripe below the rail, rail, and deck or inside."""
    rings, middles = [], []
    start, end = form.cockpit
    along = sorted({*_ALONG.tolist(), *([start, start + 0.01, end, end + 0.01] if form.hollow else [])})
    along = [u for u in along if -0.5 <= u <= 0.5]
    for u in along:
        x = u * form.length
        half, rail = form.beam_at(x) / 2, form.rail_at(x)
        lift = np.clip((u - 0.15) / 0.35, 0, 1) ** 2 * 0.45 * form.depth
        if form.stern < 0.3:
            lift = max(lift, np.clip((-u - 0.15) / 0.35, 0, 1) ** 2 * 0.4 * form.depth)
        keel = lift * 0.6
        chine = keel + form.vee * 0.55 * form.depth
        low = keel + max(0.42 * form.depth, 0.42 * (rail - keel))
        open_here = form.hollow and start + 0.005 < u < end + 0.005
        inside = max(form.floor * form.depth, keel + 0.1 * form.depth) if open_here else rail - 0.06 * form.depth
        # The stem leans forward: higher points lie further ahead near the bow.
        lean = 4 * form.rake * form.depth * float(np.clip((u - 0.2) / 0.3, 0, 1))
        heights = [keel, chine, low, keel + 0.8 * (rail - keel), rail, rail, inside, inside]
        widths = [
            0.06 * half,
            0.78 * half * (1 - 0.25 * form.vee),
            0.93 * half,
            0.985 * half,
            half,
            0.9 * half,
            0.86 * half,
            0.0,
        ]
        ring = [(x + lean * (z - form.depth) / form.depth, y, z) for z, y in zip(heights, widths, strict=True)]
        rings.append([*ring, *[(a, -b, z) for a, b, z in ring[-2::-1]]])
        middles.append((u, open_here))
    strips = []
    for (_, a), (_, b) in pairwise(middles):
        top = c["inside"] if a or b else c["deck"]
        half_names = [
            c["bottom"],
            c["bottom"],
            c["side"],
            c["stripe"],
            c["wood"] if form.hollow else c["stripe"],
            top,
            top,
        ]
        strips.append([*half_names, *half_names[::-1], c["bottom"]])
    builder.loft(rings, strips, caps=False)
    # The transom, with the side's colour above the water line.
    outline = np.array(rings[0])
    lower = np.concatenate([outline[:3], outline[-3:]])
    upper = np.concatenate([outline[2:5], outline[-5:-2]])
    builder.polygon(lower, c["bottom"])
    builder.polygon(upper, c["side"])


def deckhouse(
    builder: Builder,
    ends: tuple[float, float],
    wide: float,
    base: float,
    tall: float,
    lean: float,
    c: dict[str, str],
    round_front: bool,
) -> None:
    """A superstructure between two x with a band of windows; its front leans back by `lean`."""
    rear, front = ends
    lean = min(lean, 0.5 * (front - rear))
    corner = 0.35 * wide if round_front else 0.05 * wide
    corner = min(corner, 0.5 * (front - rear))
    rings = []
    for share in (0.0, 0.45, 0.8, 1.0):
        x, y = front - lean * share, wide / 2 * (1 - 0.08 * share)
        z = base + share * tall
        rings.append(
            [(rear, y, z), (rear, -y, z), (x - corner, -y, z), (x, -0.55 * y, z), (x, 0.55 * y, z), (x - corner, y, z)]
        )
    builder.loft(rings, [c["house"], [c["house"], *[c["glass"]] * 5], c["house"]])


def windscreen(builder: Builder, form: Hull, c: dict[str, str], tall: float) -> None:
    """A wrapped windscreen at the front of the cockpit."""
    x = form.cockpit[1] * form.length + 0.05
    half = form.beam_at(x) / 2 * 0.84
    z = form.rail_at(x) - 0.03
    for a, b in (
        ((x + 0.3, 0.6 * half), (x + 0.3, -0.6 * half)),
        ((x - 0.8, half), (x + 0.3, 0.6 * half)),
        ((x + 0.3, -0.6 * half), (x - 0.8, -half)),
    ):
        back = 0.5 * tall
        corners = [(*a, z), (*b, z), (b[0] - back, 0.9 * b[1], z + tall), (a[0] - back, 0.9 * a[1], z + tall)]
        builder.quad(corners, c["glass"])


def outboard(builder: Builder, form: Hull, c: dict[str, str], count: int = 1) -> None:
    """Outboard engines at the transom."""
    x, z = -form.length / 2 - 0.16, form.depth
    size = 0.09 * form.length
    for k in range(count):
        y = (k - (count - 1) / 2) * 0.25 * form.beam
        builder.box((x, y, z + 0.25 * size), (0.75 * size, 0.55 * size, size), c["dark"], taper=(0.8, 0.8))
        builder.box((x - 0.03, y, z - 0.9 * size), (0.3 * size, 0.16 * size, 1.6 * size), c["dark"])


def railing(builder: Builder, form: Hull, c: dict[str, str], tall: float) -> None:
    """A rail on posts around the fore deck."""
    points = []
    for u in (0.0, 0.15, 0.3, 0.42, 0.48):
        x = u * form.length
        points.append(
            (
                x + form.rake * form.depth * float(np.clip((u - 0.2) / 0.3, 0, 1)),
                form.beam_at(x) / 2 * 0.92,
                form.rail_at(x),
            )
        )
    with builder.both_sides():
        builder.tube([(x, y, z + tall) for x, y, z in points], 0.004 * form.length, c["metal"], 4)
        for x, y, z in points:
            builder.cylinder(
                (x, y, z - 0.02), (x, y, z + tall), 0.0035 * form.length, c["metal"], sections=4, caps=False
            )


def mast_and_sails(rng: np.random.Generator, builder: Builder, form: Hull, c: dict[str, str]) -> None:
    """One or two masts with main sails and a foresail, set or furled."""
    length = form.length
    tall = length * rng.uniform(1.0, 1.45)
    places = [(rng.uniform(0.02, 0.14), 1.0)]
    if rng.random() < 0.2:
        places.append((-0.28, 0.72))
    side = float(rng.choice([-1, 1])) * rng.uniform(0.0, 0.22)
    set_sail = rng.random() < 0.8
    gaff = rng.random() < 0.12
    for share, scale in places:
        x, high = share * length, tall * scale + form.depth
        builder.cylinder(
            (x, 0, form.depth * 0.5),
            (x, 0, high),
            0.009 * length,
            c["metal"] if rng.random() < 0.6 else c["wood"],
            sections=6,
        )
        low = form.depth + 0.12 * length
        boom = 0.40 * length * scale
        end = (x - boom * np.cos(side), boom * np.sin(side), low)
        builder.tube([(x, 0, low), end], 0.007 * length, c["wood"], 5)
        if not set_sail:
            middle = [
                (x - 0.1 * boom, 0.1 * boom * np.sin(side), low + 0.015 * length),
                (end[0], end[1], low + 0.015 * length),
            ]
            builder.tube(middle, 0.018 * length, c["accent"] if rng.random() < 0.6 else c["sail"], 6)
            continue
        levels = np.linspace(0, 1, 6)
        sheet = []
        for v in levels:
            reach = boom * ((1 - v) ** 0.85 if not gaff else 1 - 0.45 * v)
            belly = 0.035 * length * np.sin(np.pi * v) * (1 if side >= 0 else -1)
            z = low + v * (high - low - 0.03 * length) * (0.75 if gaff else 1.0)
            for w in (0.0, 0.5, 1.0):
                bulge = belly * np.sin(np.pi * w) + reach * w * np.sin(side)
                sheet.append((x - 0.012 * length - reach * w * np.cos(side), bulge, z))
        _sheet(builder, sheet, 3, c["sail"])
    if set_sail and rng.random() < 0.85:
        x, high = places[0][0] * length, form.depth + tall * rng.uniform(0.8, 0.97)
        bow = 0.48 * length
        foot = form.rail_at(bow) + 0.02 * length
        sheet = []
        for v in np.linspace(0, 1, 5):
            luff = np.array([bow + v * (x - bow), 0.0, foot + v * (high - foot)])
            clew = np.array(
                [x - 0.02 * length + v * 0.0, 0.5 * side * length * (1 - v), foot + 0.02 * length + v * (high - foot)]
            )
            middle = (luff + clew) / 2 + np.array([0, 0.03 * length * np.sin(np.pi * v) * (1 if side >= 0 else -1), 0])
            sheet += [tuple(luff), tuple(middle), tuple(clew)]
        _sheet(builder, sheet, 3, c["sail"] if rng.random() < 0.75 else c["accent"])


def _sheet(builder: Builder, points: list[tuple[float, float, float]], width: int, name: str) -> None:
    rows = len(points) // width
    faces = []
    for r in range(rows - 1):
        for k in range(width - 1):
            a = r * width + k
            faces += [(a, a + 1, a + width + 1), (a, a + width + 1, a + width)]
    builder.add(points, faces, name)
