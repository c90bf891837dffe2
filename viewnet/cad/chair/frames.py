"""Legs, seats, back fillings, arms and bases from which the chair generators are put together. Units: metres."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.finishes import Finish
from viewnet.cad.parts import BackSurface, bar, block, choose, patch, pillow, rail, shell, sweep, turned

TURNINGS = (
    ((0, 0.55), (0.06, 0.9), (0.12, 0.6), (0.3, 1.0), (0.5, 0.7), (0.62, 1.1), (0.72, 0.75), (0.8, 1.1), (1, 1.1)),
    ((0, 0.5), (0.25, 0.9), (0.4, 0.65), (0.45, 1.0), (0.5, 0.65), (0.75, 1.1), (0.9, 0.8), (1, 0.8)),
    ((0, 0.6), (0.1, 1.1), (0.18, 0.6), (0.22, 0.95), (0.7, 1.0), (0.75, 0.65), (0.8, 1.05), (1, 1.05)),
)


@dataclass(frozen=True)
class LegLine:
    """A left leg from its top to its foot, (3,) each; `at` gives the point at a height."""

    top: np.ndarray
    foot: np.ndarray

    def at(self, z: float) -> np.ndarray:
        """The point (3,) at the height `z`, on the line through both ends."""
        share = (z - self.foot[2]) / max(self.top[2] - self.foot[2], 1e-9)
        return self.foot + share * (self.top - self.foot)


def seat_grid(
    width: float, depth: float, z: float, taper: float, roundness: float, saddle: float = 0.0, front_drop: float = 0.0
) -> np.ndarray:
    """A seat surface (5, 7, 3): narrower at the back by `taper`, hollowed by `saddle`, front edge lower."""
    flat = patch(5, 7, roundness)
    s, t = flat[..., 0], flat[..., 1]
    y = t * width / 2 * (1 - taper * (1 - s) / 2)
    hollow = saddle * (1 - s**2) * (0.4 + 0.6 * t**2 - 0.6)
    height = z + hollow - front_drop * np.clip(s, 0, 1) ** 3
    return np.stack([s * depth / 2, y, height], axis=-1)


def seat(
    builder: Builder,
    style: str,
    size: tuple[float, float, float],
    top: float,
    finish: Finish,
    frame: Finish,
    taper: float = 0.1,
    roundness: float = 0.1,
) -> None:
    """A seat of size (width, depth, thickness) with its upper side near height `top`, in one of the styles:
    board, saddle, pad (stuffed), dropin (pad on a visible frame), slats.
    """
    width, depth, thick = size
    if style == "slats":
        count = max(3, round(depth / 0.07))
        edges = np.linspace(-depth / 2, depth / 2, count + 1)
        for low, high in pairwise(edges):
            middle = (low + high) / 2
            half = width / 2 * (1 - taper * (1 - 2 * middle / depth) / 2)
            block(builder, (middle, 0, top - thick / 2), ((high - low) * 0.72, 2 * half, thick), finish)
        return
    if style in ("board", "saddle"):
        grid = seat_grid(width, depth, top - thick / 2, taper, roundness, thick * 0.9 if style == "saddle" else 0.0)
        shell(builder, grid, thick, finish)
        return
    if style == "dropin":
        shell(builder, seat_grid(width, depth, top - thick, taper, roundness), thick * 0.7, frame)
        grid = seat_grid(width * 0.9, depth * 0.9, top - thick * 0.5, taper, roundness)
        shell(builder, grid, pillow(5, 7, thick, 0.3, 3.0), finish)
        return
    grid = seat_grid(width, depth, top - thick / 2, taper, roundness, front_drop=thick * 0.2)
    shell(builder, grid, pillow(5, 7, thick, 0.55), finish)


def cross_bar(
    builder: Builder,
    x: float,
    z: float,
    reach: float,
    half: tuple[float, float],
    finish: Finish,
    section: str = "square",
) -> None:
    """A member across the chair from -reach to +reach in y; half sizes (up, along x)."""
    bar(builder, (x, -reach, z), (x, reach, z), half, finish, section, side=(0, 0, 1))


def leg(builder: Builder, line: LegLine, style: str, half: float, finish: Finish, turning: int = 0) -> None:
    """The left leg and its mirror image: square, tapered, round, dowel (thin at both ends), turned, cabriole, metal."""
    if style == "square":
        bar(builder, line.foot, line.top, half, finish, mirror=True, upright=True)
    elif style == "tapered":
        bar(builder, line.foot, line.top, half * 0.6, finish, end_half=half * 1.15, mirror=True, upright=True)
    elif style == "round":
        bar(builder, line.foot, line.top, half * 0.65, finish, "round", end_half=half * 1.1, mirror=True)
    elif style == "dowel":
        turned(builder, line.foot, line.top, [(0, half * 0.6), (0.55, half), (1, half * 0.75)], finish, mirror=True)
    elif style == "turned":
        profile = np.array(TURNINGS[turning % len(TURNINGS)]) * (1, half)
        turned(builder, line.foot, line.top, profile, finish, mirror=True)
    elif style == "cabriole":
        share = np.array([0, 0.08, 0.3, 0.6, 0.85, 1.0])
        swell = np.array([0.5, 0.1, -0.2, 0.05, 0.55, 0.3]) * 0.055
        outward = np.array([1.0 if line.top[0] > 0 else -1.0, 0.8, 0.0])
        path = line.foot + share[:, None] * (line.top - line.foot) + swell[:, None] * outward
        sweep(
            builder, path, half * np.array([0.9, 0.7, 0.6, 0.85, 1.4, 1.3]), finish, "soft", mirror=True, upright=True
        )
    else:
        bar(builder, line.foot, line.top, half * 0.6, finish, "coarse", mirror=True)


def stretchers(
    builder: Builder,
    rng: np.random.Generator,
    style: str,
    front: LegLine,
    rear: LegLine,
    height: float,
    half: float,
    finish: Finish,
    section: str = "square",
) -> None:
    """Bars between the legs: sides, H, box (all four), high (box with the front one raised), ladder (two a side)."""
    if style == "none":
        return
    low = height * float(rng.uniform(0.18, 0.35))
    levels = (low, low + 0.25 * height) if style == "ladder" else (low,)
    for z in levels:
        bar(builder, front.at(z), rear.at(z), half, finish, section, mirror=True)
    middle = (front.at(low) + rear.at(low)) / 2
    if style == "h":
        cross_bar(builder, float(middle[0]), low, float(middle[1]), (half, half), finish, section)
    if style in ("box", "high", "ladder"):
        z = low + (0.15 * height if style == "high" else 0)
        cross_bar(builder, float(front.at(z)[0]), z, float(front.at(z)[1]), (half, half), finish, section)
        cross_bar(builder, float(rear.at(low)[0]), low, float(rear.at(low)[1]), (half, half), finish, section)


BACK_FILLS = {
    "ladder": 0.2,
    "slats": 0.13,
    "spindles": 0.1,
    "splat": 0.1,
    "panel": 0.14,
    "upholstered": 0.14,
    "top": 0.04,
    "two": 0.06,
    "cross": 0.04,
    "lattice": 0.02,
    "cane": 0.03,
    "gallery": 0.04,
}


def fill_back(
    builder: Builder,
    rng: np.random.Generator,
    style: str,
    surface: BackSurface,
    wood: Finish,
    board: Finish,
    cover: Finish,
) -> None:
    """What lies between the posts of a chair back; style: a key of BACK_FILLS."""
    thick = float(rng.uniform(0.008, 0.014))
    arch = float(rng.choice([0.0, 0.0, rng.uniform(0.01, 0.07)]))
    tall = surface.height
    low = float(rng.uniform(0.12, 0.35))

    def horizontal(t: float, half_height: float, bend: float = 0.0) -> None:
        rail(builder, surface, t, (half_height, thick), wood, reach=0.98, arch=bend)

    def upright(u: float, start: float, end: float, half: float, section: str) -> None:
        path = surface.at(u, np.linspace(start, end, 3))
        sweep(builder, path, (half, thick if section == "square" else half), wood, section)

    def board_between(start: float, end: float, half_width: float, finish: Finish, stuffed: float, side: float) -> None:
        u, t = np.meshgrid(np.linspace(-1, 1, 7), np.linspace(0, 1, 5))
        rounded = patch(5, 7, side)
        u, t = rounded[..., 1], (rounded[..., 0] + 1) / 2
        grid = surface.at(u * half_width, start + (end - start) * t + arch * (1 - u**2) * t)
        # d/dt x d/du points backwards, hence the flipped rows.
        shell(builder, grid[::-1], pillow(5, 7, stuffed, 0.45) if stuffed > 0.02 else stuffed, finish)

    if style == "ladder":
        count = int(rng.integers(2, 6))
        half = float(rng.uniform(0.12, 0.3)) * tall * (1 - low) / count
        for t in np.linspace(low, 1 - half / tall, count):
            horizontal(float(t), half, arch)
    elif style in ("slats", "spindles"):
        top = float(rng.uniform(0.022, 0.05))
        count = int(rng.integers(3, 7)) if style == "slats" else int(rng.integers(5, 10))
        foot = low if rng.random() < 0.7 else 0.0
        if foot:
            horizontal(foot, 0.018)
        horizontal(1 - top / tall, top, arch)
        half = float(rng.uniform(0.25, 0.42)) * 1.7 * surface.half0 / (count + 1) if style == "slats" else 0.0075
        for u in np.linspace(-1, 1, count + 2)[1:-1]:
            upright(float(u), foot, 1 - top / tall, half, "square" if style == "slats" else "coarse")
    elif style == "splat":
        top = float(rng.uniform(0.025, 0.05))
        horizontal(1 - top / tall, top, arch)
        foot = low * 0.5 if rng.random() < 0.5 else 0.0
        if foot:
            horizontal(foot, 0.018)
        widths = rng.uniform(0.12, 0.42, 6)
        t = np.linspace(foot, 1 - top / tall, 6)
        sweep(builder, surface.at(0.0, t), np.stack([widths * surface.half0, np.full(6, thick * 0.8)], 1), board)
        if rng.random() < 0.35:
            for u in (-0.6, 0.6):
                upright(u, foot, 1 - top / tall, 0.01, "square")
    elif style == "panel":
        board_between(float(rng.choice([low, 0.02, 0.45])), 1.0, 0.98, board, thick * 1.8, 0.0)
    elif style == "upholstered":
        stuffed = float(rng.uniform(0.025, 0.06))
        bottom = float(rng.choice([low, 0.03]))
        board_between(bottom + 0.03, 0.95, 0.95, cover, stuffed, float(rng.uniform(0, 0.4)))
        if rng.random() < 0.7:
            horizontal(0.97, 0.02, arch)
            horizontal(bottom, 0.018)
    elif style == "top":
        half = float(rng.uniform(0.12, 0.25)) * tall
        horizontal(1 - half / tall, half, arch)
    elif style == "two":
        half = float(rng.uniform(0.05, 0.1)) * tall
        horizontal(1 - half / tall, half, arch)
        horizontal(float(rng.uniform(0.4, 0.6)), half * float(rng.uniform(0.5, 1)))
    elif style == "cross":
        horizontal(0.95, 0.03, arch)
        horizontal(low * 0.6, 0.02)
        for sign in (-1.0, 1.0):
            u = np.linspace(-0.95, 0.95, 5)
            sweep(
                builder, surface.at(sign * u, low * 0.6 + (0.95 - low * 0.6) * (u + 0.95) / 1.9), (0.014, thick), wood
            )
    elif style == "lattice":
        horizontal(0.96, 0.025, arch)
        horizontal(low * 0.6, 0.02)
        for u in np.linspace(-0.66, 0.66, int(rng.integers(3, 6))):
            upright(float(u), low * 0.6, 0.96, 0.008, "square")
        for t in np.linspace(low * 0.6, 0.96, int(rng.integers(4, 6)))[1:-1]:
            horizontal(float(t), 0.008)
    elif style == "cane":
        horizontal(0.96, 0.03, arch)
        horizontal(low, 0.022)
        board_between(low, 0.95, 0.95, cover, 0.008, 0.0)
    else:  # gallery: short spindles between two upper rails
        middle = float(rng.uniform(0.45, 0.65))
        horizontal(0.96, 0.028, arch)
        horizontal(middle, 0.022)
        count = int(rng.integers(3, 8))
        for u in np.linspace(-1, 1, count + 2)[1:-1]:
            upright(float(u), middle, 0.96, 0.008, "coarse")


def wooden_arms(
    builder: Builder,
    rng: np.random.Generator,
    surface: BackSurface,
    width: float,
    depth: float,
    top: float,
    finish: Finish,
    pad: Finish | None = None,
) -> None:
    """Open arms: from the back posts forwards, on a post that stands on the seat's side."""
    height = float(rng.uniform(0.17, 0.25))
    start = surface.at(1.0, height / surface.height)
    reach = float(rng.uniform(0.15, 0.42)) * depth
    flare = float(rng.uniform(0, 0.035))
    end = np.array([reach, width / 2 + flare, top + height + float(rng.uniform(-0.03, 0.02))])
    middle = (start + end) / 2 + np.array([0, flare * 0.6, float(rng.uniform(-0.02, 0.015))])
    tip = end + np.array([0.03, 0.0, float(rng.choice([0.0, -0.025]))])
    half = (float(rng.uniform(0.014, 0.028)), float(rng.uniform(0.009, 0.018)))
    section = choose(rng, {"square": 0.6, "soft": 0.4})
    sweep(builder, np.stack([start, middle, end, tip]), half, finish, section, mirror=True)
    foot = np.array([reach - float(rng.uniform(-0.03, 0.06)), width / 2 - 0.012, top - 0.03])
    bar(builder, foot, end, 0.014, finish, choose(rng, {"square": 0.6, "round": 0.4}), mirror=True)
    if pad is not None:
        shift = np.array([0, 0, half[1] + 0.008])
        sweep(builder, np.stack([middle, end]) + shift, (half[0] * 1.1, 0.014), pad, "soft", mirror=True)


