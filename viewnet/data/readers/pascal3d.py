"""PASCAL3D+ 1.1: annotated photographs of twelve categories, read in the data set's own layout.

    Annotations/<category>_imagenet/<image>.mat        a `record` with its objects, boxes and viewpoints
    Annotations/<category>_pascal/<image>.mat
    Images/<category>_imagenet/<image>.JPEG
    Images/<category>_pascal/<image>.jpg
    Image_sets/<category>_imagenet_{train,val}.txt     one image a line
    PASCAL/VOCdevkit/VOC2012/ImageSets/Main/<category>_{train,val}.txt   image and -1, 0 or 1 a line

Whatever is not used is listed with the reason.
"""

import itertools
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from viewnet.config import CATEGORIES, PhotoConfig, known
from viewnet.data.crop import Box, clipped
from viewnet.data.photo_store import Photograph, Photographs
from viewnet.data.readers import matlab
from viewnet.data.readers.reader import Contents, Reader, no_usable, read_text
from viewnet.data.store import Rejected, rejecting, tally, within
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files

SUBSETS = ("imagenet", "pascal")
BOTH = "both"
SPLITS = ("train", "val")
USES = {"train": "val", "val": "test"}
"""A split's name here -> there: what viewpoints are calibrated on, and what is scored."""
EXTENSIONS = {"imagenet": ".JPEG", "pascal": ".jpg"}
KEEP = ("all", "easy", "first")
LISTS = Path("Image_sets")
VOC = Path("PASCAL/VOCdevkit/VOC2012/ImageSets/Main")

# These words are counted in a view store's description, and so are part of its identity: they may not change.
OTHER_SCALE = "box in another scale than its picture"
BEYOND_EDGES = "box beyond the picture's edges"

# Suffixes of images in copies of the data set.
_SUFFIXES = (".JPEG", ".jpg", ".jpeg", ".JPG", ".png", ".PNG")


@dataclass
class Report:
    """The entries of a list that are not among the annotations as they are."""

    rejected: list[Rejected] = field(default_factory=list)  # objects and images that cannot be used
    mended: list[tuple[str, str]] = field(default_factory=list)  # (id, what) of those that are used after a correction
    others: int = 0  # objects of other categories in the same images


def read(root: Path, category: str, subset: str, split: str, keep: str = "all") -> tuple[list[Photograph], Report]:
    """The objects of `category` in the split of a subset ("imagenet", "pascal" or "both"), in the order of its list.

    `keep`: all objects; the easy ones; or the first of each image, as the released code has it. Objects whose viewpoint
    is only known to an eighth of a turn are left out. An id is subset, image and which of the record's objects it is.

    Boxes with exchanged corners, beyond their image's edges or in another scale than their image are mended.
    Raises ViewnetError where `root` is not PASCAL3D+ or nothing can be used.
    """
    known(category, CATEGORIES, "category")
    known(split, SPLITS, "split")
    known(keep, KEEP, "filter")
    root, report = Path(root), Report()
    photographs: list[Photograph] = []
    for part in parts(subset):
        names = listed(root, category, part, split)
        report.mended += [(f"{part}/{name}", "listed twice") for name, times in Counter(names).items() if times > 1]
        for image in dict.fromkeys(names):
            photographs += _read_image(root, category, part, split, image, keep, report)
    if not photographs:
        raise no_usable(root, f"{category} in {subset} {split}", report.rejected, "the list is empty")
    return photographs, report


def parts(subset: str) -> tuple[str, ...]:
    """The subsets that a name stands for: itself, or all for "both"."""
    return SUBSETS if known(subset, (*SUBSETS, BOTH), "subset") == BOTH else (subset,)


def listed(root: Path, category: str, subset: str, split: str) -> list[str]:
    """The images of a split, in the order of its list; in PASCAL's lists those that show the category (1 or 0).

    Raises ViewnetError for a list that is missing or malformed.
    """
    path = list_file(root, category, subset, split)
    if not path.is_file():
        raise ViewnetError(f"{path}: no such list: expected the folder of PASCAL3D+ release 1.1")
    return names_in(path, states=subset == "pascal")


def names_in(path: Path, states: bool = False) -> list[str]:
    """The images of a list, one a line; with `states` -1, 0 or 1 follows, and those of -1 are left out.

    Raises ViewnetError for a malformed line.
    """
    text = read_text(path, "a text file, one image a line")
    lines = [line.split() for line in text.splitlines() if line.strip()]
    others = [["-1"], ["0"], ["1"]] if states else []
    if bad := [" ".join(line) for line in lines if line[1:] not in [[], *others] or not _is_name(line[0])]:
        expected = "an image and -1, 0 or 1" if states else "the name of one image"
        raise ViewnetError(f"{path}: line {bad[0][:60]!r}: expected {expected}")
    return [line[0] for line in lines if line[1:] != ["-1"]]


