"""Rendering CAD models from given viewpoints."""

import logging
from typing import Literal, get_args

import numpy as np

from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.render.camera import RADIUS, look_from
from viewnet.render.mesh import Mesh

Backend = Literal["auto", "raycast", "pyrender"]

VERSION = 2  # raise it when a change alters images: it is part of every view store's identity

log = logging.getLogger(__name__)


def render_mesh(
    mesh: Mesh,
    azimuth: np.ndarray,
    elevation: np.ndarray,
    size: int = 64,
    supersample: int = 2,
    backend: Backend = "auto",
    lights: np.ndarray | None = None,
) -> np.ndarray:
    """Straight-alpha RGBA images (V, size, size, 4) uint8 of a normalised mesh from viewpoints (V,) in degrees.

    `lights` (V, 3) are unit directions from the object to the light in the world frame; None puts it at the camera.
    Back ends share camera, lighting, flat normals, bilinear repeating textures and the treatment of transparency (holes
    of RGBA textures are left out, all else is opaque). The background is black, with alpha 0.
    Raises ViewnetError for sizes below 1, counts that do not match, and a mesh that is not normalised.
    """
    azimuth, elevation = np.atleast_1d(azimuth), np.atleast_1d(elevation)
    if azimuth.ndim != 1 or azimuth.shape != elevation.shape:
        raise ViewnetError(f"azimuth {azimuth.shape}, elevation {elevation.shape}: expected one of each for every view")
    world_from_camera = look_from(azimuth, elevation)
    lights = world_from_camera[:, :, 2] if lights is None else np.asarray(lights, dtype=np.float64)
    if lights.shape != (len(world_from_camera), 3):
        raise ViewnetError(f"lights {lights.shape}: expected ({len(world_from_camera)}, 3), a direction for every view")
    return render_cameras(mesh, world_from_camera, lights, size, supersample, choose_backend(backend))


def render_cameras(
    mesh: Mesh, world_from_camera: np.ndarray, lights: np.ndarray, size: int, supersample: int, backend: Backend
) -> np.ndarray:
    """As `render_mesh`, ViewnetErrors too, for world_from_camera (V, 3, 3) and a back end of `choose_backend`."""
    if size < 1 or supersample < 1:
        raise ViewnetError(f"size {size}, supersample {supersample}: expected 1 or more")
    if (reach := float(np.abs(mesh.vertices).max(initial=0))) > RADIUS + 1e-6:
        raise ViewnetError(f"the mesh reaches {reach:g} from its centre: normalise it to a bounding-box diagonal of 1")
    if backend == "pyrender":
        from viewnet.render import opengl  # late: its libraries take a third of a second in each process

        return opengl.render(mesh, world_from_camera, lights, size, supersample)
    from viewnet.render import raycast

    return raycast.render(raycast.prepare(mesh), world_from_camera, lights, size, supersample)


def choose_backend(backend: Backend) -> Backend:
    """The back end to render with: `auto` is the ray caster; pyrender falls back to it, with a warning.

    Raises ViewnetError for another name.
    """
    known(backend, get_args(Backend), "renderer")
    if backend != "pyrender":
        return "raycast"
    try:
        from viewnet.render import opengl

        opengl.check()
    except Exception as error:  # OpenGL stacks fail in many ways.
        log.warning("pyrender cannot render here (%s: %s): using the ray caster", type(error).__name__, error)
        return "raycast"
    return "pyrender"
