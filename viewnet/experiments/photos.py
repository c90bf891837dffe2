"""What a notebook that scores on photographs asks for: Table 3, the supplement's DVA table, the study of alignments.

ViewNet learns from drawn views of CAD models and is scored on photographs (section 4.3). Of those, the split "val" is
what viewpoints are aligned on, and what the untrained predictors are fitted on; "test" is what is scored.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from viewnet.config import PhotoConfig, RunConfig, known
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, features
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments.request import DESIGNS, CommonParameters, Experiment, folder_named, label_of, shared
from viewnet.recipes import RECIPES, VARIANTS, make_config
from viewnet.runtime import provenance
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry, Table, entries
from viewnet.training import other_views

PROFILE_RECIPE = {"smoke": "photos", "tiny": "photos", "pocket": "photos", "small": "photos", "paper": "paper_photos"}
"""The recipe a profile uses unless another is named: backgrounds behind what is trained on, ten views a model."""
SMOKE_MODELS, SMOKE_COUNT = 8, 80
"""The size of the stand-in for photographs at the smallest profile."""
LEAST = 4
"""Photographs that anything can be fitted on."""
CODE = ("baselines.py", "features.py", "backbones.py", "geometry.py", "alignment.py", "predictions.py")
ALIGNED = {"video_regression": "procrustes"}
"""How untrained predictors are aligned that do not speak in the photographs' frame."""


