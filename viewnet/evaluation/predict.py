"""From a checkpoint to predictions: a row for each image."""

from pathlib import Path

import numpy as np
import pandas as pd
import torch

from viewnet.config import RunConfig
from viewnet.data import augment
from viewnet.data.pairs import model_views
from viewnet.data.store import ViewStore
from viewnet.evaluation.predictions import ID_COLUMNS, Predictions
from viewnet.model.checkpoint import CHECKPOINT
from viewnet.model.viewnet import ViewNet
from viewnet.peers import registry
from viewnet.peers.peer import Peer

BATCH = 256  # images at once


@torch.no_grad()
def predict(
    model: Path | ViewNet | Peer,
    store: ViewStore,
    splits: tuple[str, ...] = ("val", "test"),
    checkpoint: str = CHECKPOINT,
    config: RunConfig | None = None,
) -> Predictions:
    """Viewpoint hypotheses for every view of the given splits, in the store's order, by a network or a run's folder.

    `checkpoint` is the file's name in that folder; `config` is how a network that is handed in was trained. Views for
    networks trained with backgrounds get backgrounds as in training, the same each time; photographs, which have their
    own, are not changed. Raises ViewnetError where views have no annotated viewpoint.
    """
    store.require_viewpoints(splits, "what cannot be scored is not predicted: use an annotated store")
    network, config = registry.load(model, checkpoint) if isinstance(model, Path) else (model.eval(), config)
    device, size = network.focal.device, network.config.input_size
    backgrounds = augment.load(config.data, size, device) if config else None
    rows, batches = [], []
    for split in splits:
        views = model_views(store, split, size, network.config)
        rows.append(store.index[store.index["split"] == split])
        generator = torch.Generator().manual_seed(0)  # the same backgrounds each time
        for part in torch.arange(len(views.objects)).split(BATCH):
            images = views.viewpoint_input(part, size, device)  # (n, 4, S, S)
            if config and backgrounds is not None and not views.opaque:
                images = augment.photograph(images, backgrounds, config.train.photo, generator)
            batches.append(network.viewpoint(network.composite(images)))
    vectors, logits, ups = (
        np.concatenate([value.double().cpu().numpy() for value in values]) if values[0] is not None else None
        for values in zip(*((batch.vectors, batch.logits, batch.ups) for batch in batches), strict=True)
    )
    assert vectors is not None and logits is not None
    return Predictions(pd.concat(rows, ignore_index=True)[list(ID_COLUMNS)], vectors, logits, ups)
