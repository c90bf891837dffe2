"""What the overview page shows of the files of a table: numbers in print beside measured ones, or a plain table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from viewnet.bench import report
from viewnet.errors import ViewnetError
from viewnet.experiments.alignment_study import Study
from viewnet.experiments.audit import Audit
from viewnet.runtime.files import read_csv, read_json
from viewnet.tables import novel_views
from viewnet.tables.architecture import COLUMNS, Architecture
from viewnet.tables.table import Table

HEADINGS = {
    "acc30": "Accuracy within 30°, % (higher is better)",
    "median": "Median error, degrees (lower is better)",
    "dva": "Discretized viewpoint accuracy (DVA), % (higher is better)",
    "confidence_index": "Confidence index: share of azimuth bins with more than ten photographs",
    "psnr": "PSNR of novel views, dB (higher is better)",
    "ssim": "SSIM of novel views (higher is better)",
    "iou": "IoU of masks of novel views (higher is better)",
    "consistency_acc30": "Drawings whose viewpoint its own network tells within 30°, %",
    "consistency_median": "How far off its own network is, median degrees",
    "judged_acc30": "Drawings whose viewpoint ViewNet's network tells within 30°, %",
    "judged_median": "How far off ViewNet's network is, median degrees",
}
DIGITS = {"acc30": 1, "median": 1, "dva": 1, "confidence_index": 2} | novel_views.DIGITS
Files = Mapping[str, Path]
"""Name -> file."""


@dataclass(frozen=True)
class Cell:
    """A row's number for a category: in print, measured, its interval, and what else is known of it."""

    printed: str = ""
    bold: bool = False
    measured: str = ""
    interval: str = ""
    best: bool = False
    about: str = ""


@dataclass(frozen=True)
class Measured:
    """Printed and measured numbers; `parts` has the heading of each metric, and its rows: label and cells."""

    title: str
    categories: tuple[str, ...]
    in_print: bool
    parts: tuple[tuple[str, tuple[tuple[str, tuple[Cell, ...]], ...]], ...]


@dataclass(frozen=True)
class Plain:
    """A data frame as an HTML table; a long one is `folded` away."""

    title: str
    html: Markup
    folded: bool = False


Block = Measured | Plain


@dataclass(frozen=True)
class Told:
    """What the files of a section and a setting hold: tables, lines that stand under them, and the runs behind them."""

    blocks: tuple[Block, ...] = ()
    notes: tuple[str, ...] = ()
    origins: Mapping[str, dict[str, Any]] | None = None  # a run's key -> where it comes from


def tables(files: Files) -> Told:
    """Of the tables that viewnet.tables.table.Table.write wrote."""
    blocks: list[Block] = []
    notes: list[str] = []
    origins: dict[str, dict[str, Any]] = {}
    for path in files.values():
        if path.suffix == ".json":
            found = read_json(path)
            table = Table(found["table"], found["measured on"], _frame(found["cells"]), found["runs"])
            blocks.append(measured(table, found["title"]))
            notes += [found["measured on"], *found.get("remarks", ()), found["error"], found["interval"]]
            origins |= found["runs"]
    return Told(tuple(blocks), tuple(dict.fromkeys(notes)), origins)


def measured(table: Table, title: str) -> Measured:
    """The cells of a table, metric by metric."""
    cells = table.cells
    best = _best(cells)
    parts = []
    for metric in dict.fromkeys(cells["metric"]):
        rows = tuple(
            (row, tuple(_cell(table.cell(row, c, metric), (row, c, metric) in best) for c in table.categories))
            for row in dict.fromkeys(cells.loc[cells["metric"] == metric, "row"])
        )
        parts.append((HEADINGS.get(metric, metric), rows))
    return Measured(title, table.categories, bool((cells["printed"] != "").any()), tuple(parts))


def _best(cells: pd.DataFrame) -> set[tuple[str, str, str]]:
    """(row, category, metric) of what is the best of its column as the page shows it, where there is a choice."""
    found: set[tuple[str, str, str]] = set()
    for (category, metric), column in cells.dropna(subset="measured").groupby(["category", "metric"]):
        shown = column["measured"].astype(float).round(DIGITS.get(metric, 2))
        if len(shown) > 1:
            top = shown.min() if metric.endswith("median") else shown.max()
            found |= {(row, category, metric) for row in column.loc[shown == top, "row"]}
    return found


def _cell(found: dict[str, Any] | None, best: bool) -> Cell:
    if found is None:
        return Cell()
    digits = DIGITS.get(found["metric"], 2)
    printed, value = {"printed": found["printed"], "bold": bool(found["bold"])}, float(found["measured"])
    if math.isnan(value):
        return Cell(**printed)
    low, high, spread = (float(found[name]) for name in ("low", "high", "sd"))
    about = f"{value:.{digits}f}: {found['images']} images of {found['objects']} objects, "
    about += "1 seed" if found["seeds"] == 1 else f"mean of {found['seeds']} seeds"
    about += "" if math.isnan(spread) else f", sd {spread:.{digits}f}"
    about += f"; runs: {found['runs']}" if found["runs"] else ""
    interval = "" if math.isnan(low) else f"[{low:.{digits}f}, {high:.{digits}f}]"
    return Cell(**printed, measured=f"{value:.{digits}f}", interval=interval, best=best, about=about)


