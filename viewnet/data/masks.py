"""Masks of the object in every frame of a clip: read from files, taken from the images' alpha, or predicted.

A mask source makes a follower for each clip, which is called on the clip's frames in the order of time. A frame without
a usable mask raises ViewnetError with a reason that begins with "mask".
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from scipy import ndimage
from torch import nn

from viewnet.config import CATEGORIES, known
from viewnet.data import mask_files
from viewnet.data.clips import Clip, Still, frame_count, is_lossy, read_frames
from viewnet.errors import ViewnetError
from viewnet.runtime import torchvision_weights

VERSION = 2  # raise it when a change alters masks: it is part of every store's identity
NETWORKS = {"maskrcnn": "maskrcnn_resnet50_fpn", "deeplabv3": "deeplabv3_resnet50"}
"""Our name -> torchvision's. Mask R-CNN separates the objects of a class; DeepLabV3 does not, so each connected region
counts as one."""
COCO = dict(aeroplane="airplane", diningtable="dining table", motorbike="motorcycle", sofa="couch", tvmonitor="tv")
"""COCO's names of categories where PASCAL VOC, and so DeepLabV3, has other ones."""
SURE = 0.5  # score of an object, and probability of a pixel, from which on they count
SPECK = 0.02  # regions below this share of the largest one are no objects
FOLLOW = 0.2  # intersection over union with the mask before, from which on an object is taken for the same
SIDE = 520  # pixels along the shorter side of what DeepLabV3 sees, as in its training

Follower = Callable[[int, str, Image.Image], np.ndarray]
"""A frame's number, name and image -> alpha (H, W) uint8. Raises ViewnetError where there is no usable mask."""
Segmenter = Callable[[Image.Image], np.ndarray]  # an image -> masks (K, H, W) bool of the K objects of a class in it


@dataclass(frozen=True)
class MaskSource:
    """Where masks come from."""

    described: dict[str, Any]  # what decides the masks but for the clips' own files, as JSON values
    follow: Callable[[Clip], Follower]  # a new follower for the frames of a clip
    parallel: bool = True  # whether clips are better worked on side by side


def from_files() -> MaskSource:
    """PNG files (see mask_files) in each clip's folder of masks, named like its images, or by frame number; or a video.

    Its follower raises ViewnetError for a mask that is missing, and making one for a video that cannot be of the clip.
    """

    def follow(clip: Clip) -> Follower:
        if clip.masks and clip.masks.is_file():
            return _from_video(clip, clip.masks)

        def read(number: int, name: str, image: Image.Image) -> np.ndarray:
            files = [clip.masks / f"{name}.png", clip.masks / f"{number:06d}.png"] if clip.masks else []
            file = next((path for path in files if path.is_file()), None)
            if file is None:
                raise ViewnetError("mask is missing")
            return _of_size(mask_files.read(file), image)

        return read

    return MaskSource({"masks": "files", "version": VERSION}, follow)


def _of_size(mask: np.ndarray, image: Image.Image) -> np.ndarray:
    if mask.shape != (image.height, image.width):
        raise ViewnetError(f"mask has another size than its image ({mask.shape[1]} x {mask.shape[0]})")
    return mask


def _from_video(clip: Clip, file: Path) -> Follower:
    """The masks in a video, a frame for each of the clip's with the same number.

    Raises ViewnetError, which names the file, where it has another number of frames or size, or no object at all.
    """
    try:
        total, lossy = frame_count(file), is_lossy(file)
    except ViewnetError as error:
        raise ViewnetError(f"video of masks is unusable ({file.name}: {error})") from None
    if total != (images := frame_count(clip.source)):
        raise ViewnetError(f"video of masks has another number of frames ({file.name}: {total}, and {images} images)")
    numbers = [frame.number for frame in clip.frames] or range(total)

    def mask(still: Still) -> np.ndarray:
        if isinstance(still[2], ViewnetError):
            raise ViewnetError(f"mask does not decode ({file.name})")
        return mask_files.read_lossy(still[2]) if lossy else mask_files.read(still[2])

    reasons: list[str] = []
    for still in read_frames(file, numbers):
        try:
            if (found := mask(still)).any():
                break
            reasons.append("all of them are black")
        except ViewnetError as error:
            reasons.append(str(error))
    else:
        raise ViewnetError(f"video of masks shows no object ({file.name}: {reasons[0]})")
    for _, _, image in read_frames(clip.source, [still[0]]):
        if isinstance(image, Image.Image) and image.size != found.shape[::-1]:
            sizes = "{} x {}, and images of {} x {}".format(*found.shape[::-1], *image.size)
            raise ViewnetError(f"video of masks has another size ({file.name}: {sizes})")
    stills = read_frames(file, numbers)

    def read(number: int, name: str, image: Image.Image) -> np.ndarray:
        return _of_size(mask(next(still for still in stills if still[0] == number)), image)

    return read


