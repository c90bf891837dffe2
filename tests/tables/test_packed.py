"""Predictions that are kept beside a table: nearly the same ones, in fewer bytes."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from viewnet.evaluation.predictions import ID_COLUMNS, Predictions
from viewnet.tables.packed import packed, unpacked


def predictions(heads: int = 3, tilted: bool = False) -> Predictions:
    rng = np.random.default_rng(heads)
    vectors, ups = (rng.normal(size=(500, heads, 3)) for _ in range(2))
    vectors[0, 0], vectors[1, 0], vectors[2, 0] = (0, 0, 1), (1, -1e-9, 0), (0, 0, -1)  # poles, and azimuth 360
    vectors, ups = (each / np.linalg.norm(each, axis=2, keepdims=True) for each in (vectors, ups))
    logits = 5 * rng.normal(size=(500, heads))
    logits[3] = logits[3, 0] - 1e-6 * np.arange(heads)[::-1]  # the last one by a hair
    logits[4] = 2.0  # all alike: the first one counts
    ids = pd.DataFrame(
        {"model_id": np.arange(500).astype(str), "category": "car", "split": "test", "view": 0}
        | {"azimuth": rng.uniform(0, 360, 500), "elevation": rng.uniform(-20, 40, 500)}
    )[list(ID_COLUMNS)]
    return Predictions(ids, vectors, logits, ups if tilted else None)


@pytest.mark.parametrize(("heads", "tilted"), [(3, False), (1, False), (2, True)])
def test_viewpoints_move_by_little_and_every_choice_stays(heads, tilted):
    given = predictions(heads, tilted)
    kept = unpacked(packed(given))
    assert kept.ids.equals(given.ids)
    assert np.array_equal(kept.choice, given.choice)
    for before, after in ((given.hypotheses, kept.hypotheses), *([(given.ups, kept.ups)] if tilted else [])):
        away = np.degrees(np.linalg.norm(before - after, axis=2))
        assert 0 < away.max() < 1e-3
    assert tilted or kept.ups is None
    shares = (np.exp(x.logits - x.logits.max(1, keepdims=True)) for x in (given, kept))
    before, after = (share / share.sum(1, keepdims=True) for share in shares)
    assert np.abs(before - after).max() < 1e-3


def test_what_was_kept_stays_as_it_is():
    once = packed(unpacked(packed(predictions())))  # where an azimuth of 360 degrees is 0
    numbers = once.columns[once.dtypes == "float64"].difference(["azimuth", "elevation"])  # not the true ones
    in_the_file = once.astype(dict.fromkeys(numbers, "float32")).astype(dict.fromkeys(numbers, float))
    assert packed(unpacked(in_the_file)).equals(once)


def test_an_earlier_version_s_columns_are_read():
    given = predictions()
    assert np.array_equal(unpacked(given.to_frame()).hypotheses, given.hypotheses)
