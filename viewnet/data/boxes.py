"""The boxes around CAD models, for methods that learn from them."""

import numpy as np
import torch
from torch import Tensor

from viewnet import paths
from viewnet.config import DataConfig
from viewnet.data.build import as_training_models, built_in
from viewnet.data.readers.shapenet import ModelFile, find_models, load_model
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.runtime.files import load_array, replacing


def boxes_of(config: DataConfig, store: ViewStore, split: str) -> Tensor:
    """Sides (O, 3) along x, y and z of the box around each object of a split, in the order of Views; its diagonal is 1.

    Of the meshes that the views of `config` were rendered from; measured once and kept in `<paths.data()>/boxes`.
    Raises ViewnetError for photographs and videos, which have none, and for models that are no longer there.
    """
    if config.video is not None or "renderer" not in store.meta["made_by"]:
        raise ViewnetError(f"{store.folder}: no boxes are known of photographs and videos: train on CAD models")
    names = store.index["model_id"].unique()  # (O of all splits,)
    path = paths.data() / "boxes" / f"{store.identity}.npy"
    if not path.is_file():
        models = {model.id: model for model in _models(config)}
        if missing := [name for name in names if name not in models]:
            where = config.root or "the built-in models"
            raise ViewnetError(f"{store.folder}: model {missing[0]} is not in {where}: name its collection")
        sides = np.stack([np.ptp(load_model(models[name]).vertices, axis=0) for name in names])
        with replacing(path) as temporary:
            np.save(temporary, sides)
    sides = load_array(path, again := "delete it and it is made again")
    if sides.shape != (len(names), 3) or not (np.isfinite(sides).all() and (sides >= 0).all()):
        raise ViewnetError(f"{path}: {sides.dtype} {sides.shape} for {len(names)} objects: {again}")
    here = store.index["model_id"].iloc[store.split(split)].unique()
    return torch.from_numpy(sides[np.isin(names, here)]).float()


def _models(config: DataConfig) -> list[ModelFile]:
    """The models that views of `config` are rendered from, and perhaps more of their collection."""
    root = built_in(config.category, config.models, config.seed) if config.root is None else config.root
    models = find_models(root, config.category, config.splits if config.root else None, config.seed)
    if config.extra is not None:
        models = [*models, *as_training_models(find_models(config.extra, config.category), config)]
    return models
