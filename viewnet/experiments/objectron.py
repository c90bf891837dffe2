"""What the notebook of the Objectron paragraph asks for: from CAD models on to videos, with good masks and with weak.

ViewNet is trained on CAD models, and from there on ten frames of every video (section 4.4): once cut out by masks of a
network that learned from masks, once by those of one that learned from words only. All three are scored on photographs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from viewnet.config import RunConfig, VideoConfig, known
from viewnet.data.readers import objectron
from viewnet.data.store import ViewStore
from viewnet.data.synthetic.objectron_standin import WEAK
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines
from viewnet.evaluation.run import Run
from viewnet.experiments.photos import PROFILE_RECIPE, photographs_of, scenery_of
from viewnet.experiments.request import DESIGNS, folder_named, label_of, shared
from viewnet.experiments.videos import MASKS, SHAPENET, SMOKE_SIZE, VideoExperiment
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry
from viewnet.training.run_store import ensure

FRAMES = 10
"""Of every video, drawn at random, as in print."""
STAND_IN_VIDEOS, STAND_IN_FRAMES = 160, 30
SMOKE_VIDEOS, SMOKE_FRAMES = 6, 6


@dataclass(frozen=True)
class ObjectronExperiment(VideoExperiment):
    """A checked request. Made by `objectron_experiment`; `video` has the supervised masks, `weak` the others."""

    weak: VideoConfig | None  # None: the row is left as printed

    @property
    def filmed(self) -> tuple[VideoConfig, ...]:
        """The videos by their supervised masks and, where there are any, by the weak ones."""
        return (self.video,) if self.weak is None else (self.video, self.weak)

    @property
    def configs(self) -> list[RunConfig]:
        """The trainings on CAD models, then those on videos; see VideoExperiment.configs."""
        return [*self.starts, *super().configs]

    def run(self, progress: bool = True) -> list[Run]:
        """Every run of the experiment, the trainings on CAD models first."""
        return [*ensure(self.starts, self.workers, progress), *super().run(progress)]

    @property
    def note(self) -> str:
        """What the numbers were measured on, in a line."""
        filmed = "a stand-in for Objectron" if self.video.root is None else "Objectron"
        drawn = "built-in models" if self.data_root is None else "a CAD collection"
        return f"{self.scored_on}; trained on {drawn}, then on {filmed}, {self._made}"

    def remarks(self, stores: dict[str, ViewStore]) -> list[str]:
        """What stands under the table: how the constant is fitted, and the frames and photographs left out."""
        from viewnet.data.build import video_views
        from viewnet.data.clip_store import summary
        from viewnet.data.photo_store import summary as photographs

        told = ["aligned, and the constant fitted, on all calibration photographs"]
        for kind, video in zip(("supervised", "weak"), self.filmed, strict=False):
            made = f"{video.masks} in {Path(video.mask_folder).name}" if video.masks == "files" else video.masks
            told.append(f"{kind} masks ({made}): {summary(video_views(video, self.workers, progress=False))}")
        return told + [photographs(store) for store in stores.values()]

    @property
    def called(self) -> dict[str, str]:
        """No row has another name."""
        return {}

    @property
    def unasked(self) -> tuple[str, ...]:
        """The rows of weak masks where there are none."""
        return () if self.weak else tuple(label for label, name in _ROW_NAMES.items() if name == _ROWS[2])

    def entries(self, runs_: Sequence[Run], stores: dict[str, ViewStore], name: str | None = None) -> list[Entry]:
        """As PhotoExperiment.entries; all trained rows are of one variant, and what a run was trained on tells them."""
        keys = {run.key: self._row(run) for run in runs_}
        found = super().entries(runs_, stores, name)
        # Of a run that is aligned otherwise the key is followed by how.
        rows = {entry.key: keys.get(entry.key.partition("/")[0]) for entry in found}
        return [entry for entry in found if rows[entry.key] in (None, _ROW_NAMES.get(entry.row))]

    def _row(self, run: Run) -> str:
        video = run.config.data.video
        return _ROWS[0 if video is None else 1 + self.filmed.index(video)]


_ROW_NAMES = {row.label: row.name for row in LAYOUTS["objectron"].rows_of("viewnet")}
"""Label -> name without the alignment."""
_ROWS = tuple(dict.fromkeys(_ROW_NAMES.values()))


def objectron_experiment(
    name: str,
    *,
    profile: str = "default",
    category: str = "chair",
    seeds: int | str | Sequence[int] = 1,
    recipe: str = "default",
    video_root: str = "",
    masks: str = "files",
    weak_masks: str = "",
    data_root: str = "",
    cad_root: str = "",
    backgrounds: str = "",
    output: str = "",
    workers: int = 0,
) -> ObjectronExperiment:
    """Check the parameters of the notebook; see viewnet.experiments.photos and viewnet.experiments.videos for the others.

    category     chair, as in print, bicycle or bottle
    video_root   Objectron; "": a stand-in is made
    masks        supervised ones: files (in masks/ of video_root), maskrcnn or deeplabv3 (as in print)
    weak_masks   weakly supervised ones: a folder laid out as masks/, within video_root or anywhere; "": the stand-in's
                 own, and none of Objectron
    cad_root     a ShapeNetCore folder to start on; "": the built-in models

    Raises ViewnetError naming the parameter and its valid values.
    """
    design = DESIGNS[name]
    known(category, objectron.CLASSES, "category")
    common = shared(design, PROFILE_RECIPE, profile, [category], seeds, recipe, output, workers)
    chosen = common.fields["profile"]
    behind = scenery_of(backgrounds)
    root = folder_named(video_root, "video_root")
    if weak_masks and root is None:
        raise ViewnetError(f"weak_masks {weak_masks}: the stand-in has masks of its own: give video_root, or leave it")
    video = VideoConfig(
        category=category,
        root=root,
        kind="objectron",
        count=FRAMES,
        masks=known(masks, MASKS, "masks"),  # type: ignore[arg-type]
        videos=STAND_IN_VIDEOS,
        frames=STAND_IN_FRAMES,
    )
    photographs = photographs_of(common, category, data_root)
    if chosen == "smoke":
        video = replace(video, videos=SMOKE_VIDEOS, frames=SMOKE_FRAMES, size=SMOKE_SIZE)
    weak = weak_masks or ("" if root else WEAK)
    places = {"video_root": video_root, "weak_masks": weak_masks, "data_root": data_root, "cad_root": cad_root}
    parts = [*common.parts, *common.columns]
    parts += [place for place, value in places.items() if value]
    parts += [masks] if masks != "files" else []
    parts += ["backgrounds"] if behind != "drawn" else []
    return ObjectronExperiment(
        name=name,
        **common.fields,
        variants=("viewnet",),
        data_root=folder_named(cad_root, "cad_root"),
        splits=None,
        eval_root=None,
        viewpoints=None,
        label=label_of(chosen, parts),
        extra_cad=None,
        backgrounds=behind,
        photographs=photographs,
        backbone="pixels",
        ridge=baselines.RIDGE,
        calibration=None,
        video=video,
        start=SHAPENET,
        weak=replace(video, masks="files", mask_folder=weak) if weak else None,
    )
