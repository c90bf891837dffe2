"""Synthetic scenes as backgrounds: random images of ten kinds, none of which shows a recognisable object.

They are varied rather than realistic, so that a network trained on them copes with photographs. Sizes within an image
are relative, so the same generator gives the same scene at any resolution.
"""

import colorsys
from collections.abc import Callable

import numpy as np
from PIL import Image, ImageDraw, ImageFilter
from scipy.spatial import cKDTree

VERSION = 1  # raise it when a change alters images: it is part of every set of backgrounds' identity

_SMALLEST = 32  # pixels of the shorter side while a scene is made, at least
Rng = np.random.Generator
Kind = Callable[[Rng, int, int], np.ndarray]


def sample(rng: Rng, width: int, height: int) -> np.ndarray:
    """One image (height, width, 3) uint8: a kind at random, then blurred, tinted and lit at random."""
    scale = max(2, -(-_SMALLEST // min(width, height)))
    wide, high = scale * width, scale * height
    fine = KINDS[int(rng.integers(len(KINDS)))](rng, wide, high)
    if rng.random() < 0.6:
        grain = _fractal(rng, wide, high, rng.uniform(0.4, 1.6))
        fine = fine * (1 + rng.uniform(0.02, 0.2) * grain[..., None])
    return _photographed(rng, _drawing(fine).reduce(scale))


def gradients(rng: Rng, width: int, height: int) -> np.ndarray:
    """A few colours that run into each other: seamless paper, sky, a wall out of focus."""
    rows, columns = (int(n) for n in rng.integers(2, 5, 2))
    coarse = _palette(rng, rows * columns).reshape(rows, columns, 3)
    return _array(_drawing(coarse).resize((width, height), Image.Resampling.BICUBIC))


def noise(rng: Rng, width: int, height: int) -> np.ndarray:
    """Noise on all scales in a few colours: clouds, plaster, marble, lawn, gravel."""
    field = _fractal(rng, width, height, rng.uniform(0.6, 2.4), rng.uniform(0.4, 2.5))
    colours = _palette(rng, int(rng.integers(2, 6)))
    stops = np.linspace(-1.5, 1.5, len(colours))
    return np.stack([np.interp(field, stops, channel) for channel in colours.T], axis=-1)


def tilings(rng: Rng, width: int, height: int) -> np.ndarray:
    """Stripes, checks or bricks, rotated, sometimes in perspective."""
    x, y = _grid(width, height)
    angle = rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)])
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    if rng.random() < 0.4:
        depth = 1 / (1.15 + v * rng.uniform(0.3, 0.9))
        u, v = u * depth, depth
    along, across = rng.uniform(1, 12), rng.uniform(1, 12)
    style = rng.choice(["stripes", "checks", "bricks", "waves"])
    first, second, joint = _palette(rng, 3)
    if style == "waves":
        wave = 0.5 + 0.5 * np.sin(2 * np.pi * (along * u + 0.3 * np.sin(across * v)))
        return first + wave[..., None] * (second - first)
    row = np.floor(v * across)
    shift = 0.5 * (row % 2) if style == "bricks" else 0.0
    column = np.floor(u * along + shift)
    if style == "stripes":
        row = np.zeros_like(row)
    image = np.where(((row + column) % 2 == 1)[..., None] & (style != "bricks"), second, first)
    # Every tile has a shade of its own.
    shades = rng.normal(0, rng.uniform(0, 25), (61, 61))
    image = image + shades[row.astype(int) % 61, column.astype(int) % 61][..., None]
    if style == "bricks" or rng.random() < 0.4:
        gap = rng.uniform(0.04, 0.15)
        inside = ((u * along + shift) % 1 > gap) & ((style == "stripes") | (v * across % 1 > gap))
        image = np.where(inside[..., None], image, joint)
    return image


