"""A finished run as a renderer of its test objects: from any viewpoint, in the annotated frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.data import augment, build
from viewnet.data.pairs import Views, model_views
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import Procrustes, Yaw
from viewnet.evaluation.evaluate import Aligned, align
from viewnet.evaluation.predict import predict
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.geometry import look_at, view_vector
from viewnet.model.checkpoint import load_model
from viewnet.model.reconstruction import Encoded, compare
from viewnet.model.rendering import ObjectRenderer, to_uint8
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.files import read_json
from viewnet.runtime.images import tight_crop

BATCH = 64  # images rendered at once


@dataclass(frozen=True)
class RunRenderer(ObjectRenderer):
    """A trained network with the test views of a store, numbered in its order, that of `aligned.predictions`."""

    network: ViewNet
    config: RunConfig
    store: ViewStore
    aligned: Aligned

    @classmethod
    def of(cls, folder: Path, store: ViewStore) -> "RunRenderer":
        """Of a finished run, aligned on the validation views of `store`. ViewnetError as of load_model and align.

        Viewpoints are predicted again unless the views are the run's own.
        """
        network, config = load_model(folder)
        saved, path = folder / "predictions.parquet", folder / "result.json"
        result = read_json(path) if path.is_file() else None
        own = saved.is_file() and isinstance(result, dict) and result.get("views") == store.identity
        return cls(network, config, store, align(Predictions.from_parquet(saved) if own else predict(folder, store)))

    def __len__(self) -> int:
        return len(self.aligned.predictions)

    @property
    def rotation(self) -> Tensor:
        """(3, 3), from the own frame to the annotated one. ViewnetError for an alignment that is no rotation."""
        if not isinstance(self.aligned.alignment, Procrustes):
            raise ViewnetError(f"alignment {self.aligned.alignment.kind} is no rotation: align by procrustes or robust")
        return torch.tensor(self.aligned.alignment.rotation, dtype=torch.float32)

    @cached_property
    def views(self) -> Views:
        """The test views, at the larger of the network's input and output sizes."""
        model = self.network.config
        return model_views(self.store, "test", max(model.input_size, model.render_size), model)

    @cached_property
    def backgrounds(self) -> Tensor | None:
        """The backgrounds that the run was trained with, if any; None for photographs, which have their own."""
        size = self.network.config.input_size
        return None if self.views.opaque else augment.load(self.config.data, size, self.device)

    def images(self, rows: Sequence[int], size: int | None = None) -> Tensor:
        """Test views (N, 4, S, S), RGB times alpha and alpha; by default of the network's output size."""
        return self.views.images(torch.as_tensor(rows), size or self.network.config.render_size, self.device)

    def test_images(self, rows: Sequence[int]) -> np.ndarray:
        """Test views (N, S, S, 3) uint8 on white, of the network's input size."""
        return to_uint8(self.images(rows, self.network.config.input_size))

    def next_views(self, rows: Sequence[int]) -> list[int]:
        """The next view of each view's object, or the view itself where there is no other."""
        return list(map(int, self.views.next_views(torch.as_tensor(rows))))

    @torch.no_grad()
    def encode(self, rows: Sequence[int]) -> Encoded:
        """The objects in test views; on fixed backgrounds where the appearance network was trained with these."""
        images = self.images(rows, self.network.config.input_size)
        if self.backgrounds is not None:
            generator = torch.Generator().manual_seed(0)  # the same object behind the same background each time
            images = augment.appearance(images, self.backgrounds, self.config.train.photo, generator)
        return Encoded(*self.network.encode(images))

    def level(self, azimuth: Tensor, elevation: Tensor) -> Tensor:
        """Own camera frames (..., 3, 3), held level, of annotated azimuths (...) and own elevations (...), degrees."""
        # The full rotation of a network without a common frame may tilt objects; this one keeps elevations.
        assert self.aligned.calibration is not None  # its own validation views
        turn = Yaw.fit(self.aligned.calibration.selected, self.aligned.calibration.truth).rotation
        return torch.tensor(turn.T, dtype=torch.float32) @ look_at(view_vector(azimuth, elevation))

    def predicted_frames(self, rows: Sequence[int]) -> Tensor:
        """Own camera frames (N, 3, 3) of the viewpoints that the network selects for test views."""
        taken = self.aligned.predictions.take(list(rows))  # those of the tables, not predicted again
        ups = None if taken.ups is None else torch.from_numpy(taken.ups[np.arange(len(taken)), taken.choice])
        return look_at(torch.from_numpy(np.array(taken.selected)), ups).float()

    def heads(self, rows: Sequence[int]) -> tuple[Tensor, Tensor | None]:
        """View vectors (N, M, 3) of each head for test views, in the own frame; its up vectors, None where level."""
        found = self.aligned.predictions.take(list(rows))
        ups = None if found.ups is None else torch.tensor(found.ups).float().to(self.device)
        return torch.tensor(found.hypotheses).float().to(self.device), ups

    @torch.no_grad()
    def reconstruction_errors(self, objects: Encoded, rows: Sequence[int]) -> Tensor:
        """Errors (N, M) of test views reconstructed by each head from `objects`, compared as in training."""
        vectors, ups = self.heads(rows)
        return compare(self.network, objects, vectors[:, :, None], ups, self.images(rows), self.config.train)[1]

    def reconstruct(self, rows: Sequence[int], size: int | None = None) -> Tensor:
        """Reconstructions (N, 4, S, S) of test views: own appearance, selected viewpoint; cropped like photographs."""
        rendered = self.render(self.encode(rows), self.predicted_frames(rows), size)
        return tight_crop(rendered, rendered.shape[-1], margin=0.0) if self.views.opaque else rendered


def own_views(run: Run) -> ViewStore:
    """The views that a run was trained and scored on."""
    return build.view_store(run.config.data, progress=False)


Stores = Callable[[Run], ViewStore]  # the views to use of a run: its own (`own_views`), or photographs


def renderers(runs: Sequence[Run], stores: Stores = own_views) -> list[RunRenderer]:
    """A renderer for each run. ViewnetError for no runs, and for a run that was not trained."""
    if not runs:
        raise ViewnetError("no runs to render: train some first")
    for run in runs:
        if not run.trained:
            raise ViewnetError(f"{run.name} renders nothing: choose a trained variant")
    return [RunRenderer.of(run.folder, stores(run)) for run in runs]
