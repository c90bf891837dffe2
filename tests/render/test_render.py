"""Images: visible sides, projected points, light, edges, textures, and two renderers that must agree."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from helpers.cad_files import COLOURS, model_of, real_data, write_box
from hypothesis import given, settings
from hypothesis import strategies as st

from viewnet.data.readers.shapenet import find_models, load_model
from viewnet.errors import ViewnetError
from viewnet.geometry import look_at, view_vector
from viewnet.render import choose_backend, opengl, render_mesh
from viewnet.render.camera import DISTANCE, FOCAL, look_from, project
from viewnet.render.mesh import Material, Mesh
from viewnet.render.raycast import ALPHA_CUT, AMBIENT

BACKENDS = ("raycast", "pyrender")
# The camera's viewpoint for each side of the box.
STRAIGHT = {"front": (0, 0), "left": (90, 0), "back": (180, 0), "right": (270, 0), "top": (0, 90), "bottom": (0, -90)}


@pytest.fixture
def opengl_draws() -> None:
    try:
        opengl.check()
    except Exception as error:
        pytest.skip(f"OpenGL cannot draw here: {type(error).__name__}: {error}")


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> str:
    if request.param == "pyrender":
        request.getfixturevalue("opengl_draws")
    return request.param


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Mesh:
    return load_model(model_of(write_box(tmp_path_factory.mktemp("box"), "02958343", "box")))


def triangle_mesh(corners: np.ndarray, *materials: Material, uv: np.ndarray | None = None) -> Mesh:
    """One triangle for each (3, 3) of `corners`, each of its own material."""
    count = len(corners)
    faces = np.arange(3 * count, dtype=np.int32).reshape(count, 3)
    return Mesh(np.reshape(corners, (-1, 3)), faces, np.arange(count, dtype=np.int32), materials or (Material(),), uv)


def colour_at(image: np.ndarray, row: float = 0.5, column: float = 0.5) -> np.ndarray:
    """Colour in 0..1 at a place in 0..1 of an image."""
    return image[int(row * len(image)), int(column * len(image)), :3] / 255


ALONE = """
import sys
import numpy as np
from viewnet.render import render_mesh
from viewnet.render.mesh import Material, Mesh
mesh = Mesh(np.eye(3) / 4, np.array([[0, 1, 2]], np.int32), np.zeros(1, np.int32), (Material(),))
assert render_mesh(mesh, 45, 35, 8)[0, ..., 3].any()
sys.exit("trimesh" in sys.modules or "pyrender" in sys.modules)
"""


def test_the_ray_caster_does_not_load_the_libraries_of_the_other() -> None:
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    subprocess.run([sys.executable, "-c", ALONE], env=environment, check=True)


WITHOUT_X11 = """
import ctypes
load = ctypes.CDLL.__init__
def load_no_x11(self, name, *arguments, **options):
    if "libX" in str(name):
        raise OSError(f"{name}: not here")
    load(self, name, *arguments, **options)
ctypes.CDLL.__init__ = load_no_x11
from viewnet.render import opengl
opengl.check()
"""


@pytest.mark.usefixtures("opengl_draws")
def test_on_a_server_without_x11_opengl_draws_by_egl() -> None:
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2]), "PYOPENGL_PLATFORM": "egl"}
    subprocess.run([sys.executable, "-c", WITHOUT_X11], env=environment, check=True)


# Geometry


@pytest.mark.parametrize("side", STRAIGHT)
def test_each_side_is_seen_from_its_own_side(box: Mesh, backend: str, side: str) -> None:
    azimuth, elevation = STRAIGHT[side]
    (image,) = render_mesh(box, np.array([azimuth]), np.array([elevation]), 32, backend=backend)
    assert np.allclose(colour_at(image), COLOURS[side], atol=0.02)
    assert image[16, 16, 3] == 255 and image[0, 0].tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize(
    ("azimuth", "left", "right"), [(45, "front", "left"), (135, "left", "back"), (300, "right", "front")]
)
def test_handedness(box: Mesh, backend: str, azimuth: float, left: str, right: str) -> None:
    """From the front left the front is on the image's left: at 90 degrees the object faces left."""
    (image,) = render_mesh(box, np.array([azimuth]), np.array([0.0]), 64, backend=backend)
    seen = np.flatnonzero(image[32, :, 3] == 255)
    for column, side in ((seen[2], left), (seen[-3], right)):
        colour = image[32, column, :3].astype(float)
        assert np.allclose(colour / colour.max(), COLOURS[side], atol=0.05)


