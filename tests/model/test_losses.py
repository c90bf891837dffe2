"""Losses: pixels, masks, features, the cycle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from helpers.cad_files import real_data
from PIL import Image

from viewnet.config import CycleConfig
from viewnet.errors import ViewnetError
from viewnet.model.losses import (
    SPREADS,
    PerceptualLoss,
    cycle_loss,
    head_errors,
    pixel_loss,
    pull_loss,
    selection_loss,
    selection_target,
)
from viewnet.model.viewnet import Hypotheses


def test_pixel_loss_by_hand():
    found, wanted = torch.zeros(1, 1, 2, 2), torch.tensor([[[[1.0, 0.0], [0.0, 0.0]]]])
    fine, coarse = 1 / 4 + 0.5 * 1 / 4, 1 / 4 + 0.5 * 1 / 16
    assert pixel_loss(found, wanted).item() == pytest.approx((fine + coarse) / 2)


def test_head_errors_are_means_over_a_image():
    drawn, target = torch.rand(2, 3, 3, 4, 4), torch.rand(2, 3, 4, 4)
    found = head_errors(drawn, target)
    assert found.shape == (2, 3)
    assert found[1, 2].item() == pytest.approx((drawn[1, 2] - target[1]).square().mean().item())


def test_the_cycle_pulls_the_selected_head_or_the_closest():
    truth = torch.tensor([[1.0, 0.0, 0.0]])
    vectors = F.normalize(torch.tensor([[[1.0, 0.2, 0.0], [0.0, 1.0, 0.0]]]), dim=-1)
    logits = torch.tensor([[0.0, 3.0]])  # the second is selected, the first is right
    for head, place in (("selected", 1), ("closest", 0)):
        v, s = vectors.clone().requires_grad_(), logits.clone().requires_grad_()
        loss = cycle_loss(Hypotheses(v, s), truth, CycleConfig(head=head))
        loss.backward()
        assert (v.grad.abs().sum(-1) > 0).flatten().tolist() == [place == 0, place == 1]
        assert s.grad[0, 0] < 0 < s.grad[0, 1]  # either way the right head's logit is to rise
        expected = F.mse_loss(vectors[0, place], truth[0]) + F.cross_entropy(logits, torch.tensor([0]))
        assert loss.item() == pytest.approx(expected.item())


@pytest.fixture(scope="module")
def squeezenet():
    return PerceptualLoss("squeezenet", real_data() / "weights" / "squeezenet1_1_features.pth")


def test_the_perceptual_loss_is_zero_for_equal_images_and_falls_on_the_way_there(squeezenet):
    one, two = torch.rand(2, 1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    assert squeezenet(one, one) == 0
    distances = [squeezenet(torch.lerp(one, two, t), two).item() for t in np.linspace(0, 1, 5)]
    assert distances == sorted(distances, reverse=True)


def test_the_perceptual_loss_passes_gradients_to_the_image_only(squeezenet):
    image, target = torch.rand(1, 3, 32, 32, requires_grad=True), torch.rand(1, 3, 32, 32, requires_grad=True)
    squeezenet(image, target).backward()
    assert image.grad.any()
    assert target.grad is None
    assert not any(p.requires_grad for p in squeezenet.parameters())


def test_the_perceptual_loss_and_its_gradient_are_those_of_a_plain_one(squeezenet):
    generator = torch.Generator().manual_seed(0)
    target = F.interpolate(torch.rand(8, 3, 8, 8, generator=generator), scale_factor=4, mode="bilinear")
    image = (target + 0.1 * torch.randn(target.shape, generator=generator)).clamp(0, 1).requires_grad_()
    weights = (10, 1, 1, 1)
    found = squeezenet(image, target)
    plain = sum(
        weight / sum(weights) * (F.mse_loss(one, other) + F.l1_loss(one, other)) / 2
        for weight, one, other in zip(
            weights, plain_taps(squeezenet, image), plain_taps(squeezenet, target), strict=True
        )
    )
    assert found.item() == pytest.approx(plain.item(), rel=1e-5)
    gradient, expected = (torch.autograd.grad(3 * loss, image)[0] for loss in (found, plain))
    assert (gradient - expected).norm() < 1e-3 * expected.norm()


def plain_taps(loss, image):
    """What SqueezeNet 1.1 makes of images, layer by layer, contiguous and in PyTorch's own functions."""
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    state = {name: value.contiguous() for name, value in loss.layers.state_dict().items()}

    def convolution(x, name, **settings):
        return F.relu(F.conv2d(x, state[f"{name}.weight"], state[f"{name}.bias"], **settings))

    def fire(x, name):
        x = convolution(x, f"{name}.squeeze")
        return torch.cat([convolution(x, f"{name}.expand1x1"), convolution(x, f"{name}.expand3x3", padding=1)], 1)

    pixels = (image - mean.view(3, 1, 1)) / std.view(3, 1, 1)
    first = convolution(pixels, "0", stride=2)
    second = fire(fire(F.max_pool2d(first, 3, 2, ceil_mode=True), "3"), "4")
    third = fire(fire(F.max_pool2d(second, 3, 2, ceil_mode=True), "6"), "7")
    return [pixels, first / 36, second / 63, third / 63]