@dataclass(frozen=True)
class PhotoExperiment(Experiment):
    """A checked request. Made by `photo_experiment`.

    `data_root` and `splits` are those of the CAD models trained on, as in every configuration.
    """

    extra_cad: str | None
    backgrounds: str
    photographs: PhotoConfig  # of the first category: see photo_config
    backbone: str
    ridge: float
    calibration: int | None

    @property
    def configs(self) -> list[RunConfig]:
        """One configuration a training: by variant, category and seed."""
        return [
            make_config(
                variant,
                category,
                self.profile,
                self.recipe,
                seed,
                self.data_root,
                self.splits,
                extra=self.extra_cad,
                backgrounds=self.backgrounds,
            )
            for variant in self.variants
            if variant in VARIANTS
            for category in self.categories
            for seed in self.seeds
        ]

    def photo_config(self, category: str) -> PhotoConfig:
        """The photographs of a category."""
        return replace(self.photographs, category=category)

    @property
    def note(self) -> str:
        """What the numbers were measured on, in a line."""
        data = "built-in models" if self.data_root is None else "a CAD collection"
        data += " and a second one" if self.extra_cad else ""
        return f"{self.scored_on}; trained on {data}, {self._made}"

    @property
    def scored_on(self) -> str:
        """Which photographs, in some words."""
        root = self.photographs.root
        if root is None:
            return "a stand-in for photographs"
        if (Path(root) / "Annotations").is_dir():
            return f"PASCAL3D+ ({self.photographs.subset})"
        return "photographs of another collection"

    def stores(self, progress: bool = True) -> dict[str, ViewStore]:
        """Category -> its photographs, cut and put into a view store where that was not done yet."""
        from viewnet.data.build import photo_views as views

        return {c: views(self.photo_config(c), self.workers, progress) for c in self.categories}

    def table(self, runs: Sequence[Run], added: Sequence[Entry] = (), remarks: Sequence[str] = ()) -> Table:
        """The table of these runs and of the untrained predictors; `added` and `remarks` as in Experiment."""
        stores = self.stores()
        found = self.entries(runs, stores)
        told = [*self.remarks(stores), *remarks]
        return Table.of(self.name, found, self.categories, self.note, told, self.called, self.unasked, added)

    @property
    def unasked(self) -> tuple[str, ...]:
        """Rows of ours that are left as printed: none."""
        return ()

    @property
    def called(self) -> dict[str, str]:
        """The names of rows that start from another backbone's features than the printed ones."""
        regressed = [
            row.label for row in LAYOUTS[self.name].rows if row.variant and row.variant.endswith("_regression")
        ]
        return {} if self.chosen == "vgg16" else {label: f"{label} ({self.chosen})" for label in regressed}

    def remarks(self, stores: dict[str, ViewStore]) -> list[str]:
        """What stands under the table: how the untrained rows are fitted, and the photographs left out."""
        from viewnet.data.photo_store import summary

        fitted = "all" if self.calibration is None else str(self.calibration)
        lines = [
            f"aligned, and untrained rows fitted, on {fitted} calibration photographs",
            f"view regression: ridge {self.ridge:g} from {features.describe(self.chosen)}",
        ]
        return lines + [summary(store) for store in stores.values()]

    @property
    def chosen(self) -> str:
        """The backbone of the view regression, "auto" resolved."""
        return features.choose(self.backbone)

    def entries(self, runs_: Sequence[Run], stores: dict[str, ViewStore], name: str | None = None) -> list[Entry]:
        """What the cells of the table are made of: the runs, and the untrained predictors, on these photographs."""
        name = name or self.name
        identities = {category: {"photographs": store.identity} for category, store in stores.items()}
        trained = entries(
            name, runs_, lambda run: other_views.on_photographs(run, stores[run.config.category]), self.calibration
        )
        found = [replace(e, origin=e.origin | identities[e.category]) for e in trained]
        for category, store in stores.items():
            for variant in LAYOUTS[name].variants:
                if variant not in VARIANTS:
                    found += self._untrained(name, variant, category, store)
        return found

    def _untrained(self, name: str, variant: str, category: str, store: ViewStore) -> list[Entry]:
        said, settings = self.fitted(variant, store, self.calibration)
        origin: dict[str, Any] = {"variant": variant}
        alignment = ALIGNED.get(variant, "none")
        origin |= {"category": category, "photographs": store.identity, "alignment": alignment}
        origin |= settings | {"calibration": self.calibration}
        named = json.dumps([origin, provenance.code_identity(CODE)], sort_keys=True)
        key = f"{variant}-{hashlib.sha256(named.encode()).hexdigest()[:12]}"
        origin |= {"git": provenance.commit()}
        return [
            Entry(row.label, category, 0, alignment, key, said, origin, self.calibration)
            for row in LAYOUTS[name].rows_of(variant)
        ]

    def fitted(
        self, variant: str, store: ViewStore, calibration: int | None = None, seed: int = 0
    ) -> tuple[Predictions, dict[str, Any]]:
        """What an untrained predictor says once it is fitted on calibration photographs, and its settings.

        Its predictions of the split "val" are of those photographs alone.
        """
        rows = baselines.calibrating(store.index, calibration, seed)
        index = store.index[rows]
        if variant == "view_regression":
            settings = {"backbone": self.chosen, "size": features.SIZE, "ridge": self.ridge}
            return baselines.view_regression(index, features.extract(store, self.chosen)[rows], self.ridge), settings
        return baselines.ON_CALIBRATION[variant].predict(index), {}


