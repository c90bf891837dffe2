"""Assembles one CAD model from coloured or textured parts.

Everything is in the object frame (z up, +x front, +y left) and in any unit: the writer centres and scales. Parts are
made of few triangles on purpose, since ray casting time depends on their number and the images are small.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Color = tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """A diffuse colour, each channel in 0..1, or a texture (H, W, 3) uint8 in its place."""

    color: Color
    texture: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class Part:
    """Triangles of one material: vertices (N, 3), faces (M, 3), texture coordinates (N, 2) or none."""

    vertices: Array
    faces: NDArray[np.int64]
    material: str
    uv: Array | None


class Builder:
    """Collects coloured or textured parts of one model in the object frame (z up, x front, y left; any units)."""

    def __init__(self) -> None:
        self.materials: dict[str, Material] = {}
        self.parts: list[Part] = []
        self._frames: list[tuple[Array, Array]] = []

    def material(self, name: str, color: Sequence[float], texture: NDArray[np.uint8] | None = None) -> str:
        """Declare a material and return its name. Declaring the same one twice is allowed; two under one name is not.

        Raises ValueError for a name with spaces, a colour outside 0..1 or a texture that is not (H, W, 3) uint8.
        """
        if not name or any(c.isspace() for c in name):
            raise ValueError(f"material name {name!r}: must be one word")
        rgb = tuple(float(c) for c in color)
        if len(rgb) != 3 or not all(0.0 <= c <= 1.0 for c in rgb):
            raise ValueError(f"material {name}: color {rgb} must be three values in 0..1")
        if texture is not None and (texture.ndim != 3 or texture.shape[2] != 3 or texture.dtype != np.uint8):
            raise ValueError(f"material {name}: texture must be (H, W, 3) uint8, not {texture.shape} {texture.dtype}")
        known = self.materials.get(name)
        if known is None:
            self.materials[name] = Material((rgb[0], rgb[1], rgb[2]), texture)
        elif known.color != rgb or known.texture is not texture:
            raise ValueError(f"material {name}: declared before with another color or texture")
        return name

    def add(self, vertices: ArrayLike, faces: ArrayLike, material: str, uv: ArrayLike | None = None) -> None:
        """Add triangles: vertices (N, 3), faces (M, 3) of vertex indices, texture coordinates (N, 2) (v upwards)."""
        textured = self._textured(material)
        points = np.asarray(vertices, dtype=np.float64)
        for rotation, offset in reversed(self._frames):
            points = points @ rotation.T + offset
        indices = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
        coordinates = None if uv is None else np.asarray(uv, dtype=np.float64)
        if textured and coordinates is None:
            raise ValueError(f"material {material!r} has a texture: its faces need texture coordinates")
        self.parts.append(Part(points, indices, material, coordinates))

    @contextmanager
    def both_sides(self) -> Iterator[None]:
        """Repeat at -y everything that is added inside the block."""
        first = len(self.parts)
        yield
        flip = np.array([1.0, -1.0, 1.0])
        self.parts += [Part(p.vertices * flip, p.faces[:, ::-1], p.material, p.uv) for p in self.parts[first:]]

    @contextmanager
    def placed(self, offset: ArrayLike = (0, 0, 0), rotation: ArrayLike | None = None) -> Iterator[None]:
        """Rotate (3x3), then shift by `offset`, everything that is added inside the block. Blocks nest."""
        turn = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
        self._frames.append((turn, np.asarray(offset, dtype=np.float64)))
        try:
            yield
        finally:
            self._frames.pop()

    def box(
        self,
        center: ArrayLike,
        size: ArrayLike,
        material: str,
        rotation: ArrayLike | None = None,
        taper: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        """A box of `size` (x, y, z); `taper` scales its top face in x and y; textures cover each side face once."""
        half = np.asarray(size, dtype=np.float64) / 2
        corners = np.array([[x, y, z] for z in (-1.0, 1.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        corners[4:, :2] *= taper
        corners = corners * half
        if rotation is not None:
            corners = corners @ np.asarray(rotation, dtype=np.float64).T
        corners = corners + np.asarray(center, dtype=np.float64)
        sides = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7), (3, 2, 1, 0)]
        if not self._textured(material):
            self.add(corners, [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))], material)
        else:
            uv = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (6, 1))
            self.add(corners[np.ravel(sides)], _quads(6), material, uv)

    def cylinder(
        self,
        start: ArrayLike,
        end: ArrayLike,
        radius: float,
        material: str,
        end_radius: float | None = None,
        sections: int = 12,
        caps: bool = True,
    ) -> None:
        """A round bar from `start` to `end`; another `end_radius` makes it a cone or a frustum."""
        a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
        side, other = _across(b - a)
        angle = np.arange(sections) * (2 * np.pi / sections)
        circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
        self.loft([a + radius * circle, b + (radius if end_radius is None else end_radius) * circle], material, caps)

    def ellipsoid(
        self, center: ArrayLike, radii: ArrayLike, material: str, sections: tuple[int, int] = (12, 8)
    ) -> None:
        """An ellipsoid with `sections` (around z, from pole to pole)."""
        turn = np.arange(sections[0]) * (2 * np.pi / sections[0])
        tilt = np.linspace(-np.pi / 2, np.pi / 2, sections[1] + 1)
        circle = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], -1)
        scale = np.asarray(radii, dtype=np.float64)
        middle = np.asarray(center, dtype=np.float64)
        rings = [(circle * np.cos(t) + np.array([0, 0, np.sin(t)])) * scale + middle for t in tilt]
        self.loft(rings, material, caps=False)

    def loft(
        self,
        rings: Sequence[ArrayLike],
        material: str | Sequence[str | Sequence[str]],
        caps: bool | tuple[bool, bool] = True,
        uv: ArrayLike | None = None,
    ) -> None:
        """Skin over closed rings, each (K, 3), joined point to point.

        `material`: one name, or one for each strip between two rings, or in place of a strip's name K names, one for
        each cell (cell k lies between points k and k + 1). `caps` closes the first and last ring (of convex shape) in
        the nearest strip's material. `uv` (rings, K + 1, 2) is for textured skins; caps take the ring's coordinates.
        """
        grid = np.stack([np.asarray(r, dtype=np.float64) for r in rings])
        count, around = grid.shape[:2]
        strips = [material] * (count - 1) if isinstance(material, str) else list(material)
        if len(strips) != count - 1:
            raise ValueError(f"loft of {count} rings needs {count - 1} materials, not {len(strips)}")
        cells = [[s] * around if isinstance(s, str) else list(s) for s in strips]
        coordinates = None if uv is None else np.asarray(uv, dtype=np.float64)
        if coordinates is not None:
            # The seam's point is duplicated, since its texture coordinate differs on either side.
            grid = np.concatenate([grid, grid[:, :1]], axis=1)
            coordinates = coordinates.reshape(-1, 2)
        width = grid.shape[1]
        faces = _cells(count, around, width)
        points = grid.reshape(-1, 3)
        if isinstance(material, str):
            self.add(points, faces.reshape(-1, 3), material, coordinates)
        else:
            names = np.array(cells, dtype=object)
            for name in dict.fromkeys(names.ravel()):
                self.add(points, faces[names == name].reshape(-1, 3), str(name), coordinates)
        low, high = (caps, caps) if isinstance(caps, bool) else caps
        fan = _fan(around)
        if low:
            self.add(points, fan[:, ::-1], cells[0][0], coordinates)
        if high:
            self.add(points, fan + (count - 1) * width, cells[-1][0], coordinates)

    def extrude(self, outline: ArrayLike, axis: str, low: float, high: float, material: str) -> None:
        """A prism over a simple polygon (K, 2), which may be concave, from `low` to `high` along `axis`.

        The outline's coordinates are the two other axes in order: (y, z) for x, (x, z) for y, (x, y) for z. A textured
        prism maps the outline's bounding box onto the texture.
        """
        flat = np.asarray(outline, dtype=np.float64)
        if _area(flat) < 0:
            flat = flat[::-1]
        count = len(flat)
        position = "xyz".index(axis)
        points = np.concatenate([np.insert(flat, position, low, axis=1), np.insert(flat, position, high, axis=1)])
        k = np.arange(count)
        n = (k + 1) % count
        walls = np.concatenate([np.stack([k, n, n + count], -1), np.stack([k, n + count, k + count], -1)])
        lid = triangulate(flat)
        faces = np.concatenate([walls, lid + count, lid[:, ::-1]])
        uv = None
        if self._textured(material):
            uv = np.tile((flat - flat.min(0)) / np.maximum(np.ptp(flat, axis=0), 1e-12), (2, 1))
        # (x, z) is the one pair of axes whose product points backwards along the third.
        self.add(points, faces[:, ::-1] if axis == "y" else faces, material, uv)

    def polygon(self, corners: ArrayLike, material: str) -> None:
        """A flat convex face (K, 3)."""
        points = np.asarray(corners, dtype=np.float64)
        self.add(points, [(0, k, k + 1) for k in range(1, len(points) - 1)], material)

    def quad(self, corners: ArrayLike, material: str, uv: ArrayLike | None = None) -> None:
        """A four-sided face (4, 3), counter-clockwise from the lower left corner of its texture."""
        if uv is None and self._textured(material):
            uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
        self.add(corners, _quads(1), material, uv)

    def tube(self, points: ArrayLike, radius: float | Sequence[float], material: str, sections: int = 8) -> None:
        """A round tube along a polyline (K, 3) with one radius or one for each point; not closed."""
        path = np.asarray(points, dtype=np.float64)
        steps = _unit(np.diff(path, axis=0))
        tangents = _unit(np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]]))
        radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(path))
        angle = np.arange(sections) * (2 * np.pi / sections)
        cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
        side = _across(tangents[0])[0]
        rings = []
        for point, tangent, r in zip(path, tangents, radii, strict=True):
            # Carrying the frame along keeps the tube from twisting where the path turns.
            side = side - (side @ tangent) * tangent
            norm = math.sqrt(side @ side)
            side = side / norm if norm > 1e-6 else _across(tangent)[0]
            rings.append(point + r * (cosine * side + sine * _cross(tangent, side)))
        self.loft(rings, material)

    def _textured(self, material: str) -> bool:
        if material not in self.materials:
            raise ValueError(f"material {material!r} is not declared: expected one of {', '.join(self.materials)}")
        return self.materials[material].texture is not None

    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3) of everything added so far; raises ValueError for an empty model."""
        if not self.parts:
            raise ValueError("the model is empty: add a part first")
        used = np.concatenate([p.vertices[p.faces.ravel()] for p in self.parts])
        return np.stack([used.min(0), used.max(0)])


