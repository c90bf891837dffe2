"""What the networks of a configuration see of an image: as much, cut and scaled as in training and evaluation."""

from __future__ import annotations

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
from viewnet.estimator.inputs import Given, ImageLike, ImagesLike, boxes_of, listed, masks_of, opened
from viewnet.runtime.parallel import cores

log = logging.getLogger(__name__)

READY = (np.uint8, np.float16, np.float32, np.float64)
"""Types of arrays that PyTorch takes as they are."""

MARGIN = 0.2
"""So much of an object's longer side is beyond it, on either side, where it is cut out as the rendering camera sees
objects: a built-in car's longer side is 0.71 of its view's on average."""
HIDDEN = (128, 128, 128)
"""What stands where an image is transparent, for networks that have always seen something behind the object."""
BRIGHT = 0.1
"""An image is not black along its edges where they are brighter than this on average."""


@dataclass(frozen=True)
class Framing:
    """How the networks of a configuration are shown images.

    size        pixels along a side of what they see
    crop        ModelConfig.crop: whether the viewpoint network sees the object alone, enlarged
    cutout      whether they know objects cut out, over `backdrop`: then what a mask leaves out is not seen. Networks
                trained before backgrounds, or on videos without masks, see an image as it is, and a mask only says
                where the object is
    rendered    whether they see whole views as a rendering camera frames them
    view        how an object is cut out: about as large in the image as in training
    whole       how an image is cut that is not cut out: to the object's box, as photographs are that are scored
    """

    size: int
    crop: str
    cutout: bool
    backdrop: float
    rendered: bool
    view: Crop
    whole: Crop

    @classmethod
    def of(cls, config: RunConfig) -> Framing:
        """Of a run's networks."""
        data, model, video = config.data, config.model, config.data.video
        masked = video is None or video.masks != "none"
        view = Crop(video.size, video.margin, video.square) if video else Crop(data.image_size, MARGIN)
        # Scored photographs are twice as large as what is seen of them (viewnet.evaluation.features.SIZE). Of networks that see
        # objects enlarged the box is the edge; others know how large objects are in an image.
        margin = 0.0 if masked and model.crop != "none" else view.margin
        whole = Crop(2 * model.input_size, margin, model.crop != "stretched")
        cutout, rendered = masked and data.backgrounds is None, video is None and model.crop == "none"
        return cls(model.input_size, model.crop, cutout, model.backdrop, rendered, view, whole)


@dataclass(frozen=True)
class View:
    """An image cut to its object: (S, S, 4) uint8, straight alpha, and what of it the object covers (S, S) uint8."""

    pixels: np.ndarray
    cover: np.ndarray | None
    cutout: bool


@dataclass(frozen=True)
class Shown:
    """N images as networks are shown them, in [0, 1].

    seen       (N, 4, S, S) RGB times alpha and alpha: by the viewpoint network
    object     (N, 4, S, S) the same of the object whose appearance is taken
    behind     (N, 3, S, S) what the appearance network sees behind it
    cutout     (N,) bool: whether the object is cut out
    """

    seen: Tensor
    object: Tensor
    behind: Tensor
    cutout: np.ndarray

    @property
    def images(self) -> Tensor:
        """(N, 4, S, S) for people: as the appearance network sees them, objects cut out left transparent."""
        cutout = torch.from_numpy(self.cutout).to(self.seen.device)[:, None, None, None]
        return torch.where(cutout, self.object, torch.cat([self.behind, torch.ones_like(self.behind[:, :1])], 1))


def viewed(given: Given, framing: Framing) -> View:
    """An image cut as the networks of `framing` see it. ViewnetError for a box that has no part in it."""
    image, mask, box = given.image, given.mask, given.box
    if mask is None:
        # An image of just the size is one that has been cut already.
        ready = box is None and image.size == (framing.size, framing.size)
        margin = 0.0 if box is None else framing.whole.margin
        crop = replace(framing.whole, size=framing.size if ready else framing.whole.size, margin=margin)
        return View(cut(image, box, crop), None, False)
    if framing.cutout:
        if box is None:
            # As it is: a view such as those of training. A small object in a large image is first seen from nearer.
            ready = framing.crop == "none" or image.size == (framing.view.size, framing.view.size)
            box = None if ready else bounds(mask)
        crop = framing.view if box else replace(framing.view, margin=0.0)
        return View(cut(image, box, crop, mask), None, True)
    if box is None:
        ground = Image.new("RGBA", image.size, (*HIDDEN, 255))
        image, box = Image.alpha_composite(ground, image), bounds(mask)
    return View(cut(image, box, framing.whole), cut(image, box, framing.whole, mask)[..., 3], False)


