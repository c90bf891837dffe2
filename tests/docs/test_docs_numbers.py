"""Numbers in the documents that a committed file holds are that file's.

Each text below stands in its page with the numbers filled in. Where a text is worded anew, word it anew here as well.
"""

from __future__ import annotations

import json
import re
import tomllib

import numpy as np
import pandas as pd
import pytest
from helpers.documents import ROOT, page
from test_switches import switches

from viewnet.config import make_config
from viewnet.estimator import hub
from viewnet.estimator.model_card import with_interval

TABLES = ROOT / "paper_tables"
THREE = ("aeroplane", "car", "chair")
TABLE2, REAL, STAND_IN = "table2_ablation.csv", "real_cars/table3_pascal3d.csv", "table3_pascal3d.csv"
REAL_DVA, STAND_IN_DVA, VIEWS = "real_cars/table5_dva.csv", "table5_dva.csv", "novel_views.csv"
BENCH64, BENCH8 = "benchmarks/batch64/bench.csv", "benchmarks/bench.csv"
AMX64, LEARNT = "benchmarks/batch64_amx/bench.csv", "benchmarks/time_to_accuracy/bench.csv"
README, RECIPES, SPEED, MODELS = "README.md", "docs/recipes.md", "docs/speed.md", "docs/models.md"
SCORES = ("median, degrees", "half turns, %")
HEADINGS = (
    "own test views: within 30 degrees, %",
    *SCORES,
    "stand-in for photographs: within 30 degrees, %",
    *SCORES,
)


def cell(file: str, row: str, category: str, metric: str, column: str = "measured") -> float:
    frame = pd.read_csv(TABLES / file)
    (found,) = frame.loc[(frame["row"] == row) & (frame["category"] == category) & (frame["metric"] == metric), column]
    return found


def across(file: str, row: str, metric: str, categories=THREE, column: str = "measured") -> list[float]:
    return [cell(file, row, category, metric, column) for category in categories]


def against(file: str, row: str, column: str = "measured") -> list[float]:
    """Accuracy less ViewNet's, by category."""
    both = zip(across(file, row, "acc30", column=column), across(file, "ViewNet", "acc30", column=column), strict=True)
    return [float(one) - float(viewnet) for one, viewnet in both]


def scores(row: str) -> list[float]:
    """Accuracy, median and DVA on real cars."""
    return [*(cell(REAL, row, "car", metric) for metric in ("acc30", "median")), cell(REAL_DVA, row, "car", "dva")]


def bench(file: str, work: str, column: str, volume: str = "object", size: int = 64) -> float:
    frame = pd.read_csv(TABLES / file)
    rows = (frame["work"] == work) & (frame["volume"] == volume) & (frame["size"] == size) & (frame["device"] == "cpu")
    (found,) = frame.loc[rows, column]
    return found


def seconds(category: str, accuracy: float) -> list[float]:
    """Of training until validation accuracy was first so high, by seed."""
    log = pd.read_csv(TABLES / "benchmarks" / "accuracy.csv")
    log = log[(log["category"] == category) & (log["val_accuracy"] >= accuracy)]
    return log.groupby("seed")["seconds"].min().tolist()


def steps() -> int:
    config = make_config()
    views = 0.7 * config.data.models * config.data.views
    return config.train.epochs * int(views / config.train.batch_size)


def judged(metric: str, hologan: bool) -> list[float]:
    frame = pd.read_csv(TABLES / VIEWS).dropna(subset="measured")
    rows = (frame["row"] == "HoloGAN-Decoder") == hologan
    return frame.loc[rows & (frame["metric"] == metric), "measured"].agg(["min", "max"]).tolist()


def constants() -> list[float]:
    frame = pd.read_csv(TABLES / STAND_IN_DVA)
    return frame.loc[frame["row"].str.startswith("Constant"), "measured"].agg(["min", "max"]).tolist()


