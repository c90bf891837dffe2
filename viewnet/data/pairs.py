"""Pairs for training: views held in memory, and batches that depend on (seed, step) alone (section 4.1)."""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import ModelConfig
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError

CROP_MARGIN = 0.05
"""Where views are cropped to their object: the margin all around, as a share of its side."""


@dataclass(frozen=True)
class Views:
    """Some views of a store, in memory: RGB times alpha and alpha, uint8 (N, 4, S, S), each object's views in a row."""

    pixels: Tensor
    crops: Tensor | None  # (N, 4, s, s) the same views cropped to their object, for networks that see crops
    objects: Tensor  # (N,) which object each view shows, counting from 0
    truth: Tensor  # (N, 2) azimuth and elevation in degrees; for scoring only
    first: Tensor  # (O,) the first view of each object
    count: Tensor  # (O,) how many views each object has

    def images(self, rows: Tensor, size: int, device: torch.device) -> Tensor:
        """RGB times alpha, and alpha, in [0, 1]: (n, 4, size, size)."""
        images = self.pixels[rows].to(device).float().div_(255)  # (n, 4, S, S); float only here: uint8 is a quarter
        return resize(images, size)

    @property
    def opaque(self) -> bool:
        """Whether nothing in any view is transparent: photographs."""
        return bool((self.pixels[:, 3] == 255).all())

    def next_views(self, rows: Tensor) -> Tensor:
        """Rows of the next view of each view's object (after the last, the first): its appearance comes from there."""
        start, count = self.first[self.objects[rows]], self.count[self.objects[rows]]
        return start + (rows - start + 1) % count  # (n,)

    def viewpoint_input(self, rows: Tensor, size: int, device: torch.device) -> Tensor:
        """The viewpoint network's input (n, 4, size, size): the crops where there are any, else the views."""
        if self.crops is None:
            return self.images(rows, size, device)
        return self.crops[rows].to(device).float().div_(255)

    def batch(
        self, appearance: Tensor, targets: Tensor, size: int, device: torch.device
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Images of the rows `appearance` and `targets`, and these as `viewpoint_input`: read once if none is cut."""
        images = self.images(targets, size, device)
        inputs = images if self.crops is None else self.viewpoint_input(targets, size, device)
        return self.images(appearance, size, device), images, inputs


def resize(images: Tensor, size: int) -> Tensor:
    """Images (N, C, H, H) at another size, by averaging areas; themselves where they have it."""
    while images.shape[-1] >= 2 * size and images.shape[-1] % (2 * size) == 0:  # pairs: several times as fast
        rows = images[..., ::2, :] + images[..., 1::2, :]  # (N, C, H / 2, H)
        images = (rows[..., ::2] + rows[..., 1::2]) / 4  # (N, C, H / 2, H / 2)
    return images if images.shape[-1] == size else F.interpolate(images, (size, size), mode="area")


def tight_crop(images: Tensor, size: int, stretch: bool = False, margin: float = CROP_MARGIN) -> Tensor:
    """Images (N, 4, H, H), RGB times alpha and alpha in [0, 1], cropped to their alpha's box: (N, 4, size, size).

    The box is a square around the longer side, centred, so that things keep their shape; with `stretch` it is their
    own, and what is in it is stretched. It has a `margin` of its sides all around; what it needs beyond the image is
    empty. An image without an object, or without anything else, is left whole.
    """
    full = images.shape[-1]
    covered = images[:, 3] > 0.5
    edges = torch.arange(full, device=images.device)  # (H,)
    low, high = [], []
    for axis in (2, 1):  # columns, then rows
        occupied = covered.any(3 - axis)  # (N, H)
        low.append(torch.where(occupied, edges, full).amin(1))  # (N,)
        high.append(torch.where(occupied, edges + 1, 0).amax(1))  # (N,), one past the last
    start, end = torch.stack(low, 1).float(), torch.stack(high, 1).float()  # (N, 2): x, y
    empty = ~covered.flatten(1).any(1)  # (N,)
    start, end = start.masked_fill(empty[:, None], 0), end.masked_fill(empty[:, None], full)  # (N, 2)
    margins = torch.where(empty | covered.flatten(1).all(1), 0.0, margin)  # (N,)
    sides = end - start if stretch else (end - start).amax(1, keepdim=True).expand(-1, 2)  # (N, 2)
    half = sides / 2 * (1 + 2 * margins[:, None])  # (N, 2), pixels
    centre = (start + end) / 2
    matrix = torch.diag_embed(half / (full / 2))  # (N, 2, 2); grids run over [-1, 1]
    shift = (centre / (full / 2) - 1)[:, :, None]  # (N, 2, 1)
    # More samples than pixels, averaged: an enlarged crop stays smooth and a whole image is not aliased.
    fine = size * max(1, -(-full // size))  # `full` / `size` rounded up, times `size`
    grid = F.affine_grid(torch.cat([matrix, shift], 2), [len(images), 4, fine, fine], align_corners=False)  # (N, 2, 3)
    return resize(F.grid_sample(images, grid, align_corners=False), size)


def load_views(store: ViewStore, split: str, size: int, crop: int | None = None, stretch: bool = False) -> Views:
    """The views of one split at `size` pixels a side, and cut to `crop` pixels a side where that is given.

    See `tight_crop`. ViewnetError where the split has none.
    """
    rows = store.split(split)
    index = store.index.iloc[rows]
    chunks, crops = [], []
    for chunk in np.array_split(rows, max(1, len(rows) // 512)):  # in parts: a float copy of all is large
        straight = torch.from_numpy(np.asarray(store.images[chunk])).permute(0, 3, 1, 2).float()  # (n, 4, H, W)
        # Averaging is only right on colours that are weighted by their alpha.
        weighted = torch.cat([straight[:, :3] * (straight[:, 3:] / 255), straight[:, 3:]], dim=1)  # (n, 4, H, W)
        chunks.append(resize(weighted, size).round().to(torch.uint8))
        if crop:
            crops.append(tight_crop(weighted / 255, crop, stretch).mul_(255).round_().to(torch.uint8))
    objects = torch.from_numpy(index["model_id"].factorize()[0].astype(np.int64))  # (N,), 0, 1, ... as they come
    count = torch.bincount(objects)
    truth = torch.from_numpy(index[["azimuth", "elevation"]].to_numpy(np.float32, copy=True))  # (N, 2)
    return Views(torch.cat(chunks), torch.cat(crops) if crop else None, objects, truth, count.cumsum(0) - count, count)


def model_views(store: ViewStore, split: str, size: int, config: ModelConfig) -> Views:
    """`load_views` with the crops that the networks of `config` see."""
    return load_views(
        store, split, size, None if config.crop == "none" else config.input_size, config.crop == "stretched"
    )


def sample_pairs(views: Views, objects: int, targets: int, seed: int, step: int) -> tuple[Tensor, Tensor]:
    """Rows of `objects` appearance views and of `objects * targets` target views of the same objects, none twice.

    An epoch's worth of steps visits every object equally often (a fresh shuffle each time round); the draw depends on
    (seed, step) alone, so that a resumed run sees what an undisturbed one would. Raises ViewnetError where an object
    has a single view.
    """
    total = len(views.first)
    if (views.count < 2).any():
        raise ViewnetError("training needs two views or more of every object: render more views a model")
    places = step * objects + torch.arange(objects)  # (objects,), in an endless row of shuffles
    rounds = [  # a step may span two, or more of few objects
        torch.randperm(total, generator=_generator(seed, 0, time))[places[places // total == time] % total]
        for time in torch.unique(places // total).tolist()
    ]
    chosen = torch.cat(rounds)  # (objects,)
    keys = torch.rand(objects, int(views.count.max()), generator=_generator(seed, 1, step))  # (objects, most views)
    keys[torch.arange(keys.shape[1]) >= views.count[chosen, None]] = 2.0  # views that there are not come last
    order = keys.argsort(1)
    # An object with fewer views than asked for gives its targets again, never the appearance view.
    repeat = 1 + torch.arange(targets)[None] % (views.count[chosen, None] - 1)  # (objects, targets)
    appearance = views.first[chosen] + order[:, 0]  # (objects,)
    return appearance, (views.first[chosen, None] + order.gather(1, repeat)).flatten()  # (objects * targets,)


def _generator(*numbers: int) -> torch.Generator:
    seed = int(np.random.SeedSequence(list(numbers)).generate_state(1, np.uint64)[0] >> 1)
    return torch.Generator().manual_seed(seed)  # SeedSequence hashes: near numbers, unrelated streams


def step_generator(seed: int, step: int) -> torch.Generator:
    """Random numbers for one training step."""
    return _generator(seed, 2, step)
