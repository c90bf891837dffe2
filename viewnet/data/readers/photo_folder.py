"""A folder of photographs with a list of their viewpoints.

images/            the photographs
viewpoints.csv     file, azimuth_deg, elevation_deg, split and perhaps x0, y0, x1, y1: one object a row
"""

import logging
import re
from collections import Counter
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from viewnet.config import CATEGORIES, SYNSETS, PhotoConfig, known_category
from viewnet.data.photo_store import SPLITS, Photograph, Photographs
from viewnet.data.readers.crop_list import NAMES
from viewnet.data.readers.reader import Contents, Reader, require_all
from viewnet.data.store import in_words
from viewnet.errors import ViewnetError
from viewnet.runtime.lists import one_form, read_list

log = logging.getLogger(__name__)

LIST = "viewpoints.csv"
_ANGLES = ("azimuth_deg", "elevation_deg")
_CORNERS = ("x0", "y0", "x1", "y1")


def read(root: Path, category: str) -> list[Photograph]:
    """The photographs in `<root>/images` that `<root>/viewpoints.csv` lists.

    Columns: file, azimuth_deg, elevation_deg, split (val: viewpoints are calibrated on it; test: scored), and x0, y0,
    x1, y1, the edges of the object's box in pixels from the upright image's left upper corner, unless an image
    shows just the object. All other columns are ignored. A file may have several rows, one for each object.

    Raises ViewnetError for a missing list, column or value, naming the line.
    """
    known_category(category)
    path = Path(root) / LIST
    table = read_list(path, ("file", *_ANGLES, "split"), (*_ANGLES, *_CORNERS).__contains__)
    corners = [name for name in _CORNERS if name in table.columns]
    if 0 < len(corners) < len(_CORNERS):
        raise ViewnetError(f"{path}: only {', '.join(corners)} of a box: expected {', '.join(_CORNERS)}, or none")
    if table.empty:
        raise ViewnetError(f"{path}: lists no photograph")
    photographs: list[Photograph] = []
    times = Counter[Path]()
    there: dict[str, Path] = {}
    for number, row in zip(table.index, table.to_dict("records"), strict=True):
        where = f"{path}: line {number}"
        file, split = row["file"].replace("\\", "/"), row["split"]
        if not file or PurePath(file).is_absolute() or ".." in PurePath(file).parts:
            raise ViewnetError(f"{where}: file {file!r}: expected the name of an image in images/")
        if split not in SPLITS:
            raise ViewnetError(f"{where}: split {split!r}: expected val (calibrated on) or test (scored)")
        azimuth, elevation = (_value(row, name, where) for name in _ANGLES)
        if abs(elevation) > 90:
            raise ViewnetError(f"{where}: elevation_deg {elevation:g}: expected -90 to 90")
        box = None
        if corners and not all(row[name].lower() in ("", "nan", "na") for name in _CORNERS):
            x0, y0, x1, y1 = (_value(row, name, where) for name in _CORNERS)
            box = (x0, y0, x1, y1)
        image = _image(Path(root) / "images", file, there)
        name = f"{file}/{times[image]}" if times[image] else file
        times[image] += 1
        photographs.append(Photograph(name, category, split, image, box, azimuth % 360, elevation))
    return photographs


def _image(folder: Path, file: str, there: dict[str, Path]) -> Path:
    """The image that a list means, by its name in the folder or with the folder's, in any form of Unicode.

    `there` is filled where it is needed: the folder's images by the one form of their names.
    """
    names = (file, file.removeprefix("images/"))
    if found := next((folder / name for name in names if (folder / name).is_file()), None):
        return found
    if not there:
        there |= {one_form(path.relative_to(folder).as_posix()): path for path in folder.rglob("*")}
    return next((there[one_form(name)] for name in names if one_form(name) in there), folder / file)


def _value(row: dict[Any, Any], name: str, where: str) -> float:
    try:
        value = float(row[name])
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ViewnetError(f"{where}: {name} {row[name]!r}: expected a number")
    return value


def named(text: str) -> set[str]:
    """The categories that a name mentions, in words or as a synset id. "train" is none: it names a split.

    >>> sorted(named("dining_tables/n02958343_12.jpg")), named("train/0001.jpg")
    (['car', 'diningtable'], set())
    """
    words = re.findall("[a-z]+", text.lower())
    words += [" ".join(pair) for pair in pairwise(words)]
    singular = {word.removesuffix(end) for word in words for end in ("", "s", "es")}
    ours = {NAMES.get(word, word) for word in singular}.intersection(CATEGORIES) - {"train"}
    return ours | {category for category, synset in SYNSETS.items() if synset in text}


def _tell_of_others(root: Path, category: str) -> None:
    """Warn of photographs that are of another category by their row, or else by the names of file and folder."""
    rows, others = read_list(root / LIST, ("file",)).to_dict("records"), Counter[str]()
    for row in rows:
        said = next((row[name] for name in ("category", "category_name", "class") if row.get(name)), "")
        kinds = (named(said) or {said.lower()}) if said else named(row["file"]) or named(root.resolve().name)
        others.update(() if category in kinds else sorted(kinds)[:1])
    if others:
        text = "%s: %d of %d photographs are not of %s by list or names (%s): they are used all the same"
        log.warning(text, root, others.total(), len(rows), category, in_words(others))


def _read_all(config: PhotoConfig, root: Path) -> Photographs:
    require_all(config, root)
    found = Photographs(root, read(root, config.category), upright=True)
    _tell_of_others(root, config.category)
    return found


def _count(root: Path, contents: Contents) -> None:
    # The list does not name the objects' category, and any will do here.
    photographs = read(root, CATEGORIES[0])
    found = [("objects", photo) for photo in photographs if photo.image_path.is_file()]
    missing = [(photo.id, LIST, "no such image") for photo in photographs if not photo.image_path.is_file()]
    contents.add_photographs("", found, True, missing)
    if not any(photograph.split == "test" for photograph in photographs):
        contents.problems.append(f"{LIST}: no row of split test")


READER = Reader(recognises=lambda folder: (folder / LIST).is_file(), count=_count, photographs=_read_all)
