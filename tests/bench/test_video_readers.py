"""benchmarks/video_readers.py: frames that are others, turned or of another size are found out."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "video_readers.py"
spec = importlib.util.spec_from_file_location("video_readers", SCRIPT)
video_readers = importlib.util.module_from_spec(spec)
spec.loader.exec_module(video_readers)

FRAMES = [video_readers.picture(number, (96, 64)) for number in range(video_readers.FRAMES)]


@pytest.mark.parametrize(
    ("others", "differs"),
    [
        (FRAMES, ""),
        (FRAMES[1:], "8 frames, not 7"),
        (FRAMES[1:] + FRAMES[:1], "pixels"),
        ([frame[::-1] for frame in FRAMES], "pixels"),
        ([frame[:, ::-1] for frame in FRAMES], "pixels"),
        ([frame[..., ::-1] for frame in FRAMES], "pixels"),
        ([np.rot90(frame) for frame in FRAMES], "96 x 64, not 64 x 96"),
    ],
)
def test_another_film_is_told(others, differs):
    assert video_readers.compare(FRAMES, others)[1] == differs


def test_forty_videos_are_compared():
    assert len(video_readers.VIDEOS) == 40


@pytest.mark.parametrize("name", ["h264", "FFV1, RGB", "varying rate"])
def test_what_is_written_is_read(name, tmp_path):
    suffix, how = video_readers.VIDEOS[name]
    video_readers.write(tmp_path / f"a.{suffix}", **how)
    assert video_readers.compare(video_readers.by_viewnet(tmp_path / f"a.{suffix}"), FRAMES)[1] == ""
