"""A trained network as what draws objects: from any viewpoint, in any size, as images for people."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.model import volume
from viewnet.model.losses import composite
from viewnet.model.viewnet import ViewNet

SILHOUETTE = 0.35
"""The grey of silhouettes."""


@dataclass(frozen=True)
class Imagined:
    """What appearance images became: codes (B, A) and volumes (B, 4, n, n, n), as ViewNet.imagine gives them."""

    code: Tensor
    shape: Tensor


class Painter:
    """What whoever has a trained network can draw. It has a `network` and its `config`, and says its `rotation`."""

    network: ViewNet
    config: RunConfig

    @property
    def rotation(self) -> Tensor:
        """(3, 3), from the network's own frame to the one in which viewpoints are told."""
        raise NotImplementedError

    @property
    def hologan(self) -> bool:
        """Whether the decoder paints whole images: it has neither a mask nor a volume of colours."""
        return self.network.config.decoder == "hologan"

    @property
    def device(self) -> torch.device:
        """Where the network is."""
        return self.network.focal.device

    @torch.no_grad()
    def draw(self, imagined: Imagined, frames: Tensor, size: int | None = None) -> Tensor:
        """Images (N, 4, S, S), RGB times mask and mask, from camera frames (N, 3, 3) in the network's own frame.

        N is a multiple of B, as in ViewNet.draw. A `size` above the configuration's shows volumes larger, with as many
        steps along a ray as they were learned with; the HoloGAN decoder has one size only.
        """
        frames, learned = frames.float().to(self.device), self.network.config.render_size
        if self.hologan or size is None or size == learned:
            return self.network.draw(imagined.shape, imagined.code, frames)
        return volume.render(imagined.shape, frames, self.network.focal, size, steps=learned)

    def painted(self, drawn: Tensor) -> np.ndarray:
        """`shown` before white; silhouettes where masks are all that was learned, since colours are then arbitrary."""
        if self.config.train.target == "mask":
            drawn = torch.cat([SILHOUETTE * drawn[:, 3:].expand(-1, 3, -1, -1), drawn[:, 3:]], 1)
        return shown(drawn)

    def own(self, frames: Tensor) -> Tensor:
        """Camera frames (..., 3, 3) of the frame in which viewpoints are told as seen in the network's own."""
        return self.rotation.T @ frames.float()


def shown(images: Tensor, grey: float = 1.0) -> np.ndarray:
    """Images (N, 4, H, W), RGB times mask and mask, before a grey wall: (N, H, W, 3) uint8."""
    wall = torch.full((len(images), 3), grey, device=images.device)
    colours = composite(images, wall).clamp(0, 1) * 255
    array: np.ndarray = colours.round().to(torch.uint8).movedim(1, -1).cpu().numpy()
    return array
