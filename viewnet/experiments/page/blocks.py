"""What the overview page shows of a section's files: tables of reported and measured numbers, and plain tables."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from viewnet.errors import ViewnetError
from viewnet.experiments.alignment_study import Study
from viewnet.experiments.reported_constants import ConstantAudit
from viewnet.runtime import provenance
from viewnet.runtime.files import read_csv, read_json
from viewnet.tables import benchmark, reported
from viewnet.tables.architecture import COLUMNS, Architecture
from viewnet.tables.columns import Column, best, by_key, column_of, upper_bound
from viewnet.tables.kept_predictions import NUMBERS, cells_of
from viewnet.tables.table import run_of

# End of a CSV file's name beside a table -> its title.
BESIDE = {
    "definitions": "By other alignments and definitions of the error",
    "nearest": "How near test models are to those trained on: IoU of silhouettes with the most alike",
}
Files = Mapping[str, Path]  # name -> file
Runs = Mapping[str, dict[str, str]]  # a run's key -> its `origin`, {} where that stands elsewhere


@dataclass(frozen=True)
class MetricTable:
    """Reported and measured numbers, metric by metric."""

    title: str
    categories: tuple[str, ...]
    with_reported: bool
    parts: tuple[tuple[Column, dict[str, list[dict[str, Any]]]], ...]  # metric, and label -> cells by category
    supervision: dict[str, str]  # label -> what is known in training
    bounds: set[str]  # labels of upper bounds


@dataclass(frozen=True)
class PlainTable:
    """A data frame as an HTML table; a long one is `folded`."""

    title: str
    html: Markup
    folded: bool = False


Block = MetricTable | PlainTable


@dataclass(frozen=True)
class Content:
    """The content of a section's files at one setting: tables, notes below them, and the runs behind them."""

    blocks: tuple[Block, ...] = ()
    notes: tuple[str, ...] = ()
    runs: Runs = field(default_factory=dict)


def tables(files: Files) -> Content:
    """Of the JSON files that viewnet.tables.table.Table.write writes."""
    blocks: list[Block] = []
    notes: list[str] = []
    runs: dict[str, dict[str, str]] = {}
    for path in files.values():
        if path.suffix == ".json":
            table = read_json(path)
            blocks.append(metric_table(cells_of(table), table["title"]))
            # Shown once, however many tables.
            notes += [table["measured on"], *table.get("remarks", ()), table["error"], table["interval"]]
            notes += reported.notes(table["table"]) if table["table"] in reported.TABLES else []
            runs |= {run_of(key): origin(run) for key, run in table["runs"].items()}
        if path.suffix == ".csv" and (title := BESIDE.get(path.stem.rpartition("_")[2])):
            blocks.append(plain_table(title, read_csv(path).round(3), folded=True, index=False))
    return Content(tuple(blocks), tuple(dict.fromkeys(notes)), runs)


def origin(run: Mapping[str, Any]) -> dict[str, str]:
    """A run's origin as the page shows it; "" for unknown values."""
    training = run.get("training") or {}
    git, hardware = training.get("git") or run.get("git") or {}, training.get("hardware") or {}
    return {
        "what": " ".join(str(run[name]) for name in ("variant", "category") if name in run),
        **{name: str(run.get(name, "")) for name in ("seed", "profile", "recipe")},
        "commit": provenance.in_words(git) if git.get("commit") else "",
        "date": (training.get("finished") or "")[:10],  # the day, of an ISO time
        "minutes": f"{training['seconds'] / 60:.1f}" if "seconds" in training else "",
        "machine": hardware.get("gpu") or hardware.get("processor") or "",
        "threads": str(hardware.get("threads", "")),
    }


def metric_table(cells: pd.DataFrame, title: str) -> MetricTable:
    """The cells of a table (viewnet.tables.table.Table.cells), metric by metric; {} where a row has none."""
    lines = by_key(cells)
    for key in best(cells, lambda metric: column_of(metric).page_digits):  # of numbers as they are shown
        lines[key]["best"] = True
    categories = tuple(dict.fromkeys(cells["category"]))
    parts = []
    for metric, part in cells.groupby("metric", sort=False):
        rows = {row: [lines.get((row, category, metric), {}) for category in categories] for row in part["row"]}
        parts.append((column_of(metric), rows))
    supervision = dict(zip(cells["row"], cells["supervision"], strict=True))
    bounds = {row for row, words in supervision.items() if upper_bound(words)}
    return MetricTable(title, categories, bool((cells["printed"] != "").any()), tuple(parts), supervision, bounds)


def novel_views(files: Files) -> Content:
    """Of the CSV file that viewnet.tables.novel_view_scores.write writes."""
    cells = read_csv(files["novel_views.csv"], keep_default_na=False, na_values=dict.fromkeys(NUMBERS, ""))
    # Keys alone: where a run is from stands in the JSON files of tables that have it, too.
    keys: Runs = {key: {} for keys in cells["runs"] for key in keys.split()}
    note = "intervals: 95 % percentile bootstrap over seeds and objects"
    table = metric_table(
        cells.assign(printed="", bold=False, degenerate=0, supervision=""), "Scores of rendered novel views"
    )
    return Content((table,), (note,), keys)


