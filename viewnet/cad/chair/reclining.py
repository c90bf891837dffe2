"""Lounge chairs. Units: metres."""

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.chair.frames import cross_bar
from viewnet.cad.finishes import Finishes
from viewnet.cad.parts import bar, pillow, shell, sweep


def lounge(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """An easy chair: one long reclining cushion in a bent or straight open frame with arms."""
    frame = fin.wood(0.1)[0] if rng.random() < 0.75 else fin.metal()
    cover = fin.upholstery()
    width = float(rng.uniform(0.52, 0.66))
    top, depth = float(rng.uniform(0.34, 0.42)), float(rng.uniform(0.48, 0.56))
    tall, lean = float(rng.uniform(0.5, 0.68)), float(rng.uniform(0.2, 0.38))
    x, y = depth / 2, width / 2 + 0.02
    rise = float(rng.uniform(0.02, 0.08))
    line = np.array(
        [
            [-x - lean, top + tall],
            [-x - lean * 0.66, top + tall * 0.66],
            [-x - lean * 0.3, top + tall * 0.3],
            [-x, top + 0.02],
            [-x + 0.12, top],
            [0.05, top + rise * 0.5],
            [x, top + rise],
        ]
    )
    spots = np.linspace(-1, 1, 6)
    grid = np.stack(
        [np.repeat(line[:, :1], 6, 1), np.repeat(spots[None] * width / 2, 7, 0), np.repeat(line[:, 1:], 6, 1)], axis=-1
    )
    thick = float(rng.uniform(0.05, 0.12))
    ribs = 1 - 0.25 * (np.arange(7) % 2)[:, None] * (rng.random() < 0.5)
    shell(builder, grid, pillow(7, 6, thick, 0.6) * ribs, cover)
    high = top + float(rng.uniform(0.16, 0.24))
    half = (float(rng.uniform(0.016, 0.03)), float(rng.uniform(0.01, 0.016)))
    if rng.random() < 0.5:
        path = [
            [-x - lean * 0.6, y, 0.015],
            [x - 0.02, y, 0.015],
            [x + 0.05, y, 0.06],
            [x + 0.05, y, high - 0.1],
            [x, y, high - 0.01],
            [-x - lean * 0.35, y, high - 0.03],
        ]
        sweep(builder, path, half, frame, mirror=True)
    else:
        for foot, head in (((x + 0.02, y, 0), (x - 0.02, y, high)), ((-x - 0.12, y, 0), (-x - 0.02, y, high - 0.02))):
            bar(builder, foot, head, 0.018, frame, "round" if rng.random() < 0.5 else "square", mirror=True)
        sweep(builder, [[-x - lean * 0.5, y, high - 0.02], [x + 0.04, y, high]], half, frame, mirror=True)
        bar(builder, (x, y, top - 0.03), (-x - 0.08, y, top - 0.06), (0.012, 0.022), frame, mirror=True)
    side = np.stack([line[:, 0], np.full(7, y - 0.02), line[:, 1] - thick * 0.5], 1)
    sweep(builder, side[:-1], (0.01, 0.014), frame, mirror=True)
    for spot in (side[1], side[4]):
        cross_bar(builder, float(spot[0]), float(spot[2]) - 0.01, y, (0.014, 0.01), frame)
    if rng.random() < 0.3:
        roll = line[0] + np.array([0.05, -0.06])
        bar(
            builder,
            (roll[0], -width * 0.4, roll[1]),
            (roll[0], width * 0.4, roll[1]),
            (0.05, 0.07),
            cover,
            "round",
            side=(0, 0, 1),
        )
