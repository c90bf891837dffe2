"""The view store that a configuration asks for: made when it is missing, reused when it is there."""

from __future__ import annotations

from pathlib import Path

from viewnet import cad, paths
from viewnet.config import DataConfig
from viewnet.data.shapenet import ModelFile, find_models, take
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
    models: list[ModelFile] | None = None
    if config.root is None:
        # Known without looking at a file, so that a store is found when its collection has been removed.
        described["models"] = {"built-in": cad.VERSION, "count": config.models, "category": config.category}
    else:
        models = take(find_models(config.root, config.category, config.splits, config.seed), config.models, config.seed)
        described["models"] = digest(models)
    folder = paths.data() / "views" / f"{config.category}-{identity_of(described)[:12]}"
    if folder.exists():
        return ViewStore.open(folder)
    if models is None:
        models = find_models(built_in(config.category, config.models, config.seed, progress), config.category)
    return render_views(
        models,
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
