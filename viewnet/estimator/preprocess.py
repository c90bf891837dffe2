"""Images cut and scaled to what the networks of a configuration are trained and evaluated on."""

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.data.crop import Crop, bounds, cut, reaches_far_beyond
from viewnet.errors import ViewnetError
from viewnet.estimator.inputs import ImageLike, ImagesLike, InputImage, as_list, boxes_of, masks_of, read_image
from viewnet.runtime import parallel
from viewnet.runtime.images import resize, tight_crop
from viewnet.runtime.progress import bar

log = logging.getLogger(__name__)
T = TypeVar("T")

DTYPES = (np.uint8, np.float16, np.float32, np.float64)  # that PyTorch takes without conversion
MARGIN = 0.2
"""Margin around an object that is cut out as the rendering camera frames objects, as a share of its longer side: a
built-in car's longer side is 0.71 of its view's on average."""
OPAQUE = (128, 128, 128)  # colour in place of transparency, for networks that have always seen a background
CHUNK = 16  # images that a thread takes at once: few enough for a core's cache
BRIGHT = 0.1  # an image whose edges are brighter than this on average is not black around its object


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
    whole: Tensor  # (N, 4, S, S) the same, not cut to the object
    mask: Tensor  # (N, 1, S, S) the object's mask where it is known and the object is not cut out, elsewhere 1
    cutout: Tensor  # (N,) bool: whether the object is cut out
    masked: Tensor  # (N,) bool: whether the object's mask is known
    backdrop: float  # grey level around a cut-out object

    def __len__(self) -> int:
        return len(self.cutout)

    @classmethod
    def joined(cls, parts: "Sequence[Prepared]", device: torch.device) -> "Prepared":
        """The images of all parts, on a device."""
        names = ("viewpoint", "whole", "mask", "cutout", "masked")
        tensors: Any = {name: torch.cat([getattr(part, name) for part in parts]).to(device) for name in names}
        return cls(**tensors, backdrop=parts[0].backdrop)

    @property
    def appearance(self) -> Tensor:
        """(N, 4, S, S) RGB times alpha and alpha of the object alone, for the appearance network."""
        return self.whole * self.mask

    @property
    def background(self) -> Tensor:
        """(N, 3, S, S) the background that the appearance network sees."""
        return torch.where(self.cutout[:, None, None, None], self.backdrop, self.whole[:, :3])  # (N, 3, S, S)

    @property
    def images(self) -> Tensor:
        """(N, 4, S, S) to show to people: cut-out objects stay transparent, others keep their background."""
        whole = torch.cat([self.background, torch.ones_like(self.background[:, :1])], 1)  # (N, 4, S, S)
        return torch.where(self.cutout[:, None, None, None], self.appearance, whole)  # (N, 4, S, S)


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
    kinds = [(len(image.pixels), not image.cutout) for image in cropped]
    for kind in set(kinds):
        rows, opaque = [row for row, each in enumerate(kinds) if each == kind], kind[1]
        weighted = torch.from_numpy(np.stack([cropped[i].pixels for i in rows])).permute(0, 3, 1, 2).float()
        # The same roundings as in viewnet.data.pairs.load_views, so that networks see the same pixels of an image.
        if not opaque:
            weighted[:, :3] *= weighted[:, 3:] / 255  # (n, 4, S, S)
        whole[rows] = resize(weighted, size).round()
        if framing.crop != "none":
            crop = _whole_crop if opaque else tight_crop
            viewpoint[rows] = crop(weighted.div_(255), size, framing.crop == "stretched").mul_(255).round_()
        for i in rows:
            if (mask := cropped[i].mask) is not None:
                masks[i] = resize(torch.from_numpy(mask).float()[None, None], size)[0] / 255
    cutout = torch.tensor([image.cutout for image in cropped])
    masked = cutout | torch.tensor([image.mask is not None for image in cropped])
    whole /= 255
    viewpoint = whole if framing.crop == "none" else viewpoint.div_(255)
    known = cutout.to(device), masked.to(device)
    return Prepared(viewpoint.to(device), whole.to(device), masks.to(device), *known, framing.backdrop)


