"""The models that come with the package: small, complete, and as accurate as stated."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest
from helpers.documents import ROOT, page

from viewnet.estimator import ViewpointEstimator, model_card, pretrained
from viewnet.estimator.demo import examples
from viewnet.evaluation.symmetry import SYMMETRIES, symmetry
from viewnet.geometry import look_at, rotation_angle, view_vector

TWO_SIDED = ("bus", "train", "tvmonitor")
"""Whose ends, built-in models of which look alike, are taken for each other."""
CATEGORIES = ("aeroplane", "bicycle", "boat", "car", "chair", "motorbike", "sofa", *TWO_SIDED, *SYMMETRIES)


@pytest.mark.parametrize("category", CATEGORIES)
def test_models_see_what_they_have_not_been_trained_on(category):
    import torch

    estimator = ViewpointEstimator.from_pretrained(category, device="cpu")
    assert estimator.aligned
    assert (estimator.config.category, estimator.config.profile) == (category, "pocket")
    drawn = examples.rendered(estimator)
    found = estimator.predict([one.image for one in drawn], boxes=[one.box for one in drawn])
    truth = view_vector(*torch.tensor(examples.VIEWPOINTS).unbind(1))
    said = torch.tensor(np.array([one.vector for one in found]), dtype=truth.dtype)
    turns = 2 if category in TWO_SIDED else symmetry(category).turns
    errors = rotation_angle(look_at(said), look_at(truth), turns)
    assert (errors < 30).sum() >= 3, errors


def test_they_are_small_and_say_what_they_are():
    assert pretrained.shipped() == sorted(CATEGORIES)
    files = [path for path in pretrained.SHIPPED.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 8_000_000
    names = defaultdict(set)
    for path in files:
        names[path.parent.name].add(path.name)
    assert dict(names) == {category: {"model.safetensors", "config.json", "README.md"} for category in CATEGORIES}
    for category in CATEGORIES:
        about = json.loads((pretrained.SHIPPED / category / "config.json").read_text())["about"]
        score = model_card.own(about["metrics"])["acc30"]
        assert f"| Acc@30, % | {score:.1f} [" in (pretrained.SHIPPED / category / "README.md").read_text()


def test_the_readme_s_first_example_says_what_is_printed_there():
    command, printed = (block.text for block in page("README.md").blocks[:2])
    words = command.splitlines()[1].partition("#")[0].removeprefix(".venv/bin/").split()
    assert words[:2] == ["viewnet", "predict"]
    done = subprocess.run([sys.executable, "-m", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    said, shown = (text.split() for text in (done.stdout, printed))
    assert [said[:4], said[-1]] == [shown[:4], shown[-1]]
    assert [float(word) for word in said[4:7]] == pytest.approx([float(word) for word in shown[4:7]], abs=1)