def test_higher_is_up(box: Mesh, backend: str) -> None:
    """From above, the top is behind the front and so higher in the image."""
    (image,) = render_mesh(box, np.array([0.0]), np.array([30.0]), 64, backend=backend)
    seen = np.flatnonzero(image[:, 32, 3] == 255)
    for row, side in ((seen[2], "top"), (seen[-3], "front")):
        colour = image[row, 32, :3].astype(float)
        assert np.allclose(colour / colour.max(), COLOURS[side], atol=0.05)


angles = st.tuples(st.floats(0, 359.9), st.floats(-85, 85))


@settings(max_examples=25, deadline=None)
@given(angles, st.tuples(*[st.floats(-0.25, 0.25)] * 3))
def test_points_land_where_the_camera_says(view: tuple[float, float], point: tuple[float, float, float]) -> None:
    """The middle of a small octahedron in the image, `project`, and the pinhole worked out from geometry.look_at."""
    azimuth, elevation = view
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.02)
    solid = Mesh(mesh.vertices + point, mesh.faces.astype(np.int32), np.zeros(len(mesh.faces), np.int32), (Material(),))
    (image,) = render_mesh(solid, np.array([azimuth]), np.array([elevation]), 256)
    alpha = image[..., 3] / 255
    found = np.array([(alpha.sum(axis=i) * (np.arange(256) + 0.5)).sum() for i in (0, 1)]) / alpha.sum() / 256
    (expected,) = project(np.array([point]), look_from(np.array([azimuth]), np.array([elevation])))[0]
    assert np.allclose(found, expected, atol=0.5 / 256)

    v = view_vector(torch.tensor(azimuth, dtype=torch.float64), torch.tensor(elevation, dtype=torch.float64))
    right, up, back = look_at(v).numpy().T
    offset = np.array(point) - DISTANCE * v.numpy()
    depth = -offset @ back
    pinhole = 0.5 + FOCAL * np.array([offset @ right, -offset @ up]) / depth
    assert np.allclose(expected, pinhole, atol=1e-9)


