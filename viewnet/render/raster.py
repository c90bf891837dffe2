"""The software renderer: a z-buffer in compiled loops, without OpenGL.

Every sample (pixel divided `supersample` times each way) takes the nearest face at its centre; a pixel's colour is
the mean of its covered samples and its alpha the share of them. Shading is `AMBIENT + (1 - AMBIENT) max(0, n.l)` with
the face's flat normal turned to the camera and one directional light. Where faces coincide the first in the file is
seen, and of two that face opposite ways (a surface modelled once for each side) the one turned to the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from viewnet.data.mesh import Mesh
from viewnet.render.camera import DISTANCE, FOCAL

AMBIENT = 0.4
# Texels more transparent than this are holes.
ALPHA_CUT = 128
# Relative difference of inverse depth below which two faces coincide.
TIE = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """A mesh as the kernel takes it: all textures in one buffer, a unit normal a face."""

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3) int32
    normals: np.ndarray  # (F, 3) float64
    one_sided: np.ndarray  # (F,) bool: a coincident face looks the other way
    material: np.ndarray  # (F,) int32
    diffuse: np.ndarray  # (M, 3) float32, 0..255
    texture: np.ndarray  # (M, 4) int64: offset into texels, height, width, channels (0: no texture)
    texels: np.ndarray  # (T,) uint8
    uv: np.ndarray  # (F or 0, 3, 2) float32
    colours: np.ndarray  # (V or 0, 3) float32, 0..255


def prepare(mesh: Mesh) -> Surface:
    """What the kernel needs of a mesh, once for all its views."""
    corners = mesh.vertices[mesh.faces]
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = np.cross(edge, other)
    normals /= np.maximum(np.sqrt(np.einsum("fi,fi->f", normals, normals)), 1e-300)[:, None]
    texture = np.zeros((len(mesh.materials), 4), np.int64)
    texels: list[np.ndarray] = []
    offset = 0
    for number, material in enumerate(mesh.materials):
        if material.texture is not None:
            texture[number] = offset, *material.texture.shape
            texels.append(material.texture.reshape(-1))
            offset += material.texture.size
    return Surface(
        mesh.vertices,
        mesh.faces,
        normals,
        one_sided(mesh),
        mesh.material,
        np.array([m.diffuse for m in mesh.materials], np.float32) * 255,
        texture,
        np.concatenate(texels) if texels else np.zeros(0, np.uint8),
        mesh.uv if mesh.uv is not None else np.zeros((0, 3, 2), np.float32),
        np.zeros((0, 3), np.float32) if mesh.colours is None else mesh.colours * np.float32(255),
    )


def one_sided(mesh: Mesh) -> np.ndarray:
    """(F,) bool: faces with the vertices of another that is wound the other way. Each is seen from its front only."""
    faces = mesh.faces.astype(np.int64)
    # Rotated so that the smallest index leads; then the winding is the order of the other two.
    lead = np.argmin(faces, axis=1)
    rows = np.arange(len(faces))
    first, second, third = (faces[rows, (lead + i) % 3] for i in range(3))
    size = len(mesh.vertices)
    key = (first * size + np.minimum(second, third)) * size + np.maximum(second, third)
    unique, group, counts = np.unique(key, return_inverse=True, return_counts=True)
    if len(unique) == len(key):
        return np.zeros(len(faces), bool)
    forward = np.bincount(group, weights=second < third)
    return ((forward > 0) & (forward < counts))[group]


def draw(surface: Surface, frames: np.ndarray, lights: np.ndarray, size: int, supersample: int) -> np.ndarray:
    """Straight-alpha RGBA (V, size, size, 4) uint8 for camera frames and unit directions to the light (see render)."""
    images = np.zeros((len(frames), size, size, 4), np.uint8)
    # Always of the same types and memory layout: the kernel is compiled anew for each combination.
    arrays = [
        np.ascontiguousarray(array, dtype)
        for array, dtype in (
            (surface.vertices, np.float64),
            (surface.faces, np.int32),
            (surface.normals, np.float64),
            (surface.one_sided, np.bool_),
            (surface.material, np.int32),
            (surface.diffuse, np.float32),
            (surface.texture, np.int64),
            (surface.texels, np.uint8),
            (surface.uv, np.float32),
            (surface.colours, np.float32),
            (frames, np.float64),
            (lights, np.float64),
        )
    ]
    _draw(*arrays, supersample, DISTANCE, FOCAL, images)  # type: ignore[call-arg]
    return images


@numba.njit(cache=True, nogil=True)
def _texel(texels, entry, u, v, channel):  # type: ignore[no-untyped-def]
    """Bilinear, repeating; row 0 of the texture is v = 1."""
    offset, height, width, channels = entry
    x = (u - np.floor(u)) * width - 0.5
    y = (1.0 - (v - np.floor(v))) * height - 0.5
    left, top = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - left, y - top
    x0, x1 = left % width, (left + 1) % width
    y0, y1 = top % height, (top + 1) % height
    a = texels[offset + (y0 * width + x0) * channels + channel] * (1.0 - fx)
    a += texels[offset + (y0 * width + x1) * channels + channel] * fx
    b = texels[offset + (y1 * width + x0) * channels + channel] * (1.0 - fx)
    b += texels[offset + (y1 * width + x1) * channels + channel] * fx
    return a * (1.0 - fy) + b * fy


@numba.njit(cache=True, nogil=True)
def _draw(  # type: ignore[no-untyped-def]
    vertices, faces, normals, one_sided, material, diffuse, texture, texels, uv, colours,
    frames, lights, supersample, distance, focal, images,
):  # fmt: skip
    size = images.shape[1]
    n = size * supersample
    count = len(vertices)
    sx, sy, sw = np.empty(count), np.empty(count), np.empty(count)
    nearest = np.empty((n, n))
    seen = np.empty((n, n), np.int32)
    weights = np.empty((n, n, 2), np.float32)
    rgb = np.empty(3)
    for view in range(len(frames)):
        frame, light = frames[view], lights[view]
        for i in range(count):
            x, y, z = vertices[i]
            w = 1.0 / (distance - (x * frame[0, 2] + y * frame[1, 2] + z * frame[2, 2]))
            sx[i] = n * (0.5 + focal * (x * frame[0, 0] + y * frame[1, 0] + z * frame[2, 0]) * w)
            sy[i] = n * (0.5 - focal * (x * frame[0, 1] + y * frame[1, 1] + z * frame[2, 1]) * w)
            sw[i] = w
        nearest[:] = 0.0
        seen[:] = -1
        for f in range(len(faces)):
            i, j, k = faces[f]
            xi, xj, xk = sx[i], sx[j], sx[k]
            yi, yj, yk = sy[i], sy[j], sy[k]
            x0 = max(int(np.ceil(min(xi, xj, xk) - 0.5)), 0)
            x1 = min(int(np.floor(max(xi, xj, xk) - 0.5)), n - 1)
            y0 = max(int(np.ceil(min(yi, yj, yk) - 0.5)), 0)
            y1 = min(int(np.floor(max(yi, yj, yk) - 0.5)), n - 1)
            if x0 > x1 or y0 > y1:
                continue
            # Twice the area in the picture; rows go down, so a face turned to the camera has it negative.
            area = (xj - xi) * (yk - yi) - (xk - xi) * (yj - yi)
            if area == 0.0 or (area > 0.0 and one_sided[f]):
                continue
            scale = 1.0 / area
            entry = texture[material[f]]
            cut = entry[3] == 4
            for row in range(y0, y1 + 1):
                py = row + 0.5
                for column in range(x0, x1 + 1):
                    px = column + 0.5
                    a = ((xj - px) * (yk - py) - (xk - px) * (yj - py)) * scale
                    b = ((xk - px) * (yi - py) - (xi - px) * (yk - py)) * scale
                    c = 1.0 - a - b
                    if a < 0.0 or b < 0.0 or c < 0.0:
                        continue
                    w = a * sw[i] + b * sw[j] + c * sw[k]
                    if w <= nearest[row, column] * (1.0 + TIE):
                        continue
                    # Weights of the corners on the face itself (perspective correct).
                    b = b * sw[j] / w
                    c = c * sw[k] / w
                    if cut:
                        a = 1.0 - b - c
                        u = a * uv[f, 0, 0] + b * uv[f, 1, 0] + c * uv[f, 2, 0]
                        v = a * uv[f, 0, 1] + b * uv[f, 1, 1] + c * uv[f, 2, 1]
                        if _texel(texels, entry, u, v, 3) < ALPHA_CUT:
                            continue
                    nearest[row, column] = w
                    seen[row, column] = f
                    weights[row, column, 0] = b
                    weights[row, column, 1] = c
        for row in range(size):
            for column in range(size):
                rgb[:] = 0.0
                covered = 0
                for y in range(row * supersample, (row + 1) * supersample):
                    for x in range(column * supersample, (column + 1) * supersample):
                        f = seen[y, x]
                        if f < 0:
                            continue
                        covered += 1
                        i, j, k = faces[f]
                        b, c = weights[y, x, 0], weights[y, x, 1]
                        a = 1.0 - b - c
                        # Towards the camera from a corner of the face: on which side of its plane the camera is.
                        side, shade = 0.0, 0.0
                        for axis in range(3):
                            side += normals[f, axis] * (distance * frame[axis, 2] - vertices[i, axis])
                            shade += normals[f, axis] * light[axis]
                        if side < 0.0:
                            shade = -shade
                        shade = AMBIENT + (1.0 - AMBIENT) * max(shade, 0.0)
                        number = material[f]
                        if texture[number, 3] > 0:
                            u = a * uv[f, 0, 0] + b * uv[f, 1, 0] + c * uv[f, 2, 0]
                            v = a * uv[f, 0, 1] + b * uv[f, 1, 1] + c * uv[f, 2, 1]
                            for axis in range(3):
                                rgb[axis] += shade * _texel(texels, texture[number], u, v, axis)
                        elif number == 0 and len(colours) > 0:
                            for axis in range(3):
                                rgb[axis] += shade * (
                                    a * colours[i, axis] + b * colours[j, axis] + c * colours[k, axis]
                                )
                        else:
                            for axis in range(3):
                                rgb[axis] += shade * diffuse[number, axis]
                if covered > 0:
                    for axis in range(3):
                        images[view, row, column, axis] = int(min(rgb[axis] / covered, 255.0) + 0.5)
                    images[view, row, column, 3] = int(255.0 * covered / (supersample * supersample) + 0.5)
