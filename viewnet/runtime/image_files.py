"""Opening image files: only formats that hold images and run nothing, only sizes that fit in memory, one error."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from PIL import Image

from viewnet.errors import ViewnetError

FORMATS = ("JPEG", "PNG", "BMP", "WEBP", "PPM", "TIFF", "GIF")
"""What a file may hold, whatever its name ends in. Of Pillow's others EPS would have Ghostscript run what is in it."""
MOST_PIXELS = 100_000_000
"""Of an image: 0.4 GB once it is decoded. A file of some kB can claim as many as it likes."""


@contextlib.contextmanager
def opened(source: Path | IO[bytes], what: str = "image", formats: tuple[str, ...] = FORMATS) -> Iterator[Image.Image]:
    """An image, its header read, for a block that decodes it and does nothing else.

    Whatever goes wrong in the block, as when the file is damaged, is told by ViewnetError: "`what` does not decode".
    Raises ViewnetError for a file that is not there, of another format or with too many pixels.
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
    except Exception as error:  # Pillow's decoders raise whatever a damaged file makes them stumble over.
        raise ViewnetError(f"{what} does not decode ({type(error).__name__})") from None


def size(source: Path) -> tuple[int, int]:
    """Width and height of an image, from its header. Raises ViewnetError as `opened` does."""
    with opened(source) as image:
        return image.size
