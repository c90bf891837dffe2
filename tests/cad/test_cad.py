"""Built-in CAD: the builder, the files it writes, whole collections, and the vehicles."""

from __future__ import annotations

import hashlib
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
from helpers.executors import Mortal
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from viewnet import cad
from viewnet.cad import palette, writer
from viewnet.cad.aeroplane import aeroplane
from viewnet.cad.boat import boat
from viewnet.cad.builder import Builder, rotation_about, triangulate
from viewnet.cad.bus import bus
from viewnet.cad.car import car
from viewnet.cad.cycles import bicycle, motorbike
from viewnet.cad.train import train
from viewnet.cad.writer import write_model
from viewnet.config import CATEGORIES, SYNSETS
from viewnet.errors import ViewnetError

VEHICLES = {
    "aeroplane": (aeroplane.aeroplane, aeroplane.KINDS),
    "bicycle": (bicycle.bicycle, bicycle.KINDS),
    "boat": (boat.boat, boat.KINDS),
    "bus": (bus.bus, bus.KINDS),
    "car": (car.car, car.KINDS),
    "motorbike": (motorbike.motorbike, motorbike.KINDS),
    "train": (train.train, train.KINDS),
}
KINDS = [(category, kind) for category, (_, kinds) in VEHICLES.items() for kind in kinds]


def drawn(category: str, seed: int, kind: str | None = None) -> Builder:
    return VEHICLES[category][0](np.random.default_rng([seed, 3]), kind)


def solid(builder: Builder) -> trimesh.Trimesh:
    """All parts as one mesh with its vertices merged."""
    counts = np.cumsum([0] + [len(p.vertices) for p in builder.parts])
    faces = np.concatenate([p.faces + start for p, start in zip(builder.parts, counts[:-1], strict=True)])
    mesh = trimesh.Trimesh(np.concatenate([p.vertices for p in builder.parts]), faces, process=False)
    mesh.merge_vertices(digits_vertex=6)
    mesh.update_faces(mesh.nondegenerate_faces())
    return mesh


def painted() -> Builder:
    builder = Builder()
    builder.material("red", (0.8, 0.1, 0.1))
    builder.material("wood", (1, 1, 1), np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    return builder


def fingerprint(builder: Builder) -> str:
    """Hash of where the surfaces are and which colours they have, not of how they are named or ordered."""
    rows = []
    low, high = builder.bounds()
    for part in builder.parts:
        material = builder.materials[part.material]
        texture = b"" if material.texture is None else material.texture.tobytes()
        corners = np.round((part.vertices - low)[part.faces] / np.linalg.norm(high - low), 3)
        rows.append(repr((corners.tobytes(), np.round(material.color, 2).tolist())).encode() + texture)
    return hashlib.sha256(b"".join(sorted(rows))).hexdigest()


def files(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


# Builder


@pytest.mark.parametrize(
    ("add", "volume"),
    [
        (lambda b: b.box((1, 2, 3), (2, 3, 4), "red"), 24.0),
        (lambda b: b.box((1, 2, 3), (2, 3, 4), "wood", rotation=rotation_about("x", 30)), 24.0),
        (lambda b: b.box((0, 0, 0), (2, 2, 3), "red", taper=(0.0, 0.0)), 4.0),
        (lambda b: b.cylinder((0, 0, 0), (0, 0, 2), 1.0, "red", sections=64), 2 * np.pi),
        (lambda b: b.cylinder((1, 1, 1), (1, 4, 1), 1.0, "red", end_radius=0.0, sections=64), np.pi),
        (lambda b: b.ellipsoid((0, 0, 0), (1, 2, 3), "red", (48, 32)), 8 * np.pi),
        (lambda b: b.extrude([(0, 0), (2, 0), (2, 2), (1, 1), (0, 2)], "x", -1, 1, "red"), 6.0),
        (lambda b: b.extrude([(0, 2), (1, 1), (2, 2), (2, 0), (0, 0)], "y", -1, 1, "red"), 6.0),
        (lambda b: b.extrude([(0, 0), (2, 0), (2, 2), (1, 1), (0, 2)], "z", -1, 1, "wood"), 6.0),
        (lambda b: b.tube([(0, 0, 0), (0, 0, 2), (0, 0, 5)], 1.0, "red", sections=64), 5 * np.pi),
        (lambda b: b.loft([[(x, 0, 0), (x, 1, 0), (x, 1, 1), (x, 0, 1)] for x in (0, 1, 3)], ["red", "red"]), 3.0),
    ],
)
def test_primitives_are_closed_face_outwards_and_have_their_volume(add, volume):
    builder = painted()
    add(builder)
    mesh = solid(builder)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(volume, rel=0.02)


def test_both_sides_mirrors_in_place_and_keeps_faces_outwards():
    builder = painted()
    with builder.placed((0, 1, 0)), builder.both_sides(), builder.placed((0, 2, 0), rotation_about("z", 90)):
        builder.box((0, 0, 0), (4, 2, 2), "red")
    low, high = builder.bounds()
    assert low == pytest.approx([-1, -5, -1])
    assert high == pytest.approx([1, 5, 1])
    assert solid(builder).volume == pytest.approx(32)


@given(st.lists(st.floats(0.2, 1.0), min_size=3, max_size=24))
def test_triangles_of_a_simple_polygon_cover_its_area_once(radii):
    angle = np.arange(len(radii)) * (2 * np.pi / len(radii))
    points = np.array(radii)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    x, y = points[:, 0], points[:, 1]
    area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2
    corners = points[triangulate(points)]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    parts = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert len(parts) == len(radii) - 2
    assert (parts > -1e-9).all()
    assert parts.sum() == pytest.approx(area)


def test_loft_paints_strips_and_cells():
    builder = painted()
    builder.material("blue", (0, 0, 1))
    rings = [[(x, 0, 0), (x, 1, 0), (x, 1, 1), (x, 0, 1)] for x in (0, 1, 2)]
    builder.loft(rings, ["red", ["blue", "red", "red", "red"]], caps=False)
    areas = {m: 0.0 for m in builder.materials}
    for part in builder.parts:
        areas[part.material] += trimesh.Trimesh(part.vertices, part.faces, process=False).area
    assert areas["red"] == pytest.approx(7)
    assert areas["blue"] == pytest.approx(1)


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda b: b.material("two words", (0, 0, 0)), "one word"),
        (lambda b: b.material("x", (0, 0, 2)), "0..1"),
        (lambda b: b.material("x", (0, 0, 0), np.zeros((4, 4), np.uint8)), r"\(H, W, 3\)"),
        (lambda b: b.material("red", (0, 0, 0)), "declared before"),
        (lambda b: b.box((0, 0, 0), (1, 1, 1), "blue"), "not declared"),
        (lambda b: b.add(np.eye(3), [(0, 1, 2)], "wood"), "texture coordinates"),
        (lambda b: b.loft([np.eye(3)] * 3, ["red"]), "needs 2 materials, not 1"),
        (lambda b: b.bounds(), "empty"),
    ],
)
def test_mistakes_of_a_generator_are_named(mistake, message):
    with pytest.raises(ValueError, match=message):
        mistake(painted())


