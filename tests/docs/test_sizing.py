from __future__ import annotations

import doctest

import pytest
from helpers.documents import script

from viewnet.errors import ViewnetError

sizing = script("sizing")
RATES = {"views": 5, "size": 64, "epochs": 10, "rendering": (100.0, 200.0), "training": 70.0}


def test_work_follows_from_rates():
    found = sizing.work(7200, **RATES)
    assert found.views == 36_000
    assert found.store_bytes == 36_000 * 64 * 64 * 4
    assert found.core_hours == pytest.approx((0.05, 0.1))
    assert found.targets == 252_000  # 70 % of the views, ten times
    assert found.device_hours == pytest.approx(1.0)
    assert sizing.work(7200, **RATES, runs=6).device_hours == pytest.approx(6.0)
    assert sizing.work(7200, **{**RATES, "size": 128}).store_bytes == 4 * found.store_bytes


def test_what_was_not_measured_stays_open():
    found = sizing.work(100, **{**RATES, "rendering": None, "training": None})
    assert found.core_hours is None
    assert found.device_hours is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": 0}, "views 0: expected a number above 0"),
        ({"rendering": (0.0, 5.0)}, r"rendering 0\.0: expected"),
        ({"training": -1.0}, r"training -1\.0: expected"),
    ],
)
def test_what_cannot_be_is_refused(change, message):
    with pytest.raises(ViewnetError, match=message):
        sizing.work(100, **{**RATES, **change})


def test_a_row_with_a_rate_has_its_hours():
    assert "not measured" in sizing.table()
    assert "| small, matting | 256,500 | 4.2 GB | 0.08 to 0.23 | 11 M | 30 |" in sizing.table({"small, matting": 100.0})


def test_its_example_holds():
    assert doctest.testmod(sizing) == (0, 2)