def drawing() -> list[float]:
    frame = pd.concat([pd.read_csv(TABLES / file) for file in (BENCH64, AMX64)])
    rows = frame["work"].str.startswith("renderer, forward + backward") & (frame["device"] == "cpu")
    return frame.loc[rows, "speedup"].agg(["min", "max"]).tolist()


def fuzzed() -> str:
    return f"{pd.read_csv(TABLES / 'trust' / 'fuzz.csv')['cases'].sum():,}"


def saved(category: str) -> dict:
    """What a model that comes along says of itself."""
    return json.loads((hub.SHIPPED / category / "config.json").read_text())["about"]


def on_real_cars() -> list[float]:
    (found,) = (one["alignments"]["own"] for one in saved("car")["scores"] if "StanfordCars" in one["on"])
    intervals = found["intervals"]
    measured = [value for name in ("acc30", "median", "dva") for value in (found[name], *intervals[name])]
    return [found["images"], *measured, found["flips"], found["oracle"]["acc30"]]


def answers(what: str, column: str = "median") -> float:
    """A row of benchmarks/predicting.csv."""
    return pd.read_csv(TABLES / "benchmarks" / "predicting.csv").set_index("what").loc[what, column]


def trusted(file: str, *columns: str) -> list[int]:
    """Sums of a report's columns."""
    return pd.read_csv(TABLES / "trust" / f"{file}.csv")[list(columns)].sum().tolist()


