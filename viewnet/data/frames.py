"""The images of a clip: a video file's frames or a folder's images, in the order of time."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Literal

import av
import numpy as np
from PIL import Image, ImageOps

from viewnet.data.backgrounds import SUFFIXES
from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import MOST_PIXELS, opened

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".wmv", ".3gp")
"""How names of video files end."""
CONTAINERS = (
    "mov", "mp4", "m4a", "3gp", "3g2", "mj2", "matroska", "webm", "avi", "mpeg", "mpegts", "mpegvideo", "asf",
)  # fmt: skip
"""What a video file may hold, in FFmpeg's names; among its others are lists that have it open further files."""
PICKS = ("random", "evenly")

Pick = Literal["random", "evenly"]
Still = tuple[int, str, Image.Image | ViewnetError]
"""Number from 0, name without a suffix, and the image or why there is none."""


def is_video(path: Path) -> bool:
    """Whether a file's name is that of a video."""
    return path.suffix.lower() in VIDEOS and not path.name.startswith(".") and path.is_file()


def images(folder: Path) -> list[Path]:
    """The images that lie in a folder, by name; numbers within names count as numbers: 2.png comes before 10.png."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith(".") and p.is_file()]
    return sorted(found, key=lambda path: (natural(path.name), path.name))


def count(source: Path) -> int:
    """How many frames a source has: the images of a folder, or the packets of a video, which are not decoded.

    Raises ViewnetError for a video that cannot be read, and a source without frames.
    """
    if source.is_dir():
        total = len(images(source))
    else:
        with _opened(source) as container:
            try:
                total = sum(packet.size > 0 for packet in container.demux(container.streams.video[0]))
            except (av.FFmpegError, OSError) as error:
                raise ViewnetError(f"video cannot be read ({type(error).__name__})") from None
    if not total:
        raise ViewnetError("no frames in it")
    return total


def pick(total: int, wanted: int | None, how: Pick, name: str, seed: int = 0) -> list[int]:
    """Ascending numbers of `wanted` of `total` frames, all of them for None or where there are no more.

    "evenly": the middles of as many equal stretches of time; "random": drawn by seed and the clip's name. Raises
    ViewnetError for no frames, and another way of picking.
    """
    if wanted is not None and wanted < 1:
        raise ViewnetError(f"frames {wanted}: expected 1 or more a clip, or none for all")
    if how not in PICKS:
        raise ViewnetError(f"unknown pick {how!r}: choose one of {', '.join(PICKS)}")
    if wanted is None or wanted >= total:
        return list(range(total))
    if how == "evenly":
        return [int(i) for i in (np.arange(wanted) + 0.5) * total / wanted]
    digest = hashlib.sha256(f"{seed} frames {name}".encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:8], "little"))
    return sorted(int(i) for i in rng.choice(total, wanted, replace=False))


def stills(source: Path, numbers: Collection[int]) -> Iterator[Still]:
    """The frames with these numbers, ascending, upright as their camera says; a video is decoded up to the last one.

    An image that does not decode, or a frame that a video turns out not to have, comes as a ViewnetError. Raises
    ViewnetError for a video that cannot be opened.
    """
    wanted = sorted(set(numbers))
    return _of_folder(source, wanted) if source.is_dir() else _of_video(source, wanted)


def _of_folder(folder: Path, wanted: list[int]) -> Iterator[Still]:
    files = images(folder)
    for number in wanted:
        if number >= len(files):
            yield number, f"{number:06d}", ViewnetError("no such frame")
            continue
        try:
            with opened(files[number]) as still:
                still.load()
                image: Image.Image | ViewnetError = ImageOps.exif_transpose(still)
        except ViewnetError as error:
            image = error
        yield number, files[number].stem, image


def _of_video(file: Path, wanted: list[int]) -> Iterator[Still]:
    left = set(wanted)
    with _opened(file) as container:
        for number, frame in enumerate(_decoded(container)):
            if number in left:
                left.remove(number)
                yield number, f"{number:06d}", _image(frame)
            if not left:
                return
    for number in sorted(left):
        yield number, f"{number:06d}", ViewnetError("frame does not decode")


def _image(frame: av.VideoFrame) -> Image.Image | ViewnetError:
    try:
        return upright(frame.to_image(), frame.rotation)
    except (av.FFmpegError, ValueError, MemoryError) as error:  # of a form or size that cannot be converted
        return ViewnetError(f"frame does not decode ({type(error).__name__})")


def _decoded(container: av.container.InputContainer) -> Iterator[av.VideoFrame]:
    """All frames that can be decoded: a damaged packet costs what depends on it, not the rest."""
    stream = container.streams.video[0]
    stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except (StopIteration, av.FFmpegError):  # the end, or where the file is cut off
            return
        try:
            yield from packet.decode()
        except av.FFmpegError:
            continue


def upright(image: Image.Image, rotation: float) -> Image.Image:
    """A frame turned as a video's display matrix says: `rotation` degrees counter-clockwise, by quarter turns."""
    turns = {
        90: Image.Transpose.ROTATE_90,
        180: Image.Transpose.ROTATE_180,
        270: Image.Transpose.ROTATE_270,
    }
    quarter = round(rotation / 90) * 90 % 360
    return image.transpose(turns[quarter]) if quarter else image


def _opened(file: Path) -> av.container.InputContainer:
    try:
        container = av.open(str(file), options={"format_whitelist": ",".join(CONTAINERS), "protocol_whitelist": "file"})
    except (av.FFmpegError, OSError, ValueError) as error:
        raise ViewnetError(f"video cannot be read ({type(error).__name__})") from None
    if not container.streams.video:
        container.close()
        raise ViewnetError("video cannot be read (no images in it)")
    return container


def natural(name: str) -> list[tuple[int, str]]:
    """A key by which runs of digits compare as numbers: batch-2 comes before batch-10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name)]
