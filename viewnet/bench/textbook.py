"""ViewNet's training step as one would write it from the paper: the reference contestant of `viewnet bench`.

Plain PyTorch in float32 and the default memory layout, nothing compiled by hand: every head's volume is resampled whole
and rendered with gradients. It computes what the package computes (tests/bench/test_textbook.py compares the two) with
the same names of weights.
"""

from itertools import pairwise
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import ModelConfig, TrainConfig
from viewnet.geometry import look_at
from viewnet.model.losses import PerceptualLoss, pixel_loss


def rotate(volume: Tensor, world_from_camera: Tensor, focal: Tensor, size: int, steps: int) -> Tensor:
    """Volumes (N, 4, Z, Y, X) resampled along the rays of cameras (N, 3, 3): (N, 4, steps, size, size), nearest first.

    Rotation and perspective of section 3.3 in one spatial transformer, since resampling twice would blur.
    """
    # Image rows go down and slices away from the camera.
    theta = world_from_camera.new_tensor([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0]])
    count = len(world_from_camera)
    grid = F.affine_grid(theta.expand(count, -1, -1), [count, 4, steps, size, size], align_corners=False)
    depth = grid[..., 2:]  # (N, steps, size, size, 1)
    grid = torch.cat([grid[..., :2] * (1 - focal * depth), depth], -1)
    grid = (grid.flatten(1, 3) @ world_from_camera.transpose(1, 2)).view_as(grid)  # (N, steps, size, size, 3)
    return F.grid_sample(volume, grid, align_corners=False)


