"""Folders of videos and of frames: clips, splits, and rejected files."""

from __future__ import annotations

import pytest
from helpers.video_data import write_frames, write_video

from viewnet.data.readers.video_folder import read
from viewnet.errors import ViewnetError
from viewnet.runtime.splits import seeded_splits


def test_videos_and_folders_of_frames_become_clips(tmp_path):
    write_video(tmp_path / "a.mp4", range(12))
    write_frames(tmp_path / "b", {f"{k}.png": k for k in range(3)})
    write_frames(tmp_path / "a", {"0.png": 1})
    (tmp_path / "masks/b").mkdir(parents=True)
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken.mov").write_bytes(b"?")
    (tmp_path / "README").write_text("?")
    write_video(tmp_path / "c.mkv", range(12))
    clips, rejected = read(tmp_path, "chair", 4, "evenly")
    assert {clip.id: [frame.number for frame in clip.frames] for clip in clips} == {
        "a": [0],
        "b": [0, 1, 2],
        "c": [1, 4, 7, 10],
    }
    assert {(clip.category, clip.masks) for clip in clips} == {("chair", None), ("chair", tmp_path / "masks/b")}
    assert {(path, reason.split(" (")[0]) for _, path, reason in rejected} == {
        ("README", "neither a video nor a folder of frames"),
        ("a.mp4", "another clip has its name"),
        ("broken.mov", "video cannot be read"),
        ("empty", "no frames in it"),
    }
    assert sorted(clip.split for clip in clips) == ["test", "train", "val"]


def test_splits_are_given_listed_or_seeded(tmp_path):
    for name in "abcd":
        write_frames(tmp_path / name, {"0.png": 1, "1.png": 2})
    assert {clip.id: clip.split for clip in read(tmp_path, "car")[0]} == seeded_splits("abcd", 0, {"val": 1, "test": 2})
    (tmp_path / "splits.csv").write_text("clip,split\na,train\nb,val\nc,train\n")
    clips, rejected = read(tmp_path, "car")
    assert {clip.id: clip.split for clip in clips} == {"a": "train", "b": "val", "c": "train"}
    assert rejected == [("d", "d", "in no split")]
    (tmp_path / "splits.csv").write_text("clip,split\na,half\n")
    with pytest.raises(ViewnetError, match=r"splits\.csv: line 2: split 'half'"):
        read(tmp_path, "car")
    (tmp_path / "splits.csv").write_text("clip,split\na,val\na,val\n")
    with pytest.raises(ViewnetError, match="clip 'a' is listed twice"):
        read(tmp_path, "car")


def test_seeded_splits_have_exact_shares_whatever_the_order():
    names = [f"clip{k}" for k in range(20)]
    first, again, other = (seeded_splits(*asked, {}) for asked in ((names, 1), (names[::-1], 1), (names, 2)))
    assert first == again != other
    assert sorted(first.values()) == ["test"] * 4 + ["train"] * 14 + ["val"] * 2


def test_where_nothing_can_be_used_there_is_an_error(tmp_path):
    with pytest.raises(ViewnetError, match=r"nowhere: no such folder"):
        read(tmp_path / "nowhere", "car")
    (tmp_path / "a.mp4").write_bytes(b"?")
    with pytest.raises(ViewnetError, match=r"a\.mp4: video cannot be read"):
        read(tmp_path, "car")
    write_frames(tmp_path / "b", {"0.png": 1})
    with pytest.raises(ViewnetError, match="frames -1: expected 1 or more a clip"):
        read(tmp_path, "car", -1)
