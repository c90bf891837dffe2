"""viewnet evaluate: a run and the model saved from it have equal scores; alignment never uses scored images."""

from __future__ import annotations

import io
import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from helpers.boxes import box_store
from helpers.evaluation_data import make_index
from helpers.fake_steps import STEPS
from helpers.photo_data import write_crops
from helpers.untrained_models import finished_run
from PIL import Image
from scipy.spatial.transform import Rotation

from viewnet import cli
from viewnet.data.readers import photo_folder
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.estimator.model_card import with_interval
from viewnet.evaluation import evaluate, metrics
from viewnet.evaluation.confidence import calibration_error
from viewnet.evaluation.predictions import Predictions, true_vectors
from viewnet.evaluation.run import NOT_SCORED
from viewnet.experiments import calibrated, score_model
from viewnet.experiments.score_model import ScoredData, scores
from viewnet.geometry import view_vector
from viewnet.recipes import make_config
from viewnet.runs import make_run, other_views, run_store

KEY = "0123456789ab"


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return box_store(tmp_path_factory.mktemp("scores") / "views", {"val": 4, "test": 4}, views=3)


@pytest.fixture
def run(store, tmp_path, monkeypatch):
    """A finished run in a run store of its own."""
    for name in ("RUNS", "DATA"):
        monkeypatch.setenv(f"VIEWNET_{name}", str(tmp_path / name.lower()))
    return finished_run(tmp_path / "runs" / "viewnet" / KEY, store)


def steps_of(store):
    return replace(make_run.default_steps(), views=lambda config, **_: store)


def close(one, other) -> bool:
    """Whether two scores are equal up to rounding."""
    return all(one[name] == pytest.approx(other[name], abs=1e-3) for name in ("acc30", "median", "dva", "flips"))


def test_a_run_s_own_test_views_are_scored_by_each_alignment(run):
    said = Predictions.from_parquet(run.folder / "predictions.parquet")
    for where in (KEY, str(run.folder)):
        found = scores(where)
        assert found["on"] == "its own test views"
        assert found["alignments"] == {
            kind: evaluate.evaluate(said, kind) for kind in ("procrustes", "robust", "linear")
        }
    assert scores(KEY, calibration=6)["alignments"]["procrustes"]["alignment"]["images"] == 6


def test_a_saved_model_scores_as_the_run_it_is_of(run, store, tmp_path):
    ViewpointEstimator.from_pretrained(KEY, device="cpu").save_pretrained(tmp_path / "saved")
    found = scores(str(tmp_path / "saved"), steps=steps_of(store))
    for kind, score in scores(KEY)["alignments"].items():
        assert close(found["alignments"][kind], score), kind
    assert sorted(path.name for path in (tmp_path / "saved").iterdir()) == [
        "README.md",
        "config.json",
        "model.safetensors",
    ]


def test_a_saved_model_is_not_scored_on_views_it_may_have_seen(run, tmp_path):
    ViewpointEstimator.from_pretrained(KEY, device="cpu").save_pretrained(tmp_path / "saved")
    other = box_store(tmp_path / "other", {"val": 4, "test": 4}, views=3, seed=1)
    with pytest.raises(ViewnetError, match="not those it was trained with"):
        scores(str(tmp_path / "saved"), steps=steps_of(other))


def photographs(folder: Path, store, turn: float) -> Path:
    """Views as photographs with a list, the azimuths of those that are scored turned."""
    (folder / "images").mkdir(parents=True)
    lines = ["file,azimuth_deg,elevation_deg,split"]
    for number, row in enumerate(store.index.itertuples()):
        Image.fromarray(np.asarray(store.images[number][..., :3])).save(folder / "images" / f"{number}.png")
        azimuth = (row.azimuth + (turn if row.split == "test" else 0)) % 360
        lines.append(f"{number}.png,{azimuth:.3f},{row.elevation:.3f},{row.split}")
    (folder / "viewpoints.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_labels_of_what_is_scored_have_no_part_in_the_alignment(run, store, tmp_path, monkeypatch):
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 32)
    as_it_is = scores(KEY, ScoredData(str(photographs(tmp_path / "photos", store, 0))))
    turned = scores(KEY, ScoredData(str(photographs(tmp_path / "turned", store, 77))))
    assert as_it_is["on"] == "photographs of photos"
    assert list(as_it_is["alignments"]) == ["own", "procrustes", "robust", "linear"]
    assert as_it_is["alignments"].pop("own")["alignment"]["kind"] == "none"
    for kind, score in as_it_is["alignments"].items():
        assert turned["alignments"][kind]["alignment"] == score["alignment"]
        assert turned["alignments"][kind]["median"] != score["median"]


