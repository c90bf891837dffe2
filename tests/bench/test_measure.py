"""The files of `viewnet bench`, and the settings that it refuses."""

from __future__ import annotations

import csv
import json

import pandas as pd
import pytest
import torch

from viewnet import cli
from viewnet.bench import measure, report

NAMES = {"bench.json", "bench.csv", "bench.tex", "bench.png", "bench.pdf"}


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    assert cli.main(["bench", "--quick", "--threads", "1", "--repeat", "1", "-o", str(folder)]) == 0
    return folder


@pytest.mark.slow
def test_quick_writes_every_file(quick):
    assert {path.name for path in quick.iterdir()} == NAMES
    tex = (quick / "bench.tex").read_text()
    assert tex.count("\\begin{tabular}") == tex.count("\\bottomrule") == 1
    lines = [line for line in tex.splitlines() if line.endswith("\\\\") and "multicolumn" not in line and "&" in line]
    assert {line.count("&") for line in lines} == {13}


@pytest.mark.slow
def test_the_result_is_printed_as_json(quick, tmp_path, monkeypatch, capsys):
    before = json.loads((quick / "bench.json").read_text())
    monkeypatch.setattr(measure, "measure", lambda settings: before)
    assert cli.main(["bench", "--quick", "--json", "-o", str(tmp_path)]) == 0
    content = json.loads(capsys.readouterr().out)
    assert sorted(content.pop("files")) == sorted(str(tmp_path / name) for name in NAMES)
    assert content == before


@pytest.mark.slow
def test_quick_measures_its_sizes_and_leaves_the_rest_empty(quick):
    result = json.loads((quick / "bench.json").read_text())
    assert result["schema"] == measure.SCHEMA
    assert result["settings"]["quick"] is True
    assert result["hardware"]["threads"] == 1
    assert {"hardware", "versions", "git", "rates", "settings", "started"} <= result.keys()
    rows = result["rows"]
    assert all(tuple(row) == measure.COLUMNS for row in rows)
    here = [row for row in rows if row["device"] == result["settings"]["device"] and row["size"]]
    assert {row["size"] for row in here} == {8, 16}
    for row in here:
        for name in ("textbook_s", "viewnet_s", "speedup", "floor_s", "viewnet_over_floor", "viewnet_images_per_s"):
            assert row[name] > 0, (row["work"], name)
        assert row["speedup_low"] <= row["speedup"] <= row["speedup_high"]
    assert [row["growth_expected"] for row in here if row["work"].startswith("renderer")] == [None, 8.0] * 5
    assert [row["memory_ratio"] is not None for row in here].count(True) <= 1
    missing = [row for row in rows if row["device"] == "cuda"] if not torch.cuda.is_available() else []
    missing += [row for row in rows if row["work"].startswith("time to")]
    for row in missing:
        assert not any(row[name] for name in measure.COLUMNS[4:])
    with (quick / "bench.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == len(rows)
    assert table[-1]["viewnet_s"] == table[-1]["speedup"] == ""
    text = report.as_text(result)
    assert text.count(report.NOT_MEASURED) == len(missing)


def test_the_seconds_a_training_took_to_an_accuracy():
    log = pd.DataFrame({"seconds": [1.5, 3.0, 4.5], "val_accuracy": [50.0, 85.0, 82.0]})
    assert measure.first_reached(log, 80) == 3.0
    assert measure.first_reached(log, 90) is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sizes", "4"], "size 4: expected 8 to 512"),
        (["--sizes", "16", "8"], "sizes 16 8: name each once, the smallest first"),
        (["--batch", "1"], "batch 1: expected 2 to 4096"),
        (["--repeat", "0"], "repeat 0: expected 1 to 1000"),
        (["--threads", "0"], "threads 0: expected 1 to 1024"),
        (
            ["--steps", "tiny", "--variant", "mvc"],
            "--variant mvc: a method of another paper: --steps takes ViewNet apart",
        ),
    ],
)
def test_settings_out_of_range_are_refused_in_a_line(arguments, message, capsys):
    assert cli.main(["bench", "--quick", *arguments]) == 2
    assert capsys.readouterr().err == f"viewnet: {message}\n"


def test_the_time_to_an_accuracy_is_the_seeds_median(monkeypatch):
    accuracy = {("car", 0): [85, 91], ("car", 1): [70, 85], ("car", 2): [81, 88], ("aeroplane", 0): [50, 60]}

    def trained(config, threads, progress):
        result = accuracy.get((config.category, config.seed), [0, 0])
        return pd.DataFrame({"seconds": [10.0, 20.0], "val_accuracy": result})

    monkeypatch.setattr(measure, "training_log", trained)
    settings = measure.Settings(accuracy=3, quick=True)
    rows = measure.time_to_accuracy(settings, torch.device("cpu"), False)
    times = [(row["viewnet_s"], row["viewnet_low"], row["viewnet_high"]) for row in rows]
    assert times == [(10.0, 10.0, 20.0), (None, None, None), (None, None, None)]  # one of three is not enough
