"""Experiments on photographs: trained on rendered CAD models, scored on photographs (section 4.3, Table 3, DVA table).

Of the photographs, predictions are aligned and untrained predictors fitted on the split "val"; "test" is scored.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from viewnet.config import PhotoConfig, RunConfig
from viewnet.data import build, photo_store
from viewnet.data.readers.registry import READERS
from viewnet.data.store import ViewStore, identity_of
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, features
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments.cad import Experiment, Rows
from viewnet.recipes import PEERS, RECIPES, VARIANTS
from viewnet.runs import other_views
from viewnet.runtime import provenance
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry, Table, entries

SMOKE_MODELS, SMOKE_COUNT = 8, 80
"""The size of the stand-in for photographs at the smallest profile."""
CODE = (
    *(f"evaluation/{module}.py" for module in ("alignment", "baselines", "features", "predictions")),
    *("geometry.py", "runtime/torchvision_weights.py"),
)
"""What decides the predictions of untrained predictors."""
ALIGNED = {"video_regression": "procrustes"}
"""The alignment of untrained predictors that do not predict in the photographs' frame."""


def photographs(category: str, root: str | None, square: bool, smoke: bool, **settings: Any) -> PhotoConfig:
    """The photographs of a category; without a `root` the stand-in, a small one for `smoke`.

    They are cropped at the size that features are computed at; ViewNet's networks see them at their own.
    """
    stand_in: dict[str, Any] = {"models": SMOKE_MODELS, "count": SMOKE_COUNT} if smoke else {}
    return PhotoConfig(category, root, size=features.SIZE, square=square, **settings, **stand_in)


def content_key(name: str, content: Any) -> str:
    """The key of a table's entry that is no run: its `name`, and 12 hex digits of what decides it, a JSON value."""
    return f"{name}-{identity_of(content)[:12]}"


