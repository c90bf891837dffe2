"""Targets reconstructed from the best of several hypotheses: who is compared, who gets the gradients."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from helpers.smoke_model import SMOKE, images, settings

from viewnet.geometry import look_at
from viewnet.model.losses import pixel_loss
from viewnet.model.reconstruction import reconstruct
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.images import resize


@pytest.fixture
def model():
    torch.manual_seed(0)
    return ViewNet(SMOKE.model)


def test_the_winner_alone_gets_the_reconstruction_s_gradients(model):
    model.viewpoint.encoder[-2].weight.data.mul_(5)  # viewpoints that differ from image to image
    target, appearance = images(6, seed=1), images(6, seed=2)
    found = reconstruct(model, appearance, resize(target, 16), target, SMOKE.train)
    assert torch.equal(found.choice.head, found.choice.errors.argmin(1))
    grad_vectors, grad_logits = torch.autograd.grad(
        pixel_loss(found.rendered, found.target),
        [found.hypotheses.vectors, found.hypotheses.logits],
        allow_unused=True,
        materialize_grads=True,
    )
    won = F.one_hot(found.choice.head, SMOKE.model.heads).bool()
    assert (grad_vectors[won].abs().sum(-1) > 0).all()
    assert (grad_vectors[~won] == 0).all()
    assert (grad_logits == 0).all()  # which the choice teaches, not the image


def test_the_image_is_the_winner_s(model):
    target = images(4, seed=1)
    small = resize(target, SMOKE.model.render_size)
    found = reconstruct(model, target, small, target, SMOKE.train)
    drawn = model.render(
        found.objects.volume, found.objects.code, look_at(found.choice.viewpoint), SMOKE.model.render_size
    )
    assert torch.allclose(found.rendered, drawn, atol=1e-6)


@pytest.mark.parametrize(("reconstructed", "masks"), [("image", 0.0), ("image", 2.0), ("mask", 0.5)])
def test_viewpoints_are_compared_by_colours_and_masks_as_configured(model, reconstructed, masks):
    config = settings(target=reconstructed, mask_weight=masks)
    colours, masks = (config.pixel_weight, masks) if reconstructed == "image" else (0.0, 1.0)  # as in the loss
    target = images(4, seed=1)
    found = reconstruct(model.eval(), target, resize(target, 16), target, config)
    off = (found.rendered - found.target).square().mean(dim=(2, 3))
    expected = colours * off[:, :3].mean(1) + masks * off[:, 3]
    assert torch.allclose(found.choice.errors.amin(1), expected, atol=1e-6)


def test_several_targets_share_an_appearance(model):
    model.eval()  # batch statistics would tie the images together
    target, appearance = images(4, seed=1), images(2, seed=2)
    shared = reconstruct(model, appearance, resize(target, 16), target, SMOKE.train)
    apart = reconstruct(model, appearance.repeat_interleave(2, 0), resize(target, 16), target, SMOKE.train)
    assert torch.allclose(shared.rendered, apart.rendered, atol=1e-5)
    assert torch.allclose(shared.choice.errors, apart.choice.errors, atol=1e-5)
