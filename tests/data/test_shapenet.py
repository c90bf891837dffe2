"""The CAD reader: layouts, splits, the OBJ and MTL dialects of real collections, and its errors."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.cad_files import AXES, COLOURS, model_of, obj_file, real_data, write_box
from helpers.irregular_files import IRREGULAR
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from viewnet.config import SYNSETS
from viewnet.data.readers.shapenet import find_models, load_model, take
from viewnet.errors import ViewnetError
from viewnet.render import mtl, obj
from viewnet.render.mesh import GREY, Mesh, UnusableModel
from viewnet.render.obj import read_obj

CAR = SYNSETS["car"]


def colour_towards(mesh: Mesh, direction: np.ndarray) -> tuple[float, ...]:
    """Diffuse colour of the outermost face in a direction."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return mesh.materials[mesh.material[np.argmax(centres @ direction)]].diffuse


# Layouts and frame


@pytest.mark.parametrize("layout", ["v1", "v2"])
def test_both_layouts_face_the_same_way(tmp_path: Path, layout: str) -> None:
    write_box(tmp_path, CAR, "box", layout)
    (model,) = find_models(tmp_path, "car")
    mesh = load_model(model)
    assert model.layout == layout
    for side, (axis, sign) in AXES.items():
        assert colour_towards(mesh, sign * np.eye(3)[axis]) == COLOURS[side]


@pytest.mark.parametrize("layout", ["v1", "v2"])
def test_normals_keep_pointing_outwards(tmp_path: Path, layout: str) -> None:
    """A change of frame that mirrored the model would turn every face inside out."""
    mesh = load_model(find_models(write_box(tmp_path, CAR, "box", layout) and tmp_path, "car")[0])
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), a + b + c) > 0).all()


@settings(max_examples=10, deadline=None)
@given(scale=st.floats(1e-3, 1e4), shift=st.floats(-1e3, 1e3))
def test_position_and_scale_in_the_file_do_not_matter(
    tmp_path_factory: pytest.TempPathFactory, scale: float, shift: float
) -> None:
    folder = tmp_path_factory.mktemp("models")
    plain, moved = (load_model(model_of(write_box(folder, CAR, name, **k))) for name, k in
                    (("plain", {}), ("moved", {"scale": scale, "shift": shift * scale})))  # fmt: skip
    assert np.allclose(moved.vertices, plain.vertices, atol=1e-6)
    assert np.linalg.norm(np.ptp(moved.vertices, axis=0)) == pytest.approx(1)
    assert np.allclose(moved.vertices.min(axis=0), -moved.vertices.max(axis=0))


def test_unused_vertices_do_not_shift_the_model(tmp_path: Path) -> None:
    file = write_box(tmp_path, CAR, "box")
    before = load_model(model_of(file))
    file.write_text(file.read_text() + "v 100 100 100\n")
    assert np.array_equal(load_model(model_of(file)).vertices, before.vertices)


@pytest.mark.parametrize("version", ["v1", "v2"])
def test_real_aeroplanes_face_forwards(version: str) -> None:
    """The tail fin, the highest part, is behind; the model is as wide to the left as to the right."""
    for model in find_models(real_data() / f"ShapeNetCore.{version}", "aeroplane"):
        vertices = load_model(model).vertices
        assert model.layout == version
        assert vertices[vertices[:, 2].argmax(), 0] < 0.6 * vertices[:, 0].min()
        assert vertices[:, 1].max() == pytest.approx(-vertices[:, 1].min(), abs=0.01)


def test_real_shapenet_car_and_chair_face_forwards() -> None:
    """A bonnet is lower than the middle of a car, and a chair's back is behind."""
    root = real_data() / "ShapeNetCore.v1"
    x, _, z = load_model(find_models(root, "car")[0]).vertices.T
    ends = [z[(x > 0.35) & (x < 0.42)].max(), z[(x < -0.35) & (x > -0.42)].max()]
    assert ends[0] < ends[1] < z.max()
    x, _, z = load_model(find_models(root, "chair")[0]).vertices.T
    assert x[z > z.max() - 0.05].mean() < -0.1


