"""Images cut and scaled to what the networks of a configuration are trained and evaluated on."""

import logging
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.data.crop import Crop, bounds, cut
from viewnet.data.pairs import resize, tight_crop
from viewnet.errors import ViewnetError
from viewnet.estimator.inputs import ImageLike, ImagesLike, InputImage, as_list, boxes_of, masks_of, read_image
from viewnet.runtime.parallel import cores

log = logging.getLogger(__name__)

DTYPES = (np.uint8, np.float16, np.float32, np.float64)  # that PyTorch takes without conversion
MARGIN = 0.2
"""Margin around an object that is cut out as the rendering camera frames objects, as a share of its longer side: a
built-in car's longer side is 0.71 of its view's on average."""
OPAQUE = (128, 128, 128)
"""Colour in place of transparency, for networks that have always seen a background."""
BRIGHT = 0.1
"""An image whose edges are brighter than this on average is not black around its object."""


@dataclass(frozen=True)
class Framing:
    """How the networks of a configuration are shown images.

    Networks trained on cut-out objects see nothing outside of a mask. Those trained over backgrounds, or on videos
    without masks, see an image as it is, and a mask only says where the object is.
    """

    size: int  # pixels along a side of their input
    crop: str  # ModelConfig.crop: whether the viewpoint network sees the object alone, enlarged
    cutout: bool  # whether they were trained on cut-out objects
    backdrop: float  # grey level around a cut-out object, 0 to 1
    rendered: bool  # whether they see whole views as a rendering camera frames them
    view: Crop  # how an object is cut out: about as large in the image as in training
    whole: Crop  # how an image that is not cut out is cut to the object's box, as scored photographs are

    @classmethod
    def of(cls, config: RunConfig) -> "Framing":
        """The framing of a run's networks."""
        data, model, video = config.data, config.model, config.data.video
        masked = video is None or video.masks != "none"
        view = Crop(video.size, video.margin, video.square) if video else Crop(data.image_size, MARGIN)
        # Scored photographs have twice the input's resolution (viewnet.evaluation.features.SIZE). For networks that see
        # objects enlarged the box is the edge; others know how large objects are in an image.
        margin = 0.0 if masked and model.crop != "none" else view.margin
        whole = Crop(2 * model.input_size, margin, model.crop != "stretched")
        cutout, rendered = masked and data.backgrounds is None, video is None and model.crop == "none"
        return cls(model.input_size, model.crop, cutout, model.backdrop, rendered, view, whole)


@dataclass(frozen=True)
class CroppedImage:
    """An image cut to its object."""

    pixels: np.ndarray  # (S, S, 4) uint8, straight alpha
    cutout: bool  # whether the object is cut out: alpha is then its mask
    mask: np.ndarray | None = None  # (S, S) uint8, the object's mask where it is known and the object is not cut out


@dataclass(frozen=True, eq=False)
class Prepared:
    """N images as the networks are shown them, in [0, 1]."""

    viewpoint: Tensor  # (N, 4, S, S) RGB times alpha and alpha, for the viewpoint network
    appearance: Tensor  # (N, 4, S, S) the same of the object alone, for the appearance network
    background: Tensor  # (N, 3, S, S) the background that the appearance network sees
    cutout: np.ndarray  # (N,) bool: whether the object is cut out
    masked: np.ndarray  # (N,) bool: whether the object's mask is known

    def __len__(self) -> int:
        return len(self.cutout)

    @property
    def images(self) -> Tensor:
        """(N, 4, S, S) to show to people: cut-out objects stay transparent, others keep their background."""
        cutout = torch.from_numpy(self.cutout).to(self.viewpoint.device)[:, None, None, None]  # (N, 1, 1, 1)
        whole = torch.cat([self.background, torch.ones_like(self.background[:, :1])], 1)  # (N, 4, S, S)
        return torch.where(cutout, self.appearance, whole)


def crop_to_object(given: InputImage, framing: "Framing") -> CroppedImage:
    """Cut an image as the networks of `framing` see it. ViewnetError for a box that does not overlap the image."""
    image, mask, box = given.image, given.mask, given.box
    if mask is None:
        # An image of exactly the input's size is taken as cut already.
        ready = box is None and image.size == (framing.size, framing.size)
        margin = 0.0 if box is None else framing.whole.margin
        crop = replace(framing.whole, size=framing.size if ready else framing.whole.size, margin=margin)
        return CroppedImage(cut(image, box, crop), cutout=False)
    if framing.cutout:
        if box is None:
            # Kept as it is, like a view in training; a small object in a large image is enlarged first.
            ready = framing.crop == "none" or image.size == (framing.view.size, framing.view.size)
            box = None if ready else bounds(mask)
        crop = framing.view if box else replace(framing.view, margin=0.0)
        return CroppedImage(cut(image, box, crop, mask), cutout=True)
    if box is None:
        opaque = Image.new("RGBA", image.size, (*OPAQUE, 255))
        image, box = Image.alpha_composite(opaque, image), bounds(mask)
    cut_mask = cut(image, box, framing.whole, mask)[..., 3]
    return CroppedImage(cut(image, box, framing.whole), cutout=False, mask=cut_mask)


