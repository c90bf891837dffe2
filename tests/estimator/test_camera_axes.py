"""Rotations in the axes of OpenCV, OpenGL, PyTorch3D and Blender, each against its own documented definition."""

from __future__ import annotations

import warnings
from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from viewnet.commands import predict
from viewnet.errors import ViewnetError
from viewnet.estimator import camera_axes
from viewnet.estimator.viewpoints import Viewpoint, Viewpoints
from viewnet.geometry import view_vector
from viewnet.render.camera import DISTANCE, FOCAL
from viewnet.render.mesh import Material, Mesh
from viewnet.render.raycast import prepare, render

POLES = [(0.0, 90.0, 0.0), (70.0, -90.0, 33.0), (0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (270.0, 0.0, 180.0)]
viewpoints = st.tuples(st.floats(0, 359.9), st.floats(-90, 90), st.floats(-180, 180))
points = st.tuples(*[st.floats(-0.3, 0.3)] * 3)


def everywhere(test):
    """The test with viewpoints all around: azimuth, elevation and tilt; above, below, straight ones among them."""
    for pole in POLES:
        test = example(pole)(test)
    return given(viewpoints)(test)


def camera(azimuth: float, elevation: float, tilt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The camera's right, up and back in the object's axes, by trigonometry; turned by `tilt` about back."""
    a, e, t = np.radians([azimuth, elevation, tilt])
    back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])
    return np.cos(t) * right + np.sin(t) * up, np.cos(t) * up - np.sin(t) * right, back


def viewpoint(azimuth: float, elevation: float, tilt: float | None = None) -> Viewpoint:
    """The viewpoint as a network predicts it: a view vector, and with a tilt an up vector too."""
    v = view_vector(*torch.tensor([azimuth, elevation], dtype=torch.float64)).numpy()
    ups = None if tilt is None else [[camera(azimuth, elevation, tilt)[1]]]
    return Viewpoints.of([[v]], [[0.0]], ups, aligned=True)[0]


# Worked out by hand for azimuth 30 and elevation 20, without tilt: cos 30 = 0.86603, sin 30 = 0.5, cos 20 = 0.93969,
# sin 20 = 0.34202, so that right = (-0.5, 0.86603, 0), up = (-0.29620, -0.17101, 0.93969) and
# back = (0.81380, 0.46985, 0.34202).
BY_HAND = {
    "opencv": [[-0.5, 0.866, 0], [0.296, 0.171, -0.940], [-0.814, -0.470, -0.342]],
    "opengl": [[-0.5, 0.866, 0], [-0.296, -0.171, 0.940], [0.814, 0.470, 0.342]],
    "pytorch3d": [[0.5, -0.296, -0.814], [-0.866, -0.171, -0.470], [0, 0.940, -0.342]],
    "blender": [[-0.5, -0.296, 0.814], [0.866, -0.171, 0.470], [0, 0.940, 0.342]],
}


@pytest.mark.parametrize("frame", BY_HAND)
def test_the_matrices_of_a_viewpoint_worked_out_by_hand(frame):
    assert np.abs(viewpoint(30, 20).rotation(frame) - BY_HAND[frame]).max() < 6e-4
    assert viewpoint(30, 20).rotation().tolist() == viewpoint(30, 20).rotation("opencv").tolist()


@pytest.mark.parametrize("frame", BY_HAND)
@everywhere
def test_they_are_rotations_that_say_where_the_camera_s_axes_point(frame, view):
    matrix = viewpoint(*view).rotation(frame)
    right, up, back = camera(*view)
    axes = {
        "opencv": (right, -up, -back),
        "opengl": (right, up, back),
        "pytorch3d": (-right, up, -back),
        "blender": (right, up, back),
    }[frame]
    assert np.allclose(matrix if frame in ("opencv", "opengl") else matrix.T, axes, atol=1e-7)
    assert np.linalg.det(matrix) == pytest.approx(1)


# What each program's documentation says of a point, the camera `distance` away


def opencv(rotation: np.ndarray, point: np.ndarray, distance: float) -> np.ndarray:
    """(u, v) of `projectPoints` with a focal length of 1: x = R X + t, u = x / z to the right, v = y / z down."""
    x, y, z = rotation @ point + [0, 0, distance]
    assert z > 0
    return np.array([x, y]) / z


def opengl(rotation: np.ndarray, point: np.ndarray, distance: float) -> np.ndarray:
    """The camera looks along -z with y up: a perspective projection divides by -z."""
    x, y, z = rotation @ point - [0, 0, distance]
    assert z < 0
    return np.array([x, -y]) / -z


def pytorch3d(rotation: np.ndarray, point: np.ndarray, distance: float) -> np.ndarray:
    """Row vectors, x_view = x_world R + T; +x is left, +y up and +z into the image."""
    x, y, z = point @ rotation + [0, 0, distance]
    assert z > 0
    return -np.array([x, y]) / z


def blender(rotation: np.ndarray, point: np.ndarray, distance: float) -> np.ndarray:
    """`matrix_world` is from the camera's own axes, in which it looks along -z with y up, to the world's."""
    matrix_world = np.eye(4)
    matrix_world[:3, :3] = rotation
    matrix_world[:3, 3] = distance * rotation @ [0, 0, 1]
    x, y, z, _ = np.linalg.inv(matrix_world) @ [*point, 1]
    assert z < 0
    return np.array([x, -y]) / -z


PROJECTIONS = {"opencv": opencv, "opengl": opengl, "pytorch3d": pytorch3d, "blender": blender}
"""Frame -> where a point is in the image, x to the right and y down, 0 at the centre, in focal lengths."""


@pytest.mark.parametrize("frame", PROJECTIONS)
@pytest.mark.parametrize(
    ("azimuth", "point", "expected"),
    [
        (0, (0, 0, 0.5), (0, -0.25)),  # a point above the centre is above it in the image
        (137, (0, 0, 0.5), (0, -0.25)),
        (0, (0, 0.5, 0), (0.25, 0)),  # from the front, the object's left is on the right
        (90, (0.5, 0, 0), (-0.25, 0)),  # from its left side, the object faces left
        (180, (0, 0.5, 0), (-0.25, 0)),
        (0, (1, 0, 0.5), (0, -0.5)),  # twice as near, twice as large
    ],
)
def test_points_are_where_one_expects_them(frame, azimuth, point, expected):
    seen = PROJECTIONS[frame](viewpoint(azimuth, 0).rotation(frame), np.array(point, float), 2.0)
    assert np.allclose(seen, expected)


@settings(max_examples=20, deadline=None)
@given(viewpoints, points)
@example((0.0, 90.0, 45.0), (0.2, 0.1, 0.3))
def test_the_renderer_draws_a_point_where_every_frame_has_it(view, point):
    corners = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]) * 0.02 + point
    faces = np.array([(x, y, z) for x, y, z in product((0, 1), (2, 3), (4, 5))], np.int32)
    mark = Mesh(corners, faces, np.zeros(8, np.int32), (Material(),))
    there, size = viewpoint(*view), 256
    (image,) = render(prepare(mark), there.frame[None], there.vector[None], size, 2)
    alpha = image[..., 3] / 255
    drawn = [(alpha.sum(axis) * (np.arange(size) + 0.5)).sum() / alpha.sum() / size - 0.5 for axis in (0, 1)]
    for frame, project in PROJECTIONS.items():
        seen = FOCAL * project(there.rotation(frame), np.array(point), DISTANCE)
        assert np.allclose(seen, drawn, atol=0.5 / size), frame


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def look_at_rotation(position: np.ndarray, up: np.ndarray) -> np.ndarray:
    """PyTorch3D's, by its description: z towards the origin, x = up x z, y = z x x, as columns, for row vectors."""
    z = unit(-position)
    x = unit(np.cross(up, z))
    return np.stack([x, np.cross(z, x), z], axis=1)


def look_at_view_transform(elevation: float, azimuth: float) -> np.ndarray:
    """The rotation of PyTorch3D's, by its description: y is up, and the azimuth runs from z to x."""
    a, e = np.radians([azimuth, elevation])
    return look_at_rotation(np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)]), np.array([0, 1, 0]))


