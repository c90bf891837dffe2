"""benchmarks/predicting.py: every row is measured, and rates are per image."""

from __future__ import annotations

import importlib.util
import itertools
import json
import sys
from pathlib import Path

import pandas as pd
import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "predicting.py"
spec = importlib.util.spec_from_file_location("predicting", SCRIPT)
predicting = importlib.util.module_from_spec(spec)
spec.loader.exec_module(predicting)


def test_rates_are_images_over_seconds(monkeypatch):
    monkeypatch.setattr(predicting, "IMAGES", 24)
    monkeypatch.setattr(predicting, "BATCH", 8)
    lasting = itertools.cycle([2.0, 3.0, 4.0])
    monkeypatch.setattr(predicting, "seconds", lambda work: (work(), next(lasting))[1])
    rows = predicting.batched("car", 2)
    assert [row["median"] for row in rows] == pytest.approx([24 / 2, 24 / 3, 8 / 4, 100 * 2 / 3])
    assert all(row["least"] == row["median"] == row["most"] for row in rows)


@pytest.mark.slow
def test_the_report_has_every_row(monkeypatch, tmp_path):
    monkeypatch.setattr(predicting, "IMAGES", 16)
    monkeypatch.setattr(sys, "argv", ["predicting.py", "--times", "1", "-o", str(tmp_path / "new")])
    predicting.main()
    result = pd.read_csv(tmp_path / "new" / "predicting.csv")
    committed = pd.read_csv(SCRIPT.parents[1] / "paper_tables" / "benchmarks" / "predicting.csv")
    assert result["what"].tolist() == committed["what"].tolist()
    assert (result["median"] > 0).all()
    assert json.loads((tmp_path / "new" / "predicting.json").read_text())["model"] == "car"
