"""Clips as view stores: crops, rejected frames, and training without viewpoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.video_data import write_frames, write_freiburg, write_video
from PIL import Image, ImageDraw, ImageFilter

from viewnet.config import DataConfig, VideoConfig
from viewnet.data.build import video_views, view_store
from viewnet.data.clip_store import Cutting, clip_store, sharpness, summary
from viewnet.data.clips import Clip, Frame
from viewnet.data.crop import Crop, bounds
from viewnet.data.masks import from_alpha, from_files
from viewnet.data.store import ViewStore, check_index
from viewnet.data.synthetic import freiburg_standin
from viewnet.errors import ViewnetError
from viewnet.evaluation.predict import predict
from viewnet.recipes import make_config
from viewnet.training.train import train

CROP = Crop(8, margin=0.0)


def make_clip(root: Path, name: str, split: str = "train", frames: int = 3, **changes) -> Clip:
    """A folder of red frames with a green square, which its masks cover: 16 pixels wide, one further every frame."""
    (root / name).mkdir(parents=True)
    (root / "masks" / name).mkdir(parents=True)
    for k in range(frames):
        for folder, ground, thing, mode in ((root, "red", (0, 200, 0), "RGB"), (root / "masks", 0, 255, "L")):
            image = Image.new(mode, (40, 30), ground)
            ImageDraw.Draw(image).rectangle((5 + k, 6, 20 + k, 21), thing)
            image.save(folder / name / f"{k}.png")
    clip = Clip(name, "car", split, root / name, tuple(Frame(k, 10.0 * k, 5.0) for k in range(frames)))
    return replace(clip, **{"masks": root / "masks" / name, **changes})


def store_of(root: Path, clips: list[Clip], masks=None, crop: Crop = CROP, rejected=(), **settings) -> ViewStore:
    folder = root / "stores" / str(len(list((root / "stores").glob("*"))))
    return clip_store(clips, folder, root, Cutting(masks, crop, **settings), rejected, workers=1)


# -- crops


def test_frames_are_cut_out_by_their_masks(tmp_path):
    clips = [make_clip(tmp_path, "b", "val"), make_clip(tmp_path, "a")]
    store = store_of(tmp_path, clips, from_files())
    assert store.images.shape == (6, 8, 8, 4)
    assert (store.images == (0, 200, 0, 255)).all()
    assert store.index["model_id"].tolist() == ["a"] * 3 + ["b"] * 3
    assert store.index["split"].tolist() == ["train"] * 3 + ["val"] * 3
    assert store.index["view"].tolist() == [0, 1, 2] * 2
    assert store.index["azimuth"].tolist() == [0, 10, 20] * 2 and (store.index["elevation"] == 5).all()
    assert store.index["source"].tolist()[:2] == ["a#0", "a#1"]
    assert summary(store).startswith("car: 6 views of 2 clips (1 train, 1 val); 0.0 %")
    assert store.meta["made_by"] == Cutting(from_files(), CROP).describe(clips)


def test_around_the_mask_there_is_nothing_and_colours_stay_straight(tmp_path):
    store = store_of(tmp_path, [make_clip(tmp_path, "a")], from_files(), Crop(12, margin=0.3))
    view = store.images[0].astype(int)
    assert (view[0] == 0).all() and (view[6, 6] == (0, 200, 0, 255)).all()
    edge = (view[..., 3] > 20) & (view[..., 3] < 235)
    assert edge.any() and (view[edge][:, 0] <= 3).all() and (abs(view[edge][:, 1] - 200) <= 3).all()


def turning(root: Path, sizes: list[tuple[int, int]]) -> Clip:
    """A clip of green boxes of these widths and heights."""
    clip = make_clip(root, "turning", frames=len(sizes))
    for k, (width, height) in enumerate(sizes):
        for folder, ground, thing, mode in ((clip.source, "red", (0, 200, 0), "RGB"), (clip.masks, 0, 255, "L")):
            image = Image.new(mode, (400, 200), ground)
            ImageDraw.Draw(image).rectangle((3, 4, 2 + width, 3 + height), thing)
            image.save(folder / f"{k}.png")
    return clip


def extent(view: np.ndarray) -> tuple[int, int]:
    x0, y0, x1, y1 = bounds(view[..., 3])
    return round(x1 - x0), round(y1 - y0)


def test_an_object_is_as_high_in_all_views_of_its_clip_however_far_and_however_turned(tmp_path):
    clip = turning(tmp_path, [(320, 80), (160, 80), (80, 80), (160, 40), (48, 96)])
    levelled = [extent(view) for view in store_of(tmp_path, [clip], from_files(), Crop(40)).images]
    assert np.allclose(levelled, [(40, 10), (20, 10), (10, 10), (40, 10), (5, 10)], atol=1)
    store = store_of(tmp_path, [clip], from_files(), Crop(40), scale="view")
    assert [extent(view) for view in store.images] == [(40, 10), (40, 20), (40, 40), (40, 10), (20, 40)]
    boxed = replace(clip, frames=tuple(replace(frame, box=(3, 4, 83, 84)) for frame in clip.frames))
    assert {extent(view) for view in store_of(tmp_path, [boxed], None, Crop(40)).images} == {(40, 40)}


def test_a_mask_that_is_a_sliver_does_not_make_the_others_small(tmp_path):
    store = store_of(tmp_path, [turning(tmp_path, [(80, 80)] * 39 + [(320, 20)])], from_files(), Crop(40))
    assert {extent(view) for view in store.images[:-1]} == {(40, 40)}
    assert extent(store.images[-1])[0] == 40


def test_a_mask_counts_within_its_box_only(tmp_path):
    clip = make_clip(tmp_path, "a", frames=2)
    for file in clip.masks.iterdir():
        with Image.open(file) as mask:
            mask.load()
        mask.paste(255, (34, 0, 40, 5))
        mask.save(file)
    boxed = replace(clip, frames=tuple(replace(frame, box=(5, 6, 22, 22)) for frame in clip.frames))
    assert (store_of(tmp_path, [boxed], from_files()).images[..., :3] == (0, 200, 0)).all()
    assert not (store_of(tmp_path, [clip], from_files()).images[..., :3] == (0, 200, 0)).all()


def test_without_masks_a_box_is_cut_and_nothing_is_transparent(tmp_path):
    clip = make_clip(tmp_path, "a", frames=2)
    boxed = replace(clip, frames=(Frame(0, box=(5, 6, 21, 22)), Frame(1, box=(6, 6, 22, 22))))
    store = store_of(tmp_path, [boxed])
    assert (store.images == (0, 200, 0, 255)).all()
    assert "without a usable mask" not in summary(store)


def test_a_video_needs_no_list_of_frames(tmp_path):
    write_video(tmp_path / "v.mp4", [40 * k for k in range(6)])
    store = store_of(tmp_path, [Clip("v", "car", "train", tmp_path / "v.mp4", ())])
    assert len(store) == 6 and store.index["azimuth"].isna().all()
    assert store.images[:, 4, 4, 0].tolist() == pytest.approx([40 * k for k in range(6)], abs=6)


def test_bounds_are_edges():
    mask = np.zeros((6, 9), np.uint8)
    mask[2:5, 3:9] = 255
    assert bounds(mask) == (3, 2, 9, 5)
    with pytest.raises(ViewnetError, match="mask is empty"):
        bounds(np.zeros((6, 9), np.uint8))


# -- rejected frames


def test_what_cannot_be_used_is_named_and_the_rest_is_used(tmp_path):
    good, half, lone = (make_clip(tmp_path, name, frames=4) for name in ("good", "half", "lone"))
    (tmp_path / "good/1.png").write_bytes(b"?")
    (tmp_path / "masks/half/0.png").unlink()
    Image.new("L", (40, 30)).save(tmp_path / "masks/half/2.png")
    for k in range(3):
        (tmp_path / f"masks/lone/{k}.png").unlink()
    gone = Clip("gone", "car", "train", tmp_path / "gone.mp4", ())
    store = store_of(tmp_path, [good, half, lone, gone], from_files(), rejected=[("x", "x", "no reason")])
    assert store.index.groupby("model_id")["view"].apply(list).to_dict() == {"good": [0, 2, 3], "half": [1, 3]}
    assert [(row.model_id, row.path, row.reason.split(" (")[0]) for row in store.rejected.itertuples()] == [
        ("x", "x", "no reason"),
        ("gone", "gone.mp4", "video cannot be read"),
        ("good/1", "good", "frame does not decode"),
        ("half/0", "half", "mask is missing"),
        ("half/2", "half", "mask is empty"),
        ("lone/0", "lone", "mask is missing"),
        ("lone/1", "lone", "mask is missing"),
        ("lone/2", "lone", "mask is missing"),
        ("lone", "lone", "fewer than two usable frames"),
    ]
    said = summary(store)
    assert said.startswith("car: 5 views of 2 clips (2 train); 50.0 %") and "left out: 1 fewer than two" in said
    assert "1 mask is empty, 4 mask is missing, 1 no reason" in said


def test_small_and_blurred_objects_are_left_out(tmp_path):
    rng = np.random.default_rng(0)
    clip = make_clip(tmp_path, "a", frames=5)
    for k in range(5):
        noise = Image.fromarray(rng.integers(0, 255, (30, 40, 3), dtype=np.uint8))
        (noise.filter(ImageFilter.GaussianBlur(2)) if k == 2 else noise).save(tmp_path / f"a/{k}.png")
    small = Image.new("L", (40, 30))
    small.paste(255, (5, 6, 30, 16))
    small.save(tmp_path / "masks/a/4.png")
    store = store_of(tmp_path, [clip], from_files(), side=12, blur=0.5)
    assert store.index["view"].tolist() == [0, 1, 3]
    assert set(store.rejected["reason"]) == {"object is too small (25 x 10 pixels)", "blurred"}
    assert len(store_of(tmp_path, [clip], from_files(), side=0)) == 5
    for name in ("side", "blur"):
        with pytest.raises(ViewnetError, match=f"{name} -1"):
            Cutting(None, **{name: -1})


def test_sharpness_falls_with_blur_and_not_with_light():
    rng = np.random.default_rng(0)
    grey = rng.integers(0, 200, (48, 48), dtype=np.uint8)
    views = [
        np.dstack([np.asarray(Image.fromarray(g).filter(ImageFilter.GaussianBlur(blur)))] * 3 + [np.full_like(g, 255)])
        for g, blur in ((grey, 0), (grey // 2, 0), (grey, 1), (grey, 2))
    ]
    sharp, darker, soft, softer = map(sharpness, views)
    assert sharp == pytest.approx(darker, rel=0.05) and sharp > 2 * soft > 4 * softer


def test_clips_that_cannot_be_a_store(tmp_path):
    clip = make_clip(tmp_path, "a")
    with pytest.raises(ViewnetError, match="clip 'a' is there twice"):
        store_of(tmp_path, [clip, clip])
    with pytest.raises(ViewnetError, match="a/0: a: mask is missing"):
        store_of(tmp_path, [clip], from_alpha())
    with pytest.raises(ViewnetError, match="no clip to train on can be used"):
        store_of(tmp_path, [replace(clip, split="val")])
    assert not list((tmp_path / "stores").iterdir())
    half = replace(clip, frames=(*clip.frames, Frame(9, azimuth=3.0)))
    assert "no such frame" in summary(store_of(tmp_path, [half]))


def test_the_store_is_known_by_what_decides_it(tmp_path):
    clip = make_clip(tmp_path, "a")
    usual = Cutting(from_files(), CROP)
    base = usual.describe([clip])
    cuttings = [
        replace(usual, **change) for change in ({"masks": None}, {"crop": Crop(9)}, {"side": 3}, {"scale": "view"})
    ]
    others = [cutting.describe([clip]) for cutting in cuttings]
    others += [usual.describe([replace(clip, **change)]) for change in ({"frames": clip.frames[:2]}, {"split": "val"})]
    Image.new("L", (40, 30)).save(tmp_path / "masks/a/0.png")
    assert base not in [*others, usual.describe([clip])]


# -- unknown viewpoints


def test_an_index_may_lack_whole_viewpoints_only():
    index = pd.DataFrame(
        {
            "model_id": "a",
            "category": "car",
            "split": "train",
            "view": [0, 1],
            "azimuth": [3.0, np.nan],
            "elevation": [3.0, np.nan],
            "source": "s",
        }
    )
    check_index(index, 2, Path("index"))
    for column in ("azimuth", "elevation"):
        with pytest.raises(ViewnetError, match=rf"{column} .*nan.* in row 0"):
            check_index(index.assign(**{column: np.nan}), 2, Path("index"))


# -- from a configuration


def test_a_configuration_opens_videos(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    for name in "abc":
        write_frames(tmp_path / "videos" / name, {f"{k}.png": 50 + 40 * k for k in range(5)})
    config = VideoConfig("chair", str(tmp_path / "videos"), count=2, masks="none", size=16)
    store = video_views(config, 1, False)
    assert len(store) == 6 and store.index["split"].value_counts().to_dict() == {"train": 2, "val": 2, "test": 2}
    assert store.folder.parent == tmp_path / "data/views" and store.folder.name.startswith("videos-chair-")
    assert video_views(config, 1, False).folder == store.folder
    for changes in (
        {"count": 3},
        {"seed": 5},
        {"size": 8},
        {"square": False},
        {"margin": 0.5},
        {"side": 1.0},
        {"blur": 0.1},
    ):
        assert video_views(replace(config, **changes), 1, False).folder != store.folder, changes
    with pytest.raises(ViewnetError, match="count -1: expected 1 or more"):
        video_views(replace(config, count=-1), 1, False)
    whole = video_views(replace(config, split_rule="all"), 1, False)
    assert set(whole.index["split"]) == {"train"} and len(whole) == 6
    assert view_store(DataConfig("chair", video=config), 1, False).folder == store.folder
    with pytest.raises(ViewnetError, match="category car: videos show chair"):
        view_store(DataConfig("car", video=config), 1, False)
    for wrong in (VideoConfig("sofa"), VideoConfig("chair", kind="freiburg"), VideoConfig("chair", kind="folder")):
        with pytest.raises(ViewnetError, match=f"category {wrong.category}: stand-ins"):
            video_views(wrong, 1, False)


def test_the_layout_is_known_by_what_lies_in_the_root_or_by_name(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    write_freiburg(tmp_path / "freiburg", (1, 46))
    cars = VideoConfig("car", str(tmp_path / "freiburg"), masks="none", size=16)
    store = video_views(cars, 1, False)
    assert store.index["azimuth"].tolist() == [0, 10, 20] * 2 and set(store.index["split"]) == {"train", "val"}
    assert set(video_views(replace(cars, split_rule="all"), 1, False).index["split"]) == {"train"}
    with pytest.raises(ViewnetError, match="split rule 'half'"):
        video_views(replace(cars, split_rule="half"), 1, False)
    assert video_views(replace(cars, kind="freiburg"), 1, False).folder == store.folder
    with pytest.raises(ViewnetError, match="no records: expected Objectron's"):
        video_views(replace(cars, category="chair", kind="objectron"), 1, False)
    with pytest.raises(ViewnetError, match="shows cars, not chair"):
        video_views(replace(cars, category="chair"), 1, False)


def test_a_stand_in_for_objectron_is_made_and_read(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    chairs = VideoConfig("chair", videos=3, frames=4, count=3, size=32)
    store = video_views(chairs, 1, False)
    assert set(store.index["split"]) == {"train", "val", "test"}
    assert 6 <= len(store) <= 9 and store.index[["azimuth", "elevation"]].notna().all(axis=None)
    (root,) = (path for path in (tmp_path / "data/objectron-stand-in").iterdir() if path.is_dir())
    given = replace(chairs, root=str(root))
    # Another store, as files that are given are known by their contents.
    assert np.array_equal(video_views(given, 1, False).images, store.images)
    with pytest.raises(ViewnetError, match="pick evenly"):
        video_views(replace(given, pick="evenly"), 1, False)


def test_masks_may_lie_in_another_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    root, elsewhere = tmp_path / "freiburg", tmp_path / "elsewhere"
    write_freiburg(root, (1, 2))
    greys = {f"{k + 1}.png": 255 for k in range(3)}
    for folder in (root / "masks", elsewhere):
        for name in ("car001", "car002"):
            write_frames(folder / name, greys)
    (elsewhere / "car002/2.png").unlink()
    cars = VideoConfig("car", str(root), size=16, split_rule="all")
    found = [
        len(video_views(replace(cars, mask_folder=folder), 1, False))
        for folder in ("masks", str(elsewhere), "../elsewhere")
    ]
    assert found == [6, 5, 5]
    with pytest.raises(ViewnetError, match=r"mask_folder nowhere: .*car001"):
        video_views(replace(cars, mask_folder="nowhere"), 1, False)
    with pytest.raises(ViewnetError, match="elsewhere: only used with masks=files"):
        video_views(replace(cars, mask_folder="elsewhere", masks="alpha"), 1, False)


@pytest.mark.slow
def test_training_for_photographs_on_the_stand_in(tmp_path, monkeypatch, one_thread):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.setattr(freiburg_standin, "NO_MASK", 0.2)
    videos = VideoConfig("car", size=64, sequences=(1, 2, 3, 46, 48), frames=8)
    store = video_views(videos, 1, False)
    counts = store.index.drop_duplicates("model_id")["split"].value_counts().to_dict()
    assert counts == {"train": 3, "val": 1, "test": 1}
    assert "without a usable mask; left out:" in summary(store)
    assert (store.index["elevation"] == 0).all() and store.index["azimuth"].nunique() > 20
    covered = (store.images[..., 3] > 127).mean((1, 2))
    assert covered.min() > 0.05 and covered.max() < 0.9
    config = make_config(profile="smoke", recipe="photos", epochs=1, batch_size=8)
    train(config, store, tmp_path / "run", threads=1, progress=False)
    log = pd.read_csv(tmp_path / "run/log.csv")
    assert np.isfinite(log[["loss", "val_accuracy", "val_reconstruction"]].to_numpy()).all()
    found = predict(tmp_path / "run", store, ("test",))
    assert len(found) == len(store.split("test")) and np.isfinite(found.hypotheses).all()
