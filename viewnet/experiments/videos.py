"""What the notebook of the Freiburg table asks for: trained on videos of cars, scored on photographs (section 4.4).

ViewNet sees no viewpoints of the videos. A linear regression fitted on those viewpoints is scored beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet.config import RunConfig, VideoConfig, known
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, features
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments.photos import PROFILE_RECIPE, PhotoExperiment, photographs_of, scenery_of
from viewnet.experiments.request import DESIGNS, folder_named, label_of, shared
from viewnet.model.checkpoint import locate
from viewnet.recipes import VARIANTS, make_config
from viewnet.training.run_store import ensure

SHAPENET = "shapenet"
"""The start that is trained here: ViewNet on CAD models of the category, with the same seed."""
SMOKE_SEQUENCES, SMOKE_FRAMES, SMOKE_SIZE = (1, 2, 3, 4), 8, 32
"""The stand-in for videos at the smallest profile."""
REGRESSED_FRAMES = 24
"""Of every clip, for the view regression: frames 15 degrees apart."""
MASKS = ("files", "alpha", "maskrcnn", "deeplabv3")


@dataclass(frozen=True)
class VideoExperiment(PhotoExperiment):
    """A checked request. Made by `video_experiment`.

    `data_root` is that of the CAD models that a start is trained on.
    """

    video: VideoConfig
    start: str  # "", SHAPENET, or what viewnet.model.checkpoint.locate takes

    @property
    def configs(self) -> list[RunConfig]:
        """One configuration a training on videos; where they start from SHAPENET, `run` says which runs that is."""
        return self._configs(dict.fromkeys(self.seeds, self.start or None))

    @property
    def filmed(self) -> tuple[VideoConfig, ...]:
        """The videos to train on: each is a training of its own."""
        return (self.video,)

    def _configs(self, starts: dict[int, str | None]) -> list[RunConfig]:
        # Without views held out, labelled ones at that, training can only select by reconstruction.
        blind = {"select_by": "reconstruction"} if self.video.split_rule == "all" else {}
        return [
            make_config(
                variant,
                video.category,
                self.profile,
                self.recipe,
                seed,
                video=video,
                start=starts[seed],
                backgrounds=self.backgrounds,
                **blind,
            )
            for video in self.filmed
            for variant in self.variants
            if variant in VARIANTS
            for seed in self.seeds
        ]

    @property
    def starts(self) -> list[RunConfig]:
        """The trainings on CAD models that `run` starts from, one a seed; none where it starts from other weights."""
        if self.start != SHAPENET:
            return []
        return [
            make_config(
                "viewnet",
                self.video.category,
                self.profile,
                self.recipe,
                seed,
                self.data_root,
                backgrounds=self.backgrounds,
            )
            for seed in self.seeds
        ]

    def run(self, progress: bool = True) -> list[Run]:
        """Every run of the experiment, whatever is missing trained first, and before that what it starts from."""
        if not self.starts:
            return super().run(progress)
        begun = ensure(self.starts, self.workers, progress)
        starts: dict[int, str | None] = {run.config.seed: str(run.folder) for run in begun}
        return ensure(self._configs(starts), self.workers, progress)

    @property
    def note(self) -> str:
        """What the numbers were measured on, in a line."""
        filmed = "a stand-in for Freiburg cars" if self.video.root is None else "Freiburg cars"
        begun = {"": "", SHAPENET: " after CAD models"}.get(self.start, " from other weights")
        return f"{self.scored_on}; trained on {filmed}{begun}, {self._made}"

    def remarks(self, stores: dict[str, ViewStore]) -> list[str]:
        """What stands under the table: how the untrained rows are fitted, and the frames and photographs left out."""
        from viewnet.data.build import video_views
        from viewnet.data.clip_store import summary

        told = summary(video_views(self.video, self.workers, progress=False))
        return [
            *super().remarks(stores),
            f"trained on {told}; masks: {self.video.masks}",
            f"video regression: on up to {REGRESSED_FRAMES} frames of every training clip, with their background",
        ]

    def fitted(
        self, variant: str, store: ViewStore, calibration: int | None = None, seed: int = 0
    ) -> tuple[Predictions, dict[str, Any]]:
        """As PhotoExperiment.fitted; the variant "video_regression" is fitted on frames of the training clips."""
        if variant != "video_regression":
            return super().fitted(variant, store, calibration, seed)
        from viewnet.data.build import video_views

        films = video_views(self.regressed, self.workers, progress=False)
        films.require_viewpoints(["train"], "a regression has nothing to be fitted on: use Freiburg static cars")
        mine = (films.index["split"] == "train").to_numpy()
        index = pd.concat([films.index[mine], store.index], ignore_index=True)
        seen = np.concatenate([features.extract(films, self.chosen)[mine], features.extract(store, self.chosen)])
        settings = {"backbone": self.chosen, "size": features.SIZE, "ridge": self.ridge, "videos": films.identity}
        return baselines.view_regression(index, seen, self.ridge, source="train"), settings

    @property
    def regressed(self) -> VideoConfig:
        """Frames as photographs are cut: by their box, with what is behind the object."""
        return replace(
            self.video,
            masks="none",
            margin=self.photographs.margin,
            square=self.photographs.square,
            size=features.SIZE,
            count=REGRESSED_FRAMES,
            pick="evenly",
        )


def video_experiment(
    name: str,
    *,
    profile: str = "default",
    seeds: int | str | Sequence[int] = 1,
    recipe: str = "default",
    video_root: str = "",
    split_rule: str = "all",
    masks: str = "files",
    data_root: str = "",
    start: str = "",
    cad_root: str = "",
    backgrounds: str = "",
    backbone: str = "auto",
    output: str = "",
    workers: int = 0,
) -> VideoExperiment:
    """Check the parameters of a notebook that trains on videos; see viewnet.experiments.photos for the others.

    video_root   Freiburg static cars 52; "": a stand-in is made
    split_rule   all (every sequence is trained on, as in print) or 45/2/rest (by number, so that some are held out)
    masks        files (in masks/ of video_root), alpha, maskrcnn or deeplabv3
    data_root    the photographs: PASCAL3D+ 1.1, or a folder with images/ and viewpoints.csv; "": a stand-in is made
    start        "": random weights, as in print; shapenet: ViewNet trained on CAD models first; else the key or folder
                 of a run
    cad_root     a ShapeNetCore folder for start=shapenet; "": the built-in models
    backgrounds  a folder of images (SUN397) to stand behind what is trained on; "": drawn ones

    Raises ViewnetError naming the parameter and its valid values.
    """
    design = DESIGNS[name]
    common = shared(design, PROFILE_RECIPE, profile, "all", seeds, recipe, output, workers)
    chosen, (category,) = common.fields["profile"], common.fields["categories"]
    behind = scenery_of(backgrounds)
    video = VideoConfig(
        category=category,
        root=folder_named(video_root, "video_root"),
        kind="freiburg",
        split_rule=known(split_rule, ("all", "45/2/rest"), "split_rule"),  # type: ignore[arg-type]
        masks=known(masks, MASKS, "masks"),  # type: ignore[arg-type]
    )
    photographs = photographs_of(common, category, data_root)
    if chosen == "smoke":
        video = replace(video, sequences=SMOKE_SEQUENCES, frames=SMOKE_FRAMES, size=SMOKE_SIZE)
    if cad_root and start != SHAPENET:
        raise ViewnetError(f"cad_root {cad_root}: nothing is trained on CAD models: use start={SHAPENET}, or leave it")
    begun = start if start in ("", SHAPENET) else str(locate(start))
    features.choose(backbone)
    places = {"video_root": video_root, "data_root": data_root, "cad_root": cad_root}
    parts = [*common.parts, *(place for place, value in places.items() if value)]
    parts += ["held_out"] if split_rule != "all" else []
    parts += [masks] if masks != "files" else []
    parts += [SHAPENET if start == SHAPENET else f"start_{Path(begun).parent.name}"] if start else []
    parts += ["backgrounds"] if behind != "drawn" else []
    parts += [backbone] if backbone != "auto" else []
    return VideoExperiment(
        name=name,
        **common.fields,
        variants=design.variants,
        data_root=folder_named(cad_root, "cad_root"),
        splits=None,
        eval_root=None,
        viewpoints=None,
        label=label_of(chosen, parts),
        extra_cad=None,
        backgrounds=behind,
        photographs=photographs,
        backbone=backbone,
        ridge=baselines.RIDGE,
        calibration=None,
        video=video,
        start=begun,
    )