def test_photographs_that_are_all_scored_are_scored_by_the_own_rotation_alone(run, store, tmp_path, monkeypatch):
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 32)
    place = photographs(tmp_path / "photos", store, 0)
    both = scores(KEY, ScoredData(str(place)))
    rows = (place / "viewpoints.csv").read_text().splitlines()
    (place / "viewpoints.csv").write_text("\n".join(row for row in rows if not row.endswith(",val")))
    found = scores(KEY, ScoredData(str(place)))
    assert list(found["alignments"]) == [found["choose"]] == ["own"]
    assert found["alignments"]["own"]["alignment"]["images"] == 0
    assert found["alignments"]["own"]["acc30"] == both["alignments"]["own"]["acc30"]
    assert "12 of 12 objects; none to calibrate on" in score_model.as_text(found)


def test_what_looks_alike_counts_as_right(run, store, tmp_path, monkeypatch):
    """Scores of a table from its other side, and how sure a network is that does not tell the two apart."""
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 32)
    found = scores(KEY, ScoredData(str(photographs(tmp_path / "photos", store, 0))))
    assert "up to symmetry" not in score_model.as_text(found)
    index = make_index(60, 4, category="diningtable")
    truth = true_vectors(index)
    both = np.stack([truth, truth * [-1, -1, 1]], axis=1)  # (N, 2, 3)
    logits = np.where(np.arange(len(index))[:, None] % 2, [0.0, 0.1], [0.1, 0.0])
    said = Predictions(index, both, logits)
    aligned = evaluate.align(said, "half_turns")
    sure, right = calibrated.answers(aligned)
    assert right.all() and sure == pytest.approx(1)
    table = evaluate.evaluate(said, "half_turns")
    assert table["acc30"] == pytest.approx(50, abs=3)
    first = found["alignments"]["own"]
    lines = score_model.as_text(found | {"alignments": {"own": table | {"support": first["support"]}}}).splitlines()
    assert ["own", "up", "to", "symmetry", "100.0", "[100.0,", "100.0]"] in [line.split()[:7] for line in lines]


@pytest.mark.parametrize(("turn", "images", "chosen"), [(0, 200, "own"), (90, 200, "procrustes"), (90, 5, "own")])
def test_the_alignment_is_chosen_that_calibration_images_support(turn, images, chosen):
    # Two of five are half a turn off, so that five images determine little; the own rotation is wrong by `turn`.
    index = make_index(models=800, views=1, splits=(("val", 0.5), ("test", 0.5)))
    vectors = true_vectors(index) @ Rotation.from_euler("z", turn, degrees=True).as_matrix()  # (N, 3)
    vectors[::5, :2] *= -1
    vectors[1::5, :2] *= -1
    said = Predictions(index, vectors[:, None], np.zeros((len(index), 1)))
    by_kind = {"own": (said, "none"), "procrustes": (said, "procrustes")}
    found = {name: evaluate.evaluate(said, kind, images, draws=2) for name, (said, kind) in by_kind.items()}
    assert score_model.choice(found, by_kind, images) == chosen


def test_crops_with_a_list_are_scored(run, tmp_path, monkeypatch):
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 32)
    write_crops(tmp_path / "bench", [(9.0 * number, number) for number in range(40)], "car")
    found = scores(KEY, ScoredData(str(tmp_path / "bench")))
    assert found["on"] == "photographs of bench"
    assert found["alignments"]["procrustes"]["images"] == 32
    assert found["alignments"]["procrustes"]["alignment"]["images"] == 8


