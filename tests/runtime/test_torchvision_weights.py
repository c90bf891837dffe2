from __future__ import annotations

import pytest

from viewnet.errors import ViewnetError
from viewnet.model.losses import PerceptualLoss
from viewnet.runtime import torchvision_weights


@pytest.mark.parametrize("network", ["vgg16", "squeezenet", "squeezenet1_1", "resnet18"])
def test_a_variable_names_the_file_and_its_home_folder_is_expanded(network, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv(torchvision_weights.variable(network), "~/weights.pth")
    assert torchvision_weights.weights_file(network) == tmp_path / "weights.pth"
    with pytest.raises(ViewnetError, match=rf"_WEIGHTS: .*{tmp_path}/weights\.pth"):
        torchvision_weights.available(network)


def test_the_perceptual_loss_reads_the_file_that_the_variable_names(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("VIEWNET_SQUEEZENET_WEIGHTS", "~/weights.pth")
    (tmp_path / "weights.pth").write_bytes(b"no weights")
    with pytest.raises(ViewnetError, match=rf"{tmp_path}/weights\.pth does not hold"):
        PerceptualLoss("squeezenet")


def test_without_a_variable_weights_are_expected_in_torchvision_s_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.delenv("VIEWNET_VGG16_WEIGHTS", raising=False)
    file = torchvision_weights.weights_file("vgg16")
    assert file.parent == tmp_path / "hub" / "checkpoints" and file.name.startswith("vgg16")
    assert not torchvision_weights.available("vgg16")
    with pytest.raises(ViewnetError, match="unknown network 'vgg17': choose one of"):
        torchvision_weights.weights_file("vgg17")