def shown(views: Sequence[View], framing: Framing, device: torch.device) -> Shown:
    """Cut images as the networks of `framing` are shown them."""
    count, size = len(views), framing.size
    seen, whole = torch.empty(count, 4, size, size), torch.empty(count, 4, size, size)
    covered = torch.ones(count, 1, size, size)
    for side in {len(view.pixels) for view in views}:
        rows = [i for i, view in enumerate(views) if len(view.pixels) == side]
        straight = torch.from_numpy(np.stack([views[i].pixels for i in rows])).permute(0, 3, 1, 2).float()
        # As viewnet.data.pairs.load_views has it, roundings and all, so that networks see the same of the same.
        weighted = torch.cat([straight[:, :3] * (straight[:, 3:] / 255), straight[:, 3:]], dim=1)
        whole[rows] = resize(weighted, size).round_()
        if framing.crop != "none":
            seen[rows] = tight_crop(weighted / 255, size, framing.crop == "stretched").mul_(255).round_()
        for i in rows:
            if (cover := views[i].cover) is not None:
                covered[i] = resize(torch.from_numpy(cover).float()[None, None], size)[0] / 255
    cutout = np.array([view.cutout for view in views])
    whole /= 255
    seen = whole if framing.crop == "none" else seen.div_(255)
    behind = torch.where(torch.from_numpy(cutout)[:, None, None, None], framing.backdrop, whole[:, :3])
    return Shown(seen.to(device), (whole * covered).to(device), behind.to(device), cutout)


def batches(
    images: ImagesLike, masks: Any, boxes: Any, framing: Framing, device: torch.device, batch_size: int
) -> Iterator[Shown]:
    """ImagesLike with their masks and boxes as the networks of `framing` are shown them, batch by batch.

    Warns of the first that is unlike those of training. ViewnetError names the image that is at fault.
    """
    each, warned = listed(images), False
    alphas, places = masks_of(masks, len(each)), boxes_of(boxes, len(each))
    if framing.rendered and not (masks is None and boxes is None):
        log.warning(
            "the network knows whole views as a rendering camera frames them: of images that are cut its answers are "
            "worth little: train one with the recipe photos"
        )

    def view(row: int) -> View:
        try:
            return viewed(opened(each[row], alphas[row], places[row]), framing)
        except ViewnetError as error:
            raise ViewnetError(f"{_name(each[row], row)}: {error}") from None

    for start in range(0, len(each), _count(batch_size)):
        rows = range(start, min(start + batch_size, len(each)))
        # ImagesLike are decoded and resized outside of the interpreter, so threads help.
        with ThreadPoolExecutor(min(cores(), len(rows))) as pool:
            found = shown(list(pool.map(view, rows)), framing, device)
        if not warned:
            unlike = _bright(found.seen[:, :3]).cpu() & ~torch.from_numpy(found.cutout)
            warned = _warn(framing, unlike, [_name(each[row], row) for row in rows])
        yield found


def ready_batches(images: Tensor, framing: Framing, device: torch.device, batch_size: int) -> Iterator[Tensor]:
    """Of images that `ready` gives, in [0, 1] (n, 3, S, S), batch by batch. Warns, and raises, as `batches` does.

    A batch is overwritten by the next one: fresh memory would take several times as long as to fill it.
    """
    room = None
    for start in range(0, len(images), _count(batch_size)):
        part = images[start : start + batch_size].to(device)
        if part.dtype == torch.uint8:
            room = torch.empty_like(part, dtype=torch.float32) if room is None else room
            seen = room[: len(part)].copy_(part).div_(255)
        else:
            seen = _in_unit(part)
        if start == 0:
            _warn(framing, _bright(seen), [_name(image, row) for row, image in enumerate(seen)])
        yield seen


def ready(images: ImagesLike, framing: Framing) -> Tensor | None:
    """(N, 3, S, S), for `ready_batches`, of an array of images that need no cutting; None of all else."""
    if isinstance(images, Tensor):
        found = images
    elif isinstance(images, np.ndarray) and images.ndim == 4 and images.dtype in READY:
        # PyTorch takes neither arrays that run backwards nor, without a warning, those that cannot be written.
        found = torch.from_numpy(np.require(images, requirements=["C", "W"])).movedim(-1, 1)
    else:
        return None
    return found if len(found) and found.shape[1:] == (3, framing.size, framing.size) else None


def _in_unit(images: Tensor) -> Tensor:
    """ImagesLike of floating point in [0, 1], as float32. ViewnetError for other values."""
    if not images.is_floating_point():
        raise ViewnetError(f"images are of {images.dtype}: expected uint8, or floating point in [0, 1]")
    low, high = (float(value) for value in images.detach().aminmax())
    if not (low >= 0 and high <= 1):  # not for NaN
        raise ViewnetError(f"images have values from {low:g} to {high:g}: expected 0 to 1, or uint8")
    return images.detach().float()


def _bright(seen: Tensor) -> Tensor:
    """(N,) bool: which images (N, 3, S, S) are not black along their edges."""
    edges = torch.cat([seen[:, :, [0, -1]].flatten(2), seen[:, :, :, [0, -1]].flatten(2)], 2)
    return edges.mean((1, 2)) > BRIGHT


def _warn(framing: Framing, bright: Tensor, names: Sequence[str]) -> bool:
    """Say which image is unlike those of training; whether there is one."""
    if not (framing.cutout and bright.any()):
        return False
    name = names[int(bright.int().argmax())]
    log.warning("%s is not black around its object, as all images in training were: give a mask", name)
    return True


def _name(image: ImageLike, row: int) -> str:
    return os.fspath(image) if isinstance(image, (str, os.PathLike)) else f"image {row}"


def _count(batch_size: int) -> int:
    if not isinstance(batch_size, int) or batch_size < 1:
        raise ViewnetError(f"batch_size {batch_size!r}: expected a whole number of 1 or more")
    return batch_size
