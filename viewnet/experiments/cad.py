"""Experiments on CAD models: trained on rendered views of some, scored on views of others (Tables 1 and 2)."""

from collections.abc import Collection, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewnet.config import DataConfig, RunConfig
from viewnet.data import build
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.baselines import UNTRAINED
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments.request import Request, accepted
from viewnet.recipes import make_config, repeats_viewnet
from viewnet.runs.needs import Needs, needs
from viewnet.runs.other_views import transferred
from viewnet.runs.run_store import ensure, untrained
from viewnet.tables import kept_predictions
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry, Table, by_robust_weights, entries

Rows = dict[str, tuple[ViewStore, NDArray[np.intp]]]
"""Split, "val" to align on and "test" to score -> a view store and which of its rows."""


class Experiment(Request):
    """A request that can be run."""

    @property
    def cad_collection(self) -> str | None:
        """The folder of the CAD models to train on, `cad_root` where that is a parameter; None: the built-in models."""
        return self.cad_root if "cad_root" in accepted(self.name) else self.data_root

    @property
    def configs(self) -> list[RunConfig]:
        """One configuration a run: by recipe, variant, category and seed; untrained variants once a category.

        None where a variant is ViewNet itself by a recipe.
        """
        found: dict[RunConfig, None] = {}
        for recipe, variant in product(self.recipes, self.variants):
            if variant in UNTRAINED or not repeats_viewnet(variant, recipe):
                runs = product(self.categories, self.seeds)
                found |= dict.fromkeys(self._config(variant, *run, recipe=recipe) for run in runs)
        return list(found)

    def _config(self, variant: str, category: str, seed: int, recipe: str = "", **overrides: Any) -> RunConfig:
        """A run on CAD models, of the first recipe unless another is named."""
        if variant in UNTRAINED:
            return untrained(variant, self._config("viewnet", category, seed, **overrides))
        place = (self.cad_collection, self.splits)
        return make_config(variant, category, self.profile, recipe or self.recipe, seed, *place, **overrides)

    @property
    def trained_on(self) -> str:
        """The kind of CAD models, in words."""
        return "built-in models" if self.cad_collection is None else "a CAD collection"

    @property
    def note(self) -> str:
        """What the numbers were measured on, in one line."""
        return f"{self.trained_on}{', scored on another collection' if self.eval_root else ''}, {self.settings}"

    @property
    def settings(self) -> str:
        """Profile, recipes and number of seeds, in words."""
        recipes = f"recipe{'s' if len(self.recipes) > 1 else ''} {' and '.join(self.recipes)}"
        seeds = len({*self.seeds, *self.kept_seeds})
        several = f"mean of {'up to ' if self.kept_seeds else ''}{seeds} seeds"
        return f"profile {self.profile}, {recipes}, {'1 seed' if seeds == 1 else several}"

    @property
    def kept_seeds(self) -> Collection[int]:
        """The seeds of runs that are kept, which not every row may have."""
        return ()

    @property
    def to_run(self) -> list[RunConfig]:
        """The runs whose networks or predictions are needed: those without results that are kept beside a table."""
        return self.configs

    def run(self, progress: bool = True) -> list[Run]:
        """The runs of `to_run`; missing ones are trained first (viewnet.runs.run_store.ensure)."""
        return ensure(self.to_run, self.workers, progress)

    def needs(self) -> Needs:
        """Which views and runs of the experiment's trainings are kept, and which `run` would make."""
        return needs(self.to_run)

    def table(self, runs: Sequence[Run], added: Sequence[Entry] = (), remarks: Sequence[str] = ()) -> Table:
        """The table of these runs, scored on all models of `eval_root` or, without one, on their own test views.

        `added` are entries of other methods (viewnet.experiments.own_method), `remarks` further lines under the table.
        """

        def predictions(run: Run) -> Predictions:
            return transferred(run, build.view_store(self.eval_data(run.config))) if self.eval_root else run.predictions

        robust = [] if self.eval_root else by_robust_weights(self.name, runs)
        return self.table_of([*entries(self.name, runs, predictions), *added, *robust], remarks)

    def table_of(self, given: Sequence[Entry], remarks: Sequence[str] = ()) -> Table:
        """The table of these entries; see `table`."""
        rows = (self.renamed_rows, self.unmeasured_rows)
        return Table.of(self.name, given, self.categories, self.note, remarks, *rows)

    @property
    def unmeasured_rows(self) -> tuple[str, ...]:
        """Rows of ours for which only reported numbers are shown: those that were not asked for."""
        measured = {config.variant for config in self.configs}
        return tuple(r.label for r in LAYOUTS[self.name].rows if r.variant and r.variant not in measured)

    def entries_of(self, run: Run) -> list[Entry]:
        """What a finished run adds to the table, without `eval_root`."""
        return [*entries(self.name, [run]), *by_robust_weights(self.name, [run])]

    def kept_entries(self) -> list[Entry]:
        """The entries of its runs that are kept beside its table. Raises ViewnetError for damaged files."""
        found = kept_predictions.entries(self.folder / f"{self.name}.json")
        mine = {config.settings_key() for config in self.configs}
        return [entry for entry in found if entry.origin.get("settings") in mine]

    @property
    def untrained_rows(self) -> list[str]:
        """Rows of predictors that are no runs."""
        return []

    def untrained(self) -> list[Entry]:
        """The entries of `untrained_rows`."""
        return []

    def scores(self, category: str) -> str:
        """What its runs are scored on, as a key; "" for their own test views."""
        return ""

    def eval_data(self, config: RunConfig) -> DataConfig:
        """The views of `eval_root`, rendered as those of a run."""
        assert self.eval_root is not None
        return make_config(category=config.category, profile=self.profile, data_root=self.eval_root).data

    @property
    def renamed_rows(self) -> dict[str, str]:
        """Rows of the table's layout that are called otherwise: label -> label."""
        return {}

    def scored_views(self, category: str) -> Rows:
        """The views that predictions of a category are aligned on and scored on.

        Raises ViewnetError where a model of `eval_root` is in the collection trained on.
        """
        config = next(config for config in self.configs if config.category == category)
        own = build.view_store(config.data, self.workers)
        views = {split: (own, own.split(split)) for split in ("val", "test")}
        if self.eval_root is not None:
            other = build.view_store(self.eval_data(config), self.workers)
            if both := set(own.index["model_id"]) & set(other.index["model_id"]):
                raise ViewnetError(f"{self.eval_root}: model {min(both)} is in the collection trained on as well")
            views["test"] = (other, np.arange(len(other)))
        return views
