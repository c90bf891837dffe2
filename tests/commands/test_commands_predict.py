from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from helpers.boxes import box_store
from helpers.untrained_models import finished_run
from PIL import Image

from viewnet import cli
from viewnet.estimator import ViewpointEstimator, preprocess
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
        doubt = ["or", "azimuth", f"{one.rival.azimuth:.1f}"] if one.rival else []
        assert line.split() == [image, *shares, *doubt]


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


def files(said: str) -> list[str]:
    """The images of printed lines, but for the heading."""
    return [line.split()[0] for line in said.splitlines()[1:]]


def test_images_that_fail_are_named_and_the_others_answered(images, tmp_path, capsys):
    (tmp_path / "broken.png").write_text("no image")
    given = [images[0], "nowhere.png", str(tmp_path / "broken.png"), images[1]]
    assert cli.main(["predict", *given, "--model", "0123456789ab"]) == 3
    said = capsys.readouterr()
    assert files(said.out) == images
    problems = said.err.splitlines()
    assert problems[0] == "viewnet: nowhere.png: no such image"
    assert problems[1].startswith(f"viewnet: {given[2]}: image does not decode")
    assert len(problems) == 2
    assert cli.main(["predict", *given, "--json", "--model", "0123456789ab"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert [row["file"] for row in found["images"]] == images
    assert found["failures"][0] == {"file": "nowhere.png", "error": "no such image"}
    assert cli.main(["predict", *given[1:3], "--model", "0123456789ab"]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.splitlines()) == ("", problems)


def test_predict_takes_folders_and_patterns(images, tmp_path, capsys):
    folder = tmp_path / "photos [1]"
    for name in ("c.PNG", "b.png", "d.jfif", "e.gif", ".hidden.png", "within/a.png"):
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_bytes((tmp_path / "a.png").read_bytes())
    (folder / "notes.txt").write_text("no image")
    (folder / "within" / "round").symlink_to(folder, target_is_directory=True)
    found = [str(folder / name) for name in ("b.png", "c.PNG", "d.jfif", "e.gif")]
    for word, expected in (
        (str(folder), found),
        (str(tmp_path / "[ab].*"), images),
        (str(tmp_path / "*" / "**" / "*.png"), [found[0], str(folder / "within" / "a.png")]),
        (found[0], found[:1]),  # a file's own name, whatever is in it
    ):
        assert cli.main(["predict", images[0], word, "--json", "--model", "0123456789ab"]) == 0
        read = json.loads(capsys.readouterr().out)["images"]
        assert [row["file"] for row in read] == [images[0], *expected]


@pytest.mark.parametrize("number", ["-1e-05", "-1.5E+1", "-.5", "-3.", "-20"])
@pytest.mark.parametrize("end", [[], ["a.png"]])
def test_a_box_has_numbers_of_any_form(images, number, end, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--box", number, "3", "20", "30", "--model", "0123456789ab", *(end or ["--json"])]
    assert cli.main(["predict", *([] if end else ["a.png"]), *words, *(["--json"] if end else [])]) == 0
    (found,) = json.loads(capsys.readouterr().out)["images"]
    expected = ViewpointEstimator.from_pretrained("0123456789ab").predict("a.png", boxes=[(float(number), 3, 20, 30)])
    assert found["azimuth"] == expected[0].azimuth


LIST = "image;x0;y0;x1;y1\r\nb.png;2,5;3;20;30\r\na.png;1;1;20;20\r\nb.png;4;5;30;31\r\n"
BOXES = [(2.5, 3, 20, 30), (1, 1, 20, 20), (4, 5, 30, 31)]


@pytest.mark.parametrize(
    ("given", "rows"), [([], [0, 1, 2]), (["a.png", "b.png", "c.png"], [1, 0, 2]), (["."], [1, 0, 2])]
)
def test_predict_takes_a_list_of_boxes(images, given, rows, tmp_path, capsys, monkeypatch):
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a", "b", *("c" * bool(given))):
        (folder / f"{name}.png").write_bytes((tmp_path / ("a.png" if name == "c" else f"{name}.png")).read_bytes())
    (folder / "boxes.csv").write_bytes(LIST.encode("utf-8-sig"))
    monkeypatch.chdir(folder)
    code = cli.main(["predict", *given, "--boxes", "boxes.csv", "--json", "--model", "0123456789ab"])
    said = capsys.readouterr()
    assert (code, said.err.count("\n")) == ((3, 1) if given else (0, 0))
    assert not given or said.err.endswith("c.png: no box in boxes.csv\n")
    found, names = json.loads(said.out)["images"], ["b.png", "a.png", "b.png"]
    assert [row["file"].removeprefix("./") for row in found] == [names[row] for row in rows]
    estimator = ViewpointEstimator.from_pretrained("0123456789ab")
    expected = estimator.predict([names[row] for row in rows], boxes=[BOXES[row] for row in rows])
    assert [row["azimuth"] for row in found] == expected.azimuth.tolist()


def test_predict_reads_the_standard_input(images, monkeypatch, capsys):
    for content, code in ((Path(images[0]).read_bytes(), 0), (b"no image", 3)):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(content)))
        assert cli.main(["predict", "-", images[0], "--json", "--model", "0123456789ab"]) == code
        said = capsys.readouterr()
        found = json.loads(said.out)["images"]
        assert [row["file"] for row in found] == ["-", images[0]][code // 3 :]
        assert said.err.startswith("viewnet: -: image does not decode" if code else "")
        assert found[0]["azimuth"] == found[-1]["azimuth"]


def test_the_standard_input_is_one_image(images, capsys):
    assert cli.main(["predict", "-", images[0], "-", "--model", "car"]) == 2
    assert capsys.readouterr().err == "viewnet: -: standard input holds one image: name it once\n"


@pytest.mark.parametrize("kind", ["csv", "parquet", "json"])
def test_predict_writes_a_table(images, kind, tmp_path, capsys):
    output = tmp_path / "new" / f"viewpoints.{kind}"
    asked = ["predict", *images, "nowhere.png", "--as", "euler", "--model", "0123456789ab"]
    assert cli.main([*asked, "--out", str(output)]) == 3
    assert capsys.readouterr().out == f"{output}\n"
    assert cli.main([*asked, "--json"]) == 3
    expected = json.loads(capsys.readouterr().out)
    if kind == "json":
        assert json.loads(output.read_text()) == expected
    else:
        table = pd.read_csv(output) if kind == "csv" else pd.read_parquet(output)
        assert table["file"].tolist() == images
        assert np.allclose(table["ry_2"], [row["ry_2"] for row in expected["images"]])
    output.write_text("earlier")
    assert cli.main(["predict", "nowhere.png", "--model", "0123456789ab", "--out", str(output)]) == 2
    assert output.read_text() == "earlier"
    assert [path.name for path in output.parent.iterdir()] == [output.name]


@pytest.mark.parametrize(("terminal", "count"), [(True, 2), (True, 1), (False, 2)])
def test_a_bar_is_shown_on_terminals(images, terminal, count, monkeypatch, capsys):
    shown, bar = [], preprocess.bar
    monkeypatch.setattr(preprocess, "bar", lambda show, **settings: (shown.append(show), bar(False, **settings))[1])
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    assert cli.main(["predict", *images[:count], "--model", "0123456789ab"]) == 0
    assert shown == [terminal and count == 2]
    assert files(capsys.readouterr().out) == images[:count]


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
        (["predict", "--model", "0123456789ab"], "predict: no images: name some, a folder"),
        (["predict", "a/*.png", "--model", "0123456789ab"], "a/*.png: no images there: expected files that end"),
        (["predict", "empty", "--model", "0123456789ab"], "empty: no images there: expected files that end in .jpg"),
        (["predict", "a", "--boxes", "b.csv", "--model", "0123456789ab"], "b.csv: no such file"),
        (["predict", "a", "--boxes", "wrong.csv", "--model", "0123456789ab"], "wrong.csv: line 3: box ['4', '5', '6',"),
        (["predict", "a", "--boxes", "other.csv", "--model", "0123456789ab"], "other.csv: has no box of any of the"),
        (["predict", "a", "-o", "a.txt", "--model", "0123456789ab"], "a.txt: unknown kind of table: name it .csv or"),
        (["predict", "a", "-o", "empty.csv", "--model", "0123456789ab"], "empty.csv: is a folder: name a file"),
        (
            ["predict", "a", "--boxes", "nameless.csv", "--model", "car"],
            "nameless.csv: line 3: image '': expected a file",
        ),
        (["predict", "--boxes", "dash.csv", "--model", "car"], "dash.csv: line 2: image '-': expected a file"),
        (["turntable", "a.png", "-o", "a.gif", "--model", "other.csv"], "PLACE/other.csv: not a whole checkpoint ("),
        (["predict", "a", "-o", "wrong.csv/a.csv", "--model", "0123456789ab"], "wrong.csv/a.csv: cannot be written"),
        (
            ["predict", "a", "--box", "-inf", "0", "9", "9", "--model", "0123456789ab"],
            "box [-inf, 0.0, 9.0, 9.0]: expected",
        ),
        (
            ["predict", "https://a.b/c.jpg?d=1", "--model", "car"],
            "https://a.b/c.jpg?d=1: no such image: expected a file, not an",
        ),
        (
            ["turntable", "https://a.b/c.jpg", "-o", "a.gif", "--model", "car"],
            "https:/a.b/c.jpg: no such image: expected",
        ),
        (["turntable", "empty", "-o", "a.gif", "--model", "0123456789ab"], "empty: image is a folder: expected a file"),
        (
            ["turntable", "a.png", "--mask", "empty", "-o", "a.gif", "--model", "car"],
            "a.png: mask empty is a folder: exp",
        ),
        (["turntable", "a.png", "-o", "a.webm", "--model", "0123456789ab"], "a.webm: unknown kind of animation"),
    ],
)
def test_errors_of_predict_and_turntable(images, arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty.csv").mkdir()
    (tmp_path / "nameless.csv").write_text("image,x0,y0,x1,y1\na,1,2,3,4\n,1,2,3,4\n")
    (tmp_path / "dash.csv").write_text("image,x0,y0,x1,y1\n-,1,2,3,4\n")
    (tmp_path / "other.csv").write_text("image,x0,y0,x1,y1\nb,1,2,3,4\n")
    (tmp_path / "wrong.csv").write_text("image,x0,y0,x1,y1\na,1,2,3,4\na,4,5,6,\n")
    assert cli.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"viewnet: {message}".replace("PLACE", str(tmp_path)))
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
