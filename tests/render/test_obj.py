"""OBJ and MTL files in other words: the same surface, colours and coordinates, or a refusal that names the line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.obj_wordings import FEATURES, SHAPES, Worded, as_triangles, wordings

from viewnet.render.mesh import GREY, UnusableModel
from viewnet.render.obj import files_of, read_obj
from viewnet.render.polygons import MAX_OUTLINE, triangles

MODELS = tuple(wordings(300))
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize("feature", FEATURES)
def test_the_same_mesh_in_other_words(tmp_path: Path, feature: str) -> None:
    def outcome(model: Worded) -> str:
        try:
            mesh = read_obj(model.write(tmp_path / model.name))
        except UnusableModel as error:
            return f"refused: {error.reason}"
        return "right" if model.truth is not None and model.truth.same_as(as_triangles(mesh)) else "wrong"

    mine = [model for model in MODELS if feature in model.features]
    assert len(mine) >= 10
    for model in mine:
        expected = "right" if model.truth is not None else "refused: "
        found = outcome(model)
        assert found.startswith(expected) and model.junk in found, (model.name, model.features, found)


def area(points: np.ndarray) -> float:
    """Of triangles (F, 3, 3), however they face."""
    edges = points[:, 1:] - points[:, :1]
    return float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2)


def outline_area(outline: np.ndarray) -> float:
    """Of a polygon (n, 2)."""
    x, y = outline.T
    return float(abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2)


def around_the_origin(corners: int, rng: np.random.Generator) -> np.ndarray:
    """A polygon (n, 2) that every ray from the origin leaves once."""
    turns = 2 * np.pi * (np.arange(corners) + rng.uniform(0, 0.9, corners)) / corners
    return rng.uniform(0.05, 1, corners)[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)


@pytest.mark.parametrize("corners", [4, 5, 8, 30, 100])
def test_polygons_are_triangulated_within_their_outlines(corners: int) -> None:
    """Many at once, turned in space, either way round, begun anywhere, with corners given twice or along an edge."""
    rng = np.random.default_rng(corners)
    points, sizes, areas = [], [], []
    for number in range(60):
        outline = around_the_origin(corners, rng)[:: (-1) ** number]
        places = rng.integers(0, corners - 1, 2)
        outline = np.insert(outline, places[0], outline[places[0]], axis=0)
        outline = np.insert(outline, places[1] + 1, outline[places[1] : places[1] + 2].mean(axis=0), axis=0)
        turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        points.append((np.column_stack([outline, np.zeros(len(outline))]) @ turned).round(6))
        sizes.append(len(outline))
        areas.append(outline_area(outline))
    every = np.concatenate(points)
    faces, owner = triangles(every, np.arange(len(every)), np.array(sizes))
    assert np.bincount(owner).tolist() == [size - 2 for size in sizes]
    for number, expected in enumerate(areas):
        assert area(every[faces[owner == number]]) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    "outline",
    [
        [(0, 0), (1, 1), (1, 0), (0, 1)],
        [(0, 0)] * 5,
        [(0, 0), (1, 0), (2, 0), (1, 0)],
        [(np.cos(0.8 * np.pi * i), np.sin(0.8 * np.pi * i)) for i in range(5)],
    ],
    ids=["crossing itself", "a point", "a line", "going round twice"],
)
def test_polygons_that_have_no_inside(outline: list[tuple[float, float]]) -> None:
    points = np.column_stack([outline, np.zeros(len(outline))])
    faces, _ = triangles(points, np.arange(len(points)), np.array([len(points)]))
    assert faces.shape == (len(outline) - 2, 3) and set(faces.ravel()) <= set(range(len(outline)))


def test_convex_polygons_stay_fans_and_huge_ones_are_fans() -> None:
    turns = 2 * np.pi * np.arange(MAX_OUTLINE + 1) / (MAX_OUTLINE + 1)
    for count, bent in ((6, 0.0), (MAX_OUTLINE + 1, 0.5)):
        radius = np.where(np.arange(count) % 2, 1 - bent, 1.0)
        points = np.stack([radius * np.cos(turns[:count]), radius * np.sin(turns[:count]), 0 * turns[:count]], axis=1)
        faces, _ = triangles(points, np.arange(count), np.array([count]))
        assert (faces == np.stack([np.zeros(count - 2), np.arange(1, count - 1), np.arange(2, count)], axis=1)).all()


def test_every_shape_of_the_words_is_there() -> None:
    assert set(SHAPES) - {"convex"} <= set(FEATURES)


# Materials that hide

BODY, PART = "usemtl body\nf 1 2 3 4\n", "usemtl part\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("body", "part", "shown"),
    [
        ("", "", "both"),
        ("d 1", "d 0", "body"),
        ("Tr 0", "Tr 1", "body"),
        ("", "d 0.01", "body"),
        ("d 1\nTr 0", "d 0\nTr 1", "body"),
        ("d 1.0 # opaque", "d -halo 0.0", "body"),
        ("Tr 1", "Tr 0.3", "both"),
        ("d 0", "d 0.5", "both"),
        ("Tr 1", "Tr 1", "both"),
        ("Tr 1", "Tr 0", "both"),
        ("d 1\nTr 1", "d 0.4\nTr 0.4", "both"),
        ("d 0\nTr 0", "d 0.6\nTr 0.6", "both"),
    ],
)
def test_what_materials_hide(tmp_path: Path, body: str, part: str, shown: str) -> None:
    """A part may be invisible. Where what is opaque is less than what is hidden, values are meant the other way."""
    (tmp_path / "m.mtl").write_text(f"newmtl body\nKd 1 0 0\n{body}\nnewmtl part\nKd 0 1 0\n{part}\n")
    (tmp_path / "m.obj").write_text(f"mtllib m.mtl\n{SQUARE}{BODY}{PART}")
    mesh = read_obj(tmp_path / "m.obj")
    assert sorted({mesh.materials[number].name for number in mesh.material}) == (
        ["body", "part"] if shown == "both" else ["body"]
    )


# Colours of vertices

RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
NONE = None


@pytest.mark.parametrize(
    ("written", "kd", "expected"),
    [
        (["1 0 0", "0 0 1", "1 0 0", "0 0 1"], None, [RED, BLUE, RED, BLUE]),
        (["255 0 0", "0 0 255", "255 0 0", "0 0 255"], None, [RED, BLUE, RED, BLUE]),
        (["65535 0 0", "0 0 65535", "65535 0 0", "0 0 65535"], None, [RED, BLUE, RED, BLUE]),
        (["1.00001 0 0", "0 -1e-7 1", "1 0 0", "0 0 1"], None, [RED, BLUE, RED, BLUE]),
        (["1 0 0 1", "0 0 1 1", "1 0 0 1", "0 0 1 0.5"], None, [RED, BLUE, RED, BLUE]),
        (["", "0 0 1", "1 0 0", "1.0"], None, [GREY, BLUE, RED, GREY]),
        (["1 0 0", "0 0 1", "1 0 0", "0 0 1"], "1 1 1", [RED, BLUE, RED, BLUE]),
        (["1 0 0", "0 0 1", "1 0 0", "0 0 1"], "0.64 0.64 0.64", [RED, BLUE, RED, BLUE]),
        (["", "0 0 1", "1 0 0", "0 0 1"], "0.4 0.4 0.4", [(0.4, 0.4, 0.4), BLUE, RED, BLUE]),
        (["1 1 1", "1 1 1", "1 1 0", "1 1 1"], "1 0 0", [RED] * 4),
        (["1 1 1"] * 4, "0.2 0.2 0.2", [(0.2, 0.2, 0.2)] * 4),
        (["1 1 1"] * 4, None, [(1.0, 1.0, 1.0)] * 4),
        (["", "", "", ""], "0 0 1", None),
    ],
)
def test_colours_of_vertices(tmp_path: Path, written: list[str], kd: str | None, expected: list | None) -> None:
    lines = [f"{line} {colour}" for line, colour in zip(SQUARE.splitlines(), written, strict=True)]
    if kd is not None:
        (tmp_path / "m.mtl").write_text(f"newmtl m\nKd {kd}\n")
        lines += ["mtllib m.mtl", "usemtl m"]
    (tmp_path / "m.obj").write_text("\n".join([*lines, "f 1 2 3 4"]))
    mesh = read_obj(tmp_path / "m.obj")
    if expected is None:
        assert mesh.colours is None
    else:
        assert mesh.colours is not None
        assert np.allclose(mesh.colours, np.array(expected)[mesh.faces])


@pytest.mark.parametrize("colour", ["nan 0 0", "99999 0 0"])
def test_colours_that_are_none_are_refused_by_their_line(tmp_path: Path, colour: str) -> None:
    (tmp_path / "m.obj").write_text(f"{SQUARE}v 2 2 2 {colour}\nf 1 2 3\n")
    with pytest.raises(UnusableModel, match=f"'v 2 2 2 {colour}'"):
        read_obj(tmp_path / "m.obj")


# Names


@pytest.mark.parametrize("mark", ["utf-8-sig", "utf-16"])
def test_files_of_notepad(tmp_path: Path, mark: str) -> None:
    (tmp_path / "m.mtl").write_text("newmtl rot\nKd 1 0 0\n", encoding=mark)
    (tmp_path / "m.obj").write_text(f"mtllib m.mtl\n{SQUARE}usemtl rot\nf 1 2 3\n", encoding=mark)
    assert read_obj(tmp_path / "m.obj").materials[1].diffuse == RED


@pytest.mark.parametrize(
    ("library", "uses"),
    [
        ("newmtl a #1\nKd 0 0 1\nnewmtl a #2\nKd 1 0 0\n", "usemtl a #2"),
        ("newmtl a # the red one\nKd 1 0 0\n", "usemtl a"),
        ("newmtl a\nKd 1 0 0\n", "usemtl a # the red one"),
        ("newmtl a\nKd 1 0 0\n", 'usemtl "a"'),
    ],
)
def test_names_and_comments(tmp_path: Path, library: str, uses: str) -> None:
    (tmp_path / "m.mtl").write_text(library)
    (tmp_path / "m.obj").write_text(f"mtllib m.mtl # of it\n{SQUARE}{uses}\nf 1 2 3\n")
    mesh = read_obj(tmp_path / "m.obj")
    assert mesh.materials[mesh.material[0]].diffuse == RED


def test_every_file_that_is_read_or_missed_is_named(tmp_path: Path) -> None:
    file = tmp_path / "m.obj"
    file.write_text(f"mtllib m.mtl\n{SQUARE}usemtl a\nf 1 2 3\n")
    assert files_of(file, tmp_path) == [file, tmp_path / "m.mtl"]
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd t.png\nnewmtl b\nmap_Kd images/u.png\n")
    assert files_of(file, tmp_path) == [file, tmp_path / "m.mtl", tmp_path / "t.png", tmp_path / "images/u.png"]
    file.unlink()
    assert files_of(file, tmp_path) == [file]
