"""Every loss of training: images by pixels and by features, the choice among heads, viewpoints, the cycle."""

from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import CycleConfig
from viewnet.model.viewnet import Hypotheses
from viewnet.runtime.torchvision_weights import IMAGENET_MEAN, IMAGENET_STD, convolutions

FEATURE_NETWORKS = {
    # Indices of torchvision's `features` whose *input* is compared, and their weights; 0 is the image itself.
    # VGG16: pixels, then conv1_2, conv2_2 and conv3_3 before their ReLU, as in the released code.
    "vgg16": ((0, 10.0), (3, 1.0), (8, 1.0), (15, 1.0)),
    # SqueezeNet 1.1: pixels, then after the first convolution's ReLU, the second and the fourth fire module.
    "squeezenet": ((0, 10.0), (2, 1.0), (5, 1.0), (8, 1.0)),
}
SPREADS = {"squeezenet": {2: 36.0, 5: 63.0, 8: 63.0}}
"""Network -> what its taps are divided by: their standard deviation over photographs of 64 pixels a side, about the
channels' means. Undivided, features of SqueezeNet, which has no normalisation, outweigh pixels and all other losses."""


def pixel_loss(image: Tensor, target: Tensor) -> Tensor:
    """L1 + MSE / 2 of images (N, C, H, W) at their own and half their resolution, averaged."""
    full, half = image - target, F.avg_pool2d(image - target, 2)  # (N, C, H, W) and (N, C, H / 2, W / 2)
    return (full.abs().mean() + 0.5 * full.square().mean() + half.abs().mean() + 0.5 * half.square().mean()) / 2


class PerceptualLoss(nn.Module):
    """Distance of ImageNet features (Johnson et al. 2016): each tap (MSE + L1) / 2, weighted, weights summing to 1.

    `weights` is a file with torchvision's names (default: viewnet.runtime.torchvision_weights.weights_file). Nothing is
    downloaded: ViewnetError says where the file is expected.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, network: str, weights: Path | None = None):
        super().__init__()
        self.taps, self.spreads = FEATURE_NETWORKS[network], SPREADS.get(network, {})
        layers = convolutions(network, weights, "train without (perceptual=none)")
        self.layers = layers[: max(index for index, _ in self.taps)].requires_grad_(False)  # those that a tap needs
        for layer in self.layers.modules():
            if isinstance(layer, nn.ReLU):
                layer.inplace = False  # a tap before a ReLU must survive it
        # On CPUs pooling takes a fifth of the time where a pixel's features lie side by side.
        self.layers.to(memory_format=torch.channels_last)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(1, 3, 1, 1))  # (1, 3, 1, 1)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(1, 3, 1, 1))  # (1, 3, 1, 1)

    def features(self, image: Tensor) -> list[Tensor]:
        """The taps of images (N, 3, H, W) in [0, 1], not yet divided by their SPREADS."""
        x = (image - self.mean) / self.std  # (N, 3, H, W), the range ImageNet networks are trained on
        x = x.contiguous(memory_format=torch.channels_last)
        indices = {index for index, _ in self.taps}
        taps = [x] if 0 in indices else []
        for index, layer in enumerate(self.layers, start=1):
            x = layer(x)
            if index in indices:
                taps.append(x)
        return taps

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        """The distance, a scalar, of images (N, 3, H, W) in [0, 1] from their targets (N, 3, H, W)."""
        with torch.no_grad():  # a target takes no gradient, and its activations no memory
            targets = self.features(target)
        total = image.new_zeros(())
        for tap, wanted, (index, weight) in zip(self.features(image), targets, self.taps, strict=True):
            total = total + weight * _Distance.apply(tap, wanted, self.spreads.get(index, 1.0))
        return total / sum(weight for _, weight in self.taps)  # comparable between networks of other taps


class _Distance(torch.autograd.Function):
    """(MSE + L1) / 2 of features (N, C, H, W) and those wanted, both over `spread`, in a third of autograd's passes."""

    @staticmethod
    def forward(ctx: Any, tap: Tensor, wanted: Tensor, spread: float) -> Tensor:
        difference = tap - wanted
        ctx.save_for_backward(difference)
        ctx.spread = spread
        return 0.5 * (difference.square().mean() / spread**2 + difference.abs().mean() / spread)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        (difference,), spread = ctx.saved_tensors, ctx.spread
        grad = difference.sign().add_(difference, alpha=2 / spread)  # of spread times the sum of both
        return grad.mul_(grads[0] * (0.5 / (spread * difference.numel()))), None, None


def head_errors(images: Tensor, target: Tensor) -> Tensor:
    """Mean squared error (N, M) of images (N, M, C, H, W) against targets (N, C, H, W): the norm of equation 2."""
    return (images - target[:, None]).square().mean(dim=(2, 3, 4))  # (N, M)


def selection_loss(logits: Tensor, errors: Tensor, temperature: float = 0.0) -> Tensor:
    """Cross-entropy of the selection's logits (N, M) to the head m* with the least error (N, M) (section 3.1).

    With a temperature (ours) to shares among heads: those that explain an image nearly as well as the best have nearly
    the same share. Which of them has the lower error is often chance, and nothing to learn.
    """
    return F.cross_entropy(logits, selection_target(errors, temperature))


def selection_target(errors: Tensor, temperature: float) -> Tensor:
    """The share (N, M) of each head by its error (N, M): all for the best, or softmax(-error / (T * least error))."""
    least, best = errors.min(1, keepdim=True)  # (N, 1) each
    if not temperature:
        return torch.zeros_like(errors).scatter_(1, best, 1.0)  # (N, M)
    return (-errors / (temperature * least.clamp(min=1e-9))).softmax(1)  # (N, M)


def pull_loss(vectors: Tensor, viewpoint: Tensor) -> Tensor:
    """Mean squared distance of view vectors (N, 3) from better ones that were tried (N, 3) (ours)."""
    return (viewpoint - vectors).square().sum(-1).mean()


def cycle_loss(hypotheses: Hypotheses, truth: Tensor, config: CycleConfig) -> Tensor:
    """Section 3.4: distance of predicted viewpoints from the viewpoints `truth` (N, 3) that images were rendered from.

    The selected head is pulled (the released code), or the closest one; the selection is taught which was closest.
    """
    closest = hypotheses.closest(truth)  # (N,)
    pulled = closest if config.head == "closest" else hypotheses.logits.argmax(1)  # (N,)
    return F.mse_loss(hypotheses.of_heads(pulled), truth) + F.cross_entropy(hypotheses.logits, closest)
