"""The view store that a configuration asks for: made when it is missing, reused when it is there."""

import shutil
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

from viewnet import cad, paths
from viewnet.config import DataConfig, PhotoConfig, VideoConfig, known, known_category
from viewnet.data import clip_store, masks, photo_store
from viewnet.data.clips import Clip, is_image, is_video, masks_in
from viewnet.data.crop import Crop
from viewnet.data.readers import freiburg, objectron, pascal3d
from viewnet.data.readers.photo_folder import LIST
from viewnet.data.readers.registry import READERS
from viewnet.data.readers.shapenet import ModelFile, category_folder, find_models, take
from viewnet.data.rendered_store import Rendering, digest, partial_folder, render_views
from viewnet.data.store import Rejected, ViewStore, filled_once, identity_of, made_once
from viewnet.data.synthetic.freiburg_standin import SEQUENCES, FreiburgStandIn
from viewnet.data.synthetic.objectron_standin import ObjectronStandIn
from viewnet.data.synthetic.pascal3d_standin import Pascal3DStandIn
from viewnet.data.synthetic.stand_in import StandIn
from viewnet.errors import ViewnetError
from viewnet.render import choose_backend
from viewnet.runtime.files import locked
from viewnet.runtime.splits import SHARES


def view_store(
    config: DataConfig, workers: int | None = None, progress: bool = True, executor: Executor | None = None
) -> ViewStore:
    """Open the views of `config` (section 4.2), making the CAD collection and rendering the views where missing.

    Where it names videos, the views are theirs (video_views). Else views are rendered in `workers` processes of this
    machine, or models and views made on an executor whose workers see the same files. Stores lie in
    `<paths.data()>/views/<category>-<key>`, the key a hash of everything that decides the views. Raises ViewnetError
    as find_models and render_views do.
    """
    if config.video is not None:
        if config.video.category != config.category:
            raise ViewnetError(f"category {config.category}: videos show {config.video.category}: name one category")
        return video_views(config.video, workers, progress)
    folder, settings, described, models, extra = _asked(config)
    if folder.exists():
        shutil.rmtree(partial_folder(folder), ignore_errors=True)
        return ViewStore.open(folder)
    if models is None:
        root = built_in(config.category, config.models, config.seed, progress, executor)
        models = find_models(root, config.category)
        described["models"] = digest(models, built_in=True)
    how: dict[str, Any] = {"workers": workers, "progress": progress, "executor": executor}
    return render_views([*models, *extra], folder, **settings, **how, described=described)


def planned(config: DataConfig) -> tuple[Path | None, int]:
    """The folder of the views of `config`, and about how many bytes they take; makes nothing.

    None and 0 where a stand-in for videos, which decides them, is not there yet. Raises ViewnetError as view_store.
    """
    if config.video is None:
        folder, _, _, models, extra = _asked(config)
        count = (config.models if models is None else len(models)) + len(extra)
        return folder, 4 * count * config.views * config.image_size**2
    root = Path(config.video.root) if config.video.root else _stand_in_folder(video_stand_in(config.video))
    if not root.exists():
        return None, 0
    folder, clips, *_ = _asked_of_videos(config.video, root)
    return folder, 4 * sum(len(clip.frames) for clip in clips) * config.video.size**2


def count_views(config: DataConfig) -> int:
    """How many views the folder of models or videos of `config` gives; opens no model. Raises as view_store."""
    if config.video is not None:
        return sum(len(clip.frames) for clip in _clips(config.video, Path(str(config.video.root)))[0])
    models, extra = _models(config)
    return (len(models or ()) + len(extra)) * config.views


def _models(config: DataConfig) -> tuple[list[ModelFile] | None, list[ModelFile]]:
    """The models of the folder that `config` names, None for built-in ones, and extra ones."""
    extra = [] if config.extra is None else as_training_models(find_models(config.extra, config.category), config)
    if config.root is None:
        return None, extra
    models = find_models(config.root, config.category, config.splits, config.seed)
    return take(models, config.models, config.seed), extra


