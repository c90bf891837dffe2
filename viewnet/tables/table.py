"""A table of the paper: reported and measured numbers of each row, category and metric."""

import functools
import itertools
import operator
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.alignment import Procrustes
from viewnet.evaluation.evaluate import Aligned, align
from viewnet.evaluation.predictions import Predictions, write_compact
from viewnet.evaluation.run import ROBUST_PREDICTIONS, Run
from viewnet.recipes import VARIANTS
from viewnet.runtime.files import write_csv, write_json, write_text
from viewnet.tables import columns, latex, reported
from viewnet.tables.columns import DASH, HEADLINE, METRICS, text
from viewnet.tables.layouts import ADDED, LAYOUTS, Layout
from viewnet.tables.packed import as_kept, packed, single

DRAWS = 1000
DEGENERATE = "in brackets: of some seed the predictions have too little spread for an alignment, so this is no score"
ORIGIN = ("variant", "category", "profile", "recipe", "seed", "views", "git", "training")
"""The keys of a run's result.json that a table's JSON repeats."""
CHOSEN_ROBUSTLY = ", weights by robust accuracy"
"""What the label of a row ends with whose weights were chosen so."""


@dataclass(frozen=True)
class Entry:
    """The predictions of one predictor for one category and seed: a part of a cell."""

    row: str  # the label of the table's row
    category: str
    seed: int
    alignment: str  # its kind, see viewnet.evaluation.alignment
    key: str  # its name in the table's files: a run's key, and the alignment where it is not the run's usual one
    predictions: Predictions
    origin: dict[str, Any]  # where it comes from, as plain JSON types
    calibration: int | None = None  # the number of "val" images to align on; None: all
    _aligned: dict[str, Aligned] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def recipe(self) -> str:
        """How a trained predictor was trained; "" for others."""
        return self.origin.get("recipe", "") if self.origin.get("variant") in VARIANTS else ""

    @property
    def beside(self) -> bool:
        """Whether no layout has its row: a method of the user's, or weights that a robust alignment chose."""
        return self.origin.get("variant") == ADDED or self.row.endswith(CHOSEN_ROBUSTLY)

    def aligned(self, kind: str | None = None) -> Aligned:
        """The test predictions, aligned by its own alignment or another `kind`. Each is fitted once."""
        kind = kind or self.alignment
        if kind not in self._aligned:
            # The calibration images are drawn from the same seed for all.
            self._aligned[kind] = align(self.predictions, kind, self.calibration)
        return self._aligned[kind]


def named(label: str, recipe: str) -> str:
    """The label of a row that says how its predictor was trained.

    >>> named("ViewNet", "paper"), named("ViewNet (robust)", "photos"), named("Constant", "")
    ('ViewNet (paper)', 'ViewNet (robust, photos)', 'Constant')
    """
    if not recipe:
        return label
    return f"{label[:-1]}, {recipe})" if label.endswith(")") else f"{label} ({recipe})"


def entries(
    name: str,
    runs: Sequence[Run],
    predictions: Callable[[Run], Predictions] = operator.attrgetter("predictions"),  # of its own test split
    calibration: int | None = None,
) -> list[Entry]:
    """Finished runs as entries of a table, one for each row of a run's variant. ViewnetError for runs without a row."""
    layout, result = LAYOUTS[known(name, LAYOUTS, "table")], []
    for run in runs:
        config = run.config
        known(config.variant, layout.variants, f"row of {name}")
        predicted = predictions(run)
        for row in layout.rows_of(config.variant):
            alignment = (row.alignment if run.trained else None) or run.alignment
            key = run.key if alignment == run.alignment else f"{run.key}/{alignment}"
            origin = {name: run.result[name] for name in ORIGIN}
            origin |= {"alignment": alignment, "settings": config.settings_key()}
            about = (row.label, config.category, config.seed, alignment)
            result.append(Entry(*about, key, predicted, origin, calibration))
    return result


def by_robust_weights(name: str, runs: Sequence[Run]) -> list[Entry]:
    """Entries of the weights that a robust alignment chose, for rows of their own below those of the layout.

    Of runs whose weights were chosen by validation accuracy, which is noise where predictions have two modes.
    """
    found = []
    for run in (run for run in runs if (run.folder / ROBUST_PREDICTIONS).is_file()):
        for entry in entries(name, [run], lambda run: Predictions.from_parquet(run.folder / ROBUST_PREDICTIONS)):
            if entry.alignment == run.alignment:
                origin = entry.origin | {"weights": "best robust accuracy"}
                label, key = entry.row + CHOSEN_ROBUSTLY, f"{run.key}-robust"
                found.append(replace(entry, row=label, key=key, origin=origin))
    return found


