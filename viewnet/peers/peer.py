"""What a method of another paper is to training, prediction and tables: a network with a loss of its own."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.func import functional_call

from viewnet.config import ModelConfig
from viewnet.model.networks import Encoder
from viewnet.model.viewnet import Hypotheses
from viewnet.runtime.images import composite
from viewnet.runtime.random import RandomSource, rand


@dataclass(frozen=True)
class Batch:
    """Views of B objects: one of each, and K further ones of each, N = B K, object by object.

    Images are RGB times mask, and mask, in [0, 1]. What a method does not say that it needs is not there.
    """

    first: Tensor  # (B, 4, S, S)
    images: Tensor  # (N, 4, S, S)
    world_from_camera: Tensor | None = None  # (N, 3, 3), true camera frames (viewnet.geometry.look_at)
    boxes: Tensor | None = None  # (N, 3), sides along x, y and z of the box around the object, centred at the origin

    def mirrored(self, generator: RandomSource) -> "Batch":
        """The same with half of the objects, drawn at random, left and right exchanged: images, objects and cameras."""
        drawn = rand(len(self.first), generator=generator) < 0.5  # (B,)
        chosen = drawn.repeat_interleave(len(self.images) // len(drawn)).to(self.images.device)  # (N,)
        frames = self.world_from_camera
        if frames is not None:  # the object's y and the camera's right change their signs
            signs = frames.new_tensor([[-1, 1, 1], [1, -1, -1], [-1, 1, 1]])
            frames = torch.where(chosen[:, None, None], frames * signs, frames)
        first, images = (
            torch.where(which[:, None, None, None], views.flip(-1), views)
            for which, views in ((drawn.to(chosen), self.first), (chosen, self.images))
        )
        return Batch(first, images, frames, self.boxes)


class Peer(nn.Module):
    """A method of another paper. A subclass says how it learns; everything else is as for ViewNet.

    supervision  what is known in training, in the words of the tables' column
    needs        of that, what a batch must have beyond images and masks: "viewpoints" and "boxes"
    absolute     whether it predicts viewpoints in the annotated frame, so that no alignment is fitted
    judged       the terms of its loss that rank weights on validation views
    """

    supervision: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    absolute: ClassVar[bool] = False
    judged: ClassVar[tuple[str, ...]]
    focal: Tensor

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.config = config
        self.register_buffer("focal", torch.tensor(float("nan")), persistent=False)  # the renderer's, nothing learned

    def trunk(self, outputs: int) -> nn.Module:
        """An untrained network from images (N, 3, S, S) to features (N, outputs): ViewNet's encoder."""
        return Encoder(self.config.encoder_channels, outputs, self.config.input_size)

    def begin(self) -> None:
        """What comes once before training, such as pretrained weights: nothing, unless a method says otherwise."""

    def composite(self, images: Tensor, background: Tensor | None = None) -> Tensor:
        """Images (N, 4, S, S) over backgrounds (N, 3, S, S) or the backdrop: (N, 3, S, S), for `viewpoint`."""
        return composite(images, self.config.backdrop if background is None else background)

    def viewpoint(self, images: Tensor) -> Hypotheses:
        """The hypotheses for images (N, 3, S, S), as `composite` gives them; the one with the largest logit counts."""
        raise NotImplementedError

    def losses(self, batch: Batch, progress: float, generator: RandomSource) -> dict[str, Tensor]:
        """Name -> weighted term of the loss, a scalar; their sum is minimised by one step of Adam.

        `progress` is the share of training that is done. All random numbers come from `generator`, so that a training
        that was interrupted ends as one that was not.
        """
        raise NotImplementedError

    def parameter_groups(self, learning_rate: float) -> list[dict[str, object]]:
        """The optimiser's groups: all weights at one learning rate, unless a method says otherwise."""
        return [{"params": list(self.parameters()), "lr": learning_rate}]


def frozen(network: nn.Module, *inputs: Tensor) -> Tensor:
    """The network's output, with gradients for its inputs alone."""
    return functional_call(network, {name: weight.detach() for name, weight in network.named_parameters()}, inputs)
