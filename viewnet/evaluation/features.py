"""What an image looks like, in numbers: the convolution features that a linear regression of viewpoints starts from.

A backbone is a network of viewnet.runtime.torchvision_weights, or "pixels": grey levels and directions of edges, which need no weights.
"auto" is the first of AUTO that is at hand.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from viewnet import paths
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.runtime import provenance, torchvision_weights
from viewnet.runtime.files import load_array, replacing

AUTO = ("vgg16", "squeezenet1_1", "pixels")
SIZE = 128
"""Pixels along a side of what a backbone sees: VGG16's last convolutions are then 4x4x512 after their pooling."""
BATCH = 64
GREY, CELLS, DIRECTIONS = 16, 8, 8
PIXELS_SCALE = 64.0
"""Of "pixels": the power of two at which ridge 1000 leaves the least leave-one-out error on 300 photographs of cars."""

Features = NDArray[np.float32]


def choose(backbone: str = "auto") -> str:
    """The backbone that is meant: "auto" resolved, others checked. ViewnetError for unknown ones, missing weights."""
    if backbone == "auto":
        return next(name for name in AUTO if name == "pixels" or torchvision_weights.available(name))
    if backbone != "pixels" and not torchvision_weights.available(backbone):
        torchvision_weights.convolutions(backbone, otherwise=OTHERWISE)  # says what is missing
    return backbone


OTHERWISE = "use backbone=pixels, which needs no weights"


def describe(backbone: str, size: int = SIZE) -> str:
    """What the features are, in some words: for the note under a table."""
    if backbone == "pixels":
        return f"grey levels and directions of edges at {size} px"
    return f"{backbone} convolutions at {size} px"


def extract(store: ViewStore, backbone: str = "auto", size: int = SIZE) -> Features:
    """Features (N, D) of every view of a store, in its order, over black where alpha is 0.

    Images are brought to `size` pixels a side and, for networks, normalised as ImageNet's are; the map of the last
    convolutions is flattened, so that it keeps what is where. Kept in `<paths.data()>/features` once computed. Raises
    ViewnetError as `choose` does.
    """
    backbone = choose(backbone)
    weights = b"" if backbone == "pixels" else torchvision_weights.weights_file(backbone).read_bytes()
    code = provenance.code_identity(("evaluation/features.py", "runtime/torchvision_weights.py"))
    digest = hashlib.sha256(f"{store.identity} {backbone} {size} {code}".encode() + weights).hexdigest()[:16]
    kept = paths.data() / "features" / f"{digest}.npy"
    if kept.is_file():
        return _read(kept, len(store))
    compute = _pixels if backbone == "pixels" else _Network(backbone)
    found = np.concatenate([compute(images(store, part, size)) for part in _parts(len(store))])
    with replacing(kept) as temporary:
        np.save(temporary, found)
    return found


def images(store: ViewStore, rows: NDArray[np.intp], size: int) -> Tensor:
    """Some views (n, 3, size, size), RGB in [0, 1], over black."""
    straight = torch.from_numpy(np.array(store.images[rows])).movedim(-1, 1).float().div_(255)
    shown = straight[:, :3] * straight[:, 3:]
    if shown.shape[-1] == size:
        return shown
    return F.interpolate(shown, (size, size), mode="bilinear", antialias=True).clamp_(0, 1)


class _Network:
    """Flattened convolution features of images."""

    def __init__(self, backbone: str):
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.layers = torchvision_weights.convolutions(backbone, otherwise=OTHERWISE).to(self.device)
        self.mean, self.std = (
            torch.tensor(values, device=self.device).view(1, 3, 1, 1)
            for values in (torchvision_weights.IMAGENET_MEAN, torchvision_weights.IMAGENET_STD)
        )

    @torch.no_grad()
    def __call__(self, shown: Tensor) -> Features:
        x = (shown.to(self.device) - self.mean) / self.std
        return self.layers(x).flatten(1).float().cpu().numpy()


def _pixels(shown: Tensor) -> Features:
    """Of images (n, 3, S, S): grey levels at 16x16, and how strong edges of 8 directions are in each of 8x8 cells.

    Both come centred or normalised an image: neither brightness nor contrast counts.
    """
    grey = shown.mean(dim=1, keepdim=True)
    small = F.adaptive_avg_pool2d(grey, GREY).flatten(1)
    small = F.normalize(small - small.mean(dim=1, keepdim=True), dim=1)
    x, y = (F.pad(part, pad) for part, pad in zip(_differences(grey), ((1, 1), (0, 0, 1, 1)), strict=True))
    strength, turn = torch.hypot(x, y), torch.atan2(y, x) % torch.pi * (DIRECTIONS / torch.pi)
    # A direction between two bins counts for both of them by its distance.
    bins = torch.arange(DIRECTIONS, device=shown.device).view(1, -1, 1, 1)
    away = (turn - bins).abs()
    share = (1 - torch.minimum(away, DIRECTIONS - away)).clamp_(min=0)
    edges = F.normalize(F.adaptive_avg_pool2d(share * strength, CELLS).flatten(1).sqrt(), dim=1)
    return (PIXELS_SCALE * torch.cat([small, edges], dim=1)).numpy()


def _differences(grey: Tensor) -> tuple[Tensor, Tensor]:
    return (grey[..., 2:] - grey[..., :-2]), (grey[..., 2:, :] - grey[..., :-2, :])


def _parts(count: int) -> list[NDArray[np.intp]]:
    return np.array_split(np.arange(count), max(1, -(-count // BATCH)))


def _read(path: Path, count: int) -> Features:
    found = load_array(path, "delete it and it is made again")
    if found.ndim != 2 or len(found) != count or found.dtype != np.float32 or not np.isfinite(found).all():
        raise ViewnetError(f"{path}: {found.dtype} {found.shape} for {count} images: delete it and it is made again")
    return found
