"""ViewNet: appearance from one image, viewpoints from another, and the second one drawn again (figure 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import ModelConfig
from viewnet.geometry import look_at
from viewnet.model import volume
from viewnet.model.networks import Encoder, Generator, HoloGANDecoder, gaussian_prior
from viewnet.runtime import distributed


@dataclass
class Hypotheses:
    """What the viewpoint network says of N images: M viewpoints and how likely each is the best."""

    vectors: Tensor  # (N, M, 3), unit length
    logits: Tensor  # (N, M)
    ups: Tensor | None = None  # (N, M, 3), only with in-plane rotation

    @property
    def frames(self) -> Tensor:
        """Camera frames (N, M, 3, 3)."""
        return look_at(self.vectors, self.ups)

    def part(self, rows: slice) -> Hypotheses:
        """Those of some of the images."""
        return Hypotheses(self.vectors[rows], self.logits[rows], None if self.ups is None else self.ups[rows])

    def pick(self, index: Tensor) -> Tensor:
        """View vectors (N, 3) of the heads `index` (N,)."""
        return self.vectors.gather(1, index[:, None, None].expand(-1, 1, 3))[:, 0]


class ViewpointNetwork(nn.Module):
    """f^v: images (N, 3, S, S) -> Hypotheses. One trunk; its last layer gives logits and vectors (section 3.1).

    `shares` (12, bands) is kept by training: how often the viewpoints drawn from lay in each part of the sphere.
    """

    shares: Tensor

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.heads, self.in_plane, self.limits = config.heads, config.in_plane, config.elevation_limits
        outputs = (7 if config.in_plane else 4) * config.heads
        self.encoder = Encoder(config.encoder_channels, outputs, config.input_size, config.encoder_padding)
        azimuth = torch.arange(config.heads) * (2 * math.pi / config.heads)
        offset = config.head_spread * torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros_like(azimuth)], dim=1)
        self.register_buffer("offset", offset, persistent=False)
        bands = config.balance_bands
        self.register_buffer("shares", torch.full((12, bands), 1 / (12 * bands)))

    def forward(self, images: Tensor) -> Hypotheses:
        """The hypotheses for images (N, 3, S, S), as `see` gives them."""
        out = self.encoder(images).float()
        logits, rest = out[:, : self.heads], out[:, self.heads :].unflatten(1, (-1, self.heads, 3))
        vectors = self._on_sphere(rest[:, 0] + self.offset)
        # A learned up starts near the world's: the network only has to say how far it is tilted.
        ups = F.normalize(rest[:, 1] + rest.new_tensor([0.0, 0.0, 1.0]), dim=-1) if self.in_plane else None
        return Hypotheses(vectors, logits, ups)

    def _on_sphere(self, raw: Tensor) -> Tensor:
        """Unit vectors of raw ones (..., 3), their elevation squashed into the limits where there are any."""
        if self.limits is None:
            return F.normalize(raw, dim=-1)
        low, high = (math.radians(x) for x in self.limits)
        elevation = (low + high) / 2 + (high - low) / 2 * torch.tanh(raw[..., 2:])
        return torch.cat([elevation.cos() * F.normalize(raw[..., :2], dim=-1), elevation.sin()], dim=-1)


class ViewNet(nn.Module):
    """f^v, f^a and f^d of the paper.

    `draw` gives images (N, 4, S, S): RGB times mask, and mask. The HoloGAN ablation has no mask, so its fourth
    channel is 1 everywhere.
    """

    prior: Tensor

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.config = config
        self.viewpoint = ViewpointNetwork(config)
        self.appearance = Encoder(
            config.encoder_channels, config.appearance_size, config.input_size, config.encoder_padding
        )
        self.decoder = HoloGANDecoder(config) if config.decoder == "hologan" else Generator(config)
        self.focal = nn.Parameter(torch.tensor(config.focal), requires_grad=config.learn_focal)
        prior = gaussian_prior(config.volume_size) if config.shape_prior else torch.empty(0)
        self.register_buffer("prior", prior, persistent=False)

    def see(self, images: Tensor, behind: Tensor | None = None) -> Tensor:
        """Images (N, 4, S, S), RGB times alpha and alpha, as the encoders take them: (N, 3, S, S).

        On the backdrop, or with the scenes `behind` (N, 3, S, S) behind them.
        """
        return images[:, :3] + (self.config.backdrop if behind is None else behind) * (1 - images[:, 3:])

    def imagine(self, images: Tensor, own: float = 1.0, behind: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Appearance codes (N, A) and volumes, as `shape` gives them, of the objects in images (N, 4, S, S).

        With `own` below 1 codes are drawn towards the mean of all, which they are at 0: one shape in many colours.
        `behind` as in `see`.
        """
        code = self.appearance(self.see(images, behind))
        if own < 1:
            code = torch.lerp(distributed.mean(code.mean(0, keepdim=True)), code, own)
        colour = None
        if self.config.colour_prior:
            colour = images[:, :3].sum((2, 3)) / images[:, 3].sum((1, 2))[:, None].clamp(min=1)
        return code, self.shape(code, colour)

    def shape(self, appearance: Tensor, colour: Tensor | None = None) -> Tensor:
        """Volumes (N, 4, n, n, n): colour and occupancy in [0, 1] (or the HoloGAN decoder's features).

        With `colour` (N, 3), an object's mean colour, the generator only has to say how its parts differ from that.

        Q = S + Q' as printed, where Q' = 2 sigmoid - 1 lies in [-1, 1] and the sum is kept in [0, 1]. Without the prior
        S is 0, and nothing else changes.
        """
        if isinstance(self.decoder, HoloGANDecoder):
            return self.decoder.features(appearance)
        # Both orders of squashing and sampling are in use; squashing first keeps the volume itself an image's worth.
        blocks = self.decoder.blocks(appearance)
        logit = None if colour is None else colour.clamp(0.03, 0.97).logit()
        return volume.squash(blocks, logit, self.prior if self.config.shape_prior else None)

    def draw(self, shape: Tensor, appearance: Tensor, frames: Tensor, size: int | None = None) -> Tensor:
        """Images (N, 4, size, size) of `shape` (B, ...) from camera frames (N, 3, 3), N a multiple of B."""
        size = self.config.render_size if size is None else size
        if isinstance(self.decoder, HoloGANDecoder):
            image = self.decoder.draw(shape, appearance, frames).float()
            return torch.cat([image, torch.ones_like(image[:, :1])], dim=1)
        return volume.render(shape, frames, self.focal, size, sparse=True)
