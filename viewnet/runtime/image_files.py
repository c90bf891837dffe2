"""The one door for images: of known formats and sizes that fit in memory, upright, 8 bits a channel, one kind of error.

What is damaged beside the pixels (EXIF data, colour profiles, texts) does them no harm.
"""

import contextlib
import functools
import importlib
import io
import logging
import re
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
from PIL import Image, UnidentifiedImageError

from viewnet.errors import ViewnetError

log = logging.getLogger(__name__)
for plugin in ("pillow_avif", "PIL.AvifImagePlugin"):
    with contextlib.suppress(ImportError):
        importlib.import_module(plugin)
with contextlib.suppress(ImportError):
    importlib.import_module("pillow_heif").register_heif_opener()

FORMATS = (
    *("JPEG", "PNG", "BMP", "WEBP", "PPM", "TIFF", "GIF"),
    *(name for name in ("AVIF", "HEIF") if name in Image.OPEN),
)
"""Formats that are decoded, whatever a file's suffix. Of Pillow's others, EPS would run Ghostscript on its content."""
SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".ppm", ".tif", ".tiff", ".avif", ".heic", ".heif")
"""Suffixes of image files, where a folder is searched for them."""
MOST_PIXELS = 100_000_000  # the largest image, 0.4 GB once decoded: a file of some kB can claim any number of pixels
TURNS = {number: Image.Transpose(turn) for number, turn in zip(range(2, 9), (0, 3, 1, 5, 4, 6, 2), strict=True)}
"""EXIF's orientation -> what brings it upright."""
PNG = b"\x89PNG\r\n\x1a\n"
PNG_DEPTHS = {"L;2": 2, "L;4": 4, "RGB;16B": 16}  # bits a channel in the file, where Pillow's pixels have 8

warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)  # MOST_PIXELS is the bound here

Source = Path | IO[bytes] | Image.Image


@contextlib.contextmanager
def opened(source: Source, what: str = "image", formats: tuple[str, ...] = FORMATS) -> Iterator[Image.Image]:
    """An image, of a file just its header read, for a block that only decodes or converts it.

    ViewnetError for a file that is missing, not regular, of another format or too large, and any error in the block.
    """
    try:
        if isinstance(source, Path) and source.exists() and not source.is_file():  # a pipe or a device may never end
            raise ViewnetError(f"{what} is {'a folder: expected a file' if source.is_dir() else 'not a regular file'}")
        with contextlib.ExitStack() as files:
            # Of a path Pillow maps some files into memory, and turned ones wrongly.
            file = files.enter_context(source.open("rb")) if isinstance(source, Path) else source
            image = file if isinstance(file, Image.Image) else _open(file, what, formats)
            if image.width * image.height > MOST_PIXELS:
                raise ViewnetError(f"{what} has more than {MOST_PIXELS} pixels ({image.width} x {image.height})")
            yield image
    except ViewnetError:
        raise
    except FileNotFoundError:
        web = re.match(r"[a-z]{2,}:/", str(source))  # of :// a path keeps one stroke
        advice = ": expected a file, not an address: download it and name the copy" if web else ""
        raise ViewnetError(f"no such {what}{advice}") from None
    except Image.DecompressionBombError:
        raise ViewnetError(f"{what} has more than {MOST_PIXELS} pixels") from None
    except Exception as error:  # Pillow's decoders raise many types for damaged files
        said = str(error) if type(error) is OSError else None  # "image file is truncated"; others name Pillow's insides
        reason = getattr(error, "strerror", None) or said or type(error).__name__
        raise ViewnetError(f"{what} does not decode ({reason})") from None


def read(
    source: Source,
    what: str = "image",
    formats: tuple[str, ...] = FORMATS,
    upright: bool = True,
    enough: int = 0,
    own_mode: bool = False,
) -> Image.Image:
    """The `colours` of an image or, in its `own_mode`, itself; `upright` by its EXIF data, the first of several frames.

    Where `enough` pixels a side are, a large JPEG is decoded at a fraction of its size, much faster.
    Raises ViewnetError as `opened` and `colours` do, which call the image `what`.
    """
    with opened(source, what, formats) as image:
        # The further frames of an MPO, which many cameras write, are previews.
        if isinstance(source, Path) and image.format != "MPO" and getattr(image, "is_animated", False):
            _tell_of_frames(source)
        if enough:
            image.draft("RGB", (enough, enough))
        _scale_transparent_colour(image)
        image.load()
        turn = TURNS.get(_orientation(image)) if upright else None
        turned = image if turn is None else image.transpose(turn)
        return turned if own_mode else colours(turned, what)


