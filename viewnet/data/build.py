"""The view store that a configuration asks for: made when it is missing, reused when it is there."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

from viewnet import cad, paths
from viewnet.config import CATEGORIES, DataConfig, PhotoConfig, VideoConfig, known
from viewnet.data import clip_store, frames, masks, photo_store
from viewnet.data.clips import Clip
from viewnet.data.crop import Crop
from viewnet.data.readers import freiburg, objectron, pascal3d, video_folder
from viewnet.data.readers.shapenet import SHARES, ModelFile, find_models, take
from viewnet.data.rendered_store import describe, digest, drawn_so_far, render_views
from viewnet.data.store import ViewStore, identity_of
from viewnet.data.synthetic import freiburg_standin, objectron_standin, pascal3d_standin
from viewnet.errors import ViewnetError
from viewnet.render import choose_backend
from viewnet.runtime.files import filling, locked


def view_store(
    config: DataConfig, workers: int | None = None, progress: bool = True, executor: Executor | None = None
) -> ViewStore:
    """Open the views of `config` (section 4.2), making the CAD collection and drawing the views where they are missing.

    Where it names videos, theirs are the views (video_views). Else views are drawn in `workers` processes of this
    machine, or on an executor whose workers see the same files.

    Stores lie in `<paths.data()>/views/<category>-<key>`, the key a hash of everything that decides the views. Raises
    ViewnetError for a collection that cannot be used (see find_models) and values out of range (see render_views).
    """
    if config.video is not None:
        if config.video.category != config.category:
            raise ViewnetError(
                f"category {config.category}: its videos show {config.video.category}: name one category"
            )
        return video_views(config.video, workers, progress)
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
        shutil.rmtree(drawn_so_far(folder), ignore_errors=True)
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
        executor=executor,
    )


def joining(models: list[ModelFile], config: DataConfig) -> list[ModelFile]:
    """Models of the second collection as they join the first: for training all of them.

    Each as often as it takes to make `config.extra_share` of the training models, the first collection's being 70 %,
    every time seen from other viewpoints. Without a known number of models in the first each comes once. Raises
    ViewnetError for a share that is not between 0 and 1.
    """
    if not 0 < config.extra_share < 1:
        raise ViewnetError(f"extra_share {config.extra_share}: expected a number between 0 and 1")
    others = SHARES[0] * config.models * config.extra_share / (1 - config.extra_share)
    copies = max(1, round(others / len(models)))
    return [replace(model, id=f"extra{i}-{model.id}", split="train") for i in range(copies) for model in models]


def built_in(category: str, models: int, seed: int = 0, progress: bool = True) -> Path:
    """The folder of a collection of built-in models of one category, written if it is not there yet.

    ViewnetError for 0 models.
    """
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


def photo_views(config: PhotoConfig, workers: int | None = None, progress: bool = True) -> ViewStore:
    """Open the photographs of `config` (section 4.3) as a view store, cutting them where that has not been done.

    Split "val" is what viewpoints are calibrated on, PASCAL3D+'s "train", and "test" what is scored, its "val". Every
    object is a model of its own, with one view. `photos.summary` says what is used and what is left out.

    Stores lie in `<paths.data()>/views/photos-<category>-<key>`, the key a hash of everything that decides the views;
    looking for one reads annotations, but no image. Raises ViewnetError for a root that is neither PASCAL3D+ nor a
    folder with a list (photos.read_folder), settings that do not apply to it, a split without usable photographs, and
    one photograph in both.
    """
    known(config.category, CATEGORIES, "category")
    crop = Crop(config.size, config.margin, config.square, config.pad)
    root = None if config.root is None else Path(config.root)
    made_by: dict[str, Any] = {"category": config.category, "crop": photo_store.described(crop)}
    listed = root is not None and (root / photo_store.LIST).is_file() and not (root / "Annotations").is_dir()
    if root is None:
        made_by["stand-in"] = _stand_in(config)
    elif listed:
        if config.keep != "all" or config.coarse:
            raise ViewnetError(f"{root}: its list has no flags to go by: use keep='all' and coarse=False, or PASCAL3D+")
        made_by["listed"] = photo_store.folder_digest(root)
    elif (root / "Annotations").is_dir():
        made_by["pascal3d"] = _pascal3d_digest(root, config.category, config.subset)
    else:
        raise ViewnetError(
            f"{root}: no photographs that can be read: expected PASCAL3D+ 1.1 (a folder with Annotations, Images and"
            f" Image_sets) or a folder with images/ and {photo_store.LIST}"
        )
    if not listed:
        made_by |= {"subset": config.subset, "keep": config.keep, "coarse": config.coarse}
    folder = paths.data() / "views" / f"photos-{config.category}-{identity_of(made_by)[:12]}"
    if folder.exists():
        return ViewStore.open(folder)
    with locked(folder):
        if folder.exists():
            return ViewStore.open(folder)
        if listed and root is not None:
            rows = photo_store.read_folder(root, config.category)
            return photo_store.photo_store(
                rows, folder, crop, made_by, root, upright=True, workers=workers, progress=progress
            )
        if root is None:
            root = stand_in(config, workers, progress)
        found, report = [], pascal3d.Report()
        for split in pascal3d.SPLITS:
            mine, told = pascal3d.read(root, config.category, config.subset, split, config.keep, config.coarse)
            found += mine
            report.rejected += told.rejected
            report.mended += told.mended
            report.others += told.others
        # Decided by what has been hashed already, and kept where a summary finds it.
        made_by["mended"] = pascal3d.tally(what for _, what in report.mended)
        made_by["objects of other categories"] = report.others
        splits = {"train": "val", "val": "test"}
        return photo_store.photo_store(
            found, folder, crop, made_by, root, splits, report.rejected, workers=workers, progress=progress
        )


def stand_in(config: PhotoConfig, workers: int | None = None, progress: bool = True) -> Path:
    """The folder of the stand-in for PASCAL3D+ that `config` asks for, written if it is not there yet."""
    root = paths.data() / "pascal3d-stand-in" / f"{config.category}-{identity_of(_stand_in(config))[:12]}"

    def write(folder: Path) -> None:
        pascal3d_standin.write_stand_in(
            folder,
            [config.category],
            config.models,
            config.count,
            config.subset,
            None if config.backgrounds is None else Path(config.backgrounds),
            config.seed,
            workers,
            progress,
        )

    return _written(root, write)


def video_views(config: VideoConfig, workers: int | None = None, progress: bool = True) -> ViewStore:
    """Open the videos of `config` (section 4.4) as a view store, cutting their objects out where that is not done.

    Every clip is a model, every frame a view. Viewpoints are known of Freiburg static cars and of Objectron; of a
    folder of videos they are not, so that training selects by reconstruction. `clip_store.summary` says what is used
    and what is left out.

    Stores lie in `<paths.data()>/views/videos-<category>-<key>`, the key a hash of everything that decides the views;
    looking for one lists the frames' files, and reads annotations and images' headers. Raises ViewnetError for a root
    that cannot be read, missing weights of a network for masks, and where no clip to train on is left.
    """
    known(config.category, CATEGORIES, "category")
    if config.count < 0:
        raise ViewnetError(f"count {config.count}: expected 1 or more frames a clip, or 0 for all")
    crop = Crop(config.size, config.margin, config.square)
    limits = clip_store.Limits(config.side, config.blur)
    source = _mask_source(config)
    root = video_stand_in(config, workers, progress) if config.root is None else Path(config.root)
    clips, rejected = _clips(config, root)
    made_by = clip_store.describe(clips, source, crop, limits, config.scale)
    folder = paths.data() / "views" / f"videos-{config.category}-{identity_of(made_by)[:12]}"
    if folder.exists():
        return ViewStore.open(folder)
    with locked(folder):
        if folder.exists():
            return ViewStore.open(folder)
        return clip_store.clip_store(
            clips, folder, root, source, crop, limits, config.scale, rejected, workers, progress
        )


def video_stand_in(config: VideoConfig, workers: int | None = None, progress: bool = True) -> Path:
    """The folder of the stand-in for videos that `config` asks for, written if it is not there yet.

    Raises ViewnetError for a category that neither data set has, and for a folder of videos, which has no stand-in.
    """
    kind = config.kind
    if kind == "auto":
        kind = "freiburg" if config.category == freiburg.CATEGORY else "objectron"
    if kind == "freiburg" and config.category == freiburg.CATEGORY:
        cars = (config.sequences or freiburg_standin.SEQUENCES, config.frames, config.seed)
        root = paths.data() / "freiburg-stand-in" / identity_of(freiburg_standin.describe(*cars))[:12]
        return _written(root, lambda folder: freiburg_standin.write_stand_in(folder, *cars, workers, progress))
    if kind == "objectron" and config.category in objectron.CLASSES:
        filmed = (config.category, config.videos, config.frames, config.seed)
        root = paths.data() / "objectron-stand-in" / identity_of(objectron_standin.describe(*filmed))[:12]
        return _written(root, lambda folder: objectron_standin.write_stand_in(folder, *filmed, progress=progress))
    raise ViewnetError(
        f"category {config.category}: stand-ins for videos show {freiburg.CATEGORY} (Freiburg static cars) and"
        f" {', '.join(objectron.CLASSES)} (Objectron): name a root for others"
    )


def _written(root: Path, write: Callable[[Path], None]) -> Path:
    """`root`, which appears whole when `write` has filled a folder beside it."""
    if not root.exists():  # before any lock, for which the folder about it may not be writable
        with locked(root):
            if not root.exists():
                with filling(root) as temporary:
                    write(temporary)
    return root


def _clips(config: VideoConfig, root: Path) -> tuple[list[Clip], list[freiburg.Rejected]]:
    clips, rejected = _READERS[_kind(config, root)](config, root)
    if config.split_rule == "all":
        clips = [replace(clip, split="train") for clip in clips]
    if config.mask_folder != VideoConfig.mask_folder:
        if config.masks != "files":
            raise ViewnetError(f"mask_folder {config.mask_folder}: masks are {config.masks} and not files: leave it")
        # A clip's id is its place below the folder, whatever the data set.
        places = [root / Path(config.mask_folder).expanduser() / clip.id for clip in clips]
        if not any(place.is_dir() for place in places):
            raise ViewnetError(f"mask_folder {config.mask_folder}: no masks of any video, such as {places[0]}")
        clips = [
            replace(clip, masks=place if place.is_dir() else None) for clip, place in zip(clips, places, strict=True)
        ]
    return clips, rejected


def _kind(config: VideoConfig, root: Path) -> str:
    """Which layout to read `root` in."""
    if config.kind != "auto":
        return config.kind
    if not (root / freiburg.ANNOTATIONS).is_dir():
        return "folder"
    return "objectron" if (root / "videos").is_dir() else "freiburg"


def _freiburg(config: VideoConfig, root: Path) -> tuple[list[Clip], list[freiburg.Rejected]]:
    if config.category != freiburg.CATEGORY:
        raise ViewnetError(f"{root}: shows cars, not {config.category}: name another root or category car")
    clips, rejected = freiburg.read(root, config.split_rule)
    chosen = [frames.pick(len(clip.frames), config.count or None, config.pick, clip.id, config.seed) for clip in clips]
    fewer = [
        replace(clip, frames=tuple(clip.frames[i] for i in mine)) for clip, mine in zip(clips, chosen, strict=True)
    ]
    return fewer, rejected


def _objectron(config: VideoConfig, root: Path) -> tuple[list[Clip], list[freiburg.Rejected]]:
    if config.pick != "random":
        raise ViewnetError(f"pick {config.pick}: of Objectron's frames those to use are drawn: use random")
    return objectron.read(root, config.category, config.count or sys.maxsize, config.seed)


def _folder(config: VideoConfig, root: Path) -> tuple[list[Clip], list[freiburg.Rejected]]:
    return video_folder.read(root, config.category, config.count or None, config.pick, config.seed)


_READERS = {"freiburg": _freiburg, "objectron": _objectron, "folder": _folder}


def _mask_source(config: VideoConfig) -> masks.MaskSource | None:
    if config.masks == "none":
        return None
    if config.masks == "files":
        return masks.FromFiles()
    return masks.FromAlpha() if config.masks == "alpha" else masks.predicted(config.masks, config.category)


def _stand_in(config: PhotoConfig) -> dict[str, Any]:
    backgrounds = None if config.backgrounds is None else Path(config.backgrounds)
    return pascal3d_standin.describe(
        config.category, config.subset, config.models, config.count, config.seed, backgrounds
    )


def _pascal3d_digest(root: Path, category: str, subset: str) -> str:
    """What photographs depend on: lists, annotations and, as a cheap sign of a changed image, its size."""
    hashed = hashlib.sha256()
    for part in pascal3d.parts(subset):
        for split in pascal3d.SPLITS:
            for image in pascal3d.listed(root, category, part, split):
                record = pascal3d.annotation_file(root, category, part, image)
                image_path = pascal3d.image_file(root, category, part, image)
                content = hashlib.sha256(record.read_bytes()).hexdigest() if record.is_file() else ""
                size = image_path.stat().st_size if image_path.is_file() else -1
                hashed.update(json.dumps([part, split, image, content, image_path.name, size]).encode())
    return hashed.hexdigest()
