"""The search for viewpoints: neighbours, sectors and noise."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.smoke_model import PLAIN, SMOKE, known_targets, settings

from viewnet.config import ComparisonConfig, TrainConfig
from viewnet.geometry import azimuth_elevation, look_at, view_vector
from viewnet.model.reconstruction import Choice, Encoded, Reconstruction, best_head, compare
from viewnet.model.viewnet import Hypotheses, ViewNet
from viewnet.recipes import make_config
from viewnet.training.matting import SECTORS, PoseSearch, Search, compare_grid, half_resolution, repeated_views_loss


@pytest.fixture
def model():
    torch.manual_seed(0)
    return ViewNet(SMOKE.model)


def test_heads_are_compared_by_the_best_viewpoint_around_each(model):
    """A head that is off by the step between neighbours reconstructs the target without an error."""
    config = settings(neighbours=8.0)
    objects, azimuth, elevation, target = known_targets(model)
    heads = torch.stack([view_vector(azimuth + 170, elevation), view_vector(azimuth + 8, elevation)], dim=1)
    hypotheses = Hypotheses(heads, torch.zeros(6, 2))
    choice = PoseSearch()(model, objects, hypotheses, target, config)
    assert choice.head.tolist() == [1] * 6
    assert torch.allclose(choice.viewpoint, view_vector(azimuth, elevation), atol=1e-5)
    assert choice.errors[:, 1].max() < 1e-9 < choice.errors[:, 0].min()
    plain = best_head(model, objects, hypotheses, target, config)
    assert torch.equal(plain.viewpoint, heads[:, 1])  # neighbours are for training only
    assert (plain.errors[:, 1] > choice.errors[:, 1]).all()


def test_the_search_finds_what_no_head_says_and_the_closest_head_is_taught(model):
    objects, azimuth, elevation, target = known_targets(model)
    heads = torch.stack([view_vector(azimuth + 90, elevation), view_vector(azimuth + 200, elevation)], dim=1)
    search = PoseSearch(Search(400, 0.0, torch.Generator().manual_seed(0)))
    choice = search(model, objects, Hypotheses(heads, torch.zeros(6, 2)), target, SMOKE.train)
    assert ((choice.viewpoint * view_vector(azimuth, elevation)).sum(-1) > np.cos(np.radians(12))).all()
    assert choice.head.tolist() == [0] * 6
    assert torch.equal(choice.render_from, choice.viewpoint)


def test_the_search_covers_all_azimuths_and_the_elevations_allowed():
    grid = Search(36, 0.0, torch.Generator().manual_seed(0)).grid(50, (-20.0, 40.0))
    azimuth, elevation = azimuth_elevation(grid)
    assert grid.shape == (50, 36, 3)
    assert (torch.histc(azimuth, 36, 0, 360) == 50).all()
    assert -20 <= elevation.min() < -15 and 35 < elevation.max() <= 40


@pytest.mark.parametrize("views", [40, 42, 3])
def test_sectors_are_searched_at_half_the_resolution_and_compared_at_the_full_one(views):
    config = make_config(profile="smoke", recipe="matting", **PLAIN, render_size=32)
    torch.manual_seed(2)
    model = ViewNet(config.model)
    code = torch.randn(3, config.model.appearance_size)
    grid = Search(views, 0.0, torch.Generator().manual_seed(0)).grid(3, (-20.0, 40.0))
    with torch.no_grad():
        shape = model.generate(code)
        target = model.render(shape, code, look_at(grid[:, views // 2]))
        objects = Encoded(code, shape)
        tried, errors = compare_grid(
            model, objects, grid, target, config.train, half_resolution(model, objects, target)
        )
        _, all_of_them = compare(model, Encoded(code, shape), grid[:, :, None], None, target, config.train)
    same = (tried[:, :, None] == grid[:, None]).all(-1)
    assert tried.shape[1] == min(views, SECTORS) and same.any(2).all()
    where = same.float().argmax(2)
    assert torch.allclose(errors, all_of_them.gather(1, where), atol=1e-6)
    if views > SECTORS:
        azimuth, _ = azimuth_elevation(tried)
        assert (azimuth.diff(dim=1)[:, : SECTORS - 2] > 0).all()  # one from each sector, in their order
        # What half the resolution thinks best is the viewpoint that was drawn from, or close to it.
        assert ((where.gather(1, errors.argmin(1)[:, None]) - views // 2).abs() <= 3).all()


def test_chance_chooses_in_proportion_to_the_errors():
    errors = torch.tensor([[0.0, 1.0, 2.0]]).expand(20000, 3)
    perturbed = Search(0, 1.0, torch.Generator().manual_seed(0)).perturb(errors)
    chosen = torch.bincount(perturbed.argmin(1), minlength=3) / len(errors)
    assert torch.allclose(chosen, torch.softmax(-errors[0], 0), atol=0.02)  # their spread is 1
    assert torch.equal(Search(0, 0.0, torch.Generator()).perturb(errors), errors)


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
