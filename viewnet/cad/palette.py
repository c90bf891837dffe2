"""Random colours, as frequent as on real objects."""

import colorsys
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from viewnet.cad.builder import Color


def jitter(rng: np.random.Generator, color: ArrayLike, amount: float = 0.04) -> Color:
    """The colour with its brightness and each channel moved a little, kept in 0..1."""
    moved = np.asarray(color, dtype=np.float64) + rng.normal(0, amount) + rng.normal(0, amount / 2, 3)
    r, g, b = np.clip(moved, 0.0, 1.0)
    return float(r), float(g), float(b)


def gray(rng: np.random.Generator, low: float, high: float) -> Color:
    """A nearly neutral gray of a brightness between `low` and `high`."""
    return jitter(rng, [rng.uniform(low, high)] * 3, 0.012)


# Mean, spread and share of the hues of painted objects; violet and pink are rare.
_HUES = np.array([[0.0, 0.015], [0.07, 0.02], [0.14, 0.015], [0.36, 0.05], [0.53, 0.04], [0.62, 0.03], [0.8, 0.08]])
_HUE_SHARES = np.array([0.28, 0.10, 0.13, 0.14, 0.09, 0.21, 0.05])


def vivid(rng: np.random.Generator, saturation: float = 0.55, value: float = 0.3) -> Color:
    """A colour of signs and liveries, at least this saturated and bright; mostly reds and blues."""
    middle, spread = _HUES[rng.choice(len(_HUES), p=_HUE_SHARES)]
    hue = float(rng.normal(middle, spread)) % 1.0
    r, g, b = colorsys.hsv_to_rgb(hue, rng.uniform(saturation, 1.0), rng.uniform(value, 1.0))
    return float(r), float(g), float(b)


def choose(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    """A random key, with a probability in proportion to its weight."""
    shares = np.array(list(weights.values()), dtype=np.float64)
    return list(weights)[int(rng.choice(len(shares), p=shares / shares.sum()))]


def pick(rng: np.random.Generator, kinds: Mapping[str, float], kind: str | None) -> str:
    """`kind` itself, or a random one in proportion to the shares. Raises ValueError for an unknown kind."""
    if kind is None:
        return choose(rng, kinds)
    if kind not in kinds:
        raise ValueError(f"kind {kind!r}: expected one of {', '.join(kinds)}")
    return kind


# Shares follow the paints of new cars (white, black and grays three quarters of all), with colours raised a little
# because collections of models have more coloured ones than roads.
_PAINTS: dict[str, tuple[float, Color]] = {
    "white": (22, (0.93, 0.93, 0.92)),
    "silver": (11, (0.70, 0.71, 0.72)),
    "gray": (11, (0.42, 0.43, 0.45)),
    "black": (13, (0.06, 0.06, 0.07)),
    "red": (13, (0.70, 0.06, 0.06)),
    "blue": (11, (0.10, 0.20, 0.58)),
    "navy": (4, (0.06, 0.09, 0.25)),
    "lightblue": (3, (0.45, 0.62, 0.85)),
    "green": (4, (0.08, 0.36, 0.16)),
    "yellow": (5, (0.92, 0.76, 0.10)),
    "orange": (4, (0.88, 0.42, 0.06)),
    "brown": (2, (0.34, 0.22, 0.14)),
    "beige": (3, (0.76, 0.70, 0.58)),
    "maroon": (2, (0.36, 0.05, 0.10)),
    "violet": (2, (0.42, 0.38, 0.80)),
}


def paint(rng: np.random.Generator) -> Color:
    """The paint of a vehicle."""
    return jitter(rng, _PAINTS[choose(rng, {k: v[0] for k, v in _PAINTS.items()})][1], 0.04)


def glass(rng: np.random.Generator) -> Color:
    """A window seen from outside: mostly nearly black, sometimes gray, bluish or light blue."""
    kind = choose(rng, {"dark": 7, "gray": 2, "blue": 1.2, "sky": 0.8})
    base = {
        "dark": (0.07, 0.08, 0.09),
        "gray": (0.28, 0.30, 0.32),
        "blue": (0.16, 0.24, 0.34),
        "sky": (0.50, 0.76, 0.85),
    }
    return jitter(rng, base[kind], 0.03)


def rubber(rng: np.random.Generator) -> Color:
    """A tyre."""
    return gray(rng, 0.03, 0.14)


def metal(rng: np.random.Generator) -> Color:
    """Bare or chromed metal."""
    return gray(rng, 0.55, 0.9)
