from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.fake_steps import STEPS, calls
from helpers.photo_data import keep_apart, make_photos
from helpers.tables import cell_of
from helpers.video_data import write_frames, write_freiburg
from PIL import Image

from viewnet.config import PhotoConfig, VideoConfig
from viewnet.data.build import video_views
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.experiments import experiment
from viewnet.experiments.request import accepted
from viewnet.experiments.videos import VideoExperiment
from viewnet.runs.other_views import on_photographs
from viewnet.tables.packed import as_kept


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    return keep_apart(tmp_path, monkeypatch)


@pytest.fixture
def freiburg(tmp_path) -> str:
    """Videos of noise in the layout of Freiburg static cars, with masks that cover all."""
    root, rng = tmp_path / "freiburg", np.random.default_rng(0)
    write_freiburg(root, (1, 2, 46), frames=6)
    for number in (1, 2, 46):
        for file in (root / f"car{number:03d}").iterdir():
            Image.fromarray(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)).save(file)
        write_frames(root / "masks" / f"car{number:03d}", {f"{k + 1}.png": 255 for k in range(6)})
    return str(root)


@pytest.fixture
def fakes(tmp_path, monkeypatch):
    """Fake trainings and photographs."""

    def photo_views(config, workers=None, progress=True):
        folder = tmp_path / "photos"
        return ViewStore.open(folder) if folder.exists() else make_photos(folder, size=32)

    monkeypatch.setattr("viewnet.data.build.photo_views", photo_views)
    monkeypatch.setattr("viewnet.data.photo_store.summary", lambda store: f"{len(store)} photographs")
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)


def test_defaults_train_on_every_frame_of_a_stand_in_without_labels():
    request = experiment("table4_freiburg")
    assert isinstance(request, VideoExperiment)
    assert (request.profile, request.recipe, request.label, request.categories) == ("tiny", "photos", "", ("car",))
    assert [config.variant for config in request.configs] == ["viewnet", "viewnet_cycle", "relative_pose"]
    for config in request.configs:
        assert config.data.video == VideoConfig("car", kind="freiburg", split_rule="all")
        assert (config.data.backgrounds, config.train.start) == ("drawn", None)
    assert request.photo_config("car") == PhotoConfig("car", size=32, square=False)
    assert request.note.startswith("a stand-in for photographs; trained on a stand-in for Freiburg cars, profile tiny")
    paper = experiment("table4_freiburg", profile="paper")
    assert {config.train.select_by for config in paper.configs} == {"reconstruction"}
    held_out = experiment("table4_freiburg", profile="paper", split_rule="45/2/rest")
    assert [config.train.select_by for config in held_out.configs] == ["accuracy", "accuracy", "reconstruction"]
    small = experiment("table4_freiburg", profile="smoke").video
    assert len(small.sequences) * small.frames < 100


def test_parameters_reach_videos_photographs_and_training(tmp_path, freiburg):
    request = experiment(
        "table4_freiburg", video_root=freiburg, data_root=freiburg, cad_root=freiburg, start="shapenet",
        masks="maskrcnn", split_rule="45/2/rest", backgrounds=freiburg, features="pixels", seeds=2,
    )  # fmt: skip
    video = request.configs[0].data.video
    assert (video.root, video.masks, video.split_rule) == (freiburg, "maskrcnn", "45/2/rest")
    assert request.photo_config("car").root == freiburg
    assert request.configs[0].data.backgrounds == freiburg
    assert [config.seed for config in request.starts] == [0, 1]
    assert "VpDR-Net (trained here)" in request.unmeasured_rows  # it cannot start from ViewNet's weights
    first, second = request.starts[0], request.configs[0]
    assert (first.data.root, first.data.video, first.model) == (freiburg, None, second.model)
    assert first.train.search.share > 0 == second.train.search.share
    assert request.label == "tiny-video_root-data_root-cad_root-held_out-maskrcnn-shapenet-backgrounds-pixels"
    assert "trained on Freiburg cars after CAD models" in request.note


