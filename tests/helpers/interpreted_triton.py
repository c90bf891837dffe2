"""The kernels' logic, run by Triton's interpreter on the CPU, in a process that test_volume_triton starts.

Triton decides for or against its interpreter when it is imported, so pytest does not collect this file by itself.
"""

from __future__ import annotations

import os

import pytest
import torch
import triton.language as tl
from helpers.volumes import CASES, Case, check_against_definition, gradients
from hypothesis import Phase, given, settings
from triton.runtime import interpreter

from viewnet.model.kernels import volume_cpu, volume_gpu, volume_numba, volume_triton

assert os.environ.get("TRITON_INTERPRET") == "1", "to be run by test_volume_triton.py"


def speed_up_the_interpreter() -> None:
    """Minutes become seconds, with the same results.

    At every call of one kernel function by another the interpreter wraps the whole language again, around the wrappers
    that are there already: each call is slower than the last. Once is enough. Nor is every sum of two integers worth a
    check that it has not overflowed.
    """
    patch, done = interpreter._patch_lang, set()

    def patch_once(function):
        languages = frozenset(id(x) for x in function.__globals__.values() if x is tl or x is tl.core)
        if languages not in done:
            done.add(languages)
            patch(function)
        return interpreter._LangPatchScope()

    interpreter._patch_lang = patch_once
    object.__setattr__(interpreter.interpreter_builder.options, "sanitize_overflow", False)


speed_up_the_interpreter()


def render(voxels, frames, focal, size, steps, sparse=False):
    return volume_gpu.render(voxels, frames, focal, size, steps, sparse)


@pytest.fixture(autouse=True, scope="module")
def larger_tiles():
    """An image of up to 8 x 8 pixels in one program: the interpreter's time goes by programs."""
    volume_gpu.CHOICES.update(draw=((2, 2),), draw_backward=((2, 2),))


HAZE = Case((5, 7, 9), volumes=1, share=2, size=6, steps=7, focal=0.3, solid=False, seed=0)
SOLID = Case((6, 5, 4), volumes=2, share=1, size=7, steps=9, focal=0.5, solid=True, seed=1)
FLAT = Case((3, 9, 4), volumes=1, share=1, size=9, steps=3, focal=0.0, solid=True, seed=2)


@pytest.mark.parametrize("case", [SOLID, FLAT], ids=["solid", "flat"])
def test_the_kernels_are_the_definition(case):
    check_against_definition(render, case)


FIND = (Phase.explicit, Phase.generate)  # an example takes seconds, so there is no shrinking


@pytest.mark.slow
@settings(max_examples=25, phases=FIND)
@given(CASES)
def test_the_kernels_are_the_definition_of_whatever_is_drawn(case):
    check_against_definition(render, case)


@pytest.mark.slow
@settings(max_examples=8, phases=FIND)
@given(CASES)
def test_view_vectors_get_the_gradients_of_the_definition_whatever_is_drawn(case):
    check_against_definition(render, case, by_vector=True)


def test_an_opaque_voxel_hides_all_the_same_whatever_is_behind_it():
    """Straight through a row of voxels, the nearest opaque: its gradient is colour in front minus colour behind."""
    voxels = torch.zeros(1, 4, 6, 1, 1)
    voxels[0, 0] = torch.tensor([0.9, 0.8, 0.3, 0.7, 0.5, 0.2])[:, None, None]
    voxels[0, 3] = torch.tensor([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])[:, None, None]
    inputs, red = [voxels, torch.eye(3)[None], torch.tensor(0.0)], torch.zeros(1, 4, 1, 1)
    red[:, 0] = 1
    image, (grad, _, _) = gradients(lambda v, r, f: render(v, r, f, 1, 6), inputs, red)
    assert image[0, :, 0, 0].tolist() == pytest.approx([0.2, 0, 0, 1])
    # The camera is on the side of +z: only the last voxel is seen, and behind it the one before.
    assert grad[0, 3, :, 0, 0].tolist() == pytest.approx([0, 0, 0, 0, 0, 0.2 - 0.5], abs=1e-6)


def test_sparse_leaves_out_what_the_processors_renderer_leaves_out():
    (voxels, frames, focal), weights = Case((8, 9, 7), 2, 1, 7, 9, 0.3, False, 3).inputs()
    voxels[:, 3] *= torch.rand(voxels[:, 3].shape, generator=torch.Generator().manual_seed(0)) < 0.04
    inputs = [voxels, frames, focal]
    image, found = gradients(lambda v, r, f: render(v, r, f, 7, 9, True), inputs, weights)
    wanted, expected = gradients(lambda v, r, f: volume_cpu.render(v, r, f, 7, 9, True), inputs, weights)
    _, full = gradients(lambda v, r, f: render(v, r, f, 7, 9, False), inputs, weights)
    assert torch.allclose(image, wanted, atol=1e-6)
    assert all(torch.allclose(a, b, atol=1e-5) for a, b in zip(found, expected, strict=True))
    left_out = (found[0][:, 3] == 0) & (full[0][:, 3] != 0)
    assert 0.02 < left_out.float().mean() < 0.98


def test_views_of_one_volume_share_it():
    check_against_definition(render, HAZE, by_vector=True)


def test_pixels_without_gradient_give_none():
    (voxels, frames, focal), weights = HAZE.inputs()
    _, grads = gradients(lambda v, r, f: render(v, r, f, 6, 7), [voxels, frames, focal], 0 * weights)
    assert not any(grad.any() for grad in grads)


@pytest.mark.parametrize("warps, chunk", [(1, 1), (4, 4)])
def test_tiles_and_chunks_do_not_change_the_image(warps, chunk, monkeypatch):
    (voxels, frames, focal), _ = FLAT.inputs()
    wanted = render(voxels, frames, focal, 9, 3)
    monkeypatch.setitem(volume_gpu.CHOICES, "draw", ((warps, chunk),))
    volume_gpu.kernel.cache_clear()
    assert torch.equal(render(voxels, frames, focal, 9, 3), wanted)
    volume_gpu.kernel.cache_clear()


def test_any_memory_layout_is_read():
    (voxels, frames, focal), _ = SOLID.inputs()
    wanted = render(voxels, frames, focal, 4, 5)
    last = voxels.contiguous(memory_format=torch.channels_last_3d)
    assert torch.equal(render(last, frames, focal, 4, 5), wanted)
    turned = frames.transpose(1, 2).contiguous().transpose(1, 2)
    assert torch.equal(render(voxels, turned, focal, 4, 5), wanted)


def test_both_renderers_stop_at_the_same_darkness():
    assert volume_triton.OPAQUE.value == pytest.approx(float(volume_numba.OPAQUE))
