from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from viewnet.geometry import azimuth_elevation, look_at, rotation_angle, vector_angle, view_vector

azimuths = st.floats(0, 360, exclude_max=True)
elevations = st.floats(-90, 90)


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def about(axis: tuple[float, float, float], degrees: float) -> torch.Tensor:
    return torch.from_numpy(
        Rotation.from_rotvec(np.array(axis) * degrees / np.linalg.norm(axis), degrees=True).as_matrix()
    )


def is_rotation(frames: torch.Tensor, tolerance: float = 1e-9) -> bool:
    identity = torch.eye(3, dtype=frames.dtype)
    orthogonal = (frames.transpose(-1, -2) @ frames - identity).abs().max() < tolerance
    return bool(orthogonal and (torch.linalg.det(frames) - 1).abs().max() < tolerance)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "vector"),
    [
        (0, 0, (1, 0, 0)),
        (90, 0, (0, 1, 0)),
        (180, 0, (-1, 0, 0)),
        (270, 0, (0, -1, 0)),
        (0, 90, (0, 0, 1)),
        (0, -90, (0, 0, -1)),
    ],
)
def test_known_viewpoints(azimuth, elevation, vector):
    assert torch.allclose(view_vector(tensor(azimuth), tensor(elevation)), tensor(*vector), atol=1e-15)


@given(azimuths, elevations, st.floats(1e-3, 1e3))
@example(359.9999999999999, 0.0, 1.0)
@example(0.0, 90.0, 1.0)
def test_angles_survive_the_way_to_a_vector_and_back(azimuth, elevation, length):
    a, e = azimuth_elevation(length * view_vector(tensor(azimuth), tensor(elevation)))
    assert 0 <= a < 360
    assert abs(e - elevation) < 1e-6
    # Near a pole an error in azimuth counts as little as the circle is short.
    error = (a.item() - azimuth + 180) % 360 - 180
    assert abs(error) * math.cos(math.radians(elevation)) < 1e-9


def test_the_smallest_negative_azimuth_is_zero_and_not_360():
    a, _ = azimuth_elevation(torch.tensor([1.0, -1e-30, 0.0]))
    assert a == 0


@given(azimuths, st.floats(-89.9, 89.9))
def test_the_camera_frame_is_an_upright_rotation_that_looks_at_the_object(azimuth, elevation):
    v = view_vector(tensor(azimuth), tensor(elevation))[0]
    frame = look_at(v)
    assert is_rotation(frame)
    assert torch.allclose(frame[:, 2], v, atol=1e-12)  # back
    assert abs(frame[2, 0]) < 1e-12  # right is horizontal: no tilt
    assert frame[2, 1] > 0  # up is up


def test_seen_from_the_front_the_left_side_is_on_the_right_of_the_image():
    right = look_at(tensor(1, 0, 0))[:, 0]
    assert torch.equal(right, tensor(0, 1, 0))


@given(azimuths, st.floats(-89, 89))
def test_the_frame_of_the_paper_is_the_same_up_to_order_and_sign_of_its_columns(azimuth, elevation):
    v, u = view_vector(tensor(azimuth), tensor(elevation))[0], tensor(0, 0, 1)
    w = torch.nn.functional.normalize(torch.linalg.cross(v, u), dim=0)
    paper = torch.stack([v, w, torch.linalg.cross(w, v)], dim=1)
    right, up, back = look_at(v).unbind(1)
    assert torch.allclose(paper, torch.stack([back, -right, up], dim=1), atol=1e-12)


