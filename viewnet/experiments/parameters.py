"""The parameters of notebooks in one table: defaults, checks, meanings, and their part of the output folder's name.

Values arrive plain, as papermill and the command line give them: names, whole numbers, "car,chair" or lists.
"""

import contextlib
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewnet import paths
from viewnet.config import CATEGORIES, known
from viewnet.data.readers import objectron
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, features
from viewnet.model import checkpoint
from viewnet.recipes import PEERS, PROFILES, RECIPES, VARIANTS
from viewnet.tables.layouts import LAYOUTS

SHAPENET = "shapenet"
"""The value of `start` for which ViewNet is first trained on CAD models of the category, with the same seed."""
SUBSETS = ("imagenet", "pascal", "both")
"""Of PASCAL3D+."""
MOST_SEEDS = 1000


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    default  the plain value where none is given; its type is the one that a notebook declares
    check    (plain value, name) -> the value that a Request holds; ViewnetError naming the parameter and valid values
    help     its meaning, in a line
    label    format of its part of the output folder's name, where the value is not the notebook's usual one; "": none
    text     what `label` formats, of a checked value
    field    the field of Request that it fills, where that is named differently
    plain    whether it is text and nothing else; the check of another one is given values of any type
    """

    default: Any
    check: Callable[[Any, str], Any]
    help: str
    label: str = ""
    text: Callable[[Any], Any] = lambda value: value
    field: str = ""
    plain: bool = True

    def of(self, value: Any, name: str) -> Any:
        """The checked value of the parameter `name`. ViewnetError naming it and what is expected.

        Papermill's -p takes digits, None and true for what they look like, not for text.
        """
        if self.plain and not isinstance(value, str):
            raise ViewnetError(f"{name} {value!r}: expected text ({self.help}); papermill -r takes values for text")
        return self.check(value, name)


def folder_named(value: str, what: str) -> str | None:
    """The full path of a folder, None for "". Raises ViewnetError where there is none."""
    if value and not (folder := paths.named(value, what).resolve()).is_dir():
        raise ViewnetError(f"{what} {value}: no such folder")
    return str(folder) if value else None


def _is_whole(value: Any, least: int = 0) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _whole(value: Any, what: str, expected: str = "", least: int = 0) -> int:
    """A whole number from `least`, or 0, also as text."""
    with contextlib.suppress(ValueError):  # text without digits
        number = int(value) if isinstance(value, str) else value
        if _is_whole(number) and not 0 < number < least:
            return int(number)
    raise ViewnetError(f"{what} {value!r}: expected a whole number{expected}")


def _categories(value: Any, what: str) -> tuple[str, ...]:
    names = value.split(",") if isinstance(value, str) else value
    if not isinstance(names, (list, tuple)) or not all(isinstance(n, str) and n.strip() for n in names) or not names:
        raise ViewnetError(f"{what} {value!r}: expected names such as car or car,chair")
    if value == "everything":
        return CATEGORIES
    names = tuple(known(name.strip(), CATEGORIES, "category") for name in names)
    if len(set(names)) < len(names):
        raise ViewnetError(f"{what} {value!r}: a name is there twice")
    return names


def _seeds(value: Any, what: str) -> tuple[int, ...]:
    """Seeds from a count, a list, or text of either."""
    problem = ViewnetError(f"{what} {value!r}: expected how many (3) or which (0,2), whole numbers of 0 or more")
    if isinstance(value, str):
        try:
            numbers = [int(part) for part in value.split(",")]
        except ValueError:
            raise problem from None
        value = numbers if "," in value else numbers[0]
    if _is_whole(value, 1) and value <= MOST_SEEDS:
        return tuple(range(value))
    if isinstance(value, (list, tuple)) and value and all(map(_is_whole, value)) and len(set(value)) == len(value):
        return tuple(value)
    raise problem


def _box(value: str, what: str) -> tuple[float, ...] | None:
    """Left, top, right and bottom, None for "". Whether that is a box within an image, the estimator says."""
    if not value:
        return None
    try:
        left, top, right, bottom = map(float, value.split(","))
    except ValueError:
        raise ViewnetError(f"{what} {value!r}: expected left, top, right, bottom in pixels: 40,60,380,250") from None
    return left, top, right, bottom


def _count(least: int, expected: str, help: str, label: str = "") -> Parameter:
    """0, checked to None, or a whole number from `least`."""
    return Parameter(0, lambda value, what: _whole(value, what, expected, least) or None, help, label, plain=False)


def _number(default: float, accepts: Callable[[float], bool], expected: str, help: str, label: str) -> Parameter:
    def check(value: Any, what: str) -> float:
        try:
            number = math.nan if isinstance(value, bool) else float(value)
        except (TypeError, ValueError, OverflowError):
            raise ViewnetError(f"{what} {value!r}: expected a number") from None
        if not accepts(number):
            raise ViewnetError(f"{what} {value}: expected {expected}")
        return number

    return Parameter(default, check, help, label, plain=False)


def _one_of(default: str, choices: Collection[str], help: str, label: str = "{}") -> Parameter:
    return Parameter(default, lambda value, what: known(value, choices, what), help, label)


def _one_name(default: str, choices: Collection[str], help: str, field: str, label: str = "") -> Parameter:
    """Of a field of several names."""
    return Parameter(default, lambda value, what: (known(value, choices, what),), help, label, field=field)


def _several_of(default: str, choices: Collection[str], help: str, field: str) -> Parameter:
    def check(value: str, what: str) -> tuple[str, ...]:
        return tuple(dict.fromkeys(known(name.strip(), choices, what) for name in value.split(",")))

    return Parameter(default, check, help, "{}", "-".join, field)


def _folder(name: str, help: str) -> Parameter:
    return Parameter("", folder_named, help, name)


# fmt: off
PARAMETERS: dict[str, Parameter] = {
    "profile": _one_of("default", PROFILES, "smoke, tiny, pocket, small, paper; else $VIEWNET_PROFILE or its own"),
    "recipe": _several_of("default", RECIPES, "how models are trained (viewnet.recipes), one or more: paper,matting; "
                          "default: the profile's", "recipes"),
    "variant": _one_name("", (*VARIANTS, *PEERS), "whose runs to show, such as viewnet_cycle; empty: the notebook's",
                         "variants", "{0[0]}"),
    "rows": _several_of("", tuple(dict.fromkeys(variant for layout in LAYOUTS.values() for variant in layout.variants)),
                        "variants that fill rows: viewnet,mvc; empty: all that need no pretrained weights", "variants"),
    "categories": Parameter("all", _categories,
                            "car, or car,chair, or a list; all: the notebook's; everything: all twelve of PASCAL3D+",
                            "{}", lambda names: "everything" if set(names) == set(CATEGORIES) else "-".join(names),
                            plain=False),
    "category": _one_name("chair", objectron.CLASSES, "of Objectron: chair, bicycle or bottle", "categories"),
    "seeds": Parameter("1", _seeds, "how many (3: seeds 0, 1, 2), or which (0,2 or a list)", plain=False),
    "seed": Parameter(0, lambda value, what: (_whole(value, what),), "which training to show", field="seeds",
                      plain=False),
    "video_root": _folder("video_root", "the videos to train on; empty: a stand-in is made"),
    # Within video_root or anywhere, so that it is looked for with the videos.
    "weak_masks": Parameter("", lambda value, what: value, "weak masks, laid out as masks/; empty: the stand-in's",
                            "weak_masks"),
    "data_root": _folder("data_root", "photographs, empty: a stand-in; or ShapeNetCore, empty: the built-in models"),
    "cad_root": _folder("cad_root", "ShapeNetCore to train on; empty: the built-in models"),
    "eval_root": _folder("eval_root", "ShapeNetCore to score on; empty: the run's own test models"),
    "extra_cad": _folder("extra_cad", "a second ShapeNetCore, all of whose models join training; empty: none"),
    "splits": _folder("", "<synset>_{train,val,test}.txt lists for CAD models; empty: their own"),
    "split_rule": _one_of("all", ("all", "45/2/rest"), "Freiburg's sequences to train on: all or 45/2/rest",
                          "held_out"),
    "masks": _one_of("files", ("files", "alpha", "maskrcnn", "deeplabv3"), "files (in masks/), alpha, maskrcnn ..."),
    "start": Parameter("", lambda value, what: value if value in ("", SHAPENET) else str(checkpoint.locate(value)),
                       "weights to start from; empty: random; shapenet: trained on CAD models; else a run's key or "
                       "folder",
                       "{}", lambda start: start if start == SHAPENET else f"start_{Path(start).parent.name}"),
    "viewpoints": Parameter("", lambda value, what: paths.named(value, what) if value else None,
                            "a CSV of viewpoints (viewnet.data.annotated_viewpoints); empty: a stand-in", "viewpoints"),
    "backgrounds": Parameter("", lambda value, what: folder_named("" if value == "drawn" else value, what) or "drawn",
                             "a folder of images (SUN397) to composite training views over; empty: generated ones",
                             "backgrounds"),
    "subset": _one_of("imagenet", SUBSETS, "of PASCAL3D+: imagenet, pascal or both"),
    "keep": _one_of("all", ("all", "easy", "first"), "all, easy (not truncated or occluded), first (of an image)"),
    "margin": _number(0.0, lambda x: 0 <= x <= 2, "0 to 2 sides of the box", "seen beyond a box, in sides of it",
                      "margin{:g}"),
    "features": Parameter("auto", lambda name, what: name if name == "auto" else features.choose(name),
                          "of the view regression: vgg16, pixels ...; or auto", "{}"),
    "ridge": _number(baselines.RIDGE, lambda x: 0 < x < math.inf, "more than 0", "ridge of the view regression",
                     "ridge{:g}"),
    "calibration": _count(4, " from 4, or 0 for all", "photographs to align and fit on; 0: all there are",
                          "calibration{}"),
    "output": Parameter("", lambda value, what: paths.named(value, what) if value else paths.tables(),
                        "for tables; empty: paper_tables"),
    "workers": _count(1, ", 0 for what the machine has room for",
                      "parallel trainings; 0: as many as the machine has room for"),
    "image": Parameter("", lambda value, what: paths.named(value, what) if value else None,
                       "a file with an image of your own; empty: docs/car.jpg, a drawn car"),
    "box": Parameter("", _box, "of the object in your image, in pixels: 40,60,380,250; empty: all of it"),
    "model": Parameter("car", lambda value, what: value, "car, chair, aeroplane; a run's key, a folder, a hub's name"),
}
# fmt: on
"""Every parameter, in the order of the parts of a folder's name."""
