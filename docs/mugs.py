"""CAD models of a category that is not among the built-in ones, to try docs/own_category.md with.

python docs/mugs.py FOLDER [COUNT]        (default: 60 models)
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix


def mug(rng: np.random.Generator) -> trimesh.Trimesh:
    """A mug of random size and colours: y is up, the handle on the side of +x."""
    radius, height = rng.uniform(0.3, 0.5), rng.uniform(0.6, 1.2)
    body = trimesh.creation.cylinder(radius, height, sections=24)
    handle = trimesh.creation.torus(0.3 * height, 0.06, major_sections=16, minor_sections=8)
    handle.apply_transform(rotation_matrix(np.pi / 2, [1, 0, 0]))
    handle.apply_translation([radius, 0, 0])
    for part in (body, handle):
        part.visual.face_colors = [*rng.integers(40, 220, 3), 255]
    whole = trimesh.util.concatenate([body, handle])
    whole.apply_transform(rotation_matrix(-np.pi / 2, [1, 0, 0]))
    return whole


def main(folder: str, count: str = "60") -> None:
    """Write `count` mugs as .obj files into a folder."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    for number in range(int(count)):
        mug(rng).export(Path(folder) / f"mug{number}.obj")


if __name__ == "__main__":
    main(*sys.argv[1:])