TEXTS = [
    (
        "docs/trust.md",
        "work was killed {} times, and begun {} times to be killed; it ended as undisturbed work {} times, with {} "
        "files damaged or left over. In {} of {} pairs",
        lambda: [
            *trusted("crashes", "kills", "trials", "identical", "damaged_or_left"),
            *trusted("pairs", "same", "pairs"),
        ],
    ),
    (
        MODELS,
        "Of {:.0f} of Stanford Cars, with viewpoints in PASCAL3D+'s convention, it is within 30 degrees on {:.1f} "
        "[{:.1f}, {:.1f}] %, median {:.1f} [{:.1f}, {:.1f}] degrees, DVA {:.1f} [{:.1f}, {:.1f}] %, by the rotation "
        "that it is saved with. {:.1f} % are half turns, front and back exchanged: the best of its three hypotheses is "
        "within 30 degrees on {:.1f} %",
        on_real_cars,
    ),
    (
        README,
        "One answer from a fresh interpreter takes {:.1f} seconds on two cores, {:.1f} of them PyTorch's import",
        lambda: [answers("viewnet predict"), answers("a fresh interpreter, import torch")],
    ),
    (README, "with {} steps of training a model", lambda: [steps()]),
    (
        README,
        "within 30 degrees on {:.1f} % of {:.0f} others [{:.1f}, {:.1f}], median {:.1f} degrees, DVA {:.1f} %",
        lambda: [
            *(
                cell(REAL, "ViewNet + cycle", "car", "acc30", column)
                for column in ("measured", "images", "low", "high")
            ),
            *scores("ViewNet + cycle")[1:],
        ],
    ),
    (README, "without it {:.1f} %, {:.1f} and {:.1f} %", lambda: scores("ViewNet")),
    (README, "the mean of the 300, gets {:.1f} %, {:.1f} and {:.1f} %", lambda: scores("Constant (rotation)")),
    (README, "of the same 300 gets {:.1f} %, {:.1f} and {:.1f} %", lambda: scores("VGG view* (squeezenet1_1)")),
    (
        README,
        "ViewNet's DVA is {:.0f}, {:.0f} and {:.0f} % on aeroplanes, cars and chairs by the robust rotation, "
        "the regression's {:.0f}, {:.0f} and {:.0f} %, a constant's {:.0f} to {:.0f} %",
        lambda: [
            *across(STAND_IN_DVA, "ViewNet (robust)", "dva"),
            *across(STAND_IN_DVA, "VGG view* (pixels)", "dva"),
            *constants(),
        ],
    ),
    (
        README,
        "seen mostly from the front ({:.0f} % within 30 degrees). The linear alignment of the starred rows has "
        "{:.0f} % in accuracy there, and {:.0f} % in DVA",
        lambda: [
            cell(STAND_IN, "ViewNet", "chair", "acc30"),
            cell(STAND_IN, "ViewNet*", "chair", "acc30"),
            cell(STAND_IN_DVA, "ViewNet*", "chair", "dva"),
        ],
    ),
    (
        README,
        "a PSNR of {:.1f} dB on cars, where that other view itself has {:.1f}, and masks that overlap to {:.0f} %",
        lambda: [
            cell(VIEWS, "ViewNet", "car", "psnr"),
            cell(VIEWS, "Appearance view", "car", "psnr"),
            100 * cell(VIEWS, "ViewNet", "car", "iou"),
        ],
    ),
    (README, "HoloGAN decoder draws worse ({:.1f} dB)", lambda: [cell(VIEWS, "HoloGAN-Decoder", "car", "psnr")]),
    (
        README,
        "on {:.0f} to {:.0f} %, ViewNet's on {:.0f} to {:.0f} %, where other models have {:.0f} to {:.0f} %",
        lambda: [
            *judged("consistency_acc30", hologan=True),
            *judged("judged_acc30", hologan=True),
            *judged("judged_acc30", hologan=False),
        ],
    ),
    (
        README,
        "takes {:.1f} seconds with AMX and {:.1f} with AVX-512, where a textbook version of the same step in plain "
        "PyTorch takes {:.0f} and {:.0f} seconds and four times",
        lambda: [
            bench(file, "training step, paper", f"{version}_s")
            for version in ("viewnet", "textbook")
            for file in (AMX64, BENCH64)
        ],
    ),
    (README, "forwards and backwards, is {:.0f} to {:.0f} times as fast", drawing),
    (
        README,
        "80 % of validation views of cars are right after {:.0f} seconds of training, and of aeroplanes after {:.0f}",
        lambda: [bench(LEARNT, "time to 80 % of validation views", "viewnet_s", c, 32) for c in ("car", "aeroplane")],
    ),
    (README, "reads {} damaged files", lambda: [fuzzed()]),
    (
        RECIPES,
        "changes accuracy by {:.0f}, {:.0f} and {:.0f} points on aeroplanes, cars and chairs, "
        "where the paper gains {:.0f}, {:.0f} and {:.0f}",
        lambda: [
            *against("table1_shapenet.csv", "ViewNet + cycle"),
            *against("table1_shapenet.csv", "ViewNet + cycle", "printed"),
        ],
    ),
    (
        RECIPES,
        "is {:.0f} points lower on aeroplanes, {:.0f} on cars and {:.0f} on chairs, "
        "the paper's {:.0f}, {:.0f} and {:.0f}",
        lambda: [-x for c in ("measured", "printed") for x in against(TABLE2, "Single-head", c)],
    ),
    (
        RECIPES,
        "where the paper has it {:.0f}, {:.0f} and {:.0f} lower",
        lambda: [-x for x in against(TABLE2, "Segmentation Target", "printed")],
    ),
    (
        RECIPES,
        "in the paper {:.0f} points on aeroplanes and {:.0f} on chairs",
        lambda: [-x for x in against(TABLE2, "No Shape Prior", "printed")[::2]],
    ),
    (
        RECIPES,
        "is {:.0f} points lower on aeroplanes and {:.0f} higher on chairs",
        lambda: np.multiply([-1, 1], against(TABLE2, "Encoder-Decoder")[::2]),
    ),
    (
        RECIPES,
        "has {:.0f} and {:.0f} points more in accuracy than the robust rotation, and {:.0f} and {:.0f} fewer in DVA",
        lambda: [
            sign * (cell(file, f"{row}*", "chair", metric) - cell(file, f"{row} (robust)", "chair", metric))
            for file, metric, sign in ((STAND_IN, "acc30", 1), (STAND_IN_DVA, "dva", -1))
            for row in ("ViewNet", "ViewNet + cycle")
        ],
    ),
]


@pytest.mark.parametrize(("name", "text", "values"), TEXTS, ids=[text[:50] for _, text, _ in TEXTS])
def test_the_text_has_the_numbers_of_the_file(name, text, values):
    assert text.format(*values()) in page(name).prose


