from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from helpers.evaluation_data import make_index, noisy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import (
    ALIGNMENTS,
    HalfTurns,
    Identity,
    Linear,
    PerAngle,
    Procrustes,
    QuarterTurns,
    Robust,
    Yaw,
    draw_calibration,
    fit_rotation,
)
from viewnet.evaluation.metrics import geodesic_error, vector_error
from viewnet.evaluation.predictions import true_vectors

SEEDS = st.integers(0, 2**32 - 1)


def viewpoints(seed: int, n: int = 40) -> np.ndarray:
    return true_vectors(make_index(models=n, views=1, seed=seed))


def rotation(seed: int) -> np.ndarray:
    return Rotation.random(rng=np.random.default_rng(seed)).as_matrix()


def cost(r: np.ndarray, p: np.ndarray, t: np.ndarray) -> float:
    return float(((p @ r.T - t) ** 2).sum())


@given(SEEDS)
def test_a_rotation_of_the_world_is_undone(seed):
    truth, turn = viewpoints(seed), rotation(seed)
    for kind in (Procrustes, Linear):
        aligned = kind.fit(truth @ turn.T, truth).apply(truth @ turn.T)
        assert vector_error(aligned, truth).max() < 1e-5
    assert np.allclose(fit_rotation(truth @ turn.T, truth), turn.T, atol=1e-9)


@given(SEEDS, st.floats(0, 3))
def test_the_outcome_does_not_depend_on_the_predictors_frame(seed, noise):
    truth, turn = viewpoints(seed), rotation(seed)
    p = truth + noise * np.random.default_rng(seed).standard_normal(truth.shape)
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    for kind in (Procrustes, Linear):
        one, other = kind.fit(p, truth).apply(p), kind.fit(p @ turn.T, truth).apply(p @ turn.T)
        assert vector_error(one, other).max() < 1e-4


@settings(max_examples=30)
@given(SEEDS)
def test_no_rotation_beats_the_fit_also_on_mirrored_predictions(seed):
    truth, rng = viewpoints(seed), np.random.default_rng(seed)
    p = truth * [1, -1, 1] @ rotation(seed).T
    best = fit_rotation(p, truth)
    assert np.linalg.det(best) == pytest.approx(1)
    assert np.allclose(best @ best.T, np.eye(3), atol=1e-9)
    tries = [*Rotation.random(200, rng=rng).as_matrix(), np.eye(3)]
    # Also small deviations from the fit: it is a minimum, not only better than random.
    tries += [best @ Rotation.from_rotvec(0.02 * rng.standard_normal(3)).as_matrix() for _ in range(50)]
    assert cost(best, p, truth) <= min(cost(r, p, truth) for r in tries) + 1e-9


def test_mirrored_predictions_reach_the_cosine_of_the_right_formula():
    # On the paper's range of viewpoints a mirror image can be brought to a mean cosine of about 0.9, as the elevations
    # are small: mirroring mostly reverses azimuth, best undone by flipping the vertical axis.
    truth = viewpoints(0, 4000)
    p = truth * [1, -1, 1]
    cosine = (Procrustes.fit(p, truth).apply(p) * truth).sum(1).mean()
    assert cosine == pytest.approx(1 - 2 * (truth[:, 2] ** 2).mean(), abs=0.02)
    naive = np.linalg.svd(truth.T @ p)
    wrong = naive[0] @ naive[2] @ np.diag([1, 1, np.linalg.det(naive[0] @ naive[2])])
    assert cosine >= ((p @ wrong.T) * truth).sum(1).mean()


