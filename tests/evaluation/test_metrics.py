from __future__ import annotations

import numpy as np
import pytest
from helpers.evaluation_data import make_index
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.predictions import true_vectors

ANGLES = st.floats(-180, 180)
ELEVATIONS = st.floats(-60, 60)


def at(azimuth: float, elevation: float = 0.0) -> np.ndarray:
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


@given(ANGLES, ELEVATIONS)
def test_identical_viewpoints_have_no_error_and_opposite_ones_180(azimuth, elevation):
    v = at(azimuth, elevation)
    assert metrics.geodesic_error(v, v) == pytest.approx(0, abs=1e-5)
    assert metrics.geodesic_error(at(azimuth + 180), at(azimuth)) == pytest.approx(180, abs=1e-5)


@given(ANGLES, ELEVATIONS, ANGLES, ELEVATIONS)
def test_relations_between_the_definitions(a, e, a2, e2):
    p, t = at(a, e), at(a2, e2)
    error = metrics.geodesic_error(p, t)
    assert error == pytest.approx(metrics.geodesic_error(t, p), abs=1e-5)
    assert metrics.vector_error(p, t) <= error + 1e-5
    # A rotation error is never below the difference in azimuth, which bounds a constant's accuracy over azimuth bins.
    assert error >= min(abs(a - a2) % 360, 360 - abs(a - a2) % 360) - 1e-4
    assert metrics.folded(metrics.geodesic_error(p, t)) == pytest.approx(min(error, 180 - error), abs=1e-9)
    assert metrics.scaled(metrics.geodesic_error(p, t)) == pytest.approx(error / 2**0.5, abs=1e-9)


@given(ANGLES, ELEVATIONS, ANGLES, ELEVATIONS, ANGLES)
def test_turning_the_scene_about_the_vertical_changes_nothing(a, e, a2, e2, turn):
    one = metrics.geodesic_error(at(a, e), at(a2, e2))
    assert metrics.geodesic_error(at(a + turn, e), at(a2 + turn, e2)) == pytest.approx(one, abs=1e-4)


def test_the_released_definitions_agree_with_their_matrix_formulas():
    # Folded: arcsine of the antisymmetric part. Scaled: Frobenius norm of the logarithm halved.
    index = make_index(200, 1)
    p, t = true_vectors(index), true_vectors(make_index(200, 1, seed=1))
    import torch

    from viewnet.geometry import look_at

    relative = (look_at(torch.from_numpy(p)).mT @ look_at(torch.from_numpy(t))).numpy()
    antisymmetric = np.linalg.norm((relative - relative.swapaxes(1, 2)) / 2, axis=(1, 2)) / np.sqrt(2)
    assert np.allclose(
        metrics.folded(metrics.geodesic_error(p, t)), np.degrees(np.arcsin(antisymmetric.clip(0, 1))), atol=1e-5
    )
    log = np.sqrt(2) * Rotation.from_matrix(relative).magnitude()  # |log R|_F
    assert np.allclose(metrics.scaled(metrics.geodesic_error(p, t)), np.degrees(log / 2), atol=1e-5)


def test_predicted_tilt_counts():
    v, up = at(30, 10)[None], np.array([[0.0, 0, 1]])
    assert metrics.geodesic_error(v, v, up) == pytest.approx(0, abs=1e-5)
    tilted = up @ Rotation.from_rotvec(np.deg2rad(25) * v[0]).as_matrix().T
    assert metrics.geodesic_error(v, v, tilted) == pytest.approx(25, abs=1e-5)


def test_thresholds_are_strict_and_flips_are_over_150():
    errors = np.array([9.99, 10.0, 15.0, 30.0, 29.9, 150.0, 150.1, 180.0])
    assert metrics.summary(errors, np.full(8, 15.0)) == {
        "acc10": 12.5, "acc15": 25.0, "acc30": 50.0, "median": pytest.approx(29.95), "flips": 25.0,
        "dva": 50.0, "confidence_index": 0.0,
    }  # fmt: skip
    assert metrics.accuracy(np.array([30.0]), 30) == 0.0


def test_bins_are_of_30_degrees_and_the_confidence_index_counts_those_of_more_than_ten():
    assert list(metrics.azimuth_bins(np.array([0.0, 29.9, 30.0, 359.9]))) == [0, 0, 1, 11]
    assert metrics.confidence_index(np.repeat([15.0, 45.0, 75.0], [20, 11, 10])) == pytest.approx(2 / 12)


def test_bootstrap_resamples_objects_not_images():
    # Ten objects of fifty views that are all right or all wrong: as uncertain as ten coin tosses, not as five hundred.
    objects = np.repeat([f"m{i}" for i in range(10)], 50)
    errors = np.repeat([5.0, 90.0] * 5, 50)
    low, high = metrics.bootstrap_intervals([errors], [objects])["acc30"]
    assert (low, high) == (pytest.approx(20, abs=5), pytest.approx(80, abs=5))
    images = np.array([f"m{i}" for i in range(500)])
    low, high = metrics.bootstrap_intervals([errors], [images])["acc30"]
    assert (low, high) == (pytest.approx(45.6, abs=1.5), pytest.approx(54.4, abs=1.5))


