from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from viewnet.config import CATEGORIES
from viewnet.data import annotated_viewpoints
from viewnet.errors import ViewnetError


def written(folder: Path, text: str) -> Path:
    path = folder / "viewpoints.csv"
    path.write_text(text)
    return path


def test_a_list_with_the_least_columns(tmp_path):
    frame, left_out = annotated_viewpoints.read(
        written(tmp_path, "category,azimuth_deg,elevation_deg\ncar,-30,5\nbus,390,-2\n")
    )
    assert frame["category"].tolist() == ["car", "bus"]
    assert frame["azimuth"].tolist() == [330, 30]
    assert frame["elevation"].tolist() == [5, -2]
    assert frame["split"].tolist() == ["val", "val"]
    assert not frame["easy"].any()
    assert left_out == {}


def test_what_cannot_be_used_is_counted_by_reason_and_once(tmp_path):
    frame, left_out = annotated_viewpoints.read(
        written(
            tmp_path,
            "category,subset,split,azimuth_deg,elevation_deg,easy,annotated\n"
            "car,pascal,val,10,5,1,1\n"
            "car,imagenet,val,0,0,,0\n"  # coarse: angles of 0 mean nothing
            "cow,imagenet,val,0,0,,0\n"
            "car,imagenet,train,,5,,1\n"
            "car,imagenet,train,ten,5,,1\n"
            "car,imagenet,train,10,95,,1\n",
        )
    )
    assert len(frame) == 1
    assert frame.loc[0, "easy"]
    assert left_out == {
        "of another category": 1,
        "only coarsely annotated": 1,
        "azimuth or elevation is no number": 2,
        "elevation beyond 90 degrees": 1,
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("category,azimuth_deg\ncar,1\n", "'elevation_deg' is missing"),
        ("category,azimuth_deg,elevation_deg\n", "no usable viewpoint .the list is empty."),
        ("category,azimuth_deg,elevation_deg\ncow,1,2\n", "1 of another category"),
        ("", "not a readable CSV file"),
    ],
)
def test_lists_that_are_refused(tmp_path, text, message):
    with pytest.raises(ViewnetError, match=message):
        annotated_viewpoints.read(written(tmp_path, text))


def test_a_missing_list_is_named(tmp_path):
    with pytest.raises(ViewnetError, match=r"none\.csv: no such file"):
        annotated_viewpoints.read(tmp_path / "none.csv")


def test_the_stand_in_is_spread_as_the_published_histogram():
    frame = annotated_viewpoints.sample(np.random.default_rng(0), 4000)
    assert sorted(frame["category"].unique()) == sorted(CATEGORIES)
    for category, row in annotated_viewpoints.histogram().iterrows():
        mine = frame[(frame["category"] == category) & (frame["split"] == "val")]
        wanted = row[[str(30 * k) for k in range(12)]].to_numpy(dtype=float)
        found = np.bincount((mine["azimuth"] // 30).astype(int), minlength=12)
        assert np.abs(found / 4000 - wanted / wanted.sum()).max() < 0.03
        assert mine["elevation"].mean() == pytest.approx(row["elevation_mean"], abs=1.5)
        assert mine["elevation"].std() == pytest.approx(row["elevation_sd"], rel=0.05)
