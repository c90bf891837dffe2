"""An image's object on a turntable, from the viewpoint that was predicted for the image all the way round to it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.model.reconstruction import Encoded
from viewnet.model.rendering import ObjectRenderer
from viewnet.runtime.files import replacing

MARK = (213, 94, 0)  # of the predicted viewpoint
INK = (40, 40, 40)
STRIP = 48  # pixels: the height of the line below the images
EDGE = 4
SUFFIXES = (".gif", ".mp4")


def revolve(
    painter: ObjectRenderer,
    image: np.ndarray,
    encoded: Encoded,
    answer: Tensor,
    told: np.ndarray,
    steps: int = 48,
    hold: int = 12,
    size: int = 192,
) -> list[np.ndarray]:
    """Frames (H, W, 3) uint8: a `image` (S, S, 3) uint8 on the left, the one object `encoded` turning on the right.

    The first `hold` frames stand at the predicted viewpoint, framed and named: the camera frame `answer` (3, 3) in the
    network's own frame, and the view vector `told` (3,) that is said of it. Then `steps` frames go once round at its
    elevation. The dial is seen from above, the object's front pointing down to the reader; azimuths are those of
    `told`. `size` is the side of an image in pixels. ViewnetError unless it is an even number of 64 or more, and for
    no steps.
    """
    if size < 64 or size % 2:
        raise ViewnetError(f"turntable: size {size}: expected an even number of 64 or more pixels")
    if steps < 1 or hold < 0:
        raise ViewnetError(f"turntable: steps {steps}, hold {hold}: expected 1 or more, and 0 or more")
    start, elevation = geometry.azimuth_elevation(answer[:, 2])
    turned = start + torch.arange(steps) * (360 / steps)
    frames = geometry.look_at(geometry.view_vector(turned, elevation.expand(steps)))
    frames[0] = answer
    drawn = painter.displayed(painter.render(encoded, frames, 2 * painter.network.config.render_size))
    left = _scaled(image, size)
    azimuth, height = (float(a) for a in geometry.azimuth_elevation(torch.from_numpy(np.array(told))))
    found = []
    for number in [*[0] * hold, *range(steps)]:
        angle = (azimuth + 360 / steps * number) % 360
        named = "predicted viewpoint" if number == 0 else "turned"
        text = f"{named}\nazimuth {round(angle) % 360}°, elevation {height:.0f}°"
        found.append(_composed(left, _scaled(drawn[number], size), text, angle, azimuth, number == 0))
    return found


def check(path: Path) -> None:
    """ViewnetError for a file's name that `save` does not write."""
    if path.suffix not in SUFFIXES:
        raise ViewnetError(f"{path}: unknown kind of animation: name it {' or '.join(SUFFIXES)}")


def save(frames: Sequence[np.ndarray], path: Path, rate: int = 16) -> Path:
    """Frames (H, W, 3) uint8, `rate` a second, as an animated .gif, or as .mp4 where PyAV is installed; returns `path`.

    ViewnetError for another suffix, no frames, and .mp4 without PyAV.
    """
    if not len(frames):
        raise ViewnetError(f"{path}: no frames to write")
    check(path)
    if path.suffix == ".gif":
        images = [Image.fromarray(frame) for frame in frames]
        with replacing(path) as temporary:
            duration = round(1000 / rate)
            images[0].save(temporary, save_all=True, append_images=images[1:], duration=duration, loop=0)
    else:
        _save_mp4(frames, path, rate)
    return path


def _save_mp4(frames: Sequence[np.ndarray], path: Path, rate: int) -> None:
    try:
        import av
    except ImportError:
        raise ViewnetError(f"{path}: PyAV is not installed: pip install av, or write a .gif") from None
    with replacing(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        stream: Any = container.add_stream(codec, rate=rate)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def _scaled(image: np.ndarray, size: int) -> Image.Image:
    return Image.fromarray(image).resize((size, size), Image.Resampling.BICUBIC)


def _composed(
    image: Image.Image, drawing: Image.Image, text: str, angle: float, predicted: float, marked: bool
) -> np.ndarray:
    size = image.width
    frame = Image.new("RGB", (2 * size + 3 * EDGE + EDGE % 2, size + 2 * EDGE + STRIP), "white")
    frame.paste(image, (EDGE, EDGE))
    frame.paste(drawing, (size + 2 * EDGE, EDGE))
    pen = ImageDraw.Draw(frame)
    if marked:
        pen.rectangle((size + EDGE, 0, 2 * size + 3 * EDGE - 1, size + 2 * EDGE - 1), outline=MARK, width=EDGE)
    top, font = size + 2 * EDGE, ImageFont.load_default(13)
    pen.multiline_text((EDGE + 2, top + 6), text, fill=MARK if marked else INK, font=font, spacing=3)
    _dial(pen, (2 * size - STRIP // 2, top + STRIP // 2), STRIP // 2 - 7, angle, predicted)
    return np.asarray(frame)


def _dial(pen: ImageDraw.ImageDraw, centre: tuple[int, int], radius: int, angle: float, predicted: float) -> None:
    """The circle the camera goes round on, from above: where it was predicted, and where it is."""
    x, y = centre
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), outline=INK)
    for azimuth, colour, dot in ((predicted, MARK, 5), (angle, INK, 3)):
        a = np.radians(azimuth)
        # Azimuth 0, the front, is down; counter-clockwise as seen from above, so 90 (the left side) is to the right.
        px, py = x + radius * np.sin(a), y + radius * np.cos(a)
        pen.line((x, y, px, py), fill=colour)
        pen.ellipse((px - dot, py - dot, px + dot, py + dot), fill=colour)