def render(volume: Tensor, world_from_camera: Tensor, focal: Tensor, size: int, steps: int) -> Tensor:
    """Images (N, 4, size, size), RGB times mask and mask, of volumes (B, 4, Z, Y, X), each from N / B viewpoints."""
    volume = volume.repeat_interleave(len(world_from_camera) // len(volume), dim=0)  # (N, 4, Z, Y, X)
    rotated = rotate(volume, world_from_camera, focal, size, steps)
    light = torch.ones_like(rotated[:, :1, 0])
    colour, mask = torch.zeros_like(rotated[:, :3, 0]), torch.zeros_like(light)
    for layer in rotated.unbind(2):
        stopping = layer[:, 3:] * light  # equation 3
        colour = colour + layer[:, :3] * stopping  # equation 4
        mask = mask + stopping
        light = light * (1 - layer[:, 3:])
    return torch.cat([colour, mask], 1)


def encoder(config: ModelConfig, outputs: int) -> nn.Sequential:
    """The supplement's encoder: images (N, 3, S, S) -> (N, outputs)."""
    layers: list[nn.Module] = []
    before, side = 3, config.input_size
    while side > 1:
        width = config.encoder_channels[len(layers) // 3]
        shape: dict[str, Any] = {"kernel_size": 3, "stride": 2, "padding": 1} if side > 2 else {"kernel_size": 2}
        convolution = nn.Conv2d(before, width, padding_mode="replicate", bias=False, **shape)
        layers += [convolution, nn.BatchNorm2d(width), nn.ReLU()]
        before, side = width, side // 2
    return nn.Sequential(*layers, nn.Conv2d(before, outputs, 1), nn.Flatten())


class AdaIN(nn.Module):
    """Instance normalisation, scaled and shifted by the appearance."""

    def __init__(self, channels: int, appearance: int) -> None:
        super().__init__()
        self.affine = nn.Linear(appearance, 2 * channels)

    def forward(self, x: Tensor, appearance: Tensor) -> Tensor:
        scale, shift = self.affine(appearance)[:, :, None, None, None].chunk(2, dim=1)  # (N, C, 1, 1, 1) each
        return F.instance_norm(x) * scale + shift


class Stage(nn.Module):
    """A row of the supplement's generator table."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, padding: int, appearance: int) -> None:
        super().__init__()
        self.convolution = nn.ConvTranspose3d(inputs, outputs, kernel, stride, padding, bias=False)
        self.norm = AdaIN(outputs, appearance)

    def forward(self, x: Tensor, appearance: Tensor) -> Tensor:
        return F.relu(self.norm(self.convolution(x), appearance))


class Generator(nn.Module):
    """Appearance (N, A) -> logits of the volume (N, 4, n, n, n)."""

    code: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        code, width = config.code_size, config.appearance_size
        self.register_buffer("code", torch.randn(1, code, 1, 1, 1))
        channels = config.generator_channels[: config.volume_size.bit_length() - 3]
        stages = [Stage(code, channels[0], 4, 1, 0, width)]
        for before, after in pairwise(channels):
            stages.append(Stage(before, after, 4, 2, 1, width))
            if config.generator_refine:
                stages.append(Stage(after, after, 3, 1, 1, width))
        self.stages = nn.ModuleList(stages)
        kernel = config.generator_last_kernel
        self.last = nn.ConvTranspose3d(channels[-1], 4, kernel, 2, (kernel - 2) // 2)

    def forward(self, appearance: Tensor) -> Tensor:
        x = self.code.expand(len(appearance), -1, -1, -1, -1)
        for stage in self.stages:
            x = stage(x, appearance)
        return cast(Tensor, self.last(x))


class TextbookViewNet(nn.Module):
    """The three networks of a configuration of the recipe `paper`; `load` takes the package's weights."""

    prior: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.viewpoint = nn.ModuleDict({"encoder": encoder(config, 4 * config.heads)})
        self.appearance = encoder(config, config.appearance_size)
        self.decoder = Generator(config)
        self.focal = nn.Parameter(torch.tensor(0.4))  # learned
        axis = (torch.arange(config.volume_size) * 2 + 1) / config.volume_size - 1
        squares = axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2
        self.register_buffer("prior", torch.exp(-squares / 0.05), persistent=False)  # S of section 3.3

    def load(self, state: dict[str, Tensor]) -> None:
        """The weights of a viewnet.model.viewnet.ViewNet of the same configuration."""
        first, code = "decoder.stages.0.convolution", state["decoder.code"].view(-1, 1, 1, 1, 1)
        # The package learns W z of the first layer alone; any weights W that give it will do.
        state = state | {f"{first}.weight": state[f"{first}.output"] * code / code.square().sum()}
        self.load_state_dict({name: state[name] for name in self.state_dict()})

    def generate(self, images: Tensor) -> Tensor:
        """Volumes (N, 4, n, n, n) of the objects in images (N, 3, S, S)."""
        values = torch.sigmoid(self.decoder(self.appearance(images)))
        occupancy: Tensor = _Clamp.apply(2 * values[:, 3:] - 1 + self.prior)
        return torch.cat([values[:, :3], occupancy], 1)

    def viewpoints(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """View vectors (N, M, 3) and selection logits (N, M)."""
        out = self.viewpoint["encoder"](images)  # (N, 4 M)
        heads = self.config.heads
        return F.normalize(out[:, heads:].unflatten(1, (-1, 3)), dim=-1), out[:, :heads]


class _Clamp(torch.autograd.Function):
    """To [0, 1]; values outside still take the gradient that pulls them back in, as in the package."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return x.clamp(0, 1)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (x,) = ctx.saved_tensors
        return grad * ~((x < 0) & (grad > 0) | (x > 1) & (grad < 0))


def step_loss(
    model: TextbookViewNet, batch: tuple[Tensor, ...], config: TrainConfig, perceptual: PerceptualLoss | None = None
) -> Tensor:
    """The loss of appearance views, targets and the viewpoint network's inputs, (N, 4, S, S) each, on black."""
    appearance, target, inputs = batch
    size, heads = model.config.render_size, model.config.heads
    volume = model.generate(appearance[:, :3])
    vectors, logits = model.viewpoints(inputs[:, :3])
    resized = target if target.shape[-1] == size else F.interpolate(target, (size, size), mode="area")
    cameras = look_at(vectors).flatten(0, 1)  # (N M, 3, 3)
    rendered = render(volume, cameras, model.focal, size, size).unflatten(0, (-1, heads))  # (N, M, 4, size, size)
    errors = (rendered[:, :, :3] - resized[:, None, :3]).square().mean((2, 3, 4))  # equation 2
    best = errors.argmin(1)
    image = rendered[torch.arange(len(best), device=best.device), best][:, :3]
    loss = F.cross_entropy(logits, best)
    if config.pixel_weight:
        covered = target[:, 3].mean().clamp(min=0.01)
        loss = loss + config.pixel_weight * pixel_loss(image, resized[:, :3]) / covered
    if perceptual is not None:
        total = sum(weight for _, weight in perceptual.taps)
        features = perceptual.features(torch.cat([image, resized[:, :3]]))
        for feature, (_, weight) in zip(features, perceptual.taps, strict=True):
            ours, true = feature.chunk(2)
            loss = loss + weight / total * 0.5 * (F.mse_loss(ours, true) + F.l1_loss(ours, true))
    return loss
