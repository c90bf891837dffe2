"""Each column says itself whether lower is better and where it is shown."""

from __future__ import annotations

import pandas as pd
import pytest

from viewnet.tables import columns
from viewnet.tables.columns import METRICS, Column, best, column_of


def best_row(metric: str) -> str:
    """The row marked as best of two with values 1 and 2."""
    same = {"category": "car", "metric": metric, "supervision": "", "degenerate": 0}
    lines = [{"row": row} | same for row in ("less", "more")]
    ((row, _, _),) = best(pd.DataFrame(lines).assign(measured=[1.0, 2.0]), lambda metric: 1)
    return row


@pytest.mark.parametrize("metric", METRICS)
def test_the_best_of_a_column_is_where_its_arrow_points(metric):
    column = METRICS[metric]
    assert best_row(metric) == ("less" if column.lower_is_better else "more")
    assert (r"\downarrow" in column.latex) == column.lower_is_better
    assert ("higher is better" in column.page) <= (not column.lower_is_better)
    assert ("lower is better" in column.page) <= column.lower_is_better


def test_a_column_added_at_the_end_changes_nothing_else(monkeypatch):
    bests = {metric: best_row(metric) for metric in METRICS}
    added = {"flips": Column("flips, %", r"Flips (\%) $\downarrow$", "Flips, %", lower_is_better=True)}
    monkeypatch.setattr(columns, "METRICS", METRICS | added)
    assert {metric: best_row(metric) for metric in METRICS} == bests
    assert best_row("flips") == "less"


def test_a_metric_without_a_column_is_headed_by_its_name():
    assert column_of("of another version").page == "of another version"
    assert best_row("of another version") == "more"
