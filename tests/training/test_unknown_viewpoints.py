"""Views without annotated viewpoints: trained on without labels, and never scored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from viewnet.data.store import ViewStore, write_store
from viewnet.errors import ViewnetError
from viewnet.evaluation.predict import predict
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.training.train import train


def blind(folder: Path) -> ViewStore:
    """A store of noise without viewpoints: three clips to train on, one to validate."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (16, 16, 16, 4), dtype=np.uint8)
    images[..., 3] = 0
    images[:, 4:12, 3:13, 3] = 255
    index = pd.DataFrame(
        {
            "model_id": np.repeat(list("abcd"), 4),
            "category": "car",
            "split": np.repeat(["train", "train", "train", "val"], 4),
            "view": np.tile(np.arange(4), 4),
            "azimuth": np.nan,
            "elevation": np.nan,
            "source": "s",
        }
    )
    return write_store(folder, [images], index, {})


def plain(**changes):
    settings = {"epochs": 1, "batch_size": 4, "amp": "off", "neighbours": 0.0, "search": 0.0}
    return make_config(profile="smoke", recipe="matting", **{**settings, **changes})


def test_scoring_without_viewpoints_is_refused_at_once(tmp_path):
    store = blind(tmp_path / "s")
    with pytest.raises(
        ViewnetError, match="4 of 4 views of val have no viewpoint: train with select_by='reconstruction'"
    ):
        train(plain(select_by="accuracy"), store, tmp_path / "run", progress=False)
    with pytest.raises(ViewnetError, match="4 of 4 views of val have no viewpoint: what cannot be scored"):
        predict(ViewNet(plain().model), store, ("val",))


@pytest.mark.parametrize("held_out", ["val", "train"])
def test_training_without_viewpoints(tmp_path, one_thread, held_out):
    store = blind(tmp_path / "s")
    if held_out == "train":  # no validation split
        store = write_store(tmp_path / "t", [store.images[:12]], store.index[:12], {})
    train(plain(), store, tmp_path / "run", threads=1, progress=False)
    log = pd.read_csv(tmp_path / "run/log.csv")
    assert log["val_accuracy"].isna().all() and log["val_reconstruction"].gt(0).all()
    assert (tmp_path / "run/checkpoint.safetensors").is_file()
