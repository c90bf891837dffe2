"""Boxes around CAD models: those of the meshes that views were rendered from, or a refusal."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from helpers.boxes import box_store

from viewnet.config import DataConfig, VideoConfig
from viewnet.data import boxes, build
from viewnet.data.boxes import boxes_of
from viewnet.data.pairs import load_views
from viewnet.data.readers.shapenet import find_models, load_model
from viewnet.errors import ViewnetError

DATA = DataConfig("car", models=6, views=2, image_size=16, supersample=1)


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    return build.view_store(DATA, workers=1, progress=False)


def test_boxes_are_in_the_order_of_views(store, monkeypatch):
    meshes = {model.id: load_model(model).vertices for model in find_models(build.built_in("car", 6), "car")}
    for split in ("train", "val", "test"):
        found, views = boxes_of(DATA, store, split), load_views(store, split, 16)
        names = store.index["model_id"].iloc[store.split(split)].to_numpy()[views.first.numpy()]
        assert found.shape == (len(views.first), 3)
        expected = np.stack([meshes[name].max(0) - meshes[name].min(0) for name in names])
        assert np.allclose(found, expected, atol=1e-6)
        assert torch.allclose(found.norm(dim=1), torch.ones(len(found)))
        monkeypatch.setattr(boxes, "load_model", None)  # from here on they are kept


def test_models_of_another_collection_and_of_an_extra_one(store, tmp_path):
    root = build.built_in("car", 6)
    other = dataclasses.replace(DATA, root=str(root), extra=str(build.built_in("car", 6, seed=5)))
    views = build.view_store(other, workers=1, progress=False)
    train = boxes_of(other, views, "train")
    assert len(train) == views.index["model_id"].iloc[views.split("train")].nunique()
    assert torch.equal(boxes_of(other, views, "test"), boxes_of(DATA, store, "test"))


def test_what_has_no_boxes_is_refused(store, tmp_path):
    photographs = box_store(tmp_path / "made-up", {"train": 2})
    with pytest.raises(ViewnetError, match=r"made-up: no boxes are known"):
        boxes_of(DATA, photographs, "train")
    with pytest.raises(ViewnetError, match="no boxes are known"):
        boxes_of(dataclasses.replace(DATA, video=VideoConfig("car")), store, "train")
    with pytest.raises(ViewnetError, match=r"model \S+ is not in"):
        boxes_of(dataclasses.replace(DATA, models=7, seed=1), store, "train")


def test_a_damaged_file_is_named(store, tmp_path):
    boxes_of(DATA, store, "train")
    (file,) = (tmp_path / "data" / "boxes").iterdir()
    np.save(file, np.zeros((2, 3)))
    with pytest.raises(ViewnetError, match=file.name):
        boxes_of(DATA, store, "train")
