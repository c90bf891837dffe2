"""benchmarks/against.py: two processes, each with its own checkout, do the same work."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "benchmarks" / "against.py"


@pytest.mark.slow
def test_a_version_against_itself(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    size = ["--profile", "smoke", "--rounds", "2", "--steps", "1", "--train", "2", "--set", "heads=2"]
    command = [sys.executable, str(SCRIPT), str(ROOT), *size, "-o", str(tmp_path)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows = pd.read_csv(tmp_path / "against.csv")
    assert rows["phase"].tolist() == ["search"] * 4 + ["after"] * 4
    assert (rows["old_loss"] == rows["new_loss"]).all()
    assert (rows["ratio_low"] <= rows["ratio"]).all() and (rows["ratio"] <= rows["ratio_high"]).all()
    assert printed.count("loss of the first step") == 2
    assert all(f"{phase}, whole step" in printed for phase in ("search", "after"))
    settings = json.loads((tmp_path / "against.json").read_text())["settings"]
    assert settings["commits"]["old"] == settings["commits"]["new"]
    assert settings["heads"] == 2


def test_a_folder_without_the_package_is_refused(tmp_path):
    command = [sys.executable, str(SCRIPT), str(tmp_path), "--profile", "smoke"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 1
    assert "name a checkout's folder" in result.stderr
