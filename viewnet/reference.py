"""ViewNet on one page: the paper in plain PyTorch, from the networks to the training loop. Read this first.

    python -m viewnet.reference car [--cycle]    a small model, within three minutes on one core

With so few images the loss falls, and little is learned of viewpoints: 10 to 20 % of them come within 30 degrees. The
paper's recipe takes a million (--profile tiny --epochs 290).

Brackets name the paper's sections; where it is silent, docs/decisions.md says what was chosen. All is float32 and
nothing is made fast: the package computes the same in less time (tests/test_reference.py compares losses and
gradients). The paper compares features of VGG16, whose weights do not come with this project: `--perceptual` where they
are there. Without it pixels are compared, which is ours.
"""

import argparse
import sys
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from viewnet.config import ModelConfig, RunConfig, TrainConfig
from viewnet.data.augment import crop_and_rotate
from viewnet.data.build import view_store
from viewnet.data.pairs import Views, model_views, sample_pairs, step_generator
from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import fit_rotation
from viewnet.evaluation.metrics import accuracy, geodesic_error, median
from viewnet.recipes import make_config
from viewnet.runtime.images import resize, tight_crop
from viewnet.runtime.torchvision_weights import IMAGENET_MEAN, IMAGENET_STD, convolutions

SMOKE = {"models": 100, "learning_rate": 1e-3}  # to learn anything in two minutes; the paper's recipe has 1e-4
LINE = "epoch {epoch:3.0f}: loss {loss:.3f}; validation error {error:5.1f} degrees, accuracy {accuracy:4.1f} %"


def encoder(config: ModelConfig, outputs: int) -> nn.Sequential:
    """f^v and f^a up to their last lines: images (N, 3, S, S) -> (N, outputs) (supplement, "Encoder architecture")."""
    widths = config.encoder_channels[: config.input_size.bit_length() - 1]  # S is a power of two
    layers: list[nn.Module] = []
    for before, width in pairwise((3, *widths[:-1])):  # each halves the image, down to 2 x 2
        convolution = nn.Conv2d(before, width, 3, stride=2, padding=1, padding_mode="replicate", bias=False)
        layers += [convolution, nn.BatchNorm2d(width), nn.ReLU()]
    layers += [nn.Conv2d(widths[-2], widths[-1], 2, bias=False), nn.BatchNorm2d(widths[-1]), nn.ReLU()]  # (N, C, 1, 1)
    # No ReLU at the end, where the table has one: view vectors could not leave one octant.
    return nn.Sequential(*layers, nn.Conv2d(widths[-1], outputs, 1), nn.Flatten())


class Stage(nn.Module):
    """A row of the generator's table: transposed convolution, AdaIN, ReLU (3.2)."""

    def __init__(self, inputs: int, outputs: int, appearance: int, kernel: int, stride: int, padding: int) -> None:
        super().__init__()
        self.convolution = nn.ConvTranspose3d(inputs, outputs, kernel, stride, padding, bias=False)
        self.affine = nn.Linear(appearance, 2 * outputs)
        self.affine.bias.data = torch.tensor([1.0, 0.0]).repeat_interleave(outputs)  # scales, then shifts

    def forward(self, x: Tensor, appearance: Tensor) -> Tensor:
        x = F.instance_norm(self.convolution(x))
        scale, shift = self.affine(appearance)[:, :, None, None, None].chunk(2, dim=1)  # (N, outputs, 1, 1, 1) each
        return F.relu(scale * x + shift)


