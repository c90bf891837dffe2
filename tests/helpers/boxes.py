"""Objects made of coloured boxes: as a mesh, as a volume of the same space, and rendered into a small view store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from viewnet.data.store import ViewStore, write_store
from viewnet.render import render_mesh
from viewnet.render.camera import DISTANCE, FOCAL
from viewnet.render.mesh import Material, Mesh

HALF_SIDE = DISTANCE / (2 * FOCAL)
"""Of the volume in world units, when its middle slice fills the image of the rendering camera."""
PERSPECTIVE = HALF_SIDE / DISTANCE
"""The volume's focal parameter that belongs to the rendering camera."""


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in world units."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    colour: tuple[float, float, float]


# Front, back and top differ; left and right are mirror images.
SYMMETRIC = (
    Box((-0.38, -0.16, -0.14), (0.38, 0.16, 0.02), (0.2, 0.4, 1.0)),
    Box((0.1, -0.12, 0.02), (0.3, 0.12, 0.2), (1.0, 0.9, 0.1)),
    Box((-0.34, -0.06, 0.02), (-0.26, 0.06, 0.26), (1.0, 0.1, 0.1)),
)


def box_mesh(boxes: Sequence[Box]) -> Mesh:
    """The boxes' twelve triangles each, one material a box."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([[side[0], *side[i : i + 2]] for side in sides for i in (1, 2)], np.int32)
    vertices = np.concatenate([np.array(b.low) + corners * (np.array(b.high) - b.low) for b in boxes])
    faces = np.concatenate([triangles + 8 * i for i in range(len(boxes))]).astype(np.int32)
    materials = tuple(Material(diffuse=b.colour) for b in boxes)
    return Mesh(vertices, faces, np.repeat(np.arange(len(boxes), dtype=np.int32), len(triangles)), materials)


def box_volume(boxes: Sequence[Box], size: int) -> torch.Tensor:
    """(1, 4, size, size, size): colour and occupancy of each voxel, the cube's half side being HALF_SIDE."""
    axis = ((np.arange(size) * 2 + 1) / size - 1) * HALF_SIDE
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    points = np.stack([x, y, z], axis=-1)
    volume = np.zeros((4, size, size, size), np.float32)
    for box in boxes:
        inside = ((points >= box.low) & (points <= box.high)).all(axis=-1)
        volume[:, inside] = np.array([*box.colour, 1.0], np.float32)[:, None]
    return torch.from_numpy(volume)[None]


def box_store(folder: Path, models: dict[str, int], views: int = 4, size: int = 32, seed: int = 0) -> ViewStore:
    """A view store of synthetic box objects: `models` of each split, rendered from random viewpoints."""
    rng = np.random.default_rng(seed)
    rows, batches = [], []
    for split, count in models.items():
        for number in range(count):
            length, width, height = rng.uniform((0.5, 0.2, 0.15), (0.7, 0.3, 0.3))
            body, cabin = rng.uniform(0.1, 1, (2, 3))
            mesh = box_mesh(
                [
                    Box((-length / 2, -width / 2, -height / 2), (length / 2, width / 2, 0), tuple(body)),
                    Box((-length / 3, -width / 3, 0), (length / 9, width / 3, height / 2), tuple(cabin)),
                ]
            )
            azimuth, elevation = rng.uniform(0, 360, views), rng.uniform(-20, 40, views)
            batches.append(render_mesh(mesh, azimuth, elevation, size, 1))
            name = f"{split}{number:03d}"
            rows += [(name, "car", split, k, azimuth[k], elevation[k], f"{name}.obj") for k in range(views)]
    columns = ["model_id", "category", "split", "view", "azimuth", "elevation", "source"]
    index = pd.DataFrame(rows, columns=columns)
    return write_store(folder, batches, index, {"models": models, "views": views, "size": size, "seed": seed})