@pytest.mark.slow
@pytest.mark.parametrize("category", ["aeroplane", "chair", "sofa", "car", "diningtable"])
def test_real_models_load_and_face_forwards(category: str) -> None:
    models = find_models(real_data() / "real_cad", category)
    behind = []
    for model in models:
        x, _, z = load_model(model).vertices.T
        behind.append(x[z > z.max() - 0.03 * np.ptp(z)].mean() < 0)
    if category not in ("car", "diningtable"):
        assert np.mean(behind) > 0.9


# Dialects of OBJ

SQUARE = """mtllib square.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
usemtl red
"""
DIALECTS = {
    "quad": "f 1 2 3 4\n",
    "triangles": "f 1 2 3\nf 1 3 4\n",
    "texture": "f 1/1 2/2 3/3 4/4\n",
    "normals": "f 1//1 2//1 3//1 4//1\n",
    "both": "f 1/1/1 2/2/1 3/3/1 4/4/1\n",
    "negative": "f -4 -3 -2 -1\n",
    "negative texture": "f -4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1\n",
    "mixed": "f 1//1 2//1 3//1\nf 1/1 3/3 4/4\n",
    "mixed sizes": "f 1 2 3\nf 1/1/1 3/3/1 4/4/1\n",
    "no newline": "f 1 2 3 4",
    "comments": "# a # face\nf 1 2 3 4 # the face\n",
    "spaces": "  f   1  2\t3 4  \n\n",
    "continued": "f 1 2 \\\n 3 4\n",
    "other things": "o x\ng y\ns off\nl 1 2\np 1\nvp 0 1\nf 1 2 3 4\n",
    "faces without area": "f 1 2 3 4\nf 1 1 2\nf 1 2 2 1\n",
}


@pytest.mark.parametrize("windows", [False, True])
@pytest.mark.parametrize("faces", DIALECTS.values(), ids=DIALECTS.keys())
def test_every_form_of_face_reads_the_same(tmp_path: Path, faces: str, windows: bool) -> None:
    file = tmp_path / "square.obj"
    file.write_bytes((SQUARE + faces).replace("\n", "\r\n" if windows else "\n").encode())
    (tmp_path / "square.mtl").write_text("newmtl red\nKd 1 0 0\n")
    mesh = read_obj(file)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.materials[mesh.material[0]].diffuse == (1.0, 0.0, 0.0)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


def test_indices_count_backwards_from_where_they_stand(tmp_path: Path) -> None:
    file = tmp_path / "two.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1\nv 1 0 1\nv 0 1 1\nf -3 -2 -1\n")
    assert read_obj(file).faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_agrees_with_trimesh_on_real_files() -> None:
    """An independent reader finds the same surface and texture coordinates."""
    for version, category in (("v1", "car"), ("v1", "chair"), ("v2", "aeroplane")):
        model = find_models(real_data() / f"ShapeNetCore.{version}", category)[0]
        ours = read_obj(model.path, model.folder)
        theirs = trimesh.load(model.path, process=False, force="mesh")
        faces = theirs.triangles[theirs.area_faces > 0]
        assert len(ours.faces) == pytest.approx(len(faces), rel=1e-3)
        assert trimesh.triangles.area(ours.vertices[ours.faces]).sum() == pytest.approx(theirs.area, rel=1e-6)


# Materials


def material(tmp_path: Path, text: str, faces: str = "usemtl m\nf 1/1 2/2 3/3 4/4\n") -> tuple[Mesh, obj.Material]:
    """The mesh of a textured square whose material library is `text`, and its first face's material."""
    file = obj_file(tmp_path, CAR, "square")
    file.write_text(SQUARE.replace("usemtl red\n", "") + faces)
    (file.parent / "square.mtl").write_text(text)
    images = file.parent.parent / "images"
    images.mkdir(exist_ok=True)
    Image.new("RGB", (4, 4), (10, 200, 30)).save(images / "an image.png")
    Image.new("RGBA", (4, 4), (10, 200, 30, 0)).save(images / "clear.png")
    mesh = read_obj(file, file.parent.parent)
    return mesh, mesh.materials[mesh.material[0]]


