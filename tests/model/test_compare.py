"""Views compared without images: the choice and the errors are those of images rendered by the definition."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.volumes import random_frames, random_volume

from viewnet.geometry import look_at, view_vector
from viewnet.model import volume
from viewnet.model.kernels import numba_call, volume_cpu

FOCAL = torch.tensor(0.268)
pytestmark = pytest.mark.skipif(not numba_call.available(), reason="needs Numba")


def scene(size, sides=(8, 7, 9), volumes=2, share=2, groups=3, views=4, filled=0.2):
    """Volumes, camera frames and targets, of which the third view of the second group is the truth."""
    rng = np.random.default_rng(size)
    voxels = random_volume(volumes, sides, rng)
    voxels[:, 3] *= torch.from_numpy(rng.random(voxels[:, 3].shape) < filled)
    frames = random_frames(volumes * share * groups * views, rng).view(volumes * share, groups, views, 3, 3)
    truth = frames[:, 1 % groups, 2 % views]
    return voxels, frames, volume.render_reference(voxels, truth, FOCAL, size, size)


def by_images(voxels, frames, target, weights):
    """Errors (N, G, T) of rendered images."""
    images = volume.render_reference(voxels, frames.flatten(0, 2), FOCAL, target.shape[-1], target.shape[-1])
    off = (images.unflatten(0, frames.shape[:3]) - target[:, None, None]).square().mean((-2, -1))  # (N, G, T, 4)
    return weights[0] * off[..., :3].mean(-1) + weights[1] * off[..., 3]


@pytest.mark.parametrize("size", [4, 7, 12, 33])
@pytest.mark.parametrize("weights", [(0.1, 1.0), (0.0, 1.0), (1.0, 0.0)])
@pytest.mark.parametrize(("groups", "views"), [(3, 4), (1, 5), (4, 1)])
def test_the_best_view_and_its_error_are_those_of_rendered_images(size, weights, groups, views):
    voxels, frames, target = scene(size, groups=groups, views=views)
    wanted = by_images(voxels, frames, target, weights)
    best, errors = volume_cpu.compare(voxels, frames, FOCAL, target, weights)
    assert torch.allclose(errors, wanted.amin(2), atol=1e-5)
    assert torch.allclose(wanted.gather(2, best[..., None])[..., 0], wanted.amin(2), atol=1e-5)
    if groups > 1 and views > 1:
        assert (best[:, 1] == 2).all() and errors[:, 1].max() < 1e-5


def test_rays_beside_the_object_and_parallel_to_its_box():
    """A ray that never comes between two sides of the box leaves it, in steps, beyond any integer."""
    voxels = torch.zeros(1, 4, 16, 16, 16)
    voxels[:, :, 2:4, 11:14, 1:3] = 0.8
    azimuth = torch.arange(0.0, 360.0, 90.0)
    frames = look_at(view_vector(azimuth, torch.zeros(4)))
    for focal in (torch.tensor(0.0), FOCAL):
        wanted = volume.render_reference(voxels, frames, focal, 16, 16)
        assert torch.allclose(volume.render(voxels, frames, focal, 16), wanted, atol=1e-5)
        best, errors = volume_cpu.compare(voxels, frames[None, None], focal, wanted[1:2], (0.1, 1.0))
        assert best.item() == 1 and errors.item() < 1e-8


@pytest.mark.parametrize("views", [1, 4])
def test_a_camera_that_is_none_is_noticed(views):
    voxels, frames, target = scene(16, views=views)
    _, errors = volume_cpu.compare(voxels, frames, torch.tensor(float("nan")), target, (0.1, 1.0))
    assert errors.isnan().all()
    frames[0] = float("nan")
    _, errors = volume_cpu.compare(voxels, frames, FOCAL, target, (0.1, 1.0))
    assert errors[0].isnan().all() and errors[1:].isfinite().all()
    images = volume.render(voxels, frames[:, 0, 0], FOCAL, 16)
    assert images[0].isnan().all() and images[1:].isfinite().all()


def test_threads_do_not_change_the_choice():
    scenes = scene(12)
    before = torch.get_num_threads()
    try:
        found = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(volume_cpu.compare(scenes[0], scenes[1], FOCAL, scenes[2], (0.1, 1.0)))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(one, two) for one, two in zip(*found, strict=True))


def test_a_changed_volume_is_compared_anew():
    voxels, frames, target = scene(12)
    volume_cpu.compare(voxels, frames, FOCAL, target, (0.1, 1.0))
    voxels[:, 3] = 0
    _, errors = volume_cpu.compare(voxels, frames, FOCAL, target, (0.0, 1.0))
    assert torch.allclose(errors, target[:, 3].square().mean((1, 2))[:, None].expand_as(errors), atol=1e-6)
