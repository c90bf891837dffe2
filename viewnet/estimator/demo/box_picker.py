"""A visitor's image, and the box that is marked in it by two clicks or typed."""

from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image, ImageDraw

from viewnet.data.crop import Box
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files

SHOWN = 1024
"""Pixels along the longer side of an image as it is shown. Browsers then only scale it down: gradio reports clicks
wrongly on images that are scaled up."""
EDGE = (213, 94, 0)


@dataclass(frozen=True, eq=False)
class BoxPicker:
    """An upright image that a visitor sent, and the box that was begun in it."""

    path: Path
    name: str  # the file's name on the visitor's machine
    size: tuple[int, int]  # width and height in pixels
    display: Image.Image  # the image as it is shown, on white: SHOWN pixels along its longer side
    corner: tuple[float, float] | None = None  # the first corner of a box, in the image's pixels, once it is begun

    @classmethod
    def of(cls, path: Path, name: str) -> "BoxPicker":
        """Read a file. ViewnetError, which calls it `name`, if it is not an image that can be read."""
        image = image_files.read(path, f"image {name}")
        scale = SHOWN / max(image.size)
        display = image.resize([max(1, round(scale * side)) for side in image.size], Image.Resampling.BICUBIC)
        if display.mode == "RGBA":
            display = Image.alpha_composite(Image.new("RGBA", display.size, "white"), display)
        return cls(path, name, image.size, display.convert("RGB"))

    def image(self) -> Image.Image:
        """The image in full resolution. ViewnetError if the file is gone."""
        return image_files.read(self.path, f"image {self.name}")

    def click(self, x: float, y: float) -> "tuple[BoxPicker, Box | None]":
        """The state after a click at a point of `shown`, and the box if the click completes one."""
        scale = max(self.size) / max(self.display.size)
        point = round(x * scale, 1), round(y * scale, 1)
        if self.corner is None:
            return replace(self, corner=point), None
        (x0, x1), (y0, y1) = (sorted(pair) for pair in zip(self.corner, point, strict=True))
        return self.clear(), (x0, y0, x1, y1)

    def clear(self) -> "BoxPicker":
        """The same image with no box begun."""
        return replace(self, corner=None)

    def shown(self, box: Box | None = None) -> Image.Image:
        """`display` with the box, or the corner that begins one, drawn into it."""
        image = self.display.copy()
        scale, pen = max(image.size) / max(self.size), ImageDraw.Draw(image)
        width = max(2, max(image.size) // 150)
        if self.corner is not None:
            x, y = (scale * value for value in self.corner)
            pen.circle((x, y), 3 * width, fill=EDGE, outline="white", width=max(1, width // 2))
        elif box is not None:
            x0, y0, x1, y1 = (scale * value for value in box)
            if x0 <= x1 and y0 <= y1:
                pen.rectangle((x0, y0, x1, y1), outline="white", width=2 * width)
                pen.rectangle((x0, y0, x1, y1), outline=EDGE, width=width)
        return image


def parse_box(text: str) -> Box | None:
    """A box typed as its left, top, right and bottom edge; None for no text. ViewnetError for other text."""
    if not (words := text.replace(",", " ").split()):
        return None
    try:
        x0, y0, x1, y1 = (float(word) for word in words)
    except ValueError:
        raise ViewnetError(f"box {text.strip()!r}: expected its left, top, right and bottom edge in pixels") from None
    return x0, y0, x1, y1


def format_box(box: Box | None) -> str:
    """The text of a box, for `parse_box`."""
    return "" if box is None else " ".join(f"{edge:.6g}" for edge in box)
