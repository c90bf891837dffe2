"""A saved model whose viewpoint network is trained on answers (viewnet.training.distil), scored and with its card."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from viewnet.config import RunConfig
from viewnet.data import build
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.estimator import pretrained
from viewnet.estimator.model_card import own
from viewnet.estimator.pretrained import Pretrained
from viewnet.evaluation.evaluate import scores
from viewnet.evaluation.predict import predict
from viewnet.evaluation.run import LEARNED_ALIGNMENTS, can_be_scored
from viewnet.experiments.parameters import folder_named
from viewnet.model import checkpoint
from viewnet.runtime import parallel, provenance
from viewnet.training.distil import KEPT, distil


def make(
    where: str,
    folder: Path,
    teachers: Sequence[str] = (),
    seed: int = 0,
    half: bool = False,
    cad_root: str | None = None,
    progress: bool = True,
) -> Pretrained:
    """Distil the model `where` from the answers of `teachers`, each what pretrained.load takes, and save it.

    Scores, and the rotation to the annotated frame, are of the views that the model was trained on; `cad_root` is where
    that collection lies, if it has moved. Raises ViewnetError for models that cannot teach each other, before anything
    is trained, and as viewnet.training.distil.distil and pretrained.save do. Nothing is written unless all succeeds.
    """
    check_place(folder, seed)
    models = [loaded(each, f"distil {each}") for each in (where, *teachers)]
    model, others = models[0], models[1:]
    for name, other in zip(teachers, others, strict=True):
        if other.config.category != model.config.category:
            categories = f"{other.config.category}, {where} of {model.config.category}"
            raise ViewnetError(f"{name}: is of the category {categories}")
    config = moved(model.config, cad_root)
    store = build.view_store(config.data, progress=progress)
    distil(model.network, config, store, [(each.network, each.config) for each in others], seed, progress)
    keys = [each.about.get("key", "unknown") for each in models]
    how = {"distilled": {"model": keys[0], "teachers": keys[1:] or keys[:1], "rounds": len(KEPT)}}
    return save_scored(model, config, store, how, seed, folder, half)


def check_place(folder: Path, seed: int) -> None:
    """ViewnetError as pretrained.check_place, and for no seed."""
    if not 0 <= seed < 2**32:
        raise ViewnetError(f"seed {seed}: expected 0 to {2**32 - 1}")
    pretrained.check_place(folder)


def loaded(where: str, what: str) -> Pretrained:
    """A model to train on, and PyTorch's threads set for it. ViewnetError for peers, naming `what` was asked for."""
    model = pretrained.load(where)
    model.require_viewnet(what)
    torch.set_num_threads(parallel.threads())
    return replace(model, network=model.network.to(pretrained.device(None)).eval())


def moved(config: RunConfig, cad_root: str | None) -> RunConfig:
    """The configuration with the collection that was trained on where it lies now."""
    if cad_root is None:
        return config
    return replace(config, data=replace(config.data, root=folder_named(cad_root, "cad_root")))


def save_scored(
    model: Pretrained, config: RunConfig, store: ViewStore, how: dict[str, Any], seed: int, folder: Path, half: bool
) -> Pretrained:
    """Write the model whose viewpoint network was trained on, `how` for its card, with scores on the views of `store`.

    The rotation to the annotated frame is fitted anew on validation views. Raises ViewnetError as pretrained.save.
    """
    metrics, rotation = None, model.annotated_from_model
    if can_be_scored(store.index):
        predictions = predict(model.network, store, config=config)
        metrics = scores(predictions, LEARNED_ALIGNMENTS)
        rotation = np.array(own(metrics)["alignment"]["rotation"])
    about: dict[str, Any] = {name: getattr(config, name) for name in ("variant", "category", "profile", "recipe")}
    key = checkpoint.fingerprint(model.network.state_dict())[:12]  # no run of the store has one
    about |= {"key": key, "seed": seed, "views": store.identity, "git": provenance.commit(), "metrics": metrics, **how}
    result = Pretrained(model.network, replace(model.config, seed=seed), rotation, about)
    pretrained.save(result, folder, None, half, [])
    return result
