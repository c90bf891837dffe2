"""Experiments on videos: trained on them, scored on photographs (section 4.4, tables of Freiburg cars and Objectron).

ViewNet sees no viewpoints of the videos. On Freiburg cars a linear regression fitted on those viewpoints is scored
beside it. For Objectron ViewNet is trained on CAD models, and from there on ten frames of every video: once cut out by
masks of a network that was trained on masks, once by those of one that was trained on class names only.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet.config import RunConfig, VideoConfig
from viewnet.data import build, clip_store, photo_store
from viewnet.data.readers import uco3d
from viewnet.data.store import ViewStore
from viewnet.data.synthetic.objectron_standin import WEAK
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, features
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments.parameters import SHAPENET
from viewnet.experiments.photos import PhotoExperiment
from viewnet.recipes import PEERS, make_config
from viewnet.runs.needs import Needs, needs
from viewnet.runs.run_store import ensure
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry, run_of

SMOKE_CARS: dict[str, Any] = {"sequences": (1, 2, 3, 4), "frames": 8, "size": 32}
"""The stand-in for Freiburg cars at the smallest profile."""
REGRESSED_FRAMES = 24
"""Of every clip, for the view regression: frames 15 degrees apart."""
OBJECTRON_FRAMES = 10
"""Of every video, sampled at random, as reported."""
OBJECTRON: dict[str, Any] = {"videos": 160, "frames": 30}
SMOKE_OBJECTRON: dict[str, Any] = {"videos": 6, "frames": 6, "size": 32}
"""The stand-ins for Objectron."""
_NAMES = {row.label: row.name for row in LAYOUTS["objectron"].rows_of("viewnet")}
"""Label -> name without the alignment."""
_ROWS = tuple(dict.fromkeys(_NAMES.values()))
"""CAD models, supervised masks, weak masks."""


class VideoExperiment(PhotoExperiment):
    """Videos are in `video_root`; models start from `start`, which `cad_root` is for if that is "shapenet".

    Raises ViewnetError for a `cad_root` without use.
    """

    def __post_init__(self) -> None:
        if self.cad_root and self.start != SHAPENET:
            what = f"cad_root {self.cad_root}: nothing is trained on CAD models"
            raise ViewnetError(f"{what}: use start={SHAPENET}, or leave it")

    @property
    def video(self) -> VideoConfig:
        """The videos, of the first category."""
        settings: dict[str, Any] = {"kind": "freiburg", "split_rule": self.split_rule, "masks": self.masks}
        return VideoConfig(self.categories[0], self.video_root, **settings, **(SMOKE_CARS if self.smoke else {}))

    @property
    def videos(self) -> tuple[VideoConfig, ...]:
        """The videos to train on: each is a training of its own."""
        return (self.video,)

    @property
    def trained_variants(self) -> list[str]:
        """As PhotoExperiment.trained_variants; methods of other papers cannot start from ViewNet's weights."""
        return [variant for variant in super().trained_variants if not (self.start and variant in PEERS)]

    @property
    def unmeasured_rows(self) -> tuple[str, ...]:
        """As PhotoExperiment.unmeasured_rows, and those of variants that are not trained."""
        left_out = {*super().trained_variants} - {*self.trained_variants}
        rows = (row.label for variant in left_out for row in LAYOUTS[self.name].rows_of(variant))
        return (*super().unmeasured_rows, *rows)

    @property
    def configs(self) -> list[RunConfig]:
        """One configuration a training on videos; with start "shapenet" without the weights, which `run` fills in."""
        return self._configs(dict.fromkeys(self.seeds, self.start or None))

    def _configs(self, starts: Mapping[int, str | None]) -> list[RunConfig]:
        # Without annotated views held out, training can only select weights by reconstruction.
        selection: dict[str, Any] = {"select_by": "reconstruction"} if self.video.split_rule == "all" else {}
        settings: dict[str, Any] = {"backgrounds": self.backgrounds} | selection
        how = (self.profile, self.recipe)
        return [
            make_config(variant, video.category, *how, seed, video=video, start=starts[seed], **settings)
            for video, variant, seed in product(self.videos, self.trained_variants, self.seeds)
        ]

    @property
    def starts(self) -> list[RunConfig]:
        """The trainings on CAD models that `run` starts from, one a seed; none where it starts from other weights."""
        seeds = self.seeds if self.start == SHAPENET else ()
        return [self._config("viewnet", self.categories[0], seed, backgrounds=self.backgrounds) for seed in seeds]

    def run(self, progress: bool = True) -> list[Run]:
        """Every run of the experiment; missing ones, and before them those they start from, are trained first."""
        if not self.starts:
            return super().run(progress)
        starts = {run.config.seed: str(run.folder) for run in ensure(self.starts, self.workers, progress)}
        return ensure(self._configs(starts), self.workers, progress)

    def needs(self) -> Needs:
        """As Experiment.needs; what starts from runs that are missing is not known before them."""
        begun = needs(self.starts)
        if not all(row["kept"] for row in begun.runs.values()):
            return needs(self.starts, later=self._configs(dict.fromkeys(self.seeds, SHAPENET)))
        folders = [row["folder"] for row in begun.runs.values()] or [self.start or None] * len(self.seeds)
        return begun | needs(self._configs(dict(zip(self.seeds, folders, strict=True))))

    @property
    def note(self) -> str:
        """What the numbers were measured on, in one line."""
        videos = "a stand-in for Freiburg cars" if self.video_root is None else "Freiburg cars"
        start = {"": "", SHAPENET: " after CAD models"}.get(self.start, " from other weights")
        return f"{self.scored_on}; trained on {videos}{start}, {self.settings}"

    def video_summary(self, video: VideoConfig) -> str:
        """Which clips and frames are used, and which left out, in words."""
        return clip_store.summary(build.video_views(video, self.workers, progress=False))

    def remarks(self, stores: dict[str, ViewStore]) -> list[str]:
        """Lines under the table: how untrained rows are fitted, and the frames and photographs left out."""
        return [
            *super().remarks(stores),
            f"trained on {self.video_summary(self.video)}; masks: {self.masks}",
            f"video regression: on up to {REGRESSED_FRAMES} frames of every training clip, with their background",
        ]

    def fitted(
        self, variant: str, store: ViewStore, calibration: int | None = None, seed: int = 0
    ) -> tuple[Predictions, dict[str, Any]]:
        """As PhotoExperiment.fitted; the variant "video_regression" is fitted on frames of the training clips."""
        if variant != "video_regression":
            return super().fitted(variant, store, calibration, seed)
        clips = build.video_views(self.regressed, self.workers, progress=False)
        clips.require_viewpoints(["train"], "a regression has nothing to be fitted on: use Freiburg static cars")
        train = (clips.index["split"] == "train").to_numpy()
        index = pd.concat([clips.index[train], store.index], ignore_index=True)
        values = [features.extract(clips, self.chosen_features)[train], features.extract(store, self.chosen_features)]
        settings = self.regression_settings | {"videos": clips.identity}
        return baselines.view_regression(index, np.concatenate(values), self.ridge, source="train"), settings

    @property
    def regressed(self) -> VideoConfig:
        """The frames of the view regression: cropped as photographs are, to the box with its background."""
        photographs = self.photo_config(self.categories[0])
        cut: dict[str, Any] = {"margin": photographs.margin, "square": photographs.square, "size": features.SIZE}
        return replace(self.video, masks="none", count=REGRESSED_FRAMES, pick="evenly", **cut)


