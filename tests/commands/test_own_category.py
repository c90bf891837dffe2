"""A category that nobody has heard of, from a folder of one's own to predictions, by commands alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.cad_files import write_box
from helpers.video_data import box_masks, encode, write_frames, write_video
from PIL import Image

from viewnet import cli
from viewnet.config import LIMITS, RunConfig
from viewnet.data import build, catalogue
from viewnet.data.readers.shapenet import find_models
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.recipes import make_config


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.delenv("VIEWNET_CLUSTER", raising=False)
    return tmp_path


def write_teapots(folder: Path, count: int = 6) -> Path:
    """Balls with a spout in front, y up, side by side in one folder."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for number in range(count):
        body, spout = trimesh.creation.icosphere(2, rng.uniform(0.4, 0.6)), trimesh.creation.cylinder(0.1, 0.8)
        spout.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0], [0.2, 0, 0.3]))
        for part in (body, spout):
            part.visual.face_colors = [*rng.integers(50, 200, 3), 255]
        trimesh.util.concatenate([body, spout]).export(folder / f"teapot{number}.obj")
    return folder


def write_turntables(folder: Path, count: int = 5, frames: int = 6) -> Path:
    """Folders of frames, and of their masks."""
    for number in range(count):
        write_frames(folder / f"teapot{number}", {f"{k}.png": 40 + 20 * k for k in range(frames)})
        masks = folder / "masks" / f"teapot{number}"
        masks.mkdir(parents=True)
        for k, mask in enumerate(box_masks(frames)):
            Image.fromarray(mask).save(masks / f"{k}.png")
    return folder


