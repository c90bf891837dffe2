"""A trained ViewNet for people's own images: their viewpoints, and what their objects look like from elsewhere.

`ViewpointEstimator.from_pretrained` loads a trained one. This one has random weights:

>>> from viewnet.model.viewnet import ViewNet
>>> from viewnet.recipes import make_config
>>> config = make_config(profile="smoke", recipe="photos", backgrounds=None)
>>> estimator = ViewpointEstimator(ViewNet(config.model).eval(), config)
>>> photograph = np.full((300, 400, 3), 128, np.uint8)
>>> viewpoints = estimator.predict([photograph, photograph], boxes=[(40, 60, 380, 250), None])
>>> viewpoints.vector.shape, viewpoints.hypotheses.shape, viewpoints.aligned
((2, 3), (2, 3, 3), False)
>>> estimator.novel_view(photograph, azimuth=90, elevation=10).shape
(1, 16, 16, 3)
"""

import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from viewnet.errors import ViewnetError
from viewnet.estimator import hub, preprocess, pretrained
from viewnet.estimator.inputs import ImageLike, ImagesLike, as_list
from viewnet.estimator.preprocess import Framing, Prepared
from viewnet.estimator.viewpoints import Viewpoints
from viewnet.evaluation.symmetry import symmetry
from viewnet.geometry import look_at, view_vector
from viewnet.model import rendering
from viewnet.model.reconstruction import Encoded
from viewnet.model.viewnet import Hypotheses
from viewnet.runtime.images import tight_crop

if TYPE_CHECKING:
    import trimesh

log = logging.getLogger(__name__)
BATCH = 256
OneImage = ImageLike | Prepared  # prepared images are those that the demo has cut already
Images = ImagesLike | Prepared


