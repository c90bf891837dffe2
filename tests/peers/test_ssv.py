"""SSV reduced in size: its coding of angles, its generator's turn, and which network each term of its loss teaches."""

from __future__ import annotations

import pytest
import torch

from viewnet.geometry import azimuth_elevation, look_at, view_vector
from viewnet.peers import registry
from viewnet.peers.peer import Batch
from viewnet.peers.ssv import ANGLE, MIRRORED, SSV, WARM_UP, Angles, Reading, angle_target, normalised
from viewnet.recipes import make_config

pytestmark = pytest.mark.usefixtures("one_thread")
OF_REAL = {"consistency", "mirrored"}
OF_CRITIC = {*OF_REAL, "critic", "penalty", "code", "viewpoint"}
OF_GENERATOR = {"adversary", "generator_code", "generator_viewpoint", "generator_mirrored"}


@pytest.fixture
def network() -> SSV:
    torch.manual_seed(0)
    network = registry.make("ssv", make_config("ssv", profile="smoke").model)
    assert isinstance(network, SSV)
    return network


def random() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def certain(angles: torch.Tensor) -> torch.Tensor:
    """Outputs (N, ANGLE) that say `angles` (N,) in degrees."""
    squares, quadrants = angle_target(angles)
    return torch.cat([squares.clamp(min=1e-35).log(), 40 * quadrants], 1)


def test_angles_survive_their_coding():
    angles = torch.arange(-360.0, 720.0, 0.25, dtype=torch.float64)
    squares, quadrants = angle_target(angles)
    assert torch.allclose(squares.sum(1), torch.ones_like(angles)) and (quadrants.sum(1) == 1).all()
    predicted = Angles(certain(angles))
    cosine, sine = predicted.point().unbind(1)
    off = (torch.rad2deg(torch.atan2(sine, cosine)) - angles + 180) % 360 - 180
    assert off.abs().max() < 1e-6
    assert predicted.divergence((squares, quadrants)).item() == pytest.approx(0, abs=1e-12)


def test_a_reading_is_of_the_outputs_in_their_order():
    azimuth, elevation = torch.tensor([10.0, 130.0, 250.0, 340.0]), torch.tensor([-19.0, -1.0, 20.0, 39.0])
    code, score = torch.randn(4, 16), torch.randn(4, 1)
    reading = Reading(torch.cat([score, certain(azimuth), certain(elevation), code], 1))
    assert torch.allclose(reading.vectors(), view_vector(azimuth, elevation), atol=1e-6)
    assert torch.equal(reading.score, score[:, 0]) and torch.equal(reading.code, code)


@pytest.mark.parametrize(("azimuth", "elevation"), [(20, 10), (100, -15), (200, 35), (300, 1), (359, -1)])
def test_what_is_said_of_a_mirrored_image_is_to_be_the_mirrored_viewpoint(network, azimuth, elevation):
    def reading(azimuth: float, elevation: float) -> Reading:
        angles = (certain(torch.tensor([float(angle)] * 3)) for angle in (azimuth, elevation))
        return Reading(torch.cat([torch.zeros(3, 1), *angles, torch.randn(3, network.config.code_size)], 1))

    def loss(*angles: float) -> float:
        return network.of_real(torch.rand(3, 3, 32, 32), reading(azimuth, elevation), reading(*angles))[
            "mirrored"
        ].item()

    assert loss(-azimuth, elevation) == pytest.approx(0, abs=1e-4)
    for other in ((azimuth, elevation), (180 - azimuth, elevation), (-azimuth, -elevation), (-azimuth + 10, elevation)):
        assert loss(*other) > 1e-3 * MIRRORED


def test_the_prediction_that_is_mirrored_is_a_target_alone(network):
    outputs = torch.randn(2, 5, 1 + 2 * ANGLE + network.config.code_size, requires_grad=True)
    network.of_real(torch.rand(5, 3, 32, 32), *map(Reading, outputs))["mirrored"].backward()
    assert outputs.grad is not None
    assert not outputs.grad[0].any() and outputs.grad[1, :, 1 : 1 + 2 * ANGLE].all()


def test_a_whole_turn_gives_the_same_image_and_half_of_it_another(network):
    code = normalised(torch.randn(3, network.config.code_size))

    def drawn(turn: float) -> torch.Tensor:
        azimuth = torch.tensor([0.0, 75.0, 200.0]) + turn
        return network.generator(code, look_at(view_vector(azimuth, torch.full((3,), 15.0))))

    images = drawn(0)
    assert images.shape == (3, 3, 32, 32)
    assert torch.allclose(drawn(360), images, atol=1e-4)
    assert (drawn(180) - images).abs().max() > 1e-3


