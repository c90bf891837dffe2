"""What a notebook asks for, checked before anything runs: which rows, categories, seeds, profile and data.

Notebooks and the command line pass plain values, as papermill gives them: names, whole numbers, "car,chair" or lists.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewnet import paths
from viewnet.config import CATEGORIES, SHAPENET_CATEGORIES, DataConfig, RunConfig, known
from viewnet.errors import ViewnetError
from viewnet.evaluation.baselines import UNTRAINED
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.recipes import PROFILE_RECIPE, PROFILES, RECIPES, VARIANTS, make_config
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry, Table, own_predictions
from viewnet.training.other_views import transferred
from viewnet.training.run_store import ensure, untrained

DEFAULT_PROFILE = "tiny"
MOST_SEEDS = 1000


@dataclass(frozen=True)
class Design:
    """What a notebook shows unless told otherwise."""

    variants: tuple[str, ...] = ()
    categories: tuple[str, ...] = SHAPENET_CATEGORIES
    profile: str = DEFAULT_PROFILE
    photographs: bool = False  # scored on photographs: see viewnet.experiments.photos
    tables: tuple[
        str, ...
    ] = ()  # makes several tables, to which methods are added: see viewnet.experiments.own_method_request
    videos: str = ""  # and trained on videos of this data set: see viewnet.experiments.videos and objectron_experiment


_ABLATION = tuple(variant for variant in LAYOUTS["table2_ablation"].variants if variant in VARIANTS)
"""The rows of Table 2 that are trained."""

DESIGNS = {
    **{
        n: Design(layout.variants, layout.categories, photographs=layout.blocks, videos=layout.videos)
        for n, layout in LAYOUTS.items()
    },
    "alignment_study": Design(LAYOUTS["table3_pascal3d"].variants, photographs=True),
    "figure3_azimuth": Design(("viewnet",)),
    "training_curves": Design(_ABLATION),
    # The supplement's figure is of the other four.
    "novel_views": Design(("viewnet", "viewnet_cycle", *(v for v in _ABLATION if v not in ("viewnet", "single_head")))),
    "learned_volumes": Design(("viewnet",)),
    "failures": Design(("viewnet",)),
    "reconstructions": Design(("viewnet", "viewnet_cycle"), photographs=True),
    # It shows how, in a minute.
    "your_method": Design(
        profile="smoke", photographs=True, tables=("table1_shapenet", "table3_pascal3d", "table5_dva")
    ),
    # Nothing is trained for it, so the default is the paper's size.
    "architecture": Design(categories=(), profile="paper"),
    "audit_metrics": Design(categories=(), profile="paper"),
}


@dataclass(frozen=True)
class Experiment:
    """A checked request. Made by `experiment`."""

    name: str
    profile: str
    recipe: str
    variants: tuple[str, ...]
    categories: tuple[str, ...]
    seeds: tuple[int, ...]
    data_root: str | None
    splits: str | None
    eval_root: str | None
    viewpoints: Path | None
    output: Path
    label: str  # what is not the plain default, "" if nothing
    workers: int | None

    @property
    def folder(self) -> Path:
        """Where tables and figures go: a folder of its own for what is not the plain default."""
        return self.output / self.label

    @property
    def figures(self) -> Path:
        """Where images go that are no part of a table; told apart as in `folder`."""
        return self.output / "figures" / self.label

    @property
    def configs(self) -> list[RunConfig]:
        """One configuration a run: by variant, category and seed; untrained variants once a category."""
        configs = []
        for variant in self.variants:
            for category in self.categories:
                for seed in self.seeds:
                    base = self._config("viewnet" if variant in UNTRAINED else variant, category, seed)
                    configs.append(untrained(variant, base) if variant in UNTRAINED else base)
        return list(dict.fromkeys(configs))

    @property
    def note(self) -> str:
        """What the numbers were measured on, in a line."""
        data = "built-in models" if self.data_root is None else "a CAD collection"
        if self.eval_root is not None:
            data += ", scored on another collection"
        return f"{data}, {self._made}"

    @property
    def _made(self) -> str:
        """How, and from how many seeds: the end of a note."""
        seeds = "1 seed" if len(self.seeds) == 1 else f"mean of {len(self.seeds)} seeds"
        return f"profile {self.profile}, recipe {self.recipe}, {seeds}"

    def run(self, progress: bool = True) -> list[Run]:
        """Every run of the experiment, whatever is missing trained first (viewnet.training.run_store.ensure)."""
        return ensure(self.configs, self.workers, progress)

    def table(self, runs: Sequence[Run], added: Sequence[Entry] = (), remarks: Sequence[str] = ()) -> Table:
        """The table of these runs; with `eval_root`, scored on all its models and not on the own test split.

        Rows of `added`, entries of other methods, stand below (viewnet.experiments.own_method); `remarks` are told under it.
        """
        predictions = own_predictions if self.eval_root is None else self._elsewhere
        return Table.build(self.name, runs, self.categories, predictions, self.note, remarks, added)

    def _elsewhere(self, run: Run) -> Predictions:
        from viewnet.data.build import view_store

        return transferred(run, view_store(self.eval_data(run.config)))

    def eval_data(self, config: RunConfig) -> DataConfig:
        """The views of `eval_root` in the manner of a run's own."""
        assert self.eval_root is not None
        overrides: dict[str, Any] = {} if self.profile == "smoke" else {"models": 0}
        return make_config(category=config.category, profile=self.profile, data_root=self.eval_root, **overrides).data

    def _config(self, variant: str, category: str, seed: int) -> RunConfig:
        return make_config(variant, category, self.profile, self.recipe, seed, self.data_root, self.splits)


