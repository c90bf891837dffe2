"""ImageNet3D: annotated photographs of 200 categories, read in the data set's own layout.

    annotations/<category>/<image>.npz           `annotations`, a dictionary for each object
    images/<category>/<image>.JPEG
    lists/<category>_imagenet_{train,val}.txt    one image a line

Viewpoints are those of PASCAL3D+'s camera, in radians from 0 to 2 pi. Categories are PASCAL3D+'s twelve; the others are
not read. Boxes are taken as edges in pixels. Whatever is not used is listed with the reason. https://arxiv.org/abs/2406.09613
"""

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from viewnet.config import CATEGORIES, PhotoConfig, known
from viewnet.data.photo_store import Photograph, Photographs
from viewnet.data.readers import object_arrays, pascal3d
from viewnet.data.readers.pascal3d import SPLITS, Report
from viewnet.data.readers.reader import Contents, Reader, no_usable
from viewnet.data.store import Rejected, rejecting, within
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files

LISTS, ANNOTATIONS, IMAGES = "lists", "annotations", "images"
STATES = ("status_good", "status_partially", "status_barely", "status_bad")
"""How much of an object is seen: most of it, not a small part, a small part, too little to tell its pose."""

_LIST = "_imagenet_"


def read(root: Path, category: str, split: str, keep: str = "all") -> tuple[list[Photograph], Report]:
    """The objects of `category` in a split, in the order of its list.

    `keep`: all objects; the easy ones, which are "status_good"; or the first of each image. As in the authors' code,
    objects are left out that are "status_bad" or without a status, or whose distance is not above 0. An id is image and
    which of its objects it is. Boxes are mended as PASCAL3D+'s are.
    Raises ViewnetError where `root` is not ImageNet3D or nothing can be used.
    """
    known(category, CATEGORIES, "category")
    known(keep, pascal3d.KEEP, "filter")
    root, report = Path(root), Report()
    photographs: list[Photograph] = []
    names = listed(root, category, split)
    report.mended += [(name, "listed twice") for name, times in Counter(names).items() if times > 1]
    for image in dict.fromkeys(names):
        photographs += _read_image(root, category, split, image, keep, report)
    if not photographs:
        raise no_usable(root, f"{category} in {split}", report.rejected, "the list is empty")
    return photographs, report


def list_file(root: Path, category: str, split: str) -> Path:
    """Where the list of a split lies."""
    return Path(root) / LISTS / f"{category}{_LIST}{known(split, SPLITS, 'split')}.txt"


def listed(root: Path, category: str, split: str) -> list[str]:
    """The images of a split, in the order of its list. ViewnetError for a list that is missing or malformed."""
    path = list_file(root, category, split)
    if not path.is_file():
        raise ViewnetError(f"{path}: no such list: expected the folder of ImageNet3D")
    return pascal3d.names_in(path)


def annotation_file(root: Path, category: str, image: str) -> Path:
    """Where the annotations of an image lie."""
    return Path(root) / ANNOTATIONS / category / f"{image}.npz"


def image_file(root: Path, category: str, image: str) -> Path:
    """Where an image lies, or would in the release."""
    return pascal3d.with_suffix(Path(root) / IMAGES / category / f"{image}.JPEG")


def _read_image(root: Path, category: str, split: str, image: str, keep: str, report: Report) -> list[Photograph]:
    """The objects of one image that are requested and can be used; all others go to the report."""
    path, image_path = (locate(root, category, image) for locate in (annotation_file, image_file))
    where = within(image_path, root)
    try:
        size = image_files.size(image_path, upright=False)
        where = within(path, root)
        objects = _objects(path)
    except ViewnetError as error:
        report.rejected.append((image, where, str(error)))
        return []
    mine = [(n, item) for n, item in enumerate(objects) if item.get("class", category) == category]
    report.others += len(objects) - len(mine)
    if not mine:
        report.rejected.append((image, where, "no object of the category"))
    photographs = []
    for place, (number, item) in enumerate(mine):
        name, corrections = f"{image}/{number}", list[str]()
        with rejecting(report.rejected, name, where):
            if keep == "first" and place:
                raise ViewnetError("not the first of its image")
            _check_status(item, keep)
            azimuth, elevation = _viewpoint(item)
            corners = _field(item, "bbox")
            array = corners if isinstance(corners, np.ndarray) else ()
            box = pascal3d.mended_box(array, 0, size, _size(item), corrections)
            photographs.append(Photograph(name, category, split, image_path, box, azimuth, elevation))
            report.mended += [(name, what) for what in corrections]
    return photographs