@dataclass(frozen=True, repr=False, eq=False)
class ViewpointEstimator(pretrained.Pretrained, rendering.ObjectRenderer):
    """A trained network with methods for images from anywhere.

    Predicted viewpoints are in the annotated frame if the network's own was aligned to it on annotated validation
    views, as a finished run's is (`aligned`). A network that was trained on videos without viewpoints is not aligned:
    its predictions are in its own frame, whose azimuth 0 and up are arbitrary.

    Images are PIL images, paths, numpy arrays (H, W), (H, W, 3) or (H, W, 4), or torch tensors (1, 3 or 4, H, W), uint8
    or floating point in [0, 1]; several come as a list or as an array of one more dimension. Files are turned upright
    by their EXIF data. Which part of an image the networks see:

    - with a mask (H, W), above 0 on the object, or with transparency, which is a mask: the object. A network trained on
      objects over black sees nothing else; one trained over backgrounds (recipe photos), or on videos without masks,
      sees the image around the mask, and grey where it is transparent.
    - with a box x0, y0, x1, y1 in pixels: what is in the box.
    - with neither: the whole image, which should show the object from edge to edge.

    A network that sees whole views (crop "none", recipe matting) relies on the size of objects in a rendering camera's
    images. A transparent image without a box is taken for such a view and not cut; for any other image its predictions
    are unreliable. For photographs use the recipes photos or paper_photos.
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
    ) -> "ViewpointEstimator":
        """Load a model.

        `where` is a category whose model comes with the package ("car", see viewnet.estimator.pretrained.shipped), a
        folder of `save_pretrained`, a finished run's folder or key, or a model on the Hugging Face hub ("name/model").
        The default device is a GPU if there is one. The other options are for the hub. ViewnetError for a model that is
        missing, of another version or damaged, and for a hub that cannot be reached.
        """
        options = {"revision": revision, "cache_dir": cache_dir, "token": token, "force_download": force_download}
        model = pretrained.load(where, **options, local_files_only=local_files_only)
        network = model.network.to(pretrained.device(device)).eval()
        return cls(network, model.config, model.annotated_from_model, model.about)

    @property
    def rotation(self) -> Tensor:
        """(3, 3), from the network's own frame to that of the predictions: the identity if it is not aligned."""
        if self.annotated_from_model is None:
            return torch.eye(3)
        return torch.tensor(self.annotated_from_model, dtype=torch.float32)

    @cached_property
    def framing(self) -> Framing:
        """How images are cut for the networks."""
        return Framing.of(self.config)

    def predict(
        self,
        images: Images,
        masks: Any = None,
        boxes: Any = None,
        batch_size: int = BATCH,
        failures: dict[int, str] | None = None,
        progress: bool = False,
    ) -> Viewpoints:
        """The viewpoints of one or several images, in their order.

        `masks` and `boxes`: one for each image, or None. ViewnetError names an image that cannot be read or used. With
        a dictionary of `failures` such images are left out instead, and it gets their positions and what is wrong.
        `progress` shows a bar while files are read.
        """
        hypotheses: Iterable[Hypotheses]
        if masks is None and boxes is None and (ready := preprocess.ready_images(images, self.framing)) is not None:
            inputs = preprocess.ready_batches(ready, self.framing, self.device, batch_size)
            hypotheses = map(self._hypotheses, inputs)
        elif isinstance(images, Prepared) or self.device.type != "cpu":
            hypotheses = map(self._found, self._prepared(images, masks, boxes, batch_size, failures, progress))
        else:
            parts = preprocess.computed(self._found, images, masks, boxes, self.framing, batch_size, failures, progress)
            hypotheses = chain.from_iterable(parts)
        # Copied at once: the next batch may overwrite what a batch was computed from.
        arrays = [[_array(each.vectors), _array(each.logits), _array(each.ups)] for each in hypotheses]
        if not arrays:  # all of them failed
            return Viewpoints.of(np.empty((0, 1, 3)), np.empty((0, 1)), None, self.aligned)
        joined: Any = [None if parts[0] is None else np.concatenate(parts) for parts in zip(*arrays, strict=True)]
        vectors, logits, ups = joined
        if (rotation := self.annotated_from_model) is not None:
            vectors, ups = vectors @ rotation.T, None if ups is None else ups @ rotation.T
        turns = symmetry(self.config.category).turns if self.aligned else 1
        return Viewpoints.of(vectors, logits, ups, self.aligned, turns)

    def volume(self, image: OneImage, mask: Any = None, box: Any = None) -> Tensor:
        """The volume that is reconstructed from one image: (4, Z, Y, X), colour and occupancy in [0, 1], on the CPU.

        It is in the network's own frame; `rotation` leads to that of the predictions. ViewnetError for the HoloGAN
        decoder, whose features are not a volume of colours.
        """
        if self.hologan:
            raise ViewnetError("volume: the HoloGAN decoder has no volume of colours: take another variant")
        return self.encode(self._one(image, mask, box)).volume[0].cpu()

    def mesh(self, image: OneImage, mask: Any = None, box: Any = None, level: float = 0.5) -> "trimesh.Trimesh":
        """The surface of `volume` where occupancy passes `level`, in the frame of the predictions; see volume_mesh.

        ViewnetError as `volume` does, and for an empty volume.
        """
        from viewnet.estimator import volume_mesh  # loads heavy libraries

        return volume_mesh.surface(self.volume(image, mask, box), self.rotation, level)

    def reconstruct(self, images: Images, masks: Any = None, boxes: Any = None, size: int | None = None) -> np.ndarray:
        """Images (N, S, S, 3) uint8 of the objects on white, rendered from their predicted viewpoints.

        Images that were cut to their object are rendered cut as well. `size` is S (default: as trained).
        """
        rendered = []
        for prepared in self._prepared(images, masks, boxes):
            views = self.render(self.encode(prepared), self._predicted_poses(prepared), size)
            cut = self.framing.crop != "none" and not prepared.cutout.any()
            rendered.append(self.displayed(tight_crop(views, views.shape[-1], margin=0.0) if cut else views))
        return np.concatenate(rendered)

    def novel_view(
        self,
        images: Images,
        azimuth: ArrayLike,
        elevation: ArrayLike,
        masks: Any = None,
        boxes: Any = None,
        size: int | None = None,
    ) -> np.ndarray:
        """Images (N, S, S, 3) uint8 of the objects on white, rendered from another viewpoint.

        Angles are in degrees in the frame of the predictions, one number or (N,). `size` is S in pixels (default: as
        trained). ViewnetError for angles that are not finite or not as many as the images.
        """
        count, angles = _count(images), []
        for name, values in (("azimuth", azimuth), ("elevation", elevation)):
            array = np.asarray(values, dtype=np.float64)
            if array.shape not in ((), (1,), (count,)) or not np.isfinite(array).all():
                raise ViewnetError(f"{name} {values!r}: expected degrees, one number or {count}")
            angles.append(torch.from_numpy(np.broadcast_to(array, (count,)).copy()))
        poses, rendered = self.in_own_frame(look_at(view_vector(*angles))), []
        for prepared in self._prepared(images, masks, boxes):
            batch, poses = poses[: len(prepared)], poses[len(prepared) :]
            rendered.append(self.displayed(self.render(self.encode(prepared), batch, size)))
        return np.concatenate(rendered)

    def turntable(
        self,
        image: OneImage,
        path: str | os.PathLike[str] | None = None,
        mask: Any = None,
        box: Any = None,
        *,
        steps: int = 48,
        hold: int = 12,
        size: int = 192,
        rate: int = 16,
    ) -> list[np.ndarray]:
        """Frames (H, W, 3) uint8: one image, and its object turning once; see viewnet.estimator.turntable.animate.

        They are also written to `path`, if given, which ends in .gif or .mp4, `rate` a second.
        """
        from viewnet.estimator import turntable

        if path is not None:
            turntable.check(Path(path))
        prepared = self._one(image, mask, box)
        pixels, pose = rendering.to_uint8(prepared.images)[0], self._predicted_poses(prepared)[0]
        frames = turntable.animate(self, pixels, self.encode(prepared), pose, steps, hold, size)
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

        license        of the weights, in the hub's words (default: mit if trained on built-in models, else other)
        half           keep the weights in 16 bits, at half the size
        scores         of viewnet.experiments.score_model.scores, for the card, besides those on the run's test views
        push_to_hub    upload the folder as `repo_id` (default: the folder's name), with the further options of
                       viewnet.estimator.hub.push, and return the address of the commit

        ViewnetError where it cannot be written or pushed.
        """
        place = Path(folder)
        pretrained.save(self, place, license, half, scores)
        return hub.push(place, repo_id or place.absolute().name, pretrained.FILES, **push) if push_to_hub else None

    def export_onnx(self, path: str | os.PathLike[str]) -> Path:
        """Write the viewpoint network as ONNX, see viewnet.estimator.onnx_export. Needs "viewnet[onnx]"."""
        from viewnet.estimator import onnx_export

        return onnx_export.export(self, Path(path))

    def __repr__(self) -> str:
        config, size = self.config, self.framing.size
        run = f"{config.variant} {config.category} seed {config.seed} ({config.profile}, {config.recipe})"
        frame = "the annotated frame" if self.aligned else "the network's own frame: not aligned"
        return f"ViewpointEstimator({run}, {size} x {size} pixels, {self.device}; viewpoints in {frame})"

    @torch.no_grad()
    def _hypotheses(self, images: Tensor) -> Hypotheses:
        """Hypotheses for the viewpoint network's input (N, 3, S, S), in the network's own frame."""
        return cast(Hypotheses, self.network.viewpoint(images))

    def _found(self, prepared: Prepared) -> Hypotheses:
        """`_hypotheses` for prepared images."""
        return self._hypotheses(self.network.composite(prepared.viewpoint))

    def _predicted_poses(self, prepared: Prepared) -> Tensor:
        """(N, 3, 3) camera frames of the selected hypotheses, in the network's own frame."""
        hypotheses = self._found(prepared)
        return hypotheses.world_from_camera[torch.arange(len(prepared)), hypotheses.logits.argmax(1).cpu()].cpu()

    @torch.no_grad()
    def encode(self, prepared: Prepared) -> Encoded:
        """The objects of prepared images, for `render`. ViewnetError for methods without a volume."""
        self.require_viewnet("rendering")
        background = None if self.config.train.photo.cut_out else prepared.background
        if background is None and self.config.data.backgrounds and not prepared.masked.all():
            log.warning("the appearance network knows objects that were cut out, as in training: give a mask")
        return Encoded(*self.network.encode(prepared.appearance, background=background))

    def _prepared(
        self, images: Images, masks: Any, boxes: Any, batch_size: int = BATCH, *failing: Any
    ) -> Iterator[Prepared]:
        """The images as the networks see them, batch by batch."""
        if isinstance(images, Prepared):
            return iter([images])
        return preprocess.batches(images, masks, boxes, self.framing, self.device, batch_size, *failing)

    def _one(self, image: OneImage, mask: Any, box: Any) -> Prepared:
        count = _count(image)
        if count != 1:
            raise ViewnetError(f"{count} images: expected one")
        masks, boxes = (None if value is None else [value] for value in (mask, box))
        return next(self._prepared(image, masks, boxes, 1))


def _count(images: Images) -> int:
    return len(images if isinstance(images, Prepared) else as_list(images))


def _array(values: Tensor | None) -> Any:
    return None if values is None else values.double().cpu().numpy()
