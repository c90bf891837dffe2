from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from viewnet.errors import ViewnetError
from viewnet.estimator import volume_mesh

SIZE = 32
QUARTER = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x to y, y to -x


def grid(size: int = SIZE) -> torch.Tensor:
    """Voxel centres (3, size, size, size): their x, y and z."""
    axis = (torch.arange(size) * 2 + 1) / size - 1
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    return torch.stack([x, y, z])


def two_coloured_box() -> torch.Tensor:
    """Half sides 0.5, 0.25 and 0.125 along x, y and z; red in front, blue behind; colours elsewhere are green."""
    x, y, z = grid()
    inside = (x.abs() < 0.5) & (y.abs() < 0.25) & (z.abs() < 0.125)
    colours = torch.stack([(x > 0).float(), (~inside).float(), (x <= 0).float()])
    return torch.cat([colours * torch.where(inside, 0.8, 1.0), inside[None].float()])


def test_box_is_closed_upright_and_coloured():
    mesh = volume_mesh.surface(two_coloured_box())
    assert mesh.is_watertight
    assert mesh.volume > 0  # facing outwards
    assert np.allclose(mesh.bounds, [[-0.5, -0.25, -0.125], [0.5, 0.25, 0.125]], atol=1e-6)
    colours, x = np.asarray(mesh.visual.vertex_colors), mesh.vertices[:, 0]
    assert (colours[x > 0.1] == [204, 0, 0, 255]).all()
    assert (colours[x < -0.1] == [0, 0, 204, 255]).all()
    assert (colours[:, 1] == 0).all()


def test_sphere_has_its_volume():
    radius = 0.6
    ball = (0.5 + SIZE / 2 * (radius - grid().norm(dim=0))).clamp(0, 1)
    mesh = volume_mesh.surface(torch.cat([grid() / 2 + 0.5, ball[None]]))
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.01)
    # Interpolated colours identify the position.
    told = np.asarray(mesh.visual.vertex_colors)[:, :3] / 255 * 2 - 1
    assert np.abs(told - mesh.vertices).max() < 1.5 / SIZE


def test_rotation_takes_the_own_frame_to_the_annotated_one():
    mesh = volume_mesh.surface(two_coloured_box(), QUARTER)
    assert np.allclose(mesh.extents, [0.5, 1.0, 0.25], atol=1e-6)
    assert (np.asarray(mesh.visual.vertex_colors)[mesh.vertices[:, 1] > 0.1] == [204, 0, 0, 255]).all()
    assert mesh.volume > 0


def test_what_reaches_the_edge_is_closed_there():
    mesh = volume_mesh.surface(torch.cat([torch.full((3, 4, 4, 4), 0.4), torch.ones(1, 4, 4, 4)]))
    assert mesh.is_watertight
    assert np.allclose(mesh.extents, 2)
    assert (np.asarray(mesh.visual.vertex_colors) == [102, 102, 102, 255]).all()


@pytest.mark.parametrize("suffix", volume_mesh.SUFFIXES)
def test_files_come_back(tmp_path, suffix):
    mesh = volume_mesh.surface(two_coloured_box())
    path = volume_mesh.write(mesh, tmp_path / "meshes" / f"box{suffix}")
    back = trimesh.load_scene(path).to_mesh()
    assert back.is_watertight
    upright = (back.vertices @ volume_mesh.Y_UP[:3, :3]) if suffix == ".glb" else back.vertices
    order = [np.lexsort(np.round(v, 4).T) for v in (upright, mesh.vertices)]
    assert np.allclose(upright[order[0]], mesh.vertices[order[1]], atol=1e-6)
    colours = [np.asarray(m.visual.vertex_colors)[o] for m, o in zip((back, mesh), order, strict=True)]
    assert np.array_equal(*colours)
    assert back.extents.argmin() == (1 if suffix == ".glb" else 2)  # the box is flat: which way is up


def test_errors_of_meshes(tmp_path):
    with pytest.raises(ViewnetError, match=r"occupancy is 0\.4, not above 0\.5"):
        volume_mesh.surface(torch.full((4, 4, 4, 4), 0.4))
    with pytest.raises(ViewnetError, match=r"expected \(4, Z, Y, X\)"):
        volume_mesh.surface(torch.ones(1, 4, 4, 4, 4))
    with pytest.raises(ViewnetError, match=r"\.glb or \.ply"):
        volume_mesh.write(volume_mesh.surface(two_coloured_box()), tmp_path / "box.obj")
