"""PASCAL3D+ 1.1: annotated photographs of twelve categories, read in the data set's own layout.

    Annotations/<category>_imagenet/<image>.mat        a `record` with its objects, boxes and viewpoints
    Annotations/<category>_pascal/<image>.mat
    Images/<category>_imagenet/<image>.JPEG
    Images/<category>_pascal/<image>.jpg
    Image_sets/<category>_imagenet_{train,val}.txt     one image a line
    PASCAL/VOCdevkit/VOC2012/ImageSets/Main/<category>_{train,val}.txt   image and -1, 0 or 1 a line

Nothing is left out silently: whatever is not used is listed with the reason.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from viewnet.config import CATEGORIES, known
from viewnet.data.crop import Box
from viewnet.data.readers import matlab
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files

SUBSETS = ("imagenet", "pascal")
BOTH = "both"
SPLITS = ("train", "val")
EXTENSIONS = {"imagenet": ".JPEG", "pascal": ".jpg"}
KEEP = ("all", "easy", "first")
LISTS = Path("Image_sets")
VOC = Path("PASCAL/VOCdevkit/VOC2012/ImageSets/Main")

Keep = Literal["all", "easy", "first"]

# These words are counted in a view store's description, and so are part of its identity: they may not change.
OTHER_SCALE = "box in another scale than its picture"
BEYOND_EDGES = "box beyond the picture's edges"

# What copies of the data set call their images.
_SUFFIXES = (".JPEG", ".jpg", ".jpeg", ".JPG", ".png", ".PNG")


@dataclass(frozen=True)
class Annotation:
    """One object of one photograph.

    image_path          the file
    number              which of the record's objects it is, from 0
    box                 its left, upper, right and lower edge, pixels from the image's left upper corner, within it
    azimuth, elevation  degrees: [0, 360), 0 the object's front, 90 its left side; [-90, 90]
    tilt                the camera's in-plane rotation, degrees (`theta`)
    coarse              whether no closer viewpoint than one of eight azimuths was annotated
    """

    category: str
    subset: str
    split: str
    image: str
    number: int
    image_path: Path
    box: Box
    azimuth: float
    elevation: float
    tilt: float
    coarse: bool
    truncated: bool
    occluded: bool
    difficult: bool

    @property
    def easy(self) -> bool:
        """Neither difficult nor truncated nor occluded."""
        return not (self.difficult or self.truncated or self.occluded)

    @property
    def id(self) -> str:
        """Names the object within the data set."""
        return f"{self.subset}/{self.image}/{self.number}"


@dataclass
class Report:
    """What became of all that a list names.

    rejected    (id, path within the data set, reason) of the objects and images that were not used
    mended      (id, what) of those that were used though something was odd about them
    others      objects of other categories in the same images, which were not asked for
    """

    rejected: list[tuple[str, str, str]] = field(default_factory=list)
    mended: list[tuple[str, str]] = field(default_factory=list)
    others: int = 0

    @property
    def counts(self) -> dict[str, int]:
        """Reason -> how many objects or images were not used for it."""
        return tally(reason for _, _, reason in self.rejected)


def tally(reasons: Iterable[str]) -> dict[str, int]:
    """Reason, without what stands in brackets behind it -> how often."""
    return dict(Counter(reason.split(" (")[0] for reason in reasons))


def read(
    root: Path, category: str, subset: str, split: str, keep: Keep = "all", coarse: bool = False
) -> tuple[list[Annotation], Report]:
    """The objects of `category` in the split of a subset ("imagenet", "pascal" or "both"), in the order of its list.

    `keep`: all objects; the easy ones; or the first of each image, as the released code has it. With `coarse`, objects
    whose viewpoint is only known to an eighth of a turn count too.

    Boxes with exchanged corners, beyond their image's edges or in another scale than their image are mended.
    Raises ViewnetError where `root` is not PASCAL3D+ or nothing can be used.
    """
    known(category, CATEGORIES, "category")
    known(split, SPLITS, "split")
    known(keep, KEEP, "filter")
    root, report = Path(root), Report()
    found: list[Annotation] = []
    for part in parts(subset):
        names = listed(root, category, part, split)
        report.mended += [(f"{part}/{name}", "listed twice") for name, times in Counter(names).items() if times > 1]
        for image in dict.fromkeys(names):
            found += _read_image(root, category, part, split, image, keep, coarse, report)
    if not found:
        told = ", ".join(f"{count} {reason}" for reason, count in report.counts.items())
        raise ViewnetError(f"{root}: no usable {category} in {subset} {split} ({told or 'the list is empty'})")
    return found, report


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
    try:
        lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise ViewnetError(f"{path}: cannot be read ({error}): expected a text file, one image a line") from None
    states = [["-1"], ["0"], ["1"]] if subset == "pascal" else []
    if bad := [" ".join(line) for line in lines if line[1:] not in [[], *states] or not _is_name(line[0])]:
        expected = "an image and -1, 0 or 1" if subset == "pascal" else "the name of one image"
        raise ViewnetError(f"{path}: line {bad[0][:60]!r}: expected {expected}")
    return [line[0] for line in lines if line[1:] != ["-1"]]


def _is_name(text: str) -> bool:
    """Whether a text names a file of a folder, and none elsewhere."""
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
    folder = Path(root) / "Images" / f"{category}_{subset}"
    usual = folder / f"{image}{EXTENSIONS[subset]}"
    others = (folder / f"{image}{suffix}" for suffix in _SUFFIXES)
    return usual if usual.is_file() else next((path for path in others if path.is_file()), usual)


def _read_image(
    root: Path, category: str, subset: str, split: str, image: str, keep: Keep, coarse: bool, report: Report
) -> list[Annotation]:
    """The objects of one image that are asked for and can be used; all else goes to the report."""
    path, image_path = annotation_file(root, category, subset, image), image_file(root, category, subset, image)
    name, where = f"{subset}/{image}", path.relative_to(root).as_posix()
    try:
        size = image_files.size(image_path)
    except ViewnetError as error:
        report.rejected.append((name, image_path.relative_to(root).as_posix(), str(error)))
        return []
    try:
        objects, annotated = _record(path)
    except ViewnetError as error:
        report.rejected.append((name, where, str(error)))
        return []
    mine = [(number, item) for number, item in enumerate(objects) if _class(item) == category]
    report.others += len(objects) - len(mine)
    if not mine:
        report.rejected.append((name, where, "no object of the category"))
    found = []
    for place, (number, item) in enumerate(mine):
        odd: list[str] = []
        try:
            if keep == "first" and place:
                raise ViewnetError("not the first of its image")
            box = _box(item, size, annotated, odd)
            annotation = _annotation(item, category, subset, split, image, number, image_path, box)
            if annotation.coarse and not coarse:
                raise ViewnetError("only coarsely annotated")
            if keep == "easy" and not annotation.easy:
                raise ViewnetError("truncated, occluded or difficult")
        except ViewnetError as error:
            report.rejected.append((f"{name}/{number}", where, str(error)))
            continue
        found.append(annotation)
        report.mended += [(annotation.id, what) for what in odd]
    return found


def _record(path: Path) -> tuple[list[Any], tuple[float, float] | None]:
    """The objects of a record, and the width and height of the image that was annotated where it has them."""
    if not path.is_file():
        raise ViewnetError("no such annotation")
    try:
        found = matlab.load(path)
    except ViewnetError as error:
        raise ViewnetError(f"annotation cannot be read ({error})") from None
    if "record" not in found:
        raise ViewnetError("annotation without a record")
    record = found["record"]
    if not hasattr(record, "objects"):
        raise ViewnetError("annotation without objects")
    # One object is a structure, several are an array of them, none is an empty array.
    objects = list(np.asarray(record.objects, dtype=object).ravel())
    try:
        width, height = (float(value) for value in np.asarray(record.imgsize).ravel()[:2])
    except (AttributeError, TypeError, ValueError):
        return objects, None
    return objects, (width, height) if width > 0 and height > 0 else None


def _class(item: Any) -> str:
    return str(getattr(item, "class", "")).strip()


def _box(item: Any, size: tuple[int, int], annotated: tuple[float, float] | None, odd: list[str]) -> Box:
    """The object's box as edges within its image; what had to be mended joins `odd`."""
    corners = np.asarray(getattr(item, "bbox", ()))
    if corners.size != 4 or corners.dtype.kind not in "fiu" or not np.isfinite(corners).all():
        raise ViewnetError("box is not four numbers")
    x0, y0, x1, y1 = (float(value) for value in corners.ravel())
    if x0 > x1 or y0 > y1:
        odd.append("box with exchanged corners")
        x0, x1, y0, y1 = *sorted((x0, x1)), *sorted((y0, y1))
    # Pixels are counted from 1, and the last one belongs to the box.
    edges = np.array([x0 - 1, y0 - 1, x1, y1])
    limits = np.array([*size, *size], dtype=np.float64)
    if annotated and annotated != size:
        scale = limits / [*annotated, *annotated]
        if abs(scale[0] / scale[1] - 1) < 0.02:
            edges = edges * scale
            odd.append(OTHER_SCALE)
    within = edges.clip(0, limits)
    if (within[2:] - within[:2] < 1).any():
        raise ViewnetError(f"box has no part in the image ({size[0]} x {size[1]})")
    if np.abs(within - edges).max() > 1:  # less is rounding
        odd.append(BEYOND_EDGES)
    left, upper, right, lower = within.tolist()
    return left, upper, right, lower


def _annotation(
    item: Any, category: str, subset: str, split: str, image: str, number: int, image_path: Path, box: Box
) -> Annotation:
    viewpoint = getattr(item, "viewpoint", None)
    if not hasattr(viewpoint, "_fieldnames"):
        raise ViewnetError("object without a viewpoint")
    coarse = _is_coarse(viewpoint)
    suffix = "_coarse" if coarse else ""
    azimuth, elevation = (_number(viewpoint, f"{name}{suffix}") for name in ("azimuth", "elevation"))
    if abs(elevation) > 90:
        raise ViewnetError(f"elevation beyond 90 degrees ({elevation:g})")
    tilt = 0.0 if coarse else _number(viewpoint, "theta", 0.0)
    flags = (bool(_number(item, name, 0.0)) for name in ("truncated", "occluded", "difficult"))
    # A tiny negative angle is 360 after rounding.
    turn = azimuth % 360 % 360
    return Annotation(category, subset, split, image, number, image_path, box, turn, elevation, tilt, coarse, *flags)


def _is_coarse(viewpoint: Any) -> bool:
    """Whether the closer viewpoint was never annotated: its fields are missing, or hold zeros, distance among them.

    A camera has some distance; where that alone is missing, a viewpoint of nothing but zeros is none.
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
