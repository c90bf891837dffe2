"""Verdicts on claims follow from cells and predictions by rule; the committed claims name what is there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.evaluation_data import make_index, noisy

from viewnet import cli, paths
from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Predictions
from viewnet.runtime.files import read_json, write_json
from viewnet.tables import claims, reported
from viewnet.tables.claims import CANNOT, FAILS, HOLDS, INCONCLUSIVE, Claim, Finding, Judged
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry, Table

COMMITTED = paths.part("paper_tables")
VARIANTS = {row.label: row.variant for row in LAYOUTS["table2_ablation"].rows}
ENTRY = """
[[claim]]
id = "made_up"
says = "One row is higher than another."
place = "Table 2"
criterion = "It is."
scope = "SCOPE"
"""


def without_spread(predictions: Predictions) -> Predictions:
    """Hypotheses that differ by a degree or so, whatever is seen."""
    vectors = predictions.hypotheses[:1] + 0.02 * predictions.hypotheses
    return Predictions(predictions.ids, vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), predictions.logits)


def entry(row: str, predictions: Predictions, category: str = "car", seed: int = 0) -> Entry:
    origin = {"variant": VARIANTS[row], "recipe": "matting"}
    how = (row, category, seed, "procrustes", f"{VARIANTS[row]}{category}{seed}", predictions, origin)
    return Entry(*how)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder with an ablation study: three seeds a row, but for Encoder-Decoder."""
    own = []
    for seed in range(3):
        for category in ("car", "chair"):
            index = make_index(60, 4, category)
            right, rough = (noisy(index, degrees, seed=seed) for degrees in (5, 30))
            better = {"car": (rough, right), "chair": (right, rough)}[category]
            for row, predictions in zip(("ViewNet", "Segmentation Target"), better, strict=True):
                own.append(entry(row, predictions, category, seed))
        cars = noisy(make_index(60, 4), 5, seed=seed)
        own += [
            entry("No Shape Prior", noisy(make_index(60, 4), 30, seed=seed), seed=seed),
            entry("Single-head", without_spread(cars), seed=seed),
            entry("ViewNet without search", without_spread(cars), seed=seed),
            entry("HoloGAN-Decoder", without_spread(cars) if seed else cars, seed=seed),
        ]
    own += [entry("Encoder-Decoder", noisy(make_index(60, 4), 5, seed=seed), seed=seed) for seed in (0, 1)]
    own.append(entry("Constant", noisy(make_index(60, 4), 80, seed=0)))
    folder = tmp_path_factory.mktemp("claims")
    Table.of("table2_ablation", own, ["car", "chair"], "made-up models").write(folder)
    lines = [(seed, side, 10 - side + seed / 10) for seed in range(3) for side in (1.0, 2.0, 4.0)]
    study = pd.DataFrame(lines, columns=["seed", "side", "spread"]).assign(category="car", predictor="ViewNet")
    study.to_csv(folder / "study.csv", index=False)
    pd.DataFrame({"category": ["bus"], "test_set": ["all"], "bound": [14.2]}).to_csv(folder / "audit.csv", index=False)
    cells = [("ViewNet", "viewnet", 3, 23.0, 24.0), ("No Shape Prior", "no_shape_prior", 3, 21.0, 22.0)]
    cells += [("Encoder-Decoder", "encoder_decoder", 3, 23.5, 25.0), ("Appearance view", "", 1, 18.0, 19.0)]
    frame = pd.DataFrame(cells, columns=["row", "variant", "seeds", "low", "high"])
    frame = frame.assign(category="car", metric="psnr", measured=(frame["low"] + frame["high"]) / 2)
    frame.to_csv(folder / "novel_views.csv", index=False)
    (folder / "figure.png").touch()
    return folder


@pytest.fixture
def folder(made, tmp_path) -> Path:
    """The same files, each test's own."""
    for path in made.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def judged(folder: Path, *rules: str, scope: str = "toy", entry: str = ENTRY) -> Judged:
    text = "".join(f"\n[[claim.rules]]\n{rule}\n" for rule in rules)
    (folder / claims.NAME).write_text(entry.replace("SCOPE", scope) + text)
    (each,) = claims.judge(folder)
    return each


