"""The view store that a configuration asks for: made when it is missing, reused when it is there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from viewnet import cad, paths
from viewnet.config import DataConfig
from viewnet.data.shapenet import SHARES, ModelFile, find_models, take
from viewnet.data.store import ViewStore, identity_of
from viewnet.errors import ViewnetError
from viewnet.files import locked
from viewnet.render import choose_backend
from viewnet.render.views import describe, digest, render_views


def view_store(config: DataConfig, workers: int | None = None, progress: bool = True) -> ViewStore:
    """Open the views of `config` (section 4.2), making the CAD collection and drawing the views where they are missing.

    Stores lie in `<paths.data()>/views/<category>-<key>`, the key a hash of everything that decides the views. Raises
    ViewnetError for a collection that cannot be used (see find_models) and values out of range (see render_views).
    """
    if config.models < 0:
        raise ViewnetError(f"models {config.models}: expected 1 or more, or 0 for all of a collection")
    backend = choose_backend(config.renderer)
    described = describe(
        config.views,
        config.image_size,
        config.supersample,
        config.azimuth_range,
        config.elevation_range,
        config.seed,
        backend,
    )
    extra = [] if config.extra is None else joining(find_models(config.extra, config.category), config)
    models: list[ModelFile] | None = None
    if config.root is None:
        # Known without looking at a file, so that a store is found when its collection has been removed.
        described["models"] = {"built-in": cad.VERSION, "count": config.models, "category": config.category}
    else:
        models = take(find_models(config.root, config.category, config.splits, config.seed), config.models, config.seed)
        described["models"] = digest(models)
    if extra:
        described["extra"] = digest(extra)
    folder = paths.data() / "views" / f"{config.category}-{identity_of(described)[:12]}"
    if folder.exists():
        return ViewStore.open(folder)
    if models is None:
        models = find_models(built_in(config.category, config.models, config.seed, progress), config.category)
    return render_views(
        [*models, *extra],
        folder,
        views=config.views,
        image_size=config.image_size,
        supersample=config.supersample,
        azimuth_range=config.azimuth_range,
        elevation_range=config.elevation_range,
        seed=config.seed,
        backend=backend,
        workers=workers,
        progress=progress,
    )


def joining(models: list[ModelFile], config: DataConfig) -> list[ModelFile]:
    """Models of the second collection as they join the first: for training all of them.

    Each as often as it takes to make `config.extra_share` of the training models, the first collection's being 70 %,
    every time seen from other viewpoints. Without a known number of models in the first each comes once.
    """
    if not 0 < config.extra_share < 1:
        raise ViewnetError(f"extra_share {config.extra_share}: expected a number between 0 and 1")
    others = SHARES[0] * config.models * config.extra_share / (1 - config.extra_share)
    copies = max(1, round(others / len(models)))
    return [replace(model, id=f"extra{i}-{model.id}", split="train") for i in range(copies) for model in models]


def built_in(category: str, models: int, seed: int = 0, progress: bool = True) -> Path:
    """The folder of a collection of built-in models of one category, written if it is not there yet."""
    if models < 1:
        raise ViewnetError(
            "models 0 means all of a collection, but built-in models have no end: give a number or a root"
        )
    root = paths.data() / "cad" / f"{category}-{models}-seed{seed}-v{cad.VERSION}"
    with locked(root):
        # The list of splits is written last.
        if not (root / "all.csv").is_file():
            cad.write_collection(root, [category], models, seed, progress=progress)
    return root
