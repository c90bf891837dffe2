"""Images of a page that is a single file: WebP in data URIs, with captions and alternative texts."""

import base64
import io
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image, ImageSequence

from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import opened

SUFFIXES = (".png", ".gif")  # figures and animations; a PDF is linked beside its PNG
MOVING: dict[str, Any] = {"quality": 70, "method": 2, "loop": 0, "save_all": True}  # options of animations as WebP
WIDEST = 1700  # pixels across a figure
SHOWN = 0.55  # CSS pixels per pixel of a figure: figures are saved at twice the resolution of a screen
TEMPLATES = Path(__file__).parent / "templates"
CAPTIONS = tomllib.loads((TEMPLATES / "captions.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class EmbeddedImage:
    """An image to embed, `width` by `height` CSS pixels; `still` is the first frame of an animation."""

    caption: str
    alt: str
    width: int
    height: int
    uri: str
    still: str | None
    files: Sequence[Path]  # itself and files of the same name, such as a PDF


def embedded(path: Path, files: Sequence[Path]) -> EmbeddedImage:
    """A PNG or GIF file, shrunk where it is wider than WIDEST. ViewnetError naming a file that cannot be read."""
    try:
        with opened(path) as image:
            duration = image.info.get("duration", 60)  # milliseconds
            frames = [_on_white(frame) for frame in ImageSequence.Iterator(image)]
    except ViewnetError as error:
        raise ViewnetError(f"{path}: {error}: make it again") from None
    uri, still = encode(frames[0], lossless=True, method=4), None  # lines and letters stay sharp
    if moving := len(frames) > 1:
        uri, still = encode(frames[0], append_images=frames[1:], duration=duration, **MOVING), uri
    width, height = (round((1 if moving else SHOWN) * side) for side in frames[0].size)
    return EmbeddedImage(*captions(path.stem), width, height, uri, still, files)


def _on_white(image: Image.Image) -> Image.Image:
    flat, rgba = Image.new("RGB", image.size, "white"), image.convert("RGBA")  # figures are drawn for white paper
    flat.paste(rgba, mask=rgba)
    if flat.width > WIDEST:
        flat = flat.resize((WIDEST, round(flat.height * WIDEST / flat.width)), Image.Resampling.LANCZOS)
    return flat


def encode(frame: Image.Image, **options: Any) -> str:
    """A data URI of an image as WebP."""
    data = io.BytesIO()
    frame.save(data, "WEBP", **options)
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode()


def captions(stem: str) -> tuple[str, str]:
    """Caption and alternative text."""
    for start, texts in CAPTIONS.items():
        if stem.startswith(start):
            rest = stem.removeprefix(start).replace("_", " ").strip()
            return texts["caption"].format(rest), texts["alt"].format(rest)
    return stem.replace("_", " "), f"The figure {stem}"  # better than none, for screen readers