def study(files: Files) -> Content:
    """Of the CSV files that viewnet.experiments.alignment_study.Study.write writes."""
    result = Study(*(read_csv(files[f"alignment_study_{name}.csv"]) for name in ("scores", "collapse")))
    names = {"acc30": "accuracy, %", "median": "median error, degrees", "dva": "DVA, %", "per_angle": "per angle"}
    gains = {"spread_linear": "spread left", "acc30_gain": "accuracy added", "dva_gain": "DVA added"}
    question = "Does the linear alignment collapse? Rank correlations with one-sidedness"
    return Content(
        (
            plain_table("By alignment, calibrated on all photographs", result.side_by_side().rename(columns=names)),
            plain_table(question, result.verdict().rename(columns=gains)),
            plain_table("Accuracy (%) by the number of calibration photographs", result.by_count(), folded=True),
            plain_table("Increasingly one-sided photographs", result.collapsed(), folded=True),
        ),
        (
            "by number: medians over draws of the calibration photographs, with the lowest and the highest",
            "the paper's reasoning asks for a correlation below zero with the spread that is left, and above zero with "
            "the accuracy that the linear alignment adds to the rigid one",
        ),
    )


def audit(files: Files) -> Content:
    """Of the CSV files that viewnet.experiments.reported_constants.ConstantAudit.write writes."""
    blocks: list[Block] = []
    names = {"table2_ablation": "Table 2", "table3_pascal3d": "Table 3", "table5_dva": "DVA"}
    # Apart, since what a stand-in says of the reported scores is no evidence.
    for stem, source in (("audit", "a list of annotations"), ("stand_in", "a stand-in for annotations")):
        if f"{stem}_constants.csv" in files:
            # As text: some hold two numbers, as "81 / 33.7".
            constants = read_csv(files[f"{stem}_constants.csv"], dtype={"printed": str}).replace({"table": names})
            confidence = read_csv(files[f"{stem}_confidence.csv"])
            summary = ConstantAudit(constants, confidence, {}, stem == "stand_in").summary()
            title = f"Can a constant reach the reported scores, by each definition of the error? ({source})"
            blocks.append(plain_table(title, summary))
            blocks.append(plain_table(f"Confidence index ({source})", confidence, folded=True, index=False))
    return Content(tuple(blocks))


def architecture(files: Files) -> Content:
    """Layers of viewnet.tables.architecture beside the paper's. ViewnetError for a file with other columns."""
    blocks = []
    for part in ("encoder", "generator"):
        if (name := f"architecture_{part}.csv") in files:
            layers = read_csv(files[name], dtype=str, keep_default_na=False)
            if tuple(layers.columns) != COLUMNS:
                raise ViewnetError(f"{files[name]}: columns are not {', '.join(COLUMNS)}: make it again")
            compared = Architecture(part, layers).comparison()
            # Words: a colour alone would not tell everybody.
            compared["same"] = compared["same"].map({True: "yes", False: "no"})
            above = [*["print"] * len(COLUMNS), *["ours"] * len(COLUMNS), ""]  # a heading over each half
            compared.columns = pd.MultiIndex.from_arrays([above, [*COLUMNS, *COLUMNS, "same"]])
            blocks.append(plain_table(part.capitalize(), compared, index=False))
    return Content(tuple(blocks))


def bench(files: Files) -> Content:
    """Of the `bench.json` that `viewnet bench` writes."""
    if "bench.json" not in files:
        return Content()
    result = read_json(files["bench.json"])
    above = pd.Series(benchmark.HEADINGS[0]).replace("", None).ffill().fillna("")  # a heading over its columns
    columns = pd.MultiIndex.from_arrays([above, benchmark.HEADINGS[1]])
    frame = pd.DataFrame([benchmark.cells(row) for row in result["rows"]], columns=columns)
    table = plain_table("Time and memory beside a textbook version", frame, index=False)
    return Content((table,), tuple(benchmark.notes(result)))


def csv_files(files: Files) -> Content:
    """Of every CSV file, as it is."""
    shown = [path for path in files.values() if path.suffix == ".csv"]
    return Content(tuple(plain_table(p.stem.capitalize(), read_csv(p), index=False) for p in shown))


def plain_table(title: str, frame: pd.DataFrame, folded: bool = False, index: bool = True) -> PlainTable:
    """A data frame as an HTML table, all of its text escaped."""
    html = frame.to_html(border=0, na_rep="", index=index, index_names=False, justify="unset", escape=True)
    return PlainTable(title, Markup(html), folded)


# Section -> the function that reads its files, where that is not `tables`.
READERS: dict[str, Callable[[Files], Content]] = {
    "novel_views": novel_views,
    "alignment_study": study,
    "audit_metrics": audit,
    "architecture": architecture,
    "bench": bench,
    **dict.fromkeys(("fuzz", "doors", "faults", "crashes", "videos", "predicting"), csv_files),
}
