"""Learned volumes as coloured meshes in the project's axes, for 3-D viewers.

The surface lies where occupancy, interpolated between voxel centres, passes a level (marching cubes). Vertices are in
half sides of the volume. Colours are averages weighted by occupancy, as empty voxels have no learned colour.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
import trimesh
from skimage.measure import marching_cubes
from torch import Tensor

from viewnet.errors import ViewnetError
from viewnet.runtime.files import replacing

SUFFIXES = (".glb", ".ply")
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # from the project's z up to glTF's y up


def surface(volume: Tensor, rotation: Tensor | None = None, level: float = 0.5) -> trimesh.Trimesh:
    """The closed surface of a volume (4, Z, Y, X), colour and occupancy in [0, 1], with an RGBA colour at each vertex.

    `rotation` (3, 3) leads from the volume's frame to that of the mesh (default: the same). A surface that reaches the
    volume's faces is closed there. ViewnetError for another shape, and where no voxel is above `level`.
    """
    if volume.ndim != 4 or volume.shape[0] != 4:
        raise ViewnetError(f"mesh: the volume is {tuple(volume.shape)}, expected (4, Z, Y, X): colour and occupancy")
    volume = volume.detach().float().cpu()
    occupancy = np.pad(volume[3].numpy(), 1)  # empty around it, so that the surface closes
    if not occupancy.max() > level:
        highest = f"its highest occupancy is {occupancy.max():.2g}, not above {level:g}"
        raise ViewnetError(f"mesh: the volume is empty: {highest}: train longer or lower the level")
    corners, faces, _, _ = marching_cubes(occupancy, level)
    sides = np.array(volume.shape[1:])
    points = ((2 * (corners - 1) + 1) / sides - 1)[:, ::-1].astype(np.float32)  # z, y, x to x, y, z
    colours = _colours(volume, torch.from_numpy(points.copy()))
    vertices = points if rotation is None else points @ rotation.cpu().numpy().T
    # Triangles face inwards in the order z, y, x, and so outwards in the order x, y, z.
    return trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)


def write(mesh: trimesh.Trimesh, path: Path) -> Path:
    """Write a mesh as .ply, in the project's axes, or as .glb, y up as the format has it. ViewnetError for others."""
    if path.suffix not in SUFFIXES:
        raise ViewnetError(f"{path}: unknown kind of mesh file: name it {' or '.join(SUFFIXES)}")
    data: Any = as_glb(mesh) if path.suffix == ".glb" else mesh.export(file_type="ply")
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    return path


def as_glb(mesh: trimesh.Trimesh) -> bytes:
    """The contents of a .glb file, see `write`."""
    scene = trimesh.Scene()
    scene.add_geometry(mesh, transform=Y_UP, geom_name="volume", node_name="volume")
    return bytes(scene.export(file_type="glb"))


def _colours(volume: Tensor, points: Tensor) -> np.ndarray:
    """RGBA (V, 4) uint8 at points (V, 3) of [-1, 1]^3 (x, y, z), weighted by occupancy."""
    weighted = torch.cat([volume[:3] * volume[3:], volume[3:]])
    grid = points[None, None, None]  # (1, 1, 1, V, 3)
    # Border padding: otherwise a surface closed at the cube's face would be black.
    sampled = F.grid_sample(weighted[None], grid, padding_mode="border", align_corners=False)[0, :, 0, 0]
    colours = (sampled[:3] / sampled[3:].clamp(min=1e-6)).clamp(0, 1) * 255
    return np.column_stack([colours.round().T.numpy(), np.full(len(points), 255)]).astype(np.uint8)
