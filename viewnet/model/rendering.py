"""Rendering by a trained network for people to look at: from any viewpoint, in any size, as uint8 images."""

import numpy as np
import torch
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.model import volume
from viewnet.model.reconstruction import Encoded
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.images import composite

SILHOUETTE = 0.35
"""The grey of silhouettes."""


class ObjectRenderer:
    """Renders encoded objects. Subclasses have a `network`, its `config`, and the `rotation` to the annotated frame."""

    network: ViewNet
    config: RunConfig

    @property
    def rotation(self) -> Tensor:
        """(3, 3), from the network's own frame to the frame of reported viewpoints."""
        raise NotImplementedError

    @property
    def hologan(self) -> bool:
        """Whether the decoder makes whole images: it has neither a mask nor a volume of colours."""
        return self.network.config.decoder == "hologan"

    @property
    def device(self) -> torch.device:
        """Where the network is."""
        return self.network.focal.device

    @torch.no_grad()
    def render(self, objects: Encoded, world_from_camera: Tensor, size: int | None = None) -> Tensor:
        """Images (N, 4, S, S), RGB times mask and mask, from camera frames (N, 3, 3) in the network's own frame.

        N is a multiple of B, as in ViewNet.render. A `size` above the configuration's shows volumes larger, with as
        many steps along a ray as they were learned with; the HoloGAN decoder has one size only.
        """
        cameras, learned = world_from_camera.float().to(self.device), self.network.config.render_size
        if self.hologan or size is None or size == learned:  # exactly what training rendered
            return self.network.render(objects.volume, objects.code, cameras)
        return volume.render(objects.volume, cameras, self.network.focal, size, steps=learned)  # Q is a step's

    def displayed(self, rendered: Tensor) -> np.ndarray:
        """`to_uint8` over white; silhouettes where only masks were learned, since colours are then arbitrary."""
        if self.config.train.target == "mask":  # over the mask in three channels of grey
            rendered = torch.cat([SILHOUETTE * rendered[:, 3:].expand(-1, 3, -1, -1), rendered[:, 3:]], 1)
        return to_uint8(rendered)

    def in_own_frame(self, world_from_camera: Tensor) -> Tensor:
        """Camera frames (..., 3, 3) in the annotated frame, brought to the network's own."""
        return self.rotation.T @ world_from_camera.float()  # (..., 3, 3); the transpose inverts a rotation


def to_uint8(images: Tensor, grey: float = 1.0) -> np.ndarray:
    """Images (N, 4, H, W), RGB times mask and mask, over a grey level: (N, H, W, 3) uint8."""
    colours = composite(images, grey).clamp(0, 1) * 255  # beyond 255 uint8 would wrap around
    array: np.ndarray = colours.round().to(torch.uint8).movedim(1, -1).cpu().numpy()  # (N, H, W, 3)
    return array
