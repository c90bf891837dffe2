"""The volume renderer against its definition, the mesh renderer, and the laws of light."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.boxes import PERSPECTIVE, SYMMETRIC, box_mesh, box_volume
from helpers.volumes import CASES, check_against_definition, gradients, random_frames, random_volume
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import orthogonal_procrustes

from viewnet import render as mesh_renderer
from viewnet.evaluation.alignment import fit_rotation
from viewnet.geometry import look_at, view_vector
from viewnet.model import volume
from viewnet.model.kernels import numba_call

FOCAL = torch.tensor(0.3)


# The fast path is the definition


@settings(max_examples=40, deadline=None)
@given(CASES)
def test_the_compiled_renderer_is_the_definition(case):
    check_against_definition(volume.render, case)


@settings(max_examples=10, deadline=None)
@given(CASES)
def test_the_gradient_of_view_vectors_is_the_definitions(case):
    check_against_definition(volume.render, case, by_vector=True)


def test_the_compiled_renderer_is_what_runs_here():
    assert numba_call.available()


def test_the_definition_has_the_gradients_of_finite_differences():
    rng = np.random.default_rng(0)
    inputs = (random_volume(1, (4, 5, 3), rng).double(), random_frames(2, rng).double(), torch.tensor(0.25).double())
    inputs = tuple(x.requires_grad_() for x in inputs)
    assert torch.autograd.gradcheck(
        lambda v, r, f: volume.render_reference(v, r, f, 3, 4), inputs, eps=1e-7, atol=1e-4, fast_mode=True
    )


def test_sparse_leaves_out_gradients_of_empty_voxels_only():
    rng = np.random.default_rng(1)
    voxels = random_volume(2, (9, 9, 9), rng)
    voxels[:, 3] *= torch.from_numpy(rng.random((2, 9, 9, 9)) < 0.1)
    inputs = [voxels, random_frames(4, rng), FOCAL]
    weights = torch.from_numpy(rng.standard_normal((4, 4, 12, 12)))
    dense, full = gradients(lambda v, r, f: volume.render(v, r, f, 12, 14, sparse=False), inputs, weights)
    sparse, part = gradients(lambda v, r, f: volume.render(v, r, f, 12, 14, sparse=True), inputs, weights)
    assert torch.equal(sparse, dense)
    occupied = voxels[:, 3:] > 0
    assert (full[0][:, 3:][~occupied] != 0).any()  # there are gradients to leave out
    assert torch.allclose(part[0][:, :3], full[0][:, :3], atol=1e-6)
    assert torch.allclose(part[0][:, 3:][occupied], full[0][:, 3:][occupied], atol=1e-6)
    assert torch.allclose(part[1], full[1], atol=1e-4)
    assert torch.allclose(part[2], full[2], atol=1e-4)


def test_views_of_one_volume_add_up_their_gradients():
    rng = np.random.default_rng(2)
    voxels, frames = random_volume(2, (7, 7, 7), rng), random_frames(6, rng)
    weights = torch.from_numpy(rng.standard_normal((6, 4, 9, 9)))
    together, found = gradients(lambda v, r, f: volume.render(v, r, f, 9), [voxels, frames, FOCAL], weights)
    apart = [
        gradients(
            lambda v, r, f: volume.render(v, r, f, 9),
            [voxels[n // 3 : n // 3 + 1], frames[n : n + 1], FOCAL],
            weights[n : n + 1],
        )
        for n in range(6)
    ]
    assert torch.equal(together, torch.cat([image for image, _ in apart]))
    for b in range(2):
        alone = sum(grads[0] for _, grads in apart[3 * b : 3 * b + 3])
        assert torch.allclose(found[0][b : b + 1], alone, atol=1e-5)
    assert torch.allclose(found[2], sum(grads[2] for _, grads in apart), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last_3d])
def test_halving_averages_every_eight_voxels(layout):
    voxels = torch.rand(2, 4, 4, 6, 8, generator=torch.Generator().manual_seed(0)).contiguous(memory_format=layout)
    assert torch.allclose(volume.halved(voxels), torch.nn.functional.avg_pool3d(voxels, 2), atol=1e-6)


def test_frames_that_cannot_be_shared_out():
    with pytest.raises(ValueError, match="3 camera frames cannot be shared out evenly over 2 volumes"):
        volume.render(torch.zeros(2, 4, 4, 4, 4), torch.eye(3).expand(3, 3, 3), FOCAL, 4)


@pytest.mark.slow
def test_threads_do_not_change_bits():
    import numba

    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("a single processor core: there is nothing to compare")
    rng = np.random.default_rng(3)
    inputs = [random_volume(5, (8, 8, 8), rng), random_frames(10, rng), FOCAL]
    weights = torch.from_numpy(rng.standard_normal((10, 4, 11, 11)))
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            results.append(gradients(lambda v, r, f: volume.render(v, r, f, 11), inputs, weights))
    finally:
        torch.set_num_threads(before)
    (one, one_grads), (two, two_grads) = results
    assert torch.equal(one, two)
    assert all(torch.equal(a, b) for a, b in zip(one_grads, two_grads, strict=True))


# Laws of light


def test_equations_3_and_4_spelt_out():
    """Straight on and without perspective every ray runs through the centres of one row of voxels."""
    n = 6
    voxels = random_volume(1, (n, n, n), np.random.default_rng(4))
    image = volume.render(voxels, torch.eye(3)[None], torch.tensor(0.0), n)[0]
    expected = np.zeros((4, n, n))
    for row in range(n):
        for column in range(n):
            light = 1.0
            for z in reversed(range(n)):  # the camera is on the side of +z
                *colour, q = voxels[0, :, z, n - 1 - row, column].tolist()
                expected[:, row, column] += light * q * np.array([*colour, 1.0])
                light *= 1 - q
    assert np.abs(image.numpy() - expected).max() < 1e-5
    through = (1 - voxels[0, 3]).prod(0).flip(0)
    assert torch.allclose(image[3], 1 - through, atol=1e-5)


def test_what_is_in_front_hides_what_is_behind():
    voxels = torch.zeros(1, 4, 16, 16, 16)
    voxels[:, 0, :, :, 8:] = 1  # red, towards +x
    voxels[:, 1, :, :, :8] = 1  # green, towards -x
    voxels[:, 3, :, :, 12:14] = 1
    voxels[:, 3, :, :, 2:4] = 1
    azimuth = torch.tensor([0.0, 180.0])
    front, back = volume.render(voxels, look_at(view_vector(azimuth, 0 * azimuth)), FOCAL, 15, 64)[:, :, 4:-4, 4:-4]
    assert front[0].min() > 0.95
    assert front[1].max() < 1e-3
    assert back[1].min() > 0.95
    assert back[0].max() < 1e-3


@given(st.floats(0, 360), st.floats(-80, 80), st.tuples(*[st.integers(8, 22)] * 3), st.sampled_from([0.0, 0.2, 0.4]))
@settings(max_examples=20)
def test_a_voxel_appears_where_the_camera_says(azimuth, elevation, at, focal):
    n, size = 31, 61
    voxels = torch.zeros(1, 4, n, n, n)
    voxels[0, 3, at[2], at[1], at[0]] = 0.5
    frame = look_at(view_vector(torch.tensor(azimuth), torch.tensor(elevation)))
    mask = volume.render(voxels, frame[None], torch.tensor(focal), size, 2 * size)[0, 3]
    x, y, z = frame.T @ ((torch.tensor(at) * 2 + 1) / n - 1)
    expected = torch.stack([-y, x]) / (1 - focal * z)  # rows count downwards
    pixel = (torch.arange(size) * 2 + 1) / size - 1
    found = torch.stack([(mask.sum(1) * pixel).sum(), (mask.sum(0) * pixel).sum()]) / mask.sum()
    assert (found - expected).abs().max() < 0.5 * 2 / size


def test_seen_from_the_front_left_is_right_and_up_is_up():
    voxels = torch.zeros(1, 4, 8, 8, 8)
    voxels[0, 3, 5:, 5:, :] = 1  # up, and on the object's left
    mask = volume.render(voxels, look_at(torch.tensor([[1.0, 0.0, 0.0]])), torch.tensor(0.0), 8)[0, 3]
    assert mask[:3, 5:].min() > 0.9
    assert mask[4:].max() < 1e-6
    assert mask[:, :4].max() < 1e-6


def test_without_perspective_the_distance_does_not_matter():
    frame = look_at(torch.tensor([[1.0, 0.0, 0.0]]))
    near, far = torch.zeros(2, 1, 4, 16, 16, 16)
    near[0, 3, 6:10, 6:10, 12:15] = 1
    far[0, 3, 6:10, 6:10, 1:4] = 1

    def area(voxels: torch.Tensor, focal: float) -> float:
        return volume.render(voxels, frame, torch.tensor(focal), 32, 64)[0, 3].sum().item()

    assert area(near, 0.0) == pytest.approx(area(far, 0.0), rel=1e-3)
    assert area(near, 0.3) > 1.5 * area(far, 0.3)


@pytest.mark.parametrize("sparse", [False, True])
def test_an_empty_volume_is_an_empty_image(sparse):
    voxels = torch.zeros(1, 4, 6, 6, 6)
    voxels[:, :3] = 0.7  # colour without occupancy is invisible
    voxels.requires_grad_()
    image = volume.render(voxels, look_at(torch.tensor([[1.0, 1.0, 0.3]])), FOCAL, 8, sparse=sparse)
    assert not image.any()
    image.sum().backward()
    assert voxels.grad.isfinite().all()
    # More occupancy would be visible, so that the volume can grow from nothing, unless it is known to be clamped.
    assert bool((voxels.grad[:, 3] > 0).any()) is not sparse


# Handedness: the two renderers share a world


@pytest.fixture(scope="module")
def grid():
    """Viewpoints (G, 2) around the object, and volume renderings (G, 4, S, S) of the boxes from them."""
    azimuth, elevation = np.meshgrid(np.arange(0, 360, 15), [-20, 0, 20, 40])
    viewpoints = np.stack([azimuth.ravel(), elevation.ravel()], axis=1).astype(np.float64)
    frames = look_at(vectors_of(viewpoints)).float()
    return viewpoints, volume.render(box_volume(SYMMETRIC, 48), frames, torch.tensor(PERSPECTIVE), 32, 96)


def vectors_of(viewpoints: np.ndarray) -> torch.Tensor:
    return view_vector(*torch.from_numpy(viewpoints).unbind(1))


def mesh_images(viewpoints: np.ndarray) -> torch.Tensor:
    """(V, 4, 32, 32), RGB times alpha and alpha, of the same boxes as a mesh."""
    rgba = mesh_renderer.render_mesh(box_mesh(SYMMETRIC), viewpoints[:, 0], viewpoints[:, 1], 32, 4) / 255.0
    return torch.from_numpy(np.concatenate([rgba[..., :3] * rgba[..., 3:], rgba[..., 3:]], axis=-1)).permute(0, 3, 1, 2)


def best_match(images: torch.Tensor, candidates: torch.Tensor) -> np.ndarray:
    """For each image the most similar candidate."""
    return (images[:, None].float() - candidates[None]).square().mean((2, 3, 4)).argmin(1).numpy()


def test_both_renderers_put_the_object_in_the_same_place(grid):
    viewpoints, drawn = grid
    alpha, mask = mesh_images(viewpoints)[:, 3], drawn[:, 3]
    overlap = torch.minimum(alpha, mask).sum((1, 2)) / torch.maximum(alpha, mask).sum((1, 2))
    assert overlap.min() > 0.85


def test_viewpoints_found_by_drawing_a_volume_are_those_of_the_mesh(grid):
    """Analysis by synthesis without a network: images of the mesh are matched by views of the volume."""
    viewpoints, drawn = grid
    chosen = np.random.default_rng(5).permutation(len(viewpoints))[:40]
    found = viewpoints[best_match(mesh_images(viewpoints[chosen]), drawn)]
    predicted, truth = vectors_of(found).numpy(), vectors_of(viewpoints[chosen]).numpy()
    turn, _ = orthogonal_procrustes(predicted, truth)  # any orthogonal map, reflections too
    assert np.linalg.det(turn) == pytest.approx(1)
    assert np.abs(predicted @ turn - truth).max() < 1e-6
    assert np.abs(fit_rotation(predicted, truth) - np.eye(3)).max() < 1e-6


def test_a_mirrored_renderer_would_be_noticed(grid):
    viewpoints, drawn = grid
    chosen = np.random.default_rng(5).permutation(len(viewpoints))[:40]
    found = viewpoints[best_match(mesh_images(viewpoints[chosen]).flip(3), drawn)]
    predicted, truth = vectors_of(found).numpy(), vectors_of(viewpoints[chosen]).numpy()
    turn, _ = orthogonal_procrustes(predicted, truth)
    assert np.linalg.det(turn) == pytest.approx(-1)  # a reflection explains it all
    assert np.abs(predicted @ turn - truth).max() < 1e-6
    rotated = predicted @ fit_rotation(predicted, truth).T  # and no rotation does
    assert np.linalg.norm(rotated - truth, axis=1).mean() > 0.3


def test_volumes_of_inference_mode_are_drawn_anew_each_time():
    rng = np.random.default_rng(0)
    shape, frames = random_volume(1, (8, 8, 8), rng), random_frames(2, rng)
    wanted = volume.render(shape, frames, FOCAL, 8, sparse=True)
    with torch.inference_mode():
        inferred = shape.clone()
        assert torch.equal(volume.render(inferred, frames, FOCAL, 8, sparse=True), wanted)
        inferred.mul_(0)
        assert not volume.render(inferred, frames, FOCAL, 8, sparse=True).any()
