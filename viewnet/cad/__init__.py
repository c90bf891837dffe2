"""Built-in CAD models: every category drawn by a program, in the layout of ShapeNetCore v2."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from viewnet.cad.builder import Builder
from viewnet.cad.writer import write_model
from viewnet.config import CATEGORIES, SYNSETS
from viewnet.errors import ViewnetError
from viewnet.runtime.files import replacing
from viewnet.runtime.progress import bar

Generator = Callable[[np.random.Generator], Builder]

# Part of every model's name: raise it when any generator changes, so that old and new models are never mixed.
VERSION = 2
SPLITS = {"train": 0.7, "val": 0.1, "test": 0.2}
FOLDERS = {"bicycle": "cycles", "motorbike": "cycles", "diningtable": "furniture", "sofa": "furniture"}
"""Categories that share parts share a folder; any other has one of its own."""
# Each category's module has the function of the same name.
GENERATORS: dict[str, Generator] = {
    category: getattr(importlib.import_module(f"viewnet.cad.{FOLDERS.get(category, category)}.{category}"), category)
    for category in CATEGORIES
}


def model_id(category: str, index: int, seed: int = 0) -> str:
    """32 hex digits that name model `index` of a category under a seed and the generators' version."""
    return hashlib.md5(f"viewnet-cad {VERSION} {seed} {category} {index}".encode(), usedforsecurity=False).hexdigest()


def make_model(category: str, index: int, seed: int = 0) -> Builder:
    """Model `index` of a category: it depends on (seed, category, index) only. Raises ViewnetError for the category."""
    _check(category)
    return GENERATORS[category](np.random.default_rng([seed, int(SYNSETS[category]), index]))


def write_collection(root: Path, categories: Sequence[str], models: int, seed: int = 0, progress: bool = True) -> None:
    """Write `models` models of each category, and `all.csv` with their splits, in the layout of ShapeNetCore v2.

    `<root>/<synset>/<model id>/models/model_normalized.obj` and `.mtl`, textures in `<model id>/images/`; `all.csv`
    has the columns id, synsetId, subSynsetId, modelId, split (train, val and test by 0.7, 0.1 and 0.2 of a category's
    models, shuffled by the seed). A model appears when it is whole and is kept when it exists, so a killed call goes
    on where it was. The same arguments give the same bytes.

    Raises ViewnetError for an unknown category, no category at all, or a number of models below one.
    """
    if isinstance(categories, str) or not categories:
        raise ViewnetError(f"categories {categories!r}: give at least one of {', '.join(GENERATORS)}, as a list")
    if models < 1:
        raise ViewnetError(f"models {models}: give the number of models of each category, 1 or more")
    for category in categories:
        _check(category)
    rows: list[tuple[str, str, str, str, str]] = []
    jobs = [(category, index) for category in dict.fromkeys(categories) for index in range(models)]
    splits = {category: split_names(category, models, seed) for category in categories}
    for category, index in bar(progress, iterable=jobs, desc="models", unit="model"):
        name, synset = model_id(category, index, seed), SYNSETS[category]
        folder = root / synset / name
        if not folder.exists():
            write_model(make_model(category, index, seed), folder)
        rows.append((f"{len(rows) + 1:06d}", synset, synset, name, splits[category][index]))
    table = pd.DataFrame(rows, columns=["id", "synsetId", "subSynsetId", "modelId", "split"])
    with replacing(root / "all.csv") as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n")


def split_names(category: str, models: int, seed: int = 0) -> list[str]:
    """The split of each of `models` models: exact counts (the rest is train), shuffled by seed and category."""
    val, test = round(SPLITS["val"] * models), round(SPLITS["test"] * models)
    names = np.array(["train"] * (models - val - test) + ["val"] * val + ["test"] * test)
    order = np.random.default_rng([seed, int(SYNSETS[category]), models, 1]).permutation(models)
    return [str(name) for name in names[order]]


def _check(category: str) -> None:
    if category not in GENERATORS:
        raise ViewnetError(f"category {category!r}: expected one of {', '.join(GENERATORS)}")