def asked(monkeypatch, *arguments: str) -> RunConfig:
    """The configuration that `viewnet train` would train."""
    found: list[RunConfig] = []
    monkeypatch.setattr("viewnet.runs.needs.needs", lambda configs: found.extend(configs) or exit())
    with pytest.raises(SystemExit):
        cli.main(["train", *arguments, "--dry-run"])
    return found[0]


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_teapots, write_turntables])
def test_from_a_folder_to_a_model_and_its_predictions(write, folders, capsys):
    data = write(folders / "teapots")
    assert cli.main(["train", "teapot", "--data", str(data), "--profile", "smoke", "--workers", "1", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert cli.main(["save", told["key"], str(folders / "my_teapots")]) == 0
    card = (folders / "my_teapots" / "README.md").read_text()
    assert "viewpoint estimation for the category teapot" in card
    Image.new("RGB", (60, 50), (200, 40, 40)).save(folders / "photo.png")
    capsys.readouterr()
    arguments = ["predict", "--model", str(folders / "my_teapots"), str(folders / "photo.png"), "--json"]
    assert cli.main(arguments) == 0
    (said,) = json.loads(capsys.readouterr().out)["images"]
    assert 0 <= said["azimuth"] < 360
    assert ViewpointEstimator.from_pretrained(folders / "my_teapots").config.category == "teapot"


def test_models_lie_in_folders_of_their_own_or_side_by_side(folders):
    flat = find_models(write_teapots(folders / "flat"), "teapot")
    assert [model.id for model in flat] == [f"teapot{number}" for number in range(6)]
    assert {model.split for model in flat} == {"train", "val", "test"}
    for layout in ("v1", "v2"):
        root = folders / layout
        names = [write_box(root, "teapot", f"m{k}", layout).relative_to(root / "teapot").parts[0] for k in range(5)]
        assert [model.id for model in find_models(root, "teapot")] == names  # in a folder named by the category
        assert [model.id for model in find_models(root / "teapot", "teapot")] == names  # and that folder itself
        assert {model.layout for model in find_models(root / "teapot", "car")} == {layout}


def test_few_models_are_seen_from_more_viewpoints(folders, monkeypatch):
    data = write_teapots(folders / "teapots", 8)
    usual = make_config().data
    assert asked(monkeypatch, "teapot", "--data", str(data)).data.views == usual.models * usual.views / 8
    assert asked(monkeypatch, "teapot", "--data", str(data), "-s", "views=7").data.views == 7
    assert asked(monkeypatch, "teapot", "--data", str(data), "--profile", "smoke").data.views == 5
    assert asked(monkeypatch, "car").data.views == usual.views
    assert asked(monkeypatch, "teapot", "--data", str(data), "--profile", "paper").data.views == usual.views


def test_few_frames_are_gone_through_more_often(folders, monkeypatch):
    data = write_turntables(folders / "videos", count=5, frames=10)
    usual = make_config()
    found = asked(monkeypatch, "teapot", "--data", str(data))
    assert found.data.video is not None
    assert found.data.video.root == str(data)
    filmed = make_config(video={"category": "teapot", "root": str(data)}, category="teapot").train.epochs
    assert found.train.epochs == filmed * usual.data.models * usual.data.views / 50 < LIMITS["epochs"][1]
    assert asked(monkeypatch, "teapot", "--data", str(data), "-s", "epochs=3").train.epochs == 3


def test_videos_are_told_from_models(folders):
    videos = folders / "videos"
    videos.mkdir()
    write_video(videos / "one.mp4", [10, 20, 30])
    encode(videos / "one_mask.mkv", box_masks(3), "libx264", "gray")
    assert build.shows_videos(videos, "teapot")
    assert build.shows_videos(write_turntables(folders / "frames"), "teapot")
    assert not build.shows_videos(write_teapots(folders / "models"), "teapot")
    textured = write_box(folders / "textured", "teapot", "m", "v1").parent
    Image.new("RGB", (4, 4)).save(textured / "texture.png")
    assert not build.shows_videos(folders / "textured", "teapot")
    assert not build.shows_videos(folders / "textured/teapot", "teapot")


def no_masks(folder: Path) -> None:
    for number in range(3):
        write_frames(folder / f"teapot{number}", {"0.png": 9, "1.png": 99})


@pytest.mark.parametrize(
    ("category", "write", "message"),
    [
        ("teapot", lambda folder: folder.mkdir(), "no models of teapot: expected .obj files in it or in a folder tea"),
        ("teapot", lambda folder: write_frames(folder, {"0.png": 9}), "images side by side: put the frames of each"),
        ("teapot", no_masks, "mask is missing): put masks in masks/<clip>/, named as the frames"),
        ("my teapot", write_teapots, "category 'my teapot': expected letters, digits, _ and -"),
        ("../teapot", write_teapots, "category '../teapot': expected letters, digits, _ and -"),
        ("", write_teapots, "category '': expected letters, digits, _ and -"),
    ],
)
def test_what_cannot_be_trained_on_is_said_in_one_line(category, write, message, folders, capsys):
    write(folders / "own")
    assert cli.main(["train", category, "--data", str(folders / "own"), "--profile", "smoke"]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("viewnet: ")]
    assert message in line
    assert not list((folders / "runs").glob("*/*"))


def test_models_in_other_formats_are_named(folders):
    (folders / "own").mkdir()
    for name in ("a.glb", "b.STL", "notes.txt"):
        (folders / "own" / name).touch()
    with pytest.raises(ViewnetError, match=r"it has \.glb, \.stl: export these as \.obj"):
        find_models(folders / "own", "teapot")
    with pytest.raises(ViewnetError, match=r"layouts that are read; it has \.glb, \.stl: export these as \.obj"):
        catalogue.check(folders / "own")


def test_built_in_data_have_built_in_categories_alone(capsys):
    assert cli.main(["train", "teapot"]) == 2
    assert "unknown category 'teapot': choose one of aeroplane" in capsys.readouterr().err


def test_data_check_says_what_can_be_used(folders, capsys):
    assert cli.main(["data", "check", str(write_teapots(folders / "models"))]) == 0
    assert "  1 models to test, 4 models to train, 1 models to val" in capsys.readouterr().out
    assert cli.main(["data", "check", str(write_turntables(folders / "frames"))]) == 0
    assert "  5 clips, 30 frames, 5 clips with masks" in capsys.readouterr().out
