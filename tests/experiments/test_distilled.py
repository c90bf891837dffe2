"""A distilled model is a saved model like any other: its weights, scores and card."""

from __future__ import annotations

import pytest
import torch
from helpers.estimators import untrained

from viewnet.cli import main
from viewnet.errors import ViewnetError
from viewnet.estimator import pretrained
from viewnet.estimator.model_card import own
from viewnet.experiments import distilled
from viewnet.training import distil as distilling


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.setattr(distilling, "EPOCHS", 1)


def saved(folder, category="car") -> str:
    untrained(category=category, recipe="photos", backgrounds=None).save_pretrained(folder)
    return str(folder)


@pytest.mark.slow
def test_the_folder_is_a_model_with_scores_and_says_how_it_was_made(tmp_path, capsys):
    model, teacher = saved(tmp_path / "model"), saved(tmp_path / "teacher")
    folder = tmp_path / "distilled"
    assert main(["distil", model, str(folder), "--teachers", teacher, teacher, "--seed", "3"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == str(folder)
    after, before = pretrained.load(str(folder)), pretrained.load(model)
    assert f"within 30 degrees {own(after.about['metrics'])['acc30']:.1f} %" in second
    assert after.aligned
    assert (after.config.seed, after.about["distilled"]["rounds"]) == (3, 2)
    assert "| viewpoint network | distilled from the answers of 2 of our networks" in (folder / "README.md").read_text()
    old, new = before.network.state_dict(), after.network.state_dict()
    changed = {name.split(".")[0] for name in old if not torch.equal(old[name], new[name])}
    assert changed == {"viewpoint"}
    assert main(["evaluate", str(folder)]) == 0  # its key is its own: the same as in its scores


def test_models_that_cannot_teach_each_other_are_refused_before_anything_is_made(tmp_path):
    car, chair = saved(tmp_path / "car"), saved(tmp_path / "chair", "chair")
    with pytest.raises(ViewnetError, match=r"chair: is of the category chair, .*car of car"):
        distilled.make(car, tmp_path / "out", [chair])
    with pytest.raises(ViewnetError, match="seed -1: expected 0 to"):
        distilled.make(car, tmp_path / "out", seed=-1)
    with pytest.raises(ViewnetError, match=r"README\.md: is a file: name a folder"):
        distilled.make(car, tmp_path / "car" / "README.md")
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "data").exists()
