from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from helpers.cad_files import real_data
from hypothesis import given
from hypothesis import strategies as st

from viewnet.config import ComparisonConfig, CycleConfig, SelectionConfig, TrainConfig
from viewnet.data.pairs import resize
from viewnet.errors import ViewnetError
from viewnet.geometry import azimuth_elevation, look_at, view_vector
from viewnet.model.losses import PerceptualLoss, composite, cycle_loss, head_errors, pixel_loss
from viewnet.model.viewnet import Hypotheses, ViewNet
from viewnet.recipes import make_config
from viewnet.training import step
from viewnet.training.step import (
    Reconstruction,
    Search,
    Stage,
    _balanced,
    _choose,
    _selection,
    _sightings,
    _stage,
    reconstruct,
    step_loss,
)

PLAIN = {"neighbours": 0.0, "pull_weight": 0.0, "search": 0.0, "balance": 0.0, "mirror": False, "amp": "off"}
SMOKE = make_config(profile="smoke", recipe="matting", **PLAIN)


def images(count: int, size: int = 32, seed: int = 0) -> torch.Tensor:
    """(count, 4, size, size): RGB times mask, and mask."""
    values = torch.rand(count, 4, size, size, generator=torch.Generator().manual_seed(seed))
    return torch.cat([values[:, :3] * values[:, 3:], values[:, 3:]], dim=1)


# Matting


@given(st.integers(0, 1000))
def test_equal_images_are_equal_over_every_colour(seed):
    image = images(3, 8, seed)
    colour = torch.rand(3, 3, generator=torch.Generator().manual_seed(seed + 1))
    assert pixel_loss(composite(image, colour), composite(image.clone(), colour)) == 0


def test_a_wrong_mask_cannot_hide_over_a_random_colour():
    """Painting black around the object costs nothing over black, and costs over any other colour."""
    target = torch.zeros(1, 4, 8, 8)
    target[:, :, 2:6, 2:6] = 1
    painted = target.clone()
    painted[:, 3] = 1  # the right colours, and black around the object
    black, red = torch.zeros(1, 3), torch.tensor([[1.0, 0.0, 0.0]])
    assert pixel_loss(composite(painted, black), composite(target, black)) == 0
    assert pixel_loss(composite(painted, red), composite(target, red)) > 0.1


def test_compositing_is_a_blend():
    image = torch.tensor([0.3, 0.2, 0.1, 0.5]).view(1, 4, 1, 1)
    assert composite(image, torch.tensor([[1.0, 0.0, 0.5]])).flatten().tolist() == pytest.approx([0.8, 0.2, 0.35])


def test_pixel_loss_by_hand():
    found, wanted = torch.zeros(1, 1, 2, 2), torch.tensor([[[[1.0, 0.0], [0.0, 0.0]]]])
    fine, coarse = 1 / 4 + 0.5 * 1 / 4, 1 / 4 + 0.5 * 1 / 16
    assert pixel_loss(found, wanted).item() == pytest.approx((fine + coarse) / 2)


# Choice of the head


def test_head_errors_are_means_over_a_image():
    drawn, target = torch.rand(2, 3, 3, 4, 4), torch.rand(2, 3, 4, 4)
    found = head_errors(drawn, target)
    assert found.shape == (2, 3)
    assert found[1, 2].item() == pytest.approx((drawn[1, 2] - target[1]).square().mean().item())


@pytest.fixture
def model():
    torch.manual_seed(0)
    return ViewNet(SMOKE.model)


def test_the_winner_alone_gets_the_reconstruction_s_gradients(model):
    model.viewpoint.encoder[-2].weight.data.mul_(5)  # viewpoints that differ from image to image
    target, appearance = images(6, seed=1), images(6, seed=2)
    found = reconstruct(model, appearance, target, target, SMOKE.train)
    assert torch.equal(found.best, found.errors.argmin(1))
    grad_vectors, grad_logits = torch.autograd.grad(
        pixel_loss(found.drawn, found.target),
        [found.hypotheses.vectors, found.hypotheses.logits],
        allow_unused=True,
        materialize_grads=True,
    )
    won = F.one_hot(found.best, SMOKE.model.heads).bool()
    assert (grad_vectors[won].abs().sum(-1) > 0).all()
    assert (grad_vectors[~won] == 0).all()
    assert (grad_logits == 0).all()  # which the choice teaches, not the image