@pytest.mark.parametrize("seed", range(3))
def test_a_robust_fit_follows_those_that_agree(seed):
    # Photographs of cars: most from the front quarters, slightly from above, every fourth predicted from the back.
    rng, turn = np.random.default_rng(seed), rotation(seed)
    azimuth, elevation = rng.choice([-35, 35], 60) + rng.normal(0, 8, 60), rng.normal(5, 5, 60)
    truth = true_vectors(pd.DataFrame({"azimuth": azimuth % 360, "elevation": elevation}))
    p = truth.copy()
    p[::4, :2] *= -1
    exact = Robust.fit(p, truth).apply(p)
    assert np.median(vector_error(exact, truth)) < 2
    assert np.linalg.norm(exact - truth, axis=1).sum() <= np.linalg.norm(p - truth, axis=1).sum() * 1.001
    turned = Robust.fit(truth @ turn.T, truth)
    assert vector_error(turned.apply(truth @ turn.T), truth).max() < 0.1
    squares = Procrustes.fit(p, truth).apply(p)
    assert np.median(vector_error(squares, truth)) > np.median(vector_error(exact, truth))


@pytest.mark.parametrize("kind", [HalfTurns, QuarterTurns])
@pytest.mark.parametrize("seed", range(3))
def test_turns_that_count_as_one_are_left_open(kind, seed):
    rng, truth = np.random.default_rng(seed), viewpoints(seed, 200)
    turned = kind.turned(truth)  # (order, N, 3)
    assert np.allclose(turned[1], truth @ Rotation.from_euler("z", 360 / kind.order, degrees=True).as_matrix().T)
    p = turned[rng.integers(kind.order, size=200), np.arange(200)] @ rotation(seed).T
    aligned = kind.fit(p, truth).apply(p)
    assert geodesic_error(np.broadcast_to(aligned, turned.shape), turned).min(axis=0).max() < 1
    assert (geodesic_error(Robust.fit(p, truth).apply(p), truth) > 30).mean() > 0.3  # it has to choose


def test_a_yaw_turns_about_the_vertical_by_what_most_agree_on():
    truth = viewpoints(1, 400)
    turn = Rotation.from_euler("z", -40, degrees=True).as_matrix()
    p = truth @ turn.T
    p[::3] = truth[::3] * [-1, -1, 1] @ turn.T  # a third from the opposite side
    errors = vector_error(Yaw.fit(p, truth).apply(p), truth)
    assert np.allclose(np.delete(errors, np.s_[::3]), 0, atol=1e-3)


def test_predictions_without_spread_are_degenerate():
    truth = viewpoints(2, 400)
    right = Procrustes.fit(truth @ rotation(0).T, truth)
    assert right.spread == pytest.approx(1) and not right.degenerate
    assert right.singular_values == pytest.approx(np.linalg.svd(truth.T @ truth / len(truth), compute_uv=False))
    both_sides = truth * np.where(np.arange(len(truth))[:, None] % 2, 1, [-1, -1, 1])  # half of them half a turn off
    nearly_constant = truth * 0.05 + [0, 0, 1]
    nearly_constant /= np.linalg.norm(nearly_constant, axis=1, keepdims=True)
    assert all(Procrustes.fit(p, truth).degenerate for p in (both_sides, nearly_constant))


def test_constant_predictions_are_turned_to_the_mean_direction_the_short_way():
    truth = viewpoints(3) + np.array([0.5, 0, 0])
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    mean = truth.mean(0) / np.linalg.norm(truth.mean(0))
    for vector in ([0.6, 0.0, 0.8], [-0.6, 0.8, 0.0], list(mean), list(-mean)):
        p = np.tile(vector, (len(truth), 1))
        fitted = Procrustes.fit(p, truth)
        assert np.allclose(fitted.apply(p), mean, atol=1e-9)
        assert np.linalg.det(fitted.rotation) == pytest.approx(1)
        angle = np.degrees(Rotation.from_matrix(fitted.rotation).magnitude())
        assert angle == pytest.approx(vector_error(np.array(vector), mean), abs=1e-4)
        assert np.allclose(Linear.fit(p, truth).apply(p), mean, atol=1e-9)


