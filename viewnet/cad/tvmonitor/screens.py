"""Images for screens and for labels of bottles. Arrays (H, W, 3) uint8."""

import numpy as np

from viewnet.cad.finishes import Rgb


def _shade(rng: np.random.Generator, low: float = 0.05, high: float = 0.95) -> Rgb:
    red, green, blue = rng.uniform(low, high, 3)
    return float(red), float(green), float(blue)


def _gradient(top: Rgb, bottom: Rgb, height: int, width: int) -> np.ndarray:
    t = np.linspace(0, 1, height)[:, None, None]
    return np.broadcast_to(np.asarray(top) * (1 - t) + np.asarray(bottom) * t, (height, width, 3)).copy()


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Values in 0..1 as uint8."""
    return (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def screen_image(rng: np.random.Generator, height: int = 36, width: int = 64) -> np.ndarray:
    """A random image on a screen: a reflection on dark glass, a landscape, windows on a desktop, a video, text."""
    kind = int(rng.choice(5, p=[0.3, 0.2, 0.25, 0.15, 0.1]))
    y, x = np.mgrid[0:height, 0:width] / np.array([height, width])[:, None, None]
    if kind == 0:
        glass = _gradient((0.16, 0.17, 0.2), (0.05, 0.05, 0.06), height, width)
        band = ((x * 0.8 - y * 0.6) % 1.1 < rng.uniform(0.1, 0.5)).astype(float)
        return to_bytes(glass + float(rng.uniform(0.02, 0.15)) * band[..., None])
    if kind == 1:
        image = _gradient((0.25, 0.5, 0.85), (0.8, 0.88, 0.95), height, width)
        hill = 0.55 + 0.15 * np.sin(x[0] * rng.uniform(3, 9) + rng.uniform(0, 6))
        image[y > hill] = jitter_green(rng)
        image[y > hill + 0.2] *= 0.8
        return to_bytes(image)
    if kind == 2:
        image = _gradient(_shade(rng, 0.1, 0.6), _shade(rng, 0.1, 0.7), height, width)
        for _ in range(int(rng.integers(1, 4))):
            left, top = int(rng.integers(0, width // 2)), int(rng.integers(0, height // 2))
            right, low = left + int(rng.integers(14, 34)), top + int(rng.integers(10, 20))
            image[top:low, left:right] = float(rng.uniform(0.8, 1.0))
            image[top : top + 2, left:right] = _shade(rng, 0.2, 0.7)
            image[top + 4 : low - 2 : 3, left + 2 : right - 4] = 0.55
        image[-3:] = float(rng.uniform(0.1, 0.8))
        return to_bytes(image)
    if kind == 3:
        image = _gradient(_shade(rng), _shade(rng), height, width)
        for _ in range(5):
            centre, size = rng.uniform(0.1, 0.9, 2), rng.uniform(0.08, 0.3)
            image[(x - centre[0]) ** 2 * 2.5 + (y - centre[1]) ** 2 < size**2] = _shade(rng)
        return to_bytes(image)
    back, ink = ((0.05, 0.06, 0.08), (0.5, 0.8, 0.6)) if rng.random() < 0.5 else ((0.95, 0.95, 0.95), (0.3, 0.3, 0.35))
    image = np.full((height, width, 3), back)
    for row in range(3, height - 3, 3):
        start = int(rng.integers(2, 10))
        image[row, start : start + int(rng.integers(8, 50))] = ink
    return to_bytes(image)


def jitter_green(rng: np.random.Generator) -> Rgb:
    """The colour of a meadow, a field or sand."""
    base = ((0.2, 0.45, 0.15), (0.35, 0.5, 0.2), (0.75, 0.65, 0.4))[int(rng.integers(3))]
    return float(base[0] * rng.uniform(0.8, 1.2)), float(base[1] * rng.uniform(0.8, 1.2)), float(base[2])


def label_image(rng: np.random.Generator, paper: Rgb, ink: Rgb, height: int = 48, width: int = 48) -> np.ndarray:
    """A label: an emblem or a band of colour above or below, lines of text, a border."""
    image = np.full((height, width, 3), paper)
    y, x = np.mgrid[0:height, 0:width] / np.array([height, width])[:, None, None]
    accent = _shade(rng)
    kind = int(rng.integers(4))
    middle = float(rng.uniform(0.28, 0.45))
    if kind == 0:
        image[(x - 0.5) ** 2 + ((y - middle) * 1.1) ** 2 < rng.uniform(0.03, 0.08)] = accent
    elif kind == 1:
        image[np.abs(y - middle) < rng.uniform(0.08, 0.2)] = accent
    elif kind == 2:
        image[np.abs(x - 0.5) + np.abs(y - middle) < rng.uniform(0.15, 0.3)] = accent
    else:
        image[y < middle] = accent
    for row in range(int(height * 0.62), height - 5, 5):
        half = int(rng.integers(width // 8, width * 3 // 8))
        image[row : row + 2, width // 2 - half : width // 2 + half] = ink
    if rng.random() < 0.5:
        image[[1, 2, -2, -3]] = ink
        image[:, [1, -2]] = ink
    return to_bytes(image)


def text_block(rng: np.random.Generator, paper: Rgb, ink: Rgb, height: int = 32, width: int = 32) -> np.ndarray:
    """The small print of a back label: rows of text and a bar code."""
    image = np.full((height, width, 3), paper)
    for row in range(2, height - 12, 3):
        image[row, 3 : 3 + int(rng.integers(width // 2, width - 5))] = ink
    bars = rng.random(width - 12) < 0.5
    image[height - 9 : height - 2, 6 : width - 6][:, bars] = ink
    return to_bytes(image)
