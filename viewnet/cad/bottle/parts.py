"""Walls, labels and colours of bottles. Units: metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.finishes import Finish, Finishes, Rgb, jitter
from viewnet.cad.parts import circle, put, ring_faces
from viewnet.cad.tvmonitor.screens import label_image, text_block

GREEN_GLASS: tuple[Rgb, ...] = ((0.10, 0.20, 0.10), (0.16, 0.26, 0.12), (0.07, 0.11, 0.07), (0.28, 0.36, 0.18))


BROWN_GLASS: tuple[Rgb, ...] = ((0.26, 0.13, 0.05), (0.33, 0.18, 0.07), (0.18, 0.09, 0.04))


CLEAR: tuple[Rgb, ...] = ((0.78, 0.86, 0.88), (0.70, 0.80, 0.84), (0.85, 0.89, 0.90), (0.62, 0.78, 0.86))


DRINKS: tuple[Rgb, ...] = (
    (0.16, 0.07, 0.04),
    (0.85, 0.42, 0.06),
    (0.75, 0.72, 0.12),
    (0.25, 0.55, 0.15),
    (0.70, 0.10, 0.10),
    (0.75, 0.45, 0.15),
    (0.30, 0.50, 0.75),
)


SPIRITS: tuple[Rgb, ...] = (
    (0.62, 0.32, 0.08),
    (0.75, 0.48, 0.15),
    (0.80, 0.85, 0.85),
    (0.40, 0.16, 0.06),
    (0.7, 0.78, 0.6),
)


BRIGHT: tuple[Rgb, ...] = (
    (0.93, 0.93, 0.92),
    (0.15, 0.40, 0.75),
    (0.85, 0.15, 0.15),
    (0.20, 0.60, 0.30),
    (0.95, 0.75, 0.10),
    (0.90, 0.45, 0.10),
    (0.85, 0.40, 0.60),
    (0.55, 0.30, 0.65),
    (0.12, 0.12, 0.13),
    (0.60, 0.80, 0.85),
    (0.90, 0.85, 0.75),
)


PAPERS: tuple[Rgb, ...] = (
    (0.95, 0.94, 0.90),
    (0.90, 0.84, 0.68),
    (0.10, 0.10, 0.10),
    (0.75, 0.12, 0.12),
    (0.12, 0.22, 0.5),
    (0.15, 0.4, 0.2),
    (0.9, 0.75, 0.2),
    (0.93, 0.93, 0.94),
)


CAPS: tuple[Rgb, ...] = (
    (0.93, 0.93, 0.93),
    (0.75, 0.1, 0.1),
    (0.12, 0.25, 0.6),
    (0.1, 0.1, 0.1),
    (0.2, 0.5, 0.25),
    (0.8, 0.65, 0.25),
    (0.72, 0.73, 0.75),
)


@dataclass(frozen=True)
class Vessel:
    """The outer form: profile (K, 2) of (height, radius), depth and width factors, squareness (1 round, 0.4 square)."""

    profile: np.ndarray
    depth: float = 1.0
    width: float = 1.0
    power: float = 1.0

    def ring(self, z: float, angle: np.ndarray) -> np.ndarray:
        """Points (K, 3) of the wall at a height and at angles (K,) in radians from +x."""
        radius = float(np.interp(z, self.profile[:, 0], self.profile[:, 1]))
        # Necks are round whatever the body is.
        body = np.clip(radius / float(self.profile[:, 1].max()) * 1.6 - 0.6, 0, 1)
        power = 1 + (self.power - 1) * body
        depth, width = 1 + (self.depth - 1) * body, 1 + (self.width - 1) * body
        cos, sin = np.cos(angle), np.sin(angle)
        x = np.sign(cos) * np.abs(cos) ** power * radius * depth
        y = np.sign(sin) * np.abs(sin) ** power * radius * width
        return np.stack([x, y, np.full(len(angle), z)], axis=1)


def shade_of(rng: np.random.Generator, palette: Sequence[Rgb]) -> Rgb:
    """A random colour of a palette, slightly varied."""
    return jitter(rng, palette[int(rng.integers(len(palette)))])


def add_vessel(builder: Builder, vessel: Vessel, bands: Sequence[tuple[float, Finish]], sections: int = 16) -> None:
    """The wall and the floor. bands: (upper height, finish) from below; the wall is cut where the finish changes."""
    heights = vessel.profile[:, 0]
    unit = circle(sections)
    angle = np.arctan2(unit[:, 1], unit[:, 0])
    low = float(heights[0])
    for k, (high, finish) in enumerate(bands):
        inside = heights[(heights > low + 1e-6) & (heights < high - 1e-6)]
        cuts = [low, *inside.tolist(), min(high, float(heights[-1]))]
        rings = np.stack([vessel.ring(z, angle) for z in cuts])
        put(builder, rings.reshape(-1, 3), ring_faces(len(cuts), sections, k in (0, len(bands) - 1)), finish)
        low = high


def add_label(
    builder: Builder,
    vessel: Vessel,
    low: float,
    high: float,
    reach: float,
    finish: Finish,
    behind: bool = False,
    sections: int = 16,
) -> None:
    """A label between two heights, +-`reach` degrees around the front (or `behind`), on a wall of `sections` sides."""
    # The label bends where the wall does and ends on its chords: other points would lie inside the wall.
    turn = np.pi if behind else 0.0
    corners = (np.arange(-sections, sections) + 0.5) * (2 * np.pi / sections)
    limit = np.deg2rad(reach)
    angle = np.array([-limit, *corners[np.abs(corners) < limit - 1e-3].tolist(), limit])
    columns = len(angle)
    step = 2 * np.pi / sections
    below = (np.floor(angle / step - 0.5) + 0.5) * step
    share = ((angle - below) / step)[:, None]
    inside = vessel.profile[(vessel.profile[:, 0] > low) & (vessel.profile[:, 0] < high), 0]
    cuts = np.array([low, *inside.tolist(), high])
    grid = np.stack(
        [
            (1 - share) * vessel.ring(float(z), below + turn) + share * vessel.ring(float(z), below + step + turn)
            for z in cuts
        ]
    )
    grid[..., :2] *= 1.015
    index = np.arange(grid.shape[0] * columns).reshape(-1, columns)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    u, v = np.meshgrid(0.5 + 0.498 * angle / limit, 0.002 + 0.996 * (cuts - low) / (high - low))
    put(builder, grid.reshape(-1, 3), faces, finish, uv=np.stack([u, v], axis=-1).reshape(-1, 2))


def labels(
    builder: Builder,
    rng: np.random.Generator,
    fin: Finishes,
    vessel: Vessel,
    low: float,
    high: float,
    reach: tuple[float, float] = (50, 110),
    back: float = 0.6,
    sections: int = 16,
) -> None:
    """A front label, and with probability `back` a smaller one behind with small print."""
    paper = shade_of(rng, PAPERS)
    ink = (0.1, 0.1, 0.12) if sum(paper) > 1.4 else (0.9, 0.88, 0.8)
    front = fin.texture(label_image(rng, paper, ink))
    around = float(rng.uniform(*reach))
    add_label(builder, vessel, low, high, around, front, sections=sections)
    if rng.random() < back and around < 115:
        span = high - low
        small = fin.texture(text_block(rng, paper, ink))
        add_label(
            builder,
            vessel,
            low + span * float(rng.uniform(0, 0.25)),
            high - span * float(rng.uniform(0, 0.3)),
            float(rng.uniform(28, min(55, 170 - around))),
            small,
            behind=True,
            sections=sections,
        )
