"""Clips, videos of one object each, and their frames: of a video file, or a folder of images in the order of time."""

import functools
import math
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, get_args

import av
import numpy as np
from av.stream import Disposition
from PIL import Image, ImageOps

from viewnet.config import known
from viewnet.data.crop import Box
from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import MOST_PIXELS, SUFFIXES, read
from viewnet.runtime.splits import seeded_generator

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".wmv", ".3gp")
"""How names of video files end."""
CONTAINERS = (
    "mov", "mp4", "m4a", "3gp", "3g2", "mj2", "matroska", "webm", "avi", "mpeg", "mpegts", "mpegvideo", "asf",
)  # fmt: skip
"""What a video file may hold, in FFmpeg's names. Some of FFmpeg's other formats are lists that open further files."""

Pick = Literal["random", "evenly"]
Still = tuple[int, str, Image.Image | ViewnetError]
"""A frame's number from 0, its name without a suffix, and its image or why there is none."""


@dataclass(frozen=True)
class Frame:
    """One image of a clip. What is not annotated is NaN or None."""

    number: int  # from 0, in the order of time
    azimuth: float = math.nan  # degrees in [0, 360), as in viewnet.geometry
    elevation: float = math.nan  # degrees
    box: Box | None = None  # pixels from the image's left upper corner: x0, y0, x1, y1


@dataclass(frozen=True)
class Clip:
    """A video of one object."""

    id: str
    category: str
    split: str  # train, val or test
    source: Path  # a video file, or a folder of images whose names sort in the order of time
    frames: tuple[Frame, ...]  # those that may be used; an empty tuple stands for all, without annotations
    # A folder of PNG masks named like the images (or %06d.png by frame number), or a video of them, frame by frame.
    masks: Path | None = None


def is_video(path: Path) -> bool:
    """Whether a file's name is that of a video."""
    return path.suffix.lower() in VIDEOS and not path.name.startswith(".") and path.is_file()


def is_image(path: Path) -> bool:
    """Whether a file's name is that of an image."""
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file()


def natural(name: str) -> list[tuple[int, str]]:
    """A sort key by which runs of digits compare as numbers: batch-2 comes before batch-10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def images_in(folder: Path) -> list[Path]:
    """The image files of a folder, sorted by name (see `natural`)."""
    return sorted(filter(is_image, folder.iterdir()), key=lambda path: (natural(path.name), path.name))


def masks_in(folder: Path, clip: str) -> Path | None:
    """The masks of a clip in a folder of masks: a folder or a video with the clip's name, or None.

    Raises ViewnetError where there are several.
    """
    place = folder / clip
    found = [path for suffix in VIDEOS if (path := place.with_name(place.name + suffix)).is_file()]
    found += [place] if place.is_dir() else []
    if len(found) > 1:
        raise ViewnetError(f"masks are there twice ({', '.join(path.name for path in found)})")
    return found[0] if found else None


def frame_count(source: Path) -> int:
    """The images of a folder, or frames that a video decodes to. ViewnetError for unreadable videos, and for none."""
    if source.is_dir():
        total = len(images_in(source))
    else:
        status = source.stat() if source.is_file() else None
        total = _decoded_frames(source, status and (status.st_size, status.st_mtime_ns, status.st_ino))
    if not total:
        raise ViewnetError("no frames in it")
    return total


@functools.lru_cache(None)
def _decoded_frames(file: Path, state: tuple[int, ...] | None) -> int:
    """The frames of a video, which takes as long as decoding it, by the `state` of its file."""
    with _open_video(file) as container:
        return sum(1 for _ in _decode(container))  # packets may hold several frames, or one that is not shown


def is_lossy(file: Path) -> bool:
    """Whether a video's compression can change pixels. ViewnetError for unreadable videos."""
    with _open_video(file) as container:
        return _shown(container).codec_context.codec.lossy


def pick_frames(total: int, count: int | None, how: Pick, name: str, seed: int = 0) -> list[int]:
    """Ascending numbers of `count` of `total` frames, all for None or too few. ViewnetError for counts below 1.

    "evenly": the middles of equal stretches of time; "random": by seed and the clip's name.
    """
    if count is not None and count < 1:
        raise ViewnetError(f"frames {count}: expected 1 or more a clip, or none for all")
    known(how, get_args(Pick), "pick")
    if count is None or count >= total:
        return list(range(total))
    if how == "evenly":
        return [int(i) for i in (np.arange(count) + 0.5) * total / count]
    return sorted(seeded_generator(seed, "frames", name).choice(total, count, replace=False).tolist())


