"""Opening image files safely: known formats, sizes that fit in memory, one kind of error."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from PIL import Image, ImageOps

from viewnet.errors import ViewnetError

FORMATS = ("JPEG", "PNG", "BMP", "WEBP", "PPM", "TIFF", "GIF")
"""Formats that are decoded, whatever a file's suffix. Of Pillow's others, EPS would run Ghostscript on its content."""
SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".ppm", ".tif", ".tiff")
"""Suffixes of image files, where a folder is searched for them."""
MOST_PIXELS = 100_000_000  # the largest image, 0.4 GB once decoded: a file of some kB can claim any number of pixels


@contextlib.contextmanager
def opened(source: Path | IO[bytes], what: str = "image", formats: tuple[str, ...] = FORMATS) -> Iterator[Image.Image]:
    """An image, its header read, for a block that only decodes it.

    Raises ViewnetError for a file that is missing, of another format or too large, and for any error in the block.
    """
    try:
        with Image.open(source, formats=formats) as image:
            if image.width * image.height > MOST_PIXELS:
                raise ViewnetError(f"{what} has more than {MOST_PIXELS} pixels ({image.width} x {image.height})")
            yield image
    except ViewnetError:
        raise
    except FileNotFoundError:
        raise ViewnetError(f"no such {what}") from None
    except Exception as error:  # Pillow's decoders raise many types for damaged files
        raise ViewnetError(f"{what} does not decode ({type(error).__name__})") from None


def read(source: Path, what: str = "image") -> Image.Image:
    """An image, decoded and turned upright by its EXIF data. Raises ViewnetError, which calls it `what`."""
    with opened(source, what) as image:
        image.load()
        ImageOps.exif_transpose(image, in_place=True)
        return image


def size(source: Path) -> tuple[int, int]:
    """Width and height of an image, from its header. Raises ViewnetError as `opened` does."""
    with opened(source) as image:
        return image.size
