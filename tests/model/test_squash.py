"""From the generator's logits to volumes (Q = S + Q' of section 3.3): compiled, and in plain PyTorch."""

from __future__ import annotations

import pytest
import torch

from viewnet.geometry import look_at, view_vector
from viewnet.model import volume
from viewnet.model.kernels import numba_call, volume_cpu, volume_numba, voxels_numba
from viewnet.model.networks import gaussian_prior


@pytest.fixture(params=[True, False], ids=["compiled", "plain"])
def squash(request, monkeypatch):
    if not request.param:
        monkeypatch.setattr(numba_call, "available", lambda: False)
    return volume.squash


def squashed_step_by_step(blocks, prior):
    """By automatic differentiation alone: no gradient outside [0, 1]."""
    values = torch.sigmoid(volume.joined(blocks))
    return torch.cat([values[:, :3], (2 * values[:, 3:] - 1 + prior).clamp(0, 1)], 1)


def random_blocks(side):
    generator = torch.Generator().manual_seed(0)
    places = (6 // side,) * 3
    return torch.randn(2, *places, *[side] * 3, 4, generator=generator)


def test_blocks_are_joined_place_by_place():
    blocks = torch.arange(2 * 3 * 8 * 4).view(1, 1, 2, 3, 2, 2, 2, 4)
    voxels = volume.joined(blocks)
    assert voxels.shape == (1, 4, 2, 4, 6)
    for z, y, x in [(0, 0, 0), (1, 2, 5), (0, 3, 1), (1, 1, 4)]:
        assert torch.equal(voxels[0, :, z, y, x], blocks[0, z // 2, y // 2, x // 2, z % 2, y % 2, x % 2])


@pytest.mark.parametrize("side", [1, 2])
def test_squashing_is_what_its_formula_says(squash, side):
    blocks, generator = random_blocks(side), torch.Generator().manual_seed(1)
    weights = torch.randn(2, 4, 6, 6, 6, generator=generator)
    prior, gradients, values = 0.7 * gaussian_prior(6, 0.5), [], []
    before = blocks.clone()
    for way in (squashed_step_by_step, squash):
        x = blocks.clone().requires_grad_()
        values.append(way(x, prior))
        (values[-1] * weights).sum().backward()
        gradients.append(volume.joined(x.grad))
    assert torch.equal(blocks, before)
    assert torch.allclose(*values, atol=1e-6)
    inside = (values[0] > 0) & (values[0] < 1)
    assert 0.2 < inside[:, 3].float().mean() < 0.9
    assert torch.allclose(gradients[0][inside], gradients[1][inside], atol=1e-6)


def test_an_emptied_voxel_still_takes_the_gradient_that_fills_it(squash):
    logits = torch.tensor([-2.0, -2.0, 1.0, 1.0, 3.0, 3.0])
    x = torch.zeros(1, 1, 1, 6, 1, 1, 1, 4)
    x[..., 3] = logits.view(1, 1, 1, 6, 1, 1, 1)
    x.requires_grad_()
    kept = squash(x, torch.tensor([0.0, 0.0, 0.0, 0.0, 0.5, 0.5]).view(1, 1, 6))
    assert kept[0, 3, 0, 0, [0, 1, 4, 5]].tolist() == [0, 0, 1, 1]
    kept[0, 3, 0, 0].backward(torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]))
    slope = 0.5 * (1 - torch.tanh(logits / 2).square())
    wanted = slope * torch.tensor([0, -1, 1, -1, 1, 0])  # descent: inwards, or anywhere from inside
    assert torch.allclose(x.grad[..., 3].flatten(), wanted, atol=1e-6)


def test_half_precision_logits_give_full_precision_volumes(squash):
    blocks = random_blocks(2).bfloat16().requires_grad_()
    found = squash(blocks, None)
    assert found.dtype == torch.float32
    assert torch.allclose(found, squash(blocks.float(), None), atol=1e-6)
    found.sum().backward()
    assert blocks.grad.dtype == torch.bfloat16


def test_a_squashed_volume_is_drawn_where_it_lies():
    shape = volume.squash(random_blocks(2), gaussian_prior(6, 0.5))
    assert volume_cpu.padded(shape, empty=True).untyped_storage().data_ptr() == shape.untyped_storage().data_ptr()
    frames = look_at(view_vector(torch.tensor([20.0, 200.0]), torch.tensor([10.0, 30.0])))
    there = volume.render(shape, frames, torch.tensor(0.3), 8)
    assert torch.equal(there, volume.render(shape.contiguous(), frames, torch.tensor(0.3), 8))


def test_the_inside_of_a_larger_volume_is_cut_out_of_it():
    """It lies in memory as a framed one does, but the voxels around it are no part of it."""
    larger = torch.rand(2, 8, 8, 8, 4, generator=torch.Generator().manual_seed(0)).permute(0, 4, 1, 2, 3)
    inside = larger[:, :, 1:-1, 1:-1, 1:-1]
    frames = look_at(view_vector(torch.tensor([20.0, 200.0]), torch.tensor([10.0, 30.0])))
    focal = torch.tensor(0.3)
    assert torch.equal(
        volume.render(inside, frames, focal, 8),
        volume.render(inside.clone(memory_format=torch.contiguous_format), frames, focal, 8),
    )
    assert torch.allclose(
        volume.render(inside, frames, focal, 8), volume.render_reference(inside, frames, focal, 8, 8), atol=1e-5
    )


def test_numba_s_cache_tells_the_threaded_kernels_from_the_others():
    """It is keyed by name and place, not by options, so one would be loaded for the other."""
    walking = [volume_numba.forward, volume_numba.compare, volume_numba.backward]
    for versions in (*walking, voxels_numba.occupied, voxels_numba.squash, voxels_numba.squash_backward):
        assert versions[False].py_func.__qualname__ != versions[True].py_func.__qualname__
        assert versions[True].targetoptions.get("parallel")
        assert not versions[False].targetoptions.get("parallel")


@pytest.mark.parametrize("threads", [1, 2])
def test_drawing_leaves_pytorch_its_number_of_threads(threads):
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(threads)
        volume_cpu.warm_up()
        assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