# Files


def test_a_model_is_written_y_up_facing_minus_z_with_textures_beside_it(tmp_path):
    builder = painted()
    builder.box((10, 0, 0), (20, 1, 1), "wood")
    builder.box((19, 3, 5), (2, 1, 1), "red")
    write_model(builder, tmp_path / "model")
    assert set(files(tmp_path / "model")) == {
        "models/model_normalized.obj",
        "models/model_normalized.mtl",
        "images/texture0.png",
    }
    text = (tmp_path / "model" / "models" / "model_normalized.mtl").read_text()
    assert re.findall(r"map_Kd (\S+)", text) == ["../images/texture0.png"]
    scene = trimesh.load(tmp_path / "model" / "models" / "model_normalized.obj", force="scene")
    red = next(g for g in scene.geometry.values() if g.visual.material.name == "red")
    low, high = scene.bounds
    # The red box is in front, to the left and on top: towards -z, -x and +y of the file.
    assert red.bounds[0][2] == pytest.approx(low[2], abs=1e-4)
    assert red.bounds[0][0] == pytest.approx(low[0], abs=1e-4)
    assert red.bounds[1][1] == pytest.approx(high[1], abs=1e-4)
    assert red.bounds[1][2] < 0


def test_a_model_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    with pytest.raises(ValueError, match="empty"):
        write_model(Builder(), tmp_path / "model")
    assert list(tmp_path.iterdir()) == []
    flat = painted()
    flat.box((0, 0, 0), (0, 0, 0), "red")
    with pytest.raises(ValueError, match="no extent"):
        write_model(flat, tmp_path / "model")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("category", CATEGORIES)
