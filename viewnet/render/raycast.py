"""The ray caster: rays through every pixel by Embree (embreex), shading in NumPy; no OpenGL.

A pixel's colour is the mean of its covered samples (`supersample` each way) and its alpha their share. Shading is
`AMBIENT + (1 - AMBIENT) max(0, n.l)` with the face's flat normal towards the camera and one directional light. Of faces
with the same corners the first in the file is visible, and of two that face opposite ways the one towards the camera.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene

from viewnet.render.camera import DISTANCE, FOCAL, project
from viewnet.render.mesh import Mesh, surfaces

AMBIENT = 0.4
ALPHA_CUT = 128  # texels more transparent than this are holes
STEP = 1e-5  # distance behind a hole from which its ray continues, above the rounding errors of single precision
_device = lru_cache(maxsize=1)(EmbreeDevice)
BATCH = 2**18  # rays cast and hits shaded at once, which bounds memory


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """A mesh ready for casting. The corners of a face are in the order of their vertices' numbers."""

    scene: EmbreeScene
    vertices: np.ndarray  # (V, 3) float64
    front: np.ndarray  # (G,) face of each triangle of the scene, visible where it faces the camera
    back: np.ndarray  # (G,) face visible in its place where it does not
    normals: np.ndarray  # (F, 3) float64
    planes: np.ndarray  # (F,) float64: the face's distance from the origin along its normal
    material: np.ndarray  # (F,) int32
    diffuse: np.ndarray  # (M, 3) float32, 0..255
    texture: np.ndarray  # (M, 3) int64: offset into texels, height, width (0: no texture)
    texels: np.ndarray  # (T, 4) uint8, all textures
    holes: np.ndarray  # (M,) bool: materials with holes
    uv: np.ndarray | None  # (F, 3, 2) float32
    colours: np.ndarray | None  # (F, 3, 3) float32, 0..255


def prepare(mesh: Mesh) -> Surface:
    """Prepare a mesh once for all its views."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.sqrt(np.einsum("fi,fi->f", normals, normals)), 1e-300)[:, None]
    front, back = surfaces(mesh.faces)
    order = np.argsort(mesh.faces, axis=1, kind="stable")
    faces = np.take_along_axis(mesh.faces, order, axis=1)
    scene = EmbreeScene(_device(), robust=True)
    TriangleMesh(scene, mesh.vertices.astype(np.float32), faces[front].astype(np.int32))
    texture = np.zeros((len(mesh.materials), 3), np.int64)
    holes = np.zeros(len(mesh.materials), bool)
    blocks = [np.zeros((0, 4), np.uint8)]
    for number, material in enumerate(mesh.materials):
        if material.texture is not None and mesh.uv is not None:
            height, width, channels = material.texture.shape
            texture[number] = sum(map(len, blocks)), height, width
            block = np.full((height * width, 4), 255, np.uint8)
            block[:, :channels] = material.texture.reshape(-1, channels)
            holes[number] = bool((block[:, 3] < ALPHA_CUT).any())
            blocks.append(block)
    planes, texels = np.einsum("fi,fi->f", normals, corners[:, 0]), np.concatenate(blocks)
    diffuse = np.array([material.diffuse for material in mesh.materials], np.float32) * 255
    uv = None if mesh.uv is None else np.take_along_axis(mesh.uv, order[:, :, None], axis=1)
    colours = None if mesh.colours is None else np.take_along_axis(mesh.colours, order[:, :, None], axis=1) * 255
    return Surface(
        scene, mesh.vertices, front, back, normals, planes, mesh.material, diffuse, texture, texels, holes, uv, colours
    )


def render(
    surface: Surface, world_from_camera: np.ndarray, lights: np.ndarray, size: int, supersample: int
) -> np.ndarray:
    """Straight-alpha RGBA (V, size, size, 4) uint8 for cameras (V, 3, 3) and unit directions to the light (V, 3)."""
    facing = DISTANCE * world_from_camera[:, :, 2] @ surface.normals.T > surface.planes
    seen = np.where(facing[:, surface.front], surface.front, surface.back)
    diffuse = lights @ surface.normals.T
    shade = AMBIENT + (1 - AMBIENT) * np.maximum(np.where(facing, diffuse, -diffuse), 0)
    covered = np.zeros(len(world_from_camera) * size**2)
    total = np.zeros((3, len(covered)))
    for view, pixel, triangle, u, v in _batches(_cast(surface, world_from_camera, seen, size, supersample)):
        face = seen[view, triangle]
        colour = shade[view, face, None] * _albedo(surface, face, u, v)
        covered += np.bincount(pixel, minlength=len(covered))
        for channel in range(3):
            total[channel] += np.bincount(pixel, colour[:, channel], len(covered))
    images = np.zeros((len(covered), 4), np.uint8)
    inside = np.flatnonzero(covered)
    images[inside, :3] = np.minimum(total[:, inside] / covered[inside], 255).T + 0.5
    images[inside, 3] = 255 * covered[inside] / supersample**2 + 0.5
    return images.reshape(len(world_from_camera), size, size, 4)


Hits = tuple[np.ndarray, ...]
"""Of rays that hit a face: view, pixel of all views, triangle of the scene, and Embree's coordinates u and v."""


