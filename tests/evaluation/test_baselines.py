from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import torch
from helpers.evaluation_data import make_index

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines
from viewnet.evaluation.evaluate import align, evaluate
from viewnet.evaluation.predictions import true_vectors


def photographs(azimuths: np.ndarray, elevations: np.ndarray, calibrating: float = 0.5) -> pd.DataFrame:
    n = len(azimuths)
    return pd.DataFrame(
        {
            "model_id": [f"p{i:04}" for i in range(n)],
            "category": "car",
            "split": np.where(np.arange(n) < calibrating * n, "val", "test"),
            "view": 0,
            "azimuth": azimuths % 360,
            "elevation": elevations,
        }
    )


def angles(vector: np.ndarray) -> list[float]:
    return [float(x) for x in geometry.azimuth_elevation(torch.from_numpy(vector))]


def test_the_constant_is_the_mean_of_the_split_named():
    index = pd.DataFrame(
        {
            "model_id": list("abcdef"), "category": "car", "split": ["train", "val", "test"] * 2, "view": 0,
            "azimuth": [10.0, 100.0, 200.0, 30.0, 120.0, 220.0], "elevation": 0.0,
        }
    )  # fmt: skip
    for source, azimuth in (("train", 20), ("val", 110), ("test", 210)):
        for mean in baselines.MEANS:
            found = baselines.constant(index, source=source, mean=mean)
            assert angles(found.selected[0]) == pytest.approx([azimuth, 0], abs=0.02)
            assert (found.selected == found.selected[0]).all()
            assert set(found.ids["split"]) == {"val", "test"}
    assert np.array_equal(
        baselines.constant(index).selected, baselines.constant(index, source="train", mean="vector").selected
    )


def test_all_around_an_object_one_mean_points_to_the_sky_and_the_other_keeps_the_elevation():
    azimuths = np.arange(0, 360, 1.0)
    truth = true_vectors(photographs(azimuths, np.where(azimuths % 2, 10.0, 20.0)))
    assert angles(baselines.mean_vector(truth))[1] > 89
    assert angles(baselines.mean_level_view(truth))[1] == pytest.approx(15, abs=0.1)


def test_the_mean_rotation_is_the_closest_level_frame():
    index = make_index(40, 1, seed=3)
    rng = np.random.default_rng(0)
    truth = true_vectors(index.assign(azimuth=rng.normal(350, 60, 40) % 360, elevation=rng.uniform(-60, 80, 40)))
    frames = geometry.look_at(torch.from_numpy(truth))

    def distance(azimuth, elevation):
        frame = geometry.look_at(geometry.view_vector(torch.as_tensor(azimuth), torch.as_tensor(elevation)))
        return float((frames - frame).square().sum())

    azimuth, elevation = angles(baselines.mean_level_view(truth))
    best = distance(azimuth, elevation)
    grid = [distance(float(a), float(e)) for a in range(0, 360, 6) for e in range(-90, 91, 6)]
    assert best < min(grid)
    for da, de in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        assert distance(azimuth + da, elevation + de) > best


def test_what_has_no_mean_is_said():
    ring = photographs(np.array([0.0, 90, 180, 270, 0, 90, 180, 270]), np.zeros(8))
    with pytest.raises(ViewnetError, match="cancel out"):
        baselines.constant(ring, source="val")
    assert abs(angles(baselines.constant(ring, source="val", mean="rotation").selected[0])[1]) < 1e-6
    with pytest.raises(ViewnetError, match="unknown mean 'middle'"):
        baselines.constant(ring, source="val", mean="middle")
    with pytest.raises(ViewnetError, match="no views of split 'train'"):
        baselines.constant(ring)


@pytest.fixture
def readable():
    """Photographs with features linear in the viewpoint, many uninformative ones, and noise."""
    rng = np.random.default_rng(0)
    index = photographs(rng.uniform(0, 360, 300), rng.uniform(-20, 40, 300))
    told = true_vectors(index) @ rng.standard_normal((3, 40)) * 20 + 100
    features = np.hstack([told, rng.standard_normal((300, 2000))]) + 0.1 * rng.standard_normal((300, 2040))
    return index, features.astype(np.float32)


def test_view_regression_reads_what_is_in_the_features(readable):
    index, features = readable
    found = evaluate(baselines.view_regression(index, features), "none", draws=20)
    assert found["acc10"] > 90
    shuffled = np.random.default_rng(1).permutation(features)
    assert evaluate(baselines.view_regression(index, shuffled), "none", draws=20)["acc30"] < 40


def test_view_regression_is_ridge_regression_with_a_free_intercept(readable):
    index, features = readable
    fit = (index["split"] == "val").to_numpy()
    x, y = features[fit].astype(np.float64), true_vectors(index[fit])
    x0, y0 = x.mean(axis=0), y.mean(axis=0)
    weights = np.linalg.solve((x - x0).T @ (x - x0) + 50 * np.eye(x.shape[1]), (x - x0).T @ (y - y0))
    expected = (features[~fit] - x0) @ weights + y0
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    found = baselines.view_regression(index, features, ridge=50).subset("test").selected
    assert np.allclose(found, expected, atol=1e-5)


def test_a_huge_ridge_leaves_the_mean_viewpoint(readable):
    index, features = readable
    index = index.assign(azimuth=index["azimuth"] / 4)
    found = baselines.view_regression(index, features, ridge=1e12)
    mean = baselines.constant(index, source="val")
    assert np.allclose(found.selected, mean.selected, atol=1e-3)


def test_baselines_are_fitted_on_the_photographs_that_alignments_are_fitted_on(readable):
    index, features = readable
    rows = baselines.calibrating(index, 20, seed=1)
    assert rows[index["split"] == "test"].all()
    left = index[rows & (index["split"] == "val").to_numpy()]
    drawn = align(baselines.oracle(index), calibration=20, seed=1).calibration
    assert list(left["model_id"]) == list(drawn.ids["model_id"])
    assert baselines.calibrating(index).all()
    few, other = (baselines.calibrating(index, 20, seed=seed) for seed in (1, 2))
    one, two = (baselines.view_regression(index[r], features[r]).subset("test") for r in (few, other))
    assert not np.allclose(one.selected, two.selected)


def test_test_photographs_have_no_part_in_the_fit(readable):
    index, features = readable
    spun = index.assign(azimuth=np.where(index["split"] == "test", (index["azimuth"] + 90) % 360, index["azimuth"]))
    one, two = (baselines.view_regression(i, features).selected for i in (index, spun))
    assert np.array_equal(one, two)


def test_regressions_that_cannot_be_fitted_are_refused(readable):
    index, features = readable
    with pytest.raises(ViewnetError, match=r"\(299, 2040\) for 300 images"):
        baselines.view_regression(index, features[1:])
    with pytest.raises(ViewnetError, match=r"ridge 0: expected more than 0"):
        baselines.view_regression(index, features, ridge=0)
    with pytest.raises(ViewnetError, match="151 images requested, expected 4 to 150"):
        baselines.calibrating(index, 151)
    with pytest.raises(ViewnetError, match="no views of split 'val'"):
        test = (index["split"] == "test").to_numpy()
        baselines.view_regression(index[test], features[test])