def test_nothing_but_the_default_is_written_where_the_default_goes(tmp_path, freiburg):
    run = tmp_path / "0123456789ab"
    run.mkdir()
    (run / "checkpoint.safetensors").write_bytes(b"weights")
    options = [
        {"profile": "smoke"}, {"video_root": freiburg}, {"data_root": freiburg}, {"split_rule": "45/2/rest"},
        {"masks": "alpha"}, {"start": "shapenet"}, {"start": str(run)}, {"start": "shapenet", "cad_root": freiburg},
        {"backgrounds": freiburg}, {"features": "pixels"}, {"recipe": "matting"},
    ]  # fmt: skip
    labels = [experiment("table4_freiburg", **option).label for option in options]
    assert len({"", *labels}) == len(options) + 1


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"split_rule": "half"}, "unknown split_rule 'half'"),
        ({"masks": "none"}, "unknown masks 'none'"),
        ({"video_root": "nowhere"}, "video_root nowhere: no such folder"),
        ({"start": "0123456789ab"}, "start 0123456789ab: no finished run"),
        ({"cad_root": "."}, "cad_root .*: nothing is trained"),
        ({"categories": "chair"}, "table4_freiburg 'categories'"),
        ({"splits": "."}, "table4_freiburg 'splits'"),
        ({"ridge": 3}, "table4_freiburg 'ridge'"),
        ({"features": "vgg99"}, "unknown network 'vgg99'"),
    ],
)
def test_bad_parameters_are_named(option, message):
    with pytest.raises(ViewnetError, match=message):
        experiment("table4_freiburg", **option)
    assert "video_root" in accepted("table4_freiburg") and "video_root" not in accepted("table3_pascal3d")


@pytest.mark.slow
def test_the_table_scores_photographs_beside_what_is_printed(fakes, freiburg, tmp_path):
    request = experiment("table4_freiburg", profile="smoke", video_root=freiburg, workers=1)
    runs = request.run(progress=False)
    table = request.table(runs)
    assert table.complete
    assert table.rows == (
        "Constant", "VGG view (pixels)", "VGG view, videos (pixels)",
        "ViewNet (photos)", "ViewNet + cycle (photos)", "VpDR-Net + FrC", "VpDR-Net (trained here)",
    )  # fmt: skip
    printed = {row: cell_of(table, row, "car", "acc30")["printed"] for row in table.rows}
    assert list(printed.values()) == ["", "56", "", "61", "59", "50", ""]
    assert cell_of(table, "VpDR-Net + FrC", "car", "median")["seeds"] == 0
    store = request.stores()["car"]
    said = as_kept(on_photographs(runs[0], store))  # as they are kept beside the table
    errors = align(said, "procrustes").selected_errors
    assert cell_of(table, "ViewNet (photos)", "car", "median")["measured"] == pytest.approx(np.median(errors))
    regression = table.provenance[cell_of(table, "VGG view, videos (pixels)", "car", "acc30")["runs"]]
    assert (regression["alignment"], regression["features"]) == ("procrustes", "pixels")
    assert regression["videos"] == video_views(request.regressed, 1, False).identity
    assert table.provenance[cell_of(table, "VGG view (pixels)", "car", "acc30")["runs"]]["alignment"] == "none"
    assert any("car: 18 views of 3 clips (3 train)" in line and "masks: files" in line for line in table.remarks)
    assert all(line in table.write(tmp_path / "out")[0].read_text() for line in ("VpDR-Net", "80 photographs"))


def test_the_video_regression_is_fitted_on_training_frames_only(fakes, freiburg):
    request = experiment("table4_freiburg", profile="smoke", video_root=freiburg, workers=1)
    assert request.regressed.masks == "none" and request.regressed.square is False
    store = request.stores()["car"]
    said, _ = request.fitted("video_regression", store)
    assert len(said.subset("val")) == len(said.subset("test")) == 40
    # Cars on level ground, and azimuths of 0 to 50 degrees only.
    assert np.allclose(said.hypotheses[..., 2], 0)
    held_out = experiment("table4_freiburg", profile="smoke", video_root=freiburg, split_rule="45/2/rest")
    fewer, _ = held_out.fitted("video_regression", store)
    assert not np.allclose(fewer.hypotheses, said.hypotheses)


@pytest.mark.slow
def test_what_starts_from_cad_models_trains_those_once_and_first(fakes, freiburg, folders, monkeypatch):
    monkeypatch.setattr("viewnet.model.checkpoint.identity", lambda start: Path(start).name)
    request = experiment("table4_freiburg", profile="smoke", video_root=freiburg, start="shapenet", seeds=2, workers=1)
    runs = request.run(progress=False)
    assert len(runs) == len(request.configs) == 4
    assert [run.config.variant for run in runs] == ["viewnet"] * 2 + ["viewnet_cycle"] * 2
    starts = [Path(run.config.train.start) for run in runs]
    assert starts[:2] == starts[2:] and len(set(starts)) == 2
    assert len(calls(folders)) == 6
    for run, begun in zip(runs, starts, strict=True):
        assert (begun / "checkpoint.safetensors").is_file() and begun != run.folder
        assert run.config.data.video is not None
    assert request.run(progress=False) == runs and len(calls(folders)) == 6