@pytest.mark.parametrize("file", [BENCH64, AMX64])
def test_four_times_the_memory(file):
    assert round(bench(file, "training step, paper", "memory_ratio")) == 4


def test_the_audit_s_verdicts():
    audit = pd.read_csv(TABLES / "viewpoints" / "audit_constants.csv")
    audit = audit[audit["definition"] == "geodesic"]
    beyond = audit.groupby(["table", "category"])["verdict"].agg(lambda verdicts: set(verdicts) == {"excluded"})
    text = "in five of the six categories of Table 3, and in all three of Table 2"
    assert text in page(README).prose
    assert (beyond["table3_pascal3d"].sum(), len(beyond["table3_pascal3d"])) == (5, 6)
    assert beyond["table2_ablation"].tolist() == [True] * 3


def says(text: str, *values: float) -> bool:
    """Whether a cell's numbers, in their order, are these as far as they are written out."""
    numbers = re.findall(r"\d+(?:\.\d+)?", text)
    places = [len(number.partition(".")[2]) for number in numbers]
    near = [abs(float(n) - v) <= 0.501 * 10.0**-k for n, v, k in zip(numbers, values, places, strict=True)]
    return all(near)


@pytest.mark.parametrize(
    ("text", "values", "right"),
    [("6.8", [6.83], True), ("6.8", [6.88], False), ("22", [22.3], True), ("52.9, 53.8", [52.94, 53.75], True),
     ("8523 / 2002 MiB, 4.3", [8522.8, 2001.9, 4.26], True), ("0.83 s", [0.825], True), ("1", [1.2], True)],
)  # fmt: skip
def test_numbers_are_compared_as_far_as_they_are_written_out(text, values, right):
    assert says(text, *values) == right


def test_table_2_in_the_recipes():
    (rows,) = [rows[1:] for rows in page(RECIPES).tables if [row[0] for row in rows[1:2]] == ["ViewNet"]]
    assert len(rows) == 6
    for label, *shown in rows:
        assert shown == [f"{value:.0f}" for value in across(TABLE2, label, "acc30")], label


ON_REAL_CARS = {
    "Constant (mean of camera frames)": "Constant (rotation)",
    "ridge regression from SqueezeNet 1.1's features": "VGG view* (squeezenet1_1)",
    "ViewNet, robust alignment": "ViewNet (robust)",
    "ViewNet + cycle, robust alignment": "ViewNet + cycle (robust)",
    "ViewNet, linear alignment (*)": "ViewNet*",
}
"""Label in the recipes -> row of the table."""


def test_real_cars_in_the_recipes():
    rows = page(RECIPES).table("", "acc@30, %", "median", "DVA, %")
    assert len(rows) == 7
    for label, *shown in rows:
        row = ON_REAL_CARS.get(label, label)
        accuracy, median, dva = scores(row)
        low, high = (cell(REAL, row, "car", "acc30", column) for column in ("low", "high"))
        assert shown == [f"{accuracy:.1f} [{low:.1f}, {high:.1f}]", f"{median:.1f}", f"{dva:.1f}"], label


ON_STAND_IN = {
    "regression from pixels": "VGG view* (pixels)",
    "regression from SqueezeNet 1.1's features": "VGG view* (squeezenet1_1)",
}


def test_the_stand_in_in_the_recipes():
    rows = page(RECIPES).table("acc@30 / DVA, %", *THREE)
    assert len(rows) == 9
    for label, *shown in rows:
        row = ON_STAND_IN.get(label, label)
        place = "tiny-squeezenet1_1/" if "SqueezeNet" in label else ""
        accuracy, dva = across(place + STAND_IN, row, "acc30"), across(place + STAND_IN_DVA, row, "dva")
        assert shown == [f"{a:.0f} / {d:.0f}" for a, d in zip(accuracy, dva, strict=True)], label


