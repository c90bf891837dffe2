"""Confidences: what they count, whether they are true, and how a temperature makes them so."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from viewnet.estimator.viewpoints import Viewpoints
from viewnet.evaluation.confidence import calibration_error, confidence, probabilities, temperature
from viewnet.geometry import look_at, view_vector
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config


def frames(*azimuths: float) -> np.ndarray:
    """(1, M, 3, 3) camera frames at the horizon."""
    azimuth = torch.tensor(azimuths, dtype=torch.float64)
    return look_at(view_vector(azimuth, torch.zeros_like(azimuth))).numpy()[None]


def drawn(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames of two hypotheses half a turn apart, logits, and whether the likelier is right: as often as they say."""
    rng = np.random.default_rng(seed)
    logits = rng.normal(0, 2, (count, 2))
    right = rng.uniform(size=count) < probabilities(logits).max(1)
    return frames(0, 180).repeat(count, 0), logits, right


def test_hypotheses_within_30_degrees_of_the_likeliest_count_together():
    logits = np.log([[0.4, 0.3, 0.2, 0.1]])
    assert confidence(frames(0, 29, 31, 180), logits) == pytest.approx([0.7])
    assert confidence(frames(40, 355, 0, 180), logits) == pytest.approx([0.4])
    said = Viewpoints.of(frames(0, 29, 31, 180)[..., 2], logits, None, aligned=True)
    assert said.confidence == pytest.approx([0.7])


@pytest.mark.parametrize(("turns", "sure"), [(1, 0.4), (2, 0.7), (0, 1.0)])
def test_hypotheses_that_look_alike_count_together(turns, sure):
    logits = np.log([[0.4, 0.3, 0.3]])
    at = frames(0, 185, 90)
    assert confidence(at, logits, turns) == pytest.approx([sure])
    (said,) = Viewpoints.of(at[..., 2], logits, None, True, turns)
    assert said.confidence == pytest.approx(sure)
    assert (said.rival is None) == (turns != 1)  # the other side is in doubt only where it looks different


@pytest.mark.parametrize("turns", [1, 2])
def test_a_temperature_is_of_what_looks_alike(turns):
    """Hypotheses half a turn apart: surest of all where half turns count as right, since then they all are."""
    at, logits, right = drawn(2_000)
    found = temperature(at, logits, right if turns == 1 else np.full_like(right, True), turns)
    sure = confidence(at, logits / found, turns)
    assert calibration_error(sure, right if turns == 1 else np.full_like(right, True)) < 3
    assert (sure.min() > 0.999) == (turns == 2)


def test_confidences_that_are_true_have_no_error_and_others_have_what_they_are_off():
    at, logits, right = drawn(20_000)
    sure = confidence(at, logits)
    assert calibration_error(sure, right) < 1.5
    assert calibration_error(sure**0.2, right) == pytest.approx(100 * (sure**0.2 - sure).mean(), abs=1)
    assert calibration_error(np.ones(4), np.array([True, True, True, False])) == 25


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_the_temperature_that_was_multiplied_in_is_found(factor):
    at, logits, right = drawn(20_000)
    assert temperature(at, factor * logits, right) == pytest.approx(factor, rel=0.06)


def test_dividing_logits_changes_no_hypothesis():
    torch.manual_seed(0)
    network = ViewNet(make_config(profile="smoke").model).eval().viewpoint
    images = torch.rand(5, 3, 32, 32)
    with torch.no_grad():
        before = network(images)
        network.divide_logits(2.0)
        after = network(images)
    assert torch.equal(after.vectors, before.vectors)
    assert torch.allclose(after.logits, before.logits / 2, atol=1e-6)
