"""Writes one model in the layout of ShapeNetCore v2: y up, front -z, centred, unit bounding-box diagonal."""

from pathlib import Path

import numpy as np
from PIL import Image

from viewnet.cad.builder import Array, Builder
from viewnet.runtime.files import filling

# A millionth of the diagonal: far below a pixel, and it lets vertices that meet be shared.
DIGITS = 5
# Rows are the file's axes in the object frame: file (x, y, z) = (-y, z, -x).
TO_FILE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])


def write_model(builder: Builder, folder: Path) -> None:
    """Write `models/model_normalized.obj` and `.mtl` and `images/texture<k>.png` into a new `folder`.

    The folder is written atomically. Raises ValueError for an empty model, FileExistsError for a `folder` that
    exists.
    """
    if folder.exists():
        raise FileExistsError(f"{folder} exists already")
    with filling(folder) as temporary:
        (temporary / "models").mkdir()
        (temporary / "models" / "model_normalized.obj").write_text(obj_text(builder), encoding="ascii")
        (temporary / "models" / "model_normalized.mtl").write_text(_mtl(builder, temporary), encoding="ascii")


def normalized(builder: Builder, points: Array) -> Array:
    """Object-frame points (N, 3) in the file's frame: centred on the bounding box, whose diagonal is 1."""
    low, high = builder.bounds()
    diagonal = float(np.linalg.norm(high - low))
    if not diagonal > 0:
        raise ValueError("the model has no extent")
    return (points - (low + high) / 2) / diagonal @ TO_FILE.T


def obj_text(builder: Builder) -> str:
    """The text of the .obj: shared vertices, faces in groups of one material."""
    builder.bounds()  # raises for an empty model, before numpy fails on it
    used = _used_materials(builder)
    sizes = np.cumsum([0] + [len(p.vertices) for p in builder.parts])
    points = normalized(builder, np.concatenate([p.vertices for p in builder.parts]))
    # All coordinates are within half a unit of 0, so three of them rounded fit into one integer, which sorts fast.
    steps = np.round(points * 10**DIGITS).astype(np.int64)
    _, first, inverse = np.unique(
        (steps + 2**19) @ np.array([1 << 40, 1 << 20, 1]), return_index=True, return_inverse=True
    )
    keys = steps[first] / 10**DIGITS
    faces: dict[str, list[np.ndarray]] = {name: [] for name in used}
    coordinates: list[Array] = []
    seen = 0
    for part, start in zip(builder.parts, sizes[:-1], strict=True):
        index = inverse[part.faces + start]
        whole = (index[:, 0] != index[:, 1]) & (index[:, 1] != index[:, 2]) & (index[:, 2] != index[:, 0])
        if builder.materials[part.material].texture is not None and part.uv is not None:
            coordinates.append(part.uv)
            texture = part.faces + seen
            seen += len(part.uv)
            index = np.stack([index, texture], -1).reshape(-1, 6)
        faces[part.material].append(index[whole] + 1)
    # Vertices of dropped triangles and hidden strips are left out, so the others are renumbered.
    stacked = {name: np.concatenate(group) for name, group in faces.items()}
    columns = {name: slice(None, None, 2) if f.shape[1] == 6 else slice(None) for name, f in stacked.items()}
    kept = np.unique(np.concatenate([f[:, columns[n]].ravel() for n, f in stacked.items()]))
    lines = ["mtllib model_normalized.mtl\n", _format("v %.5g %.5g %.5g\n", keys[kept - 1])]
    if coordinates:
        lines.append(_format("vt %.4g %.4g\n", np.round(np.concatenate(coordinates), 4) + 0.0))
    for name, table in stacked.items():
        table[:, columns[name]] = np.searchsorted(kept, table[:, columns[name]]) + 1
        row = "f %d/%d %d/%d %d/%d\n" if table.shape[1] == 6 else "f %d %d %d\n"
        lines += [f"usemtl {name}\n", _format(row, table)]
    return "".join(lines)


def _mtl(builder: Builder, folder: Path) -> str:
    """The text of the .mtl; writes the textures it names into `folder`/images."""
    lines = []
    for name in _used_materials(builder):
        material = builder.materials[name]
        lines += [f"newmtl {name}", "illum 2", "Kd {:.4g} {:.4g} {:.4g}".format(*material.color), "Ks 0 0 0", "d 1"]
        if material.texture is not None:
            images = folder / "images"
            images.mkdir(exist_ok=True)
            file = f"texture{len(list(images.iterdir()))}.png"
            Image.fromarray(material.texture).save(images / file)
            lines.append(f"map_Kd ../images/{file}")
        lines.append("")
    return "\n".join(lines)


def _used_materials(builder: Builder) -> list[str]:
    used = {p.material for p in builder.parts if len(p.faces)}
    return [name for name in builder.materials if name in used]


def _format(row: str, table: np.ndarray) -> str:
    return (row * len(table)) % tuple(table.ravel().tolist())
