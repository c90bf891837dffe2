"""Files of predictions: rows in any order, and errors that name the first row at fault."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from helpers.evaluation_data import make_index, noisy

from viewnet.errors import ViewnetError
from viewnet.evaluation import submitted_predictions
from viewnet.evaluation.predictions import Predictions, joined


@pytest.fixture
def said():
    return noisy(make_index(20, 3), heads=2)


@pytest.fixture
def frame(said, tmp_path):
    said.to_parquet(tmp_path / "whole.parquet")
    return pd.read_parquet(tmp_path / "whole.parquet")


def write(frame, path):
    frame.to_parquet(path, index=False) if path.suffix == ".parquet" else frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_rows_may_stand_in_any_order_beside_other_categories(said, frame, tmp_path, suffix):
    other = frame.assign(category="chair", model_id="unknown")
    mixed = pd.concat([other, frame]).sample(frac=1, random_state=0)
    found = submitted_predictions.read(write(mixed, tmp_path / f"mixed{suffix}"), said.ids)
    assert found.ids.equals(said.ids)
    assert np.array_equal(found.hypotheses, said.hypotheses)
    assert np.array_equal(found.logits, said.logits)


def test_ids_keep_their_zeros_in_csv(said, frame, tmp_path):
    assert said.ids["model_id"].str.startswith("000").all()
    lean = frame[["category", "model_id", "view", "h0_x", "h0_y", "h0_z"]]
    found = submitted_predictions.read(write(lean, tmp_path / "lean.csv"), said.ids)
    assert found.heads == 1
    assert np.array_equal(found.hypotheses[:, 0], said.hypotheses[:, 0])


def test_ups_come_along(said, tmp_path):
    tilted = Predictions(said.ids, said.hypotheses, said.logits, said.hypotheses[..., [1, 2, 0]])
    tilted.to_parquet(tmp_path / "ups.parquet")
    assert np.array_equal(submitted_predictions.read(tmp_path / "ups.parquet", said.ids).ups, tilted.ups)


def test_truth_is_the_store_s(said, frame, tmp_path):
    rounded = frame.assign(azimuth=frame["azimuth"].round(3), elevation=frame["elevation"].round(3))
    assert not rounded["azimuth"].equals(frame["azimuth"])
    found = submitted_predictions.read(write(rounded, tmp_path / "rounded.csv"), said.ids)
    assert found.ids.equals(said.ids)
    ids = said.ids.assign(azimuth=[0.001, *said.ids["azimuth"][1:]])
    around = frame.assign(azimuth=[359.999, *frame["azimuth"][1:]])
    assert len(submitted_predictions.read(write(around, tmp_path / "around.csv"), ids)) == len(said)


def changed(name, value, row=4):
    """A change of one value in row `row`, counted from 1."""

    def change(frame):
        column = frame[name].astype(object)
        column.iloc[row - 1] = value
        return frame.assign(**{name: column})

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.drop(columns="view"), "column 'view' is missing"),
        (lambda f: f.drop(columns="h0_x"), "column 'h0_x' is missing"),
        (lambda f: f.drop(columns="h1_z"), "column 'h1_z' is missing"),
        (lambda f: f.drop(columns="logit_1"), "column 'logit_1' is missing"),
        (lambda f: f.assign(category="boat"), "no row of category car"),
        (lambda f: f.iloc[:0], "no row of category car"),
        (lambda f: f.drop(index=7), r"no row for view 1 of car 00012"),
        (lambda f: pd.concat([f, f.iloc[[2]]]), "row 31: view 2 .* appears twice"),
        (changed("model_id", "99999"), "row 4: view 0 of car 99999"),
        (changed("view", 0.5), "row 4: view 0.5 of car 00011"),
        (changed("view", "first"), "row 4: view is 'first'"),
        (changed("h0_y", float("inf")), "row 4: h0_y is 'inf'"),
        (changed("h1_y", ""), "row 4: h1_y is ''"),
        (changed("h1_y", 3.0), r"row 4: h1 has length 3"),
        (changed("logit_0", "nan"), "row 4: logit_0 is 'nan'"),
        (changed("azimuth", 400.0), "row 4: azimuth is 400.0"),
        (changed("split", "train"), "row 4: split is train"),
    ],
)
def test_the_first_row_at_fault_is_named(said, frame, tmp_path, change, message):
    path = write(change(frame), tmp_path / "bad.csv")
    with pytest.raises(ViewnetError, match=f"^{path}: {message}"):
        submitted_predictions.read(path, said.ids)


def test_parquet_is_held_to_the_same(said, frame, tmp_path):
    path = tmp_path / "bad.parquet"
    numbers = frame.assign(model_id=frame["model_id"].astype(int))
    with pytest.raises(ViewnetError, match=r"row 1: model_id 10 is no text"):
        submitted_predictions.read(write(numbers, path), said.ids)
    holes = frame.assign(h0_x=[*frame["h0_x"][:-1], np.nan])
    with pytest.raises(ViewnetError, match="row 30: h0_x is 'nan'"):
        submitted_predictions.read(write(holes, path), said.ids)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("said.parquet", None, "said.parquet: no such file"),
        ("said.csv", None, "said.csv: no such file"),
        ("said.npz", b"", r"said.npz: expected a file"),
        ("said.parquet", b"no parquet", "said.parquet: not a readable"),
        ("said.csv", b"", "said.csv: not a readable CSV file"),
        ("said.csv", b"\xff\xfe\x00", "said.csv: not a readable CSV file"),
    ],
)
def test_what_is_no_such_file_is_told(said, tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ViewnetError, match=message):
        submitted_predictions.read(tmp_path / name, said.ids)


def test_what_is_written_for_two_categories_is_read_for_each(said, tmp_path):
    chairs = noisy(make_index(10, 2, "chair"), heads=2)
    joined([said, chairs]).to_parquet(tmp_path / "both.parquet")
    for part in (said, chairs):
        found = submitted_predictions.read(tmp_path / "both.parquet", part.ids)
        assert np.array_equal(found.hypotheses, part.hypotheses)