def star_base(
    builder: Builder,
    rng: np.random.Generator,
    top: float,
    radius: float,
    metal: Finish,
    dark: Finish,
    legs: int = 5,
    castors: bool = True,
) -> None:
    """A swivel base: star foot with castors or glides, column up to height `top`. Symmetric in y."""
    hub = 0.095 if castors else 0.06
    tip = 0.065 if castors else 0.02
    start = float(rng.choice([0.0, 180.0])) if legs % 2 else float(rng.choice([0.0, 45.0]))
    for k in range(legs):
        angle = np.deg2rad(start + 360 * k / legs)
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        across = np.array([-out[1], out[0], 0.0])
        high, low = np.array([0, 0, hub]) + 0.02 * out, np.array([0, 0, tip]) + radius * out
        bar(builder, high, low, (0.026, 0.022), metal, end_half=(0.017, 0.013), side=across)
        if castors:
            wheel = (radius - 0.01) * out + np.array([0, 0, 0.028])
            bar(builder, wheel - 0.024 * across, wheel + 0.024 * across, 0.028, dark, "round", side=(0, 0, 1))
    bar(builder, (0, 0, tip), (0, 0, (hub + top) / 2), 0.034 if castors else 0.028, metal, "round")
    bar(builder, (0, 0, (hub + top) / 2), (0, 0, top), 0.018 if castors else 0.026, dark if castors else metal, "round")


