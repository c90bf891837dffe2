"""The one door for masks: what an image or an array means as a mask, or that it cannot be told."""

import numpy as np
from PIL import Image

from viewnet.errors import ViewnetError
from viewnet.runtime import image_files

FEW = 32  # different values from which on a mask is shades and not numbers of classes
COLOURED = 8  # differences between channels from which on a pixel is no shade of grey: lossy files have small ones


def read(source: image_files.Source, what: str = "mask") -> np.ndarray:
    """The mask (H, W) uint8 in an image, upright by its EXIF data: 0 to 255, see `coverage`.

    It is in the alpha, where any of it is transparent; else in shades of grey, or else in colours or a palette's
    entries, where black and entry 0 are beside the object. Raises ViewnetError, which calls it `what`, for an image
    that cannot be read or whose meaning is ambiguous.
    """
    return coverage(_values(image_files.read(source, what, own_mode=True), what), what)


def read_lossy(image: Image.Image, what: str = "mask") -> np.ndarray:
    """The mask (H, W) uint8 in a frame of a video with lossy compression: 255 where it is lighter than half of white.

    Raises ViewnetError, which calls it `what`, where areas are neither black nor white.
    """
    # Such compression rounds black and white by some levels and makes ramps of edges, so that their shades cover no
    # part of a pixel, and numbers of classes are lost.
    light = np.asarray(image.convert("RGB")).max(axis=2)  # (H, W); of an object in a colour this is 255 too
    on = light > 127
    grey = (light > 63) & (light < 192)
    if (_flat(light, COLOURED) & grey).sum() > 0.1 * on.sum():
        raise ViewnetError(f"{what} is ambiguous (it has areas of grey: expected black and white in a lossy video)")
    return on.astype(np.uint8) * 255


def coverage(values: np.ndarray, what: str = "mask") -> np.ndarray:
    """The mask (H, W) uint8 that an array of booleans or numbers means: 0 beside the object and 255 on it.

    Where there are two values, 0 is beside the object. Shades reach from black to white: 255, 65535 or, in floating
    point, 1. 0 and few low whole numbers are classes, each of which is the object. Raises ViewnetError, which names the
    values, where none of this is certain.
    """
    if values.dtype == bool:
        return values.astype(np.uint8) * 255
    found = np.unique(values)  # NaN last
    low, high = found[0], found[-1]
    shares = values.dtype.kind == "f" and high <= 1
    white = 1 if shares else next((top for top in (255, 65535) if high <= top), 2**32)
    if low < 0 or not np.isfinite(high) or (not shares and (found % 1).any()):
        raise _ambiguous(found, what)
    few = len(found) <= FEW
    marked = (len(found) <= 2 and low == 0) or (low == high and low in (1, white))
    if marked or (few and low == 0 and high <= white / 2 and not shares):
        return (values > 0).astype(np.uint8) * 255
    dark, light = white / 16, white * 15 / 16  # lossy files do not have just black and white
    lossy = ((found > light) & (found < white)).any()
    if (few and high < light) or high <= white / 2 or dark < low < light:
        raise _ambiguous(found, what)
    # Dark areas are no soft edges: they are classes beside a number that stands for none, or for objects' edges.
    grey = (values > 0) & (values < white / 2)
    if few and not lossy and (_flat(values) & grey).sum() > 0.1 * (values >= light).sum():
        raise _ambiguous(found, what)
    return values.astype(np.uint8) if white == 255 else (values * (255 / white)).round().astype(np.uint8)


def _flat(values: np.ndarray, most: float = 0) -> np.ndarray:
    """Where a pixel's eight neighbours differ by `most` at most, (H, W) bool."""
    from scipy import ndimage  # imported late: it takes a quarter of a second

    plain = values.astype(np.float32)  # of what kinds of numbers filters take
    return ndimage.maximum_filter(plain, 3) - ndimage.minimum_filter(plain, 3) <= most


def _values(image: Image.Image, what: str) -> np.ndarray:
    """(H, W): what `coverage` is told of an image."""
    if image.has_transparency_data:
        pixels = np.asarray(image_files.colours(image, what))  # (H, W, 4)
        opaque = pixels[..., 3] > 127
        if not opaque.all():
            shown = pixels[opaque][:, :3] if opaque.any() else pixels[..., :3].reshape(-1, 3)  # (N, 3)
            two = np.unique(shown).tolist() == [0, 255] and not np.ptp(shown, axis=1).any()
            if two or (not opaque.any() and shown.any()):
                raise ViewnetError(f"{what} is ambiguous (its alpha and its colours differ: save one of them)")
            return pixels[..., 3]
    if image.mode == "P":
        return _entries(image, what)
    if image.mode in ("1", "L", "I", "F") or image.mode.startswith("I;16"):
        return np.asarray(image)
    colours = image_files.colours(image, what).convert("RGB")
    if np.ptp(np.asarray(colours), axis=2).max() < COLOURED:
        return np.asarray(colours.convert("L"))
    counted = [colour for _, colour in colours.getcolors(256) or []]
    if (0, 0, 0) not in counted:
        raise ViewnetError(f"{what} is ambiguous (it has {len(counted) or 'many'} colours: expected some on black)")
    return np.asarray(colours).max(axis=2) > 0


def _entries(image: Image.Image, what: str) -> np.ndarray:
    """(H, W): the greys of an image with a palette, where they tell its entries apart, else what is not entry 0."""
    numbers = np.asarray(image)
    used = np.unique(numbers)
    palette = np.array([*(image.getpalette("RGB") or []), *bytes(768)][:768], np.uint8).reshape(256, 3)
    if not np.ptp(palette[used], axis=1).any() and len(np.unique(palette[used, 0])) == len(used):
        return palette[numbers, 0]
    black = ~palette[used].any(axis=1)
    if used[0] == 0 and not black[0] and (black.any() or len(used) == 1):
        raise ViewnetError(f"{what} is ambiguous (entry 0 of its palette is {palette[0].tolist()} and not black)")
    return numbers > 0


def _ambiguous(found: np.ndarray, what: str) -> ViewnetError:
    """The error for values (K,) in ascending order."""
    named = [f"{value:g}" for value in found.tolist()]
    named = [*named[:6], "...", named[-1]] if len(named) > 8 else named
    return ViewnetError(f"{what} is ambiguous (its values are {', '.join(named)}: expected 0 and 255, or 0 and 1)")
