"""Cutting an image to the object in it: a box, made square, in one size."""

import math
from dataclasses import dataclass

import numpy as np
from PIL import Image

from viewnet.errors import ViewnetError

Box = tuple[float, float, float, float]
"""Left, upper, right and lower edge in pixels from the image's left upper corner."""
LARGEST = 1024  # pixels along a side of a crop
MOST_PIXELS = 2**28
"""Pixels of a crop before it is resized, 1 GB: an image of some kB can be very long, and the square about it huge."""
AROUND = 0.1  # a mask counts within its object's box and this share of the box's sides around it


@dataclass(frozen=True)
class Crop:
    """How photographs are cropped. Raises ViewnetError for values out of range."""

    size: int = 64  # pixels along a side
    margin: float = 0.0  # on either side, as a share of the box's longer side
    square: bool = True  # the crop is a square, so that the object keeps its shape; or the box is stretched to one

    def __post_init__(self) -> None:
        if not 1 <= self.size <= LARGEST:
            raise ViewnetError(f"crop: size {self.size}: expected 1 to {LARGEST} pixels")
        if not 0 <= self.margin <= 2:
            raise ViewnetError(f"crop: margin {self.margin}: expected 0 to 2 sides of the box")


def cut(image: Image.Image, box: Box | None, crop: Crop, mask: np.ndarray | None = None) -> np.ndarray:
    """Crop an image to `box` (pixels from its left upper corner; None: all of it), (size, size, 4) uint8.

    What lies beyond the image's edges is black. A `mask` (H, W) uint8 of the image's size becomes straight alpha, 0
    beyond those edges; colours are black where it is 0. Raises ViewnetError for a box that has no part in the image,
    and for more than MOST_PIXELS.
    """
    width, height = image.size
    x0, y0, x1, y1 = clipped(box or (0.0, 0.0, float(width), float(height)), image.size)
    half_x, half_y = (x1 - x0) / 2, (y1 - y0) / 2
    beyond = 2 * crop.margin * max(half_x, half_y)
    half_x, half_y = half_x + beyond, half_y + beyond
    if crop.square:
        half_x = half_y = max(half_x, half_y)
    centre_x, centre_y = (x0 + x1) / 2, (y0 + y1) / 2
    seen = (centre_x - half_x, centre_y - half_y, centre_x + half_x, centre_y + half_y)
    # Whole pixels around it, the image's own or black; resizing cuts the exact edges.
    (left, upper), (right, lower) = map(math.floor, seen[:2]), map(math.ceil, seen[2:])
    if (right - left) * (lower - upper) > MOST_PIXELS:
        raise ViewnetError(f"box is too large to be cut ({right - left} x {lower - upper} pixels with its margin)")
    part = (max(left, 0), max(upper, 0), min(right, width), min(lower, height))
    canvas = image.crop(part).convert("RGB")
    if mask is not None:
        canvas.putalpha(Image.fromarray(mask).crop(part))
    if canvas.size != (right - left, lower - upper):
        inside, canvas = canvas, Image.new(canvas.mode, (right - left, lower - upper))
        canvas.paste(inside, (part[0] - left, part[1] - upper))
    exact = (seen[0] - left, seen[1] - upper, seen[2] - left, seen[3] - upper)
    # Averages over the pixels that become one, without the ringing of sharper filters at the image's edge; Pillow
    # weights colours by their alpha.
    small = canvas.resize((crop.size, crop.size), Image.Resampling.HAMMING, box=exact, reducing_gap=4.0)
    return np.array(small.convert("RGBA"))


def clipped(box: Box, size: tuple[int, int]) -> Box:
    """The part of a box that lies in an image of this width and height. ViewnetError for less than a pixel of it."""
    x0, y0, x1, y1 = box
    x0, y0, x1, y1 = max(x0, 0.0), max(y0, 0.0), min(x1, float(size[0])), min(y1, float(size[1]))
    if x1 - x0 < 1 or y1 - y0 < 1:
        raise ViewnetError(f"box has no part in the image ({size[0]} x {size[1]})")
    return x0, y0, x1, y1


def reaches_far_beyond(box: Box, size: tuple[int, int]) -> bool:
    """Whether most of a box's area lies outside an image of this width and height: it may be another image's."""
    x0, y0, x1, y1 = clipped(box, size)
    return (x1 - x0) * (y1 - y0) < (box[2] - box[0]) * (box[3] - box[1]) / 2


def shrunk(view: np.ndarray, share: float) -> np.ndarray:
    """A crop (S, S, 4) uint8 resized to `share` of its side about its centre; transparent around it."""
    size = len(view)
    side = max(1, round(share * size))
    start = (size - side) // 2
    small = np.asarray(Image.fromarray(view).resize((side, side), Image.Resampling.HAMMING))
    after = size - side - start
    return np.pad(small, ((start, after), (start, after), (0, 0)))


def bounds(mask: np.ndarray) -> Box:
    """The bounding box of a mask (H, W) uint8. ViewnetError where it is empty."""
    columns, rows = (np.flatnonzero((mask > 127).any(axis)) for axis in (0, 1))
    if not len(columns):
        raise ViewnetError("mask is empty")
    return float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)


def inside(mask: np.ndarray, box: Box) -> np.ndarray:
    """A mask (H, W), zero beyond the box and AROUND it."""
    x0, y0, x1, y1 = box
    wide, high = AROUND * (x1 - x0), AROUND * (y1 - y0)
    rows = slice(max(0, math.floor(y0 - high)), math.ceil(y1 + high))
    columns = slice(max(0, math.floor(x0 - wide)), math.ceil(x1 + wide))
    clipped = np.zeros_like(mask)
    clipped[rows, columns] = mask[rows, columns]
    return clipped