def first_hits(origin: np.ndarray, rays: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Which triangle (F, 3, 3) each ray (n, 3) meets first, -1 for none (Moeller and Trumbore)."""
    a, edge_b, edge_c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(rays[:, None], edge_c)
    determinant = np.einsum("nfi,fi->nf", p, edge_b)
    u = np.einsum("nfi,fi->nf", p, origin - a) / determinant
    q = np.cross(origin - a, edge_b)
    v = rays @ q.T / determinant
    distance = np.where((u >= 0) & (v >= 0) & (u + v <= 1), np.einsum("fi,fi->f", q, edge_c) / determinant, np.inf)
    return np.where(np.isfinite(distance.min(axis=1)), distance.argmin(axis=1), -1)


def test_a_ray_caster_sees_the_same_faces() -> None:
    """Random triangles, pixel by pixel, against a ray through each pixel's centre."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-0.2, 0.2, (40, 1, 3)) + rng.uniform(-0.15, 0.15, (40, 3, 3))
    colours = [tuple(c / 255) for c in np.stack([np.arange(40) * 6 + 10, np.full(40, 9), np.full(40, 200)], 1)]
    mesh = triangle_mesh(corners, *(Material(diffuse=c) for c in colours))
    azimuth, elevation, size = 73.0, 21.0, 96
    frame = look_from(np.array([azimuth]), np.array([elevation]))[0]
    # A light from behind leaves the ambient light alone, so that colours are the faces' numbers.
    (image,) = render_mesh(mesh, np.array([azimuth]), np.array([elevation]), size, 1, lights=-frame[None, :, 2])
    place = (np.arange(size) + 0.5) / size - 0.5
    x, y = np.meshgrid(place, -place)
    rays = np.stack([x / FOCAL, y / FOCAL, -np.ones_like(x)], axis=-1).reshape(-1, 3) @ frame.T
    hit = first_hits(DISTANCE * frame[:, 2], rays, corners).reshape(size, size)
    assert (hit >= 0).mean() > 0.1
    assert ((image[..., 3] == 255) == (hit >= 0)).mean() > 0.999
    both = (hit >= 0) & (image[..., 3] == 255)
    expected = 255 * AMBIENT * np.array(colours)[hit]
    assert (np.abs(image[..., :3] - expected).max(axis=-1)[both] < 1).mean() > 0.99


# Light and edges


def test_light_changes_colours_and_never_alpha(box: Mesh, backend: str) -> None:
    rng = np.random.default_rng(0)
    lights = rng.normal(size=(4, 3))
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    images = render_mesh(box, np.full(4, 30.0), np.full(4, 20.0), 32, lights=lights, backend=backend)
    assert (images[..., 3] == images[0, ..., 3]).all()
    assert len({image.tobytes() for image in images}) == 4


@pytest.mark.parametrize("degrees", [0, 30, 60, 90, 150])
def test_shading_follows_the_angle_of_the_light(box: Mesh, backend: str, degrees: float) -> None:
    angle = np.deg2rad(degrees)
    light = np.array([[np.cos(angle), np.sin(angle), 0.0]])
    (image,) = render_mesh(box, np.zeros(1), np.zeros(1), 32, lights=light, backend=backend)
    expected = AMBIENT + (1 - AMBIENT) * max(np.cos(angle), 0)
    assert colour_at(image)[0] == pytest.approx(expected, abs=0.01)


def test_faces_are_lit_from_either_side(backend: str) -> None:
    """A single face looks the same for either winding."""
    corners = np.array([[0.0, -0.3, -0.3], [0.0, 0.3, -0.3], [0.0, 0.0, 0.3]])
    images = [
        render_mesh(triangle_mesh(c[None]), np.zeros(1), np.zeros(1), 32, backend=backend)
        for c in (corners, corners[::-1])
    ]
    assert images[0][..., 3].sum() > 0
    assert np.array_equal(*images)


def test_alpha_is_whole_inside_and_partial_at_edges_only(box: Mesh, backend: str) -> None:
    (image,) = render_mesh(box, np.array([37.0]), np.array([20.0]), 64, backend=backend)
    alpha = image[..., 3]
    near = np.stack([np.roll(alpha, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    partial = (alpha > 0) & (alpha < 255)
    assert partial.any()
    assert (near.min(axis=0)[partial] == 0).all() or (near.max(axis=0)[partial] == 255).all()
    outside = alpha == 0
    assert (image[outside] == 0).all()
    (coarse,) = render_mesh(box, np.array([37.0]), np.array([20.0]), 64, supersample=1, backend="raycast")
    assert set(np.unique(coarse[..., 3])) == {0, 255}


def test_edges_keep_the_colour_of_the_face(box: Mesh) -> None:
    """Straight alpha: a partly covered pixel is not darkened."""
    (image,) = render_mesh(box, np.zeros(1), np.zeros(1), 65, supersample=4)
    partial = (image[..., 3] > 0) & (image[..., 3] < 255)
    assert partial.any()
    assert (image[partial][:, 0] > 250).all()


def test_supersampling_is_the_mean_of_a_finer_image(box: Mesh) -> None:
    fine = render_mesh(box, np.array([25.0]), np.array([15.0]), 64, supersample=1)[0, ..., 3].astype(float)
    mean = fine.reshape(32, 2, 32, 2).mean(axis=(1, 3))
    (image,) = render_mesh(box, np.array([25.0]), np.array([15.0]), 32, supersample=2)
    assert np.array_equal(image[..., 3], np.floor(mean + 0.5))


# Surfaces

SQUARE = np.array([[0.0, -0.3, -0.3], [0.0, 0.3, -0.3], [0.0, 0.3, 0.3], [0.0, -0.3, 0.3]])
RED, BLUE = Material(diffuse=(1.0, 0.0, 0.0)), Material(diffuse=(0.0, 0.0, 1.0))


def square(texture: np.ndarray, repeat: float = 1.0) -> Mesh:
    """A square that faces front with a texture; seen from the front u runs to the right and v up."""
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * np.float32(repeat)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(SQUARE, faces, np.zeros(2, np.int32), (Material(texture=texture),), uv[faces])


def test_a_surface_modelled_once_for_each_side_shows_each(backend: str) -> None:
    """Common in ShapeNet: the same vertices twice, with both windings, in two materials."""
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]], np.int32)
    for order in ([0, 1, 2, 3], [2, 3, 0, 1]):
        material = np.array([0, 0, 1, 1], np.int32)[order]
        mesh = Mesh(SQUARE, faces[order], material, (RED, BLUE))
        front, back = render_mesh(mesh, np.array([0.0, 180.0]), np.zeros(2), 32, backend=backend)
        assert colour_at(front).round(1).tolist() == [1, 0, 0]
        assert colour_at(back).round(1).tolist() == [0, 0, 1]


def test_of_coincident_faces_the_first_is_seen_without_speckle() -> None:
    material = np.array([0, 0, 1, 1], np.int32)
    mesh = Mesh(SQUARE, np.array([[0, 1, 2], [0, 2, 3], [1, 2, 0], [2, 3, 0]], np.int32), material, (RED, BLUE))
    (image,) = render_mesh(mesh, np.array([33.0]), np.array([12.0]), 64)
    inside = image[..., 3] == 255
    assert inside.sum() > 300 and (image[inside][:, 2] == 0).all()


def test_textures_are_the_right_way_round_and_repeat(backend: str) -> None:
    texture = np.zeros((2, 2, 3), np.uint8)
    texture[0, 0], texture[0, 1], texture[1, 0] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    for repeat in (1, 3):
        (image,) = render_mesh(square(texture, repeat), np.zeros(1), np.zeros(1), 192, backend=backend)
        rows, columns = (np.flatnonzero((image[..., 3] == 255).any(axis=i)) for i in (1, 0))
        side = rows[-1] + 1 - rows[0]
        for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
            # The middle of each texel, of the last repetition to the right and down.
            place = [int(first + side * (1 - 1 / repeat + (0.25 + 0.5 * step) / repeat))
                     for first, step in ((rows[0], down), (columns[0], right))]  # fmt: skip
            assert np.abs(image[place[0], place[1], :3].astype(int) - texture[down, right]).max() < 40


def test_holes_of_a_texture_show_what_is_behind(backend: str) -> None:
    texture = np.full((8, 8, 4), 255, np.uint8)
    texture[:, :4, 3] = 0
    front = square(texture)
    behind = np.array([[-0.2, -0.3, -0.3], [-0.2, 0.3, -0.3], [-0.2, 0.3, 0.3], [-0.2, -0.3, 0.3]])
    mesh = Mesh(
        np.concatenate([front.vertices, behind]),
        np.concatenate([front.faces, front.faces + 4]),
        np.array([0, 0, 1, 1], np.int32),
        (*front.materials, BLUE),
        np.concatenate([front.uv, np.zeros((2, 3, 2), np.float32)]),  # type: ignore[list-item]
    )
    (alone,), (both,) = (render_mesh(m, np.zeros(1), np.zeros(1), 64, backend=backend) for m in (front, mesh))
    assert alone[32, 24, 3] == 0 and alone[32, 40, 3] == 255
    assert both[32, 24].tolist() == [0, 0, 255, 255] and both[32, 40].tolist() == [255, 255, 255, 255]


def test_vertex_colours_blend_across_a_face(backend: str) -> None:
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    mesh = Mesh(SQUARE[:3], np.array([[0, 1, 2]], np.int32), np.zeros(1, np.int32), (Material(),), None, colours[None])
    (image,) = render_mesh(mesh, np.zeros(1), np.zeros(1), 128, backend=backend)
    (place,) = project(SQUARE[:3].mean(axis=0, keepdims=True), look_from(np.zeros(1), np.zeros(1)))[0]
    assert np.allclose(colour_at(image, place[1], place[0]), 1 / 3, atol=0.03)


# Both renderers


def agree(mesh: Mesh) -> None:
    """Silhouettes overlap by at least 97 % and colours inside are close, on random views and lights."""
    try:
        opengl.check()
    except Exception as error:
        pytest.skip(f"OpenGL cannot draw here: {type(error).__name__}: {error}")
    rng = np.random.default_rng(0)
    lights = rng.normal(size=(4, 3))
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    azimuth, elevation = rng.uniform(0, 360, 4), rng.uniform(-20, 40, 4)
    a, b = (render_mesh(mesh, azimuth, elevation, 192, 2, name, lights).astype(float) for name in BACKENDS)  # type: ignore[arg-type]
    overlap = np.minimum(a[..., 3], b[..., 3]).sum() / np.maximum(a[..., 3], b[..., 3]).sum()
    assert overlap > 0.97
    inside = (a[..., 3] == 255) & (b[..., 3] == 255)
    assert np.abs(a - b)[inside][:, :3].mean() < 4


def test_renderers_agree_on_the_box(box: Mesh) -> None:
    agree(box)


@pytest.mark.parametrize(
    ("version", "category"), [("v1", "car"), ("v1", "chair"), ("v1", "tvmonitor"), ("v2", "aeroplane")]
)
def test_renderers_agree_on_real_models(version: str, category: str) -> None:
    agree(load_model(find_models(real_data() / f"ShapeNetCore.{version}", category)[0]))


def test_pyrender_falls_back_with_one_warning(
    box: Mesh, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> None:
        raise ImportError("no display")

    monkeypatch.setattr(opengl, "check", fail)
    with caplog.at_level(logging.WARNING):
        assert choose_backend("pyrender") == "raycast"
    assert [r.getMessage() for r in caplog.records] == [
        "pyrender cannot render here (ImportError: no display): using the ray caster"
    ]


# Bad input


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"azimuth": np.zeros(2)}, "one of each for every view"),
        ({"lights": np.zeros((2, 3))}, "a direction for every view"),
        ({"size": 0}, "expected 1 or more"),
        ({"supersample": 0}, "expected 1 or more"),
        ({"backend": "blender"}, "unknown renderer 'blender'"),
    ],
)
def test_bad_arguments(box: Mesh, change: dict, message: str) -> None:
    with pytest.raises(ViewnetError, match=message):
        render_mesh(**{"mesh": box, "azimuth": np.zeros(1), "elevation": np.zeros(1), **change})


def test_a_mesh_that_is_not_normalised(box: Mesh) -> None:
    large = Mesh(box.vertices * 3, box.faces, box.material, box.materials)
    with pytest.raises(ViewnetError, match="normalise"):
        render_mesh(large, np.zeros(1), np.zeros(1))


def test_the_shader_leaves_out_what_the_ray_caster_does() -> None:
    assert f"< {ALPHA_CUT}.0) discard" in (opengl.SHADERS / "mesh.frag").read_text()
