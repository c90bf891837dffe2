from __future__ import annotations

from pathlib import Path

import pytest
from helpers.fake_steps import STEPS, calls
from helpers.photo_data import keep_apart, make_photos
from helpers.tables import cell_of
from helpers.video_data import write_uco3d

from viewnet.config import PhotoConfig, VideoConfig
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.experiments.request import accepted
from viewnet.experiments.videos import ObjectronExperiment
from viewnet.tables.table import named

ROWS = ("Constant", "ShapeNet", "+ Objectron, supervised masks", "+ Objectron, weak masks")
ALIGNED = {row: (f"{row}*", row, f"{row} (robust)") for row in ROWS[1:]}


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    return keep_apart(tmp_path, monkeypatch)


@pytest.fixture
def fakes(tmp_path, monkeypatch):
    """Fake trainings, videos and photographs."""

    def photo_views(config, workers=None, progress=True):
        folder = tmp_path / "photos"
        return ViewStore.open(folder) if folder.exists() else make_photos(folder, category="chair", size=32)

    monkeypatch.setattr("viewnet.data.build.photo_views", photo_views)
    monkeypatch.setattr("viewnet.data.build.video_views", lambda video, workers, progress: video)
    monkeypatch.setattr("viewnet.data.clip_store.summary", lambda video: f"cut out by {video.mask_folder}/")
    monkeypatch.setattr("viewnet.data.photo_store.summary", lambda store: f"{len(store)} photographs")
    monkeypatch.setattr("viewnet.model.checkpoint.identity", lambda start: Path(start).name)
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)


def test_defaults_start_on_models_and_go_on_to_ten_frames_a_video_with_either_masks():
    request = experiment("objectron")
    assert isinstance(request, ObjectronExperiment)
    assert (request.profile, request.recipe, request.label, request.categories) == ("tiny", "photos", "", ("chair",))
    begun, supervised, weak = request.configs
    assert begun.data.video is None and begun.train.start is None and begun.train.search.share > 0
    video = VideoConfig("chair", kind="objectron", count=10, videos=160, frames=30)
    assert (supervised.data.video, supervised.train.search.share) == (video, 0)
    assert weak.data.video.mask_folder == "masks_weak" and weak.model == supervised.model == begun.model
    assert request.photo_config("chair") == PhotoConfig("chair", size=32, square=False)
    assert request.note.startswith(
        "a stand-in for photographs; trained on built-in models, then on a stand-in for Objectron, profile tiny"
    )


def test_of_objectron_itself_weak_masks_are_used_where_they_are_named(tmp_path):
    root = str(tmp_path)
    plain = experiment("objectron", video_root=root, masks="deeplabv3", cad_root=root)
    assert [config.data.video and config.data.video.masks for config in plain.configs] == [None, "deeplabv3"]
    assert plain.configs[0].data.root == root and "a CAD collection, then on Objectron" in plain.note
    assert plain.unmeasured_rows == ALIGNED[ROWS[3]]
    both = experiment("objectron", video_root=root, masks="deeplabv3", weak_masks="elsewhere")
    weak = both.configs[2].data.video
    assert (weak.masks, weak.mask_folder, weak.count) == ("files", "elsewhere", 10)
    assert both.unmeasured_rows == ()


def test_videos_may_be_those_of_uco3d(tmp_path):
    write_uco3d(tmp_path, ["furniture/chair/1-1"])
    request = experiment("objectron", video_root=str(tmp_path))
    assert request.video == VideoConfig("chair", str(tmp_path), kind="uco3d", count=10, videos=160, frames=30)
    assert "then on uCO3D" in request.note


def test_nothing_but_the_default_is_written_where_the_default_goes(tmp_path):
    root = {"video_root": str(tmp_path)}
    options = [
        {"profile": "smoke"}, {"category": "bottle"}, root, root | {"weak_masks": "weak"}, {"data_root": str(tmp_path)},
        {"cad_root": str(tmp_path)}, {"masks": "maskrcnn"}, {"backgrounds": str(tmp_path)}, {"recipe": "matting"},
    ]  # fmt: skip
    labels = [experiment("objectron", **option).label for option in options]
    assert len({"", *labels}) == len(options) + 1


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"category": "car"}, "unknown category 'car'"),
        ({"masks": "none"}, "unknown masks 'none'"),
        ({"weak_masks": "weak"}, "weak_masks weak: the stand-in has"),
        ({"video_root": "nowhere"}, "video_root nowhere: no such folder"),
        ({"categories": "chair"}, "objectron 'categories'"),
        ({"start": "shapenet"}, "unknown parameter of objectron 'start'"),
    ],
)
def test_bad_parameters_are_named(option, message):
    with pytest.raises(ViewnetError, match=message):
        experiment("objectron", **option)
    assert "weak_masks" in accepted("objectron") and "weak_masks" not in accepted("table4_freiburg")


@pytest.mark.slow
def test_every_training_has_its_row_beside_what_is_printed(fakes, folders, tmp_path):
    request = experiment("objectron", profile="smoke", seeds=2, workers=1)
    runs = request.run(progress=False)
    assert len(runs) == len(request.configs) == len(calls(folders)) == 6
    table = request.table(runs)
    assert table.complete
    labels = {row: [named(label, "photos") for label in ALIGNED[row]] for row in ROWS[1:]}
    assert table.rows == (ROWS[0], *labels[ROWS[1]], *labels[ROWS[2]], *labels[ROWS[3]])
    shown = [ROWS[0], *(labels[row][1] for row in ROWS[1:])]
    assert [cell_of(table, row, "chair", "acc30")["printed"] for row in shown] == ["", "83", "91", "89"]
    assert [cell_of(table, row, "chair", "median")["printed"] for row in shown] == ["", "", "8.8", "10.1"]
    for row, mine in zip(ROWS[1:], (runs[:2], runs[2:4], runs[4:]), strict=True):
        for label in labels[row]:
            cell = cell_of(table, label, "chair", "acc30")
            assert cell["seeds"] == 2
            assert {key.partition("/")[0] for key in cell["runs"].split()} == {run.key for run in mine}
    masks = [run.config.data.video and run.config.data.video.mask_folder for run in runs]
    assert masks == [None, None, "masks", "masks", "masks_weak", "masks_weak"]


@pytest.mark.slow
def test_without_weak_masks_their_row_is_left_as_printed(fakes, tmp_path):
    root = tmp_path / "objectron"
    root.mkdir()
    request = experiment("objectron", profile="smoke", video_root=str(root), workers=1)
    table = request.table(request.run(progress=False))
    assert table.complete
    cell = cell_of(table, ROWS[3], "chair", "acc30")
    assert (cell["printed"], cell["seeds"]) == ("89", 0)
    assert any("supervised masks (files in masks): cut out by masks/" in line for line in table.remarks)
    assert not any("weak masks" in line for line in table.remarks)