def test_bootstrap_of_several_runs_takes_the_same_objects_in_each():
    # Two kinds of runs that are right on complementary objects: of as many of both the mean is 50 % in every draw.
    objects = np.array([f"m{i}" for i in range(40)])
    one = np.where(np.arange(40) % 2, 5.0, 90.0)
    runs = [one, 95 - one] * 20
    low, high = metrics.bootstrap_intervals(runs, [objects] * 40)["acc30"]
    assert 45 < low < 50 < high < 55
    alone = metrics.bootstrap_intervals([one], [objects])["acc30"]
    assert alone[0] < 40 < 60 < alone[1]


def test_bootstrap_resamples_runs():
    # Each run is all right or all wrong, whatever the objects: four coin tosses, which may all show one side.
    objects = [np.array([f"m{i}" for i in range(40)])] * 4
    errors = [np.full(40, error) for error in (5.0, 5.0, 90.0, 90.0)]
    assert metrics.bootstrap_intervals(errors, objects)["acc30"] == (0, 100)
    assert metrics.mean_interval([100.0 * (e < 30) for e in errors], objects) == (0, 100)


def test_bootstrap_is_a_function_of_its_seed_and_not_of_the_row_order():
    rng = np.random.default_rng(0)
    errors, objects = rng.uniform(0, 180, 60), np.repeat([f"m{i}" for i in range(20)], 3)
    args = [errors], [objects]
    one = metrics.bootstrap_intervals(*args, seed=1)
    assert one == metrics.bootstrap_intervals(*args, seed=1)
    assert one != metrics.bootstrap_intervals(*args, seed=2)
    order = rng.permutation(60)
    assert one == metrics.bootstrap_intervals([errors[order]], [objects[order]], seed=1)
    assert one["acc30"][0] <= metrics.accuracy(errors, 30) <= one["acc30"][1]


def test_a_single_object_has_no_interval():
    none = metrics.bootstrap_intervals([np.ones(5)], [np.array(["m"] * 5)])
    assert none == {"acc30": None, "median": None}


def test_intervals_of_dva_are_those_of_resampled_objects():
    rng = np.random.default_rng(0)
    azimuths, objects = rng.uniform(0, 360, 90), np.repeat([f"m{i:02}" for i in range(30)], 3)
    errors = np.where(azimuths < 90, 5.0, 90.0)
    draws = []
    generator = np.random.default_rng(3)
    for _ in range(50):
        taken = generator.integers(30, size=30)
        rows = np.concatenate([np.flatnonzero(objects == f"m{i:02}") for i in taken])
        draws.append(metrics.dva(errors[rows], azimuths[rows]))
    found = metrics.bootstrap_intervals(
        [errors], [objects], 50, statistics=("acc30", "dva"), azimuths=[azimuths], seed=3
    )
    assert found["dva"] == pytest.approx(tuple(np.percentile(draws, [2.5, 97.5])))
    assert found["acc30"] == metrics.bootstrap_intervals([errors], [objects], 50, seed=3)["acc30"]


def test_bins_that_a_draw_leaves_empty_do_not_count_as_wrong():
    # One object in a bin of its own: half of the draws or so leave it out, and all that is left is right.
    azimuths, objects = np.array([15.0] * 9 + [195.0]), np.array([f"m{i}" for i in range(10)])
    found = metrics.bootstrap_intervals([np.ones(10)], [objects], statistics=("dva",), azimuths=[azimuths])
    assert found["dva"] == (100, 100)


def test_dva_intervals_need_azimuths():
    with pytest.raises(ViewnetError, match="dva of 1 runs needs"):
        metrics.bootstrap_intervals([np.ones(4)], [np.array(list("abcd"))], statistics=("dva",))


def test_the_interval_of_a_mean_is_that_of_an_accuracy():
    rng = np.random.default_rng(0)
    objects = [np.repeat([f"o{i}" for i in range(20)], 3)] * 2
    hits = [(rng.random(60) < 0.5).astype(float) * 100 for _ in range(2)]
    errors = [np.where(hit > 0, 0.0, 90.0) for hit in hits]  # acc30 is then the mean of the hits
    low, high = metrics.mean_interval(hits, objects, 4000)
    wanted = metrics.bootstrap_intervals(errors, objects, 4000)["acc30"]
    assert np.allclose([low, high], wanted, atol=1.0)
    assert metrics.mean_interval([hits[0][:3]], [objects[0][:3]]) is None
    assert metrics.mean_interval([np.full(60, np.nan)], objects[:1]) is None


def test_flags_tossed_for_are_no_matter_of_objects_and_those_of_whole_objects_are():
    rng = np.random.default_rng(0)
    objects = np.repeat(np.arange(400), 5)
    assert metrics.clustering(rng.random(2000) < 0.4, objects) == pytest.approx(0, abs=0.05)
    assert metrics.clustering(np.repeat(rng.random(400) < 0.4, 5), objects) == pytest.approx(1)
    mixed = np.where(rng.random(2000) < 0.5, np.repeat(rng.random(400) < 0.4, 5), rng.random(2000) < 0.4)
    assert metrics.clustering(mixed, objects) == pytest.approx(0.25, abs=0.06)
    assert np.isnan(metrics.clustering(np.zeros(10, bool), objects[:10]))
    assert np.isnan(metrics.clustering(np.array([True, False]), np.array(["a", "b"])))
