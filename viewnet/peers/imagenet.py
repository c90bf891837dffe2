"""A trunk with ImageNet's features for methods whose papers start from one: SqueezeNet 1.1, fine-tuned."""

import torch
from torch import Tensor, nn

from viewnet.peers.peer import Peer
from viewnet.runtime import torchvision_weights
from viewnet.runtime.torchvision_weights import IMAGENET_MEAN, IMAGENET_STD

NETWORK = "squeezenet1_1"  # ours: of five megabytes, where the papers have ResNets


class SqueezeNet(nn.Module):
    """Images (N, 3, S, S) in [0, 1] -> features (N, outputs), which keep positions."""

    mean: Tensor
    std: Tensor

    def __init__(self, outputs: int):
        super().__init__()
        from torchvision import models

        self.convolutions = models.get_model(NETWORK, weights=None).features
        self.last = nn.Sequential(
            nn.Conv2d(512, 128, 1), nn.ReLU(), nn.AdaptiveAvgPool2d(3), nn.Flatten(), nn.Linear(128 * 9, outputs)
        )
        for name, values in (("mean", IMAGENET_MEAN), ("std", IMAGENET_STD)):
            self.register_buffer(name, torch.tensor(values)[:, None, None], persistent=False)  # (3, 1, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Features (N, outputs) of images (N, 3, S, S)."""
        out: Tensor = self.last(self.convolutions((images - self.mean) / self.std))
        return out


class ImageNetTrunk(Peer):
    """Put before a method among a class's bases: the method on this trunk."""

    slower = 0.1  # the trunk's learning rate over that of the layers after it [ours]

    def trunk(self, outputs: int) -> nn.Module:
        """SqueezeNet's convolutions and a layer of `outputs`."""
        return SqueezeNet(outputs)

    def begin(self) -> None:
        """Reads ImageNet's weights. ViewnetError where their file is missing."""
        for module in self.modules():
            if isinstance(module, SqueezeNet):
                otherwise = "take the variant without _imagenet, which needs no weights"
                torchvision_weights.load(module.convolutions, NETWORK, None, otherwise)

    def parameter_groups(self, learning_rate: float) -> list[dict[str, object]]:
        """The trunk's weights at a lower rate than all others."""
        groups: dict[bool, list[nn.Parameter]] = {False: [], True: []}
        for name, parameter in self.named_parameters():
            groups[".convolutions." in name].append(parameter)
        rates = {False: learning_rate, True: self.slower * learning_rate}
        return [{"params": groups[pretrained], "lr": rate} for pretrained, rate in rates.items()]