def _asked(config: DataConfig) -> tuple[Path, dict[str, Any], dict[str, Any], list[ModelFile] | None, list[ModelFile]]:
    """Of rendered views: their folder, settings and description, their models, None for built-in ones, and extra ones.

    Raises ViewnetError for settings out of range.
    """
    if config.models < 0:
        raise ViewnetError(f"models {config.models}: expected 1 or more, or 0 for all of a collection")
    names = ("views", "image_size", "supersample", "azimuth_range", "elevation_range", "seed")
    settings = {name: getattr(config, name) for name in names} | {"backend": choose_backend(config.renderer)}
    made_by = Rendering(**settings).describe()
    models, extra = _models(config)
    described = {"extra": digest(extra)} if extra else {}
    if models is None:
        # Known without looking at a file, so that a store is found when its collection has been removed.
        known_by = {"built-in": cad.VERSIONS[config.category], "count": config.models, "category": config.category}
    else:
        known_by = described["models"] = digest(models)
    folder = _store_folder(config.category, made_by | described | {"models": known_by})
    return folder, settings, described, models, extra


def as_training_models(models: list[ModelFile], config: DataConfig) -> list[ModelFile]:
    """The models of a second collection, all of them in the training split of the first.

    Each is repeated until they are `config.extra_share` of the training models, the first collection's being 70 % of
    `config.models`; each copy has other viewpoints; one if `models` is 0. ViewnetError for a share outside (0, 1).
    """
    if not 0 < config.extra_share < 1:
        raise ViewnetError(f"extra_share {config.extra_share}: expected a number between 0 and 1")
    number = SHARES["train"] * config.models * config.extra_share / (1 - config.extra_share)
    copies = max(1, round(number / len(models)))
    return [replace(model, id=f"extra{i}-{model.id}", split="train") for i in range(copies) for model in models]


def built_in(
    category: str, models: int, seed: int = 0, progress: bool = True, executor: Executor | None = None
) -> Path:
    """The folder of built-in models of one category, written if missing. ViewnetError for less than one model."""
    if models < 1:
        raise ViewnetError("models 0 means all of a collection, but built-in ones have no end: give a number or a root")
    root = paths.data() / "cad" / f"{category}-{models}-seed{seed}-v{cad.VERSIONS[category]}"
    with locked(root):
        if not (root / "all.csv").is_file():  # the list of splits, written last
            cad.write_collection(root, [category], models, seed, progress, executor)
    return root


def photo_views(config: PhotoConfig, workers: int | None = None, progress: bool = True) -> ViewStore:
    """Open the photographs of `config` (section 4.3) as a view store, cutting them where that has not been done.

    Viewpoints are calibrated on split "val", the "train" of PASCAL3D+ and ImageNet3D, and scored on "test", their
    "val". Stores lie in `<paths.data()>/views/photos-<category>-<key>`; looking for one reads annotations, and images
    that may have changed.
    Raises ViewnetError for a root in no layout that can be read, settings that do not apply to it, a split without
    usable photographs, and one photograph in both.
    """
    known_category(config.category, own=config.root)
    crop = Crop(config.size, config.margin, config.square)
    made_by: dict[str, Any] = {"category": config.category, "crop": photo_store.describe_crop(crop)}
    data: photo_store.Photographs | None = None
    if config.root is None:
        made_by |= {"stand-in": photo_stand_in(config).describe(), "subset": config.subset, "keep": config.keep}
    else:
        root = Path(config.root)
        found = [reader.photographs for reader in READERS.values() if reader.photographs and reader.recognises(root)]
        if not found:
            expected = f"PASCAL3D+ 1.1, ImageNet3D, images/ with {LIST} or test_crop/ with a list"
            raise ViewnetError(f"{root}: no photographs that can be read: expected {expected}")
        data = found[0](config, root)
        made_by["photographs"] = photo_store.digest(data)
    folder = _store_folder(f"photos-{config.category}", made_by)

    def make() -> None:
        photographs = data or pascal3d.read_both_splits(config, written(photo_stand_in(config), workers, progress))
        photo_store.photo_store(photographs, folder, crop, made_by, workers, progress)

    return ViewStore.open(made_once(folder, make))


def shows_videos(root: Path, category: str) -> bool:
    """Whether a folder is one of videos, or of folders of frames, and not of CAD models.

    Raises ViewnetError for images that are not in folders.
    """
    if category_folder(root, category):
        return False
    layouts = (reader for key, reader in READERS.items() if reader.videos and key != "folder")
    places = list(root.iterdir())
    if any(reader.accepts(root) for reader in layouts) or any(map(is_video, places)):
        return True
    if any(path.is_dir() and any(map(is_image, path.iterdir())) for path in places):
        return True
    if any(map(is_image, places)):
        raise ViewnetError(f"{root}: images side by side: put the frames of each object in a folder of their own")
    return False