def clutter(rng: Rng, width: int, height: int) -> np.ndarray:
    """Polygons, ellipses, bars and lines, the larger ones behind."""
    image = _drawing(_any_ground(rng, width, height))
    pen, side = ImageDraw.Draw(image), max(width, height)
    count = int(rng.integers(10, 90))
    colours = _palette(rng, count)
    sizes = np.sort(0.04 * rng.pareto(1.3, count).clip(0.3, 12))[::-1] * side
    for size, colour in zip(sizes, colours, strict=True):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        shape, fill = rng.integers(4), _ink(colour)
        if shape == 0:
            stretch = rng.uniform(0.4, 1)
            pen.ellipse((x - size, y - size * stretch, x + size, y + size * stretch), fill)
        elif shape == 1:
            turns = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 8))))
            reach = size * rng.uniform(0.5, 1.2, len(turns))
            pen.polygon(list(zip(x + reach * np.cos(turns), y + reach * np.sin(turns), strict=True)), fill)
        elif shape == 2:
            pen.polygon(_bar(x, y, size, size * rng.uniform(0.1, 1), rng.uniform(0, np.pi)), fill)
        else:
            turn = rng.uniform(0, 2 * np.pi)
            end = (x + 4 * size * np.cos(turn), y + 4 * size * np.sin(turn))
            pen.line([(x, y), end], fill, width=max(1, int(rng.uniform(0.003, 0.02) * side)))
    return _array(image)