def read_frames(source: Path, numbers: Collection[int]) -> Iterator[Still]:
    """The frames with these numbers, ascending, as players show them; a video is decoded up to the last.

    A frame that does not decode or does not exist comes as a ViewnetError; a video that cannot be opened raises one.
    """
    ascending = sorted(set(numbers))
    return _from_folder(source, ascending) if source.is_dir() else _from_video(source, ascending)


def _from_folder(folder: Path, numbers: list[int]) -> Iterator[Still]:
    files = images_in(folder)
    for number in numbers:
        if number >= len(files):
            yield number, f"{number:06d}", ViewnetError("no such frame")
            continue
        try:
            image: Image.Image | ViewnetError = read(files[number], "frame")
        except ViewnetError as error:
            image = error
        yield number, files[number].stem, image


def _from_video(file: Path, numbers: list[int]) -> Iterator[Still]:
    left = set(numbers)
    with _open_video(file) as container:
        aspect = _shown(container).sample_aspect_ratio
        for number, frame in enumerate(_decode(container)):
            if number in left:
                left.remove(number)
                yield number, f"{number:06d}", _to_image(frame, aspect)
            if not left:
                return
    for number in sorted(left):
        yield number, f"{number:06d}", ViewnetError("frame does not decode")


def _open_video(file: Path) -> av.container.InputContainer:
    try:
        container = av.open(str(file), options={"format_whitelist": ",".join(CONTAINERS), "protocol_whitelist": "file"})
    except (av.FFmpegError, OSError, ValueError) as error:
        raise ViewnetError(f"video cannot be read ({type(error).__name__})") from None
    if not any(stream.codec_context for stream in container.streams.video):
        container.close()
        raise ViewnetError("video cannot be read (no images in it that can be decoded)")
    return container


def _shown(container: av.container.InputContainer) -> av.VideoStream:
    """The images that players show: no cover, the default ones before others, the largest, the first."""

    def rank(stream: av.VideoStream) -> tuple[bool, bool, int]:
        role = stream.disposition
        is_cover, is_default = role & Disposition.attached_pic, role & Disposition.default
        return not is_cover, bool(is_default), stream.width * stream.height

    return max((stream for stream in container.streams.video if stream.codec_context), key=rank)


def _decode(container: av.container.InputContainer) -> Iterator[av.VideoFrame]:
    """All frames that can be decoded: a damaged packet costs the frames that depend on it, not the rest."""
    stream = _shown(container)
    # Unaligned, as an image is else cut at its left by whole blocks only.
    stream.codec_context.options = {"max_pixels": str(MOST_PIXELS), "flags": "+unaligned"}
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


def _to_image(frame: av.VideoFrame, aspect: Fraction | None) -> Image.Image | ViewnetError:
    try:
        matrix: Any = frame.side_data.get("DISPLAYMATRIX")
        image = square(frame.to_image(), aspect or Fraction(1))
        return image if matrix is None else upright(image, np.frombuffer(bytes(matrix), np.int32))
    except (av.FFmpegError, ValueError, MemoryError) as error:  # of a form or size that cannot be converted
        return ViewnetError(f"frame does not decode ({type(error).__name__})")


def square(image: Image.Image, aspect: Fraction) -> Image.Image:
    """A frame whose pixels are `aspect` times as wide as high with square ones: the side that is too short is enlarged.

    Raises ValueError where that is too large.
    """
    size = round(image.width * max(float(aspect), 1)), round(image.height / min(float(aspect), 1))
    if size[0] * size[1] > MOST_PIXELS:
        raise ValueError
    return image if size == image.size else image.resize(size, Image.Resampling.BICUBIC)


def upright(image: Image.Image, matrix: np.ndarray) -> Image.Image:
    """A frame as players show it: turned by quarters and mirrored by its video's display matrix, (9,) as FFmpeg's.

    A point goes to x' = a x + c y and y' = b x + d y; the matrix is a, b, 0, c, d and what does not matter here.
    """
    a, b, _, c, d = (int(value) for value in matrix[:5])
    if abs(b) + abs(c) > abs(a) + abs(d):
        image, a, d = image.transpose(Image.Transpose.TRANSPOSE), c, b
    image = ImageOps.mirror(image) if a < 0 else image
    return ImageOps.flip(image) if d < 0 else image
