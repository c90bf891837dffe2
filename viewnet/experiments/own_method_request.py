"""What the notebook of a reader's own method asks for: the tables that its row is added to, with their runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from viewnet.config import RunConfig
from viewnet.evaluation.run import Run
from viewnet.experiments.own_method import Submission, with_methods
from viewnet.experiments.photos import PROFILE_RECIPE
from viewnet.experiments.request import DESIGNS, Experiment, experiment, label_of, shared
from viewnet.tables.table import Table


@dataclass(frozen=True)
class MethodExperiment(Experiment):
    """A checked request. Made by `method_experiment`."""

    parts: tuple[Experiment, ...]  # one a table

    @property
    def tables(self) -> dict[str, Experiment]:
        """Table -> what is asked for it."""
        return {part.name: part for part in self.parts}

    @property
    def configs(self) -> list[RunConfig]:
        """The runs of all tables, each once."""
        return list(dict.fromkeys(config for part in self.parts for config in part.configs))

    @property
    def folder(self) -> Path:
        """Where the tables go: a folder apart, as they are not the paper's."""
        return self.output / self.name / self.label

    def score(self, runs: Sequence[Run], submissions: Sequence[Submission]) -> dict[str, Table]:
        """Every table with a row for each method. Raises ViewnetError as viewnet.experiments.own_method.entries does."""
        return {
            name: with_methods(part, [run for run in runs if run.config in part.configs], submissions)
            for name, part in self.tables.items()
        }


def method_experiment(
    name: str,
    *,
    profile: str = "default",
    categories: str | Sequence[str] = "all",
    seeds: int | str | Sequence[int] = 1,
    data_root: str = "",
    cad_root: str = "",
    backgrounds: str = "",
    calibration: int = 0,
    output: str = "",
    workers: int = 0,
) -> MethodExperiment:
    """Check the parameters of the notebook of own methods; see viewnet.experiments.photos.photo_experiment for them.

    `cad_root` has the CAD models that Table 1 is scored on, too; `calibration` is of the photographs only. Raises
    ViewnetError naming the parameter and its valid values.
    """
    design = DESIGNS[name]
    common = shared(design, PROFILE_RECIPE, profile, categories, seeds, "default", output, workers)
    chosen = common.fields["profile"]
    same = {key: common.fields[key] for key in ("profile", "categories", "seeds")} | {"workers": workers}
    photographs = {"data_root": data_root, "cad_root": cad_root, "backgrounds": backgrounds, "calibration": calibration}
    parts = tuple(
        experiment(table, **same, **(photographs if DESIGNS[table].photographs else {"data_root": cad_root}))
        for table in design.tables
    )
    places = {
        "data_root": data_root,
        "cad_root": cad_root,
        "backgrounds": "" if backgrounds == "drawn" else backgrounds,
    }
    told = [*common.parts, *common.columns, *(place for place, value in places.items() if value)]
    told += [f"calibration{calibration}"] if calibration else []
    return MethodExperiment(
        name=name,
        **common.fields,
        variants=tuple(dict.fromkeys(variant for part in parts for variant in part.variants)),
        data_root=None,
        splits=None,
        eval_root=None,
        viewpoints=None,
        label=label_of(chosen, told),
        parts=parts,
    )