def test_the_image_is_the_winner_s(model):
    target = images(4, seed=1)
    found = reconstruct(model, target, target, target, SMOKE.train)
    drawn = model.draw(found.shape, found.appearance, look_at(found.better), SMOKE.model.render_size)
    assert torch.allclose(found.drawn, drawn, atol=1e-6)
    assert torch.equal(found.target, resize(target, SMOKE.model.render_size))


@pytest.mark.parametrize(("colours", "masks"), [(1.0, 0.0), (0.0, 1.0), (0.5, 2.0)])
def test_viewpoints_are_compared_by_colours_and_masks_as_configured(model, colours, masks):
    config = dataclasses.replace(SMOKE.train, compare_colours=colours, compare_masks=masks)
    target = images(4, seed=1)
    found = reconstruct(model.eval(), target, target, target, config)
    off = (found.drawn - found.target).square().mean(dim=(2, 3))
    expected = colours * off[:, :3].mean(1) + masks * off[:, 3]
    assert torch.allclose(found.errors.amin(1), expected, atol=1e-6)


def test_several_targets_share_an_appearance(model):
    model.eval()  # batch statistics would tie the images together
    target, appearance = images(4, seed=1), images(2, seed=2)
    shared = reconstruct(model, appearance, target, target, SMOKE.train)
    apart = reconstruct(model, appearance.repeat_interleave(2, 0), target, target, SMOKE.train)
    assert torch.allclose(shared.drawn, apart.drawn, atol=1e-5)
    assert torch.allclose(shared.errors, apart.errors, atol=1e-5)


def test_a_single_head_has_nothing_to_select():
    torch.manual_seed(0)
    config = make_config("single_head", profile="smoke", recipe="matting", **PLAIN)
    batch = (images(4, seed=1), images(4, seed=2), images(4, seed=2))
    terms = step_loss(ViewNet(config.model), batch, config.train, None, 0.5, torch.Generator().manual_seed(0))
    assert set(terms) == {"pixels", "masks"}


def test_a_segmentation_target_ignores_colour(model):
    config = dataclasses.replace(SMOKE.train, target="mask")
    target = images(4, seed=1)
    recoloured = torch.cat([target[:, :3].flip(1), target[:, 3:]], dim=1)
    one, two = (reconstruct(model.eval(), target, wanted, target, config) for wanted in (target, recoloured))
    assert torch.equal(one.errors, two.errors)
    one, two = (
        step_loss(model, (target, wanted, target), config, None, 0.5, torch.Generator().manual_seed(0))
        for wanted in (target, recoloured)
    )
    assert torch.equal(one["pixels"], two["pixels"])


# Neighbours of the heads


def known_targets(model):
    """Views of given shapes from known viewpoints: shapes, codes, azimuths, elevations, targets."""
    torch.manual_seed(1)
    code = torch.randn(6, SMOKE.model.appearance_size)
    shape = model.shape(code)
    azimuth, elevation = 60 * torch.arange(6.0), torch.full((6,), 10.0)
    return shape, code, azimuth, elevation, model.draw(shape, code, look_at(view_vector(azimuth, elevation)))


def test_heads_are_compared_by_the_best_viewpoint_around_each(model):
    """A head that is off by the step between neighbours reconstructs the target without an error."""
    config = dataclasses.replace(SMOKE.train, neighbours=8.0, pull_weight=1.0)
    shape, code, azimuth, elevation, target = known_targets(model)
    heads = torch.stack([view_vector(azimuth + 170, elevation), view_vector(azimuth + 8, elevation)], dim=1)
    said = Hypotheses(heads, torch.zeros(6, 2))
    best, view, _, errors = _choose(model, shape, code, said, target, config, Stage())
    assert best.tolist() == [1] * 6
    assert torch.allclose(view, view_vector(azimuth, elevation), atol=1e-5)
    assert errors[:, 1].max() < 1e-9 < errors[:, 0].min()
    best, plain, _, further = _choose(model.eval(), shape, code, said, target, config, Stage())
    assert torch.equal(plain, heads[:, 1])  # which is for training only
    assert (further[:, 1] > errors[:, 1]).all()


# Search and balance


def test_the_search_finds_what_no_head_says_and_the_closest_head_is_taught(model):
    shape, code, azimuth, elevation, target = known_targets(model)
    heads = torch.stack([view_vector(azimuth + 90, elevation), view_vector(azimuth + 200, elevation)], dim=1)
    search = Search(400, 0.0, torch.Generator().manual_seed(0))
    said = Hypotheses(heads, torch.zeros(6, 2))
    best, view, _, _ = _choose(model, shape, code, said, target, SMOKE.train, Stage(search=search))
    assert ((view * view_vector(azimuth, elevation)).sum(-1) > np.cos(np.radians(12))).all()
    assert best.tolist() == [0] * 6


