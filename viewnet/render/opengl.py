"""The OpenGL renderer: pyrender off screen (EGL or OSMesa), lit as by the ray caster, of which it is a check.

It needs pyrender and a driver, which not every machine has.
"""

import contextlib
import ctypes
import ctypes.util
import importlib
import os
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from viewnet.render.camera import DISTANCE, FOCAL, RADIUS
from viewnet.render.mesh import Material, Mesh, surfaces
from viewnet.render.raycast import AMBIENT

SHADERS = Path(__file__).parent / "shaders"
_LINEAR, _REPEAT = 9729, 10497


@lru_cache(maxsize=1)
def check() -> None:
    """Render one triangle; whatever is wrong with OpenGL or pyrender here is raised."""
    corners = np.array([[0.0, -0.3, -0.3], [0.0, 0.3, -0.3], [0.0, 0.0, 0.3]])
    mesh = Mesh(corners, np.array([[0, 1, 2]], np.int32), np.zeros(1, np.int32), (Material(),))
    camera = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    if render(mesh, camera[None], camera[None, :, 2], 8, 1)[0, 4, 4, 3] != 255:
        raise RuntimeError("a rendered triangle does not show")


def render(mesh: Mesh, world_from_camera: np.ndarray, lights: np.ndarray, size: int, supersample: int) -> np.ndarray:
    """Straight-alpha RGBA (V, size, size, 4) uint8 for cameras (V, 3, 3) and unit directions to the light (V, 3)."""
    pixels = size * supersample
    renderer, pyrender = _renderer(pixels), _pyrender()
    scene = pyrender.Scene(bg_color=np.zeros(4), ambient_light=np.full(3, AMBIENT))
    scene.add(pyrender.Mesh(list(_primitives(mesh))))
    focal, centre, near, far = FOCAL * pixels, pixels / 2, DISTANCE - 2 * RADIUS, DISTANCE + 2 * RADIUS
    camera = scene.add(pyrender.IntrinsicsCamera(focal, focal, centre, centre, near, far))
    light = scene.add(pyrender.DirectionalLight())
    images = np.zeros((len(world_from_camera), size, size, 4), np.uint8)
    for view, (pose, direction) in enumerate(zip(world_from_camera, lights, strict=True)):
        place = np.column_stack([pose, DISTANCE * pose[:, 2]])  # (3, 4)
        scene.set_pose(camera, np.vstack([place, [0, 0, 0, 1]]))
        scene.set_pose(light, trimesh.geometry.align_vectors([0, 0, 1], direction))
        fine, _ = renderer.render(scene, flags=pyrender.RenderFlags.RGBA)
        # Smoothed edges are over black, so colours are weighted by alpha already.
        total = fine.astype(np.float64).reshape(size, supersample, size, supersample, 4).sum(axis=(1, 3))
        alpha = total[..., 3:]
        colour = np.divide(total[..., :3] * 255, alpha, out=np.zeros_like(total[..., :3]), where=alpha > 0)
        images[view] = np.concatenate([colour.clip(0, 255), alpha / supersample**2], axis=-1) + 0.5
    return images


def _pyrender() -> Any:
    """The pyrender module. The platform must be chosen before OpenGL is first imported."""
    if "PYOPENGL_PLATFORM" not in os.environ and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        osmesa_only = ctypes.util.find_library("EGL") is None and ctypes.util.find_library("OSMesa") is not None
        os.environ["PYOPENGL_PLATFORM"] = "osmesa" if osmesa_only else "egl"
    # Triton, which PyTorch's optimisers load, crashes where Mesa's LLVM came first; the other order is harmless.
    with contextlib.suppress(ImportError):
        importlib.import_module("triton")
    if os.environ.get("PYOPENGL_PLATFORM") == "egl":
        import pyglet

        pyglet.options["headless"] = True  # pyrender imports its windows too, and those of X11 need X11's libraries
    import pyrender
    from OpenGL.arrays.ctypesparameters import CtypesParameterHandler

    # PyOpenGL 3.1.0, which pyrender asks for, finds this type by a name that Python 3.12 changed; textures need it.
    CtypesParameterHandler().register([type(ctypes.byref(ctypes.c_uint()))])
    return pyrender


_kept: dict[int, Any] = {}


def _renderer(pixels: int) -> Any:
    """An off-screen renderer with our shaders. Creating one takes half a second, so the last one is reused."""
    if pixels in _kept:
        return _kept[pixels]
    # One at a time: deleting a context ends the display that a second one would share.
    while _kept:
        _kept.popitem()[1].delete()
    pyrender = _pyrender()
    from pyrender.shader_program import ShaderProgramCache

    renderer = pyrender.OffscreenRenderer(pixels, pixels)
    # pyrender has no public way to other shaders; it has not changed since 2021.
    renderer._renderer._program_cache = ShaderProgramCache(shader_dir=SHADERS)
    _kept[pixels] = renderer
    return renderer


def _primitives(mesh: Mesh) -> Iterator[Any]:
    """One primitive for each material and sidedness; corners are not shared, for flat normals."""
    pyrender = _pyrender()
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    front, back = surfaces(mesh.faces)
    shown, single = np.zeros((2, len(mesh.faces)), bool)
    shown[front] = shown[back] = True
    single[front] = single[back] = front != back
    uv = np.zeros((len(mesh.faces), 3, 2)) if mesh.uv is None else mesh.uv
    for number in np.unique(mesh.material):
        entry = mesh.materials[number]
        textured = entry.texture is not None and mesh.uv is not None
        texels = entry.texture if textured else np.full((1, 1, 4), 255, np.uint8)
        if texels.shape[2] == 3:
            texels = np.concatenate([texels, np.full_like(texels[..., :1], 255)], axis=2)
        sampler = pyrender.Sampler(magFilter=_LINEAR, minFilter=_LINEAR, wrapS=_REPEAT, wrapT=_REPEAT)
        texture = pyrender.Texture(source=texels, source_channels="RGBA", sampler=sampler)
        colours = np.broadcast_to(np.ones(3) if textured else entry.diffuse, corners.shape)
        if mesh.colours is not None and not textured:
            colours = mesh.colours
        for one in (False, True):
            faces = shown & (mesh.material == number) & (single == one)
            if faces.any():
                yield pyrender.Primitive(
                    positions=corners[faces].reshape(-1, 3),
                    normals=np.repeat(normals[faces], 3, axis=0),
                    texcoord_0=uv[faces].reshape(-1, 2),
                    color_0=colours[faces].reshape(-1, 3),
                    material=pyrender.MetallicRoughnessMaterial(baseColorTexture=texture, doubleSided=not one),
                    mode=4,
                )
