"""Images with masks and boxes, read from files, arrays, tensors and PIL images."""

import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from torch import Tensor

from viewnet.data import mask_files
from viewnet.data.crop import Box, bounds, inside
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files

ARRAYS, FILES = (np.ndarray, Tensor), (Image.Image, str, os.PathLike, io.BytesIO)
ImageLike = Image.Image | str | os.PathLike | io.BytesIO | np.ndarray | Tensor
"""One image: a PIL image, a path, a file's content, an array (H, W), (H, W, 3) or (H, W, 4), or a tensor (1, 3 or 4,
H, W)."""
ImagesLike = ImageLike | Sequence[ImageLike]
"""One image or several: a list, or an array or tensor of one more dimension."""


@dataclass(frozen=True)
class InputImage:
    """An upright image and what is known of the object in it."""

    image: Image.Image
    mask: np.ndarray | None = None  # (H, W) uint8, the object's mask, if it is known
    box: Box | None = None  # the object's box; None: the image is framed already, and a mask is its alpha


def as_list(images: ImagesLike) -> list[ImageLike]:
    """One or several images as a list. ViewnetError if there are none, or they are of another type."""
    if isinstance(images, FILES) or (isinstance(images, ARRAYS) and images.ndim != 4):
        return [images]
    try:
        listed: list[Any] = list(images)
    except TypeError:
        expected = "expected an image, a path, an array or a list of such"
        raise ViewnetError(f"images: got {type(images).__name__}: {expected}") from None
    if not listed:
        raise ViewnetError("images: none were given")
    return listed


def masks_of(masks: Any, count: int) -> list[Any]:
    """A mask, or None, for each of `count` images. ViewnetError for another number of masks."""
    if masks is None:
        return [None] * count
    single = masks.ndim == 2 if isinstance(masks, ARRAYS) else isinstance(masks, FILES)
    return _as_many([masks] if single else list(masks), count, "masks")


def boxes_of(boxes: Any, count: int) -> list[Box | None]:
    """A box (x0, y0, x1, y1), or None, for each of `count` images. ViewnetError for anything else."""
    if boxes is None:
        return [None] * count
    if not hasattr(boxes, "__iter__"):
        raise ViewnetError(f"boxes {boxes!r}: expected x0, y0, x1, y1 in pixels for each image")
    listed = [value.tolist() if isinstance(value, ARRAYS) else value for value in boxes]
    if listed and all(isinstance(value, (int, float, np.number)) for value in listed):
        listed = [listed]
    return [None if box is None else box_of(box) for box in _as_many(listed, count, "boxes")]


def _as_many(values: list[Any], count: int, what: str) -> list[Any]:
    if len(values) != count:
        raise ViewnetError(f"{what}: {len(values)} for {count} images: give one each, or None where there is none")
    return values


def box_of(values: Any) -> Box:
    """The box of four numbers or their texts. ViewnetError for anything else."""
    try:
        x0, y0, x1, y1 = (float(value) for value in values)
    except (TypeError, ValueError):
        raise ViewnetError(f"box {values!r}: expected four numbers x0, y0, x1, y1 in pixels") from None
    if not all(map(math.isfinite, (x0, y0, x1, y1))) or x1 <= x0 or y1 <= y0:
        raise ViewnetError(f"box {values!r}: expected x0, y0, x1, y1 in pixels, x0 below x1 and y0 below y1")
    return x0, y0, x1, y1


def read_image(image: ImageLike, mask: Any = None, box: Box | None = None) -> InputImage:
    """Read an image, turned upright by its EXIF data; without a `mask` its alpha is one, if it has any.

    Only the part of a mask inside of the box counts. ViewnetError for an image or mask that cannot be read, values out
    of range, a mask of another size, and an empty mask.
    """
    decoded, alpha = _decode(image), None
    if mask is not None:
        alpha = _decode_mask(mask)
        if alpha.shape != (decoded.height, decoded.width):
            sizes = f"{alpha.shape[1]} x {alpha.shape[0]}, its image {decoded.width} x {decoded.height}"
            raise ViewnetError(f"mask is {sizes}: expected the same")
    elif decoded.has_transparency_data:
        decoded = decoded.convert("RGBA")
        transparency = np.array(decoded.getchannel("A"))
        alpha = None if transparency.min() == 255 else transparency
    if alpha is None:
        return InputImage(decoded, None, box)
    alpha = alpha if box is None else inside(alpha, box)
    place = bounds(alpha)  # of an empty mask a ViewnetError
    return InputImage(decoded, alpha, None if mask is None and box is None else place)


def _decode(image: ImageLike) -> Image.Image:
    if isinstance(image, ARRAYS):
        return Image.fromarray(_pixels(image))
    if isinstance(image, FILES):
        return image_files.read(image if isinstance(image, (Image.Image, io.BytesIO)) else Path(image))
    raise ViewnetError(f"got {type(image).__name__}: expected a PIL image, a path, a numpy array or a torch tensor")


def _pixels(image: np.ndarray | Tensor) -> np.ndarray:
    """(H, W) or (H, W, 3 or 4) uint8."""
    shape, expected = tuple(image.shape), "(H, W), (H, W, 3) or (H, W, 4)"
    if isinstance(image, Tensor):
        image = image.detach().cpu()
        image = image.movedim(0, -1) if image.ndim == 3 else image  # (H, W, C)
        image = (image.float() if image.is_floating_point() else image).numpy()
        expected = "(H, W), (1, H, W), (3, H, W) or (4, H, W)"
    if image.ndim == 3 and image.shape[-1] == 1:
        image = image[..., 0]  # (H, W)
    if not (image.ndim == 2 or (image.ndim == 3 and image.shape[-1] in (3, 4))) or 0 in shape:
        raise ViewnetError(f"image is {shape}: expected {expected}")
    return np.ascontiguousarray(_eight_bits(image))


def _eight_bits(image: np.ndarray) -> np.ndarray:
    if image.dtype == np.uint8:
        return image
    if not np.issubdtype(image.dtype, np.floating):
        raise ViewnetError(f"image is of {image.dtype}: expected uint8, or floating point in [0, 1]")
    if not (image.min() >= 0 and image.max() <= 1):  # false for NaN
        raise ViewnetError(f"image has values from {image.min():g} to {image.max():g}: expected 0 to 1, or uint8")
    return (image * 255).round().astype(np.uint8)


def _decode_mask(mask: Any) -> np.ndarray:
    """(H, W) uint8, see viewnet.data.mask_files."""
    if isinstance(mask, Image.Image):
        return mask_files.read(mask)
    if isinstance(mask, (str, os.PathLike)):
        return mask_files.read(Path(mask), f"mask {mask}")
    array = mask.detach().cpu().numpy() if isinstance(mask, Tensor) else np.asarray(mask)
    array = array.squeeze(0) if array.ndim == 3 and len(array) == 1 else array  # (H, W)
    if array.ndim != 2:
        raise ViewnetError(f"mask is {array.shape}: expected (H, W)")
    return mask_files.coverage(array)