IN_SPEED = [
    (BENCH64, AMX64, "training step, paper", "object"),
    (BENCH64, AMX64, "training step, paper", "initial"),
    (BENCH8, None, "training step, paper", "object"),
    (BENCH64, AMX64, "renderer, forward + backward", "object"),
    (BENCH64, AMX64, "renderer, forward + backward (all voxels)", "object"),
    (BENCH64, AMX64, "renderer, forward + backward", "dense"),
]
"""What the rows of the table in docs/speed.md are, on the one machine and on the other; memory is the last one's."""


def test_the_benchmark_in_speed():
    rows = page(SPEED).table("", "AVX-512", "times as fast", "AMX", "times as fast", "memory, MiB")
    for (label, *cells, memory), (*files, work, volume) in zip(rows, IN_SPEED, strict=True):
        for (times, faster), file in zip((cells[:2], cells[2:]), files, strict=True):
            if file is None:
                assert (times, faster) == ("", ""), label
                continue
            assert says(times, *(bench(file, work, f"{name}_s", volume) for name in ("textbook", "viewnet"))), label
            assert says(faster, bench(file, work, "speedup", volume)), label
        if memory:
            file = files[1] or files[0]
            assert says(memory, *(bench(file, work, f"{n}_bytes", volume) / 2**20 for n in ("textbook", "viewnet")))


def test_time_to_accuracy_in_speed():
    rows = page(SPEED).table("", "median", "least and most", "with a search at half the resolution, on the EPYC")
    assert len(rows) == 3
    for label, median, ends, before in rows:
        category, accuracy = re.fullmatch(r"(\w+)s, (\d+) %", label).groups()
        found = [
            bench(LEARNT, f"time to {accuracy} % of validation views", f"viewnet_{name}", category, 32)
            for name in ("s", "low", "high")
        ]
        assert says(median, found[0]) and says(ends, *found[1:]), label
        assert says(before, np.median(seconds(category, float(accuracy)))), label


FREIBURG, OBJECTRON = "table4_freiburg.csv", "objectron.csv"


def test_videos_of_cars():
    rows = page(RECIPES).table("videos of cars", "acc@30, %", "median")
    assert len(rows) == 5
    for label, accuracy, median in rows:
        ends = [cell(FREIBURG, label, "car", "acc30", column) for column in ("measured", "low", "high")]
        assert accuracy == "{:.1f} [{:.1f}, {:.1f}]".format(*ends), label
        assert median == f"{cell(FREIBURG, label, 'car', 'median'):.1f}", label
    regressed, constant = "VGG view (pixels)", "Constant"
    shown = [cell(FREIBURG, row, "car", "acc30") for row in ("ViewNet", "ViewNet + cycle", regressed, constant)]
    text = "on {:.1f} % of the stand-in's photographs, with the cycle on {:.1f} %, a regression fitted on labelled "
    text += "photographs on {:.1f} % and a constant on {:.1f} %"
    assert text.format(*shown) in page(README).prose


def test_videos_of_chairs():
    rows = page(RECIPES).table("", "Procrustes", "robust", "linear (*)")
    assert len(rows) == 3
    for (_, *shown), label in zip(
        rows, ("ShapeNet", *(f"+ Objectron, {m} masks" for m in ("supervised", "weak"))), strict=True
    ):
        by = [cell(OBJECTRON, label + end, "chair", "acc30") for end in ("", " (robust)", "*")]
        assert shown == [f"{value:.0f}" for value in by], label


SWITCHES = {
    "float32 instead of bfloat16": "float32",
    "gradients of empty voxels too": "gradients of empty voxels",
}


def test_switches_in_speed():
    found = switches.summary(pd.read_csv(TABLES / "benchmarks" / "switches.csv"))
    rows = page(SPEED).table("", "seeds", "right", "range", "error", "times as long")
    assert len(rows) == len(found)
    for label, seeds, right, spread, error, longer in rows:
        mine = found.loc[SWITCHES.get(label, label)]
        assert int(seeds) == mine["seeds"], label
        assert (right, error) == (f"{mine['accuracy']:.1f}", f"{mine['reconstruction']:.4f}"), label
        assert spread == f"{mine['accuracy_low']:.1f} to {mine['accuracy_high']:.1f}", label
        assert says(longer, mine["times_as_long"]), label


