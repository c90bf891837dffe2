"""Crops of objects with a list of angles, as benchmarks of orientation publish them.

    <set>_meta.csv               img_idx, category_name, azi, ele and perhaps rot (degrees): one crop a row
    test_crop/<img_idx>.jpg      the crops, of any suffix; or <set>_data/test_crop/

Angles are taken to be this project's: azi 0 shows the front and 90 the object's left side, ele is above the horizon. So
they are in the rotations of Orient Anything V2's published evaluation, Rx(rot) Ry(ele) Rz(-azi) from the object's frame
(x front, z up) to one whose x points at the viewer, rot being the crop's own rotation. Whatever is not used is listed
with the reason.
"""

import math
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

from viewnet.config import CATEGORIES, PhotoConfig, known
from viewnet.data.photo_store import Photograph, Photographs
from viewnet.data.readers.reader import Contents, Reader, require_all
from viewnet.data.store import Rejected, in_words, rejecting
from viewnet.errors import ViewnetError
from viewnet.runtime.image_files import SUFFIXES
from viewnet.runtime.lists import one_form, read_list
from viewnet.runtime.splits import seeded_rank

LISTS, CROPS = "*_meta.csv", "test_crop"
NAMES = {
    "airplane": "aeroplane", "bike": "bicycle", "dining table": "diningtable", "motorcycle": "motorbike",
    "couch": "sofa", "tv": "tvmonitor", "tv monitor": "tvmonitor", "television": "tvmonitor",
}  # fmt: skip
"""Other names of categories, in small letters and with spaces."""
CALIBRATED = 0.2  # the share of a category's crops that viewpoints are calibrated on, as lists have no splits
SIDEWAYS = 45.0  # degrees of rotation in the image beyond which a crop is left out: a viewpoint has none


def read(root: Path, category: str) -> Photographs:
    """The crops of a category, a seeded fifth of them "val" (calibrated on) and the rest "test" (scored).

    Raises ViewnetError for another layout, a list without one of its columns, and one without the category.
    """
    usable, rejected, names = _read(Path(root))
    if known(category, CATEGORIES, "category") not in usable:
        shown = in_words(dict(names.most_common())) or "no rows"
        raise ViewnetError(f"{_list(Path(root))}: no crop of {category} that can be used (it has {shown})")
    return Photographs(Path(root), usable[category], rejected[category], upright=True)


def _read(root: Path) -> tuple[dict[str, list[Photograph]], dict[str, list[Rejected]], Counter[str]]:
    """The usable crops and what cannot be used by category, and how often the list has which of its own names."""
    file = _list(root)
    table = read_list(file, ("img_idx", "category_name", "azi", "ele"), ("azi", "ele", "rot").__contains__)
    images = defaultdict[str, list[Path]](list)
    for path in sorted(_folder(root, file).iterdir()):
        if path.suffix.lower() in SUFFIXES:
            images[one_form(path.stem)].append(path)
    usable, rejected = defaultdict[str, dict[str, Photograph]](dict), defaultdict[str, list[Rejected]](list)
    for line, row in zip(table.index, table.to_dict("records"), strict=True):
        name = row["img_idx"]
        category = _category(row["category_name"])
        with rejecting(rejected[category], name, f"{file.name}: line {line}"):
            if name in usable[category]:
                raise ViewnetError("crop listed twice")
            azimuth, elevation = _angles(row)
            if len(found := images[one_form(name)]) != 1:
                several = f"several images ({', '.join(path.name for path in found)})"
                raise ViewnetError(several if found else f"no such image (img_idx {name[:60]!r})")
            usable[category][name] = Photograph(name, category, "test", found[0], None, azimuth, elevation)
    split = {category: _split(list(crops.values())) for category, crops in usable.items() if crops}
    return split, rejected, Counter(table["category_name"])


def _split(crops: list[Photograph]) -> list[Photograph]:
    ranked = sorted(crops, key=lambda crop: seeded_rank(0, "split", crop.id))
    count = round(CALIBRATED * len(ranked))
    return [replace(crop, split="val") for crop in ranked[:count]] + ranked[count:]


def _category(name: str) -> str:
    """Ours, or "" where the project has none."""
    plain = " ".join(name.lower().replace("_", " ").replace("-", " ").split())
    ours = NAMES.get(plain, plain)
    return ours if ours in CATEGORIES else ""


def _angles(row: dict[Any, str]) -> tuple[float, float]:
    """Azimuth in [0, 360) and elevation."""
    values = {}
    for name in ("azi", "ele", "rot"):
        try:
            values[name] = float(row.get(name) or ("nan" if name in row else 0))
        except ValueError:
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise ViewnetError(f"angle is no number ({name} {row[name]!r})")
    if abs(values["ele"]) > 90:
        raise ViewnetError(f"elevation beyond 90 degrees (ele {values['ele']:g})")
    if abs((values["rot"] + 180) % 360 - 180) > SIDEWAYS:
        raise ViewnetError(f"object lies on its side in the image (rot {values['rot']:g})")
    return values["azi"] % 360 % 360, values["ele"]


def _list(root: Path) -> Path:
    files = sorted(root.glob(LISTS))
    if len(files) != 1:
        shown = ", ".join(path.name for path in files) or "none"
        raise ViewnetError(f"{root}: expected one list {LISTS} (there is {shown})")
    return files[0]


def _folder(root: Path, file: Path) -> Path:
    """The folder of the crops that a list is beside."""
    nested = root / f"{file.name.removesuffix(LISTS[1:])}_data" / CROPS
    return nested if nested.is_dir() else root / CROPS


def _recognises(root: Path) -> bool:
    return any(_folder(root, file).is_dir() for file in root.glob(LISTS))


def _read_all(config: PhotoConfig, root: Path) -> Photographs:
    require_all(config, root)
    return read(root, config.category)


def _count(root: Path, contents: Contents) -> None:
    usable, rejected, names = _read(root)
    for category in CATEGORIES:
        if category in usable | rejected:
            found = [("objects", crop) for crop in usable.get(category, [])]
            contents.add_photographs(category, found, True, rejected[category])
    unknown = {name: count for name, count in names.items() if not _category(name)}
    if unknown:
        contents.problems.append(f"left out, of other categories: {in_words(unknown)}")


READER = Reader(recognises=_recognises, count=_count, photographs=_read_all)
