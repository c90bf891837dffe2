"""Frames of videos and of folders: which are sampled, their order, and damaged files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.video_data import write_frames, write_video
from PIL import Image

from viewnet.data.clips import frame_count, images_in, pick_frames, read_frames, upright
from viewnet.errors import ViewnetError


def greys(source: Path, numbers: list[int]) -> list[tuple[int, str, int]]:
    """Number, name and brightness of frames."""
    found = []
    for number, name, image in read_frames(source, numbers):
        assert isinstance(image, Image.Image), image
        found.append((number, name, round(float(np.asarray(image.convert("L")).mean()))))
    return found


def test_a_folder_is_read_in_the_order_of_numbers(tmp_path):
    write_frames(tmp_path / "clip", {"10.png": 100, "9.png": 90, "1.png": 10})
    (tmp_path / "clip/notes.txt").write_text("no image")
    assert [path.name for path in images_in(tmp_path / "clip")] == ["1.png", "9.png", "10.png"]
    assert frame_count(tmp_path / "clip") == 3
    assert greys(tmp_path / "clip", [2, 0]) == [(0, "1", 10), (2, "10", 100)]


def test_a_video_gives_the_frames_asked_for(tmp_path):
    write_video(tmp_path / "a.mp4", [20 * k for k in range(12)])
    assert frame_count(tmp_path / "a.mp4") == 12
    found = greys(tmp_path / "a.mp4", [0, 5, 11])
    assert [(number, name) for number, name, _ in found] == [(0, "000000"), (5, "000005"), (11, "000011")]
    assert [grey for *_, grey in found] == pytest.approx([0, 100, 220], abs=6)


def test_damaged_files_cost_what_is_damaged(tmp_path):
    write_frames(tmp_path / "clip", {"0.png": 10, "1.png": 20})
    (tmp_path / "clip/1.png").write_bytes((tmp_path / "clip/1.png").read_bytes()[:60])
    first, second, beyond = read_frames(tmp_path / "clip", [0, 1, 2])
    assert isinstance(first[2], Image.Image)
    assert "frame does not decode" in str(second[2]) and "no such frame" in str(beyond[2])

    write_video(tmp_path / "b.mkv", [20 * k for k in range(12)], noise=40)
    whole = (tmp_path / "b.mkv").read_bytes()
    (tmp_path / "b.mkv").write_bytes(whole[: len(whole) // 2])
    found = list(read_frames(tmp_path / "b.mkv", range(12)))
    assert [number for number, *_ in found] == list(range(12))
    good = [isinstance(image, Image.Image) for *_, image in found]
    assert good[0] and not good[-1] and good == sorted(good, reverse=True)

    (tmp_path / "c.mp4").write_bytes(b"not a video")
    with pytest.raises(ViewnetError, match="video cannot be read"):
        frame_count(tmp_path / "c.mp4")
    (tmp_path / "none").mkdir()
    with pytest.raises(ViewnetError, match="no frames in it"):
        frame_count(tmp_path / "none")


def test_frames_are_picked_by_seed_and_name_or_evenly():
    assert pick_frames(3, None, "random", "a") == pick_frames(3, 5, "evenly", "a") == [0, 1, 2]
    assert pick_frames(100, 4, "evenly", "a") == [12, 37, 62, 87]
    drawn = pick_frames(100, 10, "random", "a", seed=1)
    assert len(set(drawn)) == 10 and drawn == sorted(drawn) and drawn == pick_frames(100, 10, "random", "a", seed=1)
    assert drawn != pick_frames(100, 10, "random", "b", seed=1) and drawn != pick_frames(100, 10, "random", "a", seed=2)
    with pytest.raises(ViewnetError, match="frames 0: expected 1 or more"):
        pick_frames(100, 0, "random", "a")


def test_a_quarter_turn_by_the_display_matrix():
    image = Image.new("L", (3, 2), 0)
    image.putpixel((2, 0), 255)  # the upper right corner becomes the lower right one
    turned = upright(image, np.array([0, 65536, 0, -65536, 0, 0, 0, 0, 2**30]))
    assert turned.size == (2, 3) and turned.getpixel((1, 2)) == 255
    assert upright(image, np.array([65536, 0, 0, 0, 65536, 0, 0, 0, 2**30])) == image
