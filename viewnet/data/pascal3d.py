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
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy.io

from viewnet.config import CATEGORIES, known
from viewnet.errors import ViewnetError

SUBSETS = ("imagenet", "pascal")
SPLITS = ("train", "val")
EXTENSIONS = {"imagenet": ".JPEG", "pascal": ".jpg"}
KEEP = ("all", "easy", "first")
VOC = Path("PASCAL/VOCdevkit/VOC2012/ImageSets/Main")

Keep = Literal["all", "easy", "first"]


@dataclass(frozen=True)
class Annotation:
    """One object of one photograph.

    picture             the file
    number              which of the record's objects it is, from 0
    box                 x and y of the left upper and right lower corner, pixels from 0, as annotated
    azimuth, elevation  degrees: [0, 360), 0 the object's front, 90 its left side; [-90, 90]
    tilt                the camera's in-plane rotation, degrees (`theta`)
    coarse              whether no closer viewpoint than one of eight azimuths was annotated (its distance is then 0)
    """

    category: str
    subset: str
    split: str
    image: str
    number: int
    picture: Path
    box: tuple[float, float, float, float]
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
    """What was not used, (id, path, reason) each, and what was used though something was odd about it."""

    rejected: list[tuple[str, str, str]] = field(default_factory=list)
    mended: list[tuple[str, str]] = field(default_factory=list)

    @property
    def counts(self) -> dict[str, int]:
        """Reason -> how many objects or images."""
        return dict(Counter(reason.split(" (")[0] for _, _, reason in self.rejected))


def read(
    root: Path, category: str, subset: str, split: str, keep: Keep = "all", coarse: bool = False
) -> tuple[list[Annotation], Report]:
    """The objects of `category` in a subset's split, in the order of its list.

    `keep`: all objects; the easy ones; or the first of each image, as the released code has it. With `coarse`, objects
    whose viewpoint is only known to an eighth of a turn count too.

    Raises ViewnetError where `root` is not PASCAL3D+ or nothing can be used.
    """
    known(category, CATEGORIES, "category")
    known(subset, SUBSETS, "subset")
    known(split, SPLITS, "split")
    known(keep, KEEP, "filter")
    root, report = Path(root), Report()
    found: list[Annotation] = []
    for image in listed(root, category, subset, split):
        path = root / "Annotations" / f"{category}_{subset}" / f"{image}.mat"
        picture = root / "Images" / f"{category}_{subset}" / f"{image}{EXTENSIONS[subset]}"
        name = f"{subset}/{image}"
        if not picture.is_file():
            report.rejected.append((name, str(picture), "no such picture"))
            continue
        try:
            objects = _objects(path)
        except ViewnetError as error:
            report.rejected.append((name, str(path), str(error)))
            continue
        mine = [(number, item) for number, item in enumerate(objects) if getattr(item, "class", None) == category]
        if not mine:
            report.rejected.append((name, str(path), "no object of the category"))
        for number, item in mine[:1] if keep == "first" else mine:
            try:
                annotation = _annotation(item, category, subset, split, image, number, picture)
            except ViewnetError as error:
                report.rejected.append((f"{name}/{number}", str(path), str(error)))
                continue
            if annotation.coarse and not coarse:
                report.rejected.append((annotation.id, str(path), "only coarsely annotated"))
            elif keep != "easy" or annotation.easy:
                found.append(annotation)
    if not found:
        told = ", ".join(f"{count} {reason}" for reason, count in report.counts.items())
        raise ViewnetError(f"{root}: no usable {category} in {subset} {split} ({told or 'the list is empty'})")
    return found, report


def listed(root: Path, category: str, subset: str, split: str) -> list[str]:
    """The images of a split, in the order of its list; in PASCAL's lists those that show the category (1 or 0)."""
    if subset == "imagenet":
        path = root / "Image_sets" / f"{category}_imagenet_{split}.txt"
    else:
        path = root / VOC / f"{category}_{split}.txt"
    if not path.is_file():
        raise ViewnetError(f"{path}: no such list: expected the folder of PASCAL3D+ release 1.1")
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    if subset == "pascal":
        if bad := [" ".join(line) for line in lines if len(line) != 2 or line[1] not in ("-1", "0", "1")]:
            raise ViewnetError(f"{path}: line {bad[0]!r}: expected an image and -1, 0 or 1")
        lines = [line for line in lines if line[1] != "-1"]
    return list(dict.fromkeys(line[0] for line in lines))


def _objects(path: Path) -> list[Any]:
    if not path.is_file():
        raise ViewnetError("no such annotation")
    try:
        record = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)["record"]
        return list(np.atleast_1d(record.objects))
    except Exception as error:  # SciPy raises whatever a damaged file makes it stumble over.
        raise ViewnetError(f"annotation cannot be read ({type(error).__name__}: {error})") from None


def _annotation(
    item: Any, category: str, subset: str, split: str, image: str, number: int, picture: Path
) -> Annotation:
    viewpoint = getattr(item, "viewpoint", None)
    if viewpoint is None or not hasattr(viewpoint, "_fieldnames"):
        raise ViewnetError("object without a viewpoint")
    distance = _number(viewpoint, "distance", 0.0)
    coarse = distance == 0
    suffix = "_coarse" if coarse else ""
    azimuth, elevation = (_number(viewpoint, f"{name}{suffix}") for name in ("azimuth", "elevation"))
    if abs(elevation) > 90:
        raise ViewnetError(f"elevation beyond 90 degrees ({elevation:g})")
    box = np.asarray(getattr(item, "bbox", ()), dtype=np.float64).ravel()
    if box.shape != (4,) or not np.isfinite(box).all():
        raise ViewnetError("box is not four numbers")
    # The corners of two ImageNet boxes are exchanged; pixels are counted from 1.
    (x0, x1), (y0, y1) = sorted(box[[0, 2]] - 1), sorted(box[[1, 3]] - 1)
    flags = (bool(_number(item, name, 0.0)) for name in ("truncated", "occluded", "difficult"))
    tilt = 0.0 if coarse else _number(viewpoint, "theta", 0.0)
    return Annotation(
        category,
        subset,
        split,
        image,
        number,
        picture,
        (x0, y0, x1, y1),
        azimuth % 360,
        elevation,
        tilt,
        coarse,
        *flags,
    )


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


def subsets(root: Path) -> Iterator[tuple[str, str, str]]:
    """Every (category, subset, split) that has a list."""
    for category in CATEGORIES:
        for subset in SUBSETS:
            for split in SPLITS:
                try:
                    listed(Path(root), category, subset, split)
                except ViewnetError:
                    continue
                yield category, subset, split