def experiment(
    name: str,
    *,
    profile: str = "default",
    categories: str | Sequence[str] = "all",
    seeds: int | str | Sequence[int] = 1,
    recipe: str = "default",
    variant: str = "",
    data_root: str = "",
    splits: str = "",
    eval_root: str = "",
    viewpoints: str = "",
    output: str = "",
    workers: int = 0,
    **photographs: Any,
) -> Experiment:
    """Check the parameters of the notebook `name`.

    profile     smoke, tiny, small or paper; "default": the environment variable VIEWNET_PROFILE, else the notebook's
    categories  "car", "car,chair" or a list; "all": the notebook's; "everything": all twelve of PASCAL3D+
    seeds       how many (3: seeds 0, 1, 2), or which ("0,2" or a list)
    recipe      a name of config.RECIPES; "default": the profile's
    variant     the trained row that a figure shows; "": the notebook's
    data_root   a ShapeNetCore folder (v1 or v2); "": the built-in models
    splits      a folder of <synset>_{train,val,test}.txt lists for it; "": its own all.csv, else a seeded split
    eval_root   a ShapeNetCore folder to score on instead of the own test split
    viewpoints  a CSV of annotated viewpoints (viewnet.data.annotated_viewpoints.read); "": a stand-in is drawn
    output      where tables and figures go; "": paper_tables
    workers     trainings side by side; 0: what the machine has room for

    Notebooks that score on photographs take some of these and others: see viewnet.experiments.photos.photo_experiment,
    for those that train on videos viewnet.experiments.videos.video_experiment and
    viewnet.experiments.objectron.objectron_experiment, and for methods of a reader's own
    viewnet.experiments.own_method_request.method_experiment.

    What is not the plain default goes into a subfolder of `output` that says so ("smoke", "tiny-car"), so that no
    table replaces one of another kind. Raises ViewnetError naming the parameter and its valid values.

    >>> asked = experiment("table2_ablation", profile="smoke", categories="car", seeds="0,2")
    >>> asked.label, asked.seeds, len(asked.configs)  # six trained rows with two seeds, two constants
    ('smoke-car', (0, 2), 14)
    """
    design = DESIGNS[known(name, DESIGNS, "notebook")]
    given: dict[str, Any] = {"profile": profile, "categories": categories, "seeds": seeds, "recipe": recipe}
    given |= {"output": output, "workers": workers}
    if design.photographs:
        others: dict[str, Any] = {"variant": variant, "eval_root": eval_root, "viewpoints": viewpoints}
        if design.videos:
            others |= {"splits": splits, "categories": "" if given.pop("categories") == "all" else categories}
        elif design.tables:
            others |= {"splits": splits, "recipe": "" if given.pop("recipe") == "default" else recipe}
        else:
            given["splits"] = splits
        if unwanted := [other for other, value in others.items() if value]:
            raise ViewnetError(f"{name} takes no {unwanted[0]}")
        for other in photographs:
            known(other, accepted(name), f"parameter of {name}")
        return _on_photographs(design)(name, **given, data_root=data_root, **photographs)
    if photographs:
        raise ViewnetError(f"{name} takes no {next(iter(photographs))}")
    common = shared(design, PROFILE_RECIPE, **given)
    if variant:
        known(variant, (*VARIANTS, *UNTRAINED), "variant")
    variants = (variant,) if variant else design.variants
    parts = [*common.parts]
    parts += [variant] if variant and variants != design.variants else []
    parts += common.columns
    parts += ["data_root"] if data_root else []
    parts += ["eval_root"] if eval_root else []
    parts += ["viewpoints"] if viewpoints else []
    return Experiment(
        name=name,
        **common.fields,
        variants=variants,
        data_root=folder_named(data_root, "data_root"),
        splits=folder_named(splits, "splits"),
        eval_root=folder_named(eval_root, "eval_root"),
        viewpoints=_place(viewpoints, "viewpoints") if viewpoints else None,
        label=label_of(common.fields["profile"], parts),
    )


