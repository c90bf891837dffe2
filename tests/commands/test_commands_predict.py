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


NAMES = {
    "matrix": ["r00", "r01", "r02", "r10", "r11", "r12", "r20", "r21", "r22"],
    "quaternion": ["qw", "qx", "qy", "qz"],
    "euler": ["rx", "ry", "rz"],
}


@pytest.mark.parametrize("form", NAMES)
@pytest.mark.parametrize("frame", ["opencv", "opengl", "pytorch3d", "blender"])
def test_predict_prints_rotations_where_it_is_asked_to(images, form, frame, capsys):
    asked = ["predict", *images, "--all", "--model", "0123456789ab"]
    assert cli.main(asked) == 0
    plain = capsys.readouterr().out.splitlines()
    assert cli.main([*asked, "--as", form, "--frame", frame]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert last.startswith("rotation: camera x ")
    # What was there is there as it was; beside it are the numbers.
    rests = [line.removeprefix(before) for line, before in zip(lines, plain, strict=True)]
    assert rests[0].split() == NAMES[form]
    said = ViewpointEstimator.from_pretrained("0123456789ab").predict(images)
    expected = [each.rotation(frame, form).ravel() for one in said for each in one.ranked()]
    places = 0.06 if form == "euler" else 0.00006
    assert np.allclose([[float(word) for word in rest.split()] for rest in rests[1:]], expected, rtol=0, atol=places)


@pytest.mark.parametrize("form", NAMES)
def test_predict_as_json_has_rotations_where_it_is_asked_to(images, form, capsys):
    asked = ["predict", *images, "--json", "--model", "0123456789ab"]
    assert cli.main(asked) == 0
    plain = json.loads(capsys.readouterr().out)
    assert cli.main([*asked, "--as", form, "--frame", "blender"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found.pop("camera_frame") == "blender"
    said = ViewpointEstimator.from_pretrained("0123456789ab").predict(images)
    numbers = [[row.pop(name) for name in NAMES[form]] for row in found["images"]]
    assert np.allclose(numbers, said.rotation("blender", form).reshape(2, -1), atol=1e-9)
    for row, one in zip(found["images"], said, strict=True):
        hypotheses = [[row.pop(f"{name}_{m}") for name in NAMES[form]] for m in range(3)]
        ranked = [each.rotation("blender", form).ravel() for each in one.ranked()]
        assert np.allclose(sorted(hypotheses), sorted(each.tolist() for each in ranked), atol=1e-9)
    assert found == plain


def test_rotations_are_opencv_s_without_a_frame(images, capsys):
    asked = ["predict", *images, "--as", "matrix", "--model", "0123456789ab"]
    for more in ([], ["--json"]):
        assert cli.main([*asked, *more]) == 0
        default = capsys.readouterr().out
        assert cli.main([*asked, *more, "--frame", "opencv"]) == 0
        assert capsys.readouterr().out == default


def test_a_model_without_alignment_is_reported(images, tmp_path, capsys):
    run = finished_run(tmp_path / "own", None)
    assert cli.main(["predict", images[0], "--model", str(run.folder)]) == 0
    assert "in the network's own frame" in capsys.readouterr().out
    assert cli.main(["predict", images[0], "--model", str(run.folder), "--as", "euler", "--frame", "blender"]) == 0
    assert "in the network's own frame" in capsys.readouterr().out.splitlines()[-1]
    for more in ([], ["--as", "matrix"]):
        assert cli.main(["predict", images[0], "--model", str(run.folder), "--json", *more]) == 0
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
        (["predict", "a", "--frame", "opengl", "--model", "0123456789ab"], "--frame opengl: add --as"),
        (["turntable", "a.png", "-o", "a.webm", "--model", "0123456789ab"], "a.webm: unknown kind of animation"),
    ],
)
def test_errors_of_predict_and_turntable(images, arguments, message, capsys):
    assert cli.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"viewnet: {message}")
    assert said.count("\n") == 1


@pytest.mark.parametrize("words", [["--as", "rodrigues"], ["--as", "matrix", "--frame", "OpenCV"]])
def test_predict_names_the_forms_and_frames_that_there_are(words, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["predict", "a.png", *words, "--model", "car"])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "quaternion" in said or "pytorch3d" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("command", ["predict", "turntable"])
def test_help_has_examples(command, capsys):
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    said = capsys.readouterr().out
    assert f"examples:\n  viewnet {command} " in said
