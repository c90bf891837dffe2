from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.photo_data import make_photos

from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, features
from viewnet.evaluation.evaluate import evaluate
from viewnet.runtime import torchvision_weights


@pytest.fixture(autouse=True)
def nothing_from_outside(tmp_path, monkeypatch):
    for name in [name for name in os.environ if name.startswith("VIEWNET_") and name.endswith("_WEIGHTS")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))


@pytest.fixture
def store(tmp_path):
    return make_photos(tmp_path / "photos")


def made_up_weights(network: str, path: Path, whole: bool = False) -> Path:
    from torchvision import models

    torch.manual_seed(0)
    model = models.get_model(network, weights=None)
    state = model.state_dict() if whole else {k: v for k, v in model.state_dict().items() if "classifier" not in k}
    torch.save(state, path)
    return path


def test_pixels_tell_the_viewpoint_without_weights(store):
    found = features.extract(store, "pixels", 32)
    assert found.shape == (80, 16 * 16 + 8 * 8 * 8)
    assert found.dtype == np.float32
    score = evaluate(baselines.view_regression(store.index, found), "none", draws=20)
    assert score["acc30"] > 60


def test_pixels_do_not_depend_on_brightness_and_contrast():
    shown = torch.rand(3, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    assert np.allclose(features.pixel_features(shown), features.pixel_features(0.4 * shown + 0.3), atol=1e-3)
    assert np.isfinite(features.pixel_features(torch.zeros(1, 3, 32, 32))).all()


def test_edges_of_different_directions_are_told_apart():
    stripes = (torch.arange(32) // 4 % 2).float()
    across = features.pixel_features(stripes.expand(1, 3, 32, 32))[0, 256:].reshape(8, 64)
    along = features.pixel_features(stripes[:, None].expand(1, 3, 32, 32))[0, 256:].reshape(8, 64)
    assert across.sum(axis=1).argmax() == 0
    assert along.sum(axis=1).argmax() == 4
    assert across[4].max() < 0.1 * across[0].max()


def test_features_of_a_network_are_its_normalised_convolutions(store, tmp_path, monkeypatch):
    from torchvision import models

    path = made_up_weights("squeezenet1_1", tmp_path / "squeezenet.pth", whole=True)
    monkeypatch.setenv("VIEWNET_SQUEEZENET_WEIGHTS", str(path))
    found = features.extract(store, "squeezenet1_1", 48)
    network = models.squeezenet1_1()
    network.load_state_dict(torch.load(path))
    shown = features.images(store, np.arange(3), 48)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    with torch.no_grad():
        expected = network.features((shown - mean.view(3, 1, 1)) / std.view(3, 1, 1))
    assert found.shape == (80, expected[0].numel())
    assert np.allclose(found[:3], expected.flatten(1), atol=1e-4)


def test_networks_without_a_list_of_features_end_before_their_pooling(tmp_path):
    layers = torchvision_weights.convolutions("resnet18", made_up_weights("resnet18", tmp_path / "resnet.pth"))
    assert layers(torch.rand(1, 3, 64, 64)).shape == (1, 512, 2, 2)
    assert not layers.training


def test_images_are_shown_over_black_at_the_size_asked_for(store):
    shown = features.images(store, np.array([4]), 24)
    assert torch.allclose(shown[0], torch.from_numpy(store.images[4][..., :3] / 255).movedim(-1, 0).float())
    assert features.images(store, np.array([4, 5]), 50).shape == (2, 3, 50, 50)


def test_features_are_kept_and_made_again_for_other_settings(store, tmp_path, monkeypatch):
    first = features.extract(store, "pixels", 32)
    monkeypatch.setattr(features, "pixel_features", lambda shown: pytest.fail("computed again"))
    assert np.array_equal(features.extract(store, "pixels", 32), first)
    with pytest.raises(pytest.fail.Exception):
        features.extract(store, "pixels", 40)
    (kept,) = (tmp_path / "data" / "features").glob("*.npy")
    kept.write_bytes(b"half")
    with pytest.raises(ViewnetError, match=r"\.npy: not a whole array"):
        features.extract(store, "pixels", 32)


def test_auto_takes_the_best_features_at_hand(tmp_path, monkeypatch):
    assert features.choose() == "pixels"
    monkeypatch.setenv("VIEWNET_SQUEEZENET_WEIGHTS", str(made_up_weights("squeezenet1_1", tmp_path / "s.pth")))
    assert features.choose() == "squeezenet1_1"
    cache = tmp_path / "torch" / "hub" / "checkpoints"
    cache.mkdir(parents=True)
    (cache / "vgg16-397923af.pth").write_bytes(b"")
    assert features.choose() == "vgg16"
    assert features.choose("pixels") == "pixels"


def test_what_is_missing_is_said(tmp_path, monkeypatch):
    with pytest.raises(ViewnetError, match=r"no resnet18 weights at .*, or use features=pixels"):
        features.choose("resnet18")
    with pytest.raises(ViewnetError, match=r"unknown network 'vgg99'"):
        features.choose("vgg99")
    monkeypatch.setenv("VIEWNET_VGG16_WEIGHTS", str(tmp_path / "none.pth"))
    with pytest.raises(ViewnetError, match=r"VIEWNET_VGG16_WEIGHTS: .*none\.pth"):
        features.choose()
    with pytest.raises(ViewnetError, match="network 'vit_b_16' has no plain"):
        torchvision_weights.convolutions("vit_b_16", made_up_weights("squeezenet1_1", tmp_path / "s.pth"))