class Generator(nn.Module):
    """Appearances (N, A) -> logits of colour and occupancy (N, 4, n, n, n) (3.2; "Generator architecture")."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.code = nn.Buffer(torch.randn(1, config.code_size, 1, 1, 1))  # z: drawn once, never trained
        widths = config.generator_channels[: config.volume_size.bit_length() - 3]  # n is a power of two
        stages = [Stage(config.code_size, widths[0], config.appearance_size, kernel=4, stride=1, padding=0)]  # 4 a side
        for before, width in pairwise(widths):  # each doubles the side
            stages.append(Stage(before, width, config.appearance_size, kernel=4, stride=2, padding=1))
            if config.generator_refine:
                stages.append(Stage(width, width, config.appearance_size, kernel=3, stride=1, padding=1))
        self.stages = nn.ModuleList(stages)
        kernel = config.generator_last_kernel
        self.last = nn.ConvTranspose3d(widths[-1], 4, kernel, stride=2, padding=(kernel - 2) // 2)

    def forward(self, appearance: Tensor) -> Tensor:
        x = self.code.expand(len(appearance), -1, -1, -1, -1)  # (N, Z, 1, 1, 1)
        for stage in self.stages:
            x = stage(x, appearance)
        return self.last(x)


class ViewNet(nn.Module):
    """f^v, f^a and f^d (figure 2)."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.f_v = encoder(config, 4 * config.heads)  # for each of M heads a selection logit and a vector (3.1)
        self.f_a = encoder(config, config.appearance_size)
        self.f_d = Generator(config)
        self.focal = nn.Parameter(torch.tensor(0.4))  # of the camera, in (3.3)
        axis = (2 * torch.arange(config.volume_size) + 1) / config.volume_size - 1  # (n,) centres of voxels in [-1, 1]
        squares = axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2  # (n, n, n)
        self.prior = nn.Buffer(torch.exp(-squares / 0.05), persistent=False)  # S (3.3)

    def viewpoints(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Images (N, 3, S, S) -> M hypotheses v on the sphere (N, M, 3), and selection logits (N, M) (3.1)."""
        out = self.f_v(images)  # (N, 4 M)
        logits, vectors = out.split((self.config.heads, 3 * self.config.heads), dim=1)
        return F.normalize(vectors.unflatten(1, (-1, 3)), dim=-1), logits

    def volumes(self, images: Tensor) -> Tensor:
        """Images (N, 3, S, S) -> volumes V (N, 4, n, n, n): colours C, and occupancy Q = S + Q', in [0, 1] (3.3)."""
        values = torch.sigmoid(self.f_d(self.f_a(images)))  # (N, 4, n, n, n)
        residual = 2 * values[:, 3:] - 1  # (N, 1, n, n, n), Q' in [-1, 1]
        return torch.cat([values[:, :3], _Clamp.apply(self.prior + residual)], 1)


class _Clamp(torch.autograd.Function):
    """To [0, 1]. A value outside takes the gradient that leads back inside, or an emptied voxel would stay empty."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return x.clamp(0, 1)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (x,) = ctx.saved_tensors
        return grad * ~((x < 0) & (grad > 0) | (x > 1) & (grad < 0))


def view_vector(azimuth: Tensor, elevation: Tensor) -> Tensor:
    """Degrees (...) -> unit vectors v (..., 3) from the object, whose front is x and whose top is z, to the camera."""
    a, e = torch.deg2rad(torch.stack([azimuth, elevation]))
    return torch.stack([e.cos() * a.cos(), e.cos() * a.sin(), e.sin()], -1)


def look_at(v: Tensor) -> Tensor:
    """Unit vectors v (..., 3) -> rotations R (..., 3, 3) from camera to object coordinates (3.1)."""
    u = v.new_tensor([0.0, 0.0, 1.0]).expand_as(v)  # upwards
    w = F.normalize(torch.linalg.cross(v, u), dim=-1)
    u_ = F.normalize(torch.linalg.cross(w, v), dim=-1)
    return torch.stack([-w, u_, v], -1)  # the paper's [v, w, u'] with x to the right, y up, and z towards the camera


def rotate(volume: Tensor, rotation: Tensor, focal: Tensor, size: int, steps: int) -> Tensor:
    """Volumes (N, 4, n, n, n) as cameras R (N, 3, 3) see them: (N, 4, steps, size, size), nearest slice first (3.3)."""
    # (i) and (ii) by one spatial transformer: to resample twice would blur. Rows go down, slices away from the camera.
    axes = volume.new_tensor([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0]]).expand(len(volume), -1, -1)  # (N, 3, 4)
    points = F.affine_grid(axes, [len(volume), 4, steps, size, size], align_corners=False)  # (N, steps, size, size, 3)
    depth = points[..., 2:]  # (N, steps, size, size, 1), 1 near to -1 far
    points = torch.cat([points[..., :2] * (1 - focal * depth), depth], -1)  # (ii): rays meet at depth 1 / focal
    points = (points.flatten(1, 3) @ rotation.transpose(1, 2)).view_as(points)  # (i): R p
    return F.grid_sample(volume, points, align_corners=False)  # beyond the volume all is empty


def render(volume: Tensor, rotation: Tensor, focal: Tensor, size: int, steps: int) -> Tensor:
    """Images (K N, 4, size, size), colour over black and mask, of volumes (N, 4, n, n, n), K each (3.3)."""
    volume = volume.repeat_interleave(len(rotation) // len(volume), dim=0)  # (K N, 4, n, n, n)
    rotated = rotate(volume, rotation, focal, size, steps)  # (K N, 4, steps, size, size)
    image = torch.zeros_like(rotated[:, :, 0])  # (K N, 4, size, size)
    light = torch.ones_like(image[:, 3:])  # (K N, 1, size, size), the product of equation 3
    for layer in rotated.unbind(2):  # (iii), near to far
        c, q = layer.split((3, 1), dim=1)  # (K N, 3, size, size) and (K N, 1, size, size)
        stopping = q * light  # equation 3, Q'
        image = image + torch.cat([c * stopping, stopping], 1)  # equation 4, and the mask
        light = light * (1 - q)
    return image


def perceptual_loss(vgg16: nn.Module, image: Tensor, target: Tensor) -> Tensor:
    """Images (N, 3, s, s) compared as VGG16 sees them: pixels, then conv1_2, conv2_2 and conv3_3 before ReLU (4.1)."""
    mean, deviation = image.new_tensor([IMAGENET_MEAN, IMAGENET_STD])[:, :, None, None]  # (3, 1, 1) each
    x = (torch.cat([image, target]) - mean) / deviation  # (2 N, 3, s, s)
    compared = [x]
    for number, layer in enumerate(vgg16.children(), start=1):
        x = F.relu(x) if isinstance(layer, nn.ReLU) else layer(x)  # VGG16's own would overwrite what is compared
        if number in (3, 8, 15):
            compared.append(x)
    distances = [(F.mse_loss(*each.chunk(2)) + F.l1_loss(*each.chunk(2))) / 2 for each in compared]
    return (10 * distances[0] + distances[1] + distances[2] + distances[3]) / 13


def pixel_loss(image: Tensor, target: Tensor) -> Tensor:
    """Images (N, 3, s, s) by L1 + MSE / 2 at their resolution and at half of it. Ours, where there is no VGG16."""
    fine = image - target
    coarse = F.avg_pool2d(fine, 2)  # (N, 3, s / 2, s / 2)
    return (fine.abs().mean() + fine.square().mean() / 2 + coarse.abs().mean() + coarse.square().mean() / 2) / 2


def step_loss(
    model: ViewNet, batch: Sequence[Tensor], config: TrainConfig, vgg16: nn.Module | None, generator: torch.Generator
) -> dict[str, Tensor]:
    """The terms of the loss for images I', I, and I as f^v sees it, (N, 4, S, S) each: colour over black, and mask."""
    appearance, target, seen = batch
    if config.augment:
        seen = crop_and_rotate(seen, generator)
    size = model.config.render_size
    target = resize(target, size)  # (N, 4, s, s)
    volume = model.volumes(appearance[:, :3])  # f^a(I')
    vectors, logits = model.viewpoints(seen[:, :3])  # f^v_m(I)
    rendered = render(volume, look_at(vectors).flatten(0, 1), model.focal, size, size)  # (N M, 4, s, s)
    rendered = rendered.unflatten(0, logits.shape)  # (N, M, 4, s, s)
    errors = (rendered[:, :, :3] - target[:, None, :3]).square().mean((2, 3, 4))  # (N, M)
    best = errors.argmin(1)  # m* (equation 2)
    image = rendered[torch.arange(len(best)), best, :3]  # (N, 3, s, s): gradients pass through m* alone
    terms = {"selection": F.cross_entropy(logits, best)}  # (3.1)
    if vgg16 is not None:
        terms["perceptual"] = perceptual_loss(vgg16, image, target[:, :3])  # equation 1
    if config.pixel_weight:
        covered = target[:, 3].mean().clamp(min=0.01)  # thin objects are to count as much as others
        terms["pixels"] = config.pixel_weight * pixel_loss(image, target[:, :3]) / covered  # equation 1, by pixels
    if config.cycle.on:
        terms["cycle"] = cycle_loss(model, volume.detach(), generator)
    return terms


def cycle_loss(model: ViewNet, volume: Tensor, generator: torch.Generator) -> Tensor:
    """f^v is to find the viewpoints v~ that volumes (N, 4, n, n, n) are rendered from; it alone learns (3.4)."""
    azimuth = 360 * torch.rand(len(volume), generator=generator)  # (N,)
    elevation = 108 * torch.rand(len(volume), generator=generator) - 36
    truth = view_vector(azimuth, elevation).to(volume)  # (N, 3), v~
    size = model.config.input_size
    with torch.no_grad():
        novel = tight_crop(render(volume, look_at(truth), model.focal, size, size), size)  # (N, 4, S, S), I~ as seen
    vectors, logits = model.viewpoints(novel[:, :3])
    selected = vectors[torch.arange(len(vectors)), logits.argmax(1)]  # (N, 3), f^v(I~)
    closest = (vectors - truth[:, None]).square().sum(-1).argmin(1)  # (N,)
    return F.mse_loss(selected, truth) + F.cross_entropy(logits, closest)  # L_cycle, and the selection


@torch.no_grad()
def viewpoint_errors(model: ViewNet, views: Views) -> np.ndarray:
    """Angles (N,) in degrees of the selected heads' viewpoints, aligned by one rotation, to the true ones (4.1)."""
    rows = torch.arange(len(views.objects))  # (N,)
    images = views.viewpoint_input(rows, model.config.input_size, model.focal.device)  # (N, 4, S, S)
    model.eval()
    vectors, logits = model.viewpoints(images[:, :3])
    model.train()
    predicted = vectors[rows, logits.argmax(1)].double().cpu().numpy()  # (N, 3)
    truth = view_vector(*views.truth.double().unbind(1)).numpy()  # (N, 3)
    return geodesic_error(predicted @ fit_rotation(predicted, truth).T, truth)


def train(config: RunConfig, vgg16: nn.Module | None) -> list[dict[str, float]]:
    """Adam, until `patience` epochs gain nothing on validation views (4.1). Prints and returns a row an epoch."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    settings = config.train
    views = view_store(config.data)
    training = model_views(views, "train", config.model.input_size, config.model)
    validation = model_views(views, "val", config.model.input_size, config.model)
    torch.manual_seed(config.seed)
    model = ViewNet(config.model).to(device)
    adam = torch.optim.Adam(model.parameters(), settings.optimiser.learning_rate)
    steps = max(1, len(training.objects) // settings.batch_size)  # an epoch has as many targets as there are views
    log: list[dict[str, float]] = []
    for epoch in range(settings.epochs):
        total = 0.0
        for step in range(epoch * steps, (epoch + 1) * steps):
            rows = sample_pairs(training, settings.objects, settings.targets_per_object, config.seed, step)
            batch = training.batch(*rows, config.model.input_size, device)
            terms = step_loss(model, batch, settings, vgg16, step_generator(config.seed, step))
            loss = torch.stack(list(terms.values())).sum()
            adam.zero_grad()
            loss.backward()
            adam.step()
            total += loss.item() / steps
        errors = viewpoint_errors(model, validation)  # (N,)
        log.append({"epoch": epoch + 1, "loss": total, "error": median(errors), "accuracy": accuracy(errors, 30)})
        print(LINE.format(**log[-1]), flush=True)
        best = max(log, key=lambda row: row["accuracy"])
        if epoch + 1 - best["epoch"] >= settings.patience:
            break
    print("best:", LINE.format(**best))
    return log


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line. Returns 0, or 2 after one line about a mistake in the input."""
    parser = argparse.ArgumentParser(prog="python -m viewnet.reference", description="ViewNet on one page, trained.")
    parser.add_argument("category", help="car, chair, aeroplane ...")
    parser.add_argument("--profile", default="smoke", help="smoke (the default), tiny, small")
    parser.add_argument("--cycle", action="store_true", help="with cycle consistency")
    parser.add_argument("--perceptual", action="store_true", help="compare features of VGG16, not pixels")
    parser.add_argument("--epochs", type=int, default=60, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    given = parser.parse_args(arguments)
    changes: dict[str, Any] = {"epochs": given.epochs, "patience": 30, "perceptual": "none"}
    changes |= {"pixel_weight": 0.0 if given.perceptual else 1.0, **(SMOKE if given.profile == "smoke" else {})}
    try:
        variant = "viewnet_cycle" if given.cycle else "viewnet"
        config = make_config(variant, given.category, given.profile, "paper", given.seed, **changes)
        train(config, convolutions("vgg16", otherwise="leave out --perceptual")[:15] if given.perceptual else None)
    except ViewnetError as error:
        print(f"viewnet.reference: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