def _is_name(text: str) -> bool:
    """Whether a text is the name of a file, without a folder."""
    return len(text) <= 200 and text.isprintable() and not set(text) & set("/\\") and text not in (".", "..")


def list_file(root: Path, category: str, subset: str, split: str) -> Path:
    """Where the list of a split lies: PASCAL's with its development kit, unless it is beside ImageNet's."""
    path = Path(root) / LISTS / f"{category}_{subset}_{split}.txt"
    return Path(root) / VOC / f"{category}_{split}.txt" if subset == "pascal" and not path.is_file() else path


def annotation_file(root: Path, category: str, subset: str, image: str) -> Path:
    """Where the record of an image lies."""
    return Path(root) / "Annotations" / f"{category}_{subset}" / f"{image}.mat"


def image_file(root: Path, category: str, subset: str, image: str) -> Path:
    """Where an image lies, or would in the release."""
    return with_suffix(Path(root) / "Images" / f"{category}_{subset}" / f"{image}{EXTENSIONS[subset]}")


def with_suffix(usual: Path) -> Path:
    """An image by the name in the release, or where it is missing, the one with another suffix in its place."""
    others = (usual.with_name(f"{usual.name.removesuffix(usual.suffix)}{suffix}") for suffix in _SUFFIXES)
    return usual if usual.is_file() else next((path for path in others if path.is_file()), usual)


def _read_image(
    root: Path, category: str, subset: str, split: str, image: str, keep: str, report: Report
) -> list[Photograph]:
    """The objects of one image that are requested and can be used; all others go to the report."""
    path, image_path = (locate(root, category, subset, image) for locate in (annotation_file, image_file))
    name, where = f"{subset}/{image}", within(image_path, root)
    try:
        size = image_files.size(image_path, upright=False)
        where = within(path, root)
        objects, annotated = _record(path)
    except ViewnetError as error:
        report.rejected.append((name, where, str(error)))
        return []
    mine = [(n, item) for n, item in enumerate(objects) if str(getattr(item, "class", "")).strip() == category]
    report.others += len(objects) - len(mine)
    if not mine:
        report.rejected.append((name, where, "no object of the category"))
    photographs = []
    for place, (number, item) in enumerate(mine):
        corrections: list[str] = []
        with rejecting(report.rejected, f"{name}/{number}", where):
            if keep == "first" and place:
                raise ViewnetError("not the first of its image")
            # Pixels are counted from 1, and the last one belongs to the box.
            box = mended_box(getattr(item, "bbox", ()), 1, size, annotated, corrections)
            azimuth, elevation = _viewpoint(item)
            hard = [_number(item, flag, 0.0) for flag in ("truncated", "occluded", "difficult")]
            if keep == "easy" and any(hard):
                raise ViewnetError("truncated, occluded or difficult")
            photographs.append(Photograph(f"{name}/{number}", category, split, image_path, box, azimuth, elevation))
            report.mended += [(f"{name}/{number}", what) for what in corrections]
    return photographs


def _record(path: Path) -> tuple[list[Any], tuple[float, float] | None]:
    """The objects of a record, and where it has them the width and height of the annotated image."""
    if not path.is_file():
        raise ViewnetError("no such annotation")
    try:
        record = matlab.load(path).get("record")
    except ViewnetError as error:
        raise ViewnetError(f"annotation cannot be read ({error})") from None
    if record is None:
        raise ViewnetError("annotation without a record")
    if not hasattr(record, "objects"):
        raise ViewnetError("annotation without objects")
    # One object is a structure, several are an array of them, none is an empty array.
    objects = list(np.asarray(record.objects, dtype=object).ravel())
    try:
        width, height = (float(value) for value in np.asarray(record.imgsize).ravel()[:2])
    except (AttributeError, TypeError, ValueError):
        return objects, None
    return objects, (width, height) if min(width, height) >= 1 else None