@given(azimuths, st.floats(-60, 60), st.floats(-170, 170))
def test_a_learned_up_describes_the_tilt(azimuth, elevation, tilt):
    v = view_vector(tensor(azimuth), tensor(elevation))[0]
    turned = look_at(v, about(tuple(v.tolist()), tilt) @ tensor(0, 0, 1))
    assert is_rotation(turned)
    assert rotation_angle(turned, look_at(v)) == pytest.approx(abs(tilt), abs=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("v", [(0, 0, 1), (0, 0, -1), (0, 0, 5), (1e-9, 0, 1), (0, -1e-12, -1), (1e-7, 1e-7, 1)])
def test_poles_give_rotations_with_finite_gradients(v, dtype):
    v = torch.tensor(v, dtype=dtype, requires_grad=True)
    frame = look_at(v)
    assert is_rotation(frame.detach(), 1e-5)
    (frame * torch.arange(9.0, dtype=dtype).view(3, 3)).sum().backward()
    assert v.grad.isfinite().all()


def test_an_up_along_the_view_gives_rotations_with_finite_gradients():
    v = tensor(1, 2, 2).requires_grad_()
    up = tensor(-1, -2, -2).requires_grad_()
    frame = look_at(v, up)
    assert is_rotation(frame.detach())
    frame[0].sum().backward()
    assert v.grad.isfinite().all()
    assert up.grad is None or up.grad.isfinite().all()


def test_look_at_passes_gradients_of_finite_differences():
    torch.manual_seed(0)
    v = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    up = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(look_at, (v, up))


@given(st.floats(0, 180), st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1))
@example(180.0, (1.0, 0.0, 0.0))
@example(1e-7, (1.0, 2.0, 3.0))
def test_the_angle_between_rotations(degrees, axis):
    turn, base = about(axis, degrees), about((1, -2, 0.5), 77)
    assert rotation_angle(base, base @ turn) == pytest.approx(degrees, abs=1e-6)
    assert rotation_angle(base @ turn, base) == pytest.approx(degrees, abs=1e-6)
    # Neither the choice of the world's frame nor that of the camera's matters.
    other = about((3, 1, 1), 123)
    assert rotation_angle(other @ base, other @ base @ turn) == pytest.approx(degrees, abs=1e-6)


@pytest.mark.parametrize("turns", [0, 1, 2, 4])
def test_the_angle_up_to_turns_about_the_vertical_is_the_least_of_all(turns):
    a, b = (torch.from_numpy(Rotation.random(50, rng=np.random.default_rng(i)).as_matrix()) for i in (0, 1))
    every = 360 if turns == 0 else turns
    apart = [rotation_angle(about((0, 0, 1), 360 * turn / every) @ a, b) for turn in range(every)]
    least = torch.stack(apart).min(0).values  # (50,)
    found = rotation_angle(a, b, turns)
    assert (found <= least + 1e-9).all()
    assert torch.allclose(found, least, atol=0.5 if turns == 0 else 1e-9)
    if turns == 0:
        high, low = (look_at(view_vector(tensor(azimuth), tensor(e))) for azimuth, e in ((10, 30), (200, 5)))
        assert rotation_angle(high, low, turns) == pytest.approx(25)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_the_angle_is_exact_where_arccos_is_not(axis):
    eye = torch.eye(3)
    half_turn = torch.diag(torch.tensor([1.0 if a else -1.0 for a in axis]))
    assert rotation_angle(eye, eye) == 0
    assert rotation_angle(eye, half_turn) == 180
    small = about(axis, 1e-3).float()
    assert rotation_angle(eye, small) == pytest.approx(1e-3, rel=1e-4)


def test_the_angle_is_that_of_the_trace_formula_elsewhere():
    a, b = (torch.from_numpy(Rotation.random(200, rng=np.random.default_rng(i)).as_matrix()) for i in (0, 1))
    trace = (a.transpose(-1, -2) @ b).diagonal(dim1=-2, dim2=-1).sum(-1)
    assert torch.allclose(rotation_angle(a, b), torch.rad2deg(((trace - 1) / 2).arccos()), atol=1e-6)


@given(azimuths, st.floats(-80, 80), azimuths, st.floats(-80, 80))
def test_an_upright_camera_turns_at_least_as_far_as_its_view_vector(a1, e1, a2, e2):
    v, w = view_vector(tensor(a1), tensor(e1))[0], view_vector(tensor(a2), tensor(e2))[0]
    angle = vector_angle(v, w)
    assert torch.allclose(angle, torch.rad2deg((v @ w).clamp(-1, 1).arccos()), atol=1e-5)
    assert rotation_angle(look_at(v), look_at(w)) >= angle - 1e-6


def test_vector_angle_at_its_ends():
    v = tensor(0.3, -2, 5)
    assert vector_angle(v, 7 * v) == pytest.approx(0, abs=1e-12)
    assert vector_angle(v, -v) == pytest.approx(180, abs=1e-12)
