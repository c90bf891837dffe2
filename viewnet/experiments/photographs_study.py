"""What is lost where on the way from a renderer's labels to photographs (ours; beside Table 3).

The same CAD views teach networks of one size by their viewpoints, by ViewNet, and by what ViewNets answer for them
(viewnet.training.distil). So it can be told what labels would bring, what the drawing of views costs, and what is left
for resolution and pretrained features.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch

from viewnet.config import RunConfig
from viewnet.data import build
from viewnet.data.store import ViewStore
from viewnet.estimator import pretrained
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predict import predict
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments.calibrated import Answers, answers, turned
from viewnet.experiments.photos import PhotoExperiment, content_key
from viewnet.model import checkpoint
from viewnet.runtime import parallel, provenance
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry
from viewnet.training.distil import distil

TEACHERS = {"student": "viewnet", "student_of_black": "over_black"}
"""Students, each a ViewNet whose viewpoint network is trained anew -> whose answers it learns: its own, or of all
seeds of that variant."""
CODE = ("training/distil.py", "data/augment.py", "evaluation/predict.py")
"""What decides a student's answers, beside the runs."""


class PhotographsStudy(PhotoExperiment):
    """Photographs are in `data_root`, the CAD models trained on in `cad_root`."""

    @property
    def _students(self) -> list[str]:
        return [variant for variant in self.variants if variant in TEACHERS]

    @property
    def _untrained_variants(self) -> list[str]:
        return [variant for variant in super()._untrained_variants if variant not in TEACHERS]

    @property
    def trained_variants(self) -> list[str]:
        """Those asked for, and those that students start and learn from."""
        needed = [name for student in self._students for name in ("viewnet", TEACHERS[student])]
        return list(dict.fromkeys([*super().trained_variants, *needed]))

    @property
    def configs(self) -> list[RunConfig]:
        """As PhotoExperiment.configs, without backgrounds for networks that see objects over black."""
        return [
            replace(config, data=replace(config.data, backgrounds=None)) if config.variant == "over_black" else config
            for config in super().configs
        ]

    def trained_entries(self, runs: Sequence[Run], stores: dict[str, ViewStore]) -> list[Entry]:
        """The runs that were asked for, and the students of them."""
        shown = [run for run in runs if run.config.variant in self.variants]
        found = super().trained_entries(shown, stores)
        for variant in self._students:
            (row,) = LAYOUTS[self.name].rows_of(variant)
            for run in (run for run in runs if run.config.variant == "viewnet"):
                category, teachers = run.config.category, [run]
                if TEACHERS[variant] != "viewnet":
                    theirs = (TEACHERS[variant], category)
                    teachers = [each for each in runs if (each.config.variant, each.config.category) == theirs]
                key, predictions = taught(run, teachers, stores[category])
                origin: dict[str, Any] = {"variant": variant, "recipe": run.config.recipe, "views": run.result["views"]}
                origin |= {"teachers": [each.key for each in teachers], "photographs": stores[category].identity}
                origin |= {"alignment": row.alignment, "git": provenance.commit()}
                about = (row.label, category, run.config.seed, str(row.alignment), key)
                found.append(Entry(*about, predictions, origin, self.calibration))
        return found

    def answers(self, runs: Sequence[Run]) -> dict[str, Answers]:
        """What built-in models, and rows by the first seed, are sure and right of, for scored photographs."""
        stores, found = self.stores(), {}
        for category in (category for category in self.categories if category in pretrained.shipped()):
            model = pretrained.load(category)
            said = predict(model.network, stores[category], ("test",), config=model.config)
            if model.annotated_from_model is not None:
                found[f"built-in {category}"] = answers(align(turned(said, model.annotated_from_model), "none"))
        for entry in self.trained_entries(runs, stores):
            if entry.seed == self.seeds[0] and entry.predictions.heads > 1:
                label = entry.row if len(self.categories) == 1 else f"{entry.category}, {entry.row}"
                found[label] = answers(entry.aligned())
        return found


def taught(run: Run, teachers: Sequence[Run], photographs: ViewStore) -> tuple[str, Predictions]:
    """The key of a student that starts from a run and learns the answers of others, and what it says of photographs.

    Cached in the run's folder. Raises ViewnetError as viewnet.training.distil.distil.
    """
    weights = [checkpoint.identity(str(each.folder)) for each in (run, *teachers)]
    key = content_key("student", [weights, photographs.identity, provenance.code_identity(CODE)])
    path = run.folder / f"{key}.parquet"
    if path.is_file():
        return key, Predictions.from_parquet(path)
    torch.set_num_threads(parallel.threads())
    model, config = checkpoint.load_model(run.folder)
    others = [checkpoint.load_model(each.folder) for each in teachers if each != run]
    distil(model, config, build.view_store(config.data), others, config.seed)
    predictions = predict(model, photographs, ("val", "test"), config=config)
    predictions.to_parquet(path)
    return key, predictions