def prepare(cropped: Sequence[CroppedImage], framing: "Framing", device: torch.device) -> Prepared:
    """Scale cropped images to the input of the networks of `framing`."""
    count, size = len(cropped), framing.size
    viewpoint, whole = torch.empty(count, 4, size, size), torch.empty(count, 4, size, size)
    masks = torch.ones(count, 1, size, size)
    for side in {len(image.pixels) for image in cropped}:
        rows = [i for i, image in enumerate(cropped) if len(image.pixels) == side]
        straight = torch.from_numpy(np.stack([cropped[i].pixels for i in rows])).permute(0, 3, 1, 2).float()
        # The same roundings as in viewnet.data.pairs.load_views, so that networks see the same pixels of an image.
        weighted = torch.cat([straight[:, :3] * (straight[:, 3:] / 255), straight[:, 3:]], dim=1)  # (n, 4, S, S)
        whole[rows] = resize(weighted, size).round_()
        if framing.crop != "none":
            viewpoint[rows] = tight_crop(weighted / 255, size, framing.crop == "stretched").mul_(255).round_()
        for i in rows:
            if (mask := cropped[i].mask) is not None:
                masks[i] = resize(torch.from_numpy(mask).float()[None, None], size)[0] / 255
    cutout = np.array([image.cutout for image in cropped])
    masked = cutout | [image.mask is not None for image in cropped]
    whole /= 255
    viewpoint = whole if framing.crop == "none" else viewpoint.div_(255)
    background = torch.where(torch.from_numpy(cutout)[:, None, None, None], framing.backdrop, whole[:, :3])
    return Prepared(viewpoint.to(device), (whole * masks).to(device), background.to(device), cutout, masked)


def batches(
    images: ImagesLike, masks: Any, boxes: Any, framing: "Framing", device: torch.device, batch_size: int
) -> Iterator[Prepared]:
    """Images with their masks and boxes as the networks of `framing` are shown them, batch by batch.

    Warns of the first image that is unlike those of training. ViewnetError names the image at fault.
    """
    listed, warned = as_list(images), False
    masks, boxes = masks_of(masks, len(listed)), boxes_of(boxes, len(listed))
    if framing.rendered and any(value is not None for value in (*masks, *boxes)):
        views = "the network was trained on whole views as a rendering camera frames them: its predictions for images"
        log.warning("%s that are cut are unreliable: train one with the recipe photos", views)

    def crop(row: int) -> CroppedImage:
        try:
            return crop_to_object(read_image(listed[row], masks[row], boxes[row]), framing)
        except ViewnetError as error:
            raise ViewnetError(f"{_name(listed[row], row)}: {error}") from None

    for start in range(0, len(listed), _positive(batch_size)):
        rows = range(start, min(start + batch_size, len(listed)))
        # Images are decoded and resized outside of the interpreter's lock, so threads help.
        with ThreadPoolExecutor(min(cores(), len(rows))) as pool:
            prepared = prepare(list(pool.map(crop, rows)), framing, device)
        if not warned:
            unlike = _bright(prepared.viewpoint[:, :3]).cpu() & ~torch.from_numpy(prepared.cutout)
            warned = _warn(framing, unlike, [_name(listed[row], row) for row in rows])
        yield prepared


def ready_images(images: Any, framing: "Framing") -> Tensor | None:
    """(N, 3, S, S), for `ready_batches`, of an array or tensor of images that need no cutting; None of all else."""
    if isinstance(images, np.ndarray) and images.ndim == 4 and images.dtype in DTYPES:
        # PyTorch takes neither arrays that run backwards nor, without a warning, those that cannot be written.
        images = torch.from_numpy(np.require(images, requirements=["C", "W"])).movedim(-1, 1)
    if not isinstance(images, Tensor):
        return None
    return images if len(images) and images.shape[1:] == (3, framing.size, framing.size) else None


def ready_batches(images: Tensor, framing: "Framing", device: torch.device, batch_size: int) -> Iterator[Tensor]:
    """Images of `ready_images` in [0, 1] (n, 3, S, S), batch by batch. Warns, and raises, as `batches` does."""
    buffer = None  # A batch is overwritten by the next one: allocating takes several times as long as filling.
    for start in range(0, len(images), _positive(batch_size)):
        part = images[start : start + batch_size].to(device)
        if part.dtype == torch.uint8:
            buffer = torch.empty_like(part, dtype=torch.float32) if buffer is None else buffer
            scaled = buffer[: len(part)].copy_(part).div_(255)
        else:
            scaled = _in_unit_range(part)
        if start == 0:
            _warn(framing, _bright(scaled), [_name(image, row) for row, image in enumerate(scaled)])
        yield scaled


def _in_unit_range(images: Tensor) -> Tensor:
    """Images of floating point in [0, 1] as float32. ViewnetError for other values."""
    if not images.is_floating_point():
        raise ViewnetError(f"images are of {images.dtype}: expected uint8, or floating point in [0, 1]")
    low, high = (float(value) for value in images.detach().aminmax())
    if not (low >= 0 and high <= 1):  # false for NaN
        raise ViewnetError(f"images have values from {low:g} to {high:g}: expected 0 to 1, or uint8")
    return images.detach().float()


def _bright(images: Tensor) -> Tensor:
    """(N,) bool: which images (N, 3, S, S) are not black along their edges."""
    edges = torch.cat([images[:, :, [0, -1]].flatten(2), images[:, :, :, [0, -1]].flatten(2)], 2)  # (N, 3, 4 S)
    return edges.mean((1, 2)) > BRIGHT


def _warn(framing: "Framing", bright: Tensor, names: Sequence[str]) -> bool:
    """Name the first image that is unlike those of training; whether there is one."""
    if not (framing.cutout and bright.any()):
        return False
    name = names[int(bright.int().argmax())]
    log.warning("%s is not black around its object, as all images in training were: give a mask", name)
    return True


def _name(image: ImageLike, row: int) -> str:
    return os.fspath(image) if isinstance(image, (str, os.PathLike)) else f"image {row}"


def _positive(batch_size: int) -> int:
    if not isinstance(batch_size, int) or batch_size < 1:
        raise ViewnetError(f"batch_size {batch_size!r}: expected a whole number of 1 or more")
    return batch_size
