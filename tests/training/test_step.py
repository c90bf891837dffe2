"""One training step: which terms there are, and what each teaches."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from helpers.smoke_model import PLAIN, SMOKE, images, settings

from viewnet.config import ComparisonConfig, SelectionConfig, TrainConfig
from viewnet.data.pairs import resize
from viewnet.geometry import view_vector
from viewnet.model.reconstruction import Choice, Encoded, Reconstruction, reconstruct
from viewnet.model.viewnet import Hypotheses, ViewNet
from viewnet.recipes import make_config
from viewnet.training import step
from viewnet.training.step import pose_search, repeated_views_loss, selection_loss, step_loss


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


def inputs_of_reconstruct(model, monkeypatch, target, **changes):
    """Appearance, target and the viewpoint network's input, in a step that is given `target` for all three."""
    calls = []
    monkeypatch.setattr(step, "reconstruct", lambda *a, **k: calls.append(a) or reconstruct(*a, **k))
    config = settings(**changes)
    step_loss(model, (target, target, target), config, None, 0.5, torch.Generator().manual_seed(0))
    return calls[0][1:4]


def test_a_mirrored_target_is_drawn_as_it_is_seen(model, monkeypatch):
    target = images(32, seed=1)
    appearance, wanted, seen = inputs_of_reconstruct(model, monkeypatch, target, mirror=True, jitter=0.0)
    small = resize(target, SMOKE.model.render_size)
    mirrored = torch.isclose(wanted, small.flip(-1), atol=1e-6).flatten(1).all(1)
    assert 8 < mirrored.sum() < 24
    assert torch.equal(wanted[~mirrored], small[~mirrored])
    assert torch.allclose(resize(seen, SMOKE.model.render_size), wanted) and torch.equal(appearance, target)


def test_only_the_viewpoint_network_sees_other_colours(model, monkeypatch):
    target = images(4, seed=1)
    appearance, wanted, seen = inputs_of_reconstruct(model, monkeypatch, target, mirror=False, jitter=0.5)
    assert torch.equal(appearance, target) and torch.equal(wanted, resize(target, SMOKE.model.render_size))
    assert torch.equal(seen[:, 3], target[:, 3])
    assert not torch.allclose(seen[:, :3], target[:, :3], atol=0.01)


def test_the_cycle_teaches_the_viewpoint_network_only(model):
    config = settings(cycle=True, cycle_weight=1.0, cycle_start=0.0)
    batch = (images(4, seed=1), images(4, seed=2), images(4, seed=2))
    terms = step_loss(model, batch, config, None, 0.5, torch.Generator().manual_seed(0))
    terms["cycle"].backward()
    assert any(p.grad is not None and p.grad.any() for p in model.viewpoint.parameters())
    for part in (model.appearance, model.decoder):
        assert all(p.grad is None for p in part.parameters())
    assert model.focal.grad is None


@pytest.mark.parametrize(("progress", "factor"), [(0.0, None), (0.1, None), (0.15, 0.5), (0.2, 1.0), (0.9, 1.0)])
def test_the_cycle_sets_in_and_is_ramped_up(model, progress, factor):
    config = settings(cycle=True, cycle_weight=2.0, cycle_start=0.1)
    batch = (images(4, seed=1), images(4, seed=2), images(4, seed=2))
    model.eval()
    late = step_loss(model, batch, config, None, 1.0, torch.Generator().manual_seed(0))["cycle"]
    terms = step_loss(model, batch, config, None, progress, torch.Generator().manual_seed(0))
    if factor is None:
        assert "cycle" not in terms
    else:
        assert terms["cycle"].item() == pytest.approx(factor * late.item(), rel=1e-5)


def test_heads_at_the_viewpoint_to_select_are_all_right_choices():
    vectors = view_vector(torch.tensor([[10.0, 20.0, 190.0], [10.0, 100.0, 190.0]]), torch.zeros(2, 3))
    logits = torch.tensor([[2.0, 1.0, -1.0], [2.0, 1.0, -1.0]], requires_grad=True)
    best = torch.tensor([0, 2])
    found, wanted_view = Hypotheses(vectors, logits), vectors[[0, 1], best]
    probabilities = logits.detach().softmax(1)
    wanted = -(probabilities[0, 0] + probabilities[0, 1]).log() - probabilities[1, 2].log()
    loss = selection_loss(found, best, wanted_view, 30.0)
    assert torch.allclose(loss, wanted / 2)
    loss.backward()
    assert (logits.grad[0, :2] < 0).all() and logits.grad[0, 2] > 0  # both up, and neither against the other
    assert torch.allclose(selection_loss(found, best, wanted_view, 0.0), F.cross_entropy(logits, best))


def test_other_images_of_a_target_learn_what_its_one_reconstruction_taught():
    # Rendered from 10 degrees, where the first image's head 0 is; another image's closest head is number 2.
    first = Hypotheses(view_vector(torch.tensor([[10.0, 130.0, 250.0]]), torch.zeros(1, 3)), torch.zeros(1, 3))
    azimuth = torch.tensor([[200.0, 100.0, 30.0]], requires_grad=True)
    logits = torch.zeros(1, 3, requires_grad=True)
    others = Hypotheses(view_vector(azimuth, torch.zeros(1, 3)), logits)
    drawn, label = first.vectors[:, 0], torch.tensor([0])
    choice = Choice(label, drawn, label, torch.zeros(1, 3))
    objects = Encoded(torch.zeros(()), torch.zeros(()))
    found = Reconstruction(first, others, choice, torch.zeros(()), torch.zeros(()), objects)
    loss = repeated_views_loss(
        found,
        TrainConfig(comparison=ComparisonConfig(pull_weight=1.0), selection=SelectionConfig(weight=0.5, angle=0.0)),
    )
    distance = (view_vector(torch.tensor(10.0), torch.tensor(0.0)) - others.vectors[0, 2]).square().sum()
    assert torch.allclose(loss, distance + 0.5 * torch.tensor(3.0).log())
    loss.backward()
    assert azimuth.grad[0, 2] > 0 and not azimuth.grad[0, :2].any()  # 30 degrees goes down towards 10
    assert logits.grad[0, 2] < 0 < logits.grad[0, 0]


@pytest.mark.parametrize(("progress", "trust"), [(0.0, 0.0), (0.49, 0.0), (0.5, 0.7), (1.0, 0.7)])
def test_the_selection_is_trusted_once_it_has_learned(model, progress, trust):
    config = settings(trust=0.7)
    assert pose_search(config, progress, torch.Generator()).trust == trust


@pytest.mark.parametrize(("progress", "own"), [(0.0, 0.0), (0.1, 0.5), (0.2, 1.0), (0.9, 1.0)])
def test_shapes_become_the_objects_own_as_training_goes_on(monkeypatch, progress, own):
    asked = []
    model = ViewNet(SMOKE.model)
    plain = model.encode
    monkeypatch.setattr(model, "encode", lambda views, own, background: asked.append(own) or plain(views, own))
    config = settings(shared_shape=0.2)
    views = images(4)
    step_loss(model, (views, views, views), config, None, progress, torch.Generator().manual_seed(0))
    assert asked == [pytest.approx(own)]
