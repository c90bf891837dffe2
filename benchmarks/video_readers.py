"""Videos as the package sees them, and as FFmpeg shows them: are the frames the same?

    python benchmarks/video_readers.py --ffmpeg FFMPEG [--keep FOLDER] [-o paper_tables/trust/videos.csv]

Writes 40 videos in different ways (containers, codecs, formats of pixels, turned and mirrored, cut by edit lists, at
varying rates, with pixels that are not square, with further streams) and reads each with viewnet.data.clips and with
FFMPEG, a program of another version than the library that the package uses: that of imageio-ffmpeg, for example, in an
environment of its own. FFMPEG turns frames as players do; pixels that are not square are made so by its scale filter,
as it leaves that to players. Frames are the same where there are as many, of one size, whose pixels differ by 3 levels
of 255 on average at most. Writes a row a video; the exit status is 1 where one differs.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd

from viewnet import paths
from viewnet.data.clips import frame_count, read_frames
from viewnet.errors import ViewnetError
from viewnet.runtime.files import replacing

Further = Callable[[Any], Callable[[], None]]
FRAMES = 8
ATTACHED = int(av.stream.Disposition.attached_pic)
LEVELS = 3.0  # of 255, the mean difference from which on frames are not the same
SQUARE = "scale=w='round(iw*max(sar,1))':h='round(ih*max(1/sar,1))':flags=bicubic,setsar=1"
"""FFmpeg's filter for square pixels: the side that is too short is enlarged."""