def photo_experiment(
    name: str,
    *,
    profile: str = "default",
    categories: str | Sequence[str] = "all",
    seeds: int | str | Sequence[int] = 1,
    recipe: str = "default",
    data_root: str = "",
    cad_root: str = "",
    splits: str = "",
    extra_cad: str = "",
    backgrounds: str = "",
    subset: str = "imagenet",
    keep: str = "all",
    margin: float | str = 0.0,
    backbone: str = "auto",
    ridge: float | str = baselines.RIDGE,
    calibration: int = 0,
    output: str = "",
    workers: int = 0,
) -> PhotoExperiment:
    """Check the parameters of a notebook that scores on photographs; see viewnet.experiments.request.experiment for the others.

    categories   "all": aeroplane, car and chair; "everything": all twelve
    recipe       "default": photos, at the profile paper paper_photos
    data_root    the photographs: PASCAL3D+ 1.1, or a folder with images/ and viewpoints.csv; "": a stand-in is made
    cad_root     a ShapeNetCore folder to train on; "": the built-in models
    splits       a folder of <synset>_{train,val,test}.txt lists for it
    extra_cad    a second ShapeNetCore folder, all of whose models join training
    backgrounds  a folder of images (SUN397) to stand behind what is trained on; "": drawn ones
    subset       of PASCAL3D+: imagenet, pascal or both
    keep         all, easy (neither difficult, truncated nor occluded) or first (one object an image)
    margin       so much of a box's longer side is seen beyond it, 0 to 2
    backbone     of the view regression: vgg16, squeezenet1_1, another of torchvision's, or pixels; "auto": the first of
                 vgg16, squeezenet1_1 and pixels that is at hand
    ridge        its strength, more than 0
    calibration  on how many photographs predictions are aligned and baselines fitted; 0: on all there are

    Raises ViewnetError naming the parameter and its valid values.
    """
    design = DESIGNS[name]
    common = shared(design, PROFILE_RECIPE, profile, categories, seeds, recipe, output, workers)
    chosen = common.fields["profile"]
    if (
        isinstance(calibration, bool)
        or not isinstance(calibration, int)
        or not (calibration == 0 or calibration >= LEAST)
    ):
        raise ViewnetError(f"calibration {calibration!r}: expected a whole number from {LEAST}, or 0 for all")
    wide, strength = _number(margin, "margin"), _number(ridge, "ridge")
    if not 0 <= wide <= 2:
        raise ViewnetError(f"margin {margin}: expected 0 to 2 sides of the box")
    if not 0 < strength < np.inf:
        raise ViewnetError(f"ridge {ridge}: expected more than 0")
    behind = scenery_of(backgrounds)
    photographs = replace(
        photographs_of(common, common.fields["categories"][0], data_root),
        subset=known(subset, ("imagenet", "pascal", "both"), "subset"),  # type: ignore[arg-type]
        keep=known(keep, ("all", "easy", "first"), "keep"),  # type: ignore[arg-type]
        margin=wide,
    )
    parts = [*common.parts, *common.columns]
    places = {"data_root": data_root, "cad_root": cad_root, "extra_cad": extra_cad}
    parts += [place for place, value in places.items() if value]
    parts += ["backgrounds"] if behind != "drawn" else []
    parts += [subset] if subset != "imagenet" else []
    parts += [keep] if keep != "all" else []
    parts += [f"margin{wide:g}"] if wide else []
    parts += [backbone] if backbone != "auto" else []
    parts += [f"ridge{strength:g}"] if strength != baselines.RIDGE else []
    parts += [f"calibration{calibration}"] if calibration else []
    features.choose(backbone)
    return PhotoExperiment(
        name=name,
        **common.fields,
        variants=design.variants,
        data_root=folder_named(cad_root, "cad_root"),
        splits=folder_named(splits, "splits"),
        eval_root=None,
        viewpoints=None,
        label=label_of(chosen, parts),
        extra_cad=folder_named(extra_cad, "extra_cad"),
        backgrounds=behind,
        photographs=photographs,
        backbone=backbone,
        ridge=strength,
        calibration=calibration or None,
    )


def photographs_of(common: CommonParameters, category: str, data_root: str) -> PhotoConfig:
    """The photographs of a category under `data_root`, or a stand-in of the profile's size, cut as the recipe has them.

    Raises ViewnetError for a folder that does not exist.
    """
    found = PhotoConfig(
        category=category,
        root=folder_named(data_root, "data_root"),
        # ViewNet sees them at half that; a backbone at all of it.
        size=features.SIZE,
        square=RECIPES[common.fields["recipe"]]["model"].get("crop") != "stretched",
    )
    if common.fields["profile"] == "smoke":
        return replace(found, models=SMOKE_MODELS, count=SMOKE_COUNT)
    return found


def scenery_of(backgrounds: str) -> str:
    """The full path of the folder `backgrounds`, or "drawn" for that and for "". ViewnetError where there is none."""
    return backgrounds if backgrounds == "drawn" else folder_named(backgrounds, "backgrounds") or "drawn"


def _number(value: float | str, what: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ViewnetError(f"{what} {value!r}: expected a number") from None
