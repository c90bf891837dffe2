"""What a trained network draws of the objects in a view store, from viewpoints in the annotated frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from viewnet import scene, volume
from viewnet.alignment import Procrustes
from viewnet.config import RunConfig
from viewnet.data.pairs import Views, tight_crop, viewed
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluate import Aligned, align
from viewnet.files import read_json
from viewnet.geometry import look_at, view_vector
from viewnet.losses import composite
from viewnet.model import ViewNet
from viewnet.predict import load_model, predict
from viewnet.predictions import Predictions
from viewnet.runs import Run, name

BATCH = 64
SPLIT = "test"
SILHOUETTE = 0.35
"""The grey of silhouettes."""


@dataclass(frozen=True)
class Imagined:
    """What appearance pictures became: codes (B, A) and volumes (B, 4, n, n, n), as ViewNet.imagine gives them."""

    code: Tensor
    shape: Tensor


@dataclass(frozen=True)
class Drawer:
    """A trained network before the test views of a store, and the rotation between its frame and the annotated one.

    Rows number the test views in the store's order, which is that of `aligned.predictions`.
    """

    network: ViewNet
    config: RunConfig
    store: ViewStore
    aligned: Aligned

    @classmethod
    def of(cls, folder: Path, store: ViewStore) -> Drawer:
        """Of a finished run. Its rotation is fitted on the validation views of `store`, as in the tables.

        Views of `store` are looked at again unless they are the run's own. Raises ViewnetError as
        viewnet.predict.load_model and viewnet.evaluate.align do.
        """
        network, config = load_model(folder)
        kept, result = folder / "predictions.parquet", folder / "result.json"
        told = read_json(result) if result.is_file() else None
        own = kept.is_file() and isinstance(told, dict) and told.get("views") == store.identity
        said = Predictions.from_parquet(kept) if own else predict(folder, store)
        return cls(network, config, store, align(said))

    def __len__(self) -> int:
        return len(self.aligned.predictions)

    @property
    def hologan(self) -> bool:
        """Whether the decoder paints whole pictures: it has neither a mask nor a volume of colours."""
        return self.network.config.decoder == "hologan"

    @property
    def device(self) -> torch.device:
        """Where the network is."""
        return self.network.focal.device

    @property
    def rotation(self) -> Tensor:
        """(3, 3), from the own frame to the annotated one. ViewnetError for an alignment that is no rotation."""
        if not isinstance(self.aligned.alignment, Procrustes):
            raise ViewnetError(f"alignment {self.aligned.alignment.kind} is no rotation: align by procrustes or robust")
        return torch.tensor(self.aligned.alignment.rotation, dtype=torch.float32)

    @cached_property
    def turn(self) -> float:
        """Degrees to add to own azimuths to have annotated ones: the best turn about the vertical alone.

        Where a network has learned no common frame its rotation may lean anywhere; this leaves elevations as they are.
        """
        said, true = self.aligned.calibration.selected[:, :2], self.aligned.calibration.truth[:, :2]
        sine = (said[:, 0] * true[:, 1] - said[:, 1] * true[:, 0]).sum()
        return float(np.degrees(np.arctan2(sine, (said * true).sum())))

    @cached_property
    def views(self) -> Views:
        """The test views, at the larger of the sizes that the network reads and draws."""
        model = self.network.config
        return viewed(self.store, SPLIT, max(model.input_size, model.render_size), model)

    @cached_property
    def _scenery(self) -> Tensor | None:
        if self.views.opaque:
            return None
        return scene.load(self.config.data, self.network.config.input_size, self.device)

    def pictures(self, rows: Sequence[int], size: int | None = None) -> Tensor:
        """Test views (N, 4, S, S), RGB times alpha and alpha, of the size that the network draws unless told."""
        size = self.network.config.render_size if size is None else size
        return self.views.pictures(torch.as_tensor(rows), size, self.device)

    def shown(self, rows: Sequence[int]) -> np.ndarray:
        """Test views (N, S, S, 3) uint8 before white, of the size that the network reads."""
        return shown(self.pictures(rows, self.network.config.input_size))

    def partners(self, rows: Sequence[int]) -> list[int]:
        """The next view of each view's object, or the view itself where there is no other."""
        found: list[int] = self.views.partners(torch.as_tensor(rows)).tolist()
        return found

    @torch.no_grad()
    def imagine(self, rows: Sequence[int]) -> Imagined:
        """The objects in test views; before a background, always the same, for a run that was trained so."""
        size, behind = self.network.config.input_size, None
        if self._scenery is not None:
            chance = torch.Generator().manual_seed(0)
            behind = scene.behind(self._scenery, len(rows), size, chance, self.device)
        return Imagined(*self.network.imagine(self.pictures(rows, size), behind=behind))

    @torch.no_grad()
    def draw(self, imagined: Imagined, frames: Tensor, size: int | None = None) -> Tensor:
        """Pictures (N, 4, S, S), RGB times mask and mask, from camera frames (N, 3, 3) in the network's own frame.

        N is a multiple of B, as in ViewNet.draw. A `size` above the configuration's shows volumes larger, with as many
        steps along a ray as they were learned with; the HoloGAN decoder has one size only.
        """
        frames, learned = frames.float().to(self.device), self.network.config.render_size
        if self.hologan or size is None or size == learned:
            return self.network.draw(imagined.shape, imagined.code, frames)
        return volume.render(imagined.shape, frames, self.network.focal, size, steps=learned)

    def painted(self, drawn: Tensor) -> np.ndarray:
        """`shown` before white; silhouettes where masks are all that was learned, since colours are then arbitrary."""
        if self.config.train.target == "mask":
            drawn = torch.cat([SILHOUETTE * drawn[:, 3:].expand(-1, 3, -1, -1), drawn[:, 3:]], 1)
        return shown(drawn)

    def own(self, frames: Tensor) -> Tensor:
        """Camera frames (..., 3, 3) of the annotated frame as seen in the network's own."""
        return self.rotation.T @ frames.float()

    def level(self, azimuth: Tensor, elevation: Tensor) -> Tensor:
        """Own camera frames (..., 3, 3), held level, of annotated azimuths (...) and own elevations (...), degrees."""
        return look_at(view_vector(azimuth - self.turn, elevation))

    def answers(self, rows: Sequence[int]) -> Tensor:
        """Own camera frames (N, 3, 3) of the viewpoints that the network selects for test views."""
        said = self.aligned.predictions.take(list(rows))
        ups = None if said.ups is None else torch.from_numpy(said.ups[np.arange(len(said)), said.choice])
        return look_at(torch.from_numpy(np.array(said.selected)), ups).float()

    def reconstruct(self, rows: Sequence[int], size: int | None = None) -> Tensor:
        """Test views drawn again (N, 4, S, S) from nothing but themselves: own appearance, selected viewpoint.

        Photographs are cut to their object, so drawings of them are too.
        """
        drawn = self.draw(self.imagine(rows), self.answers(rows), size)
        return tight_crop(drawn, drawn.shape[-1], margin=0.0) if self.views.opaque else drawn


def own_views(run: Run) -> ViewStore:
    """The views that a run was trained and scored on."""
    from viewnet.data.prepare import view_store

    return view_store(run.config.data, progress=False)


Stores = Callable[[Run], ViewStore]
"""Which views to show a run: its own (`own_views`), or photographs."""


def drawers(runs: Sequence[Run], stores: Stores = own_views) -> list[Drawer]:
    """A drawer for each run. ViewnetError for none, and for a run that was not trained."""
    if not runs:
        raise ViewnetError("no runs to draw with: train some first")
    for run in runs:
        if not run.trained:
            raise ViewnetError(f"{name(run.config)} draws nothing: choose a trained variant")
    return [Drawer.of(run.folder, stores(run)) for run in runs]


def shown(pictures: Tensor, grey: float = 1.0) -> np.ndarray:
    """Pictures (N, 4, H, W), RGB times mask and mask, before a grey wall: (N, H, W, 3) uint8."""
    wall = torch.full((len(pictures), 3), grey, device=pictures.device)
    colours = composite(pictures, wall).clamp(0, 1) * 255
    array: np.ndarray = colours.round().to(torch.uint8).movedim(1, -1).cpu().numpy()
    return array
