"""The catalogue of data sets, and the check of a copy."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from helpers.pascal3d_files import listed, thing, viewpoint
from helpers.pascal3d_files import write as annotate
from PIL import Image

from viewnet import cli
from viewnet.config import SYNSETS
from viewnet.data import catalogue
from viewnet.data.catalogue import DATA_SETS, check, recognise
from viewnet.data.readers.registry import READERS
from viewnet.data.synthetic.objectron_standin import ObjectronStandIn
from viewnet.errors import ViewnetError


def image(path, size=(40, 30)):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.zeros((size[1], size[0], 3), np.uint8)).save(path)


def models(root, category, count, missing=0):
    for number in range(count + missing):
        folder = root / SYNSETS[category] / f"{number:03d}"
        folder.mkdir(parents=True)
        if number < count:
            (folder / "model.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")


def cars(root, sequences=2, frames=3):
    (root / "annotations").mkdir(parents=True)
    for number in range(1, sequences + 1):
        names = [f"car{number:03d}/{frame:04d}.png" for frame in range(frames)]
        for name in names:
            image(root / name)
        lines = "".join(f"{name} 2 2 30 25 {40 * i}\n" for i, name in enumerate(names))
        (root / "annotations" / f"{number}_annot.txt").write_text(lines)


def photographs(root, splits=("val", "test")):
    for number, split in enumerate(splits):
        image(root / "images" / f"{split}.png", (40, 30 + number))
    rows = [{"file": f"{split}.png", "azimuth_deg": 10, "elevation_deg": 5, "split": split} for split in splits]
    rows.append(rows[0] | {"file": "lost.png"})
    pd.DataFrame(rows).to_csv(root / "viewpoints.csv", index=False)


def test_cad_models_are_counted_by_category_and_split(tmp_path):
    models(tmp_path, "car", 20, missing=2)
    models(tmp_path, "chair", 10)
    found = check(tmp_path)
    assert found.key == "shapenet"
    assert set(found.counts) == {"car", "chair"}
    assert sum(found.counts["car"].values()) == 20
    assert all(kind.startswith("v1 models to ") for kind in found.counts["car"])
    assert found.problems == ["car: 2 left out: no such file: 020 and 1 more"]
    (tmp_path / f"{SYNSETS['boat']}.zip").touch()
    assert any(f"{SYNSETS['boat']}.zip is: unpack it" in problem for problem in check(tmp_path).problems)


def test_pascal3d_is_counted_and_a_missing_list_told(tmp_path):
    annotate(tmp_path, "a", thing(viewpoint=viewpoint()), thing(viewpoint=viewpoint(distance=0.0)))
    listed(tmp_path, "a", "gone")
    found = check(tmp_path)
    assert found.key == "pascal3d"
    assert list(found.counts) == ["car"]
    assert sum(found.counts["car"].values()) == 1
    assert any("car: 1 left out: " in problem for problem in found.problems)
    assert any("no such list" in problem for problem in found.problems)


def test_freiburg_and_lists_and_images(tmp_path):
    cars(tmp_path / "freiburg")
    (tmp_path / "freiburg" / "annotations" / "9_annot.txt").write_text("")
    found = check(tmp_path / "freiburg")
    assert (found.key, found.counts) == ("freiburg", {"car": {"sequences": 2, "frames": 6}})
    assert found.problems == ["car: 1 left out: no frames of the sequence: car009"]
    photographs(tmp_path / "mine")
    found = check(tmp_path / "mine")
    assert (found.key, found.counts) == ("photographs", {"": {"objects to calibrate": 1, "objects to score": 1}})
    assert found.problems == ["1 left out: no such image: lost.png"]
    photographs(tmp_path / "half", ("val",))
    assert "viewpoints.csv: no row of split test" in check(tmp_path / "half").problems
    for name in ("a/abbey/1.jpg", "a/abbey/2.jpg", "b/bar/3.jpg"):
        image(tmp_path / "sun" / name)
    assert check(tmp_path / "sun").counts == {"": {"images": 3, "classes": 1}}
    (tmp_path / "sun" / "ClassName.txt").write_text("/a/abbey\n/b/bar\n/c/cave\n")
    found = check(tmp_path / "sun")
    assert (found.counts, found.problems) == (
        {"": {"images": 3, "classes": 2}}, ["1 left out: no such class folder: /c/cave"]
    )  # fmt: skip


def test_objectron_is_counted(tmp_path):
    ObjectronStandIn("chair", videos=3, frames=4, size=(48, 64)).write(tmp_path / "o")
    found = check(tmp_path / "o")
    assert found.key == "objectron"
    counts = found.counts["chair"]
    assert sum(count for kind, count in counts.items() if kind.startswith("videos to ")) == 3
    assert counts["videos with masks"] == 3
    assert 0 < counts["frames"] <= 12
    for record in (tmp_path / "o" / "annotations").rglob("*.pbdata"):
        record.write_bytes(b"damaged")
    found = check(tmp_path / "o")
    assert not found.counts
    assert "no usable video of chair" in found.problems[0]


def test_what_is_nothing_is_told_and_what_lies_deeper_named(tmp_path):
    with pytest.raises(ViewnetError, match="nowhere: no such folder"):
        recognise(tmp_path / "nowhere")
    with pytest.raises(ViewnetError, match="none of the layouts"):
        recognise(tmp_path)
    cars(tmp_path / "freiburg_static_cars_52_v1.1")
    with pytest.raises(ViewnetError, match=r"freiburg_static_cars_52_v1.1/ in it"):
        recognise(tmp_path)


def test_the_command_tells_all_there_is(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setenv("VIEWNET_VGG16_WEIGHTS", str(tmp_path / "mine.pth"))
    monkeypatch.delenv("VIEWNET_SQUEEZENET_WEIGHTS", raising=False)
    (tmp_path / "mine.pth").touch()
    assert cli.main(["data"]) == 0
    text = capsys.readouterr().out
    for key, data in DATA_SETS.items():
        assert f"{key}: {data['title']}" in text and data["source"] in text and data["terms"] in text
    assert f"vgg16: there: {tmp_path / 'mine.pth'}" in text
    assert f"squeezenet1_1: missing: {tmp_path}" in text
    assert cli.main(["data", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [d["key"] for d in told["data sets"]] == list(DATA_SETS)
    assert list(DATA_SETS) == list(READERS)
    assert {w["network"]: w["there"] for w in told["weights"]}["vgg16"] is True
    assert {w["network"] for w in told["weights"]} == set(catalogue.NETWORKS)


def test_the_command_checks_a_folder(capsys, tmp_path):
    cars(tmp_path / "cars")
    assert cli.main(["data", "check", str(tmp_path / "cars")]) == 0
    assert capsys.readouterr().out == (
        f"{tmp_path / 'cars'}: Freiburg static cars 52, release 1.1\n  car: 2 sequences, 6 frames\n"
        "  car: 2 of 2 sequences opened, each up to its second usable frame: --deep opens all\n"
    )
    assert cli.main(["data", "check", str(tmp_path / "cars"), "--json", "--deep"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {
        "key": "freiburg", "folder": str(tmp_path / "cars"), "counts": {"car": {"sequences": 2, "frames": 6}},
        "problems": [], "notes": [],
    }  # fmt: skip
    assert cli.main(["data", "check"]) == 2
    assert "name the folder to check" in capsys.readouterr().err
    (tmp_path / "empty" / "Annotations").mkdir(parents=True)
    assert cli.main(["data", "check", str(tmp_path / "empty")]) == 2
    shown = capsys.readouterr()
    assert "problem: " in shown.out and "nothing in it can be used" in shown.err
