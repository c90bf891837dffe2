"""How far Table 1 depends on its test models: the same runs scored on other ones, and how near each set is to training.

Built-in models come from one generator, so those held out may be hardly new. Beside them stand as many of another seed,
and the models of a collection, such as one made by artists.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from viewnet.config import RunConfig
from viewnet.data import build
from viewnet.data.readers.shapenet import ModelFile, find_models, load_model
from viewnet.data.store import ViewStore
from viewnet.evaluation.run import Run
from viewnet.experiments.cad import Experiment
from viewnet.render import render_mesh
from viewnet.runs.other_views import transferred
from viewnet.runtime.splits import SHARES
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry, Table, entries

OWN, SEED, OTHER = (row.label for row in LAYOUTS["test_sets"].rows)
AZIMUTHS = np.array([0.0, 45, 90, 135, 225, 300])  # degrees; not in pairs that mirror each other
ELEVATION, SIZE = 10.0, 48  # degrees; pixels


class OtherSetsExperiment(Experiment):
    """The collection is `eval_root`; without one there are two test sets."""

    def other_seed(self, config: RunConfig) -> RunConfig:
        """The configuration whose views are of as many built-in models as the test split has, of another seed."""
        models = max(1, round(SHARES["test"] * config.data.models))
        return replace(config, data=replace(config.data, seed=config.data.seed + 1, models=models))

    def stores(self, config: RunConfig) -> dict[str, ViewStore]:
        """Label -> the views of a test set beside the run's own."""
        found = {SEED: build.view_store(self.other_seed(config).data, self.workers)}
        return found | ({OTHER: build.view_store(self.eval_data(config), self.workers)} if self.eval_root else {})

    def table(self, runs: Sequence[Run], added: Sequence[Entry] = (), remarks: Sequence[str] = ()) -> Table:
        """The scores of each run on each set, all aligned on the run's validation views."""
        own: list[Entry] = []
        stores = {run.config.category: self.stores(run.config) for run in runs}
        for run in runs:
            for entry in entries(self.name, [run]):
                if entry.row == OWN:
                    own.append(entry)
                elif (store := stores[entry.category].get(entry.row)) is not None:
                    key = f"{entry.key}-{store.identity}"  # its predictions are kept beside the run's own
                    own.append(replace(entry, key=key, predictions=transferred(run, store)))
        return self.table_of([*own, *added], remarks)

    @property
    def unmeasured_rows(self) -> tuple[str, ...]:
        """The other collection's where there is none."""
        return () if self.eval_root else (OTHER,)

    @property
    def note(self) -> str:
        """What the numbers were measured on, in one line."""
        return f"{self.trained_on}, {self.settings}"

    def nearness(self) -> pd.DataFrame:
        """A line for each category and set: `models`, and the mean `nearest_iou` with a model trained on."""
        lines = []
        for category in self.categories:
            config = next(config for config in self.configs if config.category == category)
            models = self._models(config)
            training = silhouettes([model for model in models if model.split == "train"])
            sets = {OWN: [model for model in models if model.split == "test"]}
            sets[SEED] = self._models(self.other_seed(config))
            if self.eval_root:
                sets[OTHER] = find_models(self.eval_root, category)
            for label, members in sets.items():
                near = nearest_iou(silhouettes(members), training).mean()
                lines.append({"category": category, "set": label, "models": len(members), "nearest_iou": near})
        return pd.DataFrame(lines).set_index(["category", "set"]).round(3)

    def _models(self, config: RunConfig) -> list[ModelFile]:
        data = config.data
        root = data.root or build.built_in(config.category, data.models, data.seed, progress=False)
        return find_models(root, config.category, data.splits)


def silhouettes(models: Sequence[ModelFile]) -> NDArray[np.bool_]:
    """Masks (K, V, SIZE * SIZE) of models from the same V viewpoints."""
    elevations = np.full(len(AZIMUTHS), ELEVATION)
    images = [render_mesh(load_model(model), AZIMUTHS, elevations, SIZE, 1) for model in models]
    return (np.stack(images)[..., 3] > 127).reshape(len(models), len(AZIMUTHS), -1)  # (K, V, SIZE * SIZE)


def nearest_iou(masks: NDArray[np.bool_], others: NDArray[np.bool_]) -> NDArray[np.float64]:
    """IoU (K,) of masks (K, V, P) with those of the most alike of others (L, V, P), as the mean over viewpoints."""
    result = []
    for mask in masks:  # one after another: less memory
        both, either = (mask & others).sum(2), (mask | others).sum(2)  # (L, V)
        result.append((both / np.maximum(either, 1)).mean(1).max())
    return np.array(result)
