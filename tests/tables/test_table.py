from __future__ import annotations

import dataclasses
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.documents import ROOT
from helpers.evaluation_data import make_index, noisy
from helpers.fake_steps import STEPS
from helpers.latex import assert_tabular
from helpers.tables import cell_of

from viewnet.config import CATEGORIES, SHAPENET_CATEGORIES
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.baselines import oracle, random
from viewnet.evaluation.evaluate import align
from viewnet.recipes import make_config
from viewnet.runs.run_store import ensure, untrained
from viewnet.tables import columns, kept_predictions, reported
from viewnet.tables.columns import DASH
from viewnet.tables.latex import escape
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.packed import as_kept
from viewnet.tables.table import Entry, Table, entries


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """ViewNet on three categories, two seeds on cars; single head on cars; both constants on chairs."""
    root = tmp_path_factory.mktemp("tables")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VIEWNET_RUNS", str(root / "runs"))
        patch.setenv("VIEWNET_DATA", str(root / "data"))
        required = [make_config(category=c, profile="smoke") for c in SHAPENET_CATEGORIES]
        required.append(make_config(profile="smoke", seed=1))
        required.append(make_config("single_head", profile="smoke", seed=2))
        required += [untrained(v, required[2]) for v in ("constant", "best_constant")]
        return ensure(required, workers=1, progress=False, steps=STEPS)


def build(name, runs, *arguments, **options) -> Table:
    """A table of finished runs, on their own predictions."""
    return Table.of(name, entries(name, runs), *arguments, **options)


@pytest.fixture(scope="module")
def table(runs):
    return build("table2_ablation", runs, note="made-up 100 % & more")


def cell(table, row, category, metric):
    cells = table.cells
    return cells[(cells["row"] == row) & (cells["category"] == category) & (cells["metric"] == metric)].iloc[0]


def test_cells_are_means_over_seeds_of_aligned_test_errors(runs, table):
    cars = [r for r in runs if r.config.variant == "viewnet" and r.config.category == "car"]
    errors = [align(run.predictions).selected_errors for run in cars]
    result = cell(table, "ViewNet (matting)", "car", "acc30")
    values = [metrics.accuracy(e, 30) for e in errors]
    assert result["measured"] == pytest.approx(np.mean(values))
    assert result["sd"] == pytest.approx(np.std(values, ddof=1))
    assert result["seeds"] == 2
    assert result["low"] <= result["measured"] <= result["high"]
    assert result["runs"].split() == [run.key for run in cars]
    assert result["objects"] == len(set(cars[0].predictions.subset("test").objects))
    assert np.isnan(cell(table, "ViewNet (matting)", "chair", "acc30")["sd"])
    assert cell(table, "Constant, as printed", "chair", "acc30")["measured"] == 0


def test_printed_numbers_stay_as_printed_and_apart(table):
    assert cell(table, "Single-head (matting)", "car", "median")["printed"] == "27.1"
    assert cell(table, "Random", "car", "median")["printed"] == ""
    frame = table.frame()
    assert list(frame.index)[:3] == ["ViewNet (matting)", "Single-head (matting)", "Segmentation Target"]
    assert list(frame.index)[3:] == [row.label for row in LAYOUTS["table2_ablation"].rows[3:]]
    assert frame.columns.nlevels == 3
    assert frame.shape == (10, 13)
    assert frame.loc["Random", "supervision"] == "none"
    assert frame.loc["ViewNet (matting)", ("acc30", "aeroplane", "print")] == "82"
    assert frame.loc["No Shape Prior", ("acc30", "car", "ours")] == DASH
    assert frame.loc["Constant", ("acc30", "car", "ours")] == DASH
    assert frame.loc["Constant, as printed", ("acc30", "chair", "ours")] == "0"
    assert re.fullmatch(r"\d+\.\d", frame.loc["ViewNet (matting)", ("median", "car", "ours")])


def test_latex_is_a_whole_booktabs_tabular(table):
    text = table.latex()
    assert_tabular(text)
    assert "\\textbf{82}" in text  # bold in the paper
    assert "made-up 100 \\% \\& more" in text
    assert "No Shape Prior & pairs + masks & 78 & -- &" in text