def pedestal_base(builder: Builder, top: float, radius: float, finish: Finish, waist: float = 0.03) -> None:
    """A tulip foot: a disc that rises into a column."""
    profile = [
        (0, radius),
        (0.03, radius * 0.97),
        (0.08, radius * 0.45),
        (0.2, waist * 1.3),
        (0.6, waist),
        (1, waist * 2.2),
    ]
    turned(builder, (0, 0, 0), (0, 0, top), profile, finish, section="fine")


def four_legs(
    builder: Builder,
    rng: np.random.Generator,
    style: str,
    width: float,
    depth: float,
    top: float,
    half: float,
    finish: Finish,
    splay: float,
    inset: float = 0.03,
    turning: int = 0,
    center: float = 0.0,
) -> tuple[LegLine, LegLine]:
    """Four equal legs under a seat; `splay`: how far the feet stand out. Returns the left front and rear lines."""
    lines = []
    for sign in (1.0, -1.0):
        foot_x = center + sign * (depth / 2 - inset + splay)
        line = LegLine(
            np.array([center + sign * (depth / 2 - inset), width / 2 - inset, top]),
            np.array([foot_x, width / 2 - inset + splay * 0.8, 0.0]),
        )
        leg(builder, line, style, half, finish, turning)
        lines.append(line)
    return lines[0], lines[1]
