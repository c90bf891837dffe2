"""Pointcloud: its camera is the renderer's, its silhouettes find poses, and the best candidate alone learns."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from helpers.boxes import box_store
from safetensors.torch import load_file

from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.geometry import look_at, rotation_angle, view_vector
from viewnet.peers import pointcloud, registry
from viewnet.peers.peer import Batch
from viewnet.peers.pointcloud import Pointcloud, blur, distance, draw, project, rotation, silhouette, splat
from viewnet.recipes import make_config
from viewnet.render import camera
from viewnet.runs import run_store
from viewnet.runtime.images import resize
from viewnet.training import train_peer as training
from viewnet.training.train_peer import train_peer

SMALL = {"profile": "smoke", "code_size": 32, "volume_size": 16, "epochs": 2, "validate_every": 1, "patience": 9}


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def quaternions(count: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(count, 4, generator=seeded(seed))


def cloud() -> torch.Tensor:
    """A chair without symmetry but left and right: seat, back, and an arm that breaks that as well. (P, 3)."""
    points = torch.rand(3, 300, 3, generator=seeded()) - 0.5
    seat, back, arm = points * torch.tensor([[[0.4, 0.4, 0.08]], [[0.06, 0.4, 0.4]], [[0.3, 0.06, 0.06]]])
    return torch.cat([seat, back + torch.tensor([-0.2, 0, 0.2]), arm + torch.tensor([0.0, 0.2, 0.15])])


def views(count: int, seed: int = 0) -> torch.Tensor:
    """Images of grey rectangles, RGB times mask and mask: (count, 4, 32, 32)."""
    images = torch.zeros(count, 4, 32, 32)
    for image, (width, height) in zip(images, torch.randint(4, 14, (count, 2), generator=seeded(seed)), strict=True):
        image[:3, 16 - height : 16 + height, 16 - width : 16 + width] = 0.5
        image[3, 16 - height : 16 + height, 16 - width : 16 + width] = 1.0
    return images


@pytest.fixture
def model() -> Pointcloud:
    torch.manual_seed(0)
    return Pointcloud(make_config("pointcloud", **SMALL).model)


# The camera and the grid


def test_points_are_seen_where_the_renderers_camera_sees_them():
    turns, points = quaternions(5), 0.5 * (torch.rand(40, 3, generator=seeded()) - 0.5)
    places = project(points.expand(5, -1, -1), turns)
    columns_rows = camera.project(points.double().numpy(), rotation(turns).double().numpy())
    assert np.allclose(places[..., [2, 1]], columns_rows, atol=1e-6)
    nearness = torch.einsum("pi,ni->np", points, rotation(turns)[..., 2])  # along the axis to the camera
    assert torch.allclose(places[..., 0], 0.5 - nearness, atol=1e-6)


def test_any_length_and_sign_of_a_quaternion_is_one_rotation():
    turns = quaternions(6)
    frames = rotation(turns)
    assert torch.allclose(frames @ frames.mT, torch.eye(3).expand(6, 3, 3), atol=1e-6)
    assert torch.allclose(torch.linalg.det(frames), torch.ones(6), atol=1e-6)
    assert torch.allclose(rotation(-3 * turns), frames, atol=1e-6)


@pytest.mark.parametrize("size", [8, 12])
def test_a_grid_holds_each_point_once_around_its_place(size):
    places = 0.1 + 0.8 * torch.rand(3, 7, 3, generator=seeded())
    grids = splat(places, size)
    assert torch.allclose(grids.sum((1, 2, 3)), torch.full((3,), 7.0), atol=1e-5)
    centres = (torch.arange(size) + 0.5) / size
    alone = splat(places[:, :1], size)
    for axis in range(3):
        mass = alone.sum([d for d in (1, 2, 3) if d != axis + 1])  # (3, n)
        assert torch.allclose(mass @ centres, places[:, 0, axis], atol=1e-5)


def test_points_beyond_the_cube_are_left_out_without_gradient():
    places = torch.tensor(
        [[[0.5, 0.5, 0.5], [1.01, 0.5, 0.5], [0.5, -0.2, 0.5], [0.5, 0.5, 0.999]]], requires_grad=True
    )
    grid = splat(places, 8)
    assert grid.sum().item() == pytest.approx(2.0)
    grid.square().sum().backward()
    assert not places.grad[0, 1:3].any() and places.grad.isfinite().all()


def test_the_compiled_splat_is_pytorchs(monkeypatch):
    places = torch.rand(2, 200, 3, generator=seeded()) * 1.2 - 0.1
    places[0, 0], places[0, 1] = 0.0, 1.0  # corners of the cube
    found, wanted = [], torch.rand(2, 9, 9, 9, generator=seeded(1))
    for compiled in (True, False):
        monkeypatch.setattr(pointcloud.numba_call, "available", lambda compiled=compiled: compiled)
        moved = places.clone().requires_grad_()
        grids = splat(moved, 9)
        (grids * wanted).sum().backward()
        found.append((grids.detach(), moved.grad))
    for one, two in zip(*found, strict=True):
        assert torch.allclose(one, two, atol=1e-5)


@pytest.mark.parametrize("sigma", [0.1, 0.8, 1.5])
def test_a_blur_moves_mass_and_keeps_it(sigma):
    grid = torch.zeros(1, 17, 17, 17)
    grid[0, 8, 8, 8] = 1.0
    blurred = blur(grid, sigma)
    assert blurred.sum().item() == pytest.approx(1.0, abs=1e-4)
    away = (torch.arange(17.0) - 8) ** 2
    for axes in ((2, 3), (1, 3), (1, 2)):
        spread = (blurred.sum(axes)[0] @ away).item()
        assert spread == pytest.approx(sigma**2 if sigma > 0.5 else 0.0, rel=0.02, abs=1e-6)


def test_a_silhouette_is_what_a_ray_stops_at_anywhere():
    grid = torch.zeros(1, 4, 4, 4)
    grid[0, 0, 1, 2], grid[0, 3, 1, 2], grid[0, 2, 0, 0] = 0.5, 0.25, 7.0  # the last one is clipped to 1
    mask = silhouette(grid, torch.tensor([0.8]), 0.05)
    expected = torch.zeros(1, 4, 4)
    expected[0, 1, 2], expected[0, 0, 0] = 1 - (1 - 0.8 * 0.5) * (1 - 0.8 * 0.25), 0.8
    assert torch.allclose(mask, expected, atol=1e-5)


# Learning


def test_masks_of_known_points_tell_their_poses():
    turns, points = quaternions(6), cloud().expand(6, -1, -1)
    scales = torch.ones(6)
    masks = silhouette(splat(project(points, turns), 24), scales, 0.5)
    found = torch.nn.functional.normalize(turns, dim=1) + 0.17 * quaternions(6, seed=1)
    start = rotation_angle(rotation(found), rotation(turns))
    assert start.min() > 8
    found.requires_grad_()
    optimiser = torch.optim.Adam([found], lr=0.03)
    for step in range(60):
        optimiser.zero_grad()
        distance(points, found, scales, masks, 1.2 - 0.7 * step / 60).sum().backward()
        optimiser.step()
    assert rotation_angle(rotation(found), rotation(turns)).max() < 3


def test_candidates_draw_points_of_their_own():
    drawn = draw(50, 20, 2000, seeded())
    assert all(len(set(row)) == 20 for row in drawn[:50].tolist())
    assert len({tuple(sorted(row)) for row in drawn.tolist()}) > 40
    shares = torch.bincount(drawn.flatten(), minlength=50) / 2000
    assert shares.min() > 0.35 and shares.max() < 0.45
    assert sorted(draw(50, 50, 1, seeded())[0].tolist()) == list(range(50))


def test_the_best_candidate_alone_learns_and_the_student_from_it(model, monkeypatch):
    found, batch = quaternions(8 * 5).unflatten(0, (8, 5)).requires_grad_(), Batch(views(2, 1), views(6, 2))
    features = torch.randn(8, 32, generator=seeded(3))
    monkeypatch.setattr(model, "quaternions", lambda images: (features, found))
    terms = model.losses(batch, 1.0, seeded())  # all points: drawing changes nothing
    points, scales = model.decode(features[:2])
    owner, masks = (
        torch.tensor([0, 1, 0, 0, 0, 1, 1, 1]),
        resize(torch.cat([batch.first, batch.images])[:, 3:], 16)[:, 0],
    )
    errors = torch.stack(
        [distance(points[owner], found[:, c], scales[owner], masks, pointcloud.BLUR[1] / 4) for c in range(1, 5)], 1
    )
    assert terms["silhouette"].item() == pytest.approx(errors.min(1).values.mean().item(), rel=1e-4)
    (grad,) = torch.autograd.grad(terms["silhouette"], found, retain_graph=True)
    learns = grad.abs().sum(2) > 0
    assert torch.equal(learns[:, 1:], torch.nn.functional.one_hot(errors.argmin(1), 4).bool())
    assert not learns[:, 0].any()
    (grad,) = torch.autograd.grad(terms["student"], found)
    assert (grad.abs().sum(2) > 0).all(0).tolist() == [True, False, False, False, False]
    assert not grad[:, 1:].any()


@pytest.mark.parametrize("factor", [1.0, -2.0])
def test_a_student_that_agrees_has_no_loss(model, monkeypatch, factor):
    one = quaternions(4)[:, None]
    found = torch.cat([factor * one, one.expand(-1, 4, -1)], 1)
    monkeypatch.setattr(model, "quaternions", lambda images: (torch.zeros(4, 32), found))
    assert model.losses(Batch(views(1), views(3)), 0.5, seeded())["student"].item() == pytest.approx(0.0, abs=1e-5)


def test_both_anneals_run_from_the_first_step_to_the_last(model, monkeypatch):
    seen = []

    def noted(points, quaternions, scales, masks, sigma):
        seen.append((points.shape[1], round(sigma, 3)))
        return distance(points, quaternions, scales, masks, sigma)

    monkeypatch.setattr(pointcloud, "distance", noted)
    for progress in (0.0, 0.5, 1.0):
        model.losses(Batch(views(1), views(3)), progress, seeded())
    few, all_points = round(pointcloud.KEPT[0] * model.points), model.points
    assert list(dict.fromkeys(seen)) == [(few, 0.375), (round((few + all_points) / 2), 0.212), (all_points, 0.05)]


def test_decay_is_the_gradient_of_half_the_squared_weights(model):
    weights, biases = model.parameter_groups(0.1)
    assert {id(p) for group in (weights, biases) for p in group["params"]} == {id(p) for p in model.parameters()}
    assert all(p.dim() == 1 for p in biases["params"])
    assert weights["weight_decay"] == pytest.approx(pointcloud.DECAY / 16) and "weight_decay" not in biases


def test_candidates_start_level_and_evenly_around_the_object(model):
    for head in model.last[1:]:
        torch.nn.init.zeros_(head.weight)  # what depends on the image
    frames = model.viewpoint(model.composite(views(2))).world_from_camera[:, 1:]
    expected = look_at(view_vector(torch.tensor([0.0, 90.0, 180.0, 270.0]), torch.zeros(4)))
    assert torch.allclose(frames, expected.expand_as(frames), atol=1e-5)


def test_the_student_is_the_prediction(model):
    images = model.composite(views(3))
    assert images[:, :, 0, 0].eq(1).all()  # on white
    found = model.viewpoint(images)
    assert found.vectors.shape == (3, 5, 3)
    assert found.logits.argmax(1).tolist() == [0, 0, 0]
    turns = model.quaternions(images)[1]
    assert torch.allclose(found.world_from_camera, rotation(turns), atol=1e-5)  # the frame that `project` sees from


@pytest.mark.parametrize("changes", [{"heads": 1}, {"encoder_channels": (8, 16)}])
def test_settings_that_make_no_network_are_refused(changes):
    with pytest.raises(ViewnetError, match=str(next(iter(changes)))):
        registry.make("pointcloud", make_config("pointcloud", **{**SMALL, **changes}).model)


# Runs


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return box_store(tmp_path_factory.mktemp("views") / "boxes", {"train": 6, "val": 3, "test": 2}, views=4)


class Killed(Exception):
    pass


def test_a_training_has_the_same_bits_killed_or_not(store, tmp_path, one_thread, monkeypatch):
    config = make_config("pointcloud", **SMALL, batch_size=6, targets_per_object=3)  # four steps an epoch
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    train_peer(config, store, whole, progress=False)
    left, losses = iter(range(6)), Pointcloud.losses

    def dying(self, batch, progress, generator):
        if self.training and next(left, None) is None:
            raise Killed
        return losses(self, batch, progress, generator)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(Pointcloud, "losses", dying)
        train_peer(config, store, killed, progress=False)
    torch.manual_seed(9)
    training.train_peer(config, store, killed, progress=False)
    one, two = (load_file(folder / "checkpoint.safetensors") for folder in (whole, killed))
    assert all(torch.equal(one[name], two[name]) for name in one)
    network, loaded = registry.load(whole)
    assert isinstance(network, Pointcloud) and loaded == config


def test_a_run_is_trained_scored_and_predicts_for_new_images(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    config = make_config("pointcloud", "chair", **SMALL, models=15, views=4)
    (run,) = run_store.ensure([config], workers=1, progress=False)
    assert {"silhouette", "student"} <= set(run.log)
    scores = run.result["metrics"]["procrustes"]
    assert len(scores["heads"]) == 5 and math.isfinite(scores["median"])
    estimator = ViewpointEstimator.from_pretrained(run.folder)
    found = estimator.predict([np.full((32, 32, 3), 90, np.uint8)], masks=[np.ones((32, 32), bool)])
    assert len(found) == 1 and math.isfinite(found[0].azimuth)
    with pytest.raises(ViewnetError, match="pointcloud"):
        estimator.volume(np.full((32, 32, 3), 90, np.uint8))