@everywhere
def test_pytorch3d_s_look_at_rotation_is_the_same(view):
    _, up, back = camera(*view)
    assert np.allclose(viewpoint(*view).rotation("pytorch3d"), look_at_rotation(3 * back, up), atol=1e-7)


@given(st.floats(0, 359.9), st.floats(-89, 89))
def test_pytorch3d_s_look_at_rotation_of_a_level_camera_has_z_up(azimuth, elevation):
    there = viewpoint(azimuth, elevation)
    assert np.allclose(there.rotation("pytorch3d"), look_at_rotation(2 * there.vector, np.array([0, 0, 1])), atol=1e-7)


@given(st.floats(0, 359.9), st.floats(-89, 89))
def test_in_pytorch3d_s_own_world_the_rows_are_in_another_order(azimuth, elevation):
    """For a mesh with y up, front along z and left along x."""
    expected = look_at_view_transform(elevation, azimuth)
    assert np.allclose(viewpoint(azimuth, elevation).rotation("pytorch3d")[[1, 2, 0]], expected, atol=1e-7)


def about(axis: int, degrees: float) -> np.ndarray:
    """The right-handed rotation about x, y or z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix[[first, first, second, second], [first, second, first, second]] = c, -s, s, c
    return matrix


def test_the_camera_that_a_new_scene_in_blender_has():
    """Its location, rotation (XYZ Euler) and the axes in `matrix_world`, as Blender 5.0 shows them."""
    location = np.array([7.358891, -6.925791, 4.958309])
    shown = [[0.6859, -0.3240, 0.6516], [0.7277, 0.3054, -0.6142], [0.0, 0.8954, 0.4453]]
    back = np.array(shown)[:, 2]
    there = Viewpoints.of([[unit(back)]], [[0.0]], None, aligned=True)[0]
    assert np.allclose(there.rotation("blender"), shown, atol=1e-4)
    assert np.allclose(there.rotation("blender", "euler"), [63.5593, 0, 46.6919], atol=0.01)
    assert np.allclose(unit(location), there.vector, atol=0.01)  # it looks a little past the origin


@pytest.mark.parametrize("frame", BY_HAND)
@everywhere
def test_other_forms_are_the_same_rotation(frame, view):
    there = viewpoint(*view)
    matrix = there.rotation(frame)
    w, x, y, z = there.rotation(frame, "quaternion")
    assert w >= 0
    assert w * w + x * x + y * y + z * z == pytest.approx(1)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    assert np.allclose(np.eye(3) + 2 * w * cross + 2 * cross @ cross, matrix, atol=1e-7)
    rx, ry, rz = there.rotation(frame, "euler")
    assert abs(ry) <= 90
    assert np.allclose(about(2, rz) @ about(1, ry) @ about(0, rx), matrix, atol=1e-6)


def test_gimbal_lock_is_no_cause_for_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rx, ry, rz = viewpoint(0, 0).rotation("opencv", "euler")
    assert (abs(ry), rz) == (90, 0)
    assert np.allclose(about(1, ry) @ about(0, rx), viewpoint(0, 0).rotation("opencv"), atol=1e-9)


@pytest.mark.parametrize("azimuth", [0, 75, 180, 300])
@pytest.mark.parametrize("elevation", [-20, 0, 50, 89])
def test_a_level_camera_in_blender_is_tilted_up_and_then_turned(azimuth, elevation):
    """Without rotation it looks straight down, its up along y; azimuth 270 is the view that Blender calls front."""
    rx, ry, rz = viewpoint(azimuth, elevation).rotation("blender", "euler")
    assert (rx, ry) == (pytest.approx(90 - elevation), pytest.approx(0, abs=1e-9))
    assert (rz - azimuth - 90 + 180) % 360 - 180 == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("form", "shape"), [("matrix", (3, 3)), ("quaternion", (4,)), ("euler", (3,))])
def test_rotations_of_several_images_are_those_of_each(form, shape):
    vectors = np.random.default_rng(0).normal(size=(2, 5, 3, 3))
    vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    logits = np.random.default_rng(1).normal(size=(5, 3))
    for ups in (None, vectors[1]):
        several = Viewpoints.of(vectors[0], logits, ups, aligned=True)
        found = several.rotation("pytorch3d", form)
        assert found.shape == (5, *shape)
        for one, rotation in zip(several, found, strict=True):
            assert np.allclose(one.rotation("pytorch3d", form), rotation)
            ranked = one.ranked()
            assert np.allclose(ranked[0].rotation("pytorch3d", form), rotation)
            for each in ranked:
                matrix = each.rotation("blender")
                assert np.allclose(matrix[:, 2], view_vector(*torch.tensor([each.azimuth, each.elevation])), atol=1e-6)
        assert several[:0].rotation("opengl", form).shape == (0, *shape)


@pytest.mark.parametrize("form", camera_axes.FORMS)
def test_tables_have_the_numbers_of_every_hypothesis(form):
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(4, 2, 3))
    said = Viewpoints.of(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), rng.normal(size=(4, 2)), None, True)
    plain, table = said.to_frame(), said.to_frame("opengl", form)
    names = list(camera_axes.FORMS[form])
    assert list(table) == [*plain, *names, *(f"{name}_{m}" for m in range(2) for name in names)]
    assert table[list(plain)].equals(plain)
    assert np.array_equal(table[names], said.rotation("opengl", form).reshape(4, -1))
    for row, one in enumerate(said):
        chosen = table.loc[row, [f"{name}_{one.choice}" for name in names]]
        assert np.array_equal(chosen, table.loc[row, names])
    assert list(said[:0].to_frame("opengl", form)) == list(table)


@pytest.mark.parametrize(
    ("frame", "form", "said"),
    [("OpenCV", "matrix", "frame of a rotation 'OpenCV'.*opengl"), ("opencv", "rodrigues", "form of a rotation 'rod")],
)
def test_another_frame_or_form_is_an_error(frame, form, said):
    several = Viewpoints.of([[[1.0, 0, 0]]], [[0.0]], None, aligned=True)
    for ask in (several.rotation, several[0].rotation, several[0].ranked()[0].rotation, several.to_frame):
        with pytest.raises(ViewnetError, match=said):
            ask(frame, form)


def test_the_command_offers_every_frame_and_form():
    assert set(predict.FRAMES) == set(camera_axes.SIGNS) == set(camera_axes.MEANINGS)
    assert set(predict.FORMS) == set(camera_axes.FORMS)