def _frame(cells: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    frame = pd.DataFrame([{**cell, "runs": " ".join(cell["runs"])} for cell in cells])
    return frame.astype({name: float for name in ("measured", "sd", "low", "high")})


def novel(files: Files) -> Told:
    """Of viewnet.tables.novel_views.write."""
    cells = read_csv(
        files["novel_views.csv"], keep_default_na=False, na_values={"measured": "", "sd": "", "low": "", "high": ""}
    )
    table = Table("novel_views", "", cells.assign(printed="", bold=False), {})
    keys: dict[str, dict[str, Any]] = {key: {} for keys in cells["runs"] for key in keys.split()}
    note = "intervals: 95 % percentile bootstrap over objects"
    return Told((measured(table, "What models draw, in numbers"),), (note,), keys)


def study(files: Files) -> Told:
    """Of viewnet.experiments.alignment_study.Study.write."""
    parts = [read_csv(files[f"alignment_study_{name}.csv"]) for name in ("scores", "collapse")]
    found = Study("", *parts)
    names = {"acc30": "accuracy, %", "median": "median error, degrees", "dva": "DVA, %", "per_angle": "per angle"}
    added = {"spread_linear": "spread left", "acc30_gain": "accuracy added", "dva_gain": "DVA added"}
    return Told(
        (
            plain("By each alignment, calibrated on all photographs", found.side_by_side().rename(columns=names)),
            plain(
                "Does the linear alignment collapse? Rank correlations with one-sidedness",
                found.verdict().rename(columns=added),
            ),
            plain("Accuracy (%) by the number of calibration photographs", found.by_count(), folded=True),
            plain("Ever more one-sided photographs", found.collapsed(), folded=True),
        ),
        (
            "by number: medians over draws of the calibration photographs, with the lowest and the highest",
            "the paper's reasoning asks for a correlation below zero with the spread that is left, and above zero with "
            "the accuracy that the linear alignment adds to the rigid one",
        ),
    )


def audit(files: Files) -> Told:
    """Of viewnet.experiments.audit.Audit.write."""
    blocks: list[Block] = []
    names = {"table2_ablation": "Table 2", "table3_pascal3d": "Table 3", "table4_dva": "DVA"}
    for stem, of in (("audit", "a list of annotations"), ("stand_in", "a stand-in for annotations")):
        if f"{stem}_constants.csv" in files:
            constants = read_csv(files[f"{stem}_constants.csv"], dtype={"printed": str}).replace({"table": names})
            confidence = read_csv(files[f"{stem}_confidence.csv"])
            summary = Audit(constants, confidence, {}, stem == "stand_in").summary()
            blocks.append(
                plain(f"Can a constant score what is printed, by each definition of the error? ({of})", summary)
            )
            blocks.append(plain(f"Confidence index ({of})", confidence, folded=True, index=False))
    return Told(tuple(blocks))


def architecture(files: Files) -> Told:
    """Of viewnet.tables.architecture.Architecture.write, beside print. ViewnetError for a file of other columns."""
    blocks = []
    for part in ("encoder", "generator"):
        if (name := f"architecture_{part}.csv") in files:
            layers = read_csv(files[name], dtype=str, keep_default_na=False)
            if tuple(layers.columns) != COLUMNS:
                raise ViewnetError(f"{files[name]}: columns are not {', '.join(COLUMNS)}: make it again")
            compared = Architecture(part, layers, 0).comparison()
            compared["same"] = compared["same"].map({True: "yes", False: "no"})
            above = [*["print"] * len(COLUMNS), *["ours"] * len(COLUMNS), ""]
            compared.columns = pd.MultiIndex.from_arrays([above, [*COLUMNS, *COLUMNS, "same"]])
            blocks.append(plain(part.capitalize(), compared, index=False))
    return Told(tuple(blocks))


def bench(files: Files) -> Told:
    """Of viewnet.bench.report.write."""
    if "bench.json" not in files:
        return Told()
    found = read_json(files["bench.json"])
    above = pd.Series(report.HEADINGS[0]).replace("", None).ffill().fillna("")
    columns = pd.MultiIndex.from_arrays([above, report.HEADINGS[1]])
    frame = pd.DataFrame([report.cells(row) for row in found["rows"]], columns=columns)
    return Told((plain("Time and memory beside a textbook version", frame, index=False),), tuple(report.notes(found)))


def lists(files: Files) -> Told:
    """Every CSV file, as it is."""
    return Told(tuple(plain(p.stem, read_csv(p), index=False) for p in files.values() if p.suffix == ".csv"))


def plain(title: str, frame: pd.DataFrame, folded: bool = False, index: bool = True) -> Plain:
    """A data frame as a table, everything in it escaped."""
    html = frame.to_html(
        border=0, na_rep="", index=index, index_names=False, justify="unset", escape=True, sparsify=True
    )
    return Plain(title, Markup(html), folded)


READERS: dict[str, Callable[[Files], Told]] = {
    "novel_views": novel,
    "alignment_study": study,
    "audit_metrics": audit,
    "architecture": architecture,
    "bench": bench,
    "fuzz": lists,
    "faults": lists,
    "crashes": lists,
    "predicting": lists,
}
"""Section -> what reads its files, where `tables` does not."""
