"""Freiburg cars: its layout, its splits, its azimuths, and every kind of unusable line and frame."""

from __future__ import annotations

import pytest
from helpers.video_data import write_frames, write_freiburg

from viewnet.data.clips import Frame
from viewnet.data.readers import freiburg
from viewnet.data.readers.freiburg import read
from viewnet.errors import ViewnetError


def test_sequences_become_clips_with_splits_by_number(tmp_path):
    write_freiburg(tmp_path, [2, 45, 46, 47, 48, 52])
    (tmp_path / "masks/car045").mkdir(parents=True)
    clips, rejected = read(tmp_path)
    assert not rejected
    assert [(clip.id, clip.split) for clip in clips] == [
        ("car002", "train"), ("car045", "train"), ("car046", "val"), ("car047", "val"), ("car048", "test"),
        ("car052", "test"),
    ]  # fmt: skip
    box = (8.0, 6.0, 40.0, 30.0)
    assert clips[0].frames == (Frame(0, 0.0, 0.0, box), Frame(1, 10.0, 0.0, box), Frame(2, 20.0, 0.0, box))
    assert (clips[0].category, clips[0].source, clips[0].masks) == ("car", tmp_path / "car002", None)
    assert clips[1].masks == tmp_path / "masks/car045"


def test_folders_and_lists_may_have_padded_numbers_and_bare_names(tmp_path):
    write_frames(tmp_path / "007", {"0001.png": 1, "0002.png": 2})
    (tmp_path / "annotations").mkdir()
    (tmp_path / "annotations/007_annot.txt").write_text("0002.png 1 1 9 9 400\n0001.png 1 1 9 9 -10.5\n\n")
    (clip,), rejected = read(tmp_path)
    assert not rejected
    assert [(frame.number, frame.azimuth) for frame in clip.frames] == [(0, 349.5), (1, 40.0)]


def test_one_constant_says_how_azimuths_are_counted(monkeypatch):
    assert freiburg.azimuth(90) == 90 and freiburg.azimuth(-1e-20) == 0
    monkeypatch.setattr(freiburg, "AZIMUTH", (-1.0, 30.0))
    assert freiburg.azimuth(90) == 300


def test_what_cannot_be_used_is_named_and_the_rest_is_used(tmp_path):
    write_freiburg(tmp_path, [1, 3, 9], frames=6)
    lines = [
        "car001/1.png 1 1 9 9 0",
        "car001/2.png 1 1 9 9",
        "car001/3.png 100 1 120 9 0",
        "car001/99.png 1 1 9 9 0",
        "car001/1.png 1 1 9 9 5",
        "car001/4.png 1 1 9 9 nan",
        "car001/6.png -5 -5 1000 9 7",
    ]
    (tmp_path / "annotations/1_annot.txt").write_text("\n".join(lines))
    (tmp_path / "annotations/3_annot.txt").unlink()
    (tmp_path / "annotations/4_annot.txt").write_text("car004/1.png 1 1 9 9 0")
    (tmp_path / "car009/2.png").write_bytes(b"damaged")
    clips, rejected = read(tmp_path)
    assert [(clip.id, [frame.number for frame in clip.frames]) for clip in clips] == [
        ("car001", [0, 5]),
        ("car009", [0, 2, 3, 4, 5]),
    ]
    assert clips[0].frames[1].box == (0.0, 0.0, 64.0, 9.0)
    assert [(name, path, reason.split(" (")[0]) for name, path, reason in rejected] == [
        ("car001:2", "annotations/1_annot.txt", "annotation is malformed"),
        ("car001:3", "annotations/1_annot.txt", "box has no part in the image"),
        ("car001:4", "annotations/1_annot.txt", "annotation of a frame that is missing"),
        ("car001:5", "annotations/1_annot.txt", "frame annotated twice"),
        ("car001:6", "annotations/1_annot.txt", "annotation is malformed"),
        ("car001/2", "car001/2.png", "frame without a usable annotation"),
        ("car001/4", "car001/4.png", "frame without a usable annotation"),
        ("car001/5", "car001/5.png", "frame without a usable annotation"),
        ("car003", "car003", "no annotations of the sequence"),
        ("car004", "annotations/4_annot.txt", "no frames of the sequence"),
        ("car009:2", "annotations/9_annot.txt", "image does not decode"),
    ]


def test_without_any_usable_frame_there_is_an_error(tmp_path):
    with pytest.raises(ViewnetError, match="no folder annotations"):
        read(tmp_path)
    (tmp_path / "annotations").mkdir()
    with pytest.raises(ViewnetError, match=r"no usable frame \(no sequences\)"):
        read(tmp_path)
    write_frames(tmp_path / "car001", {"1.png": 5})
    with pytest.raises(ViewnetError, match=r"no usable frame .1 no annotations"):
        read(tmp_path)
