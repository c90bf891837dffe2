"""MVC: its camera, its costs, its heads, its selection and its adversary, on worlds whose answers are known."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.boxes import PERSPECTIVE, SYMMETRIC, box_mesh, box_store, box_volume
from safetensors.torch import load_file
from scipy.spatial.transform import Rotation

from viewnet.config import RunConfig
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.geometry import look_at, rotation_angle, view_vector
from viewnet.peers import registry
from viewnet.peers.mvc import BACKGROUND, MVC, quaternion
from viewnet.peers.peer import Batch
from viewnet.recipes import make_config
from viewnet.render import render_mesh
from viewnet.runs.run_store import ensure
from viewnet.training.train_peer import train_peer

pytestmark = pytest.mark.usefixtures("one_thread")


def config(**overrides) -> RunConfig:
    return make_config("mvc", profile="smoke", **overrides)


@pytest.fixture
def model() -> MVC:
    torch.manual_seed(0)
    return MVC(config().model)


def masks(azimuth: torch.Tensor, elevation: torch.Tensor) -> torch.Tensor:
    """Images (V, 4, 32, 32) of the boxes as a mesh: white, and their mask."""
    rgba = render_mesh(box_mesh(SYMMETRIC), azimuth.numpy(), elevation.numpy(), 32, 4)
    return torch.from_numpy(rgba[..., 3] / 255).float()[:, None].expand(-1, 4, -1, -1)


# The camera and the cost


def test_the_camera_is_that_of_the_renders(model):
    assert float(model.focal) == pytest.approx(PERSPECTIVE)
    azimuth, elevation = torch.tensor([20.0, 140.0, 275.0]), torch.tensor([-15.0, 10.0, 35.0])
    images = masks(azimuth, elevation)
    right = model.view_costs(box_volume(SYMMETRIC, 48), azimuth, elevation, images)
    assert (right < 0.15 * images[:, 3].mean((1, 2))).all()  # edges of voxels
    for off in (torch.tensor([15.0, 0.0]), torch.tensor([0.0, 15.0])):
        wrong = model.view_costs(box_volume(SYMMETRIC, 48), azimuth + off[0], elevation + off[1], images)
        assert (wrong > right).all()


@pytest.mark.parametrize("occupancy", [0.0, 1.0])
def test_a_ray_costs_what_it_stops_or_passes_wrongly(model, occupancy):
    images = masks(torch.tensor([0.0, 90.0]), torch.tensor([0.0, 30.0]))
    voxels = torch.full((1, 4, 20, 20, 20), occupancy)
    # From the front at f = 0.27 a full cube, whose near face is enlarged, fills the image.
    cost = model.view_costs(voxels, torch.zeros(2), torch.zeros(2), images)
    covered = images[:, 3].mean((1, 2))
    assert torch.allclose(cost, BACKGROUND * (1 - covered) if occupancy else covered, atol=1e-4)


def test_viewpoints_are_found_from_masks_alone(model):
    true = torch.tensor([33.0, 118.0, 250.0, 320.0]), torch.tensor([30.0, 20.0, 25.0, 15.0])  # (4,) each
    images = masks(*true).repeat_interleave(8, 0)  # (32, 4, 32, 32), a head each
    azimuth = (torch.arange(8) * 45.0).repeat(4).requires_grad_()  # as heads start
    elevation = torch.full((32,), 10.0, requires_grad=True)
    solid = box_volume(SYMMETRIC, 32)
    optimiser = torch.optim.Adam([azimuth, elevation], lr=2.0)
    for _ in range(60):
        cost = model.view_costs(solid, azimuth, elevation, images)  # (32,)
        optimiser.zero_grad()
        cost.sum().backward()
        optimiser.step()
    best = cost.detach().view(4, 8).argmin(1)[:, None]  # (4, 1)
    found = [each.detach().view(4, 8).gather(1, best)[:, 0] for each in (azimuth, elevation)]  # (4,) each
    errors = rotation_angle(look_at(view_vector(*found)), look_at(view_vector(*true)))
    assert errors.max() < 6


# The heads


def test_heads_start_evenly_apart_and_level(model):
    azimuth, elevation, logits = model.eval().angles(torch.rand(16, 3, 32, 32))
    apart = (azimuth - 180 - torch.arange(8) * 45 + 180) % 360 - 180
    assert apart.abs().max() < 40
    assert (elevation - 10).abs().max() < 10
    assert logits.softmax(1).max() < 0.3


def test_predictions_are_viewpoints_of_the_known_distribution(model):
    with torch.no_grad():
        model.pose[-2].weight.mul_(1000)  # as far as heads can go
    vectors = model.eval().viewpoint(torch.rand(16, 3, 32, 32)).vectors
    elevation = torch.rad2deg(vectors[..., 2].asin())
    assert vectors.norm(dim=-1).allclose(torch.ones(16, 8))
    assert elevation.min() > -20.01
    assert elevation.max() < 40.01


def test_mvc_needs_the_cameras_views(model):
    with pytest.raises(ViewnetError, match="crop square"):
        MVC(config(crop="square").model)


# What the terms of the loss teach


def known_world(model: MVC, monkeypatch, logits: torch.Tensor, costs: torch.Tensor) -> None:
    """Heads that stay 45 degrees apart with these logits (M,), and what each of them costs (M,)."""

    def angles(images):
        azimuth = (torch.arange(8) * 45.0).expand(len(images), -1)
        return azimuth, torch.full_like(azimuth, 10.0), logits.expand(len(images), -1)

    monkeypatch.setattr(model, "angles", angles)
    monkeypatch.setattr(model, "view_costs", lambda _, azimuth, *__: costs[(azimuth / 45).round().long()])
    with torch.no_grad():
        model.adversary[-1].weight.zero_()  # every viewpoint is as likely as any other


@pytest.mark.parametrize("baseline", [0.0, 0.4])
def test_reinforce_is_the_gradient_of_the_expected_cost(model, monkeypatch, baseline):
    logits = torch.tensor([0.0, 1.0, -1.0, 0.5, 0.0, 0.3, -0.5, 0.8], requires_grad=True)
    costs = torch.tensor([0.9, 0.1, 0.5, 0.3, 0.7, 0.2, 0.4, 0.6])
    known_world(model, monkeypatch, logits, costs)
    model.baseline.fill_(baseline)
    batch = Batch(torch.zeros(2, 4, 32, 32), torch.zeros(40000, 4, 1, 1))
    terms = model.losses(batch, 0.0, torch.Generator().manual_seed(0))
    (found,) = torch.autograd.grad(terms["selection"], logits)
    (exact,) = torch.autograd.grad((logits.softmax(0) * costs).sum(), logits)
    assert (found - exact).abs().max() < 0.15 * exact.abs().max()
    assert terms["view"].item() == pytest.approx((logits.softmax(0) * costs).sum().item(), abs=0.01)
    cost = float(terms["view"] + terms["prior"])
    assert float(model.baseline) == pytest.approx(0.95 * baseline + 0.05 * cost, abs=1e-4)


def test_validation_takes_the_likeliest_head_and_changes_nothing(model, monkeypatch):
    logits, costs = torch.tensor([0.0, 0, 0, 0, 0, 9, 0, 0]), torch.arange(8.0)
    known_world(model, monkeypatch, logits, costs)
    terms = model.eval().losses(Batch(torch.zeros(2, 4, 32, 32), torch.zeros(64, 4, 1, 1)), 1.0, torch.Generator())
    assert float(terms["view"]) == 5.0
    assert float(model.baseline) == 0


def test_the_adversary_and_what_it_judges_learn_apart(model):
    batch = Batch(torch.rand(4, 4, 32, 32), torch.rand(12, 4, 32, 32))
    terms = model.losses(batch, 0.0, torch.Generator().manual_seed(0))

    def taught(term: str) -> set[str]:
        grads = torch.autograd.grad(terms[term], list(model.parameters()), retain_graph=True, allow_unused=True)
        names = [name.split(".")[0] for name, _ in model.named_parameters()]
        return {name for name, grad in zip(names, grads, strict=True) if grad is not None and grad.any()}

    assert {term: taught(term) for term in terms} == {
        "view": {"shape", "decoder", "pose"},
        "prior": {"pose"},
        "selection": {"pose"},
        "adversary": {"adversary"},
    }


def test_the_adversary_pulls_predictions_to_the_known_distribution(model):
    azimuth = torch.full((64,), 90.0, requires_grad=True)  # all from one side
    optimiser = torch.optim.Adam([{"params": model.adversary.parameters(), "lr": 0.02}])
    generator = torch.Generator().manual_seed(0)
    for _ in range(150):
        told = model.prior(azimuth.detach(), torch.full((64,), 10.0), generator)[1]
        optimiser.zero_grad()
        told.mean().backward()
        optimiser.step()
    elevation = torch.full((3,), 10.0)
    unlikely = model.prior(torch.tensor([90.0, 200.0, 300.0]), elevation, generator)[0].detach()
    assert unlikely[0] > 2 * unlikely[1:].max()


def test_quaternions_are_the_rotations_of_viewpoints():
    azimuth, elevation = torch.tensor([0.0, 77.0, 190.0, 359.0]), torch.tensor([-20.0, 0.0, 15.0, 40.0])
    rotations = Rotation.from_quat(quaternion(azimuth, elevation).numpy(), scalar_first=True)
    assert np.allclose(rotations.apply([1, 0, 0]), view_vector(azimuth, elevation).numpy(), atol=1e-6)
    assert np.allclose(rotations.apply([0, 1, 0])[:, 2], 0, atol=1e-6)  # no tilt


# Training as a whole


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> ViewStore:
    return box_store(tmp_path_factory.mktemp("views") / "boxes", {"train": 6, "val": 3, "test": 2}, views=4)


SMALL = {"epochs": 2, "batch_size": 9, "encoder_channels": (8, 8, 8, 8, 8), "generator_channels": (8, 8)}


def trained(store: ViewStore, folder: Path) -> tuple[dict[str, torch.Tensor], list[dict[str, str]]]:
    """Weights and log, but for the time it took, of two epochs of two steps."""
    train_peer(config(**SMALL), store, folder, threads=1, progress=False)
    with (folder / "log.csv").open(newline="") as file:
        rows = [{name: value for name, value in row.items() if name != "seconds"} for row in csv.DictReader(file)]
    return load_file(folder / "checkpoint.safetensors"), rows


def test_a_killed_training_goes_on_to_the_same_bits(store, tmp_path, monkeypatch):
    weights, rows = trained(store, tmp_path / "whole")
    losses, left = MVC.losses, iter(range(3))

    def dying(self, *arguments):
        if self.training and next(left, None) is None:
            raise KeyboardInterrupt
        return losses(self, *arguments)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(MVC, "losses", dying)
        trained(store, tmp_path / "killed")
    torch.manual_seed(12345)  # whatever else has been going on
    resumed, again = trained(store, tmp_path / "killed")
    assert again == rows
    assert len(rows) == 2
    assert resumed.keys() == weights.keys()
    assert all(torch.equal(resumed[name], weights[name]) for name in weights)
    assert weights["baseline"] > 0  # kept, as it is a part of what goes on


def test_a_run_is_trained_scored_and_loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    (run,) = ensure([config(models=20, **SMALL)], workers=1, progress=False)
    assert (run.folder / "result.json").is_file()
    network, again = registry.load(run.folder)
    assert isinstance(network, MVC)
    assert again == run.config
    assert network.viewpoint(torch.rand(2, 3, 32, 32)).vectors.shape == (2, 8, 3)
