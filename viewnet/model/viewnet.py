"""ViewNet: appearance from one image, viewpoints from another, and the second image reconstructed (figure 2)."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import ModelConfig
from viewnet.geometry import look_at
from viewnet.model import volume
from viewnet.model.networks import Encoder, Generator, HoloGANDecoder, gaussian_prior
from viewnet.runtime.images import composite

FOCAL = 0.4
"""What a learned focal length starts from, as released."""


@dataclass
class Hypotheses:
    """M predicted viewpoints for each of N images, and logits of which one is the best (section 3.1)."""

    vectors: Tensor  # (N, M, 3), unit view vectors from object to camera
    logits: Tensor  # (N, M)
    ups: Tensor | None = None  # (N, M, 3), only with in-plane rotation

    @property
    def world_from_camera(self) -> Tensor:
        """Camera frames (N, M, 3, 3): columns right, up and back in world coordinates."""
        return look_at(self.vectors, self.ups)

    def rows(self, rows: slice) -> "Hypotheses":
        """Those of some of the images."""
        return Hypotheses(self.vectors[rows], self.logits[rows], None if self.ups is None else self.ups[rows])

    def of_heads(self, index: Tensor) -> Tensor:
        """View vectors (N, 3), each image's of its head `index` (N,)."""
        return self.vectors.gather(1, index[:, None, None].expand(-1, 1, 3))[:, 0]  # (N, 3)

    def closest(self, viewpoint: Tensor) -> Tensor:
        """Each image's head (N,) whose view vector is the closest to its `viewpoint` (N, 3)."""
        return (self.vectors - viewpoint[:, None]).square().sum(-1).argmin(1)  # (N,)


class ViewpointNetwork(nn.Module):
    """f^v: images (N, 3, S, S) -> Hypotheses. One encoder whose last layer gives logits and vectors (section 3.1)."""

    offset: Tensor

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.heads, self.in_plane, self.limits = config.heads, config.in_plane, config.elevation_limits
        outputs = (7 if config.in_plane else 4) * config.heads
        self.encoder = Encoder(config.encoder_channels, outputs, config.input_size)
        azimuth = torch.arange(config.heads) * (2 * math.pi / config.heads)  # (M,), evenly around the object
        # Heads that start in one place would all learn the same viewpoint.
        offset = config.head_spread * torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros_like(azimuth)], dim=1)
        self.register_buffer("offset", offset, persistent=False)  # (M, 3); follows from the settings: not saved

    def forward(self, images: Tensor) -> "Hypotheses":
        """The hypotheses for images (N, 3, S, S), as `ViewNet.composite` gives them."""
        out = self.encoder(images).float()  # (N, 4 M), or (N, 7 M) with ups
        logits, rest = out[:, : self.heads], out[:, self.heads :].unflatten(1, (-1, self.heads, 3))  # (N, 1 or 2, M, 3)
        vectors = self.on_sphere(rest[:, 0] + self.offset)  # (N, M, 3)
        # A learned up starts near the world's: the network only has to predict how far it is tilted.
        ups = F.normalize(rest[:, 1] + rest.new_tensor([0.0, 0.0, 1.0]), dim=-1) if self.in_plane else None
        return Hypotheses(vectors, logits, ups)

    @torch.no_grad()
    def divide_logits(self, temperature: float) -> None:
        """Make the selection less sure, or with a temperature below 1 surer; every choice stays."""
        last = next(layer for layer in reversed(self.encoder) if isinstance(layer, nn.Conv2d))
        last.weight[: self.heads] /= temperature
        assert last.bias is not None
        last.bias[: self.heads] /= temperature

    def on_sphere(self, raw: Tensor) -> Tensor:
        """Unit vectors of raw ones (..., 3), their elevation squashed into the limits where there are any."""
        if self.limits is None:
            return F.normalize(raw, dim=-1)
        low, high = (math.radians(x) for x in self.limits)
        elevation = (low + high) / 2 + (high - low) / 2 * torch.tanh(raw[..., 2:])  # (..., 1)
        return torch.cat([elevation.cos() * F.normalize(raw[..., :2], dim=-1), elevation.sin()], dim=-1)  # (..., 3)


class ViewNet(nn.Module):
    """The paper's f^v (`viewpoint`), f^a (`appearance`) and f^d (`decoder` and the volume renderer).

    Images of objects are (N, 4, S, S): RGB times mask, and mask, in [0, 1].
    """

    prior: Tensor

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.config = config
        self.viewpoint = ViewpointNetwork(config)
        self.appearance = Encoder(config.encoder_channels, config.appearance_size, config.input_size)
        self.decoder = HoloGANDecoder(config) if config.decoder == "hologan" else Generator(config)
        learned = config.focal is None
        self.focal = nn.Parameter(torch.tensor(FOCAL if learned else config.focal), requires_grad=learned)
        prior = gaussian_prior(config.volume_size) if config.shape_prior else torch.empty(0)
        self.register_buffer("prior", prior, persistent=False)

    def composite(self, images: Tensor, background: Tensor | None = None) -> Tensor:
        """Images (N, 4, S, S) over backgrounds (N, 3, S, S) or the backdrop: (N, 3, S, S), as encoders take them."""
        return composite(images, self.config.backdrop if background is None else background)

    def encode(self, images: Tensor, background: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Appearance codes (N, A) and volumes, as `generate` gives them, of the objects in images (N, 4, S, S).

        `background` as in `composite`.
        """
        code = self.appearance(self.composite(images, background))  # (N, A)
        return code, self.generate(code)

    def generate(self, code: Tensor) -> Tensor:
        """Volumes (N, 4, n, n, n) of appearance codes (N, A): colour and occupancy in [0, 1] (section 3.3).

        Q = S + Q' as reported, where Q' = 2 sigmoid - 1 lies in [-1, 1] and the sum is limited to [0, 1]. Without the
        prior S is 0, and nothing else changes. The HoloGAN decoder's volumes are features.
        """
        if isinstance(self.decoder, HoloGANDecoder):
            return self.decoder.features(code)
        # Squashed before it is sampled (both orders are in use), so that the volume itself holds colours.
        blocks = self.decoder.blocks(code)
        return volume.squash(blocks, self.prior if self.config.shape_prior else None)

    def render(self, volumes: Tensor, code: Tensor, world_from_camera: Tensor, size: int | None = None) -> Tensor:
        """Images (N, 4, size, size) of volumes (B, ...) from camera frames (N, 3, 3), N a multiple of B (section 3.3).

        `size` defaults to the size of reconstructions; the HoloGAN decoder has no other.
        """
        if isinstance(self.decoder, HoloGANDecoder):
            return self.decoder.render(volumes, code, world_from_camera)
        return volume.render(volumes, world_from_camera, self.focal, size or self.config.render_size, sparse=True)