def test_scores_of_the_models_that_come_along():
    rows = page(MODELS).table("model", *HEADINGS)
    assert [row[0] for row in rows] == hub.shipped()
    for category, *cells in rows:
        about = saved(category)
        (stand_in,) = (one["alignments"]["own"] for one in about["scores"] if "stand-in" in one["on"])
        expected = []
        for found in (about["metrics"]["procrustes"], stand_in):
            expected += [with_interval(found, "acc30"), with_interval(found, "median"), f"{found['flips']:.1f}"]
        assert cells == expected, category


def test_tables_1_and_2_in_the_readme():
    rows = page(README).table("right within 30 degrees, %", *THREE, "median error, degrees: aeroplane", *THREE[1:])
    trained = [row for row in pd.read_csv(TABLES / TABLE2)["row"].drop_duplicates() if row != "Best constant"]
    assert [row[0] for row in rows] == [trained[0], "ViewNet + cycle", *trained[1:]]
    for name, *cells in rows:
        file = "table1_shapenet.csv" if "cycle" in name else TABLE2
        expected = []
        for metric, digits in (("acc30", 0), ("median", 1)):
            both = (across(file, name, metric, column=column) for column in ("measured", "printed"))
            expected += [f"{ours:.1f} ({float(printed):.{digits}f})" for ours, printed in zip(*both, strict=True)]
        assert cells == expected, name


def test_profiles_in_the_readme():
    rows = page(README).table("profile", "seen", "volume and drawings", "recipe", "models", "a training, on one core")
    assert [row[0].split()[0] for row in rows] == ["smoke", "tiny", "pocket", "small", "paper"]
    ablation = json.loads((TABLES / "table2_ablation.json").read_text())["runs"].values()
    trainings = [run["training"] for run in ablation if run.get("training")]
    assert {training["hardware"]["threads"] for training in trainings} == {1}
    smoke = pd.read_csv(TABLES / "trust" / "crashes.csv").set_index("what").loc["run", "undisturbed_s"]
    minutes = np.median([training["seconds"] for training in trainings]) / 60
    assert [row[-1] for row in rows[:2]] == [f"{smoke:.0f} seconds", f"{minutes:.0f} minutes"]
    for name, seen, drawn, recipe, models, _ in rows:
        config = make_config(profile=name.split()[0])
        side, voxels, drawing_ = config.model.input_size, config.model.volume_size, config.model.render_size
        assert seen == f"{side}x{side}"
        assert drawn == f"{voxels}x{voxels}x{voxels}, {drawing_}x{drawing_}"
        assert recipe == config.recipe
        assert models.startswith(f"{config.data.models}" if config.data.models else "all")
    assert "(default)" in rows[1][0]
    assert make_config().profile == "tiny"


IN_DECISIONS = {
    "search": ("search_views", "best of {} viewpoints all around"),
    "choice": ("neighbours", "within {:.0f} degrees"),
    "selection head": ("selection_weight", "weight {}"),
    "selection angle": ("selection_angle", "within {:.0f} degrees of the best"),
    "cycle weight": ("cycle_weight", "weight {}, from 15 %"),
    "muon": ("muon", "Muon at {}"),
    "adam": ("learning_rate", "Adam at 1e{:.0f}"),
    "masks": ("mask_weight", "masks at weight {:.0f}"),
    "pixels": ("pixel_weight", "over the random colour at {}"),
}


@pytest.mark.parametrize(("field", "text"), IN_DECISIONS.values(), ids=IN_DECISIONS)
def test_settings_in_the_decisions(field, text):
    value = getattr(make_config(recipe="matting").train, field)
    shown = np.log10(value) if field == "learning_rate" else value
    assert text.format(shown) in page("docs/decisions.md").prose


def test_the_version_is_the_same_everywhere():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE) == [version]
    assert version in page("CHANGELOG.md").text
