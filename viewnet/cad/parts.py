"""Shapes shared by the furniture and household generators: swept members, bent boards, cushions, turned parts.

All take the finish (material) and, with `mirror=True`, also add the copy at -y. Texture coordinates, where the finish
has a texture, are u = y and v = z - x times the finish's scale: an even texture then looks the same left and right.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from viewnet.cad.finishes import Finish

if TYPE_CHECKING:
    from viewnet.cad.builder import Builder

_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_MIRROR = np.array([1.0, -1.0, 1.0])


def choose(rng: np.random.Generator, options: Mapping[str, float]) -> str:
    """A random key, with a probability in proportion to its value."""
    weights = np.fromiter(options.values(), float)
    return list(options)[int(rng.choice(len(weights), p=weights / weights.sum()))]


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    # Twice as fast as numpy's for arrays this small.
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    d, e, f = second[..., 0], second[..., 1], second[..., 2]
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], axis=-1)


def circle(count: int) -> np.ndarray:
    """Unit circle, (count, 2), counter-clockwise, symmetric about both axes for even counts."""
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


_SECTIONS = {
    "square": _SQUARE,
    "round": circle(8),
    "coarse": circle(6),
    "fine": circle(16),
    "soft": np.array([[-1, -0.6], [-0.6, -1], [0.6, -1], [1, -0.6], [1, 0.6], [0.6, 1], [-0.6, 1], [-1, 0.6]]),
}


def put(
    builder: "Builder",
    vertices: np.ndarray,
    faces: np.ndarray,
    finish: Finish,
    mirror: bool = False,
    uv: np.ndarray | None = None,
) -> None:
    """Adds a mesh: vertices (N, 3), faces (M, 3); with `mirror` also its copy at -y."""
    if finish.textured and uv is None:
        uv = finish.scale * np.stack([vertices[:, 1], vertices[:, 2] - vertices[:, 0]], axis=1)
    if not finish.textured:
        uv = None
    builder.add(vertices, faces, finish.name, uv)
    if mirror:
        builder.add(vertices * _MIRROR, faces[:, ::-1], finish.name, uv)


_strip_cache: dict[tuple[int, int, bool], np.ndarray] = {}


def _grid_faces(rows: int, columns: int, closed: bool) -> np.ndarray:
    key = (rows, columns, closed)
    if key not in _strip_cache:
        last = columns if closed else columns - 1
        row, column = np.meshgrid(np.arange(rows - 1), np.arange(last), indexing="ij")
        a = (row * columns + column).ravel()
        b = (row * columns + (column + 1) % columns).ravel()
        _strip_cache[key] = np.concatenate(
            [np.stack([a, b, b + columns], axis=1), np.stack([a, b + columns, a + columns], axis=1)]
        )
    return _strip_cache[key]


def sweep(
    builder: "Builder",
    path: ArrayLike,
    radii: ArrayLike,
    finish: Finish,
    section: str | np.ndarray = "square",
    side: ArrayLike = (0.0, 1.0, 0.0),
    mirror: bool = False,
    caps: bool = True,
    upright: bool = False,
) -> None:
    """A member of given cross-section along a path.

    path: (K, 3). radii: half sizes, a number, (2,), (K,) for K > 2, or (K, 2): first along `side` (made orthogonal to
    the path), then along the third direction. With `upright` all sections are horizontal, as for table legs.
    """
    points = np.asarray(path, float)
    count = len(points)
    half = np.asarray(radii, float)
    if half.ndim == 0:
        half = np.full((count, 2), half)
    elif half.ndim == 1:
        half = np.tile(half, (count, 1)) if half.shape == (2,) else np.stack([half, half], axis=1)
    reference = np.asarray(side, float)
    if upright:
        across = np.tile(reference / np.linalg.norm(reference), (count, 1))
        third = _cross(np.array([0.0, 0.0, 1.0]), across)
    else:
        steps = np.diff(points, axis=0)
        steps = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-12)
        tangent = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
        tangent = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        across = reference - (tangent @ reference)[:, None] * tangent
        length = np.linalg.norm(across, axis=1, keepdims=True)
        if np.any(length < 1e-3):
            reference = np.array([0.3, 0.0, 1.0]) if abs(reference[1]) > 0.5 else np.array([0.0, 1.0, 0.0])
            across = reference - (tangent @ reference)[:, None] * tangent
            length = np.linalg.norm(across, axis=1, keepdims=True)
        across = across / np.maximum(length, 1e-9)
        third = _cross(tangent, across)
    outline = _SECTIONS[section] if isinstance(section, str) else section
    rings = (
        points[:, None, :]
        + across[:, None, :] * (outline[None, :, :1] * half[:, None, :1])
        + third[:, None, :] * (outline[None, :, 1:] * half[:, None, 1:])
    )
    put(builder, rings.reshape(-1, 3), ring_faces(count, len(outline), caps), finish, mirror)


_ring_cache: dict[tuple[int, int, bool], np.ndarray] = {}


def ring_faces(count: int, sides: int, caps: bool) -> np.ndarray:
    """Triangles (M, 3) of the skin over `count` closed rings of `sides` points each, with flat ends."""
    key = (count, sides, caps)
    if key not in _ring_cache:
        faces = [_grid_faces(count, sides, closed=True)]
        if caps:
            fan = np.stack([np.zeros(sides - 2, int), np.arange(1, sides - 1), np.arange(2, sides)], axis=1)
            faces += [fan[:, ::-1], fan + (count - 1) * sides]
        _ring_cache[key] = np.concatenate(faces)
    return _ring_cache[key]


def bar(
    builder: "Builder",
    start: ArrayLike,
    end: ArrayLike,
    half: ArrayLike,
    finish: Finish,
    section: str = "square",
    end_half: ArrayLike | None = None,
    side: ArrayLike = (0.0, 1.0, 0.0),
    mirror: bool = False,
    upright: bool = False,
) -> None:
    """A straight member from start to end; `half`: half size, a number or (along side, along third direction)."""
    first = np.broadcast_to(np.asarray(half, float), (2,))
    second = first if end_half is None else np.broadcast_to(np.asarray(end_half, float), (2,))
    path = np.array([np.asarray(start, float), np.asarray(end, float)])
    sweep(builder, path, np.stack([first, second]), finish, section, side, mirror, upright=upright)


def turned(
    builder: "Builder",
    start: ArrayLike,
    end: ArrayLike,
    profile: ArrayLike,
    finish: Finish,
    mirror: bool = False,
    section: str = "round",
) -> None:
    """A part made on a lathe: profile (K, 2) of (position along start..end in 0..1, radius)."""
    shape = np.asarray(profile, float)
    low, high = np.asarray(start, float), np.asarray(end, float)
    sweep(builder, low + shape[:, :1] * (high - low), np.stack([shape[:, 1]] * 2, 1), finish, section, mirror=mirror)


def block(
    builder: "Builder", center: ArrayLike, size: ArrayLike, finish: Finish, mirror: bool = False, taper: float = 1.0
) -> None:
    """An upright box; `taper` scales its top."""
    middle, extent = np.asarray(center, float), np.asarray(size, float)
    rise = np.array([0.0, 0.0, extent[2] / 2])
    base = np.array([extent[1], extent[0]]) / 2
    sweep(
        builder,
        np.stack([middle - rise, middle + rise]),
        np.stack([base, base * taper]),
        finish,
        mirror=mirror,
        upright=True,
    )


def patch(rows: int, columns: int, roundness: float) -> np.ndarray:
    """Points of [-1, 1]^2, (rows, columns, 2), with corners rounded: 0 a square, 1 a disc. First axis first."""
    s, t = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    disc = np.stack([s * np.sqrt(1 - t**2 / 2), t * np.sqrt(1 - s**2 / 2)], axis=-1)
    return (1 - roundness) * np.stack([s, t], axis=-1) + roundness * disc


def shell(
    builder: "Builder",
    grid: np.ndarray,
    thickness: float | np.ndarray,
    finish: Finish,
    back: Finish | None = None,
    mirror: bool = False,
) -> None:
    """A bent board or cushion: the surface grid (U, V, 3) thickened to both sides along its normals.

    thickness: a number or (U, V). `back`: finish of the side against the normal d/du x d/dv, by default the same.
    """
    rows, columns = grid.shape[:2]
    along = np.empty_like(grid)
    along[1:-1], along[0], along[-1] = grid[2:] - grid[:-2], grid[1] - grid[0], grid[-1] - grid[-2]
    across = np.empty_like(grid)
    across[:, 1:-1], across[:, 0], across[:, -1] = (
        grid[:, 2:] - grid[:, :-2],
        grid[:, 1] - grid[:, 0],
        grid[:, -1] - grid[:, -2],
    )
    normal = _cross(along, across)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    offset = normal * (np.broadcast_to(np.asarray(thickness, float), (rows, columns))[..., None] / 2)
    upper, lower = (grid + offset).reshape(-1, 3), (grid - offset).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    rim = np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]])
    following = np.roll(rim, -1)
    size = rows * columns
    faces = _grid_faces(rows, columns, closed=False)[:, ::-1]
    edge = np.concatenate(
        [np.stack([rim, following + size, following], 1), np.stack([rim, rim + size, following + size], 1)]
    )
    both = np.concatenate([upper, lower])
    if back is None or back == finish:
        put(builder, both, np.concatenate([faces, faces[:, ::-1] + size, edge]), finish, mirror)
    else:
        put(builder, both, np.concatenate([faces, edge]), finish, mirror)
        put(builder, lower, faces[:, ::-1], back, mirror)


def pillow(rows: int, columns: int, thickness: float, edge: float = 0.4, power: float = 4.0) -> np.ndarray:
    """Thickness (rows, columns) of a cushion: full in the middle, `edge` of it at the rim."""
    s, t = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)[None, :]
    return thickness * (edge + (1 - edge) * (1 - np.abs(s) ** power) * (1 - np.abs(t) ** power))


def cushion(
    builder: "Builder",
    center: ArrayLike,
    size: ArrayLike,
    finish: Finish,
    roundness: float = 0.15,
    edge: float = 0.5,
    axes: ArrayLike | None = None,
    mirror: bool = False,
    rows: int = 5,
    columns: int = 6,
) -> None:
    """A stuffed box of size (length along x, along y, thickness along z), or along the rows of `axes` (3, 3)."""
    extent = np.asarray(size, float)
    frame = np.eye(3) if axes is None else np.asarray(axes, float)
    flat = patch(rows, columns, roundness) * (extent[:2] / 2)
    # Rim points crowd towards the edge, so that the flat top reaches nearly to the seam.
    grid = np.asarray(center, float) + flat[..., :1] * frame[0] + flat[..., 1:] * frame[1]
    shell(builder, grid, pillow(rows, columns, extent[2], edge), finish, mirror=mirror)


@dataclass(frozen=True)
class BackSurface:
    """The surface in which a chair back lies, between its posts: u in [-1, 1] from right to left, t in [0, 1] upwards.

    x0, z0: foot; height; half widths at foot and top; lean: how far the top is behind the foot; bow: extra backward
    curve with height; dish: how far the middle lies behind the posts. All in one unit of length.
    """

    x0: float
    z0: float
    height: float
    half0: float
    half1: float
    lean: float
    bow: float = 0.0
    dish: float = 0.0

    def at(self, u: ArrayLike, t: ArrayLike) -> np.ndarray:
        """Points (..., 3) for broadcast u and t."""
        across, up = np.broadcast_arrays(np.asarray(u, float), np.asarray(t, float))
        half = self.half0 + (self.half1 - self.half0) * up
        # The dish grows with height: the seat's rear rail is straight on most chairs.
        hollow = self.dish * (1 - across**2) * np.clip(0.3 + 0.7 * up, 0, None)
        x = self.x0 - self.lean * up - self.bow * up**2 - hollow
        return np.stack([x, across * half, self.z0 + self.height * up], axis=-1)


def rail(
    builder: "Builder",
    surface: BackSurface,
    t: float,
    half: Sequence[float],
    finish: Finish,
    reach: float = 1.0,
    arch: float = 0.0,
    points: int = 5,
    section: str = "square",
) -> None:
    """A horizontal member of a chair back at height t: half sizes (up, thick); `arch` raises its middle (in t)."""
    u = np.linspace(-reach, reach, points)
    path = surface.at(u, t + arch * (1 - (u / reach) ** 2))
    sweep(builder, path, np.tile(np.asarray(half, float), (points, 1)), finish, section, side=(0.0, 0.0, 1.0))