def test_photographs_are_scored_by_the_rotation_of_the_estimator_s_answers(run, store, tmp_path, monkeypatch):
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 32)
    monkeypatch.setattr(score_model, "choice", lambda found, *_: list(found)[-1])  # whatever is chosen
    place = photographs(tmp_path / "photos", store, 0)
    both = scores(KEY, ScoredData(str(place)))
    found = both["alignments"]["own"]
    listed = pd.read_csv(place / "viewpoints.csv")
    listed = listed[listed["split"] == "test"]
    said = ViewpointEstimator.from_pretrained(KEY, device="cpu").predict([place / "images" / f for f in listed["file"]])
    truth = view_vector(*(torch.tensor(listed[name].to_numpy()) for name in ("azimuth_deg", "elevation_deg")))
    errors = metrics.vector_error(np.stack([one.vector for one in said]), truth.numpy())
    assert found["audit"]["vector"]["median"] == pytest.approx(np.median(errors), abs=0.5)
    assert both["choose"] != "own"
    sure = np.array([one.confidence for one in said])
    right = metrics.geodesic_error(np.stack([one.vector for one in said]), truth.numpy()) < 30
    about = {"mean": 100 * sure.mean(), "error": calibration_error(sure, right)}
    assert both["confidence"] == pytest.approx(about, abs=0.5)


