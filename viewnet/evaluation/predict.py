"""From a checkpoint to predictions: one row an image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from viewnet.data import augment
from viewnet.data.pairs import model_views
from viewnet.data.store import ViewStore
from viewnet.evaluation.predictions import Predictions
from viewnet.model.checkpoint import load_model
from viewnet.model.viewnet import ViewNet

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
    backgrounds = augment.load(config.data, size, device) if config else None
    rows, vectors, logits, ups = [], [], [], []
    for split in splits:
        views = model_views(store, split, size, network.config)
        rows.append(store.index[store.index["split"] == split])
        generator = torch.Generator().manual_seed(0)
        for part in torch.arange(len(views.objects)).split(BATCH):
            images = views.viewpoint_input(part, size, device)
            if config and backgrounds is not None and not views.opaque:
                images = augment.photograph(images, backgrounds, config.train.photo, generator)
            found = network.viewpoint(network.composite(images))
            vectors.append(_array(found.vectors))
            logits.append(_array(found.logits))
            if found.ups is not None:
                ups.append(_array(found.ups))
    import pandas as pd

    ids = pd.concat(rows, ignore_index=True)[["model_id", "category", "split", "view", "azimuth", "elevation"]]
    return Predictions(ids, np.concatenate(vectors), np.concatenate(logits), np.concatenate(ups) if ups else None)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.double().cpu().numpy()