def street(rng: Rng, width: int, height: int) -> np.ndarray:
    """Sky, houses with windows, trees and posts, and a ground that runs to the horizon."""
    horizon = int(height * rng.uniform(0.35, 0.7))
    canvas = _drawing(np.concatenate([_sky(rng, width, horizon), _ground(rng, width, height - horizon)]))
    pen = ImageDraw.Draw(canvas)
    for _ in range(int(rng.integers(0, 7))):
        left, wide = rng.uniform(-0.2, 1) * width, rng.uniform(0.1, 0.5) * width
        top, foot = horizon * rng.uniform(-0.3, 0.9), horizon + rng.uniform(0, 0.06) * height
        _house(rng, pen, (left, top, left + wide, foot))
    for _ in range(int(rng.integers(0, 6))):
        x, high = rng.uniform(0, width), rng.uniform(0.15, 0.6) * height
        foot = horizon + rng.uniform(0, 0.1) * height
        if rng.random() < 0.6:
            _tree(rng, pen, x, foot, high)
        else:
            pen.line([(x, foot), (x, foot - high)], _ink(_palette(rng, 1)[0]), width=max(1, width // 90))
    return _array(canvas)


def facade(rng: Rng, width: int, height: int) -> np.ndarray:
    """The front of a house, or shelves, fence and shutters: rectangles in rows, in perspective."""
    image = _drawing(np.broadcast_to(_palette(rng, 1)[0], (height, width, 3)))
    _house(rng, ImageDraw.Draw(image), (-0.1 * width, -0.1 * height, 1.1 * width, 1.1 * height))
    slant = rng.uniform(-0.25, 0.25, 4) * [width, height, width, height]
    corners = (slant[0], slant[1], -slant[0], height, width, height + slant[1], width + slant[2], slant[3])
    slanted = image.transform((width, height), Image.Transform.QUAD, corners, Image.Resampling.BILINEAR)
    mask = Image.new("L", image.size, 255).transform(slanted.size, Image.Transform.QUAD, corners)
    beyond = _drawing(_any_ground(rng, width, height))
    beyond.paste(slanted, mask=mask)
    return _array(beyond)


def room(rng: Rng, width: int, height: int) -> np.ndarray:
    """A wall and a floor of boards or tiles, with frames, windows and boxes."""
    edge = int(height * rng.uniform(0.45, 0.8))
    image = np.empty((height, width, 3))
    wall, floor = (_muted(colour) for colour in _palette(rng, 2))
    light = 1 + rng.uniform(0, 0.35) * np.cos(np.linspace(0, np.pi, width) + rng.uniform(0, np.pi))
    image[:edge] = wall * light[:, None]
    x, y = _grid(width, height - edge)
    depth = 1 / (y + 1 + rng.uniform(0.2, 0.8))
    boards = np.floor(x * depth * rng.uniform(4, 16) + 100)
    if rng.random() < 0.5:
        boards = boards + np.floor(depth * rng.uniform(5, 20))
    shades = rng.normal(0, rng.uniform(3, 18), 53)
    image[edge:] = floor * light[:, None] + shades[boards.astype(int) % 53][..., None]
    canvas = _drawing(image)
    pen = ImageDraw.Draw(canvas)
    if rng.random() < 0.7:
        pen.line([(0, edge), (width, edge)], _ink(wall * rng.uniform(0.5, 1.3)), width=max(2, height // 40))
    for _ in range(int(rng.integers(0, 7))):
        outer, inner = _palette(rng, 2)
        x0, wide, high = rng.uniform(-0.1, 0.9) * width, rng.uniform(0.08, 0.5) * width, rng.uniform(0.1, 0.5) * height
        on_floor = rng.random() < 0.5
        y0 = (edge + rng.uniform(0, 0.15) * height - high) if on_floor else rng.uniform(0, 0.6) * edge
        rim = rng.uniform(0.03, 0.15) * min(wide, high)
        pen.rectangle((x0, y0, x0 + wide, y0 + high), _ink(outer))
        pen.rectangle((x0 + rim, y0 + rim, x0 + wide - rim, y0 + high - rim), _ink(inner))
        for line in range(int(rng.integers(0, 4))):
            level = y0 + high * (line + 1) / 4
            pen.line([(x0, level), (x0 + wide, level)], _ink(outer * 0.7), width=max(1, height // 100))
    return _array(canvas)


def landscape(rng: Rng, width: int, height: int) -> np.ndarray:
    """Ridges behind each other, hazier the farther, perhaps with water before them."""
    image = _sky(rng, width, height)
    haze = image[0].mean(axis=0)
    count = int(rng.integers(2, 6))
    top = height * rng.uniform(0.2, 0.6)
    y = np.arange(height)[:, None]
    for number, colour in enumerate(_palette(rng, count, hue=rng.choice([0.08, 0.25, 0.3, 0.6]))):
        rough = np.cumsum(rng.normal(0, 1, width) + rng.normal(0, 0.6)) * height * rng.uniform(0.002, 0.01)
        ridge = top + (height - top) * (number / count) ** 1.3 + rough - rough.mean()
        near = (number + 1) / count
        layer = haze + (_muted(colour) - haze) * near
        grain = 1 + 0.15 * near * _fractal(rng, width, height, rng.uniform(0.5, 1.5))
        image = np.where((y > ridge)[..., None], layer * grain[..., None], image)
    if rng.random() < 0.3:
        shore = int(height * rng.uniform(0.6, 0.85))
        mirrored = image[shore - 1 :: -1][: height - shore]
        ripple = _fractal(rng, width, len(mirrored), 1.0, 6.0)[..., None]
        image[shore : shore + len(mirrored)] = 0.8 * mirrored + 8 * ripple
    return image


def stones(rng: Rng, width: int, height: int) -> np.ndarray:
    """Cells around scattered points: stones, leaves on the ground, a crowd, crazy paving."""
    count = int(rng.integers(8, 250))
    points = rng.uniform(-0.1, 1.1, (count, 2)) * [width, height * rng.uniform(0.5, 1)]
    x, y = np.meshgrid(np.arange(width), np.linspace(0, points[:, 1].max(), height))
    near, cell = cKDTree(points).query(np.stack([x, y], axis=-1), k=2)
    image = _palette(rng, count)[cell[..., 0]]
    reach = np.sqrt(width * height / count)
    rim = ((near[..., 1] - near[..., 0]) / reach).clip(0, 1)[..., None]
    return image * (1 - rng.uniform(0, 0.8) * np.exp(-rim * rng.uniform(2, 15)))


def foliage(rng: Rng, width: int, height: int) -> np.ndarray:
    """Many short strokes or spots: grass, leaves, twigs; with large soft spots, lights out of focus."""
    image = _drawing(_any_ground(rng, width, height) * rng.uniform(0.3, 1))
    pen, side = ImageDraw.Draw(image), max(width, height)
    count = int(rng.integers(60, 400))
    size, main, spread = rng.uniform(0.01, 0.08) * side, rng.uniform(0, np.pi), rng.uniform(0, 1.5)
    round_ones = rng.random() < 0.4
    for colour in _palette(rng, count, hue=rng.choice([0.1, 0.25, 0.33, rng.random()])):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        reach, turn = size * rng.uniform(0.4, 1.5), main + rng.normal(0, spread)
        if round_ones:
            pen.ellipse((x - reach / 2, y - reach / 2, x + reach / 2, y + reach / 2), _ink(colour))
        else:
            pen.polygon(_bar(x, y, reach, reach * rng.uniform(0.1, 0.5), turn), _ink(colour))
    if rng.random() < 0.3:
        image = image.filter(ImageFilter.GaussianBlur(rng.uniform(0, 0.02) * side))
    return _array(image)


KINDS: tuple[Kind, ...] = (gradients, noise, tilings, clutter, street, facade, room, landscape, stones, foliage)


def _sky(rng: Rng, width: int, height: int) -> np.ndarray:
    """Blue, grey or evening, lighter below, with or without clouds."""
    hue = rng.choice([0.55, 0.6, 0.08], p=[0.4, 0.4, 0.2])
    high = _rgb(hue, rng.uniform(0, 0.6), rng.uniform(0.4, 0.95))
    low = _rgb(hue, rng.uniform(0, 0.25), rng.uniform(0.7, 1))
    image = high + np.linspace(0, 1, height)[:, None, None] ** rng.uniform(0.5, 2) * (low - high)
    image = np.broadcast_to(image, (height, width, 3)).copy()
    if rng.random() < 0.6:
        clouds = _fractal(rng, width, height, rng.uniform(1.5, 2.5), rng.uniform(0.2, 1))
        share = (0.5 * (clouds + rng.uniform(-1, 1))).clip(0, 1)[..., None]
        image += share * (_rgb(0, 0, rng.uniform(0.6, 1)) - image)
    return image


def _ground(rng: Rng, width: int, height: int) -> np.ndarray:
    """A plane that runs to the horizon at its top: lawn, sand, asphalt, with a road or lines on it or not."""
    colour = _muted(_palette(rng, 1)[0])
    x, y = _grid(width, height)
    y = (y + 1.02) / 2
    grain = _fractal(rng, width, height, rng.uniform(0.2, 1.4), 0.3)
    image = colour * (1 + rng.uniform(0, 0.25) * grain[..., None]) * (0.8 + 0.3 * y[..., None])
    if rng.random() < 0.6:
        lane = (x - rng.uniform(-0.5, 0.5) * (1 - y)) / (0.1 + y)
        road = np.abs(lane) < rng.uniform(0.3, 1.2)
        image = np.where(road[..., None], _rgb(0, 0, rng.uniform(0.25, 0.6)) * (1 + 0.08 * grain[..., None]), image)
        dashes = (np.abs(lane) < 0.03) & (np.floor(3 / (y + 0.05)) % 2 == 0)
        image = np.where(dashes[..., None], 235.0, image)
    return image


def _house(rng: Rng, pen: ImageDraw.ImageDraw, box: tuple[float, float, float, float]) -> None:
    """A wall with windows in rows; each of them has its own shade."""
    x0, y0, x1, y1 = box
    wall, glass, rim = _palette(rng, 3)
    wall, glass = _muted(wall), _muted(glass) * rng.uniform(0.4, 1.1)
    pen.rectangle(box, _ink(wall))
    if rng.random() < 0.4:
        peak = (x0 + x1) / 2 + rng.uniform(-0.3, 0.3) * (x1 - x0)
        pen.polygon([(x0, y0), (peak, y0 - 0.3 * (x1 - x0)), (x1, y0)], _ink(rim * 0.7))
    rows, columns = (int(n) for n in rng.integers(1, 9, 2))
    step_x, step_y = (x1 - x0) / columns, (y1 - y0) / rows
    pad_x, pad_y = rng.uniform(0.1, 0.35, 2)
    for row in range(rows):
        for column in range(columns):
            left, top = x0 + (column + pad_x) * step_x, y0 + (row + pad_y) * step_y
            right, foot = x0 + (column + 1 - pad_x) * step_x, y0 + (row + 1 - pad_y) * step_y
            if right - left >= 2 and foot - top >= 2:
                pen.rectangle((left, top, right, foot), _ink(glass + rng.normal(0, 20)), outline=_ink(rim))


def _tree(rng: Rng, pen: ImageDraw.ImageDraw, x: float, foot: float, high: float) -> None:
    pen.line([(x, foot), (x, foot - high)], _ink(_rgb(0.08, 0.4, rng.uniform(0.2, 0.4))), width=max(1, int(high / 12)))
    for _ in range(int(rng.integers(6, 25))):
        dx, dy = rng.normal(0, 0.2, 2) * high
        reach = rng.uniform(0.06, 0.2) * high
        leaf = _rgb(rng.normal(0.28, 0.05), rng.uniform(0.2, 0.8), rng.uniform(0.15, 0.65))
        centre = foot - 0.75 * high + dy
        pen.ellipse((x + dx - reach, centre - reach, x + dx + reach, centre + reach), _ink(leaf))


def _any_ground(rng: Rng, width: int, height: int) -> np.ndarray:
    """A plain ground for shapes."""
    if plain := int(rng.integers(3)):
        return (gradients, noise)[plain - 1](rng, width, height)
    return np.broadcast_to(_palette(rng, 1)[0], (height, width, 3))


def _photographed(rng: Rng, image: Image.Image) -> np.ndarray:
    """Out of focus, brighter or darker on one side, of another contrast, tint and saturation, and grainy; or not."""
    side = max(image.size)
    if rng.random() < 0.4:
        image = image.filter(ImageFilter.GaussianBlur(rng.exponential(0.012) * side))
    pixels = _array(image) / 255
    x, y = _grid(*image.size)
    if rng.random() < 0.5:
        slope = rng.normal(0, 0.25, 2)
        pixels = pixels * np.exp(slope[0] * x + slope[1] * y)[..., None]
    grey = pixels.mean(axis=2, keepdims=True)
    saturations = [0.0, rng.uniform(0.3, 1.0), rng.uniform(1.0, 1.3)]
    pixels = grey + (pixels - grey) * rng.choice(saturations, p=[0.06, 0.5, 0.44])
    pixels = pixels * np.exp(rng.normal(0, 0.08, 3)) * np.exp(rng.normal(0, 0.2))
    middle = pixels.mean()
    pixels = middle + (pixels - middle) * rng.uniform(0.5, 1.25)
    pixels = pixels.clip(0, 1) ** np.exp(rng.normal(0, 0.2))
    pixels = pixels + rng.normal(0, rng.uniform(0, 0.03), pixels.shape)
    return (pixels.clip(0, 1) * 255 + 0.5).astype(np.uint8)


def _palette(rng: Rng, count: int, hue: float | None = None) -> np.ndarray:
    """Matching random colours (count, 3), 0 to 255: few hues, mostly dull, from dark to light."""
    if hue is None:  # those of earth, leaves and sky are more frequent than violet
        hues = [rng.normal(0.09, 0.04), rng.normal(0.28, 0.06), rng.normal(0.59, 0.05), rng.random()]
        hue = rng.choice(hues, p=[0.35, 0.2, 0.2, 0.25])
    spread = rng.choice([0.03, 0.1, 0.5])
    dull, light, contrast = rng.beta(1.2, 2.2), rng.uniform(0.35, 0.85), rng.uniform(0.05, 0.3)
    around = hue + rng.normal(0, spread, count)
    saturation = (dull * rng.uniform(0.4, 1.6, count)).clip(0, 1)
    value = rng.normal(light, contrast, count).clip(0.03, 1)
    return np.array([_rgb(*hsv) for hsv in zip(around, saturation, value, strict=True)])


def _rgb(hue: float, saturation: float, value: float) -> np.ndarray:
    return 255 * np.array(colorsys.hsv_to_rgb(hue % 1, saturation, value))


def _muted(colour: np.ndarray) -> np.ndarray:
    return 0.5 * colour + 0.5 * colour.mean()


def _fractal(rng: Rng, width: int, height: int, slope: float, stretch: float = 1.0) -> np.ndarray:
    """Noise (height, width) of mean 0 and deviation 1 whose amplitudes fall as frequency ** -slope.

    `stretch` above 1 draws it out sideways, below 1 upwards. Slopes of about 1 are those of photographs.
    """
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None]
    frequency = np.hypot(fx * np.sqrt(stretch) * width, fy / np.sqrt(stretch) * height)
    frequency[0, 0] = np.inf
    field = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(height, width))) * frequency**-slope, (height, width))
    return field / max(field.std(), 1e-12)


def _grid(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y (height, width), the longer side from -1 to 1."""
    side = max(width, height)
    return np.meshgrid(np.linspace(-1, 1, width) * width / side, np.linspace(-1, 1, height) * height / side)


def _bar(x: float, y: float, reach: float, thick: float, turn: float) -> list[tuple[float, float]]:
    """The corners of a rectangle about (x, y), rotated by `turn` radians."""
    along, across = np.array([np.cos(turn), np.sin(turn)]) * reach, np.array([-np.sin(turn), np.cos(turn)]) * thick
    centre = np.array([x, y])
    corners = (centre + along + across, centre + along - across, centre - along - across, centre - along + across)
    return [(float(p[0]), float(p[1])) for p in corners]


def _ink(colour: np.ndarray) -> tuple[int, int, int]:
    red, green, blue = np.asarray(colour).clip(0, 255).astype(int).tolist()
    return red, green, blue


def _drawing(pixels: np.ndarray) -> Image.Image:
    return Image.fromarray(np.ascontiguousarray(pixels.clip(0, 255).astype(np.uint8)))


def _array(image: Image.Image) -> np.ndarray:
    return np.asarray(image, dtype=np.float64)
