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


def test_files_are_read_each_time_and_given_to_the_command(monkeypatch):
    monkeypatch.setattr(predicting, "FILES", 5)
    started, lasting = [], itertools.cycle([2.0, 4.0])
    monkeypatch.setattr(predicting, "fresh", lambda *arguments: lambda: started.append(arguments))
    monkeypatch.setattr(predicting, "seconds", lambda work: (work(), next(lasting))[1])
    rows = predicting.from_files("car", SCRIPT.parents[1] / "docs" / "car.jpg", 1)
    assert [row["median"] for row in rows] == [5 / 2, 5 / 4] * 2
    assert [sum(name.endswith((".jpg", ".png")) for name in arguments) for arguments in started] == [5] * 4
    assert sum("--box" in arguments for arguments in started) == 2


@pytest.mark.slow
def test_the_report_has_every_row(monkeypatch, tmp_path):
    monkeypatch.setattr(predicting, "IMAGES", 16)
    monkeypatch.setattr(predicting, "FILES", 20)
    monkeypatch.setattr(sys, "argv", ["predicting.py", "--times", "1", "-o", str(tmp_path / "new")])
    predicting.main()
    result = pd.read_csv(tmp_path / "new" / "predicting.csv")
    committed = pd.read_csv(SCRIPT.parents[1] / "paper_tables" / "benchmarks" / "predicting.csv")
    assert result["what"].tolist() == committed["what"].tolist()
    assert (result["median"] > 0).all()
    assert json.loads((tmp_path / "new" / "predicting.json").read_text())["model"] == "car"
