"""Pairs for training: views held in memory, and batches that depend on (seed, step) alone (section 4.1)."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from viewnet.config import ModelConfig
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.runtime.images import resize, tight_crop


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


def load_views(store: ViewStore, split: str, size: int, crop: int | None = None, stretch: bool = False) -> Views:
    """The views of one split at `size` pixels a side, and cut to `crop` pixels a side where that is given.

    See viewnet.runtime.images.tight_crop. ViewnetError where the split has none.
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
    crop = None if config.crop == "none" else config.input_size
    return load_views(store, split, size, crop, config.crop == "stretched")


def sample_pairs(views: Views, objects: int, targets: int, seed: int, step: int) -> tuple[Tensor, Tensor]:
    """Rows of `objects` appearance views and of `objects * targets` target views of the same objects, none twice.

    An epoch's worth of steps visits every object equally often (a fresh shuffle each time round); the draw depends on
    (seed, step) alone, so a resumed run sees the same. Raises ViewnetError where an object has a single view.
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