def compared(row: str, bounds: str, reference: str = "ViewNet", categories: str = '"car"', more: str = "") -> str:
    about = f'file = "table2_ablation.json"\nrow = "{row}"\nreference = "{reference}"\ncategories = [{categories}]\n'
    return about + "\n".join([*bounds.split(), more]).replace("=", " = ")


def valued(metric: str, bounds: str, row: str = "ViewNet") -> str:
    return f'file = "table2_ablation.json"\nrow = "{row}"\nmetric = "{metric}"\ncategories = ["car"]\n{bounds}'


def of_study(bounds: str, along: str = "side") -> str:
    about = 'file = "study.csv"\nwhere = ["predictor=ViewNet"]\ncolumn = "spread"\ncategories = ["car"]\n'
    return f'{about}along = "{along}"\n{bounds}'


def fidelity(row: str, reference: str, bounds: str) -> str:
    about = f'file = "novel_views.csv"\nrow = "{row}"\nreference = "{reference}"\n'
    return f'{about}metric = "psnr"\ncategories = ["car"]\n{bounds}'


AUDIT = 'file = "audit.csv"\nwhere = ["test_set=all"]\ncolumn = "bound"\ncategories = ["bus"]\n'
LOST = "Single-head"
CASES = {
    "higher": ([compared("Segmentation Target", "over=0")], HOLDS),
    "on the other side": ([compared("Segmentation Target", "under=0")], FAILS),
    "on the other side in one category": (
        [compared("Segmentation Target", "over=0", "ViewNet", '"car", "chair"')],
        FAILS,
    ),
    "one of two rules": ([compared("Segmentation Target", b) for b in ("over=0", "under=0")], FAILS),
    "alike": ([compared("No Shape Prior", "over=-20 under=20")], HOLDS),
    "not alike": ([compared("Segmentation Target", "over=-20 under=20")], FAILS),
    "no higher, no lower": ([compared("No Shape Prior", "over=0")], INCONCLUSIVE),
    "two seeds": ([compared("Encoder-Decoder", "over=0")], INCONCLUSIVE),
    "two seeds of the reference": ([compared("ViewNet", "under=0", "Encoder-Decoder")], INCONCLUSIVE),
    "a constant needs no seeds": ([compared("ViewNet", "over=0", "Constant")], HOLDS),
    "no score is not higher": ([compared(LOST, "over=0")], FAILS),
    "no score is lower": ([compared(LOST, "under=0")], HOLDS),
    "no score is not alike": ([compared(LOST, "over=-20 under=20")], FAILS),
    "higher than no score": ([compared("ViewNet", "over=0", LOST)], HOLDS),
    "two without a score": ([compared(LOST, "under=0", "ViewNet without search")], INCONCLUSIVE),
    "some seeds without a score": ([compared("HoloGAN-Decoder", "under=0")], INCONCLUSIVE),
    "not measured": ([compared("ViewNet", "over=0", "Random")], CANNOT),
    "one rule fails, one row is not measured": (
        [compared("ViewNet", "over=0", "Random"), compared("Segmentation Target", "under=0")],
        FAILS,
    ),
    "a value": ([valued("acc30", "over = 10")], HOLDS),
    "a value below": ([valued("acc30", "under = 10")], FAILS),
    "a value without a score": ([valued("acc30", "over = 1", LOST)], INCONCLUSIVE),
    "errors": ([valued("symmetric errors", "under = 90")], HOLDS),
    "kinds of errors": ([valued("half turns minus mirrored", "over = 90")], FAILS),
    "selection": ([valued("selected minus best", "under = 0")], HOLDS),
    "a measure without a score": ([valued("symmetric errors", "over = 1", LOST)], INCONCLUSIVE),
    "rank correlation": ([of_study("under = 0")], HOLDS),
    "a line": ([AUDIT + "under = 20"], HOLDS),
    "a line beyond": ([AUDIT + "over = 18.5"], FAILS),
    "intervals apart": ([fidelity("No Shape Prior", "ViewNet", "under = 0")], HOLDS),
    "intervals that overlap": ([fidelity("Encoder-Decoder", "ViewNet", "over = 0")], INCONCLUSIVE),
    "a view needs no seeds": ([fidelity("ViewNet", "Appearance view", "over = 0")], HOLDS),
    "nothing kept": (['file = "figure.png"\ncannot = "no numbers are kept"'], CANNOT),
}


