"""CAD models for tests: a box with six differently coloured sides, written in either layout of ShapeNetCore."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from viewnet.data.readers.shapenet import ModelFile

SIZE = np.array([0.8, 0.4, 0.3])
COLOURS = {
    "front": (1.0, 0.0, 0.0),
    "back": (0.0, 1.0, 0.0),
    "left": (0.0, 0.0, 1.0),
    "right": (1.0, 1.0, 0.0),
    "top": (1.0, 0.0, 1.0),
    "bottom": (0.0, 1.0, 1.0),
}
AXES = {"front": (0, 1), "back": (0, -1), "left": (1, 1), "right": (1, -1), "top": (2, 1), "bottom": (2, -1)}
# File coordinates of world (x, y, z), written out from the layouts' own description: y is up in both.
TO_FILE = {"v1": lambda p: (p[0], p[2], -p[1]), "v2": lambda p: (-p[1], p[2], -p[0])}


def real_data() -> Path:
    """The folder of real data; skips the test where there is none."""
    folder = os.environ.get("VIEWNET_REAL_DATA")
    if not folder:
        pytest.skip("VIEWNET_REAL_DATA does not name a folder of real data")
    return Path(folder)


def side_corners(side: str) -> np.ndarray:
    """World corners (4, 3) of a side of the box, counter-clockwise from outside."""
    axis, sign = AXES[side]
    u, v = (axis + 1) % 3, (axis + 2) % 3
    corners = np.zeros((4, 3))
    corners[:, axis] = sign * SIZE[axis] / 2
    corners[:, u] = np.array([-1, 1, 1, -1]) * SIZE[u] / 2
    corners[:, v] = np.array([-1, -1, 1, 1]) * SIZE[v] / 2
    return corners if sign > 0 else corners[::-1]


def obj_file(root: Path, synset: str, name: str, layout: str = "v2") -> Path:
    """Where a model's .obj lies, its folder made."""
    file = root / synset / name / ("models/model_normalized.obj" if layout == "v2" else "model.obj")
    file.parent.mkdir(parents=True, exist_ok=True)
    return file


def write_box(root: Path, synset: str, name: str, layout: str = "v2", scale: float = 1.0, shift: float = 0.0) -> Path:
    """Write the coloured box as a model of a collection; its .obj."""
    file = obj_file(root, synset, name, layout)
    lines, materials = [f"mtllib {file.stem}.mtl"], []
    for number, side in enumerate(AXES):
        materials += [f"newmtl {side}", "Kd {} {} {}".format(*COLOURS[side])]
        lines += ["v {} {} {}".format(*TO_FILE[layout](corner * scale + shift)) for corner in side_corners(side)]
        lines += [f"usemtl {side}", "f " + " ".join(str(4 * number + i) for i in (1, 2, 3, 4))]
    file.write_text("\n".join(lines) + "\n")
    file.with_suffix(".mtl").write_text("\n".join(materials) + "\n")
    return file


def model_of(file: Path, category: str = "car") -> ModelFile:
    """The entry of a v2 .obj file."""
    return ModelFile(file.parent.parent.name, category, file, "v2", "train")