def rotation_about(axis: str, degrees: float) -> Array:
    """Rotation (3, 3) about x, y or z, counter-clockwise when the axis points at the viewer."""
    a = np.deg2rad(degrees)
    c, s = np.cos(a), np.sin(a)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def triangulate(outline: ArrayLike) -> NDArray[np.int64]:
    """Triangles (K - 2, 3) of a simple polygon (K, 2) given counter-clockwise, by ear clipping."""
    points = [(float(x), float(y)) for x, y in np.asarray(outline, dtype=np.float64)]
    left = list(range(len(points)))
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        for at in range(len(left)):
            a, b, c = left[at - 1], left[at], left[(at + 1) % len(left)]
            pa, pb, pc = points[a], points[b], points[c]
            if _turn(pa, pb, pc) <= 0:
                continue
            others = (points[i] for i in left if i not in (a, b, c))
            if not any(_turn(pa, pb, p) >= 0 and _turn(pb, pc, p) >= 0 and _turn(pc, pa, p) >= 0 for p in others):
                break
        else:
            # Only collinear runs have no ear left; dropping a point of one changes nothing.
            at = 0
            a, b, c = left[-1], left[0], left[1]
        triangles.append((a, b, c))
        del left[at]
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles, dtype=np.int64)


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _area(outline: Array) -> float:
    x, y = outline[:, 0], outline[:, 1]
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2


