"""A CAD model in memory: triangles with materials, and the error that says why a model cannot be used."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from viewnet.errors import ViewnetError

GREY = (0.8, 0.8, 0.8)  # colour of a face without a (defined) material


class UnusableModel(ViewnetError):
    """A CAD model that cannot be rendered; `reason` says why in a few words, `path` which file."""

    def __init__(self, path: Path, reason: str) -> None:
        # Text from a file may be long, and bytes that are not UTF-8 could not be written to a list.
        reason = reason[:300].encode("utf-8", "backslashreplace").decode()
        super().__init__(f"{path}: {reason}")
        self.path, self.reason = path, reason

    def __reduce__(self) -> tuple[type, tuple[Path, str]]:
        return type(self), (self.path, self.reason)


@dataclass(frozen=True, eq=False)
class Material:
    """Diffuse colour (3,) in 0..1 and, where given, a texture (h, w, 3 or 4) uint8, top row first.

    A texture replaces the diffuse colour (exporters often write it black beside a texture).
    """

    name: str = ""
    diffuse: tuple[float, float, float] = GREY
    texture: np.ndarray | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """Triangles: vertices (V, 3) float64, faces (F, 3) int32, material (F,) int32 into `materials`.

    `uv` (F, 3, 2) float32 are the texture coordinates of each face's corners (origin at the lower left, repeating) or
    None; `colours` (F, 3, 3) float32 in 0..1 are the corners' colours or None, used on faces without a texture.
    """

    vertices: np.ndarray
    faces: np.ndarray
    material: np.ndarray
    materials: tuple[Material, ...]
    uv: np.ndarray | None = None
    colours: np.ndarray | None = None


def surfaces(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each set of faces (F, 3) with the same vertices, the first (G,), ascending, and the first of other winding.

    CAD models often have a surface twice, once for each side. A face without one of the other winding is repeated in
    the second array: it is visible from both sides.
    """
    order = np.argsort(faces, axis=1, kind="stable")
    even = (order[:, 1] - order[:, 0]) % 3 == 1
    ascending = np.take_along_axis(faces, order, axis=1)
    ranked = np.lexsort(ascending.T)
    key = ascending[ranked]
    begins = np.append(True, (key[1:] != key[:-1]).any(axis=1))[: len(faces)]
    group = np.cumsum(begins) - 1
    first = ranked[begins]
    # Ranking is stable, so of each set the first with the other winding comes first here too.
    otherwise = np.flatnonzero(even[ranked] != even[first][group])
    sets, at = np.unique(group[otherwise], return_index=True)
    other = first.copy()
    other[sets] = ranked[otherwise[at]]
    by_number = np.argsort(first)
    return first[by_number], other[by_number]
