from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from helpers.evaluation_data import make_index, noisy

from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Predictions, joined

INDEX = make_index(12)


def with_column(name: str, value: object) -> pd.DataFrame:
    return INDEX.assign(**{name: value})


def unit(n: int, heads: int = 2) -> np.ndarray:
    vectors = np.random.default_rng(0).standard_normal((n, heads, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.mark.parametrize("in_plane", [False, True])
def test_parquet_round_trip_is_exact_and_flat(tmp_path, in_plane):
    kept = noisy(INDEX)
    if in_plane:
        kept = Predictions(kept.ids, kept.hypotheses, kept.logits, np.roll(kept.hypotheses, 1, axis=2))
    path = tmp_path / "deep" / "predictions.parquet"
    kept.to_parquet(path)
    back = Predictions.from_parquet(path)
    pd.testing.assert_frame_equal(back.ids, kept.ids)
    assert np.array_equal(back.hypotheses, kept.hypotheses)
    assert np.array_equal(back.logits, kept.logits)
    assert (back.ups is None) is not in_plane
    if in_plane:
        assert np.array_equal(back.ups, kept.ups)
    frame = pd.read_parquet(path)
    assert {"model_id", "azimuth", "h0_x", "h2_z", "logit_2"} <= set(frame.columns)
    assert frame["model_id"].iloc[0] == kept.ids["model_id"].iloc[0]  # leading zeros stay
    assert [p.name for p in path.parent.iterdir()] == ["predictions.parquet"]


def test_selected_follows_the_largest_logit_and_truth_the_angles():
    ids = INDEX.iloc[:2].assign(azimuth=[0.0, 90.0], elevation=[0.0, 90.0])
    hypotheses = unit(2, 3)
    kept = Predictions(ids, hypotheses, np.array([[0.0, 1.0, 0.5], [3.0, 2.0, 1.0]]))
    assert np.array_equal(kept.selected, np.stack([hypotheses[0, 1], hypotheses[1, 0]]))
    assert np.allclose(kept.truth, [[1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_subset_and_joined_undo_each_other():
    kept = noisy(INDEX)
    both = joined([kept.subset("val"), kept.subset("test")])
    assert len(both) == len(kept)
    assert set(kept.subset("test").ids["split"]) == {"test"}
    with pytest.raises(ViewnetError, match=r"'train', only of test, val"):
        kept.subset("train")
    with pytest.raises(ViewnetError, match="2 and 3"):
        joined([noisy(INDEX, heads=2), kept])


def test_values_are_not_writable():
    with pytest.raises(ValueError, match="read-only"):
        noisy(INDEX).hypotheses[0, 0, 0] = 2


@pytest.mark.parametrize(
    ("ids", "message"),
    [
        (INDEX.drop(columns="elevation"), "'elevation' is missing"),
        (INDEX.iloc[:0], "no rows"),
        (with_column("azimuth", np.nan), "'azimuth' has empty values"),
        (with_column("azimuth", np.inf), "not finite"),
        (with_column("azimuth", "east"), "'azimuth' holds .* not numbers"),
        (with_column("elevation", 91.0), "elevation 91 is outside"),
        (with_column("model_id", 2958343), "'model_id' holds .* not text"),
        (with_column("view", 0), "view 0 of model 00000 appears twice"),
    ],
)
def test_bad_ids_are_named(ids, message):
    with pytest.raises(ViewnetError, match=message):
        Predictions(ids, unit(len(ids)), np.zeros((len(ids), 2)))


def test_bad_arrays_are_named():
    n = len(INDEX)
    broken = unit(n)
    broken[3, 1, 2] = np.nan
    with pytest.raises(ViewnetError, match=r"hypotheses of row 3 are not finite"):
        Predictions(INDEX, broken, np.zeros((n, 2)))
    with pytest.raises(ViewnetError, match="logits of row 0 are not finite"):
        Predictions(INDEX, unit(n), np.full((n, 2), -np.inf))
    with pytest.raises(ViewnetError, match="have length 2, expected 1"):
        Predictions(INDEX, 2 * unit(n), np.zeros((n, 2)))
    with pytest.raises(ViewnetError, match=r"\(60, 3\), expected \(60, 2\)"):
        Predictions(INDEX, unit(n), np.zeros((n, 3)))
    with pytest.raises(ViewnetError, match="hypotheses are"):
        Predictions(INDEX, unit(n)[:, 0], np.zeros((n, 2)))
    with pytest.raises(ViewnetError, match="ups are"):
        Predictions(INDEX, unit(n), np.zeros((n, 2)), unit(n, 1))


def test_unreadable_files_are_named(tmp_path):
    path = tmp_path / "p.parquet"
    with pytest.raises(ViewnetError, match=r"p\.parquet: no such file"):
        Predictions.from_parquet(path)
    path.write_bytes(b"PAR1 but not really")
    with pytest.raises(ViewnetError, match=r"p\.parquet: not a readable parquet"):
        Predictions.from_parquet(path)
    noisy(INDEX).to_parquet(path)
    pd.read_parquet(path).drop(columns="h1_y").to_parquet(path)
    with pytest.raises(ViewnetError, match=r"p\.parquet: column 'h1_y' is missing"):
        Predictions.from_parquet(path)
    INDEX.to_parquet(path)
    with pytest.raises(ViewnetError, match="column 'h0_x' is missing"):
        Predictions.from_parquet(path)
