"""Images for a page that is one file: as WebP in data URIs, with a caption and what those are told who do not see."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import opened

SUFFIXES = (".png", ".gif")
MOVING_QUALITY = 70
SHOWN = 0.55
"""CSS pixels for a pixel of a figure: figures are saved with twice as many as a page in print needs."""

ABOUT: tuple[tuple[str, str, str], ...] = (
    (
        "figure3_azimuth",
        "Predicted over true azimuth of test views, after alignment",
        "Scatter plots, one for each category: the predicted azimuth of test views over the true one, 0 to 360 degrees",
    ),
    (
        "figure3_candidates",
        "What each head draws, by rising reconstruction error; below each that error and the angle to the truth",
        "A row of small images for each category: the test view, and the drawings of the heads",
    ),
    (
        "alignment_calibration",
        "Scores by the number of calibration photographs",
        "Line charts of accuracy, median error and DVA over the number of calibration photographs, for each category",
    ),
    (
        "alignment_collapse",
        "What the linear alignment does the more one-sided photographs are",
        "Three line charts over the share of the commonest side: spread that is left, accuracy added, DVA added",
    ),
    (
        "novel_views_",
        "All around one {} at constant elevation, by each model; the image that its appearance is from stands first",
        "A grid of drawings of one {}: a row for each model, turning from left to right",
    ),
    (
        "volumes_",
        "Images of test objects ({}), and the volumes made of them, all from one viewpoint",
        "Pairs of images: a {} as it was seen, and below it the volume drawn from a common viewpoint",
    ),
    (
        "turntable_",
        "A test object ({}) and its volume on a turntable, from the predicted viewpoint on",
        "An animation: left an image of a {}, right its volume, turning once",
    ),
    (
        "reconstructions",
        "Photographs, and what ViewNet with and without cycles makes of them",
        "A grid of images: photographs as the networks see them, and the reconstructions of each model",
    ),
    (
        "failures_",
        "The worst errors of each cause ({}): the view, and what is drawn at the predicted viewpoint",
        "Pairs of images of a {} whose viewpoint is wrong, in groups by cause",
    ),
    (
        "training_curves",
        "Validation accuracy, reconstruction error and losses over training",
        "Line charts over the steps of training, a colour for each variant and a dash for each category",
    ),
    (
        "bench",
        "Speed and memory beside a textbook version",
        "Bar and line charts of how many times faster, and how much smaller in memory, than a textbook version",
    ),
    (
        "switches",
        "Accuracy over training time, with parts of the recipe switched off",
        "Line charts of validation accuracy over seconds of training, one line for each part switched off",
    ),
)
"""What a file's name begins with, its caption, and its text for those who do not see it; {} is the rest of the name."""


@dataclass(frozen=True)
class EmbeddedImage:
    """An image to embed, shown `width` by `height` CSS pixels large; `still` is the first frame of one that moves."""

    name: str
    caption: str
    alt: str
    width: int
    height: int
    uri: str
    still: str | None
    files: Sequence[Path]  # itself and what has the same name, such as a PDF


def embedded(path: Path, widest: int, files: Sequence[Path] = ()) -> EmbeddedImage:
    """A PNG or GIF file, shrunk where it is wider than `widest`. ViewnetError naming what cannot be read."""
    try:
        with opened(path) as image:
            frames, wait = [], image.info.get("duration", 60)
            for number in range(getattr(image, "n_frames", 1)):
                image.seek(number)
                frames.append(_shown(image, widest))
    except ViewnetError as error:
        raise ViewnetError(f"{path}: {error}: make it again") from None
    moving = len(frames) > 1
    caption, alt = _about(path.stem)
    share = 1.0 if moving else SHOWN
    return EmbeddedImage(
        path.stem,
        caption,
        alt,
        width=round(share * frames[0].width),
        height=round(share * frames[0].height),
        uri=_moving(frames, wait) if moving else _uri(frames[0]),
        still=_uri(frames[0]) if moving else None,
        files=tuple(files) or (path,),
    )


def _shown(image: Image.Image, widest: int) -> Image.Image:
    """Over white, as on paper."""
    flat = Image.new("RGB", image.size, "white")
    drawn = image.convert("RGBA")
    flat.paste(drawn, mask=drawn)
    if flat.width > widest:
        flat = flat.resize((widest, max(1, round(flat.height * widest / flat.width))), Image.Resampling.LANCZOS)
    return flat


def _uri(frame: Image.Image) -> str:
    data = io.BytesIO()
    frame.save(data, "WEBP", lossless=True, method=4)
    return _encoded(data)


def _moving(frames: Sequence[Image.Image], wait: int) -> str:
    data = io.BytesIO()
    frames[0].save(
        data, "WEBP", save_all=True, append_images=frames[1:], duration=wait, loop=0, quality=MOVING_QUALITY, method=2
    )
    return _encoded(data)


def _encoded(data: io.BytesIO) -> str:
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode()


def _about(stem: str) -> tuple[str, str]:
    for begins, caption, alt in ABOUT:
        if stem.startswith(begins):
            rest = stem.removeprefix(begins).replace("_", " ").strip()
            return caption.format(rest), alt.format(rest)
    return stem.replace("_", " "), f"The figure {stem}"
