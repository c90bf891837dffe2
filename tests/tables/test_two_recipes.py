"""Rows of two recipes in one table, comparisons of rows, other definitions, and alignments that determine nothing."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from helpers.evaluation_data import make_index, noisy
from helpers.latex import assert_tabular
from helpers.tables import cell_of

from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predictions import Predictions
from viewnet.experiments.page import blocks
from viewnet.tables import definitions, kept_predictions
from viewnet.tables import table as table_module
from viewnet.tables.table import DEGENERATE, Entry, Table, named

VARIANTS = {"ViewNet": "viewnet", "Single-head": "single_head"}


def entry(row: str, recipe: str, degrees: float, seed: int = 0, predictions: Predictions | None = None) -> Entry:
    """A made-up run on cars whose selected viewpoints are off by some degrees."""
    predictions = predictions or noisy(make_index(120, 5), degrees, seed=seed)
    origin = {"variant": VARIANTS[row], "recipe": recipe}
    return Entry(row, "car", seed, "procrustes", f"{recipe}{row[0]}{seed}", predictions, origin)


def nearly_constant(seed: int) -> Predictions:
    """Predictions that differ by a degree or so, whatever is seen."""
    wide = noisy(make_index(120, 5), seed=seed)
    vectors = wide.hypotheses[:1] + 0.02 * wide.hypotheses
    return Predictions(wide.ids, vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), wide.logits)


@pytest.fixture(scope="module")
def table() -> Table:
    """ViewNet by two recipes, two seeds each, and the single head by one of them, without spread."""
    own = [
        entry("ViewNet", recipe, 5 + 25 * (recipe == "paper"), seed)
        for recipe in ("paper", "matting")
        for seed in (0, 1)
    ]
    single = [entry("Single-head", "matting", 5, seed, nearly_constant(seed)) for seed in (0, 1)]
    return Table.of("table2_ablation", [*own, *single], ["car"])


@pytest.mark.parametrize("label", ["ViewNet", "ViewNet*", "ViewNet (robust)", "+ Objectron, weak masks (robust)"])
@pytest.mark.parametrize("recipe", ["", "paper", "photos"])
def test_names_say_the_recipe_within_one_pair_of_brackets(label, recipe):
    assert (recipe in named(label, recipe)) and named(label, recipe).count("(") <= 1


def test_each_recipe_is_a_row_with_the_reported_number_beside_it(table):
    assert table.rows[:3] == ("ViewNet (paper)", "ViewNet (matting)", "Single-head (matting)")
    lines = {row: cell_of(table, row, "car", "acc30") for row in table.rows}
    assert lines["ViewNet (paper)"]["measured"] < lines["ViewNet (matting)"]["measured"]
    assert {lines[row]["printed"] for row in table.rows[:2]} == {"89"}
    assert lines["ViewNet (paper)"]["runs"].split() == ["paperV0", "paperV1"]
    assert lines["No Shape Prior"]["seeds"] == 0


def test_rows_are_compared_only_where_a_difference_is_measured(table):
    text = table.comparison("ViewNet (paper)", "ViewNet (matting)", "car")
    assert "points lower [-" in text
    same = table.comparison("ViewNet (matting)", "ViewNet (matting)", "car")
    assert same.startswith("no difference measured [")
    assert table.comparison("No Shape Prior", "ViewNet (paper)", "car") is None
    assert table.comparison("Single-head (matting)", "ViewNet (matting)", "car") == "no score"


def test_the_reference_of_a_row_is_of_its_own_recipe(table):
    (sentence,) = (line for line in table.verdict() if line.startswith("Single-head (matting) "))
    assert sentence.startswith("Single-head (matting) beside ViewNet (matting), Acc@30: car ")
    assert not any(line.startswith("ViewNet (") for line in table.verdict())


def test_an_alignment_that_determines_nothing_is_flagged_and_never_best(table, tmp_path):
    cell = cell_of(table, "Single-head (matting)", "car", "acc30")
    assert cell["degenerate"] == 2
    assert cell_of(table, "ViewNet (matting)", "car", "acc30")["degenerate"] == 0
    assert table.frame().loc["Single-head (matting)", ("acc30", "car", "ours")] == f"({cell['measured']:.0f})"
    assert DEGENERATE in table.remarks
    text = table.latex()
    assert_tabular(text)
    assert f"& ({cell['measured']:.0f}) &" in text
    path = next(path for path in table.write(tmp_path) if path.suffix == ".json")
    page = blocks.tables({path.name: path})
    shown = page.blocks[0].parts[0][1]["Single-head (matting)"][0]
    assert shown["degenerate"] and "best" not in shown


def test_recipes_survive_the_files(table, tmp_path):
    path = next(path for path in table.write(tmp_path) if path.suffix == ".json")
    assert kept_predictions.differences(path).empty
    again = kept_predictions.remade(path)
    assert again.rows == table.rows and again.remarks == table.remarks
    columns = ["row", "recipe", "seeds", "degenerate", "runs"]
    pd.testing.assert_frame_equal(again.cells[columns], table.cells[columns])
    assert {cell["recipe"] for cell in json.loads(path.read_text())["cells"]} == {"", "paper", "matting"}


def test_an_alignment_of_predictions_is_fitted_once(monkeypatch, tmp_path):
    fitted = []

    def counted(predictions, *arguments):
        fitted.append(arguments[0])
        return align(predictions, *arguments)

    monkeypatch.setattr(table_module, "align", counted)
    table = Table.of("table2_ablation", [entry("ViewNet", "matting", 5), entry("Single-head", "matting", 5)], ["car"])
    table.verdict()
    table.comparison("Single-head (matting)", "ViewNet (matting)", "car")
    table.write(tmp_path)
    definitions.of_seeds(table)
    definitions.write(table, tmp_path)
    kinds = ("half_turns", "procrustes", "quarter_turns", "robust", "yaw")
    assert sorted(fitted) == [kind for kind in kinds for _ in range(2)]


def test_other_definitions_stand_beside_the_headline(table, tmp_path):
    found = definitions.by_definition(table)
    ours = found.loc[("ViewNet (matting)", "car")]
    assert ours["geodesic_acc30"] == pytest.approx(
        cell_of(table, "ViewNet (matting)", "car", "acc30")["measured"], abs=1e-3
    )
    assert ours["folded_acc30"] >= ours["geodesic_acc30"]  # the second head faces back
    assert ours["robust_acc30"] == pytest.approx(ours["geodesic_acc30"], abs=5)
    assert ours["yaw_acc30"] < 60  # their vertical is not the world's
    assert (ours["seeds"], ours["degenerate"]) == (2, 0) and ours["spread"] > 0.5
    assert ours["best_head_acc30"] >= ours["robust_acc30"] and ours["best_of_24_acc30"] >= ours["geodesic_acc30"]
    assert 0 <= ours["half_turns"] <= 100 - ours["robust_acc30"]
    assert ours["robust_acc30"] <= ours["up_to_half_turns_acc30"] <= ours["up_to_quarter_turns_acc30"]
    assert found.loc[("Single-head (matting)", "car"), "degenerate"] == 2
    path = definitions.write(table, tmp_path)
    assert len(pd.read_csv(path)) == 3
    (block,) = blocks.tables({path.name: path}).blocks
    assert "ViewNet (matting)" in block.html
