"""Masks as a video: beside any video, and in uCO3D's layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.video_data import box_masks, encode, write_frames, write_uco3d, write_video
from PIL import Image

from viewnet.config import VideoConfig
from viewnet.data import mask_files
from viewnet.data.build import video_views
from viewnet.data.catalogue import check
from viewnet.data.clip_store import summary
from viewnet.data.clips import Clip, Frame, masks_in, read_frames
from viewnet.data.masks import from_files
from viewnet.data.readers import uco3d, video_folder
from viewnet.errors import ViewnetError

BLACK = np.zeros((48, 64, 3), np.uint8)
LOSSY = [("mpeg4", "yuv420p"), ("libx264", "gray"), ("libvpx-vp9", "yuv420p"), ("mjpeg", "yuvj420p")]
LOSSLESS = [("ffv1", "gray"), ("ffv1", "yuv444p")]


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))


def clip_of(folder: Path, masks: list[np.ndarray], frames: int | None = None, codec: str = "libx264", **how) -> Clip:
    """A clip of grey frames with these masks (H, W, 3) as a video."""
    frames = len(masks) if frames is None else frames
    write_video(folder / "a.mp4", [20 * k for k in range(frames)])
    encode(folder / "a_mask.mkv", masks, codec, how.get("pixels", "gray"))
    return Clip("a", "car", "train", folder / "a.mp4", tuple(map(Frame, range(frames))), folder / "a_mask.mkv")


def masks_of(clip: Clip, numbers: list[int]) -> list[np.ndarray]:
    follow = from_files().follow(clip)
    return [follow(number, name, image) for number, name, image in read_frames(clip.source, numbers)]


@pytest.mark.parametrize(("codec", "pixels"), LOSSY + LOSSLESS)
def test_each_image_gets_the_mask_of_its_number(codec, pixels, tmp_path):
    masks = box_masks(6)
    clip = clip_of(tmp_path, masks, codec=codec, pixels=pixels)
    found = masks_of(clip, [0, 3, 5])
    for number, mask in zip([0, 3, 5], found, strict=True):
        off = (mask > 127) != (masks[number][..., 0] > 127)  # (H, W)
        assert off.sum() <= (40 if codec != "ffv1" else 0)  # of 144 pixels on the outline
        assert set(np.unique(mask)) == {0, 255}


def test_what_is_soft_without_loss_stays_and_ramps_of_lossy_videos_go(tmp_path):
    soft = box_masks(2)
    for mask in soft:
        mask[8:40, 9] = mask[8:40, 51] = 100
    (lossless,) = masks_of(clip_of(tmp_path, soft, codec="ffv1"), [0])
    assert (lossless[8:40, 9] == 100).all()
    steps = np.r_[np.zeros(8), [3, 40, 100, 140, 220, 250], np.full(8, 252)]
    ramp = Image.fromarray(np.tile(steps, (9, 1)).astype(np.uint8))
    assert (mask_files.read_lossy(ramp) == np.r_[np.zeros(11), np.full(11, 255)]).all()
    assert (mask_files.read(ramp) == steps).all()


GREY = np.full_like(BLACK, 128)
CLASSES = [mask // 255 * 5 for mask in box_masks(6)]
UNUSABLE = {
    "fewer": (box_masks(5), 6, r"another number of frames \(a_mask.mkv: 5, and 6 images\)"),
    "more": (box_masks(7), 6, r"another number of frames \(a_mask.mkv: 7, and 6 images\)"),
    "smaller": (box_masks(6, (60, 44)), 6, r"another size \(a_mask.mkv: 60 x 44, and images of 64 x 48\)"),
    "turned": ([mask.swapaxes(0, 1) for mask in box_masks(6)], 6, r"another size \(a_mask.mkv: 48 x 64"),
    "empty": ([BLACK] * 6, 6, r"no object \(a_mask.mkv: all of them are black\)"),
    "grey": ([GREY] * 6, 6, r"no object \(a_mask.mkv: mask is ambiguous"),
    "numbers of classes": (CLASSES, 6, r"no object \(a_mask.mkv: all of them are black"),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_a_video_that_cannot_be_of_the_clip_ends_in_one_message(name, tmp_path):
    masks, frames, message = UNUSABLE[name]
    with pytest.raises(ViewnetError, match=f"^video of masks .*{message}"):
        from_files().follow(clip_of(tmp_path, masks, frames))
    (tmp_path / "a_mask.mkv").write_bytes(b"?")
    with pytest.raises(ViewnetError, match=r"video of masks is unusable \(a_mask.mkv: video cannot be read"):
        from_files().follow(Clip("a", "car", "train", tmp_path / "a.mp4", (), tmp_path / "a_mask.mkv"))


def test_numbers_of_classes_are_read_where_nothing_is_lost(tmp_path):
    (mask,) = masks_of(clip_of(tmp_path, CLASSES, codec="ffv1"), [2])
    assert ((mask == 255) == (CLASSES[2][..., 0] > 0)).all()


def test_frames_whose_mask_cannot_be_used_are_listed_by_number(tmp_path):
    folder = tmp_path / "v"
    folder.mkdir()
    masks = box_masks(5)
    masks[2], masks[4] = BLACK, GREY
    clip_of(folder, masks)
    (folder / "splits.csv").write_text("clip,split\na,train\n")
    store = video_views(VideoConfig("car", str(folder), size=16), 1, False)
    assert store.index["view"].tolist() == [0, 1, 3]
    assert [(row.model_id, row.reason.split(" (")[0]) for row in store.rejected.itertuples()] == [
        ("a/000002", "mask is empty"),
        ("a/000004", "mask is ambiguous"),
    ]
    assert "40.0 % of the frames without a usable mask" in summary(store)


def test_masks_lie_in_a_folder_of_masks_or_beside_the_clip(tmp_path):
    for name in ("a", "b", "c", "d", "gas_mask", "twice"):
        write_video(tmp_path / f"{name}.mp4", [10, 90, 200])
    (tmp_path / "masks/b").mkdir(parents=True)
    places = {"a": "a_mask.mkv", "c": "masks/c.avi", "twice": "masks/twice.mkv"}
    for place in [*places.values(), "twice_mask.mp4"]:
        encode(tmp_path / place, box_masks(3))
    write_frames(tmp_path / "d_mask", {f"{k:06d}.png": 255 for k in range(3)})
    clips, rejected = video_folder.read(tmp_path, "car", None)
    found = {clip.id: clip.masks and clip.masks.relative_to(tmp_path).as_posix() for clip in clips}
    assert found == {"a": "a_mask.mkv", "b": "masks/b", "c": "masks/c.avi", "d": "d_mask", "gas_mask": None}
    assert [(name, reason.split(" (")[0]) for name, _, reason in rejected] == [("twice", "masks are there twice")]
    (tmp_path / "masks/c").mkdir()
    with pytest.raises(ViewnetError, match=r"there twice \(c.avi, c\)"):
        masks_in(tmp_path / "masks", "c")


def test_masks_of_a_folder_of_frames_may_be_a_video_in_another_folder(tmp_path):
    root = tmp_path / "v"
    for name in ("a", "b"):
        write_frames(root / name, {f"{k}.png": 60 * k for k in range(3)})
    (root / "splits.csv").write_text("clip,split\na,train\nb,train\n")
    (tmp_path / "other").mkdir()
    for name in ("a", "b"):
        encode(tmp_path / f"other/{name}.mkv", box_masks(3), "ffv1", "gray")
    store = video_views(VideoConfig("car", str(root), size=16, mask_folder=str(tmp_path / "other")), 1, False)
    assert len(store) == 6 and store.rejected.empty
    covered = (store.images[..., 3] > 127).mean((1, 2))
    assert (abs(covered - 32 / 40) < 0.15).all()  # boxes of 40 x 32 pixels, with a margin


# -- uCO3D

CARS = [f"personal_vehicles/car__automobile_/{number}-{number}" for number in range(4)]


def test_uco3d_is_read_by_its_layout(tmp_path):
    root = tmp_path / "uCO3D"
    write_uco3d(root, [*CARS, "furniture/chair/1-1"])
    (root / CARS[1] / "mask_video.mkv").unlink()
    (root / CARS[2] / "rgb_video.mp4").unlink()
    clips, rejected = uco3d.read(root, "car", 2, "evenly")
    assert [(clip.id, [frame.number for frame in clip.frames], clip.masks is not None) for clip in clips] == [
        (CARS[0], [1, 3], True),
        (CARS[1], [1, 3], False),
        (CARS[3], [1, 3], True),
    ]
    assert rejected == [(CARS[2], CARS[2], "no rgb_video.mp4")]
    with pytest.raises(ViewnetError, match=r"no usable video of bus__vehicle_ \(no <super>/bus__vehicle_/\)"):
        uco3d.read(root, "bus")


def test_uco3d_becomes_views(tmp_path):
    root = tmp_path / "uCO3D"
    write_uco3d(root, CARS)
    encode(root / CARS[3] / "mask_video.mkv", box_masks(2), "ffv1", "gray")
    config = VideoConfig("car", str(root), size=16)
    store = video_views(config, 1, False)
    assert store.index["model_id"].value_counts().to_dict() == dict.fromkeys(CARS[:3], 4)
    assert store.index["source"][0] == f"{CARS[0]}/rgb_video.mp4#000000" and store.index["azimuth"].isna().all()
    assert set(store.rejected["path"]) == {f"{CARS[3]}/rgb_video.mp4"}
    assert "mask_video.mkv: 2, and 4 images" in store.rejected["reason"][0]
    encode(root / CARS[3] / "mask_video.mkv", box_masks(4), "ffv1", "gray")
    assert len(video_views(config, 1, False)) == 16, "another store, as a file has changed"


def test_a_check_says_what_a_copy_of_uco3d_holds(tmp_path):
    root = tmp_path / "uCO3D"
    write_uco3d(root, [*CARS, "furniture/chair/1-1", "furniture/stool/1-1"])
    (root / CARS[1] / "mask_video.mkv").unlink()
    encode(root / CARS[3] / "mask_video.mkv", [BLACK] * 4)
    found = check(root)
    assert found.key == "uco3d" and found.problems == []
    assert found.counts == {
        "car": {"videos": 4, "videos with masks": 3},
        "chair": {"videos": 1, "videos with masks": 1},
    }
    assert found.notes == ["car: 2 of 4 videos opened: --deep opens all", "folders of other categories: stool"]
    found = check(root, deep=True)
    assert found.counts["car"] == {"videos": 3, "videos with masks": 2}
    assert found.problems == ["car: 1 left out: video of masks shows no object: personal_vehicles/car__automobile_/3-3"]