def accepted(name: str) -> set[str]:
    """The parameters that `experiment` takes for a notebook."""
    design = DESIGNS[known(name, DESIGNS, "notebook")]
    if design.photographs:
        return set(inspect.signature(_on_photographs(design)).parameters) - {"name"}
    return set(inspect.signature(experiment).parameters) - {"name", "photographs"}


def _on_photographs(design: Design) -> Callable[..., Experiment]:
    """What checks the parameters of a notebook that scores on photographs: it builds on this module."""
    if design.videos == "objectron":
        from viewnet.experiments.objectron import objectron_experiment

        return objectron_experiment
    if design.videos:
        from viewnet.experiments.videos import video_experiment

        return video_experiment
    if design.tables:
        from viewnet.experiments.own_method_request import method_experiment

        return method_experiment
    from viewnet.experiments.photos import photo_experiment

    return photo_experiment


@dataclass(frozen=True)
class CommonParameters:
    """What every experiment has, checked: fields of Experiment, and what of it belongs into its label."""

    fields: dict[str, Any]
    parts: list[str]  # profile and recipe, where they are not the default
    columns: list[str]  # categories, where they are not the default


def shared(
    design: Design,
    recipes: Mapping[str, str],
    profile: str,
    categories: str | Sequence[str],
    seeds: int | str | Sequence[int],
    recipe: str,
    output: str,
    workers: int,
) -> CommonParameters:
    """Check what every experiment has; `recipes` gives each profile's own. Raises ViewnetError as `experiment` does."""
    if profile == "default":
        profile = os.environ.get("VIEWNET_PROFILE", design.profile)
    known(profile, PROFILES, "profile")
    recipe = known(recipes[profile] if recipe == "default" else recipe, RECIPES, "recipe")
    if isinstance(categories, str) and categories in ("all", "everything"):
        chosen = design.categories if categories == "all" else CATEGORIES
    else:
        chosen = _names(categories, "categories")
    for category in chosen:
        known(category, CATEGORIES, "category")
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 0:
        raise ViewnetError(f"workers {workers!r}: expected a whole number, 0 for what the machine has room for")
    columns = ["everything"] if set(chosen) == set(CATEGORIES) else list(chosen)
    return CommonParameters(
        {
            "profile": profile,
            "recipe": recipe,
            "categories": chosen,
            "seeds": _seeds(seeds),
            "output": _place(output, "output") if output else paths.tables(),
            "workers": workers or None,
        },
        ([profile] if profile != design.profile else []) + ([recipe] if recipe != recipes[profile] else []),
        columns if chosen != design.categories else [],
    )


def label_of(profile: str, parts: Sequence[str]) -> str:
    """The name of a folder for what is not the plain default: the profile comes first wherever there is anything."""
    if list(parts) not in ([], ["viewpoints"]) and parts[0] != profile:  # a list of viewpoints has no profile
        parts = [profile, *parts]
    return "-".join(parts)


def _names(value: Any, what: str) -> tuple[str, ...]:
    names = value.split(",") if isinstance(value, str) else value
    if not isinstance(names, (list, tuple)) or not all(isinstance(n, str) and n.strip() for n in names) or not names:
        raise ViewnetError(f"{what} {value!r}: expected names such as car or car,chair")
    names = tuple(n.strip() for n in names)
    if len(set(names)) < len(names):
        raise ViewnetError(f"{what} {value!r}: a name is there twice")
    return names


def _seeds(value: Any) -> tuple[int, ...]:
    """Seeds from a count, a list, or text of either."""
    problem = ViewnetError(f"seeds {value!r}: expected how many (3) or which (0,2), whole numbers of 0 or more")
    if isinstance(value, str):
        try:
            numbers = [int(part) for part in value.split(",")]
        except ValueError:
            raise problem from None
        value = numbers if "," in value else numbers[0]
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_SEEDS:
        return tuple(range(value))
    if (
        isinstance(value, (list, tuple))
        and value
        and all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in value)
        and len(set(value)) == len(value)
    ):
        return tuple(value)
    raise problem


def folder_named(value: str, what: str) -> str | None:
    """The full path of a folder, None for ""; ViewnetError where there is none."""
    if not isinstance(value, str):
        raise ViewnetError(f"{what} {value!r}: expected a folder")
    if not value:
        return None
    folder = _place(value, what).resolve()
    if not folder.is_dir():
        raise ViewnetError(f"{what} {value}: no such folder")
    return str(folder)


def _place(value: str, what: str) -> Path:
    """A path, "~" in it replaced. ViewnetError for what is none."""
    try:
        place = Path(value).expanduser()
        place.resolve().exists()
    except (OSError, ValueError, RuntimeError, TypeError):  # too long, a zero in it, the home of nobody, no text
        raise ViewnetError(f"{what} {value!r:.300}: not the name of a file or folder") from None
    return place
