"""Tables 1, 2, 3 and the supplement's DVA table: what the paper prints and what is measured, side by side."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.evaluate import Aligned, align
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.runtime.files import write_json, write_text
from viewnet.tables import latex, published
from viewnet.tables.layouts import HEADLINE, LAYOUTS, Layout, alignment_of
from viewnet.tables.published import DASH, DIGITS, text

NAMES = {"acc30": "acc@30, %", "median": "median, degrees", "dva": "DVA, %"}
DRAWS = 1000


def own_predictions(run: Run) -> Predictions:
    """The predictions a run is scored on unless told otherwise: of its own test split."""
    return run.predictions


@dataclass(frozen=True)
class Entry:
    """What a cell is made of: what one predictor says of one category, one seed of it.

    row          the label of the table's row
    alignment    how it is aligned (viewnet.evaluation.alignment), on `calibration` of its "val" images (None: all)
    key          names it in the table's files: a run's key, and the alignment where it is not the run's usual one
    origin       where it comes from, as plain JSON types
    """

    row: str
    category: str
    seed: int
    alignment: str
    key: str
    predictions: Predictions
    origin: dict[str, Any]
    calibration: int | None = None

    def aligned(self) -> Aligned:
        """Test predictions in the annotated frame. The calibration images are drawn from the same seed for all."""
        return align(self.predictions, self.alignment, self.calibration)


def entries(
    name: str,
    runs: Sequence[Run],
    predictions: Callable[[Run], Predictions] = own_predictions,
    calibration: int | None = None,
) -> list[Entry]:
    """Finished runs as entries of a table, one for each row that a run's variant fills.

    `predictions` gives what a run is scored on. Raises ViewnetError for runs that have no place in the table.
    """
    layout, found = LAYOUTS[known(name, LAYOUTS, "table")], []
    for run in runs:
        config = run.config
        known(config.variant, layout.variants, f"row of {name}")
        said = predictions(run)
        for label in layout.labels(config.variant):
            alignment = (alignment_of(label) if run.trained else None) or run.alignment
            key = run.key if alignment == run.alignment else f"{run.key}/{alignment}"
            origin = {name: run.result[name] for name in _ORIGIN} | {"alignment": alignment}
            found.append(Entry(label, config.category, config.seed, alignment, key, said, origin, calibration))
    return found


_ORIGIN = ("variant", "category", "profile", "recipe", "seed", "views", "git", "training")


@dataclass(frozen=True)
class Table:
    """One table. `cells` has a row for each (row, category, metric), measured or not:

    row, variant, category, metric, printed (text), bold (in print), measured (mean over seeds), sd (over seeds), low
    and high (95 % bootstrap interval over objects of that mean), seeds (how many), images, objects, runs (their keys)
    """

    name: str
    note: str  # what was measured on, in a line
    cells: pd.DataFrame
    provenance: dict[str, Any]
    remarks: tuple[str, ...] = ()  # more lines to stand under it
    labels: dict[str, str] = field(default_factory=dict)  # label -> the layout's, where a row is called otherwise
    added: tuple[str, ...] = ()  # rows of other methods, below the layout's

    @classmethod
    def build(
        cls,
        name: str,
        runs: Sequence[Run],
        categories: Sequence[str] | None = None,
        predictions: Callable[[Run], Predictions] = own_predictions,
        note: str = "",
        remarks: Sequence[str] = (),
        added: Sequence[Entry] = (),
    ) -> Table:
        """From finished runs. Raises ViewnetError as `entries` and `of` do."""
        return cls.of(name, entries(name, runs, predictions), categories, note, remarks, added=added)

    @classmethod
    def of(
        cls,
        name: str,
        found: Sequence[Entry],
        categories: Sequence[str] | None = None,
        note: str = "",
        remarks: Sequence[str] = (),
        called: dict[str, str] | None = None,
        unasked: Collection[str] = (),
        added: Sequence[Entry] = (),
    ) -> Table:
        """From entries. Several of one row and category are seeds and are averaged; `called` renames rows.

        Rows in `unasked` have numbers in print only. Entries in `added` are of other methods (viewnet.experiments.own_method): their
        rows stand below the layout's and have no numbers in print.
        Raises ViewnetError for entries that have no place in the table, for two of the same row, category and seed, and
        for an added row that is called like another.
        """
        others, called = tuple(dict.fromkeys(entry.row for entry in added)), called or {}
        layout = LAYOUTS[known(name, LAYOUTS, "table")].extended(others)
        layout.extended(called.values())
        categories, found = tuple(categories or layout.categories), [*found, *added]
        for entry in found:
            known(entry.row, (label for label, variant in layout.rows if variant), f"row of {name}")
            known(entry.category, categories, f"column of {name}")
        printed = _published(layout, name).set_index(["row", "metric", "category"])
        cells: list[dict[str, Any]] = []
        for label, variant in layout.rows:
            wanted = (layout.own[label],) if label in layout.own else layout.metrics
            for category in categories:
                mine = [e for e in found if e.row == label and e.category == category]
                if len({e.seed for e in mine}) < len(mine):
                    raise ViewnetError(f"{name}: two runs of {label}, {category} have the same seed")
                measured = _measure(mine, wanted) if mine else {}
                for metric in wanted:
                    place = (layout.printed_as.get(label, label), metric, category)
                    cells.append(
                        {
                            "row": called.get(label, label),
                            "variant": "" if variant is None or label in unasked else variant,
                            "category": category,
                            "metric": metric,
                            "printed": printed.loc[place, "value"] if place in printed.index else "",
                            "bold": bool(printed.loc[place, "bold"]) if place in printed.index else False,
                            **(measured.get(metric) or _UNMEASURED),
                            "runs": " ".join(e.key for e in mine),
                        }
                    )
        return cls(
            name,
            note,
            pd.DataFrame(cells),
            {e.key: e.origin for e in found},
            tuple(remarks),
            {new: old for old, new in called.items()},
            others,
        )

    @property
    def layout(self) -> Layout:
        """What the table was asked to show."""
        return LAYOUTS[self.name].extended(self.added)

    @property
    def rows(self) -> tuple[str, ...]:
        """Labels from top to bottom."""
        return tuple(dict.fromkeys(self.cells["row"]))

    @property
    def categories(self) -> tuple[str, ...]:
        """Categories from left to right."""
        return tuple(dict.fromkeys(self.cells["category"]))

    def frame(self) -> pd.DataFrame:
        """For reading: a line a row, columns (metric, category, "print" or "ours"), numbers as text, -- where none.

        Rows of a measure of their own have it in the first metric's columns.
        """
        layout = self.layout
        cells = self.cells.assign(
            print=self.cells["printed"].replace("", DASH),
            ours=[text(m, metric) for m, metric in zip(self.cells["measured"], self.cells["metric"], strict=True)],
            metric=self.cells["metric"].where(self.cells["metric"].isin(layout.metrics), layout.metrics[0]),
        )
        wide = cells.pivot(index="row", columns=["metric", "category"], values=["print", "ours"])
        wide = wide.reorder_levels([1, 2, 0], axis=1)
        columns = [(m, c, k) for m in layout.metrics for c in self.categories for k in ("print", "ours")]
        return wide.loc[list(self.rows), columns].rename_axis(index=None, columns=[None] * 3)

    def differences(self, reference: str = "ViewNet") -> pd.DataFrame:
        """Accuracy of each row minus that of the row `reference`, in points: printed and measured, NaN where none."""
        cells = self.cells[self.cells["metric"] == self.layout.metrics[0]]
        values = cells.assign(print=pd.to_numeric(cells["printed"]), ours=cells["measured"].astype(float))
        wide = values.pivot(index="row", columns="category", values=["print", "ours"]).swaplevel(axis=1)
        rows = [row for row in self.rows if row in wide.index]
        wide = wide.loc[rows, [(c, k) for c in self.categories for k in ("print", "ours")]]
        return (wide - wide.loc[reference]).drop(index=reference).round(1).rename_axis(index=None, columns=[None] * 2)

    def measurements(self) -> pd.DataFrame:
        """Our numbers in full: a line for each measured (row, category), with intervals and the number of seeds."""
        wanted = list(self.layout.metrics)
        measured = self.cells[(self.cells["seeds"] > 0) & self.cells["metric"].isin(wanted)]
        lines = [
            f"{m:.1f} [{low:.1f}, {high:.1f}]"
            for m, low, high in zip(measured["measured"], measured["low"], measured["high"], strict=True)
        ]
        wide = measured.assign(text=lines).pivot(index=["row", "category"], columns="metric", values="text")
        first = measured.drop_duplicates(["row", "category"]).set_index(["row", "category"])
        wide = wide.join(first[["seeds", "objects", "images"]]).loc[
            first.index, [*wanted, "seeds", "objects", "images"]
        ]
        return wide.rename(columns={metric: f"{NAMES[metric]} [95 %]" for metric in wanted})

    def checks(self) -> dict[str, bool]:
        """What must hold whatever was trained, and how long."""
        cells, layout = self.cells, self.layout
        printed, rows = _published(layout, self.name)["row"], [self.labels.get(row, row) for row in self.rows]
        measured = cells[cells["seeds"] > 0]
        shares = measured[measured["metric"].isin(("acc30", "dva"))]
        found = {
            "every printed row is here": set(printed) <= {layout.printed_as.get(row, row) for row in rows},
            "every row of ours is measured in every category": len(measured) == int((cells["variant"] != "").sum()),
            "nothing is measured elsewhere": bool((measured["variant"] != "").all()),
            "accuracies lie between 0 and 100": bool(shares["measured"].between(0, 100).all()),
        }
        if "median" in layout.metrics:
            median = measured[measured["metric"] == "median"]
            found["medians lie between 0 and 180"] = bool(median["measured"].between(0, 180).all())
        if "confidence_index" in layout.own.values():
            index = measured[measured["metric"] == "confidence_index"]
            found["confidence indices lie between 0 and 1"] = bool(index["measured"].between(0, 1).all())
        behind = (key in self.provenance for keys in measured["runs"] for key in keys.split())
        return found | {"every number has runs behind it": all(behind)}

    def latex(self) -> str:
        """A booktabs tabular to \\input: printed and measured values together, the best of each column bold."""
        return latex.blocks(self) if self.layout.blocks else latex.side_by_side(self)

    def write(self, folder: Path) -> list[Path]:
        """`<name>.tex`, `<name>.csv` (every cell, with interval) and `<name>.json` (where each number comes from)."""
        files = [folder / f"{self.name}{suffix}" for suffix in (".tex", ".csv", ".json")]
        write_text(files[0], self.latex())
        write_text(files[1], self.cells.round(4).to_csv(index=False, lineterminator="\n"))
        cells = [
            {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in cell.items()}
            | {"runs": cell["runs"].split()}
            for cell in self.cells.round(4).to_dict("records")
        ]
        about = {
            "table": self.name,
            "title": self.layout.title,
            "measured on": self.note,
            **({"remarks": list(self.remarks)} if self.remarks else {}),
            "error": "geodesic angle between camera frames, degrees; accuracy: per cent strictly below 30",
            "interval": f"95 % percentile bootstrap over objects, {DRAWS} draws, of the mean over seeds",
        }
        write_json(files[2], about | {"cells": cells, "runs": self.provenance})
        return files

    def cell(self, row: str, category: str, metric: str) -> dict[str, Any] | None:
        """One line of `cells`; None where the row has no such metric."""
        cells = self.cells
        found = cells[(cells["row"] == row) & (cells["category"] == category) & (cells["metric"] == metric)]
        return None if found.empty else found.iloc[0].to_dict()

    def best(self) -> set[tuple[str, str, str]]:
        """(row, category, metric) of measured cells that are the best of their column as it reads, ties included, where
        there is a choice."""
        best: set[tuple[str, str, str]] = set()
        for (category, metric), column in self.cells[self.cells["seeds"] > 0].groupby(["category", "metric"]):
            shown = column["measured"].astype(float).round(DIGITS[metric])
            if len(shown) > 1:
                top = shown.min() if metric == "median" else shown.max()
                best |= {(row, category, metric) for row in column.loc[shown == top, "row"]}
        return best


def audit(runs: Sequence[Run], table: str, row: str) -> pd.DataFrame:
    """Runs of one row scored by every definition of the error in print, beside the printed numbers: acc30 and median.

    Only the geodesic angle is an error of rotation; see viewnet.evaluation.metrics for the others.
    """
    printed = published.load(table)
    printed = printed[printed["row"] == row].set_index(["category", "metric"])["value"]
    lines = {}
    for run in runs:
        found = run.result["metrics"][run.alignment]
        definitions = {"geodesic": {m: found[m] for m in HEADLINE}, **found["audit"]}
        for name, values in definitions.items():
            lines[run.config.category, name] = {m: text(values[m], m) for m in HEADLINE}
        lines[run.config.category, "printed"] = {m: printed.get((run.config.category, m), DASH) for m in HEADLINE}
    frame = pd.DataFrame.from_dict(lines, orient="index")
    frame.index = pd.MultiIndex.from_tuples(frame.index, names=["category", "definition"])
    return frame


def _published(layout: Layout, name: str) -> pd.DataFrame:
    return published.load(layout.printed or name)


_UNMEASURED: dict[str, Any] = {
    "measured": float("nan"),
    "sd": float("nan"),
    "low": float("nan"),
    "high": float("nan"),
    "seeds": 0,
    "images": 0,
    "objects": 0,
}


def _measure(found: Sequence[Entry], wanted: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Every metric of the seeds of one cell."""
    scored = [entry.aligned() for entry in found]
    errors = [aligned.selected_errors for aligned in scored]
    objects = [aligned.predictions.objects for aligned in scored]
    azimuths = [aligned.predictions.ids["azimuth"].to_numpy() for aligned in scored]
    statistics = [metric for metric in wanted if metric != "confidence_index"]
    rng = np.random.default_rng(0)
    intervals = metrics.bootstrap_intervals(errors, objects, rng, DRAWS, statistics=statistics, azimuths=azimuths)
    measured = {}
    for metric in wanted:
        values = [_value(metric, e, a) for e, a in zip(errors, azimuths, strict=True)]
        low, high = intervals.get(metric) or (float("nan"), float("nan"))
        measured[metric] = {
            "measured": float(np.mean(values)),
            "sd": float(np.std(values, ddof=1)) if len(values) > 1 else float("nan"),
            "low": low,
            "high": high,
            "seeds": len(found),
            "images": len(errors[0]),
            "objects": len(set(objects[0])),
        }
    return measured


def _value(metric: str, errors: np.ndarray, azimuths: np.ndarray) -> float:
    if metric == "confidence_index":
        return metrics.confidence_index(azimuths)
    return metrics.dva(errors, azimuths) if metric == "dva" else metrics.STATISTICS[metric](errors)
