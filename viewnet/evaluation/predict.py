"""From a checkpoint to predictions: one row an image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from viewnet.data import augment
from viewnet.data.pairs import viewed
from viewnet.data.store import ViewStore
from viewnet.evaluation.predictions import Predictions
from viewnet.model.checkpoint import load_model
from viewnet.model.losses import composite
from viewnet.model.viewnet import ViewNet
from viewnet.training.step import reconstruct

BATCH = 256


@torch.no_grad()
def predict(model: Path | ViewNet, store: ViewStore, splits: tuple[str, ...] = ("val", "test")) -> Predictions:
    """Viewpoint hypotheses for every view of the given splits, in the store's order.

    A run that was trained before backgrounds is shown views as in training, the same each time; photographs have their
    own background and are shown as they are. Raises ViewnetError where views have no annotated viewpoint.
    """
    store.require_viewpoints(splits, "what cannot be scored is not predicted: use an annotated store")
    network, config = load_model(model) if isinstance(model, Path) else (model.eval(), None)
    device, size = network.focal.device, network.config.input_size
    scenery = augment.load(config.data, size, device) if config else None
    rows, vectors, logits, ups = [], [], [], []
    for split in splits:
        views = viewed(store, split, size, network.config)
        rows.append(store.index[store.index["split"] == split])
        generator = torch.Generator().manual_seed(0)
        for part in torch.arange(len(views.objects)).split(BATCH):
            seen = views.seen(part, size, device)
            if config and scenery is not None and not views.opaque:
                seen = augment.photograph(seen, scenery, config.train, generator)
            found = network.viewpoint(network.see(seen))
            vectors.append(_array(found.vectors))
            logits.append(_array(found.logits))
            if found.ups is not None:
                ups.append(_array(found.ups))
    import pandas as pd

    ids = pd.concat(rows, ignore_index=True)[["model_id", "category", "split", "view", "azimuth", "elevation"]]
    return Predictions(ids, np.concatenate(vectors), np.concatenate(logits), np.concatenate(ups) if ups else None)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.double().cpu().numpy()


@torch.no_grad()
def candidates(folder: Path, store: ViewStore, rows: list[int], split: str = "test") -> tuple[np.ndarray, ...]:
    """What each head draws of some views of a split, ranked by reconstruction error (figure 3d).

    Returns the views themselves (N, H, W, 3) uint8, the drawings (N, M, H, W, 3) uint8, their errors (N, M) ascending
    and the heads' numbers (N, M). The appearance comes from the next view of the same object, the background is white.
    """
    network, config = load_model(folder)
    device, size = network.focal.device, network.config.render_size
    small = network.config.input_size
    views = viewed(store, split, max(size, small), network.config)
    index = torch.tensor(rows)
    others = views.partners(index)
    seen, behind, scenery = views.seen(index, small, device), None, augment.load(config.data, small, device)
    if scenery is not None:
        generator = torch.Generator().manual_seed(0)
        seen = augment.photograph(seen, scenery, config.train, generator)
        behind = augment.behind(scenery, len(others), small, generator, device)
    found = reconstruct(
        network,
        views.images(others, small, device),
        views.images(index, small, device),
        seen,
        config.train,
        behind=behind,
    )
    heads = network.config.heads
    drawn = _on_white(network.draw(found.shape, found.appearance, found.hypotheses.frames.flatten(0, 1)))
    ranked = found.errors.argsort(1)
    return (
        _on_white(views.images(index, size, device)),
        drawn.reshape(-1, heads, *drawn.shape[1:])[np.arange(len(rows))[:, None], ranked.cpu().numpy()],
        found.errors.gather(1, ranked).cpu().numpy(),
        ranked.cpu().numpy(),
    )


def _on_white(images: Tensor) -> np.ndarray:
    """Images (N, 4, H, W), RGB times mask and mask in [0, 1] -> (N, H, W, 3) uint8."""
    colours = composite(images, torch.ones(len(images), 3, device=images.device))
    return (colours.clamp(0, 1) * 255).round().to(torch.uint8).movedim(1, -1).cpu().numpy()