class ObjectronExperiment(VideoExperiment):
    """`masks` are the supervised ones, `weak_masks` the others. Raises ViewnetError for these without `video_root`.

    Videos may be uCO3D's in place of Objectron's.
    """

    def __post_init__(self) -> None:
        if self.weak_masks and self.video_root is None:
            remedy = "the stand-in has masks of its own: give video_root, or leave it"
            raise ViewnetError(f"weak_masks {self.weak_masks}: {remedy}")

    @property
    def video(self) -> VideoConfig:
        """The videos with their supervised masks."""
        kind = "uco3d" if self._of_uco3d else "objectron"
        settings: dict[str, Any] = {"kind": kind, "count": OBJECTRON_FRAMES, "masks": self.masks}
        settings |= SMOKE_OBJECTRON if self.smoke else OBJECTRON
        return VideoConfig(self.categories[0], self.video_root, **settings)

    @property
    def _of_uco3d(self) -> bool:
        return self.video_root is not None and uco3d.READER.accepts(Path(self.video_root))

    @property
    def videos(self) -> tuple[VideoConfig, ...]:
        """The videos by their supervised masks and, where there are any, by the weakly supervised ones."""
        folder = self.weak_masks or (WEAK if self.video_root is None else "")
        return (self.video, replace(self.video, masks="files", mask_folder=folder)) if folder else (self.video,)

    @property
    def configs(self) -> list[RunConfig]:
        """The trainings on CAD models, then those on videos; see VideoExperiment.configs."""
        return [*self.starts, *super().configs]

    def run(self, progress: bool = True) -> list[Run]:
        """Every run of the experiment, the trainings on CAD models first."""
        return [*ensure(self.starts, self.workers, progress), *super().run(progress)]

    @property
    def note(self) -> str:
        """What the numbers were measured on, in one line."""
        given = "uCO3D" if self._of_uco3d else "Objectron"
        videos = "a stand-in for Objectron" if self.video_root is None else given
        return f"{self.scored_on}; trained on {self.trained_on}, then on {videos}, {self.settings}"

    def remarks(self, stores: dict[str, ViewStore]) -> list[str]:
        """Lines under the table: how the constant is fitted, and the frames and photographs left out."""
        lines = ["aligned, and the constant fitted, on all calibration photographs"]
        for kind, video in zip(("supervised", "weak"), self.videos, strict=False):
            source = f"{video.masks} in {Path(video.mask_folder).name}" if video.masks == "files" else video.masks
            lines.append(f"{kind} masks ({source}): {self.video_summary(video)}")
        return [*lines, *map(photo_store.summary, stores.values())]

    @property
    def unmeasured_rows(self) -> tuple[str, ...]:
        """The rows of weak masks where there are none."""
        return () if len(self.videos) > 1 else tuple(label for label, row in _NAMES.items() if row == _ROWS[2])

    def entries(self, runs: Sequence[Run], stores: dict[str, ViewStore]) -> list[Entry]:
        """As PhotoExperiment.entries; all trained rows are of one variant, and told apart by the videos trained on."""
        trainings = (None, *self.videos)
        rows = {run.key: _ROWS[trainings.index(run.config.data.video)] for run in runs}
        return [e for e in super().entries(runs, stores) if rows.get(run_of(e.key)) in (None, _NAMES.get(e.row))]
