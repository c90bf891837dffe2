from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.evaluation_data import make_index, noisy
from scipy.spatial.transform import Rotation

from viewnet.errors import ViewnetError
from viewnet.estimator import model_card
from viewnet.evaluation import baselines, metrics
from viewnet.evaluation.evaluate import align, evaluate, scores
from viewnet.evaluation.predictions import Predictions, joined

LARGE = make_index(6000, 2, seed=1)
"""Enough viewpoints for percentages within one point."""


def score(predictions, alignment="none", **options):
    return evaluate(predictions, alignment, draws=20, **options)


def test_random_predictor():
    found = score(baselines.random(LARGE))
    assert found["acc30"] == pytest.approx(10.4, abs=1.5)
    assert found["median"] == pytest.approx(93, abs=2)
    assert found["audit"]["folded"] == {"acc30": pytest.approx(27.5, abs=2), "median": pytest.approx(48.2, abs=2)}


def test_best_constant_predictor():
    found = score(baselines.best_constant(LARGE))
    assert found["acc30"] == pytest.approx(13.2, abs=1.5)
    assert found["median"] == pytest.approx(91.3, abs=2)
    audit = found["audit"]
    assert audit["folded"] == {"acc30": pytest.approx(30, abs=2), "median": pytest.approx(46.4, abs=2)}
    assert audit["scaled"] == {"acc30": pytest.approx(21.5, abs=2), "median": pytest.approx(64.5, abs=2)}


def test_mean_vector_constant_is_never_right_and_folding_hides_it():
    found = score(baselines.constant(LARGE))
    assert found["acc30"] == 0
    assert 100 < found["median"] < 125
    assert found["audit"]["folded"] == {"acc30": pytest.approx(22, abs=3), "median": pytest.approx(59, abs=4)}
    # Rigid alignment turns the training mean to the validation mean, and changes nothing else.
    assert score(baselines.constant(LARGE), "procrustes")["acc30"] == 0


@pytest.mark.parametrize("alignment", ["procrustes", "linear"])
def test_oracle_in_any_frame_is_perfect(alignment):
    index = make_index(40)
    for seed in range(3):
        turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        found = score(baselines.oracle(index, rotation=turn), alignment)
        assert found["acc10"] == found["acc30"] == found["oracle"]["acc30"] == 100
        assert found["median"] == pytest.approx(0, abs=1e-4)
        assert found["flips"] == 0
        assert found["intervals"]["acc30"] == [100, 100]


def test_flips_count_as_errors_and_only_the_folded_definition_forgives_them():
    index = make_index(400)
    flat = index.assign(elevation=0.0)
    right = baselines.oracle(flat)
    rng = np.random.default_rng(0)
    sign = np.where(rng.random((len(right), 1, 1)) < 0.3, -1, 1)
    found = score(Predictions(right.ids, right.hypotheses * sign, right.logits))
    assert found["flips"] == pytest.approx(30, abs=4)
    assert found["acc30"] == pytest.approx(100 - found["flips"])
    assert found["audit"]["folded"]["acc30"] == 100


def test_nothing_but_validation_rows_is_fitted_on_and_nothing_but_test_rows_scored():
    predictions = noisy(make_index(60))
    found = evaluate(predictions, draws=50)
    val, test = predictions.subset("val"), predictions.subset("test")
    # Test truth that is wrong everywhere changes the score, not the alignment; the same with validation the other way.
    spun = Predictions(test.ids.assign(azimuth=(test.ids["azimuth"] + 90) % 360), test.hypotheses, test.logits)
    changed = evaluate(joined([val, spun]), draws=50)
    assert changed["alignment"] == found["alignment"]
    assert changed["acc30"] < found["acc30"]
    assert found["images"] == len(test)
    assert found["alignment"]["images"] == len(val)
    spun = Predictions(val.ids.assign(azimuth=(val.ids["azimuth"] + 90) % 360), val.hypotheses, val.logits)
    assert evaluate(joined([spun, test]), draws=50)["alignment"] != found["alignment"]


def test_heads_and_oracle():
    predictions = noisy(make_index(200), degrees=2, heads=3)
    found = evaluate(predictions, draws=50)
    aligned = align(predictions)
    assert found["oracle"]["acc30"] == 100
    assert found["acc30"] < found["oracle"]["acc30"]
    assert sum(head["selected"] for head in found["heads"]) == pytest.approx(100)
    assert sum(head["best"] for head in found["heads"]) == pytest.approx(100)
    assert found["heads"][0]["acc30"] == 100
    assert found["heads"][1]["acc30"] < 5  # it faces backwards
    assert found["acc30"] == metrics.accuracy(aligned.selected_errors, 30)
    assert aligned.errors.shape == (len(aligned.predictions), 3)
    assert aligned.selected.shape == (len(aligned.predictions), 3)


def test_mirrored_predictions_do_worse_than_true_ones_but_no_worse_than_unaligned():
    index = make_index(200)
    true, mirrored = (evaluate(noisy(index, 2, mirrored=m), draws=20) for m in (False, True))
    assert mirrored["median"] > true["median"] + 5
    assert mirrored["acc30"] >= evaluate(noisy(index, 2, mirrored=True), "none", draws=20)["acc30"]