def _objects(path: Path) -> list[dict[str, Any]]:
    """The annotated objects of an image."""
    if not path.is_file():
        raise ViewnetError("no such annotation")
    try:
        objects = object_arrays.load(path, "annotations")
    except ViewnetError as error:
        raise ViewnetError(f"annotation cannot be read ({error})") from None
    if not objects or not all(isinstance(item, dict) for item in objects):
        raise ViewnetError("annotation without objects")
    return objects


def _check_status(item: dict[str, Any], keep: str) -> None:
    """Raise where an object is not usable, or requested, by what is seen of it."""
    status = item.get("object_status")
    if status is None:
        raise ViewnetError("object without a status")
    if not isinstance(status, str) or status not in STATES:
        raise ViewnetError("object_status is unknown")
    if status == "status_bad":
        raise ViewnetError("status_bad")
    if keep == "easy" and status != "status_good":
        raise ViewnetError("truncated, occluded or difficult")


def _viewpoint(item: dict[str, Any]) -> tuple[float, float]:
    """Azimuth in [0, 360) and elevation of an object, degrees."""
    if _number(item, "distance") <= 0:
        raise ViewnetError("distance of 0 or less")
    angles = {name: _number(item, name) for name in ("azimuth", "elevation")}
    if beyond := [name for name, angle in angles.items() if abs(angle) > 2 * math.pi + 1e-6]:
        raise ViewnetError(f"{beyond[0]} beyond 2 pi radians ({angles[beyond[0]]:g})")
    azimuth, elevation = map(math.degrees, angles.values())
    elevation = (elevation + 180) % 360 - 180  # 350 means -10
    if abs(elevation) > 90:
        raise ViewnetError(f"elevation beyond 90 degrees ({elevation:g})")
    return azimuth % 360 % 360, elevation  # a tiny negative angle is 360 after rounding


def _size(item: dict[str, Any]) -> tuple[float, float] | None:
    """Width and height of the image that an object was annotated in, where it has them."""
    if not {"width", "height"} <= item.keys():
        return None
    width, height = _number(item, "width"), _number(item, "height")
    return (width, height) if min(width, height) >= 1 else None


def _number(item: dict[str, Any], name: str) -> float:
    """A field that holds one finite number."""
    if name not in item:
        raise ViewnetError(f"field {name!r} is missing")
    value = _field(item, name)
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ViewnetError(f"field {name!r} is no number")
    if not abs(value) < 1e300:  # neither NaN nor infinite, nor a whole number that no float holds
        raise ViewnetError(f"field {name!r} is no finite number")
    return float(value)


def _field(item: dict[str, Any], name: str) -> Any:
    """A field's value, arrays of numbers as NumPy's."""
    value = item.get(name)
    return value.values if isinstance(value, object_arrays.Array) else value


def _read_both_splits(config: PhotoConfig, root: Path) -> Photographs:
    if config.subset != "imagenet":
        raise ViewnetError(f"{root}: subset {config.subset!r}: ImageNet3D has images of ImageNet alone: leave it out")
    return pascal3d.both_splits(root, lambda split: read(root, config.category, split, config.keep))


def _count(root: Path, contents: Contents) -> None:
    there = {path.name.rpartition(_LIST)[0] for path in (root / LISTS).glob(f"*{_LIST}*.txt")}
    for category in CATEGORIES:
        if category not in there:
            continue
        found: list[tuple[str, Photograph]] = []
        rejected: list[Rejected] = []
        for split, use in pascal3d.USES.items():
            with contents.error_is_problem():
                photographs, report = read(root, category, split)
                found += [("objects", replace(photo, split=use)) for photo in photographs]
                rejected += report.rejected
        contents.add_photographs(category, found, False, rejected)
    if others := there - set(CATEGORIES):
        contents.notes.append(f"{len(others)} categories that are not read: {', '.join(sorted(others)[:3])} ...")


READER = Reader(
    recognises=lambda folder: (folder / ANNOTATIONS).is_dir() and any((folder / LISTS).glob(f"*{_LIST}*.txt")),
    count=_count,
    photographs=_read_both_splits,
)
