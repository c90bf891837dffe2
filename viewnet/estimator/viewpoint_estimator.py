"""A trained ViewNet for people's own images: where they were taken from, and what their object is like elsewhere.

`ViewpointEstimator.from_pretrained` gives one of a finished run. Here is one that has learned nothing yet:

>>> from viewnet.recipes import make_config
>>> config = make_config(profile="smoke", recipe="photos", backgrounds=None)
>>> estimator = ViewpointEstimator(ViewNet(config.model).eval(), config)
>>> photograph = np.full((300, 400, 3), 128, np.uint8)
>>> found = estimator.predict([photograph, photograph], boxes=[(40, 60, 380, 250), None])
>>> found.vector.shape, found.hypotheses.shape, found.aligned
((2, 3), (2, 3, 3), False)
>>> estimator.novel_view(photograph, azimuth=90, elevation=10).shape
(1, 16, 16, 3)
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from viewnet.data.pairs import tight_crop
from viewnet.errors import ViewnetError
from viewnet.estimator import hub, inputs, preprocess, pretrained
from viewnet.estimator.inputs import ImageLike, ImagesLike
from viewnet.estimator.preprocess import Framing, Shown
from viewnet.estimator.pretrained import Pretrained
from viewnet.estimator.viewpoints import Viewpoints
from viewnet.geometry import look_at, view_vector
from viewnet.model.reconstruction import Encoded
from viewnet.model.rendering import ObjectRenderer
from viewnet.model.viewnet import Hypotheses

if TYPE_CHECKING:
    import trimesh

BATCH = 256


@dataclass(frozen=True, repr=False, eq=False)
class ViewpointEstimator(Pretrained, ObjectRenderer):
    """A trained network, ready for images from anywhere.

    Answers are in the annotated frame where the network's own was aligned to it on annotated validation views, as a
    finished run's is (`aligned`). A network that was trained on videos without viewpoints has no alignment: its answers
    are in its own frame, whose azimuth 0 and whose up are arbitrary.

    ImagesLike are PIL images, paths, numpy arrays (H, W), (H, W, 3) or (H, W, 4), torch tensors (1, H, W), (3, H, W) or
    (4, H, W), uint8 or floating point in [0, 1], of any size; several come as a list or as an array of one more
    dimension. Files are turned upright as their camera says. What is known of the object in an image decides what of
    it the networks see:

    - with a mask, (H, W) with the object above 0, or with transparency, which is a mask: the object. A network trained
      on objects over black sees nothing else; one trained before backgrounds (recipe photos), or on videos without
      masks, sees the image around the mask, and grey where it is transparent.
    - with a box x0, y0, x1, y1 in pixels: what is in the box.
    - with neither: all of the image, which then should show the object from edge to edge.

    A network that sees whole views (crop "none", recipe matting) knows from them how large objects are in the images
    of a rendering camera. A transparent image without a box is then taken for such a view and not cut; in any other
    image its answers are little worth. For photographs take the recipes photos or paper_photos.

    `about` says where the network comes from, as plain JSON types: a run's key, metrics and so on.
    """

    @classmethod
    def from_pretrained(
        cls,
        where: str | os.PathLike[str],
        *,
        device: str | torch.device | None = None,
        revision: str | None = None,
        cache_dir: str | os.PathLike[str] | None = None,
        token: str | bool | None = None,
        force_download: bool = False,
        local_files_only: bool = False,
    ) -> ViewpointEstimator:
        """Of a category whose model comes with the package ("car", viewnet.estimator.pretrained.shipped), or from elsewhere.

        That is a folder of `save_pretrained`, a finished run's folder or key, or the Hugging Face hub ("name/model").

        `viewnet train` prints a run's folder, which is called by its key. The device is a GPU if there is one, unless
        told. What follows is for the hub only, which needs `pip install "viewnet[hub]"`. Weights are read with
        safetensors: nothing is unpickled. Raises ViewnetError for what is not there, is of another version, or is
        damaged, and for a hub that cannot be reached.
        """
        options = {"revision": revision, "cache_dir": cache_dir, "token": token, "force_download": force_download}
        model = pretrained.load(where, **options, local_files_only=local_files_only)
        network = model.network.to(pretrained.device(device)).eval()
        return cls(network, model.config, model.annotated_from_model, model.about)

    @property
    def rotation(self) -> Tensor:
        """(3, 3), from the network's own frame to that of the answers: the identity where it is not aligned."""
        return (
            torch.eye(3)
            if self.annotated_from_model is None
            else torch.tensor(self.annotated_from_model, dtype=torch.float32)
        )

    @cached_property
    def framing(self) -> Framing:
        """What the networks see of an image."""
        return Framing.of(self.config)

    def predict(self, images: ImagesLike, masks: Any = None, boxes: Any = None, batch_size: int = BATCH) -> Viewpoints:
        """The viewpoints of one or several images, in their order.

        `masks` and `boxes` are one or as many, None for images without. Raises ViewnetError that names the image
        for what cannot be read, and for masks and boxes that do not fit.
        """
        vectors, logits, ups = [], [], []
        for seen in self._seen(images, masks, boxes, batch_size):
            found = self._look(seen)
            vectors.append(found.vectors.double().cpu().numpy())
            logits.append(found.logits.double().cpu().numpy())
            if found.ups is not None:
                ups.append(found.ups.double().cpu().numpy())
        return self._told(np.concatenate(vectors), np.concatenate(logits), np.concatenate(ups) if ups else None)

    def volume(self, image: ImageLike, mask: Any = None, box: Any = None) -> Tensor:
        """What one image's object looks like to the network: (4, Z, Y, X), colour and occupancy, on the CPU.

        Values are in [0, 1], the frame is the network's own, which `rotation` takes to that of the answers. Raises
        ViewnetError for the HoloGAN decoder, whose features are no volume of colours.
        """
        if self.hologan:
            raise ViewnetError(
                "volume: the HoloGAN decoder has no volume of colours and occupancy: take another variant"
            )
        return self._encode(self._one(image, mask, box)).volume[0].cpu()

    def mesh(self, image: ImageLike, mask: Any = None, box: Any = None, level: float = 0.5) -> trimesh.Trimesh:
        """The surface of `volume` where occupancy passes `level`, in the frame of the answers.

        viewnet.estimator.volume_mesh.write makes a file of it. Raises ViewnetError as `volume` does, and for an empty volume.
        """
        from viewnet.estimator import volume_mesh

        return volume_mesh.surface(self.volume(image, mask, box), self.rotation, level)

    def reconstruct(
        self, images: ImagesLike, masks: Any = None, boxes: Any = None, size: int | None = None
    ) -> np.ndarray:
        """ImagesLike (N, S, S, 3) uint8 of the objects before white, each drawn from the viewpoint predicted for it.

        Of images that were cut to their object, the drawing is too. `size` is S, in pixels (default: as learned).
        """
        drawn = []
        for shown in self._shown(images, masks, boxes):
            found = self.render(self._encode(shown), self._answers(shown), size)
            cut = self.framing.crop != "none" and not shown.cutout.any()
            drawn.append(self.displayed(tight_crop(found, found.shape[-1], margin=0.0) if cut else found))
        return np.concatenate(drawn)

    def novel_view(
        self,
        images: ImagesLike,
        azimuth: ArrayLike,
        elevation: ArrayLike,
        masks: Any = None,
        boxes: Any = None,
        size: int | None = None,
    ) -> np.ndarray:
        """ImagesLike (N, S, S, 3) uint8 of the objects before white, from another viewpoint in degrees: one, or (N,).

        The viewpoint is in the frame of the answers. `size` is S, in pixels (default: as learned). Raises ViewnetError
        for angles that are no finite numbers, or not as many as images.
        """
        count = len(inputs.listed(images))
        angles = []
        for name, values in (("azimuth", azimuth), ("elevation", elevation)):
            given = np.asarray(values, dtype=np.float64)
            if given.shape not in ((), (1,), (count,)) or not np.isfinite(given).all():
                raise ViewnetError(f"{name} {values!r}: expected degrees, one number or {count}")
            angles.append(torch.from_numpy(np.broadcast_to(given, (count,)).copy()))
        frames, drawn, done = self.in_own_frame(look_at(view_vector(*angles))), [], 0
        for shown in self._shown(images, masks, boxes):
            part = frames[done : done + len(shown.seen)]
            drawn.append(self.displayed(self.render(self._encode(shown), part, size)))
            done += len(part)
        return np.concatenate(drawn)

    def turntable(
        self,
        image: ImageLike,
        path: str | os.PathLike[str] | None = None,
        mask: Any = None,
        box: Any = None,
        *,
        steps: int = 48,
        hold: int = 12,
        size: int = 192,
        rate: int = 16,
    ) -> list[np.ndarray]:
        """Frames (H, W, 3) uint8: one image, and its object turning once; see viewnet.estimator.turntable.revolve.

        With a `path` that ends in .gif or .mp4 they are written there too, `rate` a second.
        """
        from viewnet.estimator import turntable
        from viewnet.model import rendering

        if path is not None:
            turntable.check(Path(path))
        shown = self._one(image, mask, box)
        found, answer = self._look(self.network.composite(shown.seen)), self._answers(shown)[0]
        told = self._told(*(_array(values) for values in (found.vectors, found.logits, found.ups)))
        given = rendering.to_uint8(shown.images)[0]
        frames = turntable.revolve(self, given, self._encode(shown), answer, told.vector[0], steps, hold, size)
        if path is not None:
            turntable.save(frames, Path(path), rate)
        return frames

    def save_pretrained(
        self,
        folder: str | os.PathLike[str],
        *,
        license: str | None = None,
        half: bool = False,
        scores: Sequence[dict[str, Any]] = (),
        push_to_hub: bool = False,
        repo_id: str | None = None,
        **push: Any,
    ) -> str | None:
        """Write model.safetensors, config.json and README.md, a model card, for `from_pretrained`.

        `license` is that of the weights in the hub's words (default: mit of what was trained on built-in models, else
        other). `half` keeps the weights in 16 bits, at half the size. The card tells `scores`, of
        viewnet.experiments.score_model.scores, beside those of the run's own test views. With `push_to_hub` the folder goes to the
        hub as `repo_id` (default: the folder's name), with what else viewnet.estimator.hub.push takes; the address of the
        commit is returned. ViewnetError where it cannot be written or pushed.
        """
        place = Path(folder)
        pretrained.save(self, place, license, half, scores)
        files = (pretrained.WEIGHTS, pretrained.CONFIG, pretrained.CARD)
        return hub.push(place, repo_id or place.absolute().name, files, **push) if push_to_hub else None

    def export_onnx(self, path: str | os.PathLike[str]) -> Path:
        """Write the viewpoint network as ONNX, see viewnet.estimator.onnx_export.export. Needs `pip install "viewnet[onnx]"`."""
        from viewnet.estimator import onnx_export

        return onnx_export.export(self, Path(path))

    def __repr__(self) -> str:
        config = self.config
        frame = "the annotated frame" if self.aligned else "the network's own frame: not aligned"
        return (
            f"ViewpointEstimator({config.variant} {config.category} seed {config.seed} ({config.profile}, "
            f"{config.recipe}), {self.framing.size} x {self.framing.size} pixels, {self.device}; answers in {frame})"
        )

    @torch.no_grad()
    def _look(self, seen: Tensor) -> Hypotheses:
        """Of what the encoder takes (N, 3, S, S)."""
        found: Hypotheses = self.network.viewpoint(seen)
        return found

    def _answers(self, shown: Shown) -> Tensor:
        """(N, 3, 3) own camera frames of the viewpoints that are selected."""
        found = self._look(self.network.composite(shown.seen))
        return found.world_from_camera[torch.arange(len(found.logits)), found.logits.argmax(1).cpu()].cpu()

    @torch.no_grad()
    def _encode(self, shown: Shown) -> Encoded:
        return Encoded(*self.network.encode(shown.object, background=shown.behind))

    def _told(self, vectors: np.ndarray, logits: np.ndarray, ups: np.ndarray | None) -> Viewpoints:
        """Own hypotheses (N, M, 3) in the frame of the answers."""
        if self.annotated_from_model is not None:
            vectors, ups = (
                vectors @ self.annotated_from_model.T,
                None if ups is None else ups @ self.annotated_from_model.T,
            )
        return Viewpoints.of(vectors, logits, ups, self.aligned)

    def _seen(self, images: ImagesLike, masks: Any, boxes: Any, batch_size: int) -> Iterator[Tensor]:
        """What the encoder takes of the images (n, 3, S, S), batch by batch."""
        if masks is None and boxes is None and (ready := preprocess.ready(images, self.framing)) is not None:
            return preprocess.ready_batches(ready, self.framing, self.device, batch_size)
        return (self.network.composite(shown.seen) for shown in self._shown(images, masks, boxes, batch_size))

    def _shown(self, images: ImagesLike, masks: Any, boxes: Any, batch_size: int = BATCH) -> Iterator[Shown]:
        """The images as the networks see them, batch by batch."""
        return preprocess.batches(images, masks, boxes, self.framing, self.device, batch_size)

    def _one(self, image: ImageLike, mask: Any, box: Any) -> Shown:
        if len(each := inputs.listed(image)) != 1:
            raise ViewnetError(f"{len(each)} images: expected one")
        masks, boxes = (None if value is None else [value] for value in (mask, box))
        return next(self._shown(each, masks, boxes, 1))


def _array(values: Tensor | None) -> Any:
    return None if values is None else values.double().cpu().numpy()