def on_photographs(name: str, categories: tuple[str, ...]) -> Table:
    """A table of synthetic predictors on synthetic photographs."""
    result = [
        Entry(row.label, c, 0, row.alignment or "procrustes", f"{i}-{c}", noisy(make_index(40, 3, c)), {})
        for c in categories
        for i, row in enumerate(LAYOUTS[name].rows)
        if row.variant
    ]
    return Table.of(name, result, categories, "made up", ["car: 3 left out & more"], {"VGG view*": "VGG view* (x_y)"})


@pytest.mark.parametrize("name", ["table3_pascal3d", "table5_dva"])
def test_few_categories_have_two_columns_each_and_metrics_stand_below_one_another(name):
    table = on_photographs(name, ("car", "chair"))
    text = table.latex()
    assert_tabular(text)
    bounds = any(columns.upper_bound(row.supervision) for row in LAYOUTS[name].rows)
    assert text.count("\\midrule") == len(LAYOUTS[name].metrics) * (1 + bounds)
    assert "VGG view* (x\\_y) & ImageNet labels, viewpoints of calibration images & 56 &" in text
    assert text.index("\\end{tabular}") < text.index("ours: made up\\\\\ncar: 3 left out \\& more")
    assert table.complete


@pytest.mark.parametrize("name", ["table3_pascal3d", "table5_dva"])
@pytest.mark.slow
def test_many_categories_have_one_column_each_and_ours_below_print(name):
    table = on_photographs(name, CATEGORIES[:5])
    text = table.latex()
    assert_tabular(text)
    assert "& airplane & bike & boat" in text
    lines = text.splitlines()
    after = lines[lines.index(next(line for line in lines if line.startswith("ViewNet* & "))) + 1]
    assert after.startswith("\\quad\\textit{ours} & ")
    if name == "table3_pascal3d":
        ssv = "SSV* & single images, range of viewpoints & -- & -- & -- & -- & \\textbf{82} \\\\"
        assert not lines[lines.index(ssv) + 1].startswith("\\quad")
        assert any(line.startswith("Constant (rotation), \\textit{ours} & ") for line in lines)


def test_a_run_fills_its_starred_row_too(runs):
    result = entries("table3_pascal3d", [run for run in runs if run.config.variant == "viewnet"])
    assert [(e.row, e.alignment) for e in result[:2]] == [("ViewNet*", "linear"), ("ViewNet", "procrustes")]
    assert result[0].key == f"{runs[0].key}/linear" and result[1].key == runs[0].key
    table = Table.of("table3_pascal3d", result)
    for e, kind in ((result[0], "linear"), (result[1], "procrustes")):
        median = np.median(align(as_kept(e.predictions), kind).selected_errors)
        assert cell_of(table, table.label(e), e.category, "median")["measured"] == pytest.approx(median)


@pytest.mark.skipif(not any(map(shutil.which, ("pdflatex", "tectonic"))), reason="no TeX engine on this machine")
@pytest.mark.parametrize("name", list(LAYOUTS))
def test_latex_compiles(runs, name, tmp_path):
    layout = LAYOUTS[name]
    mine = [run for run in runs if run.config.variant in layout.variants and run.config.category in layout.categories]
    compiles(build(name, mine).latex(), tmp_path)


@pytest.mark.skipif(not any(map(shutil.which, ("pdflatex", "tectonic"))), reason="no TeX engine on this machine")
def test_latex_of_all_twelve_categories_compiles(tmp_path):
    compiles(on_photographs("table5_dva", CATEGORIES).latex(), tmp_path)