def test_a_volume_is_seen_near_first_and_upright(network, monkeypatch):
    generator, volume = network.generator, torch.rand(1, 3, 8, 8, 8)  # its axes: z, y, x
    for name in ("enter", "seen", "paint"):
        monkeypatch.setattr(generator, name, torch.nn.Identity())
    monkeypatch.setattr(generator.enter, "forward", lambda constant, code: volume)
    monkeypatch.setattr(generator, "stages", torch.nn.ModuleList())
    found = generator(torch.zeros(1, 1), torch.eye(3)[None])  # a camera up on z, whose right is x
    assert torch.allclose(found.unflatten(1, (8, 3)), volume.flip(2, 3).movedim(1, 2), atol=1e-6)


def test_each_term_teaches_one_network(network):
    images = torch.rand(8, 4, 32, 32)
    batch = Batch(images[::2], images)
    names = {"critic": OF_CRITIC, "generator": OF_GENERATOR}
    assert set(network.losses(batch, 0.0, random())) == OF_CRITIC | OF_GENERATOR
    for term in sorted(OF_CRITIC | OF_GENERATOR):
        network.zero_grad()
        network.losses(batch, 1.0, random())[term].backward()
        for name, terms in names.items():
            gradients = [weight.grad for weight in getattr(network, name).parameters()]
            assert any(each is not None and each.any() for each in gradients) == (term in terms), (term, name)


def test_one_pass_over_the_sum_gives_each_network_the_gradient_of_its_own_terms(network):
    images = torch.rand(8, 4, 32, 32)
    batch = Batch(images[::2], images)

    def gradients(part: torch.nn.Module, terms: set[str]) -> list[torch.Tensor]:
        network.zero_grad()
        losses = network.losses(batch, 1.0, random())
        torch.stack([losses[name] for name in losses if name in terms]).sum().backward()
        return [weight.grad.clone() for weight in part.parameters() if weight.grad is not None]

    for part, own in ((network.critic, OF_CRITIC), (network.generator, OF_GENERATOR)):
        together, alone = gradients(part, OF_CRITIC | OF_GENERATOR), gradients(part, own)
        assert len(together) == len(alone) == len(list(part.parameters()))
        assert all(torch.allclose(*pair, atol=1e-7) for pair in zip(together, alone, strict=True))


def test_the_viewpoint_of_generated_images_teaches_the_generator_bit_by_bit(network):
    images = torch.rand(8, 4, 32, 32)
    start, amid, later, end = (
        network.losses(Batch(images, images), progress, random()) for progress in (0, WARM_UP / 2, WARM_UP, 1)
    )
    assert start["generator_viewpoint"] == 0
    assert torch.allclose(2 * amid["generator_viewpoint"], end["generator_viewpoint"])
    for name in OF_CRITIC | OF_GENERATOR:
        assert torch.equal(later[name], end[name])
        assert torch.equal(start[name], end[name]) or name == "generator_viewpoint"


def test_images_of_a_batch_stand_alone(network):
    images = torch.rand(8, 4, 32, 32)
    one = network.losses(Batch(images[::2], images), 0.0, random())
    other = network.losses(Batch(torch.full((4, 4, 32, 32), torch.nan), images), 0.0, random())
    assert one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)
    moved = network.viewpoint(images[[5, 3], :3])
    assert torch.allclose(moved.vectors, network.viewpoint(images[:, :3]).vectors[[5, 3]], atol=1e-6)


def test_viewpoints_drawn_cover_the_range_that_is_known(network):
    code, azimuth, elevation = network.drawn(4000, random())
    assert torch.allclose(code.square().mean(1), torch.ones(4000), atol=1e-4)
    assert torch.histc(azimuth, 12, 0, 360).min() > 4000 / 12 * 0.8
    assert elevation.min() >= -20 and elevation.max() <= 40
    assert torch.histc(elevation, 6, -20, 40).min() > 4000 / 6 * 0.8
    _, found = azimuth_elevation(view_vector(azimuth, elevation))
    assert torch.allclose(found, elevation, atol=1e-3)


def test_the_penalty_is_the_squared_slope_of_a_score(network):
    real = torch.rand(2, 3, 32, 32)
    step = 1e-2 * torch.randn(2, 3, 32, 32)
    inner = real.clone().requires_grad_()
    (slope,) = torch.autograd.grad(Reading(network.critic(inner)).score.sum(), inner)
    moved = Reading(network.critic(real + 1e-2 * step)).score - Reading(network.critic(real)).score
    assert torch.allclose(moved, 1e-2 * (slope * step).sum((1, 2, 3)), atol=2e-4)
    assert network.squared_slope(real).item() == pytest.approx(slope.square().sum((1, 2, 3)).mean().item(), rel=1e-5)