def test_every_category_loads_centred_with_unit_diagonal_and_all_its_materials(category, tmp_path):
    for index in range(3):
        builder = cad.make_model(category, index)
        folder = tmp_path / str(index)
        write_model(builder, folder)
        scene = trimesh.load(folder / "models" / "model_normalized.obj", force="scene")
        low, high = scene.bounds
        assert np.linalg.norm(high - low) == pytest.approx(1, abs=2e-4)
        assert (low + high) / 2 == pytest.approx(np.zeros(3), abs=1e-4)
        text = (folder / "models" / "model_normalized.mtl").read_text()
        assert len(scene.geometry) == len(re.findall(r"^newmtl", text, re.M)) >= 2
        for image in re.findall(r"map_Kd (\S+)", text):
            path = (folder / "models" / image).resolve()
            assert path.is_file()
            assert path.is_relative_to(folder.resolve())
        triangles = sum(len(g.faces) for g in scene.geometry.values())
        assert 100 < triangles < 4000
        assert sum(map(len, files(folder).values())) < 400_000


# Collections


def test_a_collection_has_the_layout_of_shapenet(tmp_path):
    cad.write_collection(tmp_path, ["car", "train"], 20, progress=False)
    table = pd.read_csv(tmp_path / "all.csv", dtype=str)
    assert list(table.columns) == ["id", "synsetId", "subSynsetId", "modelId", "split"]
    assert table["id"].is_unique
    assert table["modelId"].is_unique
    assert table["modelId"].str.fullmatch("[0-9a-f]{32}").all()
    counts = table.groupby(["synsetId", "split"]).size().to_dict()
    assert counts == {
        (SYNSETS[c], split): n for c in ("car", "train") for split, n in (("train", 14), ("val", 2), ("test", 4))
    }
    for row in table.itertuples():
        assert (tmp_path / row.synsetId / row.modelId / "models" / "model_normalized.obj").is_file()
    # Hidden leftovers must not count as models.
    assert {p.name for p in tmp_path.iterdir()} == {"all.csv", "README.md", SYNSETS["car"], SYNSETS["train"]}
    assert all(len(list((tmp_path / SYNSETS[c]).iterdir())) == 20 for c in ("car", "train"))


def test_splits_are_shuffled_by_seed_and_category():
    assert cad.split_names("car", 100) == cad.split_names("car", 100)
    assert cad.split_names("car", 100) != cad.split_names("car", 100, seed=1)
    assert cad.split_names("car", 100) != cad.split_names("bus", 100)
    assert cad.split_names("car", 1) == ["train"]


def test_same_seed_same_bytes_and_other_seeds_other_models(tmp_path):
    cad.write_collection(tmp_path / "a", ["car", "chair"], 4, seed=5, progress=False)
    cad.write_collection(tmp_path / "b", ["chair", "car"], 4, seed=5, progress=False)
    cad.write_collection(tmp_path / "c", ["car", "chair"], 4, seed=6, progress=False)
    a, b, c = (files(tmp_path / name) for name in "abc")
    a.pop("all.csv")
    b.pop("all.csv")
    assert a == b
    assert set(a) & set(c) == {"README.md"}


def test_an_executor_writes_the_same_bytes(tmp_path):
    cad.write_collection(tmp_path / "here", ["bus"], 20, progress=False)
    with ThreadPoolExecutor(2) as executor:
        cad.write_collection(tmp_path / "there", ["bus"], 20, progress=False, executor=executor)
    assert files(tmp_path / "here") == files(tmp_path / "there")
    with pytest.raises(ViewnetError, match="a process that makes CAD models died"):
        cad.write_collection(tmp_path / "dead", ["bus"], 20, progress=False, executor=Mortal(1))
    assert not (tmp_path / "dead" / "all.csv").exists()


def test_a_model_does_not_depend_on_how_many_are_made(tmp_path):
    cad.write_collection(tmp_path / "few", ["bus"], 2, progress=False)
    cad.write_collection(tmp_path / "many", ["bus", "car"], 5, progress=False)
    few, many = files(tmp_path / "few"), files(tmp_path / "many")
    few.pop("all.csv")
    assert few.items() <= many.items()


def test_a_killed_collection_goes_on_where_it_was(tmp_path, monkeypatch):
    cad.write_collection(tmp_path / "whole", ["boat"], 6, progress=False)
    calls = []

    def killed(builder: Builder) -> str:
        calls.append(builder)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return original(builder)

    original = writer.obj_text
    monkeypatch.setattr(writer, "obj_text", killed)
    with pytest.raises(KeyboardInterrupt):
        cad.write_collection(tmp_path / "part", ["boat"], 6, progress=False)
    assert not (tmp_path / "part" / "all.csv").exists()
    assert len(list((tmp_path / "part" / SYNSETS["boat"]).iterdir())) == 3
    cad.write_collection(tmp_path / "part", ["boat"], 6, progress=False)
    assert len(calls) == 4 + 3
    assert files(tmp_path / "part") == files(tmp_path / "whole")