class PhotoExperiment(Experiment):
    """Photographs are in `data_root`, the CAD models trained on in `cad_root` and `extra_cad`."""

    @property
    def trained_variants(self) -> list[str]:
        """The variants that are not fitted on photographs."""
        return [variant for variant in self.variants if variant in VARIANTS | PEERS]

    @property
    def configs(self) -> list[RunConfig]:
        """One configuration a training: by variant, category and seed."""
        settings: dict[str, Any] = {"extra": self.extra_cad, "backgrounds": self.backgrounds}
        runs = product(self.trained_variants, self.categories, self.seeds)
        return [self._config(*run, **settings) for run in runs]

    def photo_config(self, category: str) -> PhotoConfig:
        """The photographs of a category."""
        square = RECIPES[self.recipe]["model"].get("crop") != "stretched"
        settings = {"subset": self.subset, "keep": self.keep, "margin": self.margin}
        return photographs(category, self.data_root, square, self.smoke, **settings)

    @property
    def note(self) -> str:
        """What the numbers were measured on, in one line."""
        second = " and a second one" if self.extra_cad else ""
        return f"{self.scored_on}; trained on {self.trained_on}{second}, {self.settings}"

    @property
    def scored_on(self) -> str:
        """The kind of photographs, in words."""
        if self.data_root is None:
            return "a stand-in for photographs"
        names = {"imagenet3d": "ImageNet3D", "pascal3d": f"PASCAL3D+ ({self.subset})"}
        known = (name for key, name in names.items() if READERS[key].recognises(Path(str(self.data_root))))
        return next(known, "photographs of another collection")

    def stores(self, progress: bool = True) -> dict[str, ViewStore]:
        """Category -> the view store of its photographs, made where it is missing."""
        return {c: build.photo_views(self.photo_config(c), self.workers, progress) for c in self.categories}

    def scored_views(self, category: str) -> Rows:
        """The photographs that predictions of a category are aligned on and scored on."""
        store = self.stores()[category]
        return {split: (store, store.split(split)) for split in ("val", "test")}

    def table(self, runs: Sequence[Run], added: Sequence[Entry] = (), remarks: Sequence[str] = ()) -> Table:
        """The table of these runs and of the untrained predictors; `added` and `remarks` as in Experiment."""
        return self.table_of([*self.entries(runs, self.stores()), *added], remarks)

    def table_of(self, given: Sequence[Entry], remarks: Sequence[str] = ()) -> Table:
        """The table of these entries; see `table`. Raises ViewnetError for those on photographs of another version."""
        stores = self.stores()
        self.check_photographs([entry for entry in given if not entry.beside], stores)
        return super().table_of(given, [*self.remarks(stores), *remarks])

    def check_photographs(self, own: Sequence[Entry], stores: dict[str, ViewStore]) -> None:
        """Raise ViewnetError for entries on photographs of another version."""
        if other := [e for e in own if e.origin["photographs"] != stores[e.category].identity]:
            what = f"{self.folder / self.name}: {other[0].row} was scored on photographs of another version"
            raise ViewnetError(f"{what}: remove the table's files to make it again")

    def entries_of(self, run: Run) -> list[Entry]:
        """What a finished run adds to the table."""
        return self.trained_entries([run], self.stores())

    @property
    def _untrained_variants(self) -> list[str]:
        return [variant for variant in self.variants if variant not in VARIANTS | PEERS]

    @property
    def untrained_rows(self) -> list[str]:
        """Rows of predictors that are no runs."""
        return [row.label for variant in self._untrained_variants for row in LAYOUTS[self.name].rows_of(variant)]

    def untrained(self) -> list[Entry]:
        """The entries of `untrained_rows`."""
        return self.untrained_entries(self.stores())

    def scores(self, category: str) -> str:
        """What its runs are scored on, as a key."""
        return str(self.photo_config(category))

    @property
    def unmeasured_rows(self) -> tuple[str, ...]:
        """As Experiment.unmeasured_rows, of all variants: not all are runs."""
        return tuple(r.label for r in LAYOUTS[self.name].rows if r.variant and r.variant not in self.variants)

    @property
    def renamed_rows(self) -> dict[str, str]:
        """The names of regressions from other features than the reported ones."""
        rows = [r.label for r in LAYOUTS[self.name].rows if r.variant in ("view_regression", "video_regression")]
        return {row: f"{row} ({self.chosen_features})" for row in rows if self.chosen_features != "vgg16"}

    def remarks(self, stores: dict[str, ViewStore]) -> list[str]:
        """Lines under the table: how untrained rows are fitted, and the photographs left out."""
        count = "all" if self.calibration is None else str(self.calibration)
        return [
            f"aligned, and untrained rows fitted, on {count} calibration photographs",
            f"view regression: ridge {self.ridge:g} from {features.describe(self.chosen_features)}",
            *map(photo_store.summary, stores.values()),
        ]

    @property
    def chosen_features(self) -> str:
        """The features of the view regression, "auto" resolved."""
        return features.choose(self.features)

    @property
    def regression_settings(self) -> dict[str, Any]:
        """What decides a view regression beside the images, for a table's JSON."""
        return {"features": self.chosen_features, "size": features.SIZE, "ridge": self.ridge}

    def entries(self, runs: Sequence[Run], stores: dict[str, ViewStore]) -> list[Entry]:
        """The entries of its table: the runs, and the untrained predictors, on these photographs."""
        return [*self.trained_entries(runs, stores), *self.untrained_entries(stores)]

    def trained_entries(self, runs: Sequence[Run], stores: dict[str, ViewStore]) -> list[Entry]:
        """Of `entries`, the runs."""

        def predictions(run: Run) -> Predictions:
            return other_views.on_photographs(run, stores[run.config.category])

        return [
            replace(entry, origin=entry.origin | {"photographs": stores[entry.category].identity})
            for entry in entries(self.name, runs, predictions, self.calibration)
        ]

    def untrained_entries(self, stores: dict[str, ViewStore]) -> list[Entry]:
        """Of `entries`, the untrained predictors."""
        result = []
        for (category, store), variant in product(stores.items(), self._untrained_variants):
            fitted, settings = self.fitted(variant, store, self.calibration)
            alignment = ALIGNED.get(variant, "none")
            origin: dict[str, Any] = {"variant": variant, "category": category, "photographs": store.identity}
            origin |= {"alignment": alignment, **settings, "calibration": self.calibration}
            key = content_key(variant, [origin, provenance.code_identity(CODE)])
            origin["git"] = provenance.commit()
            for row in LAYOUTS[self.name].rows_of(variant):
                result.append(Entry(row.label, category, 0, alignment, key, fitted, origin, self.calibration))
        return result

    def fitted(
        self, variant: str, store: ViewStore, calibration: int | None = None, seed: int = 0
    ) -> tuple[Predictions, dict[str, Any]]:
        """The predictions of an untrained predictor fitted on calibration photographs, and its settings.

        Its predictions of the split "val" are of those photographs alone.
        """
        rows = baselines.calibrating(store.index, calibration, seed)
        index = store.index[rows]
        if variant == "view_regression":
            values = features.extract(store, self.chosen_features)[rows]
            return baselines.view_regression(index, values, self.ridge), self.regression_settings
        return baselines.ON_CALIBRATION[variant](index), {}
