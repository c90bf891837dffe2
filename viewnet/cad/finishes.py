"""Colours and textures of furniture and household objects: wood, fabric, leather, metal, plastic.

The palettes follow what furniture shops and collections of CAD models show: mostly browns, greys, black, white and
beige, some saturated colours. A share of the models is left in one pale grey, as many CAD models are.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from viewnet.cad.builder import Builder

Rgb = tuple[float, float, float]

WOODS: tuple[Rgb, ...] = (
    (0.80, 0.63, 0.42),
    (0.72, 0.53, 0.33),
    (0.62, 0.42, 0.24),
    (0.52, 0.33, 0.18),
    (0.42, 0.25, 0.14),
    (0.33, 0.19, 0.11),
    (0.40, 0.16, 0.09),
    (0.24, 0.14, 0.09),
    (0.15, 0.10, 0.08),
    (0.87, 0.75, 0.56),
    (0.55, 0.27, 0.12),
)
PAINTS: tuple[Rgb, ...] = (
    (0.92, 0.91, 0.88),
    (0.10, 0.10, 0.10),
    (0.55, 0.57, 0.58),
    (0.30, 0.45, 0.50),
    (0.35, 0.50, 0.35),
    (0.65, 0.12, 0.10),
    (0.82, 0.78, 0.66),
    (0.20, 0.28, 0.45),
)
NEUTRAL_FABRICS: tuple[Rgb, ...] = (
    (0.12, 0.12, 0.13),
    (0.25, 0.25, 0.27),
    (0.45, 0.45, 0.46),
    (0.62, 0.61, 0.59),
    (0.80, 0.77, 0.70),
    (0.88, 0.86, 0.82),
    (0.70, 0.62, 0.50),
    (0.55, 0.45, 0.34),
    (0.36, 0.27, 0.20),
)
BRIGHT_FABRICS: tuple[Rgb, ...] = (
    (0.60, 0.08, 0.09),
    (0.42, 0.06, 0.10),
    (0.12, 0.18, 0.38),
    (0.15, 0.30, 0.60),
    (0.18, 0.36, 0.24),
    (0.40, 0.48, 0.22),
    (0.80, 0.45, 0.12),
    (0.85, 0.68, 0.20),
    (0.30, 0.50, 0.55),
    (0.48, 0.25, 0.45),
    (0.75, 0.50, 0.52),
)
LEATHERS: tuple[Rgb, ...] = (
    (0.10, 0.09, 0.09),
    (0.16, 0.13, 0.12),
    (0.32, 0.18, 0.11),
    (0.45, 0.25, 0.14),
    (0.60, 0.38, 0.20),
    (0.35, 0.08, 0.07),
    (0.86, 0.83, 0.77),
    (0.92, 0.92, 0.91),
    (0.72, 0.64, 0.52),
)
METALS: tuple[Rgb, ...] = (
    (0.75, 0.76, 0.78),
    (0.62, 0.63, 0.65),
    (0.45, 0.46, 0.48),
    (0.14, 0.14, 0.15),
    (0.09, 0.09, 0.09),
    (0.88, 0.88, 0.88),
    (0.30, 0.27, 0.24),
    (0.70, 0.56, 0.28),
)
PLASTICS: tuple[Rgb, ...] = (
    (0.93, 0.93, 0.92),
    (0.90, 0.89, 0.85),
    (0.10, 0.10, 0.11),
    (0.35, 0.36, 0.38),
    (0.75, 0.10, 0.10),
    (0.90, 0.42, 0.08),
    (0.92, 0.75, 0.10),
    (0.25, 0.50, 0.22),
    (0.10, 0.25, 0.60),
    (0.35, 0.62, 0.72),
    (0.60, 0.58, 0.54),
)


@dataclass(frozen=True)
class Finish:
    """A material of one model: its name in the builder, whether it has a texture, texture repeats per unit length."""

    name: str
    textured: bool = False
    scale: float = 2.0


def jitter(rng: np.random.Generator, color: Rgb, amount: float = 0.05) -> Rgb:
    """A colour near the given one: brightness varies more than hue. Components stay within 0.02..0.97."""
    shifted = np.asarray(color) * rng.uniform(1 - 3 * amount, 1 + 3 * amount) + rng.normal(0, amount / 2.5, 3)
    red, green, blue = np.clip(shifted, 0.02, 0.97)
    return float(red), float(green), float(blue)


def pick(rng: np.random.Generator, palette: tuple[Rgb, ...]) -> Rgb:
    """A jittered colour of a palette."""
    return jitter(rng, palette[int(rng.integers(len(palette)))])


class Finishes:
    """The materials of one model. A share `plain` of the models has no colours: everything is pale grey."""

    def __init__(self, builder: "Builder", rng: np.random.Generator, plain: float = 0.12) -> None:
        self._builder = builder
        self._rng = rng
        self._count = 0
        self._plain: Rgb | None = None
        if rng.random() < plain:
            shade = float(rng.choice([0.64, 0.8, 0.9, 0.95])) * float(rng.uniform(0.93, 1.02))
            self._plain = (shade, shade, shade)

    def _make(self, color: Rgb, texture: np.ndarray | None = None, scale: float = 2.0) -> Finish:
        self._count += 1
        if self._plain is not None:
            if self._rng.random() < 0.3:
                color = jitter(self._rng, self._plain, 0.04)
                grey = float(np.mean(color))
                color = (grey, grey, grey)
            else:
                color = self._plain
            texture = None
        if texture is not None:
            color = (1.0, 1.0, 1.0)
        name = self._builder.material(f"material{self._count}", color, texture)
        return Finish(name, texture is not None, scale)

    def solid(self, color: Rgb) -> Finish:
        """A given colour, without texture."""
        return self._make(color)

    def wood(self, painted: float = 0.2) -> tuple[Finish, Finish]:
        """(plain, grained) of one wood: for thin members, for boards. `painted`: share of painted wood."""
        rng = self._rng
        if rng.random() < painted:
            finish = self._make(pick(rng, PAINTS))
            return finish, finish
        color = pick(rng, WOODS)
        plain = self._make(color)
        if rng.random() < 0.45:
            return plain, plain
        return plain, self._make(color, wood_texture(rng, color), float(rng.uniform(1.2, 2.5)))

    def fabric(self, patterned: float = 0.3) -> Finish:
        """Woven cloth, with stripes, checks, dots or flowers in the given share of cases."""
        rng = self._rng
        color = pick(rng, NEUTRAL_FABRICS if rng.random() < 0.55 else BRIGHT_FABRICS)
        if rng.random() < 0.12:
            return self._make(color, tweed_texture(rng, color), float(rng.uniform(1.0, 2.5)))
        if rng.random() < patterned:
            other = pick(rng, NEUTRAL_FABRICS if rng.random() < 0.6 else BRIGHT_FABRICS)
            return self._make(color, fabric_texture(rng, color, other), float(rng.uniform(1.2, 4.0)))
        return self._make(color)

    def leather(self) -> Finish:
        """Smooth or slightly mottled leather."""
        rng = self._rng
        color = pick(rng, LEATHERS)
        if rng.random() < 0.2:
            return self._make(color, mottled_texture(rng, color, 0.10), 2.0)
        return self._make(color)

    def upholstery(self) -> Finish:
        """Fabric or leather."""
        return self.leather() if self._rng.random() < 0.4 else self.fabric()

    def metal(self) -> Finish:
        """Chrome, steel, black or coloured metal."""
        rng = self._rng
        return self._make(pick(rng, METALS if rng.random() < 0.92 else PAINTS))

    def plastic(self) -> Finish:
        """Plain plastic."""
        return self._make(pick(self._rng, PLASTICS))

    def dark(self) -> Finish:
        """Black or nearly black plastic or rubber."""
        return self._make(jitter(self._rng, (0.11, 0.11, 0.12)))

    def cane(self) -> Finish:
        """Woven cane or rush."""
        color = pick(self._rng, ((0.78, 0.65, 0.42), (0.68, 0.54, 0.34), (0.55, 0.42, 0.26)))
        return self._make(color, weave_texture(color), float(self._rng.uniform(4, 9)))

    def texture(self, texture: np.ndarray, scale: float = 1.0) -> Finish:
        """A given image, HxWx3 uint8."""
        mean = texture.reshape(-1, 3).mean(0) / 255
        return self._make((float(mean[0]), float(mean[1]), float(mean[2])), texture, scale)


def _to_bytes(values: np.ndarray) -> np.ndarray:
    return (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def _even(half: np.ndarray) -> np.ndarray:
    # Even about u = 0 and periodic: a part that is mirror-symmetric in y gets a symmetric image.
    return np.concatenate([half, half[:, ::-1]], axis=1)


def wood_texture(rng: np.random.Generator, color: Rgb, size: int = 64) -> np.ndarray:
    """Grain running along v: (size, size, 3) uint8, periodic in both directions."""
    lines = rng.normal(0, 1, size // 2)
    lines = np.convolve(np.concatenate([lines[-2:], lines, lines[:2]]), np.ones(3) / 3, mode="same")[2:-2]
    rows = np.arange(size)
    drift = np.rint(1.5 * np.sin(2 * np.pi * rows / size + rng.uniform(0, 6))).astype(int)
    grain = lines[np.clip(np.arange(size // 2)[None, :] + drift[:, None], 0, size // 2 - 1)]
    return _to_bytes(np.asarray(color) * (1 + rng.uniform(0.08, 0.22) * _even(grain)[..., None]))


def mottled_texture(rng: np.random.Generator, color: Rgb, depth: float, size: int = 32) -> np.ndarray:
    """Soft blotches: (size, size, 3) uint8, periodic."""
    coarse = _even(rng.normal(0, 1, (size // 4, size // 8)))
    blotches = np.kron(coarse, np.ones((4, 4)))
    return _to_bytes(np.asarray(color) * (1 + depth * blotches[..., None]))


def tweed_texture(rng: np.random.Generator, color: Rgb, size: int = 48) -> np.ndarray:
    """Coarse yarn of mixed shades: (size, size, 3) uint8, periodic."""
    return _to_bytes(
        np.asarray(color) * (1 + rng.uniform(0.1, 0.3) * _even(rng.normal(0, 1, (size, size // 2)))[..., None])
    )


def weave_texture(color: Rgb, size: int = 32) -> np.ndarray:
    """Over-and-under weave: (size, size, 3) uint8, periodic."""
    index = np.arange(size)
    over = ((index[:, None] // 8 + index[None, :] // 8) % 2).astype(float)
    hole = ((index[:, None] % 8 == 0) | (index[None, :] % 8 == 0)).astype(float)
    return _to_bytes(np.asarray(color) * (1.08 - 0.22 * over - 0.35 * hole)[..., None])


def fabric_texture(rng: np.random.Generator, color: Rgb, other: Rgb, size: int = 64) -> np.ndarray:
    """Stripes, checks, plaid, dots, diamonds or flowers in two colours: (size, size, 3) uint8, even in u, periodic."""
    u, v = np.meshgrid(np.arange(size // 2) + 0.5, np.arange(size) + 0.5)
    count = int(rng.integers(1, 4))
    fu, fv = u * count / size, v * count / size
    kind = int(rng.integers(6))
    if kind == 0:
        amount = (np.abs(fu % 1 - 0.5) < rng.uniform(0.1, 0.3)).astype(float)
    elif kind == 1:
        amount = ((np.abs(fu % 1 - 0.5) < 0.25) ^ (np.abs(fv % 1 - 0.5) < 0.25)).astype(float)
    elif kind == 2:
        amount = 0.5 * (np.abs(fu % 1 - 0.5) < 0.22) + 0.5 * (np.abs(fv % 1 - 0.5) < 0.22)
    elif kind == 3:
        amount = ((fu % 1 - 0.5) ** 2 + (fv % 1 - 0.5) ** 2 < rng.uniform(0.03, 0.1)).astype(float)
    elif kind == 4:
        amount = (np.abs(fu % 1 - 0.5) + np.abs(fv % 1 - 0.5) < rng.uniform(0.25, 0.45)).astype(float)
    else:
        amount = np.zeros_like(u)
        for _ in range(14):
            centre = rng.uniform(0, size, 2)
            gap = np.abs(v - centre[1])
            distance = (u - centre[0] / 2) ** 2 + np.minimum(gap, size - gap) ** 2
            amount[distance < rng.uniform(2, 30)] = rng.uniform(0.4, 1)
    noise = 1 + 0.05 * rng.normal(0, 1, (size, size // 2, 1))
    values = (np.asarray(color) * (1 - amount[..., None]) + np.asarray(other) * amount[..., None]) * noise
    return _to_bytes(_even(values))
