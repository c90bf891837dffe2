"""Relative rotations: each object's frame makes no difference, and errors have a learned scale."""

from __future__ import annotations

import math

import pytest
import torch

from viewnet.errors import ViewnetError
from viewnet.geometry import look_at, view_vector
from viewnet.peers import registry
from viewnet.peers.peer import Batch
from viewnet.peers.relative_pose import FLOOR, relative
from viewnet.recipes import make_config

OBJECTS, VIEWS = 3, 4


def rotations(count: int, seed: int) -> torch.Tensor:
    """Rotations (count, 3, 3) of any kind."""
    vectors, ups = torch.randn(2, count, 3, generator=torch.Generator().manual_seed(seed))
    return look_at(vectors, ups)


@pytest.fixture
def batch() -> Batch:
    images = torch.rand(OBJECTS * VIEWS, 4, 32, 32, generator=torch.Generator().manual_seed(1))
    return Batch(images[::VIEWS], images, rotations(len(images), 2))


def network(**overrides):
    torch.manual_seed(0)
    config = make_config("relative_pose", profile="smoke", **overrides)
    return registry.make("relative_pose", config.model).eval()


@pytest.mark.parametrize("in_plane", [False, True])
def test_the_frame_of_each_object_makes_no_difference(batch, in_plane):
    model, generator = network(in_plane=in_plane), torch.Generator()
    turns = rotations(OBJECTS, 3).repeat_interleave(VIEWS, 0)  # one for all views of an object
    turned = Batch(batch.first, batch.images, turns @ batch.world_from_camera)
    losses = [model.losses(each, 0.0, generator)["relative"] for each in (batch, turned)]
    assert losses[0].item() == pytest.approx(losses[1].item(), rel=1e-5)
    other = Batch(batch.first, batch.images, rotations(OBJECTS * VIEWS, 3) @ batch.world_from_camera)
    assert model.losses(other, 0.0, generator)["relative"].item() != pytest.approx(losses[0].item(), rel=1e-3)


def test_each_pair_of_an_object_is_compared_once():
    frames = rotations(6, 0).unflatten(0, (2, 3))
    found = relative(frames)
    expected = [[each[i].T @ each[j] for i, j in ((0, 1), (0, 2), (1, 2))] for each in frames]
    assert torch.allclose(found, torch.stack([torch.stack(each) for each in expected]), atol=1e-6)


@pytest.mark.parametrize("raw", [-30.0, -3.0, 0.0, 2.0])
def test_the_loss_of_right_predictions_is_the_logarithm_of_the_scale(raw, batch, monkeypatch):
    model = network()
    angles = torch.tensor([[a, e] for a in (0.0, 100.0, 200.0) for e in (-10.0, 0.0, 20.0, 35.0)])
    vectors = view_vector(*angles.unbind(1))
    quarter = look_at(view_vector(torch.tensor(90.0), torch.tensor(0.0)))  # any rotation of the world
    monkeypatch.setattr(model, "forward", lambda images: (vectors, None, torch.full((len(images),), raw)))
    right = Batch(batch.first, batch.images, quarter @ look_at(vectors))
    scale = FLOOR + math.log1p(math.exp(2 * raw))
    assert model.losses(right, 0.0, torch.Generator())["relative"].item() == pytest.approx(math.log(scale), abs=1e-3)
    distance = (relative(look_at(vectors).unflatten(0, (OBJECTS, VIEWS))) - torch.eye(3)).flatten(-2).norm(dim=-1)
    still = Batch(batch.first, batch.images, torch.eye(3).expand(OBJECTS * VIEWS, 3, 3))
    expected = math.log(scale) + math.sqrt(2) * distance.mean().item() / scale
    assert model.losses(still, 0.0, torch.Generator())["relative"].item() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("in_plane", [False, True])
def test_up_is_predicted_on_request(batch, in_plane):
    found = network(in_plane=in_plane).viewpoint(batch.images[:, :3])
    assert found.vectors.shape == (OBJECTS * VIEWS, 1, 3)
    assert (found.ups is not None) is in_plane


def test_one_view_of_each_object_is_refused(batch):
    with pytest.raises(ViewnetError, match="targets_per_object"):
        network().losses(Batch(batch.images, batch.images, batch.world_from_camera), 0.0, torch.Generator())
