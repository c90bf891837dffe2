"""An animation of an image's object on a turntable, once round from the viewpoint predicted for the image."""

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
STRIP = 48  # pixels: the height of the strip of text below the images
EDGE = 4
LARGEST = 1024  # pixels along a side of an image
MOST_PIXELS = 2**27  # of the images of all frames, which are in memory together
SUFFIXES = (".gif", ".mp4")


def animate(
    renderer: ObjectRenderer,
    image: np.ndarray,
    encoded: Encoded,
    pose: Tensor,
    steps: int = 48,
    hold: int = 12,
    size: int = 192,
) -> list[np.ndarray]:
    """Frames (H, W, 3) uint8: an `image` (S, S, 3) uint8 on the left, its reconstructed object turning on the right.

    The first `hold` frames stay at the predicted viewpoint; `steps` frames then go once round at its elevation. `pose`
    (3, 3) is the predicted camera frame in the network's own frame; labels and dial are in that of the predictions.
    `size` is the side of an image in pixels. ViewnetError for a side that is odd or out of range, for
    no steps, and for frames that would fill the memory.
    """
    if not 64 <= size <= LARGEST or size % 2:
        raise ViewnetError(f"turntable: size {size}: expected an even number of 64 to {LARGEST} pixels")
    most = MOST_PIXELS // size**2
    if steps < 1 or hold < 0 or steps + hold > most:
        wrong = f"steps {steps}, hold {hold}: expected 1 or more, and 0 or more"
        raise ViewnetError(f"turntable: {wrong}, together at most {most} at size {size}")
    start, elevation = geometry.azimuth_elevation(pose[:, 2])
    azimuths = start + torch.arange(steps) * (360 / steps)
    poses = geometry.look_at(geometry.view_vector(azimuths, elevation.expand(steps)))  # (steps, 3, 3)
    poses[0] = pose
    rendered = renderer.displayed(renderer.render(encoded, poses, 2 * renderer.network.config.render_size))
    left = _scaled(image, size)
    azimuth, height = (float(angle) for angle in geometry.azimuth_elevation(renderer.rotation @ pose[:, 2]))
    frames = []
    for step in [*[0] * hold, *range(steps)]:
        angle = (azimuth + 360 / steps * step) % 360
        heading = "predicted viewpoint" if step == 0 else "turned"
        text = f"{heading}\nazimuth {round(angle) % 360}°, elevation {height:.0f}°"
        frames.append(_composed(left, _scaled(rendered[step], size), text, angle, azimuth, step == 0))
    return frames


def check(path: Path) -> None:
    """Raise ViewnetError for a suffix that `save` does not write."""
    if path.suffix not in SUFFIXES:
        raise ViewnetError(f"{path}: unknown kind of animation: name it {' or '.join(SUFFIXES)}")


def save(frames: Sequence[np.ndarray], path: Path, rate: int = 16) -> Path:
    """Write frames (H, W, 3) uint8, `rate` a second, as .gif or .mp4. ViewnetError for another suffix and no frames."""
    if not len(frames):
        raise ViewnetError(f"{path}: no frames to write")
    check(path)
    if path.suffix == ".gif":
        first, *others = [Image.fromarray(frame) for frame in frames]
        with replacing(path) as temporary:
            first.save(temporary, save_all=True, append_images=others, duration=round(1000 / rate), loop=0)
        return path
    import av  # loads the libraries of ffmpeg

    with replacing(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        stream: Any = container.add_stream(codec, rate=rate)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


def _scaled(image: np.ndarray, size: int) -> Image.Image:
    return Image.fromarray(image).resize((size, size), Image.Resampling.BICUBIC)


def _composed(
    image: Image.Image, rendered: Image.Image, text: str, angle: float, predicted: float, marked: bool
) -> np.ndarray:
    size = image.width
    frame = Image.new("RGB", (2 * size + 3 * EDGE + EDGE % 2, size + 2 * EDGE + STRIP), "white")
    frame.paste(image, (EDGE, EDGE))
    frame.paste(rendered, (size + 2 * EDGE, EDGE))
    pen = ImageDraw.Draw(frame)
    if marked:
        pen.rectangle((size + EDGE, 0, 2 * size + 3 * EDGE - 1, size + 2 * EDGE - 1), outline=MARK, width=EDGE)
    top, font = size + 2 * EDGE, ImageFont.load_default(13)
    pen.multiline_text((EDGE + 2, top + 6), text, fill=MARK if marked else INK, font=font, spacing=3)
    # The camera's circle from above, with the predicted camera and the present one.
    x, y, radius = 2 * size - STRIP // 2, top + STRIP // 2, STRIP // 2 - 7
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), outline=INK)
    for azimuth, colour, dot in ((predicted, MARK, 5), (angle, INK, 3)):
        a = np.radians(azimuth)
        # Azimuth 0, the front, is down and 90, the left side, to the right: counter-clockwise seen from above.
        px, py = x + radius * np.sin(a), y + radius * np.cos(a)
        pen.line((x, y, px, py), fill=colour)
        pen.ellipse((px - dot, py - dot, px + dot, py + dot), fill=colour)
    return np.asarray(frame)
