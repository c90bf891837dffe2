"""Tables 1 and 2: what the paper prints and what the runs measure, side by side."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet import metrics, published
from viewnet.config import SHAPENET_CATEGORIES, known
from viewnet.errors import ViewnetError
from viewnet.evaluate import Aligned, align
from viewnet.files import write_json, write_text
from viewnet.predictions import Predictions
from viewnet.runs import Run

METRICS = {"acc30": r"Accuracy (\%) $\uparrow$", "median": r"Median error ($^\circ$) $\downarrow$"}
DIGITS = {"acc30": 0, "median": 1}  # as printed
DASH = "--"
"""What stands where nothing was printed or measured."""
DRAWS = 1000


@dataclass(frozen=True)
class Layout:
    """A table of the paper: its rows as (label, variant or None where this project has no such method)."""

    title: str
    rows: tuple[tuple[str, str | None], ...]
    categories: tuple[str, ...] = SHAPENET_CATEGORIES

    @property
    def variants(self) -> tuple[str, ...]:
        """The variants to have runs of."""
        return tuple(variant for _, variant in self.rows if variant)


LAYOUTS = {
    "table1_shapenet": Layout(
        "ShapeNet results of unsupervised methods",
        (("MVC", None), ("Pointcloud", None), ("ViewNet", "viewnet"), ("ViewNet + cycle", "viewnet_cycle")),
    ),
    "table2_ablation": Layout(
        "Ablation study",
        (
            ("ViewNet", "viewnet"),
            ("Single-head", "single_head"),
            ("Segmentation Target", "segmentation_target"),
            ("No Shape Prior", "no_shape_prior"),
            ("Encoder-Decoder", "encoder_decoder"),
            ("HoloGAN-Decoder", "hologan_decoder"),
            ("Constant", "constant"),
            ("Best constant", "best_constant"),  # not in print: the printed constant points to the sky
        ),
    ),
}


def own_predictions(run: Run) -> Predictions:
    """The predictions a run is scored on unless told otherwise: of its own test split."""
    return run.predictions


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

    @classmethod
    def build(
        cls,
        name: str,
        runs: Sequence[Run],
        categories: Sequence[str] | None = None,
        predictions: Callable[[Run], Predictions] = own_predictions,
        note: str = "",
    ) -> Table:
        """From finished runs. Several runs of one row and category are seeds and are averaged.

        `predictions` gives what a run is scored on. Raises ViewnetError for runs that have no place in the table and
        for two runs of the same row, category and seed.
        """
        layout = LAYOUTS[known(name, LAYOUTS, "table")]
        categories = tuple(categories or layout.categories)
        for run in runs:
            known(run.config.variant, layout.variants, f"row of {name}")
            known(run.config.category, categories, f"column of {name}")
        printed = published.load(name).set_index(["row", "metric", "category"])
        cells: list[dict[str, Any]] = []
        for label, variant in layout.rows:
            for category in categories:
                mine = [r for r in runs if r.config.variant == variant and r.config.category == category]
                if len({r.config.seed for r in mine}) < len(mine):
                    raise ViewnetError(f"{name}: two runs of {label}, {category} have the same seed")
                measured = _measure(mine, predictions) if mine else {}
                for metric in METRICS:
                    place = (label, metric, category)
                    cells.append(
                        {
                            "row": label,
                            "variant": variant or "",
                            "category": category,
                            "metric": metric,
                            "printed": printed.loc[place, "value"] if place in printed.index else "",
                            "bold": bool(printed.loc[place, "bold"]) if place in printed.index else False,
                            **(measured.get(metric) or _UNMEASURED),
                            "runs": " ".join(r.key for r in mine),
                        }
                    )
        return cls(name, note, pd.DataFrame(cells), {run.key: _origin(run) for run in runs})

    def frame(self) -> pd.DataFrame:
        """For reading: a line a row, columns (metric, category, "print" or "ours"), numbers as text, -- where none."""
        cells = self.cells.assign(
            print=self.cells["printed"].replace("", DASH),
            ours=[_text(m, metric) for m, metric in zip(self.cells["measured"], self.cells["metric"], strict=True)],
        )
        wide = cells.pivot(index="row", columns=["metric", "category"], values=["print", "ours"])
        wide = wide.reorder_levels([1, 2, 0], axis=1)
        columns = [(m, c, k) for m in METRICS for c in self.categories for k in ("print", "ours")]
        return wide.loc[list(self.rows), columns].rename_axis(index=None, columns=[None] * 3)

    @property
    def rows(self) -> tuple[str, ...]:
        """Labels from top to bottom."""
        return tuple(dict.fromkeys(self.cells["row"]))

    @property
    def categories(self) -> tuple[str, ...]:
        """Categories from left to right."""
        return tuple(dict.fromkeys(self.cells["category"]))

    def differences(self, reference: str = "ViewNet") -> pd.DataFrame:
        """Accuracy of each row minus that of the row `reference`, in points: printed and measured, NaN where none."""
        cells = self.cells[self.cells["metric"] == "acc30"]
        values = cells.assign(print=pd.to_numeric(cells["printed"]), ours=cells["measured"].astype(float))
        wide = values.pivot(index="row", columns="category", values=["print", "ours"]).swaplevel(axis=1)
        wide = wide.loc[list(self.rows), [(c, k) for c in self.categories for k in ("print", "ours")]]
        return (wide - wide.loc[reference]).drop(index=reference).round(1).rename_axis(index=None, columns=[None] * 2)

    def measurements(self) -> pd.DataFrame:
        """Our numbers in full: a line for each measured (row, category), with intervals and the number of seeds."""
        measured = self.cells[self.cells["seeds"] > 0]
        lines = [
            f"{m:.1f} [{low:.1f}, {high:.1f}]"
            for m, low, high in zip(measured["measured"], measured["low"], measured["high"], strict=True)
        ]
        wide = measured.assign(text=lines).pivot(index=["row", "category"], columns="metric", values="text")
        first = measured.drop_duplicates(["row", "category"]).set_index(["row", "category"])
        wide = wide.join(first[["seeds", "objects", "images"]]).loc[
            first.index, [*METRICS, "seeds", "objects", "images"]
        ]
        return wide.rename(columns={"acc30": "acc@30, % [95 %]", "median": "median, degrees [95 %]"})

    def checks(self) -> dict[str, bool]:
        """What must hold whatever was trained, and how long."""
        cells, printed = self.cells, published.load(self.name)
        measured = cells[cells["seeds"] > 0]
        accuracy = measured[measured["metric"] == "acc30"]
        median = measured[measured["metric"] == "median"]
        return {
            "every printed row is here": set(printed["row"]) <= set(self.rows),
            "every row of ours is measured in every category": len(measured) == int((cells["variant"] != "").sum()),
            "nothing is measured elsewhere": bool((measured["variant"] != "").all()),
            "accuracies lie between 0 and 100": bool(accuracy["measured"].between(0, 100).all()),
            "medians lie between 0 and 180": bool(median["measured"].between(0, 180).all()),
            "every number has runs behind it": all(
                key in self.provenance for keys in measured["runs"] for key in keys.split()
            ),
        }

    def latex(self) -> str:
        """A booktabs tabular to \\input: printed and measured values side by side, the best of each column bold."""
        width = 2 * len(METRICS) * len(self.categories)
        out = io.StringIO()
        out.write(f"\\begin{{tabular}}{{l{'r' * width}}}\n\\toprule\n")
        spans = [len(self.categories) * 2] * len(METRICS)
        out.write(_header(list(METRICS.values()), spans))
        out.write(_header(list(self.categories) * len(METRICS), [2] * (width // 2)))
        out.write(" & ".join(["", *["print", "ours"] * (width // 2)]) + " \\\\\n\\midrule\n")
        best = self._best()
        for row in self.rows:
            line = [escape(row)]
            for metric in METRICS:
                for category in self.categories:
                    cell = self._cell(row, category, metric)
                    line.append(_bold(cell["printed"] or DASH, bool(cell["bold"])))
                    line.append(_bold(_text(cell["measured"], metric), (row, category, metric) in best))
            out.write(" & ".join(line) + " \\\\\n")
        out.write("\\bottomrule\n")
        if self.note:
            out.write(f"\\multicolumn{{{width + 1}}}{{l}}{{\\footnotesize ours: {escape(self.note)}}} \\\\\n")
        out.write("\\end{tabular}\n")
        return out.getvalue()

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
            "title": LAYOUTS[self.name].title,
            "measured on": self.note,
            "error": "geodesic angle between camera frames, degrees; accuracy: per cent strictly below 30",
            "interval": f"95 % percentile bootstrap over objects, {DRAWS} draws, of the mean over seeds",
        }
        write_json(files[2], about | {"cells": cells, "runs": self.provenance})
        return files

    def _cell(self, row: str, category: str, metric: str) -> dict[str, Any]:
        cells = self.cells
        found = cells[(cells["row"] == row) & (cells["category"] == category) & (cells["metric"] == metric)]
        return found.iloc[0].to_dict()

    def _best(self) -> set[tuple[str, str, str]]:
        """Measured cells that are the best of their column as it reads, ties included, where there is a choice."""
        best: set[tuple[str, str, str]] = set()
        for (category, metric), column in self.cells[self.cells["seeds"] > 0].groupby(["category", "metric"]):
            shown = column["measured"].astype(float).round(DIGITS[metric])
            if len(shown) > 1:
                top = shown.max() if metric == "acc30" else shown.min()
                best |= {(row, category, metric) for row in column.loc[shown == top, "row"]}
        return best


def audit(runs: Sequence[Run], table: str, row: str) -> pd.DataFrame:
    """Runs of one row scored by every definition of the error in print, beside the printed numbers: acc30 and median.

    Only the geodesic angle is an error of rotation; see viewnet.metrics for the others.
    """
    printed = published.load(table)
    printed = printed[printed["row"] == row].set_index(["category", "metric"])["value"]
    lines = {}
    for run in runs:
        found = run.result["metrics"][run.alignment]
        definitions = {"geodesic": {m: found[m] for m in METRICS}, **found["audit"]}
        for name, values in definitions.items():
            lines[run.config.category, name] = {m: _text(values[m], m) for m in METRICS}
        lines[run.config.category, "printed"] = {m: printed.get((run.config.category, m), DASH) for m in METRICS}
    frame = pd.DataFrame.from_dict(lines, orient="index")
    frame.index = pd.MultiIndex.from_tuples(frame.index, names=["category", "definition"])
    return frame


_UNMEASURED: dict[str, Any] = {
    "measured": float("nan"),
    "sd": float("nan"),
    "low": float("nan"),
    "high": float("nan"),
    "seeds": 0,
    "images": 0,
    "objects": 0,
}


def _measure(runs: Sequence[Run], predictions: Callable[[Run], Predictions]) -> dict[str, dict[str, Any]]:
    """Every metric of the seeds of one cell."""
    scored = [_scored(run, predictions) for run in runs]
    errors = [aligned.selected_errors for aligned in scored]
    objects = [aligned.predictions.objects for aligned in scored]
    intervals = metrics.bootstrap_intervals(errors, objects, np.random.default_rng(0), DRAWS, statistics=tuple(METRICS))
    found = {}
    for metric in METRICS:
        values = [metrics.STATISTICS[metric](e) for e in errors]
        low, high = intervals[metric] or (float("nan"), float("nan"))
        found[metric] = {
            "measured": float(np.mean(values)),
            "sd": float(np.std(values, ddof=1)) if len(values) > 1 else float("nan"),
            "low": low,
            "high": high,
            "seeds": len(runs),
            "images": len(errors[0]),
            "objects": len(set(objects[0])),
        }
    return found


def _scored(run: Run, predictions: Callable[[Run], Predictions]) -> Aligned:
    return align(predictions(run), run.alignment)


def _origin(run: Run) -> dict[str, Any]:
    result = run.result
    wanted = ("variant", "category", "profile", "recipe", "seed", "views", "git", "training")
    return {name: result[name] for name in wanted} | {"alignment": run.alignment}


def _header(labels: Sequence[str], spans: Sequence[int]) -> str:
    cells = [f"\\multicolumn{{{span}}}{{c}}{{{label}}}" for label, span in zip(labels, spans, strict=True)]
    ends = np.cumsum(spans) + 1
    rules = [f"\\cmidrule(lr){{{end - span + 1}-{end}}}" for end, span in zip(ends, spans, strict=True)]
    return " & ".join(["", *cells]) + " \\\\\n" + " ".join(rules) + "\n"


def _text(value: float, metric: str) -> str:
    return DASH if np.isnan(value) else f"{value:.{DIGITS[metric]}f}"


def _bold(text: str, bold: bool) -> str:
    return f"\\textbf{{{text}}}" if bold else text


@functools.cache
def _specials() -> dict[int, str]:
    return str.maketrans({c: f"\\{c}" for c in "&%$#_{}"} | {"~": r"\textasciitilde{}", "\\": r"\textbackslash{}"})


def escape(text: str) -> str:
    """Plain text for LaTeX."""
    return text.translate(_specials())
