"""One training step: which terms there are, and what each teaches."""

from __future__ import annotations

import pytest
import torch
from helpers.smoke_model import PLAIN, SMOKE, images, settings

from viewnet.data.pairs import step_generator
from viewnet.model.reconstruction import reconstruct
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.runtime.images import resize
from viewnet.training.optimisers import make_optimisers
from viewnet.training.step import step_loss


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


def test_images_of_the_hologan_decoder_do_not_run_away_to_nothing():
    torch.manual_seed(0)
    config = make_config("hologan_decoder", batch_size=4)
    model = ViewNet(config.model)
    optimisers = make_optimisers(model, config.train)
    target = torch.zeros(4, 4, 64, 64)
    for image, corner in zip(target, (12, 18, 24, 30), strict=True):
        image[:, corner : corner + 22, 16:48] = 1.0  # fills a sixth of the image, as cars do
    appearance = target[::2]
    for step in range(30):
        terms = step_loss(model, (appearance, target, target), config.train, None, 0.5, step_generator(0, step))
        model.zero_grad()
        torch.stack(list(terms.values())).sum().backward()
        for optimiser in optimisers:
            optimiser.step()
    with torch.no_grad():
        rendered = reconstruct(model, appearance, resize(target, 32), target, config.train).rendered
    assert rendered[:, 3].amax((1, 2)).min() > 0.5


@pytest.mark.parametrize("cut_out", [False, True])
def test_backgrounds_are_behind_the_appearance_network_s_input_unless_objects_are_cut_out(model, cut_out, monkeypatch):
    seen, encode = [], model.encode
    monkeypatch.setattr(model, "encode", lambda shown: (seen.append(shown), encode(shown))[1])
    backgrounds = torch.full((2, 3, 64, 64), 255, dtype=torch.uint8)
    batch = tuple(images(4, seed=seed) for seed in (1, 2, 2))
    generator = torch.Generator().manual_seed(0)
    step_loss(model, batch, settings(cut_out=cut_out), None, 0.5, generator, backgrounds)
    shown, alpha = seen[0][:, :3], batch[0][:, 3:]
    assert torch.equal(shown, batch[0][:, :3]) == cut_out
    torch.testing.assert_close(shown, batch[0][:, :3] + (0 if cut_out else 1) * (1 - alpha))