@pytest.mark.parametrize(
    ("categories", "models", "message"),
    [
        (["car", "cat"], 1, "'cat'.*aeroplane"),
        ([], 1, "at least one"),
        ("car", 1, "as a list"),
        (["car"], 0, "models 0"),
    ],
)
def test_wrong_arguments_are_named_before_anything_is_written(tmp_path, categories, models, message):
    with pytest.raises(ViewnetError, match=message):
        cad.write_collection(tmp_path, categories, models, progress=False)
    assert list(tmp_path.iterdir()) == []


# Vehicles


@pytest.mark.slow
@pytest.mark.parametrize("category", CATEGORIES)
def test_models_of_a_category_are_all_different(category):
    assert len({fingerprint(cad.make_model(category, index)) for index in range(25)}) == 25


@pytest.mark.slow
@pytest.mark.parametrize("category", CATEGORIES)
def test_a_thousand_models_of_a_category_are_all_different(category):
    assert len({fingerprint(cad.make_model(category, index)) for index in range(1000)}) == 1000


@pytest.mark.parametrize(("category", "kind"), KINDS)
def test_each_kind_is_longer_than_wide_stands_upright_and_is_finite(category, kind):
    for seed in range(3):
        builder = drawn(category, seed, kind)
        assert all(np.isfinite(p.vertices).all() for p in builder.parts)
        x, y, z = builder.bounds()[1] - builder.bounds()[0]
        if category != "aeroplane":
            assert x > 1.2 * y or kind in ("rowing", "raft")
        if category != "boat":
            assert z < max(x, y)


def test_an_unknown_kind_is_named():
    with pytest.raises(ValueError, match=r"'tank'.*sedan"):
        car.car(np.random.default_rng(0), "tank")


def surface(builder: Builder, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Points uniform on the surface, in units of the diagonal, and their colours."""
    corners = np.concatenate([p.vertices[p.faces] for p in builder.parts])
    colors = np.concatenate([np.tile(builder.materials[p.material].color, (len(p.faces), 1)) for p in builder.parts])
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(corners), count, p=areas / areas.sum())
    weights = rng.dirichlet((1, 1, 1), count)
    points = np.einsum("nk,nkd->nd", weights, corners[chosen])
    return points / np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)), colors[chosen]


@pytest.mark.parametrize("category", ["aeroplane", "car", "train", "bicycle"])
@pytest.mark.parametrize("seed", range(6))
def test_left_and_right_are_mirror_images(category, seed):
    points, colors = surface(drawn(category, seed))
    tree = cKDTree(np.concatenate([points, 0.05 * colors], axis=1))
    mirrored = np.concatenate([points * [1, -1, 1], 0.05 * colors], axis=1)
    far, _ = tree.query(mirrored)
    # A bicycle's chain and pedals, a lone mast or a leg with an odd number of sides stay within this share.
    assert np.mean(far > 0.04) < (0.06 if category == "bicycle" else 0.01)


# A single-seater has neither lights nor windows.
@pytest.mark.parametrize("kind", sorted(set(car.KINDS) - {"formula"}))
def test_cars_have_white_lights_in_front_red_ones_behind_and_wheels_below(kind):
    wheeled = 0
    for seed in range(4):
        builder = drawn("car", seed, kind)

        def mean(material: str, builder: Builder = builder) -> np.ndarray:
            parts = [p.vertices[p.faces].reshape(-1, 3) for p in builder.parts if p.material == material]
            return np.concatenate(parts).mean(0)

        low, high = builder.bounds()
        assert mean("lamp")[0] > low[0] + 0.85 * (high - low)[0]
        assert mean("tail")[0] < low[0] + 0.15 * (high - low)[0]
        # A few bodies come without wheels.
        if any(p.material == "tyre" for p in builder.parts):
            assert mean("tyre")[2] < low[2] + 0.35 * (high - low)[2]
            wheeled += 1
        assert mean("glass")[2] > low[2] + 0.5 * (high - low)[2]
    assert wheeled >= 3


@pytest.mark.parametrize("seed", range(8))
def test_aeroplanes_carry_their_fin_behind(seed):
    points, _ = surface(drawn("aeroplane", seed, "airliner"))
    low, high = points.min(0), points.max(0)
    top = points[points[:, 2] > low[2] + 0.85 * (high - low)[2]]
    assert top[:, 0].mean() < low[0] + 0.2 * (high - low)[0]


def test_paints_follow_what_is_on_the_road():
    rng = np.random.default_rng(0)
    colors = np.array([palette.paint(rng) for _ in range(2000)])
    spread = np.ptp(colors, axis=1)
    assert 0.45 < np.mean(spread < 0.12) < 0.75
    assert 0.1 < np.mean((colors < 0.2).all(axis=1)) < 0.3
    assert 0.15 < np.mean((colors > 0.8).all(axis=1)) < 0.35
