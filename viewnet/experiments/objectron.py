"""The Objectron experiment: trained on CAD models, then on videos with good masks or with weak ones (section 4.4).

ViewNet is trained on CAD models, and from there on ten frames of every video: once cut out by masks of a network that
was trained on masks, once by those of one that was trained on class names only. All three are scored on photographs.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from viewnet.config import RunConfig, VideoConfig
from viewnet.data import photo_store
from viewnet.data.store import ViewStore
from viewnet.data.synthetic.objectron_standin import WEAK
from viewnet.errors import ViewnetError
from viewnet.evaluation.run import Run
from viewnet.experiments.videos import SMOKE_SIZE, VideoExperiment
from viewnet.runs.run_store import ensure
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry

FRAMES = 10
"""Of every video, sampled at random, as reported."""
STAND_IN: dict[str, Any] = {"videos": 160, "frames": 30}
SMOKE: dict[str, Any] = {"videos": 6, "frames": 6, "size": SMOKE_SIZE}
_NAMES = {row.label: row.name for row in LAYOUTS["objectron"].rows_of("viewnet")}
"""Label -> name without the alignment."""
_ROWS = tuple(dict.fromkeys(_NAMES.values()))
"""CAD models, supervised masks, weak masks."""


class ObjectronExperiment(VideoExperiment):
    """`masks` are the supervised ones, `weak_masks` the others. Raises ViewnetError for these without `video_root`."""

    def __post_init__(self) -> None:
        if self.weak_masks and self.video_root is None:
            raise ViewnetError(
                f"weak_masks {self.weak_masks}: the stand-in has masks of its own: give video_root, or leave it"
            )

    @property
    def video(self) -> VideoConfig:
        """The videos with their supervised masks."""
        settings: dict[str, Any] = {"kind": "objectron", "count": FRAMES, "masks": self.masks}
        return VideoConfig(self.categories[0], self.video_root, **settings, **(SMOKE if self.smoke else STAND_IN))

    @property
    def weak(self) -> VideoConfig | None:
        """The videos with their weakly supervised masks; None where there are none."""
        folder = self.weak_masks or (WEAK if self.video_root is None else "")
        return replace(self.video, masks="files", mask_folder=folder) if folder else None

    @property
    def videos(self) -> tuple[VideoConfig, ...]:
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
        """What the numbers were measured on, in one line."""
        videos = "a stand-in for Objectron" if self.video_root is None else "Objectron"
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
        return () if self.weak else tuple(label for label, row in _NAMES.items() if row == _ROWS[2])

    def entries(self, runs: Sequence[Run], stores: dict[str, ViewStore], name: str | None = None) -> list[Entry]:
        """As PhotoExperiment.entries; all trained rows are of one variant, and told apart by the videos trained on."""
        trainings = (None, *self.videos)
        rows = {run.key: _ROWS[trainings.index(run.config.data.video)] for run in runs}
        # The key of a run in another alignment is followed by that: "key/linear".
        keyed = [(rows.get(e.key.partition("/")[0]), e) for e in super().entries(runs, stores, name)]
        return [entry for row, entry in keyed if row in (None, _NAMES.get(entry.row))]