@pytest.mark.parametrize("name", ["../images/an image.png", "..\\images\\an image.png", "./../images/an image.png"])
def test_texture_names(tmp_path: Path, name: str) -> None:
    """Spaces and backslashes are part of real files; a black Kd beside a texture is a habit of exporters."""
    mesh, found = material(tmp_path, f"newmtl m\nKd 0 0 0\nmap_Kd {name}\n")
    assert found.texture is not None and found.texture.shape == (4, 4, 3)
    assert (found.texture == (10, 200, 30)).all()
    assert mesh.uv is not None and mesh.uv[0].tolist() == [[0, 0], [1, 0], [1, 1]]


def test_texture_options(tmp_path: Path) -> None:
    options = "-s 2 3 1 -o 0.5 0.25 0 -clamp on -blendu off -mm 0 1 -bm 1.0 -imfchan l"
    mesh, found = material(tmp_path, f"newmtl m\nmap_Kd {options} ../images/an image.png\n")
    assert found.texture is not None
    assert mesh.uv is not None and mesh.uv[0].tolist() == [[0.5, 0.25], [2.5, 0.25], [2.5, 3.25]]


def test_alpha_of_textures_is_kept(tmp_path: Path) -> None:
    _, found = material(tmp_path, "newmtl m\nmap_Kd ../images/clear.png\n")
    assert found.texture is not None and (found.texture[..., 3] == 0).all()