def _whole_crop(images: Tensor, size: int, stretch: bool) -> Tensor:
    """`tight_crop` of opaque images, which leaves them whole, in a fraction of its time: most samples are pixels."""
    full = images.shape[-1]
    if full == size:  # what lies between two pixels by a rounding error is rounded away
        return images
    if full != size * max(1, -(-full // size)):  # sampled more finely than their pixels
        return tight_crop(images, size, stretch)
    grid = F.affine_grid(torch.eye(2, 3)[None], [1, 1, full, full], align_corners=False)  # (1, H, H, 2)
    between = (((grid[0, 0, :, 0] + 1) * full - 1) / 2 != torch.arange(full)).nonzero().flatten()
    grid, sampled = grid.expand(len(images), -1, -1, -1), images.clone()
    sampled[:, :, between] = F.grid_sample(images, grid[:, between], align_corners=False)
    sampled[:, :, :, between] = F.grid_sample(images, grid[:, :, between], align_corners=False)
    return resize(sampled, size)


def batches(
    images: ImagesLike, masks: Any, boxes: Any, framing: "Framing", device: torch.device, batch_size: int, *failing: Any
) -> Iterator[Prepared]:
    """Images with their masks and boxes as the networks of `framing` are shown them, batch by batch; see `computed`."""
    for parts in computed(lambda prepared: prepared, images, masks, boxes, framing, batch_size, *failing):
        if parts:
            yield Prepared.joined(parts, device)


def computed(
    work: Callable[[Prepared], T],
    images: ImagesLike,
    masks: Any,
    boxes: Any,
    framing: "Framing",
    batch_size: int,
    failures: dict[int, str] | None = None,
    progress: bool = False,
) -> Iterator[list[T]]:
    """The results of `work` on images as the networks of `framing` are shown them, those of a batch at once.

    Every thread (viewnet.runtime.parallel.threads) takes some images at a time, from files to results. Warns of the
    first image that is unlike those of training, and of the first box that is mostly outside its image. ViewnetError
    names an image that cannot be used; where there are `failures`, such images are left out and their positions and
    errors added there. `progress` shows a bar.
    """
    listed, warned, beyond = as_list(images), False, list[int]()
    masks, boxes, threads = masks_of(masks, len(listed)), boxes_of(boxes, len(listed)), parallel.threads()
    if framing.rendered and any(value is not None for value in (*masks, *boxes)):
        views = "the network was trained on whole views as a rendering camera frames them: its predictions for images"
        log.warning("%s that are cut are unreliable: train one with the recipe photos", views)

    def compute(rows: Sequence[int]) -> tuple[list[T], list[str]]:
        cropped: dict[int, CroppedImage] = {}
        for row in rows:
            try:
                given = read_image(listed[row], masks[row], boxes[row])
                cropped[row] = crop_to_object(given, framing)
                if boxes[row] and reaches_far_beyond(boxes[row], given.image.size):
                    beyond.append(row)
            except ViewnetError as error:
                if failures is None:
                    raise ViewnetError(f"{_name(listed[row], row)}: {error}") from None
                failures[row] = str(error)
        if not cropped:
            return [], []
        prepared = prepare(list(cropped.values()), framing, torch.device("cpu"))
        bright = _bright(prepared.viewpoint[:, :3]) & ~prepared.cutout
        names = [_name(listed[row], row) for row, unlike in zip(cropped, bright, strict=True) if unlike]
        return [work(prepared)], names

    with bar(progress, total=len(listed), desc="images", unit="image", leave=False) as shown:
        for start in range(0, len(listed), _positive(batch_size)):
            rows = range(start, min(start + batch_size, len(listed)))
            step = min(CHUNK, -(-len(rows) // threads))  # a share for each
            parts = [rows[first : first + step] for first in range(0, len(rows), step)]
            results: list[T] = []
            unlike: list[str] = []
            with _pool(min(threads, len(parts))) as pool:
                for part, (found, names) in zip(parts, pool.map(compute, parts), strict=True):
                    results, unlike = results + found, unlike + names
                    shown.update(len(part))
            warned = warned or _warn(framing, unlike)
            yield results
    if beyond:
        name = _name(listed[min(beyond)], min(beyond))
        log.warning("%s: most of its box lies outside of it: is the box of this image, and in its pixels?", name)


@contextmanager
def _pool(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Threads for work that nearly all happens outside of the interpreter's lock.

    PyTorch computes in each of them alone: its own threads wait for each other awake, and on a busy machine for long.
    """
    threads = torch.get_num_threads()
    try:
        with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            yield pool
    finally:
        torch.set_num_threads(threads)  # what the other threads that start later will have


def ready_images(images: Any, framing: "Framing") -> Tensor | None:
    """(N, 3, S, S), for `ready_batches`, of an array or tensor of images that need no cutting; None of all else."""
    if isinstance(images, np.ndarray) and images.ndim == 4 and images.dtype in DTYPES:
        # PyTorch takes neither arrays that run backwards nor, without a warning, those that cannot be written.
        images = torch.from_numpy(np.require(images, requirements=["C", "W"])).movedim(-1, 1)
    if not isinstance(images, Tensor):
        return None
    return images if len(images) and images.shape[1:] == (3, framing.size, framing.size) else None


def ready_batches(images: Tensor, framing: "Framing", device: torch.device, batch_size: int) -> Iterator[Tensor]:
    """Images of `ready_images` in [0, 1] (n, 3, S, S), by batches. Warns as `batches`; ViewnetError for others."""
    buffer = None  # A batch is overwritten by the next one: allocating takes several times as long as filling.
    for start in range(0, len(images), _positive(batch_size)):
        part = images[start : start + batch_size].to(device)
        if part.dtype == torch.uint8:
            buffer = torch.empty_like(part, dtype=torch.float32) if buffer is None else buffer
            scaled = buffer[: len(part)].copy_(part).div_(255)
        else:
            if not part.is_floating_point():
                raise ViewnetError(f"images are of {part.dtype}: expected uint8, or floating point in [0, 1]")
            low, high = (float(value) for value in part.detach().aminmax())
            if not (low >= 0 and high <= 1):  # false for NaN
                raise ViewnetError(f"images have values from {low:g} to {high:g}: expected 0 to 1, or uint8")
            scaled = part.detach().float()
        if start == 0:
            _warn(framing, [f"image {row}" for row in _bright(scaled).nonzero().flatten().tolist()])
        yield scaled


def _bright(images: Tensor) -> Tensor:
    """(N,) bool: which images (N, 3, S, S) are not black along their edges."""
    edges = torch.cat([images[:, :, [0, -1]].flatten(2), images[:, :, :, [0, -1]].flatten(2)], 2)  # (N, 3, 4 S)
    return edges.mean((1, 2)) > BRIGHT


def _warn(framing: "Framing", bright: Sequence[str]) -> bool:
    """Name the first of the images that are unlike those of training; whether there is one."""
    if not (framing.cutout and bright):
        return False
    log.warning("%s is not black around its object, as all images in training were: give a mask", bright[0])
    return True


def _name(image: ImageLike, row: int) -> str:
    return os.fspath(image) if isinstance(image, (str, os.PathLike)) else f"image {row}"


def _positive(batch_size: int) -> int:
    if not isinstance(batch_size, int) or batch_size < 1:
        raise ViewnetError(f"batch_size {batch_size!r}: expected a whole number of 1 or more")
    return batch_size
