"""Readers of OBJ files compared: how many of the models of tests/helpers/obj_wordings.py each reads right.

    python benchmarks/obj_readers.py [--models 300] [--seed 0] [--speed FILE.obj]

Readers are the package's, trimesh, and tinyobjloader where it can be imported. A file is read right where its surface,
its colours and its texture coordinates are those it states, or where it is refused and has to be. `--speed` reads one
file with each in turns, and prints the medians.
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import statistics
import sys
import tempfile
import time
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import numpy as np
import trimesh
from helpers.obj_wordings import Triangles, as_triangles, wordings
from PIL import Image

from viewnet.errors import ViewnetError
from viewnet.render.mesh import GREY
from viewnet.render.obj import read_obj


def by_viewnet(file: Path) -> Triangles:
    return as_triangles(read_obj(file))


def by_trimesh(file: Path) -> Triangles:
    parts = []
    for mesh in trimesh.load_scene(file, process=False, maintain_order=True).geometry.values():
        colours = np.full((len(mesh.vertices), 3), GREY)
        uv = np.full((len(mesh.vertices), 2), np.nan)
        if mesh.visual.kind == "vertex":
            colours = mesh.visual.vertex_colors[:, :3] / 255
        elif mesh.visual.kind == "texture" and (image := mesh.visual.material.image) is not None:
            colours[:] = np.asarray(image.convert("RGB")).mean((0, 1)) / 255
            uv = uv if mesh.visual.uv is None else mesh.visual.uv
        elif mesh.visual.kind == "texture" and mesh.visual.material.name != "material_0":
            colours[:] = mesh.visual.material.diffuse[:3] / 255
        parts.append(Triangles(mesh.triangles, colours[mesh.faces], uv[mesh.faces]))
    return Triangles(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("corners", "colours", "uv")))


def by_tinyobjloader(file: Path) -> Triangles:
    import tinyobjloader

    reader = tinyobjloader.ObjReader()
    if not reader.ParseFromFile(str(file)):
        raise ValueError(reader.Error())
    attributes, parts = reader.GetAttrib(), []
    vertices = np.array(attributes.vertices).reshape(-1, 3)
    tints, places = np.array(attributes.colors).reshape(-1, 3), np.array(attributes.texcoords).reshape(-1, 2)
    materials = reader.GetMaterials()
    for shape in reader.GetShapes():
        # Its `numpy_indices` are zeros.
        rows = [(corner.vertex_index, corner.texcoord_index) for corner in shape.mesh.indices]
        index = np.array(rows, int).reshape(-1, 3, 2)
        if not len(index):
            continue
        colours, uv = tints[index[..., 0]] if len(tints) else np.full((*index.shape[:2], 3), GREY), None
        uv = np.full((len(index), 3, 2), np.nan)
        for face, number in enumerate(shape.mesh.material_ids):
            if number < 0:
                # White is what the library has for vertices without a colour.
                colours[face] = np.where((colours[face] == 1).all(-1, keepdims=True), GREY, colours[face])
            elif materials[number].diffuse_texname:
                with Image.open(file.parent / materials[number].diffuse_texname.replace("\\", "/")) as image:
                    colours[face], uv[face] = (
                        np.asarray(image.convert("RGB")).mean((0, 1)) / 255,
                        places[index[face, :, 1]],
                    )
            elif (colours[face] == 1).all():
                colours[face] = materials[number].diffuse
        parts.append(Triangles(vertices[index[..., 0]], colours, uv))
    return Triangles(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("corners", "colours", "uv")))


READERS: dict[str, Callable[[Path], Triangles]] = {"viewnet": by_viewnet, "trimesh": by_trimesh}
if importlib.util.find_spec("tinyobjloader"):
    READERS["tinyobjloader"] = by_tinyobjloader


def outcome(read: Callable[[Path], Triangles], file: Path, truth: Triangles | None, junk: str) -> str:
    """right, wrong, refused, or crashed."""
    try:
        result = read(file)
    except ViewnetError as error:
        if truth is None:
            return "right" if junk in str(error) else "wrong"
        return "refused"
    except Exception:  # libraries raise many types
        return "right" if truth is None else "refused"
    return "right" if truth is not None and truth.same_as(result) else "wrong"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speed", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable(logging.ERROR)
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    failed: dict[str, Counter[str]] = defaultdict(Counter)
    for model in wordings(options.models, options.seed):
        with tempfile.TemporaryDirectory() as folder:
            file = model.write(Path(folder))
            for name, read in READERS.items():
                result = outcome(read, file, model.truth, model.junk)
                counts[name][result] += 1
                if result != "right":
                    failed[name].update(model.features)
    for name, results in counts.items():
        print(f"{name}: {', '.join(f'{results[key]} {key}' for key in ('right', 'wrong', 'refused'))}")
        print("   ", ", ".join(f"{feature} {count}" for feature, count in failed[name].most_common(12)))
    if options.speed:
        times: dict[str, list[float]] = defaultdict(list)
        for _ in range(7):
            for name, read in READERS.items():
                begun = time.perf_counter()
                read(options.speed)
                times[name].append(time.perf_counter() - begun)
        print(", ".join(f"{name} {statistics.median(seconds):.3f} s" for name, seconds in times.items()))


if __name__ == "__main__":
    main()