def photo_stand_in(config: PhotoConfig) -> StandIn:
    """The stand-in for PASCAL3D+ that `config` asks for."""
    return Pascal3DStandIn(config.category, config.subset, config.models, config.count, config.seed, config.backgrounds)


def written(stand_in: StandIn, workers: int | None = None, progress: bool = True) -> Path:
    """The folder of a stand-in, written if it is not there yet."""
    return filled_once(_stand_in_folder(stand_in), lambda temporary: stand_in.write(temporary, workers, progress))


def _stand_in_folder(stand_in: StandIn) -> Path:
    return paths.data() / stand_in.FOLDER / identity_of(stand_in.describe())[:12]


def video_views(config: VideoConfig, workers: int | None = None, progress: bool = True) -> ViewStore:
    """Open the videos of `config` (section 4.4) as a view store, cutting their objects out where that is not done.

    Viewpoints are known of Freiburg static cars and of Objectron; of a folder of videos they are not, so that training
    selects by reconstruction. Stores lie in `<paths.data()>/views/videos-<category>-<key>`; looking for one lists the
    frames' files, and reads annotations and images' headers. Raises ViewnetError for a root that cannot be read,
    missing weights of a network for masks, and where no clip to train on is left.
    """
    known_category(config.category, own=config.root)
    if config.count < 0:
        raise ViewnetError(f"count {config.count}: expected 1 or more frames a clip, or 0 for all")
    root = written(video_stand_in(config), workers, progress) if config.root is None else Path(config.root)
    folder, clips, rejected, cutting, made_by = _asked_of_videos(config, root)

    def make() -> None:
        clip_store.clip_store(clips, folder, root, cutting, rejected, workers, progress, made_by)

    return ViewStore.open(made_once(folder, make))


def _asked_of_videos(
    config: VideoConfig, root: Path
) -> tuple[Path, list[Clip], list[Rejected], clip_store.Cutting, dict[str, Any]]:
    """The folder of the views of videos in `root`, their clips, what cannot be used, how they are cut, and all that."""
    crop, source = Crop(config.size, config.margin, config.square), masks.mask_source(config.masks, config.category)
    cutting = clip_store.Cutting(source, crop, config.scale, config.side, config.blur)
    clips, rejected = _clips(config, root)
    # Stand-ins, as built-in models, are known by their files' sizes.
    made_by = cutting.describe(clips, None if config.root is None else root)
    return _store_folder(f"videos-{config.category}", made_by), clips, rejected, cutting, made_by


def _clips(config: VideoConfig, root: Path) -> tuple[list[Clip], list[Rejected]]:
    """The clips in `root` as the configuration wants them split and masked, and what cannot be used."""
    auto = config.kind == "auto"
    reader = next(r for r in READERS.values() if r.accepts(root)) if auto else READERS[config.kind]
    assert reader.videos is not None
    clips, rejected = reader.videos(config, root)
    if known(config.split_rule, ("45/2/rest", "all"), "split rule") == "all":
        clips = [replace(clip, split="train") for clip in clips]
    if config.mask_folder != VideoConfig.mask_folder:
        if config.masks != "files":
            raise ViewnetError(f"mask_folder {config.mask_folder}: only used with masks=files (not {config.masks})")
        # A clip's id is its place below the folder, whatever the data set.
        folder = root / paths.named(config.mask_folder, "mask_folder")
        clips = [replace(clip, masks=masks_in(folder, clip.id)) for clip in clips]
        if not any(clip.masks for clip in clips):
            first = folder / clips[0].id
            raise ViewnetError(f"mask_folder {config.mask_folder}: no masks of any video, such as {first}")
    return clips, rejected


def video_stand_in(config: VideoConfig) -> StandIn:
    """The stand-in for videos of `config`. ViewnetError for categories that neither data set has."""
    if config.category == freiburg.CATEGORY and config.kind in ("auto", "freiburg"):
        return FreiburgStandIn(config.sequences or SEQUENCES, config.frames, config.seed)
    if config.category in objectron.CLASSES and config.kind in ("auto", "objectron"):
        return ObjectronStandIn(config.category, config.videos, config.frames, config.seed)
    shown = f"{freiburg.CATEGORY} (Freiburg static cars) and {', '.join(objectron.CLASSES)} (Objectron)"
    raise ViewnetError(f"category {config.category}: stand-ins for videos show {shown}: name a root for others")


def _store_folder(name: str, made_by: dict[str, Any]) -> Path:
    return paths.data() / "views" / f"{name}-{identity_of(made_by)[:12]}"