def _across(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed frame with `direction` as the third."""
    unit = _unit(direction)
    helper = np.array([0.0, 0.0, 1.0]) if abs(unit[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    side = _unit(_cross(helper, unit))
    return side, _cross(unit, side)


def _cross(a: Array, b: Array) -> Array:
    """The cross product of two vectors (3,), faster than numpy's general one."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to length 1; those of no length stay 0."""
    return vectors / np.maximum(np.sqrt(np.sum(vectors * vectors, axis=-1, keepdims=True)), 1e-12)


@lru_cache(maxsize=512)
def _cells(count: int, around: int, width: int) -> NDArray[np.int64]:
    """The two triangles of each cell of a skin, (count - 1, around, 2, 3)."""
    i, k = np.meshgrid(np.arange(count - 1), np.arange(around), indexing="ij")
    a, b = i * width + k, i * width + (k + 1) % width
    faces = np.stack([np.stack([a, b, b + width], -1), np.stack([a, b + width, a + width], -1)], 2)
    faces.setflags(write=False)
    return faces


@lru_cache(maxsize=64)
def _fan(around: int) -> NDArray[np.int64]:
    """Triangles of a convex polygon."""
    fan = np.array([(0, j, j + 1) for j in range(1, around - 1)])
    fan.setflags(write=False)
    return fan


def _quads(count: int) -> NDArray[np.int64]:
    base = np.arange(count)[:, None, None] * 4
    return (base + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