def _batches(parts: Iterator[Hits]) -> Iterator[Hits]:
    """Join hits of several views, up to BATCH, for few and large array operations."""
    pending: list[Hits] = []
    for part in parts:
        pending.append(part)
        if sum(len(waiting[0]) for waiting in pending) >= BATCH:
            yield tuple(np.concatenate(arrays) for arrays in zip(*pending, strict=True))
            pending = []
    if pending:
        yield tuple(np.concatenate(arrays) for arrays in zip(*pending, strict=True))


def _cast(
    surface: Surface, world_from_camera: np.ndarray, seen: np.ndarray, size: int, supersample: int
) -> Iterator[Hits]:
    """Cast the rays of every sample in the mesh's bounding box in each image, some rows at a time."""
    samples = size * supersample
    places = (np.arange(samples) + 0.5) / samples - 0.5
    boxes = project(surface.vertices, world_from_camera) * samples - 0.5
    # A little wider than the box, as the rays are of single precision.
    lows = np.clip(np.ceil(boxes.min(axis=1) - 0.01), 0, samples).astype(int)
    highs = np.clip(np.floor(boxes.max(axis=1) + 0.01) + 1, 0, samples).astype(int)
    for view, (camera, (left, top), (right, bottom)) in enumerate(zip(world_from_camera, lows, highs, strict=True)):
        if (width := int(right - left)) == 0:
            continue
        axes = camera.astype(np.float32)
        origin = np.float32(DISTANCE) * axes[:, 2]
        height = max(1, BATCH // width)
        for row in range(int(top), int(bottom), height):
            end = min(row + height, bottom)
            rays = np.empty((end - row, width, 3), np.float32)
            rays[..., 0] = places[left:right] / FOCAL
            rays[..., 1] = -places[row:end, None] / FOCAL
            rays[..., 2] = -1
            hit, triangle, u, v = _first(surface, seen[view], origin, rays.reshape(-1, 3) @ axes.T)
            down, along = row + hit // width, left + hit % width
            pixel = (view * size + down // supersample) * size + along // supersample
            yield np.full(len(hit), view), pixel, triangle, u, v


def _first(surface: Surface, seen: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> Hits:
    """Which rays hit a face, and the triangles and coordinates of the first hits; rays continue through holes."""
    cast = surface.scene.run(np.broadcast_to(origin, directions.shape), directions, output=1)
    triangle, u, v = cast["primID"], cast["u"], cast["v"]
    hit = np.flatnonzero(triangle >= 0)
    if surface.holes.any():
        travelled, going = cast["tfar"], hit
        while len(going := going[_in_hole(surface, seen[triangle[going]], u[going], v[going])]):
            travelled[going] += np.float32(STEP)
            onward = directions[going]
            cast = surface.scene.run(origin + travelled[going, None] * onward, onward, output=1)
            triangle[going], u[going], v[going] = cast["primID"], cast["u"], cast["v"]
            going = going[cast["primID"] >= 0]
            travelled[going] += cast["tfar"][cast["primID"] >= 0]
        hit = np.flatnonzero(triangle >= 0)
    return hit, triangle[hit], u[hit], v[hit]


def _blend(values: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Values (n, c) at Embree's coordinates (n,) of those at the corners (n, 3, c)."""
    return values[:, 0] * (1 - u - v)[:, None] + values[:, 1] * u[:, None] + values[:, 2] * v[:, None]


def _in_hole(surface: Surface, face: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n,) bool: whether a ray hits a transparent part of a texture."""
    holed = np.flatnonzero(surface.holes[surface.material[face]])
    transparent = np.zeros(len(face), bool)
    transparent[holed] = _texture(surface, face[holed], u[holed], v[holed])[:, 3] < ALPHA_CUT
    return transparent


def _albedo(surface: Surface, face: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Unshaded colours (n, 3), 0..255."""
    material = surface.material[face]
    colour = surface.diffuse[material] if surface.colours is None else _blend(surface.colours[face], u, v)
    if len(surface.texels):
        mapped = np.flatnonzero(surface.texture[material, 1])
        colour[mapped] = _texture(surface, face[mapped], u[mapped], v[mapped])[:, :3]
    return colour


def _texture(surface: Surface, face: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """RGBA (n, 4), 0..255, of textured faces: bilinear, repeating; row 0 of a texture is at the top."""
    assert surface.uv is not None
    offset, height, width = surface.texture[surface.material[face]].T
    place = _blend(surface.uv[face], u, v).astype(np.float64)
    place -= np.floor(place)
    x, y = place[:, 0] * width - 0.5, (1 - place[:, 1]) * height - 0.5
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    along, down = (x - left)[:, None], (y - top)[:, None]
    upper, lower = (offset + (row % height) * width for row in (top, top + 1))
    before, after = left % width, (left + 1) % width
    texel = surface.texels
    first = texel[upper + before] * (1 - along) + texel[upper + after] * along
    second = texel[lower + before] * (1 - along) + texel[lower + after] * along
    return first * (1 - down) + second * down