def compiles(text: str, folder: Path) -> None:
    (folder / "t.tex").write_text(text)
    document = "\\documentclass{article}\\usepackage{booktabs}\\begin{document}\\tiny\\input{t}\\end{document}\n"
    (folder / "d.tex").write_text(document)
    engine = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error"] if shutil.which("pdflatex") else ["tectonic"]
    done = subprocess.run([*engine, "d.tex"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:]


def test_the_best_measured_value_of_a_column_is_bold_and_alone_values_are_not(table):
    rows = {
        line.split(" & ")[0]: line.rstrip(" \\").split(" & ") for line in table.latex().splitlines() if " & " in line
    }
    two = [cell(table, row, "car", "acc30")["measured"] for row in ("ViewNet (matting)", "Single-head (matting)")]
    best = f"{'ViewNet' if round(two[0]) >= round(two[1]) else 'Single-head'} (matting)"
    assert rows[best][5].startswith("\\textbf{")
    assert not rows["ViewNet (matting)"][3].startswith("\\textbf{")  # the only one measured on aeroplanes


def test_upper_bounds_stand_below_a_rule_and_compete_with_no_other_row(monkeypatch):
    layout = LAYOUTS["table2_ablation"]
    bound = dataclasses.replace(layout.rows[-1], supervision="absolute viewpoints")
    monkeypatch.setitem(LAYOUTS, "table2_ablation", dataclasses.replace(layout, rows=(*layout.rows[:-1], bound)))
    index = make_index(40, 3, "car")
    made = (("ViewNet", noisy(index)), ("Single-head", random(index)), ("Random", oracle(index)))
    own = [Entry(row, "car", 0, "procrustes", row, predictions, {}) for row, predictions in made]
    table = Table.of("table2_ablation", own, ["car"])
    *_, before, rule, last = table.latex().partition("\\bottomrule")[0].splitlines()
    assert before.startswith("Constant, as printed & ") and rule == "\\midrule"
    assert last.startswith("Random & absolute viewpoints & -- & 100 & ")
    assert {key[0] for key in columns.best(table.cells, lambda metric: 1)} == {"ViewNet"}


def test_files_are_written_whole_and_name_what_is_behind_each_cell(table, runs, tmp_path):
    files = table.write(tmp_path / "smoke")
    assert [f.name for f in files] == [f"table2_ablation.{kind}" for kind in ("tex", "csv", "json", "parquet")]
    assert sorted(p.name for p in (tmp_path / "smoke").iterdir()) == sorted(f.name for f in files)
    frame = pd.read_csv(files[1])
    assert len(frame) == 10 * 3 * 2
    assert frame.loc[frame["row"] == "HoloGAN-Decoder", "measured"].isna().all()
    about = json.loads(files[2].read_text())
    assert set(about["runs"]) == {run.key for run in runs}
    origin = about["runs"][runs[0].key]
    assert origin["training"]["hardware"]["cores"] >= 1
    assert origin["alignment"] == "procrustes"
    cells = {(c["row"], c["category"], c["metric"]): c for c in about["cells"]}
    assert cells["HoloGAN-Decoder", "car", "acc30"]["measured"] is None
    assert cells["HoloGAN-Decoder", "car", "acc30"]["runs"] == []
    assert cells["ViewNet (matting)", "car", "median"]["seeds"] == 2
    before = [f.read_bytes() for f in files]
    build("table2_ablation", runs, note=table.note).write(tmp_path / "smoke")
    assert [f.read_bytes() for f in files] == before


def test_a_table_without_some_rows_is_not_complete(table, runs):
    assert not table.complete
    few = [r for r in runs if r.config.variant == "viewnet"]
    cycle = build("table1_shapenet", few)
    assert list(cycle.frame().index)[:4] == ["MVC", "Pointcloud", "ViewNet (matting)", "ViewNet + cycle"]
    assert cycle.frame().loc["MVC", ("acc30", "car", "ours")] == DASH


def test_the_verdict_compares_each_measured_row(table):
    sentences = table.verdict()
    assert [sentence.partition(" beside ")[0] for sentence in sentences] == [
        "Single-head (matting)",
        "Constant",
        "Constant, as printed",
    ]
    for sentence in sentences:
        names, _, words = sentence.partition(", Acc@30: ")
        row, reference = names.split(" beside ")
        category = words.split(" ")[0]
        assert reference == "ViewNet (matting)"
        assert f"{category} {table.comparison(row, reference, category)}" in words


def test_measurements_list_every_measured_row_once(table):
    lines = table.measurements()
    assert lines.index.is_unique
    assert len(lines) == 3 + 1 + 2
    assert lines.loc[("ViewNet (matting)", "car"), "seeds"] == 2
    assert re.fullmatch(r"\d+\.\d \[\d+\.\d, \d+\.\d\]", lines.loc[("ViewNet (matting)", "car"), "acc@30, % [95 %]"])


def test_what_has_no_place_is_said(runs):
    with pytest.raises(ViewnetError, match="table1_shapenet 'single_head'"):
        build("table1_shapenet", runs)
    with pytest.raises(ViewnetError, match="table2_ablation 'aeroplane'"):
        build("table2_ablation", runs, ["car"])
    with pytest.raises(ViewnetError, match="two runs of ViewNet, car"):
        build("table1_shapenet", [runs[1], runs[1]])
    with pytest.raises(ViewnetError, match="unknown table 'table9'"):
        build("table9", runs)


def test_escape():
    assert escape("50 % & a_b #1 {x}") == r"50 \% \& a\_b \#1 \{x\}"


def test_reported_numbers_are_in_files_named_as_their_tables():
    files = {path.stem for path in reported.folder().glob("*.csv")}
    assert files - {"architecture", "pascal3d_viewpoints"} == set(reported.TABLES)
    assert {name for name in reported.TABLES if not (ROOT / f"notebooks/{name}.ipynb").is_file()} == set()


@pytest.mark.parametrize("name", reported.TABLES)
def test_printed_numbers_are_numbers_with_a_source(name):
    frame = reported.load(name)
    assert not frame.duplicated(["row", "metric", "category"]).any()
    assert frame["source"].str.len().min() > 10
    assert set(frame["row"]) <= {LAYOUTS[name].reported_as.get(row.label, row.label) for row in LAYOUTS[name].rows}
    values = pd.to_numeric(frame["value"].replace("", np.nan))
    assert values.between(0, 100).sum() == (frame["value"] != "").sum()
    # As reported, every row has all of its metrics and categories, and bold marks a best value.
    assert frame.groupby("row").size().nunique() <= 2
    for (_, metric), column in frame[frame["bold"]].groupby(["category", "metric"]):
        assert pd.to_numeric(column["value"]).nunique() <= 2, metric


def test_printed_numbers_agree_with_each_other():
    one, two = (reported.load(name).set_index(["row", "metric", "category"])["value"] for name in reported.TABLES[:2])
    assert (one.loc["ViewNet"] == two.loc["ViewNet"]).all()
    three = (
        reported.load("table3_pascal3d")
        .set_index(["row", "metric", "category"])["value"]
        .sort_index()
        .replace("", np.nan)
    )
    printed, corrected = (three.loc[row, "median"].astype(float) for row in ("Liao", "Liao (corrected)"))
    # Both were rounded to 0.1, one of them before the division.
    assert (corrected / np.sqrt(2) - printed).abs().max() < 0.05 + 0.05 / np.sqrt(2)
    assert len(three.loc["SSV*"].dropna()) == 6


def test_unreadable_prints_are_named(tmp_path, monkeypatch):
    (tmp_path / "paper_tables" / "published").mkdir(parents=True)
    monkeypatch.setenv("VIEWNET_ROOT", str(tmp_path))
    with pytest.raises(ViewnetError, match=r"table1_shapenet\.csv: no such file"):
        reported.load("table1_shapenet")
    (tmp_path / "paper_tables" / "published" / "table1_shapenet.csv").write_text("row,value\nMVC,1\n")
    with pytest.raises(ViewnetError, match=r"column 'metric' is missing: expected row, metric"):
        reported.load("table1_shapenet")


def test_a_table_is_made_again_from_the_predictions_beside_it(table, tmp_path):
    path = next(path for path in table.write(tmp_path) if path.suffix == ".json")
    assert kept_predictions.differences(path).empty
    again = kept_predictions.remade(path)
    assert (again.name, again.note, again.rows) == (table.name, table.note, table.rows)
    assert again.cells["measured"].equals(table.cells["measured"])  # to the last digit, though fewer are kept
    about = json.loads(path.read_text())
    changed = next(each for each in about["cells"] if each["measured"] is not None)
    changed["measured"] += 1
    path.write_text(json.dumps(about))
    (line,) = kept_predictions.differences(path).to_dict("records")
    assert (line["row"], line["what"]) == (changed["row"], "measured")
    path.with_suffix(".parquet").unlink()
    with pytest.raises(ViewnetError, match=r"table2_ablation\.parquet: no such file"):
        kept_predictions.remade(path)