def test_large_textures_are_reduced(tmp_path: Path) -> None:
    material(tmp_path, "newmtl m\n")
    Image.new("RGB", (4 * mtl.TEXTURE_SIZE, mtl.TEXTURE_SIZE), (9, 9, 9)).save(tmp_path / CAR / "square/images/big.jpg")
    _, found = material(tmp_path, "newmtl m\nmap_Kd ../images/big.jpg\n")
    assert found.texture is not None and found.texture.shape == (mtl.TEXTURE_SIZE // 4, mtl.TEXTURE_SIZE, 3)


def test_invisible_faces_are_left_out_unless_all_are(tmp_path: Path) -> None:
    text = "newmtl glass\nd 0\nnewmtl m\nKd 1 0 0\n"
    mesh, found = material(tmp_path, text, "usemtl glass\nf 1 2 3\nusemtl m\nf 1 3 4\n")
    assert mesh.faces.tolist() == [[0, 2, 3]] and found.name == "m"
    assert len(material(tmp_path, text, "usemtl glass\nf 1 2 3 4\n")[0].faces) == 2


def test_faces_without_a_defined_material_are_grey(tmp_path: Path) -> None:
    assert material(tmp_path, "newmtl other\nKd 1 0 0\n")[1].diffuse == GREY
    assert material(tmp_path, "newmtl other\nKd 1 0 0\n", "f 1 2 3\n")[1].diffuse == GREY


def test_libraries_with_spaces_and_several_in_a_line(tmp_path: Path) -> None:
    file = tmp_path / "x.obj"
    for name, colour in (("a b.mtl", "1 0 0"), ("a.mtl", "0 1 0"), ("c.mtl", "0 0 1")):
        (tmp_path / name).write_text(f"newmtl {name[0]}\nKd {colour}\n")
    file.write_text("mtllib a b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    assert read_obj(file).materials[1].diffuse == (1, 0, 0)
    file.write_text("mtllib a.mtl c.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl c\nf 1 3 2\n")
    assert [m.diffuse for m in read_obj(file).materials[1:]] == [(0, 1, 0), (0, 0, 1)]


# Unusable files

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
TEXTURED = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n"
BROKEN = {
    "empty": ("", None, "empty file"),
    "blank": ("\n \n", None, "empty file"),
    "no faces": ("v 0 0 0\nv 1 0 0\n", None, "no faces"),
    "no vertices": ("f 1 2 3\n", None, "no vertices"),
    "only a line": ("v 0 0 0\nv 1 0 0\nf 1 2\n", None, "no faces"),
    "nan": (TRIANGLE.replace("v 1", "v nan"), None, "NaN"),
    "infinite": (TRIANGLE.replace("v 1", "v inf"), None, "NaN or infinite"),
    "a point": ("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", None, "no face has an area"),
    "tiny": ("v 0 0 0\nv 1e-31 0 0\nv 0 1e-31 0\nf 1 2 3\n", None, "size|no face has an area"),
    "two coordinates": (TRIANGLE.replace("v 0 1 0", "v 0 1"), None, "fewer than 3 numbers: 'v 0 1'"),
    "text": (TRIANGLE.replace("v 0 1 0", "v 0 one 0"), None, "not a number: 'v 0 one 0'"),
    "text face": (TRIANGLE.replace("f 1 2 3", "f 1 2 x"), None, "not a number: 'f 1 2 x'"),
    "index above": (TRIANGLE.replace("f 1 2 3", "f 1 2 4"), None, "vertex 4 of 3"),
    "index zero": (TRIANGLE.replace("f 1 2 3", "f 0 1 2"), None, "vertex 0 of 3"),
    "index below": (TRIANGLE.replace("f 1 2 3", "f -4 -2 -1"), None, "vertex 0 of 3"),
    "texture index": (TEXTURED.replace("3/1", "3/2"), "newmtl m\n", "texture coordinate 2 of 1"),
    "four indices": (
        TEXTURED.replace("3/1", "3/1/1/1"),
        "newmtl m\n",
        "cannot understand the face: 'f 1/1 2/1 3/1/1/1'",
    ),
    "a blank before a slash": (TEXTURED.replace("3/1", "3 /1"), "newmtl m\n", "cannot understand the face"),
    "no library": (TEXTURED, None, "missing material library"),
    "library outside": (TEXTURED.replace("m.mtl", "../../../m.mtl"), "", "leads out of"),
    "library absolute": (TEXTURED.replace("m.mtl", "/etc/passwd"), "", "absolute path"),
    "library on a drive": (TEXTURED.replace("m.mtl", "C:\\m.mtl"), "", "absolute path"),
    "bad colour": (TEXTURED, "newmtl m\nKd 1 red 0\n", "cannot understand 'Kd 1 red 0'"),
    "nan colour": (TEXTURED, "newmtl m\nKd nan 0 0\n", "cannot understand"),
    "no texture": (TEXTURED, "newmtl m\nmap_Kd none.png\n", "missing texture 'models/none.png'"),
    "texture outside": (TEXTURED, "newmtl m\nmap_Kd ../../x.png\n", "leads out of"),
    "texture absolute": (TEXTURED, "newmtl m\nmap_Kd /tmp/x.png\n", "absolute path"),
    "broken texture": (TEXTURED, "newmtl m\nmap_Kd m.mtl\n", "broken texture"),
}


@pytest.mark.parametrize(("text", "library", "reason"), BROKEN.values(), ids=BROKEN.keys())
def test_unusable_models_are_refused_with_the_reason(
    tmp_path: Path, text: str, library: str | None, reason: str
) -> None:
    file = obj_file(tmp_path, CAR, "broken")
    file.write_text(text)
    if library is not None:
        (file.parent / "m.mtl").write_text(library)
    with pytest.raises(UnusableModel, match=reason) as error:
        load_model(model_of(file))
    assert str(file) in str(error.value) and "\n" not in str(error.value)


def test_a_truncated_image_is_a_broken_texture(tmp_path: Path) -> None:
    file = obj_file(tmp_path, CAR, "broken")
    file.write_text(TEXTURED)
    (file.parent / "m.mtl").write_text("newmtl m\nmap_Kd t.png\n")
    Image.effect_noise((64, 64), 50).save(file.parent / "t.png")
    whole = (file.parent / "t.png").read_bytes()
    load_model(model_of(file))
    (file.parent / "t.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UnusableModel, match="broken texture"):
        load_model(model_of(file))


def test_a_broken_texture_that_no_face_uses_does_not_matter(tmp_path: Path) -> None:
    file = obj_file(tmp_path, CAR, "fine")
    file.write_text(TEXTURED)
    (file.parent / "m.mtl").write_text("newmtl m\nKd 1 0 0\nnewmtl unused\nmap_Kd none.png\n")
    assert len(load_model(model_of(file)).faces) == 1


def test_missing_and_oversized_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = obj_file(tmp_path, CAR, "large")
    with pytest.raises(UnusableModel, match="no such file"):
        load_model(model_of(file))
    file.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    monkeypatch.setattr(obj, "MAX_FACES", 1)
    with pytest.raises(UnusableModel, match="2 faces, more than 1"):
        load_model(model_of(file))
    monkeypatch.setattr(obj, "MAX_BYTES", 10)
    with pytest.raises(UnusableModel, match=r"bytes in model_normalized\.obj, more than 10"):
        load_model(model_of(file))


@pytest.mark.parametrize("make", IRREGULAR.values(), ids=IRREGULAR.keys())
def test_only_regular_files_are_read(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(file := obj_file(tmp_path, CAR, "odd"))
    with pytest.raises(UnusableModel, match=r"odd/models/model_normalized\.obj: not a regular file"):
        load_model(model_of(file))


# Finding models and splits


def collection(root: Path, names: list[str]) -> Path:
    for name in names:
        obj_file(root, CAR, name).write_text(TRIANGLE)
    return root


def test_a_folder_without_its_model_is_listed_and_rubbish_is_not(tmp_path: Path) -> None:
    collection(tmp_path, ["b", "a"])
    (tmp_path / CAR / "c").mkdir()
    (tmp_path / CAR / ".hidden").mkdir()
    (tmp_path / CAR / "notes.txt").write_text("")
    models = find_models(tmp_path, "car")
    assert [m.id for m in models] == ["a", "b", "c"]
    with pytest.raises(UnusableModel, match="no such file"):
        load_model(models[2])


@pytest.mark.parametrize(
    ("make", "category", "message"),
    [
        (lambda root: None, "car", "not a ShapeNetCore collection"),
        (lambda root: (root / "03001627").mkdir(), "car", "it has 03001627"),
        (lambda root: (root / CAR).mkdir(), "car", "no models: expected <id>"),
        (lambda root: (root / f"{CAR}.zip").touch(), "car", "unpack it"),
        (lambda root: None, "cart", r"no models of cart: expected .obj files in it.*Did you mean 'car'\?"),
    ],
)
def test_wrong_roots_say_what_to_do(tmp_path: Path, make, category: str, message: str) -> None:
    make(tmp_path)
    with pytest.raises(ViewnetError, match=message):
        find_models(tmp_path, category)


def test_a_root_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(ViewnetError, match="no such folder"):
        find_models(tmp_path / "nowhere", "car")


def write_csv(root: Path, rows: list[str], header: str = "id,synsetId,subSynsetId,modelId,split") -> None:
    (root / "all.csv").write_text("\n".join([header, *rows]) + "\n")


def test_official_list(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Ids stay text whatever they look like; models without an id, and ids without a model, are counted."""
    collection(tmp_path, ["007", "1e5", "nan", "unlisted"])
    write_csv(
        tmp_path,
        [
            f"000001,{CAR},{CAR},007,train",
            f"000002,{CAR},{CAR},1e5,val",
            f"000003,{CAR},{CAR},nan,test",
            f"000004,{CAR},{CAR},gone,test",
            "000005,03001627,03001627,unlisted,train",
        ],
    )
    with caplog.at_level(logging.WARNING):
        models = find_models(tmp_path, "car")
    assert {m.id: m.split for m in models} == {"007": "train", "1e5": "val", "nan": "test"}
    assert "1 models not in" in caplog.text and "1 listed models missing" in caplog.text


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([f"1,{CAR},{CAR},a,train", f"2,{CAR},{CAR},b,test"], "the val split of car is empty"),
        ([f"1,{CAR},{CAR},a,train", f"2,{CAR},{CAR},x,val", f"3,{CAR},{CAR},b,test"], "none of its 1 models is in"),
        ([f"1,{CAR},{CAR},a,training"], "split 'training'"),
        (["1,03001627,03001627,a,train"], "lists no model of car"),
        ([f"1,{CAR},{CAR},a,train", f"2,{CAR},{CAR},a,test"], "in both train and test"),
    ],
)
def test_faulty_official_lists(tmp_path: Path, rows: list[str], message: str) -> None:
    write_csv(collection(tmp_path, ["a", "b"]), rows)
    with pytest.raises(ViewnetError, match=message):
        find_models(tmp_path, "car")


def test_official_list_without_a_column(tmp_path: Path) -> None:
    write_csv(collection(tmp_path, ["a"]), [], "id,synset,model,split")
    with pytest.raises(ViewnetError, match="column 'synsetId'"):
        find_models(tmp_path, "car")


def test_text_lists_come_before_the_official_one(tmp_path: Path) -> None:
    root = collection(tmp_path / "root", ["a", "b", "c"])
    write_csv(
        root, [f"1,{CAR},{CAR},{name},{split}" for name, split in zip("abc", ("train", "val", "test"), strict=True)]
    )
    lists = tmp_path / "lists"
    lists.mkdir()
    for name, split in zip("cab", ("train", "val", "test"), strict=True):
        (lists / f"{CAR}_{split}.txt").write_text(f"{name}\n\n")
    assert {m.id: m.split for m in find_models(root, "car", lists)} == {"c": "train", "a": "val", "b": "test"}
    (lists / f"{CAR}_val.txt").unlink()
    with pytest.raises(ViewnetError, match=f"{CAR}_val.txt: no such list"):
        find_models(root, "car", lists)


def test_the_chair_missing_from_the_published_list_is_restored(tmp_path: Path) -> None:
    chair, lost = SYNSETS["chair"], "901cab3f56c74894d7f7a4c4609b0913"
    sizes = {"train": 4744, "val": 677, "test": 1356}
    for split, size in sizes.items():
        (tmp_path / f"{chair}_{split}.txt").write_text("\n".join(f"{split}{i}" for i in range(size)))
    for name in ("train0", "val0", "test0", lost):
        obj_file(tmp_path / "root", chair, name).write_text(TRIANGLE)
    assert {m.id: m.split for m in find_models(tmp_path / "root", "chair", tmp_path)}[lost] == "val"
    (tmp_path / f"{chair}_val.txt").write_text("val0\n")
    assert lost not in {m.id for m in find_models(tmp_path / "root", "chair", tmp_path)}


def test_seeded_split(tmp_path: Path) -> None:
    root = collection(tmp_path, [f"m{i:03d}" for i in range(40)])
    split = {m.id: m.split for m in find_models(root, "car", seed=3)}
    counts = {name: list(split.values()).count(name) for name in ("train", "val", "test")}
    assert counts == {"train": 28, "val": 4, "test": 8}
    assert split == {m.id: m.split for m in find_models(root, "car", seed=3)}
    assert split != {m.id: m.split for m in find_models(root, "car", seed=4)}
    test = {name for name, value in split.items() if value == "test"}
    assert test != set(sorted(split)[:8])


@pytest.mark.parametrize(("count", "expected"), [(1, {"train"}), (2, {"train", "test"}), (3, {"train", "val", "test"})])
def test_seeded_split_of_few_models(tmp_path: Path, count: int, expected: set[str]) -> None:
    models = find_models(collection(tmp_path, list("abc")[:count]), "car")
    assert {m.split for m in models} == expected


def test_take_keeps_order_and_proportions(tmp_path: Path) -> None:
    models = find_models(collection(tmp_path, [f"m{i:03d}" for i in range(40)]), "car")
    some = take(models, 20, seed=1)
    assert [m.id for m in some] == sorted(m.id for m in some)
    assert [sum(m.split == s for m in some) for s in ("train", "val", "test")] == [14, 2, 4]
    assert some != take(models, 20, seed=2)
    assert {m.split for m in take(models, 1)} == {"train", "val", "test"}
    assert take(models, 0) == take(models, 99) == models
