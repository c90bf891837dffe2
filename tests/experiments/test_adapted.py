"""An adapted model: which photographs count, what is written, and when nothing is."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from helpers.estimators import photograph, untrained
from PIL import Image

from viewnet.cli import main
from viewnet.data.backgrounds import Backgrounds
from viewnet.estimator import pretrained
from viewnet.training import adapt as adapting


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)
    few = Backgrounds(np.zeros((2, 3, 64, 64), np.uint8), "black")
    monkeypatch.setattr("viewnet.data.augment.load_backgrounds", lambda *_, **__: few)
    monkeypatch.setattr(adapting, "STEPS", 2)
    untrained(recipe="photos").save_pretrained(tmp_path / "model")
    (tmp_path / "photos").mkdir()
    for number in range(52):
        Image.fromarray(photograph(seed=number)).save(tmp_path / "photos" / f"{number:02}.png")


def adapt(*more: str) -> int:
    return main(["adapt", "photos", "--model", "model", "-o", "adapted", *more])


def forced(monkeypatch, kept: bool) -> None:
    monkeypatch.setattr(adapting.Adaptation, "kept", property(lambda _: kept))


@pytest.mark.slow
def test_the_folder_is_a_model_that_says_how_it_was_adapted(tmp_path, monkeypatch, capsys):
    forced(monkeypatch, True)
    (tmp_path / "photos" / "broken.jpg").write_bytes(b"no image")
    Image.fromarray(photograph(30, 20)).save(tmp_path / "photos" / "tiny.png")
    assert adapt("--half") == 0
    out, err = capsys.readouterr()
    assert out.startswith("adapted\n  learned from 41 photographs, 11 held out\n")
    assert "viewnet: photos/broken.jpg: " in err
    assert "tiny.png: the object is 30 x 20 pixels: too small to learn from, needs 32 along one side" in err
    before, after = pretrained.load("model"), pretrained.load("adapted")
    assert after.about["adapted"]["photographs"] == 41
    assert "| adapted | to 41 photographs without labels;" in (tmp_path / "adapted" / "README.md").read_text()
    old, new = before.network.state_dict(), after.network.state_dict()
    changed = {name.split(".")[0] for name in old if not torch.allclose(old[name], new[name], atol=1e-3)}
    assert changed == {"viewpoint"}
    assert json.loads((tmp_path / "adapted" / "config.json").read_text())["about"]["metrics"]


@pytest.mark.slow
def test_what_does_not_help_is_not_written(tmp_path, monkeypatch, capsys):
    forced(monkeypatch, False)
    assert adapt() == 1
    assert capsys.readouterr().out.startswith("not written: it does not help\n  learned from 41")
    assert not (tmp_path / "adapted").exists()


def test_too_few_usable_photographs_are_refused_before_anything_is_made(tmp_path, capsys):
    Image.fromarray(photograph(20, 31)).save(tmp_path / "photos" / "00.png")
    (tmp_path / "photos" / "01.png").write_bytes(b"")
    (tmp_path / "photos" / "02.png").unlink()
    assert adapt() == 2
    err = capsys.readouterr().err
    assert "00.png: the object is 20 x 31 pixels: too small to learn from" in err
    assert "adapt: 49 usable photographs: needs 50 or more (the first that was left out: photos/00.png: " in err
    assert not (tmp_path / "data").exists()
    assert main(["adapt", "--model", "model", "-o", "adapted"]) == 2
    assert "adapt: no images: name some" in capsys.readouterr().err


def test_boxes_decide_what_is_seen_and_what_is_too_small(tmp_path, capsys):
    lines = [f"photos/{number:02}.png,0,0,{20 if number < 5 else 80},25" for number in range(51)]
    (tmp_path / "boxes.csv").write_text("\n".join(["image,x0,y0,x1,y1", *lines]))
    assert adapt("--boxes", "boxes.csv") == 2
    err = capsys.readouterr().err
    assert "photos/51.png: no box in boxes.csv" in err
    assert "photos/04.png: the object is 20 x 25 pixels: too small to learn from, needs 32 along one side" in err
    assert "adapt: 46 usable photographs" in err