def test_the_card_of_a_saved_model_tells_scores_on_photographs(run, store, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 32)
    place = photographs(tmp_path / "photos", store, 0)
    assert cli.main(["evaluate", KEY, "--data-root", str(place), "--json"]) == 0
    (tmp_path / "scores.json").write_text(said := capsys.readouterr().out)
    command = ["save", KEY, str(tmp_path / "saved"), "--half", "--license", "cc0-1.0"]
    assert cli.main([*command, "--scores", str(tmp_path / "scores.json")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'saved'}\n"
    card = (tmp_path / "saved" / "README.md").read_text()
    (found,) = json.loads(said)
    assert "| | own | procrustes | robust | linear |\n" in card
    median = " | ".join(with_interval(found["alignments"][kind], "median") for kind in ("own", *score_model.LEARNED))
    assert f"| median error, degrees | {median} |\n" in card
    assert "On photographs of photos: 12 images of 12 objects. A column for each alignment" in card
    assert "| licence of the weights | cc0-1.0 |" in card
    (kept,) = ViewpointEstimator.from_pretrained(tmp_path / "saved").about["scores"]
    assert kept["alignments"]["robust"]["intervals"] == found["alignments"]["robust"]["intervals"]
    # Scores name their run, also after saving.
    again = scores(str(tmp_path / "saved"), ScoredData(str(place)))
    assert again["key"] == KEY
    assert close(again["alignments"]["procrustes"], found["alignments"]["procrustes"])


SCORE = {"images": 1, "objects": 1, "acc30": 1.0, "median": 1.0, "dva": 1.0, "flips": 0.0, "intervals": {}}
SCORE |= {"oracle": {"acc30": 1.0}, "alignment": {"kind": "none", "images": 1, "objects": 1}}
OTHERS = json.dumps({"key": "ba9876543210", "on": "photographs", "alignments": {"own": SCORE}})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (OTHERS, "are of the run ba9876543210"),
        ('{"key": "0123456789ab", "on": "photographs"}', "scores: expected the output"),
        ('{"key": "0123456789ab", "on": "photographs", "alignments": {}}', "scores: expected the output"),
        ("[3]", "scores: expected the output"),
        ("{", "not JSON"),
    ],
)
def test_a_card_takes_no_other_scores(run, tmp_path, capsys, given, message):
    (tmp_path / "scores.json").write_text(given)
    assert cli.main(["save", KEY, str(tmp_path / "saved"), "--scores", str(tmp_path / "scores.json")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "saved").exists()


def test_another_collection_is_scored_whole_and_aligned_on_own_views(tmp_path, monkeypatch):
    for name in ("RUNS", "DATA"):
        monkeypatch.setenv(f"VIEWNET_{name}", str(tmp_path / name.lower()))
    (run,) = run_store.ensure([make_config(profile="smoke")], workers=1, progress=False, steps=STEPS)
    (tmp_path / "cad" / "02958343").mkdir(parents=True)
    found = scores(run.key, ScoredData(str(tmp_path / "cad")), steps=STEPS)
    other = STEPS.views(make_config(profile="smoke", data_root=str(tmp_path / "cad")).data)
    for score in found["alignments"].values():
        assert score["images"] == len(other.index)
        assert score["alignment"]["images"] == len(run.predictions.subset("val"))
    assert found["alignments"]["procrustes"] == evaluate.evaluate(other_views.transferred(run, other, STEPS))


@pytest.mark.parametrize(
    ("where", "on", "message"),
    [
        ("nowhere", ScoredData(), "nowhere: no model there"),
        (KEY, ScoredData("nowhere"), "data_root nowhere: no such folder"),
        (KEY, ScoredData(subset="imagenet10"), "unknown subset 'imagenet10'"),
        (KEY, ScoredData(cad_root="nowhere"), "cad_root nowhere: no such folder"),
    ],
)
def test_what_cannot_be_scored_is_said(run, where, on, message):
    with pytest.raises(ViewnetError) as error:
        scores(where, on)
    assert str(error.value).startswith(message)


def test_folders_without_viewpoints_are_not_scored_on(run, tmp_path):
    (tmp_path / "pictures").mkdir()
    Image.new("RGB", (8, 8)).save(tmp_path / "pictures" / "a.jpg")
    with pytest.raises(ViewnetError, match="is backgrounds, whose viewpoints"):
        scores(KEY, ScoredData(str(tmp_path / "pictures")))


def test_a_run_without_scores_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    finished_run(tmp_path / "own", None)
    with pytest.raises(ViewnetError, match=NOT_SCORED):
        scores(str(tmp_path / "own"))


def test_the_command_prints_a_line_an_alignment(run, capsys):
    assert cli.main(["evaluate", KEY]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{run.name}: {KEY}"
    assert lines[1].startswith("  its own test views: 12 of 4 objects; aligned on 12 of 4; ")
    assert [line.split()[0] for line in lines[2:]] == ["aligned", "procrustes", "robust", "linear", "confidence"]
    score = scores(KEY)["alignments"]["procrustes"]
    low, high = score["intervals"]["acc30"]
    assert f"{score['acc30']:.1f} [{low:.1f}, {high:.1f}]" in lines[3]
    assert cli.main(["evaluate", KEY, str(run.folder), "--calibration", "6", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [one["model"] for one in told] == [KEY, str(run.folder)]
    assert told[0]["alignments"]["linear"]["alignment"]["images"] == 6
    assert "flips" in told[0]["alignments"]["robust"]


def test_photographs_of_another_category_are_told_in_one_line_and_scored(run, store, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 32)
    for name, said in (("cars", 0), ("chairs", 1)):
        caught = logging.StreamHandler(io.StringIO())
        monkeypatch.setattr(photo_folder.log, "handlers", [caught])
        assert cli.main(["evaluate", KEY, "--data-root", str(photographs(tmp_path / name, store, 0))]) == 0
        assert f"photographs of {name}: 12 of 12" in capsys.readouterr().out
        assert caught.stream.getvalue().count("\n") == said
    assert "chairs: 24 of 24 photographs are not of car by list or names (24 chair)" in caught.stream.getvalue()


def test_constants_are_scored_as_they_are(tmp_path, monkeypatch):
    for name in ("RUNS", "DATA"):
        monkeypatch.setenv(f"VIEWNET_{name}", str(tmp_path / name.lower()))
    (run,) = run_store.ensure(
        [run_store.untrained("constant", make_config(profile="smoke"))], workers=1, progress=False, steps=STEPS
    )
    found = scores(run.key)
    assert list(found["alignments"]) == ["none", "procrustes"]
    assert found["alignments"]["none"] == run.result["metrics"]["none"]