def test_affine_fit_shrinks_to_the_mean_of_biased_viewpoints():
    # The paper's warning: with uninformative predictions and clustered viewpoints the regression gives the cluster.
    rng = np.random.default_rng(0)
    truth = np.array([1.0, 0, 0]) + 0.1 * rng.standard_normal((200, 3))
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    p = viewpoints(1, 200)
    linear, rigid = Linear.fit(p, truth).apply(p), Procrustes.fit(p, truth).apply(p)
    assert (geodesic_error(linear, truth) < 30).mean() > 0.95
    assert (geodesic_error(rigid, truth) < 30).mean() < 0.5


def test_per_angle_recovers_lines_and_ignores_wrapping():
    index = make_index(50, 1).assign(azimuth=np.linspace(-60, 60, 50) % 360)
    truth = true_vectors(index)
    p = true_vectors(index.assign(azimuth=(0.5 * np.linspace(-60, 60, 50) + 10) % 360))
    fitted = PerAngle.fit(p, truth)
    assert fitted.azimuth == pytest.approx((2.0, -20.0), abs=1e-6)
    assert fitted.elevation == pytest.approx((1.0, 0.0), abs=1e-6)
    assert vector_error(fitted.apply(p), truth).max() < 1e-4
    same = np.tile(truth[0], (50, 1))
    assert PerAngle.fit(same, truth).azimuth == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("kind", list(ALIGNMENTS))
def test_hypotheses_of_any_batch_shape_are_mapped_and_parameters_are_json(kind):
    truth = viewpoints(0)
    p = truth @ rotation(0).T
    fitted = ALIGNMENTS[kind].fit(p, truth)
    batch = p[:24].reshape(2, 4, 3, 3)
    assert np.allclose(fitted.apply(batch).reshape(-1, 3), fitted.apply(p[:24]), atol=1e-12)
    values = json.loads(json.dumps(fitted.to_dict()))
    assert values.pop("kind") == kind
    assert all(np.array_equal(getattr(fitted, name), value) for name, value in values.items())


def test_identity_leaves_vectors_alone():
    truth = viewpoints(0)
    assert np.array_equal(Identity.fit(truth, truth).apply(truth), truth)


@pytest.mark.parametrize("kind", ["procrustes", "linear", "per_angle"])
def test_too_little_to_fit_on_is_said(kind):
    truth = viewpoints(0)
    with pytest.raises(ViewnetError, match="3 calibration images"):
        ALIGNMENTS[kind].fit(truth[:3], truth[:3])
    with pytest.raises(ViewnetError, match="expected"):
        ALIGNMENTS[kind].fit(truth, truth[:5])
    with pytest.raises(ViewnetError, match="not finite"):
        ALIGNMENTS[kind].fit(truth * np.nan, truth)


def test_undetermined_alignments_are_refused():
    ring = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    with pytest.raises(ViewnetError, match="determine no rotation"):
        Procrustes.fit(np.tile([0.0, 0, 1], (4, 1)), ring)
    with pytest.raises(ViewnetError, match="no direction"):
        Linear(np.zeros((3, 3)), np.zeros(3)).apply(ring)


def test_calibration_takes_whole_objects_in_a_seeded_order():
    val = noisy(make_index(80)).subset("val")
    assert list(draw_calibration(val.objects)) == list(range(len(val)))
    rows = draw_calibration(val.objects, 23, seed=1)
    drawn = val.take(rows)
    counts = drawn.ids.groupby("model_id").size()
    assert len(drawn) == 23
    assert sorted(counts) == [3, 5, 5, 5, 5]
    assert np.array_equal(rows, draw_calibration(val.objects, 23, seed=1))
    assert not np.array_equal(rows, draw_calibration(val.objects, 23, seed=2))
    assert set(drawn.ids["model_id"]) != set(val.ids["model_id"][:23])
    for count in (3, len(val) + 1):
        with pytest.raises(ViewnetError, match=f"{count} images requested, expected 4 to {len(val)}"):
            draw_calibration(val.objects, count)