def picture(number: int, size: tuple[int, int]) -> np.ndarray:
    """Frame `number` (H, W, 3): a slope of grey, lighter each time, a red corner at the upper left, a green bar."""
    width, height = size
    image = np.repeat(
        np.linspace(40 + 8 * number % 96, 130 + 8 * number % 96, height).astype(np.uint8)[:, None, None], width, axis=1
    ).repeat(3, axis=2)
    image[: height // 3, : width // 3] = 230, 20, 20
    image[height // 2 :, width // 3 : width // 2] = 20, 200, 60
    return image


def write(
    file: Path,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    size: tuple[int, int] = (96, 64),
    count: int = FRAMES,
    start: int = 0,
    times: Sequence[int] | None = None,
    bframes: int = 0,
    aspect: Fraction | None = None,
    matrix: tuple[int, int, int, int] | None = None,
    options: Mapping[str, str] | None = None,
    full: bool = False,
    bt709: bool = False,
    first: Further | None = None,
    last: Further | None = None,
) -> None:
    """A video of 20 frames a second.

    start          frames whose times are below 0, which an edit list leaves out
    times          of the frames, in twentieths of a second
    matrix         a, b, c, d of the display matrix
    full, bt709    numbers of all 256 levels, and of the colours of high definition, where they are given as such
    first, last    what adds another stream before or after the video's, and returns what writes it
    """
    options_of_file = {"avoid_negative_ts": "disabled"} if start else {}
    with av.open(str(file), "w", options=options_of_file) as container:
        others = [first(container)] if first else []
        stream: Any = container.add_stream(codec, rate=20, options=dict(options or {}))
        stream.width, stream.height, stream.pix_fmt = *size, pixels
        context = stream.codec_context
        context.time_base, context.gop_size = Fraction(1, 20), 12
        context.max_b_frames = bframes
        if aspect:
            context.sample_aspect_ratio = aspect
        if matrix:
            a, b, c, d = (value * 65536 for value in matrix)
            stream.set_display_matrix([a, b, 0, c, d, 0, 0, 0, 2**30])
        if full:
            context.color_range = 2
        if bt709:
            context.colorspace = context.color_primaries = context.color_trc = 1
        others += [last(container)] if last else []
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(picture(number, size), format="rgb24")
            frame = frame.reformat(
                format=pixels, dst_colorspace=1 if bt709 else None, dst_color_range=2 if full else None
            )
            frame.pts, frame.time_base = times[number] if times else number - start, Fraction(1, 20)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
        for finish in others:
            finish()


def further(size: tuple[int, int] = (32, 32), role: int = 0, codec: str = "mjpeg", count: int = 1) -> Further:
    """Another stream of pictures, plain blue, with a `role` (a value of av.stream.Disposition)."""

    def add(container: Any) -> Callable[[], None]:
        stream = container.add_stream(codec, rate=20)
        stream.width, stream.height = size
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.disposition = role

        def finish() -> None:
            blue = np.zeros((size[1], size[0], 3), np.uint8) + np.array([0, 0, 255], np.uint8)
            for number in range(count):
                frame = av.VideoFrame.from_ndarray(blue, format="rgb24")
                frame.pts, frame.time_base = number, Fraction(1, 20)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())

        return finish

    return add


def sound(container: Any) -> Callable[[], None]:
    """Silence."""
    stream = container.add_stream("aac", rate=8000)

    def finish() -> None:
        for number in range(4):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
            frame.sample_rate, frame.pts, frame.time_base = 8000, 1024 * number, Fraction(1, 8000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())

    return finish


VARYING = (0, 1, 4, 5, 11, 12, 13, 30)
TURNED = (0, 1, -1, 0)
VIDEOS: dict[str, tuple[str, dict[str, Any]]] = {
    "h264": ("mp4", {}),
    "h264 in Matroska": ("mkv", {}),
    "cut at the left and above": ("mov", {"options": {"x264-params": "crop-rect=10,8,0,0"}}),
    "MPEG-4": ("avi", {"codec": "mpeg4"}),
    "VP9": ("webm", {"codec": "libvpx-vp9"}),
    "VP8": ("webm", {"codec": "libvpx"}),
    "HEVC": ("mp4", {"codec": "libx265", "options": {"x265-params": "log-level=none"}}),
    "AV1": ("mp4", {"codec": "libsvtav1", "size": (128, 96)}),
    "ProRes, 10 bits": ("mov", {"codec": "prores_ks", "pixels": "yuv422p10le"}),
    "motion JPEG, all levels": ("avi", {"codec": "mjpeg", "pixels": "yuvj420p"}),
    "FFV1, grey": ("mkv", {"codec": "ffv1", "pixels": "gray"}),
    "FFV1, RGB": ("mkv", {"codec": "ffv1", "pixels": "bgr0"}),
    "MPEG-2": ("mpg", {"codec": "mpeg2video", "size": (128, 96)}),
    "WMV": ("wmv", {"codec": "wmv2"}),
    "H.263": ("3gp", {"codec": "h263", "size": (176, 144)}),
    "a quarter clockwise": ("mp4", {"matrix": TURNED}),
    "half a turn": ("mov", {"matrix": (-1, 0, 0, -1)}),
    "a quarter counter-clockwise": ("mp4", {"matrix": (0, -1, 1, 0)}),
    "mirrored": ("mp4", {"matrix": (-1, 0, 0, 1)}),
    "upside down": ("mov", {"matrix": (1, 0, 0, -1)}),
    "transposed": ("mp4", {"matrix": (0, 1, 1, 0)}),
    "a quarter clockwise in Matroska": ("mkv", {"matrix": TURNED}),
    "start cut off": ("mp4", {"start": 3}),
    "start cut off, B-frames": ("mov", {"start": 3, "bframes": 2}),
    "B-frames": ("mp4", {"bframes": 3, "count": 20}),
    "B-frames, MPEG-4": ("avi", {"codec": "mpeg4", "bframes": 2, "count": 20}),
    "begins late": ("mp4", {"times": tuple(range(10, 18))}),
    "varying rate": ("mp4", {"times": VARYING}),
    "varying rate in Matroska, B-frames": ("mkv", {"times": VARYING, "bframes": 2}),
    "odd size": ("avi", {"codec": "mpeg4", "size": (97, 65)}),
    "odd size, VP9": ("webm", {"codec": "libvpx-vp9", "size": (97, 65), "pixels": "yuv444p"}),
    "wide pixels": ("mp4", {"aspect": Fraction(4, 3)}),
    "narrow pixels": ("mkv", {"aspect": Fraction(8, 9)}),
    "wide pixels, turned": ("mov", {"aspect": Fraction(2, 1), "matrix": TURNED}),
    "cover before the video": ("mp4", {"first": further((200, 200), ATTACHED)}),
    "small video before the video": ("mkv", {"first": further(codec="mpeg4", count=FRAMES)}),
    "sound before the video": ("mp4", {"first": sound}),
    "10 bits": ("mp4", {"codec": "libx265", "pixels": "yuv420p10le", "options": {"x265-params": "log-level=none"}}),
    "colours of high definition, all levels": ("mp4", {"bt709": True, "full": True}),
    "one frame": ("mp4", {"count": 1}),
}


def by_ffmpeg(ffmpeg: Path, file: Path) -> list[np.ndarray]:
    """The frames (H, W, 3) that FFmpeg shows, none twice and none left out for the rate's sake."""
    command = [str(ffmpeg), "-v", "error", "-i", str(file), "-fps_mode", "passthrough"]
    command += ["-vf", SQUARE, "-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]
    stream = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
    frames = []
    while stream:
        _, width, height, _ = stream[:40].split(None, 4)[:4]
        begin, length = stream.index(b"255\n") + 4, 3 * int(width) * int(height)
        pixels = np.frombuffer(stream[begin : begin + length], np.uint8)
        frames.append(pixels.reshape(int(height), int(width), 3))
        stream = stream[begin + length :]
    return frames


def by_viewnet(file: Path) -> list[np.ndarray]:
    """The frames (H, W, 3) that the package reads."""
    frames = []
    for _, _, image in read_frames(file, range(frame_count(file))):
        if isinstance(image, ViewnetError):
            raise image
        frames.append(np.asarray(image.convert("RGB")))
    return frames


def compare(ours: list[np.ndarray], theirs: list[np.ndarray]) -> tuple[float, str]:
    """The largest mean difference of two frames, and how they differ, "" where they do not."""
    if len(ours) != len(theirs):
        return np.nan, f"{len(ours)} frames, not {len(theirs)}"
    sizes = {(mine.shape, other.shape) for mine, other in zip(ours, theirs, strict=True) if mine.shape != other.shape}
    if sizes:
        (height, width, _), (high, wide, _) = sizes.pop()
        return np.nan, f"{width} x {height}, not {wide} x {high}"
    worst = max(float(np.abs(a.astype(int) - b).mean()) for a, b in zip(ours, theirs, strict=True))
    return worst, "pixels" if worst > LEVELS else ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ffmpeg", type=Path, required=True, help="the program")
    parser.add_argument("--keep", type=Path, help="a folder for the videos")
    parser.add_argument("-o", "--output", type=Path, default=paths.tables() / "trust" / "videos.csv")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(prefix="viewnet-videos-") as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for number, (name, (suffix, how)) in enumerate(VIDEOS.items()):
            file = folder / f"{number:02d}.{suffix}"
            write(file, **how)
            theirs = by_ffmpeg(options.ffmpeg, file)
            try:
                worst, differs = compare(by_viewnet(file), theirs)
            except ViewnetError as error:
                worst, differs = np.nan, str(error)
            size = f"{theirs[0].shape[1]} x {theirs[0].shape[0]}"
            row = {"video": name, "container": suffix, "frames": len(theirs), "size": size}
            rows.append(row | {"mean_difference": round(worst, 2), "differs": differs})
            print(*rows[-1].values(), sep=", ", flush=True)
    with replacing(options.output) as file:
        pd.DataFrame(rows).to_csv(file, index=False, lineterminator="\n")
    wrong = sum(bool(row["differs"]) for row in rows)
    print(f"{len(rows)} videos, {wrong} differ")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
