"""Corners of boxes: PnP gives back the rotation they were projected by, whatever a crop has done to them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from viewnet.geometry import look_at, rotation_angle, view_vector
from viewnet.peers import registry
from viewnet.peers.box_corners import THINNEST, corners_of, framed, pnp, project
from viewnet.peers.peer import Batch
from viewnet.recipes import make_config
from viewnet.render import camera

SHAPES = ((0.9, 0.37, 0.3), (0.5, 0.5, 0.7), (0.6, 0.77, 0.2), (0.95, 0.3, 0.06))


def cameras() -> torch.Tensor:
    """world_from_camera (168, 3, 3) of a grid of viewpoints, straight from the front and the sides among them."""
    azimuth, elevation = torch.meshgrid(torch.arange(0, 360, 15), torch.arange(-40, 80, 20), indexing="ij")
    return look_at(view_vector(azimuth.flatten().double(), elevation.flatten().double()))


def seen(shape: tuple[float, ...], frames: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Corners (N, 8, 2) in the image, and sides (N, 3)."""
    sides = torch.nn.functional.normalize(torch.tensor(shape, dtype=torch.float64), dim=0).expand(len(frames), 3)
    return project(corners_of(sides), frames), sides


@pytest.mark.parametrize("shape", SHAPES)
def test_pnp_gives_back_the_rotation(shape):
    frames = cameras()
    points, sides = seen(shape, frames)
    for given in (points, framed(points), points * torch.tensor([3.0, 0.5]) + torch.tensor([0.1, -2.0])):
        assert rotation_angle(pnp(given, 4 * sides), frames).max() < 0.01  # sides count as shares of the diagonal


@pytest.mark.parametrize("shape", SHAPES[:3])
def test_small_errors_of_corners_and_sides_cost_few_degrees(shape):
    frames, generator = cameras(), torch.Generator().manual_seed(0)
    points, sides = seen(shape, frames)
    points = framed(points) + 0.02 * torch.randn(points.shape, generator=generator)
    found = pnp(points, sides + 0.01 * torch.randn(sides.shape, generator=generator))
    angles = rotation_angle(found, frames)
    assert angles.median() < 4 and angles.quantile(0.95) < 12


@pytest.mark.parametrize(
    ("points", "sides"),
    [
        (torch.zeros(1, 8, 2), torch.ones(1, 3)),  # all in one place
        (torch.rand(1, 8, 2), -torch.ones(1, 3)),  # sides that no box has
        (torch.rand(1, 8, 1).expand(1, 8, 2), torch.tensor([[1.0, 0.0, 0.0]])),  # on a line, of a line
    ],
)
def test_nonsense_still_gives_a_rotation(points, sides):
    found = pnp(points, sides)
    assert torch.allclose(found.transpose(1, 2) @ found, torch.eye(3), atol=1e-4)


def test_a_side_of_nothing_is_taken_for_a_thin_one():
    frames = cameras()
    points, _ = seen((0.8, 0.6, THINNEST), frames)
    flat = torch.tensor([0.8, 0.6, 0.0], dtype=torch.float64).expand(len(frames), 3)
    assert rotation_angle(pnp(points, flat), frames).max() < 0.1


def test_front_and_back_differ_by_the_order_of_corners():
    front, back = (look_at(view_vector(torch.tensor([a]), torch.tensor([10.0]))) for a in (0.0, 180.0))
    points, sides = seen(SHAPES[0], front.double())
    corners = corners_of(sides)
    turned = [int((corners[0] * torch.tensor([-1, -1, 1]) - corner).norm(dim=1).argmin()) for corner in corners[0]]
    assert rotation_angle(pnp(points[:, turned], sides), back.double()).item() < 0.01


def test_corners_are_where_the_renderer_puts_them():
    frames = cameras()
    points, sides = seen(SHAPES[0], frames)
    drawn = camera.project(corners_of(sides[:1])[0].numpy(), frames.numpy())  # y down, in image widths
    assert np.allclose(drawn, 0.5 + camera.FOCAL * points.numpy() * [1, -1])


def test_the_loss_is_nothing_at_the_truth_and_the_prediction_is_then_right(monkeypatch):
    network = registry.make("box_corners", make_config("box_corners", profile="smoke").model).eval()
    frames = cameras().float()
    points, sides = seen(SHAPES[0], frames.double())
    monkeypatch.setattr(network, "forward", lambda images: (framed(points).float(), sides.float()))
    images = torch.rand(len(frames), 4, 32, 32)
    batch = Batch(images[:1], images, frames, 3 * sides.float())
    assert sum(network.losses(batch, 0.0, torch.Generator()).values()) < 1e-6
    assert torch.allclose(network.viewpoint(images).vectors[:, 0], frames[..., 2], atol=1e-3)
    other = Batch(images[:1], images, frames.roll(1, 0), 3 * sides.float())
    assert network.losses(other, 0.0, torch.Generator())["corners"] > 0.01
    other = Batch(images[:1], images, frames, sides.float().flip(1))
    assert network.losses(other, 0.0, torch.Generator())["sides"] > 0.001