def test_the_search_covers_all_azimuths_and_the_elevations_allowed():
    grid = Search(36, 0.0, torch.Generator().manual_seed(0)).grid(50, (-20.0, 40.0))
    azimuth, elevation = azimuth_elevation(grid)
    assert grid.shape == (50, 36, 3)
    assert (torch.histc(azimuth, 36, 0, 360) == 50).all()
    assert -20 <= elevation.min() < -15 and 35 < elevation.max() <= 40


@pytest.mark.parametrize("views", [40, 42, 3])
def test_sectors_are_searched_at_half_the_resolution_and_compared_at_the_full_one(views):
    config = make_config(profile="smoke", recipe="matting", **PLAIN, render_size=32)
    torch.manual_seed(0)
    model = ViewNet(config.model)
    code = torch.randn(3, config.model.appearance_size)
    grid = Search(views, 0.0, torch.Generator().manual_seed(0)).grid(3, (-20.0, 40.0))
    with torch.no_grad():
        shape = model.shape(code)
        target = model.draw(shape, code, look_at(grid[:, views // 2]))
        tried, errors = step._compare_grid(model, shape, code, grid, target, config.train)
        _, all_of_them = step.compare(model, shape, code, grid[:, :, None], None, target, config.train)
    same = (tried[:, :, None] == grid[:, None]).all(-1)
    assert tried.shape[1] == min(views, step.SECTORS) and same.any(2).all()
    where = same.float().argmax(2)
    assert torch.allclose(errors, all_of_them.gather(1, where), atol=1e-6)
    if views > step.SECTORS:
        azimuth, _ = azimuth_elevation(tried)
        assert (azimuth.diff(dim=1)[:, : step.SECTORS - 2] > 0).all()  # one from each sector, in their order
        # The best at half the resolution is the true viewpoint, or close to it.
        assert ((where.gather(1, errors.argmin(1)[:, None]) - views // 2).abs() <= 3).all()


def test_chance_chooses_in_proportion_to_the_errors():
    errors = torch.tensor([[0.0, 1.0, 2.0]]).expand(20000, 3)
    perturbed = Search(0, 1.0, torch.Generator().manual_seed(0)).perturb(errors)
    chosen = torch.bincount(perturbed.argmin(1), minlength=3) / len(errors)
    assert torch.allclose(chosen, torch.softmax(-errors[0], 0), atol=0.02)  # their spread is 1
    assert torch.equal(Search(0, 0.0, torch.Generator()).perturb(errors), errors)


def test_an_azimuth_chosen_too_often_is_avoided():
    front, back = view_vector(torch.tensor([15.0, 195.0]), torch.zeros(2))
    views = torch.stack([front, back]).expand(1, 2, 3)
    score = torch.tensor([[1.0, 1.1]])  # both much alike, the front a little better
    even, limits = torch.full((12, 1), 1 / 12), (-90.0, 90.0)
    assert _balanced(score, views, even, limits, 1.0).argmin().item() == 0
    often = torch.tensor([0.6, 0.4, *[0.0] * 9, 0.0])[:, None]
    assert _balanced(score, views, often, limits, 1.0).argmin().item() == 1
    assert torch.equal(_balanced(score, views, often, limits, 0.0), score)


def test_an_elevation_chosen_too_often_is_avoided():
    """With near and far exchanged, (a, e) looks like (180 - a, -e): the frequencies of elevations distinguish them."""
    views = view_vector(torch.tensor([15.0, 165.0]), torch.tensor([10.0, -10.0])).expand(1, 2, 3)
    score, limits = torch.tensor([[1.1, 1.0]]), (-20.0, 40.0)
    even = torch.full((12, 4), 1 / 48)
    assert _balanced(score, views, even, limits, 1.0).argmin().item() == 1
    below = torch.tensor([0.7, 0.1, 0.1, 0.1]).expand(12, 4) / 12
    assert _balanced(score, views, below, limits, 1.0).argmin().item() == 0


def asked_to_draw(model, monkeypatch, target, **changes):
    """Appearance, target and what the viewpoint network sees, in a step that is given `target` for all three."""
    asked = []
    monkeypatch.setattr(step, "reconstruct", lambda *a, **k: asked.append(a) or reconstruct(*a, **k))
    config = dataclasses.replace(SMOKE.train, **changes)
    step_loss(model, (target, target, target), config, None, 0.5, torch.Generator().manual_seed(0))
    return asked[0][1:4]


def test_a_mirrored_target_is_drawn_as_it_is_seen(model, monkeypatch):
    target = images(32, seed=1)
    appearance, wanted, seen = asked_to_draw(model, monkeypatch, target, mirror=True, jitter=0.0)
    mirrored = (wanted == target.flip(-1)).flatten(1).all(1)
    assert 8 < mirrored.sum() < 24
    assert torch.equal(wanted[~mirrored], target[~mirrored])
    assert torch.equal(seen, wanted) and torch.equal(appearance, target)


def test_only_the_viewpoint_network_sees_other_colours(model, monkeypatch):
    target = images(4, seed=1)
    appearance, wanted, seen = asked_to_draw(model, monkeypatch, target, mirror=False, jitter=0.5)
    assert torch.equal(appearance, target) and torch.equal(wanted, target)
    assert torch.equal(seen[:, 3], target[:, 3])
    assert not torch.allclose(seen[:, :3], target[:, :3], atol=0.01)


# Cycle consistency


def test_the_cycle_pulls_the_selected_head_or_the_closest():
    truth = torch.tensor([[1.0, 0.0, 0.0]])
    vectors = F.normalize(torch.tensor([[[1.0, 0.2, 0.0], [0.0, 1.0, 0.0]]]), dim=-1)
    logits = torch.tensor([[0.0, 3.0]])  # the second is selected, the first is right
    moved = {}
    for head in ("selected", "closest"):
        v, s = vectors.clone().requires_grad_(), logits.clone().requires_grad_()
        loss = cycle_loss(Hypotheses(v, s), truth, TrainConfig(cycle=CycleConfig(head=head)))
        loss.backward()
        moved[head] = (v.grad.abs().sum(-1) > 0).flatten().tolist()
        assert s.grad[0, 0] < 0 < s.grad[0, 1]  # either way the right head's logit is to rise
        pulled = {"selected": vectors[0, 1], "closest": vectors[0, 0]}[head]
        expected = F.mse_loss(pulled, truth[0]) + F.cross_entropy(logits, torch.tensor([0]))
        assert loss.item() == pytest.approx(expected.item())
    assert moved == {"selected": [False, True], "closest": [True, False]}


def test_the_cycle_teaches_the_viewpoint_network_only(model):
    config = dataclasses.replace(SMOKE.train, cycle=True, cycle_weight=1.0, cycle_start=0.0)
    batch = (images(4, seed=1), images(4, seed=2), images(4, seed=2))
    terms = step_loss(model, batch, config, None, 0.5, torch.Generator().manual_seed(0))
    terms["cycle"].backward()
    assert any(p.grad is not None and p.grad.any() for p in model.viewpoint.parameters())
    for part in (model.appearance, model.decoder):
        assert all(p.grad is None for p in part.parameters())
    assert model.focal.grad is None


@pytest.mark.parametrize(("progress", "factor"), [(0.0, None), (0.1, None), (0.15, 0.5), (0.2, 1.0), (0.9, 1.0)])
def test_the_cycle_sets_in_and_is_ramped_up(model, progress, factor):
    config = dataclasses.replace(SMOKE.train, cycle=True, cycle_weight=2.0, cycle_start=0.1)
    batch = (images(4, seed=1), images(4, seed=2), images(4, seed=2))
    model.eval()
    late = step_loss(model, batch, config, None, 1.0, torch.Generator().manual_seed(0))["cycle"]
    terms = step_loss(model, batch, config, None, progress, torch.Generator().manual_seed(0))
    if factor is None:
        assert "cycle" not in terms
    else:
        assert terms["cycle"].item() == pytest.approx(factor * late.item(), rel=1e-5)


# Features


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
        assert torch.allclose(network.eval().features[:layers](x), tap, atol=1e-4)


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


def test_heads_at_the_viewpoint_to_select_are_all_right_choices():
    vectors = view_vector(torch.tensor([[10.0, 20.0, 190.0], [10.0, 100.0, 190.0]]), torch.zeros(2, 3))
    logits = torch.tensor([[2.0, 1.0, -1.0], [2.0, 1.0, -1.0]], requires_grad=True)
    best = torch.tensor([0, 2])
    found, wanted_view = Hypotheses(vectors, logits), vectors[[0, 1], best]
    probabilities = logits.detach().softmax(1)
    wanted = -(probabilities[0, 0] + probabilities[0, 1]).log() - probabilities[1, 2].log()
    loss = _selection(found, best, wanted_view, 30.0)
    assert torch.allclose(loss, wanted / 2)
    loss.backward()
    assert (logits.grad[0, :2] < 0).all() and logits.grad[0, 2] > 0  # both up, and neither against the other
    assert torch.allclose(_selection(found, best, wanted_view, 0.0), F.cross_entropy(logits, best))


def test_other_images_of_a_target_learn_what_its_one_drawing_taught():
    # Drawn from 10 degrees, where the first image's head 0 is; another image's closest head is number 2.
    first = Hypotheses(view_vector(torch.tensor([[10.0, 130.0, 250.0]]), torch.zeros(1, 3)), torch.zeros(1, 3))
    azimuth = torch.tensor([[200.0, 100.0, 30.0]], requires_grad=True)
    logits = torch.zeros(1, 3, requires_grad=True)
    others = Hypotheses(view_vector(azimuth, torch.zeros(1, 3)), logits)
    drawn, label = first.vectors[:, 0], torch.tensor([0])
    found = Reconstruction(first, others, torch.zeros(1, 3), label, drawn, label, *[torch.zeros(())] * 4)
    loss = _sightings(
        found,
        TrainConfig(comparison=ComparisonConfig(pull_weight=1.0), selection=SelectionConfig(weight=0.5, angle=0.0)),
    )
    distance = (view_vector(torch.tensor(10.0), torch.tensor(0.0)) - others.vectors[0, 2]).square().sum()
    assert torch.allclose(loss, distance + 0.5 * torch.tensor(3.0).log())
    loss.backward()
    assert azimuth.grad[0, 2] > 0 and not azimuth.grad[0, :2].any()  # 30 degrees goes down towards 10
    assert logits.grad[0, 2] < 0 < logits.grad[0, 0]


def test_the_selection_has_a_say_in_what_is_drawn_and_none_in_what_it_is_taught(model):
    """A head slightly off and one far off: the first has the lower error, unless the selection is sure of the other."""
    shape, code, azimuth, elevation, target = known_targets(model)
    heads = torch.stack([view_vector(azimuth + 2, elevation), view_vector(azimuth + 60, elevation)], dim=1)
    sure = torch.tensor([0.0, 30.0]).expand(6, 2)
    for logits, trust, drawn in ((sure, 0.5, 1), (sure, 0.0, 0), (-sure, 0.5, 0), (0 * sure, 0.5, 0)):
        best, view, label, errors = _choose(
            model, shape, code, Hypotheses(heads, logits), target, SMOKE.train, Stage(trust=trust)
        )
        assert best.tolist() == [drawn] * 6
        assert torch.equal(view, heads[:, drawn])
        assert label.tolist() == [0] * 6
        assert (errors[:, 0] < errors[:, 1]).all()


@pytest.mark.parametrize(("progress", "trust"), [(0.0, 0.0), (0.49, 0.0), (0.5, 0.7), (1.0, 0.7)])
def test_the_selection_is_trusted_once_it_has_learned(model, progress, trust):
    config = dataclasses.replace(SMOKE.train, trust=0.7)
    assert _stage(model, config, progress, torch.Generator()).trust == trust


def test_objects_begin_with_one_shape_and_end_with_their_own():
    torch.manual_seed(0)
    model, views = ViewNet(SMOKE.model).eval(), images(3)
    codes = [model.imagine(views, own=own)[0] for own in (0.0, 0.5, 1.0)]
    assert torch.allclose(codes[0], codes[2].mean(0).expand(3, -1), atol=1e-6)
    assert torch.allclose(codes[1], (codes[0] + codes[2]) / 2, atol=1e-6)
    assert not torch.allclose(codes[2][0], codes[2][1], atol=1e-3)


@pytest.mark.parametrize(("progress", "own"), [(0.0, 0.0), (0.1, 0.5), (0.2, 1.0), (0.9, 1.0)])
def test_shapes_become_the_objects_own_as_training_goes_on(monkeypatch, progress, own):
    asked = []
    model = ViewNet(SMOKE.model)
    plain = model.imagine
    monkeypatch.setattr(model, "imagine", lambda views, own, behind: asked.append(own) or plain(views, own))
    config = dataclasses.replace(SMOKE.train, shared_shape=0.2)
    views = images(4)
    step_loss(model, (views, views, views), config, None, progress, torch.Generator().manual_seed(0))
    assert asked == [pytest.approx(own)]
