from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from helpers.boxes import box_store
from helpers.untrained_models import finished_run
from PIL import Image

from viewnet import cli
from viewnet.estimator import ViewpointEstimator
from viewnet.geometry import azimuth_elevation


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return box_store(tmp_path_factory.mktemp("commands") / "views", {"val": 3, "test": 3}, views=3)


@pytest.fixture
def images(store, tmp_path, monkeypatch):
    """Two images with their masks, and a run called 0123456789ab."""
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    finished_run(tmp_path / "runs" / "viewnet" / "0123456789ab", store)
    for name, row in (("a", 10), ("b", 15)):
        Image.fromarray(store.images[row][..., :3]).save(tmp_path / f"{name}.png")
        Image.fromarray(store.images[row][..., 3]).save(tmp_path / f"{name}_mask.png")
    return [str(tmp_path / "a.png"), str(tmp_path / "b.png")]


def test_predict_prints_a_line_for_each_image(images, capsys):
    assert cli.main(["predict", *images, "--model", "0123456789ab"]) == 0
    lines = capsys.readouterr().out.splitlines()
    said = ViewpointEstimator.from_pretrained("0123456789ab").predict(images)
    assert lines[0].split() == ["azimuth", "elevation", "confidence"]
    for line, image, one in zip(lines[1:], images, said, strict=True):
        shares = f"{one.azimuth:.1f}", f"{one.elevation:.1f}", f"{100 * one.confidence:.0f}", "%"
        assert line.split() == [image, *shares]


def test_predict_prints_every_hypothesis_where_it_is_asked_to(images, capsys):
    assert cli.main(["predict", *images, "--all", "--model", "0123456789ab"]) == 0
    lines = capsys.readouterr().out.splitlines()[1:]
    said = ViewpointEstimator.from_pretrained("0123456789ab").predict(images)
    expected = []
    for image, one in zip(images, said, strict=True):
        order = np.argsort(-one.probabilities)
        azimuths, elevations = (v.numpy()[order] for v in azimuth_elevation(torch.from_numpy(one.hypotheses)))
        for name, *numbers in zip((image, "", ""), azimuths, elevations, one.probabilities[order], strict=True):
            shown = [f"{numbers[0]:.1f}", f"{numbers[1]:.1f}", f"{100 * numbers[2]:.0f}", "%"]
            expected.append([name, *shown] if name else shown)
    assert [line.split() for line in lines] == expected


def test_predict_as_json_has_every_hypothesis(images, tmp_path, capsys):
    masks = [image.replace(".png", "_mask.png") for image in images]
    assert cli.main(["predict", *images, "--masks", *masks, "--json", "--model", "0123456789ab"]) == 0
    found = json.loads(capsys.readouterr().out)
    estimator = ViewpointEstimator.from_pretrained("0123456789ab")
    said = estimator.predict(images, masks)
    assert found["frame"] == "annotated"
    assert [row["file"] for row in found["images"]] == images
    assert [row["azimuth"] for row in found["images"]] == said.azimuth.tolist()
    assert [row["probability_2"] for row in found["images"]] == said.probabilities[:, 2].tolist()
    boxed = estimator.predict(images, boxes=[(2, 3, 20, 30)] * 2)
    assert cli.main(["predict", *images, "--box", "2", "3", "20", "30", "--json", "--model", "0123456789ab"]) == 0
    again = json.loads(capsys.readouterr().out)["images"]
    assert [row["azimuth"] for row in again] == boxed.azimuth.tolist() != said.azimuth.tolist()


def test_a_model_without_alignment_is_reported(images, tmp_path, capsys):
    run = finished_run(tmp_path / "own", None)
    assert cli.main(["predict", images[0], "--model", str(run.folder)]) == 0
    assert "in the network's own frame" in capsys.readouterr().out
    assert cli.main(["predict", images[0], "--model", str(run.folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frame"] == "own"


def test_turntable_writes_an_animation(images, tmp_path, capsys):
    output, mask = tmp_path / "turn" / "a.gif", images[0].replace(".png", "_mask.png")
    arguments = ["--mask", mask, "-o", str(output), "--size", "64", "--steps", "3", "--model", "0123456789ab"]
    assert cli.main(["turntable", images[0], *arguments]) == 0
    assert capsys.readouterr().out == f"{output}\n"
    frames = ViewpointEstimator.from_pretrained("0123456789ab").turntable(images[0], mask=mask, size=64, steps=3)
    with Image.open(output) as back:
        assert back.n_frames == 3
        assert np.abs(np.asarray(back.convert("RGB")).astype(int) - frames[0]).mean() < 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["predict", "nowhere.png", "--model", "0123456789ab"], "nowhere.png: no such image"),
        (["predict", "nowhere.png", "--model", "ba9876543210"], "ba9876543210: no model there"),
        (["predict", "a", "b", "--masks", "c", "--model", "0123456789ab"], "masks: 1 for 2 images"),
        (["turntable", "a.png", "-o", "a.webm", "--model", "0123456789ab"], "a.webm: unknown kind of animation"),
    ],
)
def test_errors_of_predict_and_turntable(images, arguments, message, capsys):
    assert cli.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"viewnet: {message}")
    assert said.count("\n") == 1


@pytest.mark.parametrize("command", ["predict", "turntable"])
def test_help_has_examples(command, capsys):
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    said = capsys.readouterr().out
    assert f"examples:\n  viewnet {command} " in said