def test_calibration_images_are_drawn_from_the_seed_and_counted():
    predictions = noisy(make_index(80), degrees=15)
    first, second = (evaluate(predictions, calibration=20, seed=s, draws=20) for s in (0, 1))
    assert first["alignment"]["images"] == 20
    assert first["alignment"]["objects"] == 4
    assert first["alignment"]["rotation"] != second["alignment"]["rotation"]
    assert first == evaluate(predictions, calibration=20, seed=0, draws=20)


def test_in_plane_rotation_is_aligned_with_the_view_and_scored():
    index = make_index(40)
    turn = Rotation.random(rng=np.random.default_rng(5)).as_matrix()
    plain = baselines.oracle(index, rotation=turn)
    up = np.broadcast_to(turn @ [0, 0, 1], plain.hypotheses.shape)
    assert score(Predictions(plain.ids, plain.hypotheses, plain.logits, up), "procrustes")["median"] < 1e-4
    views = plain.hypotheses[:, 0]
    rolled = Rotation.from_rotvec(np.deg2rad(20) * views).apply(turn @ [0, 0, 1])[:, None]
    tilted = Predictions(plain.ids, plain.hypotheses, plain.logits, rolled)
    assert score(tilted, "procrustes")["median"] == pytest.approx(20, abs=1e-3)
    assert score(tilted, "linear")["median"] == pytest.approx(0, abs=1e-3)


def test_dva_is_not_taken_in_by_a_biased_set_of_viewpoints():
    index = make_index(400, 1)
    biased = index.assign(azimuth=np.where(index["view"].index % 10, 5.0, index["azimuth"]), elevation=5.0)
    found = score(baselines.constant(biased))
    assert found["acc30"] > 85
    assert found["dva"] < 25
    assert found["intervals"]["dva"][0] <= found["dva"] <= found["intervals"]["dva"][1]
    assert found["confidence_index"] == pytest.approx(1 / 12)


def test_the_result_is_plain_json():
    found = evaluate(noisy(make_index(30)), draws=20)
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_what_cannot_be_scored_is_said():
    index = make_index(40)
    predictions = noisy(index)
    with pytest.raises(ViewnetError, match="no rows of split 'val'"):
        evaluate(predictions.subset("test"))
    with pytest.raises(ViewnetError, match="unknown alignment 'rigid'"):
        evaluate(predictions, "rigid")
    with pytest.raises(ViewnetError, match="one category at a time, got car, chair"):
        evaluate(joined([predictions, noisy(make_index(40, category="chair"))]))
    leaked = index.assign(model_id="a", view=np.arange(len(index)))
    with pytest.raises(ViewnetError, match="car/a is in the validation split"):
        evaluate(noisy(leaked))
    with pytest.raises(ViewnetError, match="no views of split 'train'"):
        baselines.constant(index[index["split"] != "train"])
    ring = index.iloc[:4].assign(split="train", azimuth=[0.0, 90, 180, 270], elevation=0.0)
    with pytest.raises(ViewnetError, match="cancel out"):
        baselines.constant(ring)


@pytest.mark.parametrize(("category", "kind"), [("diningtable", "half_turns"), ("bottle", "any_turn")])
def test_symmetric_categories_are_scored_up_to_their_symmetry_too(category, kind):
    said = noisy(make_index(400, 5, category=category))
    rng = np.random.default_rng(0)
    angle = rng.choice([0, 180], len(said)) if category == "diningtable" else rng.uniform(0, 360, len(said))
    turned = Rotation.from_rotvec(angle[:, None] * [0, 0, 1], degrees=True).apply(said.truth)
    found = scores(Predictions(said.ids, turned[:, None], np.zeros((len(said), 1))), ("procrustes",))
    assert list(found) == ["procrustes", kind]
    assert model_card.own(found) is found[kind]
    assert found[kind]["acc30"] < 70
    alike = found[kind]["alike"]
    assert alike["acc30"] == 100
    assert alike["median"] < 0.5
    assert alike["intervals"]["acc30"] == [100, 100]
    assert "alike" not in scores(noisy(make_index(40, 5)), ("procrustes",))["procrustes"]


def test_two_groups_half_a_turn_apart_are_scored_by_the_rotation_of_the_larger_one():
    said = noisy(make_index(400, 5))
    assert list(scores(said, ("procrustes", "linear"))) == ["procrustes", "linear"]
    turned = np.random.default_rng(0).random(len(said)) < 0.45
    logits = np.where(turned[:, None], [0.0, 9.0, -9.0], [9.0, 0.0, -9.0])  # the second head faces back
    found = scores(Predictions(said.ids, said.hypotheses, logits), ("procrustes", "linear"))
    assert list(found) == ["procrustes", "linear", "robust"]
    assert found["robust"]["acc30"] == pytest.approx(55, abs=6)
    assert model_card.own(found) == found["robust"]
    assert model_card.own({name: found[name] for name in ("procrustes", "linear")}) == found["procrustes"]
    assert model_card.own({}) == {}
