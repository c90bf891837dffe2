"""CAD collections in the layouts of ShapeNetCore v1 and v2: their models with their splits, and a model's mesh."""

import logging
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from viewnet.config import SYNSETS, known_category, nearest
from viewnet.data.readers.reader import Contents, Reader, read_text
from viewnet.errors import ViewnetError
from viewnet.render.mesh import Mesh, UnusableModel
from viewnet.render.mtl import unread
from viewnet.render.obj import files_of, read_obj
from viewnet.runtime.lists import read_list
from viewnet.runtime.splits import SPLITS, seeded_rank, seeded_splits

Layout = Literal["v1", "v2"]
LAYOUTS: dict[Layout, str] = {"v2": "models/model_normalized.obj", "v1": "model.obj"}
"""Where a model lies in its folder."""
OTHER_FORMATS = (".3ds", ".blend", ".dae", ".fbx", ".glb", ".gltf", ".off", ".ply", ".stl", ".step", ".usdz")
# world_from_file: rows are world axes (x front, y left, z up) in the file's axes. Both layouts are y up; v1 faces +x,
# v2 faces -z.
WORLD_FROM_FILE = {
    "v1": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "v2": np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}

READER_VERSION = 1  # raise it when a change alters meshes: it is part of the identity of every collection's views

# This chair is missing from the validation list of the DPC release, but is in the table that the lists come from.
_DPC_CHAIR = ("03001627", 4744, 677, "901cab3f56c74894d7f7a4c4609b0913")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ModelFile:
    """One CAD model of a collection."""

    id: str
    category: str
    path: Path
    layout: Layout
    split: str

    @property
    def folder(self) -> Path:
        """The model's own folder, which its materials and textures must lie in."""
        return self.path.parent.parent if self.layout == "v2" else self.path.parent


def find_models(root: Path | str, category: str, splits: Path | str | None = None, seed: int = 0) -> list[ModelFile]:
    """The models of a category under `root`, sorted by id, each with its split (train, val or test).

    Splits are those of `splits`, a folder of lists `<synset>_{train,val,test}.txt` with one id a line; else of
    `all.csv` at the root (columns id, synsetId, subSynsetId, modelId, split); else seeded (runtime.splits). Models that
    a list lacks and listed models that are missing are not used; the log has their numbers.

    A category that is not PASCAL3D+'s has a folder of its own name in place of a synset's.
    Raises ViewnetError for a root that is not a collection, a category without models, and a malformed list, or one
    whose models of some split are all missing.
    """
    root, synset = Path(root), SYNSETS.get(known_category(category), category)
    models = _scan(root, synset, category)
    if splits is not None:
        listed, source = _read_lists(Path(splits), synset), str(splits)
    elif (root / "all.csv").is_file():
        listed, source = _read_csv(root / "all.csv", synset), str(root / "all.csv")
    else:
        splits_of = seeded_splits((model.id for model in models), seed, {"val": 2, "test": 1})
        return [replace(model, split=splits_of[model.id]) for model in models]
    if not listed:
        raise ViewnetError(f"{source}: lists no model of {category} ({synset}): give a list that does, or none at all")
    there = {model.id for model in models}
    for split in SPLITS:
        names = [name for name, value in listed.items() if value == split]
        if not there.intersection(names):
            reason = "list models for it, or use more"
            if names:
                reason = f"none of its {len(names)} models is in {root / synset}: check that they belong together"
            raise ViewnetError(f"{source}: the {split} split of {category} is empty: {reason}")
    unlisted, absent = sum(model.id not in listed for model in models), len(listed.keys() - there)
    if unlisted or absent:
        text = "%s: %d models not in %s left out, %d listed models missing"
        log.warning(text, root / synset, unlisted, source, absent)
    return [replace(model, split=listed[model.id]) for model in models if model.id in listed]


def take(models: Sequence[ModelFile], count: int, seed: int = 0) -> list[ModelFile]:
    """About `count` of the models, chosen by seed and ids, in their order; their splits keep their shares.

    At least one of each split is chosen. A count of 0, or above their number, takes all.
    """
    if count <= 0 or count >= len(models):
        return list(models)
    ranked = sorted(models, key=lambda model: seeded_rank(seed, "take", model.id))
    chosen: set[str] = set()
    for split in SPLITS:
        ids = [model.id for model in ranked if model.split == split]
        chosen.update(ids[: max(1, round(count * len(ids) / len(models)))])
    return [model for model in models if model.id in chosen]


def load_model(model: ModelFile) -> Mesh:
    """The model's mesh in the world frame, its bounding box centred on the origin with a diagonal of 1.

    Raises UnusableModel with the reason: see `obj.read_obj`, and a model without a size.
    """
    mesh = read_obj(model.path, model.folder)
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = mesh.vertices[used] @ WORLD_FROM_FILE[model.layout].T  # (V, 3)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    with np.errstate(over="ignore"):
        diagonal = float(np.linalg.norm(high - low))
    if not 1e-30 < diagonal < 1e30:
        raise UnusableModel(model.path, f"size {diagonal:g}")
    vertices = (vertices - (low + high) / 2) / diagonal
    return replace(mesh, vertices=vertices, faces=faces.reshape(-1, 3).astype(np.int32))


def read_files(model: ModelFile) -> dict[str, Path]:
    """Every file that decides the mesh, there or not, by its name within the model's folder."""
    folder = model.folder.resolve()
    return {os.path.relpath(file.resolve(), folder): file for file in files_of(model.path, model.folder)}


def holds_models(folder: Path) -> bool:
    """Whether CAD models lie in a folder, each in one of its own or all side by side."""
    return any(folder.glob("*.obj")) or any(next(folder.glob(f"*/{place}"), None) for place in LAYOUTS.values())


