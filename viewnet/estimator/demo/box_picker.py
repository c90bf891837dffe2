"""What a visitor of the page has chosen: an image's file, and in it, corner by corner, its object's box."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image, ImageDraw, ImageOps

from viewnet.data.crop import Box, rgb
from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import opened

SHOWN = 1024
"""Pixels along the longer side of an image as it is shown. Browsers only ever make it smaller: of one that they make
larger gradio tells clicks wrongly."""
EDGE = (213, 94, 0)


@dataclass(frozen=True, eq=False)
class Chosen:
    """An image that a visitor sent, upright.

    path     its file
    name     what the file was called where it came from
    size     width and height in pixels
    display  the image as it is shown: SHOWN pixels along its longer side, before white
    corner   of a box that was begun, in the image's pixels
    """

    path: Path
    name: str
    size: tuple[int, int]
    display: Image.Image
    corner: tuple[float, float] | None = None

    @classmethod
    def of(cls, path: Path, name: str) -> Chosen:
        """Of a file. ViewnetError, by its `name`, where it is no image that can be read."""
        image = read(path, f"image {name}")
        display = image.convert("RGBA") if image.has_transparency_data else rgb(image)
        display = ImageOps.contain(display, (SHOWN, SHOWN))
        if display.mode == "RGBA":
            display = Image.alpha_composite(Image.new("RGBA", display.size, "white"), display)
        return cls(path, name, image.size, display.convert("RGB"))

    def image(self) -> Image.Image:
        """All of it, upright. ViewnetError where the file is gone."""
        return read(self.path, f"image {self.name}")

    def clicked(self, x: float, y: float) -> tuple[Chosen, Box | None]:
        """After a click at a point of `shown`: the corner that begins a box, or the box that it ends."""
        scale = max(self.size) / max(self.display.size)
        point = (round(x * scale, 1), round(y * scale, 1))
        if self.corner is None:
            return replace(self, corner=point), None
        (x0, x1), (y0, y1) = (sorted(pair) for pair in zip(self.corner, point, strict=True))
        return replace(self, corner=None), (x0, y0, x1, y1)

    def clear(self) -> Chosen:
        """Without a corner."""
        return replace(self, corner=None)

    def shown(self, box: Box | None = None) -> Image.Image:
        """`display` with the box, or the corner that begins one, drawn into it."""
        found = self.display.copy()
        scale, pen = max(found.size) / max(self.size), ImageDraw.Draw(found)
        width = max(2, max(found.size) // 150)
        if self.corner is not None:
            x, y = (scale * value for value in self.corner)
            pen.circle((x, y), 3 * width, fill=EDGE, outline="white", width=max(1, width // 2))
        elif box is not None:
            x0, y0, x1, y1 = (scale * value for value in box)
            if x0 <= x1 and y0 <= y1:
                pen.rectangle((x0, y0, x1, y1), outline="white", width=2 * width)
                pen.rectangle((x0, y0, x1, y1), outline=EDGE, width=width)
        return found


def read(path: Path, what: str) -> Image.Image:
    """An image's file, decoded and upright. ViewnetError, which calls it `what`, where it cannot be read."""
    with opened(path, what) as file:
        file.load()
        return ImageOps.exif_transpose(file)


def box_of(text: str) -> Box | None:
    """The box that is typed as its left, top, right and bottom edge, None without any. ViewnetError for other text."""
    if not (words := text.replace(",", " ").split()):
        return None
    try:
        x0, y0, x1, y1 = (float(word) for word in words)
    except ValueError:
        raise ViewnetError(f"box {text.strip()!r}: expected its left, top, right and bottom edge in pixels") from None
    return x0, y0, x1, y1


def box_text(box: Box | None) -> str:
    """A box as it is typed."""
    return "" if box is None else " ".join(f"{edge:.6g}" for edge in box)