def colours(image: Image.Image, what: str = "image") -> Image.Image:
    """An image of any mode as RGB or, where anything can be transparent, as RGBA with straight alpha.

    16 bits are scaled by their range, floating point from [0, 1]. Raises ViewnetError for values out of range.
    """
    if image.mode in ("I", "F") or image.mode.startswith("I;16"):
        image = _eight_bits(image, what)
    elif image.mode == "LAB":
        from PIL import ImageCms

        lab, screen = ImageCms.createProfile("LAB"), ImageCms.createProfile("sRGB")
        image = ImageCms.buildTransform(lab, screen, "LAB", "RGB").apply(image)
    return image.convert("RGBA" if image.has_transparency_data else "RGB")


def size(source: Path, upright: bool = True) -> tuple[int, int]:
    """Width and height of an image, `upright` or as it is stored, from its header. ViewnetError as `opened`."""
    with opened(source) as image:
        sideways = upright and "exif" in image.info and _orientation(image) in range(5, 9)
        return (image.height, image.width) if sideways else image.size


def _eight_bits(image: Image.Image, what: str) -> Image.Image:
    """An image of numbers as grey levels."""
    values = np.asarray(image)
    low, high = values.min(), values.max()
    if image.mode == "F":
        if not (low >= 0 and high <= 1):  # false for NaN
            raise ViewnetError(f"{what} is of floating point from {low:g} to {high:g}: expected 0 to 1")
        return Image.fromarray((values * 255).round().astype(np.uint8))
    # Up to 255 the values of 32 bits may be meant as 8 bits or as a nearly black image of 16.
    if image.mode == "I" and (low < 0 or high > 65535 or 0 < high <= 255):
        raise ViewnetError(f"{what} is of 32-bit numbers from {low} to {high}: save it with 8 or 16 bits")
    grey = Image.fromarray(((values.astype(np.uint32) * 255 + 32767) // 65535).astype(np.uint8))
    if (key := image.info.get("transparency")) is not None:
        grey.putalpha(Image.fromarray(values != key).convert("L"))
    return grey


def _scale_transparent_colour(image: Image.Image) -> None:
    """Give a PNG's transparent colour, which has the bits of the file, those of the pixels to come."""
    tiles, key = getattr(image, "tile", None), image.info.get("transparency")
    if image.format == "PNG" and tiles and key is not None and (bits := PNG_DEPTHS.get(tiles[0].args)):
        scaled = [k >> (bits - 8) if bits > 8 else k * 255 // (2**bits - 1) for k in np.atleast_1d(key).tolist()]
        image.info["transparency"] = scaled[0] if image.mode == "L" else tuple(scaled)


def _orientation(image: Image.Image) -> int:
    try:
        return int(image.getexif().get(274, 1))
    except Exception:  # of damaged data, and of many types
        return 1


@functools.cache
def _tell_of_frames(source: Path) -> None:
    log.warning("%s has several frames: the first is used", source)


def _open(file: IO[bytes], what: str, formats: tuple[str, ...]) -> Image.Image:
    """The image in a file, of a PNG also where what is beside its pixels is damaged."""
    try:
        return Image.open(file, formats=formats)
    except (UnidentifiedImageError, ValueError) as error:
        file.seek(0)
        if (head := file.read(16).ljust(16, b"\0")).startswith(PNG):
            file.seek(len(PNG))
            return Image.open(io.BytesIO(PNG + b"".join(_whole_chunks(file.read()))), formats=formats)
        if isinstance(error, ValueError):
            raise
        raise ViewnetError(f"{what} does not decode ({_claimed(head, formats)})") from None


def _whole_chunks(content: bytes) -> Iterator[bytes]:
    """The chunks of a PNG that its pixels need, and its orientation where it is not damaged."""
    start = 0
    while chunk := content[start : start + 12 + int.from_bytes(content[start : start + 4])]:
        kind, whole = chunk[4:8], zlib.crc32(chunk[4:-4]) == int.from_bytes(chunk[-4:])
        if kind[:1].isupper() or kind == b"tRNS" or (whole and kind == b"eXIf"):
            yield chunk
        start += len(chunk)


def _claimed(head: bytes, formats: tuple[str, ...]) -> str:
    """What format the first 16 bytes of an unknown file claim, and which could be read."""
    Image.init()
    claims = (name for name, (_, accepts) in Image.OPEN.items() if accepts and accepts(head) is True)
    kind = head[8:12].decode("latin-1").strip().upper() if head[4:8] == b"ftyp" else next(claims, "no known format")
    if kind in ("HEIC", "HEIX", "MIF1"):
        kind += ", for which install pillow-heif"
    advice = ", damaged or of an unknown kind" if kind in formats else f": save it as one of {', '.join(formats)}"
    return kind + advice
