"""Images of a page that is a single file: WebP in data URIs, with captions and alternative texts."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import opened

SUFFIXES = (".png", ".gif")
MOVING: dict[str, Any] = {"quality": 70, "method": 2, "loop": 0, "save_all": True}
"""Options of animations as WebP."""
SHOWN = 0.55
"""CSS pixels per pixel of a figure: figures are saved at twice the resolution of a screen."""

CAPTIONS = {
    "figure3_azimuth": (
        "Predicted over true azimuth of test views, after alignment",
        "Scatter plots, one for each category: predicted over true azimuth of test views, 0 to 360 degrees",
    ),
    "figure3_candidates": (
        "Reconstructions by each head, by rising error; below each that error and the angle to the truth",
        "A row of small images for each category: the test view, and the reconstructions by each head",
    ),
    "alignment_calibration": (
        "Scores by the number of calibration photographs",
        "Line charts of accuracy, median error and DVA over the number of calibration photographs, for each category",
    ),
    "alignment_collapse": (
        "Effect of the linear alignment as photographs become one-sided",
        "Three line charts over the share of the commonest side: spread that is left, accuracy added, DVA added",
    ),
    "novel_views_": (
        "All around one {} at constant elevation, by each model; the appearance image stands first",
        "A grid of rendered views ({}): a row for each model, turning from left to right",
    ),
    "volumes_": (
        "Images of test objects ({}), and their volumes, all from one viewpoint",
        "Pairs of images: test images ({}), and below each its volume rendered from a common viewpoint",
    ),
    "turntable_": (
        "A test object ({}) and its volume on a turntable, starting at the predicted viewpoint",
        "An animation: left a test image ({}), right its volume, turning once",
    ),
    "reconstructions": (
        "Photographs, and their reconstructions by ViewNet with and without cycles",
        "A grid of images: photographs as the networks take them, and the reconstructions by each model",
    ),
    "failures_": (
        "The worst errors of each cause ({}): the view, and its reconstruction at the predicted viewpoint",
        "Pairs of images ({}) whose predicted viewpoint is wrong, in groups by cause",
    ),
    "training_curves": (
        "Validation accuracy, reconstruction error and losses over training",
        "Line charts over the epochs of training, a colour for each variant and a dash for each category",
    ),
    "bench": (
        "Speed and memory compared with a textbook version",
        "Bar and line charts of how many times faster, and how much smaller in memory, than a textbook version",
    ),
    "switches": (
        "Accuracy over training, with parts of the recipe switched off",
        "Line charts of validation accuracy over epochs of training, one line for each part switched off",
    ),
}
"""Start of a file's name -> caption and alternative text; {} is the rest of the name."""


@dataclass(frozen=True)
class EmbeddedImage:
    """An image to embed, `width` by `height` CSS pixels; `still` is the first frame of an animation."""

    name: str
    caption: str
    alt: str
    width: int
    height: int
    uri: str
    still: str | None
    files: Sequence[Path]  # itself and files of the same name, such as a PDF


def embedded(path: Path, widest: int, files: Sequence[Path] = ()) -> EmbeddedImage:
    """A PNG or GIF file, shrunk where it is wider than `widest`. ViewnetError naming a file that cannot be read."""
    try:
        with opened(path) as image:
            frames, duration = [], image.info.get("duration", 60)
            for number in range(getattr(image, "n_frames", 1)):
                image.seek(number)
                frames.append(_on_white(image, widest))
    except ViewnetError as error:
        raise ViewnetError(f"{path}: {error}: make it again") from None
    moving = len(frames) > 1
    caption, alt = _captions(path.stem)
    share = 1.0 if moving else SHOWN
    still = encode(frames[0], lossless=True, method=4)
    return EmbeddedImage(
        path.stem,
        caption,
        alt,
        width=round(share * frames[0].width),
        height=round(share * frames[0].height),
        uri=encode(frames[0], append_images=frames[1:], duration=duration, **MOVING) if moving else still,
        still=still if moving else None,
        files=tuple(files) or (path,),
    )


def _on_white(image: Image.Image, widest: int) -> Image.Image:
    flat, rgba = Image.new("RGB", image.size, "white"), image.convert("RGBA")
    flat.paste(rgba, mask=rgba)
    if flat.width > widest:
        flat = flat.resize((widest, max(1, round(flat.height * widest / flat.width))), Image.Resampling.LANCZOS)
    return flat


def encode(frame: Image.Image, **options: Any) -> str:
    """A data URI of an image as WebP."""
    data = io.BytesIO()
    frame.save(data, "WEBP", **options)
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode()


def _captions(stem: str) -> tuple[str, str]:
    for start, texts in CAPTIONS.items():
        if stem.startswith(start):
            rest = stem.removeprefix(start).replace("_", " ").strip()
            return texts[0].format(rest), texts[1].format(rest)
    return stem.replace("_", " "), f"The figure {stem}"
