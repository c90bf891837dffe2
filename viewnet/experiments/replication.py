"""The replication: a queue of the trainings behind the tables of CAD models, kept in paper_tables/ as they end.

A table of the queue is made of the runs that are kept beside it: their predictions and where they come from
(viewnet.tables.kept_predictions). As a run ends, the tables with a row of it are written again, its log beside them. So
what was measured survives the machine, a queue that was stopped goes on where it was, and what is kept is not trained
again, by whichever version it was trained: its commit stands in the table's JSON. To train runs again, remove the
table's files.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet.config import RunConfig
from viewnet.evaluation.baselines import UNTRAINED
from viewnet.evaluation.run import Run
from viewnet.experiments import experiment
from viewnet.experiments.cad import Experiment
from viewnet.runs.make_run import Steps
from viewnet.runs.run_store import ensure
from viewnet.runtime.files import read_csv, read_json, write_csv
from viewnet.tables import definitions, kept_predictions, plots
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import CHOSEN_ROBUSTLY, Entry, by_robust_weights, entries

QUEUE: tuple[tuple[str, dict[str, str]], ...] = (
    # Does each part of the method matter, and does the cycle help?
    ("table2_ablation", {"seeds": "3"}),
    ("table1_shapenet", {"seeds": "3"}),
    # Does the method as printed tell front from rear?
    ("table2_ablation", {"seeds": "3", "recipe": "paper", "rows": "viewnet"}),
    ("table2_ablation", {"seeds": "1", "recipe": "paper", "categories": "car"}),
    # What is needed of what our recipe adds?
    ("recipe_ablation", {"seeds": "3"}),
)
"""Notebooks and their parameters, in the order of what each tells."""


@dataclass
class Replication:
    """The queue: what of it is kept, and what is missing."""

    requests: Sequence[Experiment]
    kept: dict[str, dict[str, Entry]] = field(default_factory=dict)  # RunConfig.settings_key -> row -> its entry

    @classmethod
    def of(cls, parts: Sequence[tuple[str, dict[str, str]]] = QUEUE, **parameters: Any) -> "Replication":
        """The queue of `parts`, with more `parameters` for each, such as profile or output, and what is kept of it.

        Raises ViewnetError for invalid parameters and damaged files.
        """
        queue = cls([experiment(name, **(parameters | own)) for name, own in parts])
        for request in queue.requests:
            path = _file(request)
            if path.with_suffix(".parquet").is_file():
                queue._add(kept_predictions.read(path).entries)
        return queue

    def _add(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            self.kept.setdefault(entry.origin.get("settings", ""), {})[entry.row] = entry

    @property
    def missing(self) -> list[RunConfig]:
        """The runs that are not kept, in the order to train them: part by part, of each the first seeds first."""
        wanted = (config for request in self.requests for config in sorted(request.configs, key=lambda c: c.seed))
        return [config for config in dict.fromkeys(wanted) if config.settings_key() not in self.kept]

    def plan(self) -> list[dict[str, Any]]:
        """Of each part: its table, its runs, how many are kept, and `core_hours` for those that no part before has.

        By the training times of kept runs of the same recipe; NaN where there are none.
        """
        seconds: dict[str, list[float]] = {}
        for entry in (next(iter(rows.values())) for rows in self.kept.values()):
            if entry.recipe:
                seconds.setdefault(entry.recipe, []).append(entry.origin["training"]["seconds"])
        parts, missing = [], set(self.missing)
        for request in self.requests:
            own = missing & set(request.configs)
            missing -= own
            trained = [config.recipe for config in own if config.variant not in UNTRAINED]
            hours = sum(float(np.mean(seconds.get(recipe, [np.nan]))) for recipe in trained) / 3600
            kept = sum(config.settings_key() in self.kept for config in request.configs)
            name = f"{request.label}/{request.name}".lstrip("/")
            parts.append({"table": name, "runs": len(request.configs), "kept": kept, "core_hours": hours})
        return parts

    def train(self, workers: int | None = None, progress: bool = True, steps: Steps | None = None) -> None:
        """Train what is missing, `workers` side by side, and keep each run as it ends.

        Raises ViewnetError as viewnet.runs.run_store.ensure does, after the others have ended.
        """
        for request in self.requests:  # runs that one table has kept may be another's rows
            path = _file(request)
            shown = {run.get("settings") for run in read_json(path)["runs"].values()} if path.is_file() else set()
            if {config.settings_key() for config in request.configs} & self.kept.keys() - shown:
                self._write(request)
        ensure(self.missing, workers, progress, steps, finished=self.keep)

    def keep(self, run: Run) -> None:
        """Write every table that has a row of a finished run again, with its predictions and its log."""
        for request in self.requests:
            if run.config in request.configs:
                self._add([*entries(request.name, [run]), *by_robust_weights(request.name, [run])])
                self._write(request)
                if run.trained:
                    self._write_log(request, run)

    def _write(self, request: Experiment) -> None:
        found = [entry for config in request.configs for entry in self.kept.get(config.settings_key(), {}).values()]
        labels = {row.label for row in LAYOUTS[request.name].rows}
        own = [entry for entry in found if entry.row in labels]
        chosen = [entry for entry in found if entry.row.endswith(CHOSEN_ROBUSTLY)]
        definitions.write_with(request.table_of(own, chosen, _uneven(own)), request.folder)

    def _write_log(self, request: Experiment, run: Run) -> None:
        """The logs of the table's runs, of several machines perhaps, one below the other."""
        path, log = request.folder / f"{request.name}_logs.csv", plots.training_logs([run]).round(4)
        if path.is_file():
            columns = ["row", "recipe", "category", "seed"]
            before = read_csv(path, columns)
            others = (before[columns] != log[columns].iloc[0]).any(axis=1)
            log = pd.concat([before[others], log], ignore_index=True)
        write_csv(path, log)


def _file(request: Experiment) -> Path:
    """The JSON of a part's table."""
    return request.folder / f"{request.name}.json"


def _uneven(own: Sequence[Entry]) -> list[str]:
    """A remark where trained rows of a table have different numbers of seeds so far."""
    seeds = Counter((entry.row, entry.recipe, entry.category) for entry in own if entry.recipe)
    fewest, most = min(seeds.values(), default=0), max(seeds.values(), default=0)
    return [f"trained rows have {fewest} to {most} seeds so far"] if fewest < most else []