@dataclass(frozen=True)
class Table:
    """One table. `cells` has a row for each (row, category, metric), measured or not:

    row, variant, recipe, supervision (what is known in training), category, metric, printed (text in the paper), bold
    (in the paper), measured (mean over seeds), sd (over seeds), low and high (95 % bootstrap interval over seeds and
    objects of that mean), seeds (how many), images, objects, degenerate (of how many seeds the predictions determine
    hardly any rotation), runs (their keys)

    A trained row is there once for each recipe, which its label names.
    """

    name: str
    note: str  # the data and training behind the measured numbers, in a line
    cells: pd.DataFrame
    entries: tuple[Entry, ...]
    remarks: tuple[str, ...] = ()  # more lines below the table
    renamed: dict[str, str] = field(default_factory=dict)  # the layout's label of a row -> its label here
    added: tuple[str, ...] = ()  # rows of other methods, below the layout's

    @classmethod
    def of(
        cls,
        name: str,
        entries: Sequence[Entry],
        categories: Sequence[str] | None = None,
        note: str = "",
        remarks: Sequence[str] = (),
        renamed: dict[str, str] | None = None,
        unmeasured: Collection[str] = (),
    ) -> "Table":
        """From entries. Several of one row and category are seeds and are averaged; `renamed`: label -> new label.

        Rows in `unmeasured` have reported numbers only. Those of entries `beside` have none, and stand below the
        layout's. Raises ViewnetError for entries that have no place in the table, for two of the same row, category and
        seed, and for a row beside with the label of another.
        """
        given = sorted((replace(e, predictions=as_kept(e.predictions)) for e in entries), key=lambda e: e.beside)
        others, renamed = tuple(dict.fromkeys(entry.row for entry in given if entry.beside)), renamed or {}
        layout = LAYOUTS[known(name, LAYOUTS, "table")].extended(others)
        layout.extended(renamed.values())
        categories = tuple(categories or layout.categories)
        for entry in given:
            known(entry.row, (row.label for row in layout.rows if row.variant), f"row of {name}")
            known(entry.category, categories, f"column of {name}")
        printed = reported.load(name).itertuples() if layout.reported else ()
        paper = {(r.row, r.metric, r.category): (r.value, bool(r.bold)) for r in printed}
        lines: list[dict[str, Any]] = []
        recipes = {row.label: dict.fromkeys(e.recipe for e in given if e.row == row.label) for row in layout.rows}
        shown_rows = [row for row in layout.rows if recipes[row.label] or not row.optional]
        rows = [(row, recipe) for row in shown_rows for recipe in recipes[row.label] or ("",)]
        for (row, recipe), category in itertools.product(rows, categories):
            label = row.label
            mine = [e for e in given if (e.row, e.recipe, e.category) == (label, recipe, category)]
            if len({e.seed for e in mine}) < len(mine):
                raise ViewnetError(f"{name}: two runs of {label}, {category} have the same seed: choose one")
            variant = "" if row.variant is None or label in unmeasured else row.variant
            shown = renamed.get(label, label)
            about = {"row": named(shown, recipe), "variant": variant, "recipe": recipe}
            about |= {"supervision": row.supervision_as(shown, recipe), "category": category}
            row_metrics = (layout.own[label],) if label in layout.own else layout.metrics
            measured = _measure(mine, row_metrics) if mine else {}
            for metric in row_metrics:
                value, bold = paper.get((layout.reported_as.get(label, label), metric, category), ("", False))
                numbers = measured.get(metric, columns.UNMEASURED)
                line = {**about, "metric": metric, "printed": value, "bold": bold, **numbers}
                lines.append(line | {"runs": " ".join(e.key for e in mine)})
        cells = pd.DataFrame(lines)
        if cells["degenerate"].any():
            remarks = tuple(dict.fromkeys([*remarks, DEGENERATE]))
        return cls(name, note, cells, tuple(given), tuple(remarks), renamed, others)

    @property
    def layout(self) -> Layout:
        """The layout of the paper's table, with the added rows."""
        return LAYOUTS[self.name].extended(self.added)

    @property
    def provenance(self) -> dict[str, dict[str, Any]]:
        """Key of an entry -> where it comes from, and how it is aligned."""
        how = {e.key: {"seed": e.seed, "alignment": e.alignment, "calibration": e.calibration} for e in self.entries}
        return {e.key: e.origin | how[e.key] for e in self.entries}

    @property
    def rows(self) -> tuple[str, ...]:
        """Labels from top to bottom."""
        return tuple(dict.fromkeys(self.cells["row"]))

    @property
    def categories(self) -> tuple[str, ...]:
        """Categories from left to right."""
        return tuple(dict.fromkeys(self.cells["category"]))

    def frame(self) -> pd.DataFrame:
        """For reading: a line per row, columns (metric, category, "print" or "ours"), numbers as text, -- for none.

        Rows with a metric of their own have it in the first metric's columns.
        """
        shown = self.layout.metrics
        cells = self.cells.assign(
            print=self.cells["printed"].replace("", DASH),
            ours=list(map(text, self.cells["measured"], self.cells["metric"], self.cells["degenerate"])),
            metric=self.cells["metric"].where(self.cells["metric"].isin(shown), shown[0]),
        )
        wide = cells.pivot(index="row", columns=["metric", "category"], values=["print", "ours"])
        order = list(itertools.product(shown, self.categories, ("print", "ours")))
        wide = wide.reorder_levels([1, 2, 0], axis=1).loc[list(self.rows), order]
        known_of = self.cells.drop_duplicates("row").set_index("row")["supervision"]
        wide.insert(0, ("supervision", "", ""), known_of.loc[wide.index])
        return wide.rename_axis(index=None, columns=[None] * 3)

    def label(self, entry: Entry) -> str:
        """The label of the row that an entry is a part of."""
        return named(self.renamed.get(entry.row, entry.row), entry.recipe)

    def interval(self, row: str, reference: str, category: str) -> tuple[float, float] | None:
        """95 % interval of Acc@30 of a row minus that of another, over seeds and objects; None where one is missing."""
        mine, objects = self._hits.get((row, category), ([], []))
        other, other_objects = self._hits.get((reference, category), ([], []))
        return metrics.mean_interval(mine, objects + other_objects, minus=other) if mine and other else None

    @functools.cached_property
    def _hits(self) -> dict[tuple[str, str], tuple[list[np.ndarray], list[np.ndarray]]]:
        """Row and category -> for each seed, 100 where a view is right and 0 where not, and the views' objects."""
        found: dict[tuple[str, str], tuple[list[np.ndarray], list[np.ndarray]]] = {}
        for entry in self.entries:
            hits, objects = found.setdefault((self.label(entry), entry.category), ([], []))
            hits.append(metrics.hits(entry.aligned().selected_errors))
            objects.append(entry.aligned().predictions.objects)
        return found

    def comparison(self, row: str, reference: str, category: str) -> str | None:
        """In words, how many points of Acc@30 a row is above or below another one, with the interval in brackets.

        "no difference measured" where the interval includes 0, "no score" where the predictions of one determine no
        alignment. None where one of them was not measured.
        """
        if (interval := self.interval(row, reference, category)) is None:
            return None
        cells = self.cells[(self.cells["category"] == category) & (self.cells["metric"] == "acc30")].set_index("row")
        if cells.loc[[row, reference], "degenerate"].any():
            return "no score"
        points = cells.at[row, "measured"] - cells.at[reference, "measured"]
        low, high = interval
        what = "no difference measured"
        if low > 0 or high < 0:
            what = f"{abs(points):.1f} points {'higher' if points > 0 else 'lower'}"
        return f"{what} [{low:.1f}, {high:.1f}]"

    def verdict(self) -> list[str]:
        """`comparison` of each measured row with the layout's reference of its recipe, a sentence a row.

        None for tables without Acc@30, and for rows and references whose predictions are not here.
        """
        sentences = []
        first = next((entry.recipe for entry in self.entries if entry.recipe), "")
        rows = self.cells.drop_duplicates("row") if HEADLINE[0] in self.layout.metrics else self.cells[:0]
        for row, recipe in zip(rows["row"], rows["recipe"], strict=True):
            reference = named(self.layout.reference, recipe or first)
            pairs = ((category, self.comparison(row, reference, category)) for category in self.categories)
            if row != reference and (found := [f"{category} {words}" for category, words in pairs if words]):
                sentences.append(f"{row} beside {reference}, Acc@30: {'; '.join(found)}")
        return sentences

    def measurements(self) -> pd.DataFrame:
        """The measured numbers in full: a line per measured (row, category), with intervals, seeds and counts."""
        shown, keys = list(self.layout.metrics), ["row", "category"]
        measured = self.cells[(self.cells["seeds"] > 0) & self.cells["metric"].isin(shown)]
        numbers = measured[["measured", "low", "high"]].itertuples(index=False)
        texts = [f"{m:.1f} [{low:.1f}, {high:.1f}]" for m, low, high in numbers]
        wide = measured.assign(text=texts).pivot(index=keys, columns="metric", values="text")
        counts = measured.drop_duplicates(keys).set_index(keys)[["seeds", "objects", "images"]]
        wide = wide.join(counts).loc[counts.index, [*shown, *counts.columns]]
        return wide.rename(columns={metric: f"{METRICS[metric].name} [95 %]" for metric in shown})

    @property
    def complete(self) -> bool:
        """Whether every row of ours, and no other, is measured in every category."""
        return bool(((self.cells["seeds"] > 0) == (self.cells["variant"] != "")).all())

    def latex(self) -> str:
        """A booktabs tabular to \\input: reported and measured numbers, the best of each column bold."""
        lines = [line for line in (f"ours: {self.note}" if self.note else "", *self.remarks) if line]
        return (latex.blocks if self.layout.blocks else latex.side_by_side)(self.cells, self.layout, lines)

    def write(self, folder: Path | str) -> list[Path]:
        """`<name>.tex`, `.csv` (every cell, with interval), `.json` (where each number comes from) and `.parquet`.

        The last has the predictions behind the table, of which viewnet.tables.kept_predictions makes it again.
        """
        folder, cells = Path(folder), self.cells.round(4)
        write_text(tex := folder / f"{self.name}.tex", self.latex())
        csv = write_csv(folder / f"{self.name}.csv", cells)
        about = {
            "table": self.name,
            "title": self.layout.title,
            "measured on": self.note,
            **({"remarks": list(self.remarks)} if self.remarks else {}),
            **({"renamed": self.renamed} if self.renamed else {}),
            "error": "geodesic angle between camera frames, degrees; accuracy: per cent strictly below 30",
            "interval": f"95 % percentile bootstrap over seeds and objects, {DRAWS} draws, of the mean over seeds",
        }
        plain = cells.assign(runs=cells["runs"].str.split()).astype(object).where(cells.notna(), None)
        entries = {"cells": plain.to_dict("records"), "runs": self.provenance}
        write_json(path := folder / f"{self.name}.json", about | entries)
        write_compact(self._predictions(), parquet := folder / f"{self.name}.parquet")
        return [tex, csv, path, parquet]

    def _predictions(self) -> pd.DataFrame:
        """Those of every run, one below the other: its key in a column "run", then as `packed`."""
        runs = {run_of(entry.key): entry.predictions for entry in self.entries}
        frame = pd.concat([single(packed(each)).assign(run=key) for key, each in runs.items()], ignore_index=True)
        return frame.astype(dict.fromkeys(("run", "category", "split", "model_id"), "category"))


def run_of(key: str) -> str:
    """The run of an entry's key, which may name an alignment, too."""
    return key.partition("/")[0]


def _measure(seeds: Sequence[Entry], row_metrics: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Metric -> the measured part of a cell, of the seeds of one row and category."""
    aligned = [entry.aligned() for entry in seeds]
    errors = [one.selected_errors for one in aligned]
    objects = [one.predictions.objects for one in aligned]
    azimuths = [one.predictions.ids["azimuth"].to_numpy() for one in aligned]
    statistics = [metric for metric in row_metrics if metric != "confidence_index"]
    intervals = metrics.bootstrap_intervals(errors, objects, DRAWS, statistics, azimuths)
    values = list(map(metrics.summary, errors, azimuths))  # metric -> value, for each seed
    degenerate = sum(isinstance(one.alignment, Procrustes) and one.alignment.degenerate for one in aligned)
    return {
        metric: columns.measured([seed[metric] for seed in values], intervals.get(metric), objects)
        | {"degenerate": degenerate}
        for metric in row_metrics
    }
