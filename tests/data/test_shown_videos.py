"""Videos as players show them: turned, mirrored and edited."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from viewnet.data.clips import frame_count, read_frames, square
from viewnet.errors import ViewnetError

ONE = 65536
MATRICES = {
    "as it is": ((1, 0, 0, 1), "upper left"),
    "a quarter clockwise": ((0, 1, -1, 0), "upper right"),
    "half": ((-1, 0, 0, -1), "lower right"),
    "a quarter counter-clockwise": ((0, -1, 1, 0), "lower left"),
    "mirrored": ((-1, 0, 0, 1), "upper right"),
    "upside down": ((1, 0, 0, -1), "lower left"),
    "transposed": ((0, 1, 1, 0), "upper left"),
    "transposed the other way": ((0, -1, -1, 0), "lower right"),
}
"""a, b, c, d of the matrix, and where players show what is stored at the upper left; FFmpeg's tool shows the same."""


def write_mp4(file: Path, frames: int = 6, start: int = 0, codec: str = "mpeg4", **options: Any) -> None:
    """A red corner at the upper left, grey elsewhere by the frame's number; frames before `start` are edited out."""
    with av.open(str(file), "w", options={"avoid_negative_ts": "disabled"} if start else {}) as container:
        stream = container.add_stream(codec, rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.gop_size = frames
        for name, value in options.items():
            setattr(stream.codec_context, name, value)
        for number in range(frames):
            image = np.full((48, 64, 3), 40 + 20 * number, np.uint8)
            image[:16, :16] = 250, 0, 0
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts = number - start
            frame.time_base = Fraction(1, 10)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def set_matrix(file: Path, a: int, b: int, c: int, d: int) -> None:
    """Write the matrix into the track's header, where it begins with the 40th byte after the box's name."""
    content = bytearray(file.read_bytes())
    place = content.index(b"tkhd") + 4 + 40
    content[place : place + 36] = struct.pack(">9i", a * ONE, b * ONE, 0, c * ONE, d * ONE, 0, 0, 0, 2**30)
    file.write_bytes(content)


def red_corner(image: Image.Image) -> str:
    pixels = np.asarray(image.convert("RGB")).astype(int)
    corners = {
        "upper left": pixels[:10, :10],
        "upper right": pixels[:10, -10:],
        "lower left": pixels[-10:, :10],
        "lower right": pixels[-10:, -10:],
    }
    (where,) = [name for name, part in corners.items() if part[..., 0].mean() > 180 and part[..., 1].mean() < 60]
    return where


@pytest.mark.parametrize("name", MATRICES)
def test_a_video_is_seen_as_players_show_it(name, tmp_path):
    matrix, corner = MATRICES[name]
    write_mp4(tmp_path / "a.mp4")
    set_matrix(tmp_path / "a.mp4", *matrix)
    ((_, _, image),) = read_frames(tmp_path / "a.mp4", [1])
    assert red_corner(image) == corner
    assert image.size == ((64, 48) if matrix[0] else (48, 64))


@pytest.mark.parametrize("options", [{}, {"max_b_frames": 2}], ids=["in order", "out of order"])
def test_frames_that_an_edit_list_leaves_out_are_not_there(options, tmp_path):
    write_mp4(tmp_path / "whole.mp4", 8, **options)
    write_mp4(tmp_path / "cut.mp4", 8, start=3, **options)
    for name, expected in (("whole.mp4", range(8)), ("cut.mp4", range(3, 8))):
        assert frame_count(tmp_path / name) == len(expected)
        frames = list(read_frames(tmp_path / name, range(len(expected))))
        greys = [round(float(np.asarray(image)[30:, 30:].mean())) for _, _, image in frames]
        assert greys == pytest.approx([40 + 20 * number for number in expected], abs=5)
        ((_, _, beyond),) = read_frames(tmp_path / name, [len(expected)])
        assert "frame does not decode" in str(beyond)


@pytest.mark.parametrize(
    ("aspect", "matrix", "size"),
    [
        (Fraction(4, 3), "as it is", (85, 48)),
        (Fraction(8, 9), "as it is", (64, 54)),
        (Fraction(2, 1), "a quarter clockwise", (48, 128)),
        (Fraction(1, 1), "as it is", (64, 48)),
    ],
)
def test_pixels_become_square_and_none_is_lost(aspect, matrix, size, tmp_path):
    write_mp4(tmp_path / "a.mp4", sample_aspect_ratio=aspect)
    set_matrix(tmp_path / "a.mp4", *MATRICES[matrix][0])
    ((_, _, image),) = read_frames(tmp_path / "a.mp4", [1])
    assert image.size == size and red_corner(image) == MATRICES[matrix][1]


def test_pixels_of_an_absurd_shape_are_refused():
    with pytest.raises(ValueError):
        square(Image.new("RGB", (64, 48)), Fraction(100_000, 1))


STREAMS = {
    "the largest": ("mkv", [(32, 32, 0), (64, 48, 0)], (64, 48)),
    "the default": ("mkv", [(96, 96, 0), (64, 48, 1)], (64, 48)),
    "no cover": ("mp4", [(96, 96, 1024), (64, 48, 0)], (64, 48)),
    "the first": ("mkv", [(64, 48, 0), (48, 64, 0)], (64, 48)),
}
"""Suffix; width, height and disposition (FFmpeg's numbers) of streams; the size that is shown."""


@pytest.mark.parametrize("name", STREAMS)
def test_of_several_streams_the_one_that_players_show_is_read(name, tmp_path):
    suffix, streams, size = STREAMS[name]
    file = tmp_path / f"a.{suffix}"
    with av.open(str(file), "w") as container:
        made = []
        for width, height, role in streams:
            stream = container.add_stream("mjpeg", rate=10)
            stream.width, stream.height, stream.pix_fmt, stream.disposition = width, height, "yuvj420p", role
            made.append(stream)
        for stream, (width, height, _) in zip(made, streams, strict=True):
            container.mux(stream.encode(av.VideoFrame(width, height, "yuvj420p")))
            container.mux(stream.encode())
    ((_, _, image),) = read_frames(file, [0])
    assert image.size == size


def test_an_unknown_codec_is_told(tmp_path):
    write_mp4(tmp_path / "a.avi")
    content = (tmp_path / "a.avi").read_bytes()
    (tmp_path / "a.avi").write_bytes(content.replace(b"FMP4", b"ZZZZ"))
    with pytest.raises(ViewnetError, match="video cannot be read"):
        frame_count(tmp_path / "a.avi")


def test_an_image_is_cut_at_its_left_by_any_number_of_pixels(tmp_path):
    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"x264-params": "crop-rect=10,8,0,0"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode())
    ((_, _, image),) = read_frames(tmp_path / "a.mp4", [0])
    assert image.size == (54, 40)


def test_a_rejected_frame_is_called_a_frame(tmp_path):
    (tmp_path / "0.png").write_bytes(b"?")
    ((_, _, error),) = read_frames(tmp_path, [0])
    assert str(error).startswith("frame does not decode")