def category_folder(root: Path, category: str) -> Path | None:
    """The folder of a category's models, named by its synset or itself, or all of `root`; None where there are none."""
    for name in (SYNSETS.get(category, category), category):
        if (root / name).is_dir():
            return root / name
    return root if holds_models(root) else None


def _scan(root: Path, synset: str, category: str) -> list[ModelFile]:
    """Every model folder of the category, sorted by id; one without its .obj is rejected when it is rendered.

    A folder of one's own may be named by the category, or be the root, and models may be files side by side.
    """
    if not root.is_dir():
        raise ViewnetError(f"{root}: no such folder: give the folder of a ShapeNetCore collection")
    folder = category_folder(root, category)
    if folder is None:
        raise _no_collection(root, synset, category)
    names = sorted(entry.name for entry in os.scandir(folder) if entry.is_dir() and entry.name[0] not in "._")
    there = [[key for key, file in LAYOUTS.items() if (folder / name / file).is_file()] for name in names]
    counts = Counter(layouts[0] for layouts in there if layouts)
    if not counts["v1"] + counts["v2"]:
        if files := sorted(folder.glob("[!.]*.obj")):
            return [ModelFile(file.stem, category, file, "v1", "") for file in files]
        places = f"<id>/{LAYOUTS['v2']} (v2), <id>/{LAYOUTS['v1']} (v1) or <id>.obj"
        raise ViewnetError(f"{folder}: no models: expected {places}{other_formats(folder)}")
    usual: Layout = "v2" if counts["v2"] >= counts["v1"] else "v1"
    pairs = [(name, (*layouts, usual)[0]) for name, layouts in zip(names, there, strict=True)]
    return [ModelFile(name, category, folder / name / LAYOUTS[layout], layout, "") for name, layout in pairs]


def _no_collection(root: Path, synset: str, category: str) -> ViewnetError:
    """What to say of a root without a folder of the category and without models."""
    if (root / f"{synset}.zip").exists():
        return ViewnetError(f"{root / synset}: not there, but {synset}.zip is: unpack it")
    if names := sorted(path.name for path in root.iterdir() if re.fullmatch(r"\d{8}", path.name) and path.is_dir()):
        wanted = f"{synset} ({category})" if synset != category else category
        return ViewnetError(f"{root}: no folder {wanted}; it has {', '.join(names)}{nearest(category, SYNSETS)}")
    if synset != category:
        return ViewnetError(f"{root}: not a ShapeNetCore collection: expected a folder {synset} ({category}) in it")
    expected = f"expected .obj files in it or in a folder {category} of it, or videos, or folders of frames"
    return ViewnetError(f"{root}: no models of {category}: {expected}{other_formats(root)}{nearest(category, SYNSETS)}")


def other_formats(folder: Path) -> str:
    """The end of a message: models in other formats, if there are any."""
    found = sorted({path.suffix.lower() for path in folder.rglob("*")} & {*OTHER_FORMATS})
    return f"; it has {', '.join(found)}: export these as .obj" if found else ""


def _read_csv(file: Path, synset: str) -> dict[str, str]:
    """Model id -> split of one category of an official list."""
    table = read_list(file, ("synsetId", "modelId", "split"))
    table = table[table["synsetId"] == synset]
    if wrong := sorted(set(table["split"]) - set(SPLITS)):
        raise ViewnetError(f"{file}: split {wrong[0][:60]!r}: expected one of {', '.join(SPLITS)}")
    return _unique(file, list(zip(table["modelId"], table["split"], strict=True)))


def _read_lists(folder: Path, synset: str) -> dict[str, str]:
    """Model id -> split of one category of a folder of text lists."""
    pairs = []
    for split in SPLITS:
        file = folder / f"{synset}_{split}.txt"
        if not file.is_file():
            raise ViewnetError(f"{file}: no such list: expected {synset}_{{train,val,test}}.txt")
        lines = read_text(file, "a text file, one id a line").splitlines()
        pairs += [(name, split) for line in lines if (name := line.strip())]
    counts = Counter(split for _, split in pairs)
    chair, train, val, name = _DPC_CHAIR
    if (synset, counts["train"], counts["val"]) == (chair, train, val) and (name, "val") not in pairs:
        pairs.append((name, "val"))
    return _unique(folder, pairs)


def _unique(source: Path, pairs: list[tuple[str, str]]) -> dict[str, str]:
    listed: dict[str, str] = {}
    for name, split in pairs:
        if listed.setdefault(name, split) != split:
            raise ViewnetError(f"{source}: model {name[:60]} is in both {listed[name]} and {split}: keep one")
    return listed


def _synset_there(root: Path, synset: str) -> bool:
    return (root / synset).is_dir() or (root / f"{synset}.zip").is_file()


def _count(root: Path, contents: Contents) -> None:
    # Models of one's own name no category.
    for category in [name for name, synset in SYNSETS.items() if _synset_there(root, synset)] or [""]:
        with contents.error_is_problem():
            models = find_models(root, category or "own")
            lost = {model.id: reason for model in models if (reason := unread(model.path))}
            for model in (models[number] for number in contents.opened(category, len(models), "models")):
                try:
                    load_model(model)
                except UnusableModel as error:
                    lost.setdefault(model.id, error.reason)
            layout = {name: f"{name} models" if category else "models" for name in LAYOUTS}
            usable = [f"{layout[model.layout]} to {model.split}" for model in models if model.id not in lost]
            contents.add(category, usable, lost.items())


READER = Reader(
    recognises=lambda root: any(_synset_there(root, each) for each in SYNSETS.values()) or holds_models(root),
    count=_count,
)
