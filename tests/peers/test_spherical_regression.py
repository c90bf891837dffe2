"""Spherical regression: its coding of angles, and what its loss asks for."""

from __future__ import annotations

import math

import pytest
import torch

from viewnet.geometry import look_at, view_vector
from viewnet.peers import registry
from viewnet.peers.peer import Batch
from viewnet.peers.spherical_regression import MAGNITUDE_WEIGHT, SHIFT, decode, encode
from viewnet.recipes import make_config


def test_angles_survive_their_coding():
    angles = torch.arange(-360.0, 720.0, 0.25, dtype=torch.float64)
    squares, quadrants = encode(angles)
    assert torch.allclose(squares.sum(-1), torch.ones_like(angles))
    off = (decode(squares, quadrants) - angles + 180) % 360 - 180
    assert off.abs().max() < 1e-6


@pytest.mark.parametrize(
    ("angle", "quadrant", "signs"), [(10, 0, (1, 1)), (100, 1, (-1, 1)), (190, 2, (-1, -1)), (-80, 3, (1, -1))]
)
def test_a_quadrant_gives_the_signs(angle, quadrant, signs):
    assert encode(torch.tensor([float(angle)]))[1].tolist() == [quadrant]
    decoded = math.radians(decode(torch.tensor([[0.5, 0.5]]), torch.tensor([quadrant])).item())
    assert (math.copysign(1, math.cos(decoded)), math.copysign(1, math.sin(decoded))) == signs


def test_a_quadrant_that_errs_near_an_axis_costs_few_degrees():
    squares, quadrants = encode(torch.tensor([2.0, 88.0]))
    wrong = torch.where(quadrants == 0, torch.tensor([3, 1]), quadrants)
    assert torch.allclose(decode(squares, wrong), torch.tensor([-2.0, 92.0]), atol=1e-4)


@pytest.fixture
def network():
    torch.manual_seed(0)
    return registry.make("spherical_regression", make_config("spherical_regression", profile="smoke").model).eval()


def predicting(network, azimuth: float, elevation: float, monkeypatch) -> None:
    """Makes the network certain of one viewpoint, whatever it sees."""
    squares, quadrants = encode(torch.tensor([azimuth, elevation]) + torch.tensor(SHIFT))

    def forward(images, generator=None):
        logits = 40.0 * torch.nn.functional.one_hot(quadrants, 4).float()
        return squares.log().expand(len(images), 2, 2), logits.expand(len(images), 2, 4)

    monkeypatch.setattr(network, "forward", forward)


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 20), (45, 1), (135, -19), (250, 39), (359, -1)])
def test_the_loss_is_least_at_the_truth_and_the_prediction_is_then_right(network, monkeypatch, azimuth, elevation):
    images, truth = torch.rand(2, 4, 32, 32), view_vector(torch.tensor(float(azimuth)), torch.tensor(float(elevation)))
    batch = Batch(images[:1], images, look_at(truth).expand(2, 3, 3))
    generator = torch.Generator().manual_seed(0)
    predicting(network, azimuth, elevation, monkeypatch)
    assert torch.allclose(network.viewpoint(images[:, :3]).vectors[:, 0], truth.expand(2, 3), atol=1e-4)
    right = network.losses(batch, 0.0, generator)
    squares = encode(torch.tensor([azimuth, elevation]) + torch.tensor(SHIFT))[0]
    assert right["magnitude"].item() == pytest.approx(-MAGNITUDE_WEIGHT * (squares * squares.log()).sum().item(), 1e-4)
    assert right["quadrant"].item() == pytest.approx(0, abs=1e-4)
    for other in ((azimuth + 10, elevation), (azimuth + 180, elevation), (azimuth, elevation + 10)):
        predicting(network, *other, monkeypatch)
        assert sum(network.losses(batch, 0.0, generator).values()) > sum(right.values()) + 1e-3


def test_units_are_dropped_in_training_only_and_by_the_generator_given(network):
    images = torch.rand(4, 3, 32, 32)

    def logits(seed: int) -> torch.Tensor:
        return network(images, torch.Generator().manual_seed(seed))[0]

    assert torch.equal(logits(1), logits(2))
    network.train()
    assert torch.equal(logits(1), logits(1)) and not torch.equal(logits(1), logits(2))