def from_alpha() -> MaskSource:
    """The alpha of the images themselves. Followers raise ViewnetError for an image without."""

    def read(number: int, name: str, image: Image.Image) -> np.ndarray:
        if not image.has_transparency_data:
            raise ViewnetError("mask is missing (the image has no alpha)")
        return np.array(image.convert("RGBA").getchannel("A"))

    return MaskSource({"masks": "alpha", "version": VERSION}, lambda clip: read)


def from_segmenter(segment: Segmenter, described: dict[str, Any]) -> MaskSource:
    """Masks by a network: the largest object of the class first, then what overlaps most; ViewnetError for none."""

    def follow(clip: Clip) -> Follower:
        last: np.ndarray | None = None

        def find(number: int, name: str, image: Image.Image) -> np.ndarray:
            nonlocal last
            objects = segment(image.convert("RGB"))
            if not len(objects) or not objects.any():
                raise ViewnetError("mask is missing (nothing of the class is seen)")
            last = objects[continuing(objects, last)]
            return last.astype(np.uint8) * 255

        return find

    return MaskSource(described, follow, parallel=False)


def mask_source(name: str, category: str) -> MaskSource | None:
    """The source that a configuration names: files, alpha, none, or else a network (see `predicted`)."""
    plain: dict[str, MaskSource | None] = {"none": None, "files": from_files(), "alpha": from_alpha()}
    return plain[name] if name in plain else predicted(name, category)


def continuing(objects: np.ndarray, last: np.ndarray | None) -> int:
    """Which of the masks (K, H, W) bool continues the mask before (H, W); the largest where none does."""
    if last is not None and last.shape == objects.shape[1:]:
        union = (objects | last).sum((1, 2))
        overlap = (objects & last).sum((1, 2)) / np.maximum(union, 1)
        if overlap.max() >= FOLLOW:
            return int(overlap.argmax())
    return int(objects.sum((1, 2)).argmax())


def predicted(network: str, category: str) -> MaskSource:
    """Masks of a category by torchvision's network for COCO: "maskrcnn" or "deeplabv3". Raises as `segmenter` does."""
    path = torchvision_weights.weights_file(NETWORKS[known(network, NETWORKS, "network for masks")])
    segment = segmenter(network, category, path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    return from_segmenter(segment, {"masks": network, "category": category, "weights": digest, "version": VERSION})


def segmenter(network: str, category: str, path: Path) -> Segmenter:
    """The network of `predicted` with the weights of a file. Raises ViewnetError where these cannot be used."""
    from torchvision import models

    known(category, CATEGORIES, "category")
    full, instances = NETWORKS[network], network == "maskrcnn"
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model = models.get_model(full, weights=None, weights_backbone=None)
    torchvision_weights.load(model, full, path, "use masks from files or from the images' alpha")
    if instances:
        for layer in model.modules():
            if isinstance(layer, nn.BatchNorm2d):
                layer.eps = 0.0  # the weights were trained with layers that have none
    model.eval().to(device)
    names = torchvision_weights.published(full).meta["categories"]
    label = names.index(COCO.get(category, category) if instances else category)
    statistics = [torchvision_weights.IMAGENET_MEAN, torchvision_weights.IMAGENET_STD]
    mean, deviation = torch.tensor(statistics).view(2, 3, 1, 1)

    @torch.no_grad()
    def by_instance(image: Image.Image) -> np.ndarray:
        (result,) = model([_tensor(image).to(device)])
        mine = (result["labels"] == label) & (result["scores"] >= SURE)
        return (result["masks"][mine, 0] >= SURE).cpu().numpy()

    @torch.no_grad()
    def by_class(image: Image.Image) -> np.ndarray:
        scale = SIDE / min(image.size)
        small = image.resize((round(image.width * scale), round(image.height * scale)), Image.Resampling.BILINEAR)
        scores = model(((_tensor(small) - mean) / deviation)[None].to(device))["out"]
        full = F.interpolate(scores, (image.height, image.width), mode="bilinear", align_corners=False)
        return regions((full[0].argmax(0) == label).cpu().numpy())

    return by_instance if instances else by_class


def regions(covered: np.ndarray) -> np.ndarray:
    """The connected regions (K, H, W) of a mask (H, W) bool but for specks."""
    labels, count = ndimage.label(covered)
    areas = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    large = np.flatnonzero(areas >= SPECK * areas.max(initial=1)) + 1
    return labels[None] == large[:, None, None]


def _tensor(image: Image.Image) -> torch.Tensor:
    """(3, H, W) in [0, 1]."""
    return torch.from_numpy(np.array(image)).permute(2, 0, 1).float() / 255
