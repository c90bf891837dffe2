"""Image features for the linear regression of viewpoints (the row "VGG view").

They are named by a network of viewnet.runtime.torchvision_weights, whose last convolutions they are, or "pixels": grey
levels and edge directions, which need no weights. "auto" is the first of AUTO whose weights are there.
"""

import hashlib
from collections.abc import Callable

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
SIZE = 128  # image side in pixels: VGG16's last convolutions, pooled, are then 4x4x512
BATCH = 64
GREY, CELLS, DIRECTIONS = 16, 8, 8
PIXELS_SCALE = 64.0  # the power of two at which ridge 1000 has the least leave-one-out error on 300 photographs of cars
ALTERNATIVE = "use features=pixels, which needs no weights"

Features = NDArray[np.float32]


def choose(name: str = "auto") -> str:
    """The name, "auto" resolved. ViewnetError for unknown ones and missing weights."""
    if name == "auto":
        return next(each for each in AUTO if each == "pixels" or torchvision_weights.available(each))
    if name != "pixels" and not torchvision_weights.available(name):
        torchvision_weights.convolutions(name, otherwise=ALTERNATIVE)  # raises
    return name


def describe(name: str, size: int = SIZE) -> str:
    """The features in some words, for the note under a table."""
    kind = "grey levels and directions of edges" if name == "pixels" else f"{name} convolutions"
    return f"{kind} at {size} px"


def extract(store: ViewStore, name: str = "auto", size: int = SIZE) -> Features:
    """Features (N, D) of every view of a store, in its order, resized to `size` pixels a side and over black.

    Of a network the last convolutional map, flattened, which keeps the positions. Cached in `<paths.data()>/features`.
    Raises ViewnetError as `choose` does.
    """
    name = choose(name)
    weights = b"" if name == "pixels" else torchvision_weights.weights_file(name).read_bytes()
    code = provenance.code_identity(("evaluation/features.py", "runtime/torchvision_weights.py"))
    digest = hashlib.sha256(f"{store.identity} {name} {size} {code}".encode() + weights).hexdigest()[:16]
    path = paths.data() / "features" / f"{digest}.npy"
    if path.is_file():
        cached = load_array(path, again := "delete it and it is made again")
        if cached.shape[:-1] != (len(store),) or cached.dtype != np.float32 or not np.isfinite(cached).all():
            raise ViewnetError(f"{path}: {cached.dtype} {cached.shape} for {len(store)} images: {again}")
        return cached
    compute = pixel_features if name == "pixels" else _network_features(name)
    parts = np.array_split(np.arange(len(store)), max(1, -(-len(store) // BATCH)))
    features = np.concatenate([compute(images(store, part, size)) for part in parts])
    with replacing(path) as temporary:
        np.save(temporary, features)
    return features


def images(store: ViewStore, rows: NDArray[np.intp], size: int) -> Tensor:
    """Some views (n, 3, size, size), RGB in [0, 1], composited over black."""
    rgba = torch.from_numpy(np.array(store.images[rows])).movedim(-1, 1).float().div_(255)  # (n, 4, S, S)
    rgb = rgba[:, :3] * rgba[:, 3:]
    if rgb.shape[-1] == size:
        return rgb
    return F.interpolate(rgb, (size, size), mode="bilinear", antialias=True).clamp_(0, 1)  # (n, 3, size, size)


def _network_features(name: str) -> Callable[[Tensor], Features]:
    """A function from images (n, 3, S, S) to flattened convolutional features (n, D)."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    layers = torchvision_weights.convolutions(name, otherwise=ALTERNATIVE).to(device)
    imagenet = torch.tensor([torchvision_weights.IMAGENET_MEAN, torchvision_weights.IMAGENET_STD], device=device)
    mean, std = imagenet.view(2, 1, 3, 1, 1)

    @torch.no_grad()
    def compute(rgb: Tensor) -> Features:
        return layers((rgb.to(device) - mean) / std).flatten(1).float().cpu().numpy()

    return compute


def pixel_features(rgb: Tensor) -> Features:
    """Of images (n, 3, S, S): grey levels at 16x16, and the strength of edges of 8 directions in each of 8x8 cells."""
    grey = rgb.mean(dim=1, keepdim=True)  # (n, 1, S, S)
    small = F.adaptive_avg_pool2d(grey, GREY).flatten(1)  # (n, 256)
    small = F.normalize(small - small.mean(dim=1, keepdim=True), dim=1)  # neither brightness nor contrast counts
    x = F.pad(grey[..., 2:] - grey[..., :-2], (1, 1))  # (n, 1, S, S)
    y = F.pad(grey[..., 2:, :] - grey[..., :-2, :], (0, 0, 1, 1))
    strength, direction = torch.hypot(x, y), torch.atan2(y, x) % torch.pi * (DIRECTIONS / torch.pi)
    # A direction between two bins counts for both, by its distance to each.
    away = (direction - torch.arange(DIRECTIONS, device=rgb.device).view(1, -1, 1, 1)).abs()  # (n, 8, S, S)
    share = (1 - torch.minimum(away, DIRECTIONS - away)).clamp_(min=0)  # (n, 8, S, S)
    edges = F.normalize(F.adaptive_avg_pool2d(share * strength, CELLS).flatten(1).sqrt(), dim=1)  # (n, 512)
    return (PIXELS_SCALE * torch.cat([small, edges], dim=1)).numpy()