def test_features_are_torchvision_s(squeezenet):
    import torchvision

    network = torchvision.models.squeezenet1_1(weights=None)
    state = torch.load(real_data() / "weights" / "squeezenet1_1_features.pth", weights_only=True)
    network.load_state_dict({f"features.{k.removeprefix('features.')}": v for k, v in state.items()}, strict=False)
    image = torch.rand(1, 3, 48, 48)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    x = (image - mean.view(1, 3, 1, 1)) / std.view(1, 3, 1, 1)
    found = squeezenet.features(image)
    assert len(found) == 4
    assert torch.allclose(found[0], x, atol=1e-6)
    for layers, tap in ((2, found[1]), (5, found[2]), (8, found[3])):
        assert torch.allclose(network.eval().features[:layers](x), tap, atol=1e-3)


def test_taps_weigh_as_much_as_pixels_of_photographs(squeezenet):
    files = sorted((real_data() / "backgrounds").rglob("*.jpg"))[:64]
    images = [np.asarray(Image.open(file).convert("RGB").resize((64, 64))) for file in files]
    taps = squeezenet.features(torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2) / 255)  # (N, C, H, W) each
    divisors = [1.0, *SPREADS["squeezenet"].values()]  # pixels first, which are compared as they are
    spreads = [
        (tap - tap.mean((0, 2, 3), keepdim=True)).square().mean().sqrt().item() / divisor
        for tap, divisor in zip(taps, divisors, strict=True)
    ]
    assert len(spreads) == 4 and 0.8 < min(spreads) < max(spreads) < 1.25


@pytest.mark.parametrize("network", ["vgg16", "squeezenet"])
def test_missing_weights_say_where_they_belong(network, tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(ViewnetError) as error:
        PerceptualLoss(network)
    message = str(error.value)
    assert str(tmp_path / "hub" / "checkpoints") in message
    assert "https://download.pytorch.org/models/" in message
    assert f"VIEWNET_{network.upper()}_WEIGHTS" in message
    assert "perceptual=none" in message


def test_files_without_weights_are_refused(tmp_path: Path):
    for name, content in (("text.pth", b"no weights"), ("empty.pth", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ViewnetError, match=f"{name} does not hold squeezenet weights"):
            PerceptualLoss("squeezenet", tmp_path / name)
    torch.save({"features.0.weight": torch.zeros(3)}, tmp_path / "other.pth")
    with pytest.raises(ViewnetError, match="does not hold squeezenet weights"):
        PerceptualLoss("squeezenet", tmp_path / "other.pth")


def test_the_selection_is_taught_the_best_head_or_how_well_each_explains_the_image():
    errors = torch.tensor([[0.2, 0.1, 0.4], [0.01, 0.04, 0.02]])
    assert selection_target(errors, 0.0).tolist() == [[0, 1, 0], [1, 0, 0]]
    shares = selection_target(errors, 0.5)
    assert torch.allclose(shares[:, 0] / shares[:, 1], torch.tensor([-2.0, 6.0]).exp())  # (0.1 - 0.2) / (0.5 * 0.1)
    assert torch.allclose(selection_target(10 * errors, 0.5), shares, atol=1e-6)  # whatever the errors' size
    assert torch.equal(selection_target(torch.zeros(1, 3), 0.5), torch.full((1, 3), 1 / 3))


def test_the_selection_loss_is_least_where_the_best_head_is_selected():
    errors = torch.tensor([[0.2, 0.1, 0.4]])
    found = [selection_loss(10 * torch.eye(3)[head, None], errors).item() for head in range(3)]
    assert found[1] == pytest.approx(0, abs=1e-3)
    assert found[0] == found[2] == pytest.approx(10, abs=1e-3)


def test_pulling_is_by_the_squared_distance():
    found, better = torch.eye(3)[:2], torch.eye(3)[1:]
    assert pull_loss(found, better).item() == 2
    assert pull_loss(better, better).item() == 0
