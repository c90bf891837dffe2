"""The textbook version computes what the package computes."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from viewnet.bench import contestants, textbook
from viewnet.model import volume
from viewnet.model.losses import PerceptualLoss
from viewnet.model.viewnet import ViewNet
from viewnet.training.step import step_loss


@pytest.mark.parametrize("occupancy", ["object", "dense"])
def test_the_textbook_renderer_is_the_definition(occupancy):
    shape = volume.squash(contestants.logits(occupancy, 11, 2), None)
    weights = torch.randn(6, 4, 9, 9, generator=torch.Generator().manual_seed(0))
    images, gradients = [], []
    for draw in (textbook.render, volume.render_reference):
        inputs = (shape, contestants.camera_frames(6), torch.tensor(0.3))
        leaves = [x.detach().double().requires_grad_() for x in inputs]
        images.append(draw(*leaves, 9, 13))
        gradients.append(torch.autograd.grad((images[-1] * weights).sum(), leaves))
    assert torch.allclose(*images, atol=1e-10)
    for result, expected in zip(*gradients, strict=True):
        assert (result - expected).abs().max() < 1e-4 * expected.abs().max()


class Features(PerceptualLoss):
    """Two taps of random layers instead of ImageNet's."""

    def __init__(self):
        torch.nn.Module.__init__(self)
        torch.manual_seed(1)
        self.taps, self.spreads = ((0, 10.0), (2, 1.0)), {2: 0.5}
        self.layers = torch.nn.Sequential(torch.nn.Conv2d(3, 4, 3), torch.nn.Tanh()).requires_grad_(False)
        self.mean, self.std = torch.full((1, 3, 1, 1), 0.5), torch.full((1, 3, 1, 1), 0.2)


def gradients(change, perceptual=None):
    """The loss of one step, and every weight's gradient, by the package and by the textbook version."""
    config = contestants.step_config("smoke")
    torch.manual_seed(6)  # from others a ReLU or a cell's edge may lie between the two, and gradients differ by 1e-2
    net = ViewNet(config.model)
    with torch.no_grad():
        change(net)
    book = textbook.TextbookViewNet(config.model)
    book.load(net.state_dict())
    batch = contestants.images(6, 32)
    settings = dataclasses.replace(config.train, amp="off")
    ours = sum(step_loss(net, batch, settings, perceptual, 0.5, torch.Generator()).values())
    theirs = textbook.step_loss(book, batch, settings, perceptual)
    result = []
    for loss, module in ((ours, net), (theirs, book)):
        loss.backward()
        result.append((loss.item(), {name: weight.grad for name, weight in module.named_parameters()}))
    # The package learns W z of the first layer, z fixed, and the gradient g of that makes W's: z times g.
    mine, first = result[0][1], "decoder.stages.0.convolution"
    mine[f"{first}.weight"] = net.decoder.code.view(-1, 1, 1, 1, 1) * mine.pop(f"{first}.output")
    return result


def same(result, tolerance):
    (ours, mine), (theirs, its) = result
    assert ours == pytest.approx(theirs, rel=tolerance)
    assert mine.keys() == its.keys()
    for name, gradient in mine.items():
        assert gradient.norm() > 0, name
        assert (gradient - its[name]).norm() < tolerance * gradient.norm(), name


def filled(net):
    """No voxel is empty, so none is skipped."""
    net.decoder.last.bias[3] += 1.0


@pytest.mark.parametrize("perceptual", [None, Features()], ids=["pixels", "features"])
def test_the_textbook_step_has_the_package_s_loss_and_gradients(perceptual, monkeypatch):
    def plain(shape, frames, focal, size, steps=None, sparse=False):
        return volume.render_reference(shape, frames, focal, size, steps or size)

    monkeypatch.setattr(volume, "render", plain)
    same(gradients(lambda net: None, perceptual), 1e-4)


def test_the_compiled_step_is_the_textbook_s_where_nothing_is_empty():
    same(gradients(filled), 1e-3)