@pytest.mark.parametrize("name", CASES)
def test_each_outcome_is_reached_by_its_rule(name, folder):
    rules, outcome = CASES[name]
    each = judged(folder, *rules)
    assert each.verdict == (f"toy scale: {outcome}" if outcome in (HOLDS, FAILS) else outcome), each.evidence


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        ([(HOLDS, "matting"), (HOLDS, "paper")], "verified"),
        ([(HOLDS, "matting"), (FAILS, "paper")], INCONCLUSIVE),
        ([(HOLDS, "matting"), (INCONCLUSIVE, "paper")], "verified"),
        ([(FAILS, "matting"), (CANNOT, "paper")], "not reproduced"),
        ([(INCONCLUSIVE, "matting"), (CANNOT, "paper")], INCONCLUSIVE),
        ([(HOLDS, "matting"), (FAILS, "")], "not reproduced"),
        ([(HOLDS, "matting"), (INCONCLUSIVE, "matting"), (HOLDS, "paper")], "verified"),
        ([(HOLDS, "matting"), (INCONCLUSIVE, "")], INCONCLUSIVE),
        ([(HOLDS, ""), (CANNOT, "")], CANNOT),
    ],
)
def test_recipes_are_judged_apart(found, verdict):
    claim = Claim("made_up", "", "", "", "full", ())
    findings = tuple(Finding(outcome, "", "", "", recipe) for outcome, recipe in found)
    assert Judged(claim, findings).verdict == verdict


def test_a_planted_cell_changes_the_verdict(folder):
    rule = compared("Segmentation Target", "over=0")
    path = folder / "table2_ablation.json"
    content = read_json(path)
    for cell in content["cells"]:
        if cell["row"] == "ViewNet (matting)" and cell["category"] == "car":
            cell["seeds"] = 2
    write_json(path, content)
    assert judged(folder, rule).verdict == INCONCLUSIVE
    for cell in content["cells"]:
        cell["seeds"] = 3
        cell["degenerate"] = 3 * (cell["row"] == "Segmentation Target (matting)")
    write_json(path, content)
    assert judged(folder, rule).verdict == "toy scale: does not hold"


def test_a_planted_prediction_changes_the_verdict(folder):
    path = folder / "table2_ablation.parquet"
    frame = pd.read_parquet(path)
    mine = frame["run"].str.startswith("segmentation_targetcar") & (frame["split"] == "test")
    frame.loc[mine, "logit_1"] = 100.0
    frame.to_parquet(path, index=False)
    assert judged(folder, compared("Segmentation Target", "over=0")).verdict == "toy scale: does not hold"


def test_without_predictions_the_interval_is_the_widest(folder):
    rule = compared("Segmentation Target", "over=0")
    narrow = judged(folder, rule)
    (folder / "table2_ablation.parquet").unlink()
    wide = judged(folder, rule)
    low, high = (json.loads(each.findings[0].text.removeprefix("car ").partition(" ")[2]) for each in (narrow, wide))
    assert high[0] < low[0] < low[1] < high[1]
    with pytest.raises(ViewnetError, match="no predictions"):
        judged(folder, valued("symmetric errors", "over = 0"))


def test_a_study_of_two_seeds_says_nothing(folder):
    frame = pd.read_csv(folder / "study.csv")
    frame[frame["seed"] < 2].to_csv(folder / "study.csv", index=False)
    each = judged(folder, of_study("under = 0"))
    assert each.verdict == INCONCLUSIVE and "2 seeds of the 3 needed" in each.evidence[0]


@pytest.mark.parametrize(
    ("rule", "subject"),
    [
        (compared("Two heads", "over=0"), "'Two heads'"),
        (compared("ViewNet", "over=0", "Two heads"), "'Two heads'"),
        (compared("ViewNet", "over=0", "Constant", '"boat"'), "'boat'"),
        (compared("ViewNet", "over=0", "Constant", more='metric="dva"'), "'dva'"),
        (compared("ViewNet", "", "Constant"), "bound"),
        (compared("ViewNet", "over=0", "Constant", ""), "categories"),
        (compared("ViewNet", "over=0", "Constant", more='row_of="x"'), "row_of"),
        (compared("ViewNet", "over=0").replace("table2", "table9"), "table9_ablation.json: no such file"),
        ('file = "nothing.png"\ncannot = "no numbers"', "nothing.png: no such file"),
        (AUDIT.replace("bound", "height") + "over = 0", "'height'"),
        (AUDIT.replace("test_set=", "set=") + "over = 0", "'set'"),
        (AUDIT.replace("=all", "=none") + "over = 0", "0 lines"),
        (of_study("over = 0", "turn"), "'turn'"),
        (of_study("over = 0").replace('along = "side"', ""), "9 lines"),
    ],
)
def test_what_is_not_there_is_an_error_and_never_a_verdict(rule, subject, folder):
    with pytest.raises(ViewnetError) as error:
        judged(folder, rule)
    assert claims.NAME in str(error.value) and subject in str(error.value)


