"""The replication: a queue of the trainings behind the tables, kept in paper_tables/ as they end.

A table of the queue is made of the runs that are kept beside it: their predictions and where they come from
(viewnet.tables.kept_predictions). As a run ends, the tables with a row of it are written again, its log beside them. So
what was measured survives the machine, a queue that was stopped goes on where it was, and what is kept is not trained
again, by whichever version it was trained: its commit stands in the table's JSON. To train runs again, remove the
table's files. Predictors that are not trained, such as constants, are measured once and kept too.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
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
from viewnet.tables.table import Entry

ALL_TWELVE = {
    "categories": "everything", "seeds": "1", "rows": "constant,constant_rotation,view_regression,viewnet,viewnet_cycle"
}  # fmt: skip
QUEUE: tuple[tuple[str, dict[str, str]], ...] = (
    # Does each part of the method matter, and does the cycle help?
    ("table2_ablation", {"seeds": "3"}),
    ("table1_shapenet", {"seeds": "3"}),
    # Does the method as printed tell front from rear?
    ("table2_ablation", {"seeds": "3", "recipe": "paper", "rows": "viewnet"}),
    ("table2_ablation", {"seeds": "1", "recipe": "paper", "categories": "car"}),
    # What is left of it on photographs, and after training on videos?
    ("table3_pascal3d", {"seeds": "3"}),
    ("table5_dva", {"seeds": "3"}),
    ("table3_pascal3d", ALL_TWELVE),
    ("table5_dva", ALL_TWELVE),
    ("table4_freiburg", {"seeds": "3"}),
    # What is needed of what our recipe adds?
    ("recipe_ablation", {"seeds": "3"}),
)
"""Notebooks and their parameters, in the order of what each tells."""


@dataclass
class Replication:
    """The queue: what of it is kept, and what is missing."""

    requests: Sequence[Experiment]
    # What is scored (Experiment.scores), and RunConfig.settings_key or the key of what is not trained -> row -> entry
    kept: dict[tuple[str, str], dict[str, Entry]] = field(default_factory=dict)

    @classmethod
    def of(cls, parts: Sequence[tuple[str, dict[str, str]]] = QUEUE, **parameters: Any) -> "Replication":
        """The queue of `parts`, with more `parameters` for each, such as profile or output, and what is kept of it.

        Raises ViewnetError for invalid parameters and damaged files.
        """
        queue = cls([experiment(name, **(parameters | own)) for name, own in parts])
        for request in queue.requests:
            queue._add(request, kept_predictions.entries(_file(request)))
        return queue

    def _add(self, request: Experiment, entries: Sequence[Entry]) -> None:
        for entry in entries:
            key = (request.scores(entry.category), entry.origin.get("settings", entry.key))
            self.kept.setdefault(key, {})[entry.row] = entry

    def _kept(self, request: Experiment, config: RunConfig) -> dict[str, Entry]:
        """Row -> what is kept of a run for what a request scores; nothing where the run is to be trained."""
        return self.kept.get((request.scores(config.category), config.settings_key()), {})

    @property
    def missing(self) -> list[RunConfig]:
        """The runs that are not kept, in the order to train them: part by part, of each the first seeds first."""
        return list(dict.fromkeys(config for request in self.requests for config in self._missing_of(request)))

    def _missing_of(self, request: Experiment) -> list[RunConfig]:
        return [c for c in sorted(request.configs, key=lambda c: c.seed) if not self._kept(request, c)]

    def plan(self) -> list[dict[str, Any]]:
        """Of each part: its table, its runs, how many are kept, and `core_hours` for those that no part before has.

        By the training times of kept runs of the same recipe; NaN where there are none.
        """
        seconds: dict[str, list[float]] = {}
        for entry in (next(iter(rows.values())) for rows in self.kept.values()):
            if entry.recipe:
                seconds.setdefault(entry.recipe, []).append(entry.origin["training"]["seconds"])
        parts, before = [], set[RunConfig]()
        for request in self.requests:
            own = set(self._missing_of(request)) - before
            before |= own
            trained = [config.recipe for config in own if config.variant not in UNTRAINED]
            hours = sum(float(np.mean(seconds.get(recipe, [np.nan]))) for recipe in trained) / 3600
            kept = sum(bool(self._kept(request, config)) for config in request.configs)
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
            if any(c.settings_key() not in shown for c in request.configs if self._kept(request, c)):
                self._write(request)
        ensure(self.missing, workers, progress, steps, finished=self.keep)

    def keep(self, run: Run) -> None:
        """Write every table that has a row of a finished run again, with its predictions and its log."""
        for request in self.requests:
            if run.config in request.configs:
                self._add(request, request.entries_of(run))
                self._write(request)
                if run.trained:
                    self._write_log(request, run)

    def _write(self, request: Experiment) -> None:
        found = [entry for config in request.configs for entry in self._kept(request, config).values()]
        own = [entry for entry in found if not entry.beside]
        table = request.table_of([*self._untrained(request), *found], _uneven(own))
        definitions.write_with(table, request.folder)

    def _untrained(self, request: Experiment) -> list[Entry]:
        """The entries of predictors without training that are no runs, measured where some are not kept."""

        def kept() -> dict[tuple[str, str], Entry]:
            scored = {request.scores(category) for category in request.categories}
            entries = (entry for (what, _), rows in self.kept.items() if what in scored for entry in rows.values())
            return {(entry.row, entry.category): entry for entry in entries if "settings" not in entry.origin}

        wanted = list(product(request.untrained_rows, request.categories))
        if set(wanted) - kept().keys():
            self._add(request, request.untrained())
        return [kept()[each] for each in wanted]

    def _write_log(self, request: Experiment, run: Run) -> None:
        """The logs of the table's runs, of several machines perhaps, one below the other; of Table 2 as curves, too."""
        path, log = request.folder / f"{request.name}_logs.csv", plots.training_logs([run]).round(4)
        if path.is_file():
            columns = ["row", "recipe", "category", "seed"]
            before = read_csv(path, columns)
            others = (before[columns] != log[columns].iloc[0]).any(axis=1)
            log = pd.concat([before[others], log], ignore_index=True)
        write_csv(path, log)
        if request.name == "table2_ablation":  # whose rows the notebook training_curves shows
            note = f"{request.note}; of the trainings whose logs are kept"
            plots.save(plots.training_curves(log), request.figures, "training_curves", note)


def _file(request: Experiment) -> Path:
    """The JSON of a part's table."""
    return request.folder / f"{request.name}.json"


def _uneven(own: Sequence[Entry]) -> list[str]:
    """A remark where trained rows of a table have different numbers of seeds so far."""
    seeds = Counter((entry.row, entry.recipe, entry.category) for entry in own if entry.recipe)
    fewest, most = min(seeds.values(), default=0), max(seeds.values(), default=0)
    return [f"trained rows have {fewest} to {most} seeds so far"] if fewest < most else []
