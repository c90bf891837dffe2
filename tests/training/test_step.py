"""One training step: which terms there are, and what each teaches."""

from __future__ import annotations

import pytest
import torch
from helpers.smoke_model import PLAIN, SMOKE, images, settings

from viewnet.config import ComparisonConfig, TrainConfig
from viewnet.data.pairs import resize
from viewnet.geometry import view_vector
from viewnet.model.reconstruction import Choice, Encoded, Reconstruction, reconstruct
from viewnet.model.viewnet import Hypotheses, ViewNet
from viewnet.recipes import make_config
from viewnet.training.step import repeated_views_loss, selection_target, step_loss


@pytest.fixture
def model():
    torch.manual_seed(0)
    return ViewNet(SMOKE.model)


def test_a_single_head_has_nothing_to_select():
    torch.manual_seed(0)
    config = make_config("single_head", profile="smoke", recipe="matting", **PLAIN)
    batch = (images(4, seed=1), images(4, seed=2), images(4, seed=2))
    terms = step_loss(ViewNet(config.model), batch, config.train, None, 0.5, torch.Generator().manual_seed(0))
    assert set(terms) == {"pixels", "masks"}


def test_a_segmentation_target_ignores_colour(model):
    config = settings(target="mask")
    target = images(4, seed=1)
    recoloured = torch.cat([target[:, :3].flip(1), target[:, 3:]], dim=1)
    one, two = (
        reconstruct(model.eval(), target, resize(wanted, 16), target, config) for wanted in (target, recoloured)
    )
    assert torch.equal(one.choice.errors, two.choice.errors)
    one, two = (
        step_loss(model, (target, wanted, target), config, None, 0.5, torch.Generator().manual_seed(0))
        for wanted in (target, recoloured)
    )
    assert torch.equal(one["pixels"], two["pixels"])


def test_the_cycle_teaches_the_viewpoint_network_only(model):
    config = settings(cycle=True)
    batch = (images(4, seed=1), images(4, seed=2), images(4, seed=2))
    terms = step_loss(model, batch, config, None, 0.5, torch.Generator().manual_seed(0))
    terms["cycle"].backward()
    assert any(p.grad is not None and p.grad.any() for p in model.viewpoint.parameters())
    for part in (model.appearance, model.decoder):
        assert all(p.grad is None for p in part.parameters())
    assert model.focal.grad is None


def test_the_selection_is_taught_the_best_head_or_how_well_each_explains_the_image():
    errors = torch.tensor([[0.2, 0.1, 0.4], [0.01, 0.04, 0.02]])
    assert selection_target(errors, 0.0).tolist() == [[0, 1, 0], [1, 0, 0]]
    shares = selection_target(errors, 0.5)
    assert torch.allclose(shares[:, 0] / shares[:, 1], torch.tensor([-2.0, 6.0]).exp())  # (0.1 - 0.2) / (0.5 * 0.1)
    assert torch.allclose(selection_target(10 * errors, 0.5), shares, atol=1e-6)  # whatever the errors' size
    assert torch.equal(selection_target(torch.zeros(1, 3), 0.5), torch.full((1, 3), 1 / 3))


def test_other_images_of_a_target_learn_what_its_one_reconstruction_taught():
    # Rendered from 10 degrees, where the first image's head 0 is; another image's closest head is number 2.
    first = Hypotheses(view_vector(torch.tensor([[10.0, 130.0, 250.0]]), torch.zeros(1, 3)), torch.zeros(1, 3))
    azimuth = torch.tensor([[200.0, 100.0, 30.0]], requires_grad=True)
    logits = torch.zeros(1, 3, requires_grad=True)
    others = Hypotheses(view_vector(azimuth, torch.zeros(1, 3)), logits)
    choice = Choice(torch.tensor([0]), first.vectors[:, 0], torch.tensor([[0.1, 0.2, 0.3]]))
    objects = Encoded(torch.zeros(()), torch.zeros(()))
    found = Reconstruction(first, others, choice, torch.zeros(()), torch.zeros(()), objects)
    loss = repeated_views_loss(found, TrainConfig(comparison=ComparisonConfig()))
    distance = (view_vector(torch.tensor(10.0), torch.tensor(0.0)) - others.vectors[0, 2]).square().sum()
    assert torch.allclose(loss, distance + torch.tensor(3.0).log())
    loss.backward()
    assert azimuth.grad[0, 2] > 0 and not azimuth.grad[0, :2].any()  # 30 degrees goes down towards 10
    assert logits.grad[0, 2] < 0 < logits.grad[0, 0]