@pytest.mark.parametrize(
    ("text", "subject"),
    [
        ("[[claim", "not a list of claims"),
        ("claims = 1", "not a list of claims"),
        (ENTRY.replace("SCOPE", "toy") + "rules = []", "'made_up' has no rule"),
        (ENTRY.replace("SCOPE", "half") + "rules = []", "half"),
        (ENTRY.replace("SCOPE", "toy").replace("criterion", "criteria") + "rules = []", "criteria"),
        (2 * (ENTRY.replace("SCOPE", "toy") + 'rules = [{file = "a", cannot = "b"}]\n'), "'made_up'"),
    ],
)
def test_a_file_that_is_no_list_of_claims_is_told(text, subject, tmp_path):
    (tmp_path / claims.NAME).write_text(text)
    with pytest.raises(ViewnetError) as error:
        claims.judge(tmp_path)
    assert claims.NAME in str(error.value) and subject in str(error.value)


def test_the_command_prints_counts_and_verdicts(folder, monkeypatch, capsys):
    monkeypatch.setenv("VIEWNET_TABLES", str(folder))
    each = judged(folder, compared("Segmentation Target", "over=0"))
    assert cli.main(["tables", "--claims"]) == 0
    assert capsys.readouterr().out.splitlines() == ["1 claim: 1 toy scale: holds", str(each)]
    assert cli.main(["tables", "--claims", "--json"]) == 0
    (value,) = json.loads(capsys.readouterr().out)
    assert value["verdict"] == each.verdict and value["recipes"] == {"matting": HOLDS} and value["evidence"]
    (folder / claims.NAME).unlink()
    assert cli.main(["tables", "--claims"]) == 2
    assert claims.NAME in capsys.readouterr().err


# The committed claims


@pytest.fixture(scope="module")
def committed() -> list[Judged]:
    return claims.judge(COMMITTED)


def test_every_committed_rule_names_what_is_there(committed):
    assert [each.claim for each in committed] == list(claims.read(COMMITTED))
    for each in committed:
        assert each.verdict in claims.VERDICTS
        assert len(each.findings) >= len(each.claim.rules)
        assert all(text.endswith(".") for text in (each.claim.says, each.claim.criterion))


def test_every_method_of_the_ablation_study_and_of_table_1_has_a_claim(committed):
    rules = [rule for each in committed for rule in each.claim.rules]
    named = {name for rule in rules for name in (rule.row, rule.reference)}
    constants = {part for rule in rules for part in rule.where}
    for table in ("table1_shapenet", "table2_ablation"):
        assert set(reported.load(table)["row"]) - {"Constant"} <= named
    assert "table=table2_ablation" in constants


def test_only_what_the_data_decide_is_in_full(committed):
    """Neither tiny networks nor built-in models verify what the paper says of ShapeNet and PASCAL3D+."""
    for rule in (rule for each in committed if each.claim.scope == "full" for rule in each.claim.rules):
        if rule.file.endswith(".json"):
            assert {run.get("profile", "paper") for run in read_json(COMMITTED / rule.file)["runs"].values()} == {
                "paper"
            }
        else:
            assert not {"seed", "seeds"} & set(pd.read_csv(COMMITTED / rule.file).columns)


def test_criteria_of_no_difference_name_their_margin(committed):
    for each in committed:
        for rule in each.claim.rules:
            if rule.over is not None and rule.under is not None:
                assert rule.over == -rule.under and f"{rule.under:g} points" in each.claim.criterion


@pytest.mark.parametrize("table", reported.TABLES)
def test_notes_stand_beside_numbers_that_were_measured_otherwise(table):
    lines = reported.notes(table)
    numbers = reported.load(table)
    assert sum(len(line.partition(": ")[0].split("; ")) for line in lines) == numbers["row"].nunique()
    assert all(line.startswith("reported for ") for line in lines)