def mended_box(
    box: Any, first: int, size: tuple[int, int], annotated: tuple[float, float] | None, corrections: list[str]
) -> Box:
    """The edges within an image of an annotated box, an array; what had to be corrected joins `corrections`.

    `first` is the number of the first pixel, `annotated` the size of the image that the box is of.
    Raises ViewnetError for a box that is not four numbers, or has no part in the image.
    """
    array = np.asarray(box)
    corners = array.ravel().astype(np.float64) if array.dtype.kind in "fiu" else np.zeros(0)
    if len(corners) != 4 or not (np.abs(corners) < 1e9).all():  # no NaN either
        raise ViewnetError("box is not four numbers")
    x0, y0, x1, y1 = corners.tolist()
    if x0 > x1 or y0 > y1:
        corrections.append("box with exchanged corners")
        x0, x1, y0, y1 = *sorted((x0, x1)), *sorted((y0, y1))
    edges = np.array([x0 - first, y0 - first, x1, y1])
    limits = np.array([*size, *size], dtype=np.float64)
    if annotated and annotated != size:
        scale = limits / [*annotated, *annotated]
        if abs(scale[0] / scale[1] - 1) < 0.02:
            edges = edges * scale
            corrections.append(OTHER_SCALE)
    left, upper, right, lower = edges.tolist()
    box = clipped((left, upper, right, lower), size)
    if np.abs(box - edges).max() > 1:  # less is rounding
        corrections.append(BEYOND_EDGES)
    return box


def _viewpoint(item: Any) -> tuple[float, float]:
    """Azimuth and elevation of an object."""
    viewpoint = getattr(item, "viewpoint", None)
    if not hasattr(viewpoint, "_fieldnames"):
        raise ViewnetError("object without a viewpoint")
    if _is_coarse(viewpoint):
        raise ViewnetError("only coarsely annotated")
    azimuth, elevation = (_number(viewpoint, name) for name in ("azimuth", "elevation"))
    if abs(elevation) > 90:
        raise ViewnetError(f"elevation beyond 90 degrees ({elevation:g})")
    return azimuth % 360 % 360, elevation  # a tiny negative angle is 360 after rounding


def _is_coarse(viewpoint: Any) -> bool:
    """Whether the closer viewpoint was never annotated: its fields are missing, or its distance is zero.

    Without a distance, a viewpoint of zeros counts as missing.
    """
    if any(np.size(getattr(viewpoint, name, ())) == 0 for name in ("azimuth", "elevation")):
        return True
    names = ("distance",) if np.size(getattr(viewpoint, "distance", ())) else ("azimuth", "elevation", "theta")
    return all(_number(viewpoint, name, 0.0) == 0 for name in names)


def _number(item: Any, name: str, default: float | None = None) -> float:
    """A field that holds one finite number; `default` where it is missing or empty."""
    value = np.asarray(getattr(item, name, ()))
    if value.size == 0:
        if default is None:
            raise ViewnetError(f"field {name!r} is missing")
        return default
    try:
        number = float(value.ravel()[0])
    except (TypeError, ValueError):
        raise ViewnetError(f"field {name!r} is no number") from None
    if not np.isfinite(number):
        raise ViewnetError(f"field {name!r} is no finite number")
    return number


def read_both_splits(config: PhotoConfig, root: Path) -> Photographs:
    """What a configuration asks for."""
    return both_splits(root, lambda split: read(root, config.category, config.subset, split, config.keep))


def both_splits(root: Path, read_split: Callable[[str], tuple[list[Photograph], Report]]) -> Photographs:
    """Viewpoints are calibrated on a data set's "train" and scored on its "val"."""
    parts = {use: read_split(split) for split, use in USES.items()}
    usable = [replace(photograph, split=use) for use, (photographs, _) in parts.items() for photograph in photographs]
    reports = [report for _, report in parts.values()]
    mended = tally(what for report in reports for _, what in report.mended)
    notes = {"mended": mended, "objects of other categories": sum(report.others for report in reports)}
    return Photographs(root, usable, [each for report in reports for each in report.rejected], notes)


def _count(root: Path, contents: Contents) -> None:
    for category in CATEGORIES:
        files = {subset: [list_file(root, category, subset, split) for split in SPLITS] for subset in SUBSETS}
        there = [subset for subset in SUBSETS if any(file.is_file() for file in files[subset])]
        found: list[tuple[str, Photograph]] = []
        rejected: list[Rejected] = []
        for subset, (split, use) in itertools.product(there, USES.items()):
            with contents.error_is_problem():
                photographs, report = read(root, category, subset, split)
                found += [(f"{subset} objects", replace(photo, split=use)) for photo in photographs]
                rejected += report.rejected
        if there:
            contents.add_photographs(category, found, False, rejected)
    if not contents.counts:
        contents.problems.append(f"{root / LISTS}: no list of any category: expected PASCAL3D+ release 1.1")


READER = Reader(recognises=lambda folder: (folder / "Annotations").is_dir(), count=_count, photographs=read_both_splits)
