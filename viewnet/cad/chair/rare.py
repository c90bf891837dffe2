"""Rare chairs: chunky toy chairs, floor chairs, chaises longues, wheelchairs, children's high chairs.

Units: metres.
"""

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.chair.frames import cross_bar, seat_grid
from viewnet.cad.finishes import Finishes
from viewnet.cad.parts import BackSurface, bar, block, choose, cushion, patch, pillow, shell, sweep


def _panel(surface: BackSurface, low: float, high: float, roundness: float) -> np.ndarray:
    flat = patch(5, 7, roundness)
    return surface.at(flat[..., 1], low + (high - low) * (flat[..., 0] + 1) / 2)[::-1]


def chunky(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Thick simple blocks, as children's and garden chairs have, and many low-polygon models."""
    wood, board = fin.wood(0.4)
    cover = fin.fabric() if rng.random() < 0.5 else board
    width, depth = float(rng.uniform(0.42, 0.6)), float(rng.uniform(0.4, 0.55))
    top, tall = float(rng.uniform(0.26, 0.42)), float(rng.uniform(0.3, 0.55))
    half = float(rng.uniform(0.032, 0.055))
    thick = float(rng.uniform(0.06, 0.13))
    lean = tall * float(rng.uniform(0, 0.2))
    x, y = depth / 2 - half, width / 2 - half
    bar(builder, (x, y, 0), (x, y, top - thick / 2), half, wood, mirror=True, upright=True)
    ends = [[-x, y, 0], [-x, y, top], [-x - lean, y, top + tall * float(rng.uniform(0.9, 1.05))]]
    sweep(builder, ends, half, wood, mirror=True, upright=True)
    cushion(builder, (0, 0, top), (depth, width, thick), cover, 0.05, float(rng.uniform(0.6, 0.95)))
    surface = BackSurface(-x + half * float(rng.choice([0.0, 1.3])), top, tall, width / 2, width / 2, lean)
    shell(builder, _panel(surface, float(rng.uniform(0.1, 0.4)), 1.0, 0.06), pillow(5, 7, thick * 0.9, 0.75), cover)
    if rng.random() < 0.4:
        high = top + float(rng.uniform(0.15, 0.22))
        bar(builder, (x, y, top), (x, y, high), half * 0.9, wood, mirror=True, upright=True)
        ends = [[-x - lean * 0.4, y, high], [x + half, y, high]]
        sweep(builder, ends, (half * 1.1, half * 0.5), wood, mirror=True)


def floor_chair(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A seat without legs: bent board or padded rest, with a cushion on the floor."""
    board = fin.wood(0.1)[1] if rng.random() < 0.6 else fin.upholstery()
    width, depth, tall = float(rng.uniform(0.4, 0.55)), float(rng.uniform(0.42, 0.6)), float(rng.uniform(0.36, 0.6))
    lean = tall * float(rng.uniform(0.2, 0.5))
    thick = float(rng.choice([0.02, rng.uniform(0.05, 0.1)]))
    surface = BackSurface(-depth / 2, thick / 2, tall, width / 2, width / 2, lean, bow=0.03)
    shell(builder, _panel(surface, 0.0, 1.0, 0.1), thick, board)
    block(builder, (0, 0, thick / 2), (depth, width, thick), board)
    high = float(rng.uniform(0.06, 0.14))
    size = (depth * 1.05, width * 1.02, high)
    cushion(builder, (0.03, 0, thick + high * 0.4), size, fin.fabric(), 0.12, 0.3)


def chaise(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A chaise longue or reclining chair: one long bent cushion, head behind, feet in front, on a low frame."""
    cover = fin.upholstery()
    frame = fin.metal() if rng.random() < 0.6 else fin.wood(0.1)[0]
    width = float(rng.uniform(0.5, 0.7))
    length = float(rng.uniform(1.35, 1.75))
    head, knee, dip = float(rng.uniform(0.65, 0.95)), float(rng.uniform(0.4, 0.52)), float(rng.uniform(0.28, 0.36))
    feet = float(rng.uniform(0.24, 0.4))
    s = np.linspace(-0.5, 0.5, 9)
    z = np.interp(s, [-0.5, -0.12, 0.0, 0.2, 0.5], [head, dip + 0.05, dip, knee, feet])
    line = np.stack([s * length, z], 1)
    spots = np.linspace(-1, 1, 6) * width / 2
    grid = np.stack([np.repeat(line[:, :1], 6, 1), np.tile(spots, (9, 1)), np.repeat(line[:, 1:], 6, 1)], axis=-1)
    thick = float(rng.uniform(0.06, 0.13))
    ribs = 1 - 0.2 * (np.arange(9) % 2)[:, None] * (rng.random() < 0.5)
    shell(builder, grid, pillow(9, 6, thick, 0.6) * ribs, cover)
    side = np.stack([line[:, 0], np.full(9, width / 2 - 0.02), line[:, 1] - thick * 0.6], 1)
    sweep(builder, side, 0.013, frame, "coarse", mirror=True)
    for share in (0.3, 0.72):
        spot = side[round(share * 8)]
        for toe in (0.13, -0.13):
            bar(builder, (spot[0] + toe, spot[1], 0), spot, 0.014, frame, "coarse", mirror=True)
        cross_bar(builder, float(spot[0]), float(spot[2]), width / 2, (0.012, 0.012), frame, "coarse")
    if rng.random() < 0.6:
        roll = line[0] + np.array([0.1, -0.02])
        bar(
            builder,
            (roll[0], -width * 0.4, roll[1]),
            (roll[0], width * 0.4, roll[1]),
            0.065,
            cover,
            "round",
            side=(0, 0, 1),
        )


def wheelchair(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Large rear wheels, small castors and footrests in front, push handles behind."""
    frame = fin.metal()
    dark = fin.dark()
    cover = fin.leather() if rng.random() < 0.7 else fin.fabric(0)
    width, depth, top = float(rng.uniform(0.42, 0.5)), float(rng.uniform(0.4, 0.45)), float(rng.uniform(0.48, 0.54))
    tall = float(rng.uniform(0.38, 0.46))
    x, y, radius = depth / 2, width / 2, float(rng.uniform(0.27, 0.31))
    shell(builder, seat_grid(width, depth, top, 0, 0.05), pillow(5, 7, 0.05, 0.5), cover)
    surface = BackSurface(-x, top, tall, y, y, 0.05)
    shell(builder, _panel(surface, 0.1, 0.97, 0.05), 0.03, cover)
    angle = np.linspace(0, 2 * np.pi, 19)
    hub = np.array([-x + 0.03, y + 0.06, radius])
    for scale, half, finish, out in ((1.0, 0.016, dark, 0.0), (0.86, 0.008, frame, 0.035)):
        ring = (
            hub + np.stack([np.cos(angle), 0 * angle, np.sin(angle)], 1) * radius * 0.96 * scale + np.array([0, out, 0])
        )
        sweep(builder, ring, half, finish, "coarse", mirror=True)
    for k in range(4):
        spoke = np.array([np.cos(np.pi * k / 4), 0, np.sin(np.pi * k / 4)]) * radius * 0.94
        bar(builder, hub - spoke, hub + spoke, 0.004, frame, "coarse", mirror=True)
    bar(builder, (hub[0], y, radius), hub + np.array([0, 0.03, 0]), 0.025, frame, "round", mirror=True, side=(0, 0, 1))
    bar(
        builder,
        (x + 0.05, y - 0.015, 0.08),
        (x + 0.05, y + 0.015, 0.08),
        0.08,
        dark,
        "round",
        mirror=True,
        side=(0, 0, 1),
    )
    high = top + float(rng.uniform(0.2, 0.25))
    path = [[-x - 0.15, y, top + tall], [-x - 0.05, y, top + tall], [-x, y, top], [-x, y, radius]]
    sweep(builder, path, 0.013, frame, "coarse", mirror=True)
    path = [[-x, y, high], [x * 0.6, y, high], [x * 0.75, y, top], [x + 0.05, y, top - 0.05], [x + 0.2, y, 0.12]]
    sweep(builder, path, 0.012, frame, "coarse", mirror=True)
    bar(builder, (x + 0.05, y, top - 0.05), (x + 0.05, y, 0.1), 0.012, frame, "coarse", mirror=True)
    bar(builder, (-x, y, 0.28), (x + 0.05, y, 0.28), 0.012, frame, "coarse", mirror=True)
    sweep(builder, [[-x * 0.7, y, high + 0.015], [x * 0.5, y, high + 0.015]], (0.022, 0.014), dark, mirror=True)
    block(builder, (x + 0.24, y * 0.55, 0.11), (0.15, 0.13, 0.015), dark, mirror=True)


def high_chair(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A child's high chair: splayed legs, a small seat with arms, a tray in front."""
    frame = fin.wood(0.3)[0] if rng.random() < 0.5 else fin.plastic()
    cover = fin.fabric(0.6) if rng.random() < 0.6 else fin.plastic()
    tray = fin.plastic() if rng.random() < 0.6 else frame
    width, depth, top = float(rng.uniform(0.32, 0.4)), float(rng.uniform(0.28, 0.36)), float(rng.uniform(0.52, 0.62))
    tall, splay = float(rng.uniform(0.34, 0.46)), float(rng.uniform(0.06, 0.14))
    x, y = depth / 2, width / 2
    half = float(rng.uniform(0.014, 0.024))
    style = choose(rng, {"round": 0.6, "square": 0.4})
    for sign in (1.0, -1.0):
        foot, head = (sign * (x + splay), y + splay * 0.6, 0), (sign * x * 0.8, y * 0.9, top)
        bar(builder, foot, head, half, frame, style, mirror=True)
        cross_bar(builder, sign * (x + splay * 0.6), top * 0.3, y + splay * 0.4, (half * 0.7, half * 0.7), frame)
    block(builder, (x + splay * 0.8, 0, top * 0.45), (0.12, width * 0.9, 0.018), frame)
    shell(builder, seat_grid(width, depth, top, 0, 0.1), pillow(5, 7, 0.05, 0.6), cover)
    surface = BackSurface(-x, top, tall, y, y * float(rng.uniform(0.8, 1.0)), tall * float(rng.uniform(0.1, 0.25)))
    shell(builder, _panel(surface, 0.0, 1.0, float(rng.uniform(0.1, 0.5))), pillow(5, 7, 0.05, 0.6), cover)
    high = top + float(rng.uniform(0.16, 0.2))
    sweep(builder, [[-x - 0.02, y, high - 0.02], [x + 0.05, y, high - 0.02]], (half, half * 0.8), frame, mirror=True)
    bar(builder, (x * 0.6, y, top), (x * 0.6, y, high - 0.02), half * 0.8, frame, mirror=True)
    flat = patch(4, 6, float(rng.uniform(0.1, 0.5)))
    grid = np.stack([x + 0.08 + flat[..., 0] * 0.15, flat[..., 1] * (y + 0.06), np.full((4, 6), high)], axis=-1)
    shell(builder, grid, 0.025, tray)
