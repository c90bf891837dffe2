"""The parameters of notebooks, in one table: their defaults, how they are checked, and their part of the folder's name.

Values arrive plain, as papermill and the command line give them: names, whole numbers, "car,chair" or lists.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewnet import paths
from viewnet.config import CATEGORIES, known
from viewnet.data.readers import objectron
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, features
from viewnet.evaluation.baselines import UNTRAINED
from viewnet.model import checkpoint
from viewnet.recipes import PROFILES, RECIPES, VARIANTS

SHAPENET = "shapenet"
"""The value of `start` for which ViewNet is first trained on CAD models of the category, with the same seed."""
MOST_SEEDS = 1000
LEAST_CALIBRATION = 4
"""Photographs that an alignment can be fitted on, at least."""

Check = Callable[[Any, str], Any]
"""(plain value, parameter's name) -> checked value. Raises ViewnetError naming the parameter and its valid values."""


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    default  the plain value where none is given
    check    turns a plain value into the one that a Request holds
    help     its meaning, in a line
    label    checked value -> its part of the output folder's name, where the value is not the notebook's usual one
    field    the field of Request that it fills, where that is named differently
    """

    default: Any
    check: Check
    help: str
    label: Callable[[Any], str] | None = None
    field: str = ""


def folder_named(value: str, what: str) -> str | None:
    """The full path of a folder, None for "". Raises ViewnetError where there is none."""
    if not isinstance(value, str):
        raise ViewnetError(f"{what} {value!r}: expected a folder")
    if not value:
        return None
    folder = _path(value, what).resolve()
    if not folder.is_dir():
        raise ViewnetError(f"{what} {value}: no such folder")
    return str(folder)


def _path(value: str, what: str) -> Path:
    """A path with "~" expanded. Raises ViewnetError for what cannot be one."""
    try:
        path = Path(value).expanduser()
        path.resolve().exists()
    except (OSError, ValueError, RuntimeError, TypeError):  # too long, a null byte, an unknown user's home, no text
        raise ViewnetError(f"{what} {value!r:.300}: not the name of a file or folder") from None
    return path


def _one_of(*choices: str) -> Check:
    return lambda value, what: known(value, choices, what)


def _is_whole(value: Any, least: int = 0) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _number(accepts: Callable[[float], bool], expected: str) -> Check:
    def check(value: Any, what: str) -> float:
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise ViewnetError(f"{what} {value!r}: expected a number") from None
        if not accepts(number):
            raise ViewnetError(f"{what} {value}: expected {expected}")
        return number

    return check


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


def _workers(value: Any, what: str) -> int | None:
    if not _is_whole(value):
        raise ViewnetError(f"{what} {value!r}: expected a whole number, 0 for what the machine has room for")
    return value or None


def _calibration(value: Any, what: str) -> int | None:
    if not _is_whole(value) or 0 < value < LEAST_CALIBRATION:
        raise ViewnetError(f"{what} {value!r}: expected a whole number from {LEAST_CALIBRATION}, or 0 for all")
    return value or None


def _backbone(value: Any, what: str) -> str:
    if value != "auto":
        features.choose(value)
    return value


def _categories_label(names: Sequence[str]) -> str:
    return "everything" if set(names) == set(CATEGORIES) else "-".join(names)


def _start_label(start: str) -> str:
    return start if start == SHAPENET else f"start_{Path(start).parent.name}"


def _folder_parameter(name: str, help: str) -> Parameter:
    return Parameter("", folder_named, help, label=name.format)


PARAMETERS: dict[str, Parameter] = {
    "profile": Parameter(
        "default",
        _one_of(*PROFILES),
        "how large: smoke, tiny, small or paper; default: environment variable VIEWNET_PROFILE, else the notebook's",
        label="{}".format,
    ),
    "recipe": Parameter(
        "default",
        _one_of(*RECIPES),
        "how models are trained, a name of config.RECIPES; default: the profile's",
        label="{}".format,
    ),
    "variant": Parameter(
        "",
        lambda value, what: (known(value, (*VARIANTS, *UNTRAINED), what),),
        "the row that a figure shows; empty: the notebook's",
        label="{0[0]}".format,
        field="variants",
    ),
    "categories": Parameter(
        "all",
        _categories,
        "car, or car,chair, or a list; all: the notebook's; everything: all twelve of PASCAL3D+",
        label=_categories_label,
    ),
    "category": Parameter(
        "chair",
        lambda value, what: (known(value, objectron.CLASSES, what),),
        "of Objectron: chair, as reported, bicycle or bottle",
        field="categories",
    ),
    "seeds": Parameter(1, _seeds, "how many (3: seeds 0, 1, 2), or which (0,2 or a list)"),
    "video_root": _folder_parameter("video_root", "the videos to train on; empty: a stand-in is made"),
    "weak_masks": Parameter(
        "",
        lambda value, what: value,
        "a folder of weakly supervised masks, laid out as masks/, within video_root or anywhere; empty: the stand-in's "
        "own, and none for Objectron",
        label="weak_masks".format,
    ),
    "data_root": _folder_parameter(
        "data_root",
        "without photographs: ShapeNetCore (v1 or v2), empty: the built-in models; else the photographs, PASCAL3D+ 1.1 "
        "or a folder with images/ and viewpoints.csv, empty: a stand-in is made",
    ),
    "cad_root": _folder_parameter("cad_root", "ShapeNetCore to train on; empty: the built-in models"),
    "eval_root": _folder_parameter("eval_root", "ShapeNetCore to score on; empty: the own test models"),
    "extra_cad": _folder_parameter("extra_cad", "a second ShapeNetCore folder, all of whose models join training"),
    "splits": Parameter(
        "",
        folder_named,
        "a folder of <synset>_{train,val,test}.txt lists for the CAD models; empty: their all.csv, else a seeded split",
    ),
    "split_rule": Parameter(
        "all",
        _one_of("all", "45/2/rest"),
        "which sequences are trained on: all, as reported, or 45/2/rest, by number, so that some are held out",
        label="held_out".format,
    ),
    "masks": Parameter(
        "files",
        _one_of("files", "alpha", "maskrcnn", "deeplabv3"),
        "what cuts objects out of frames: files (in masks/ of video_root), alpha, maskrcnn or deeplabv3",
        label="{}".format,
    ),
    "start": Parameter(
        "",
        lambda value, what: value if value in ("", SHAPENET) else str(checkpoint.locate(value)),
        "weights to start from; empty: random, as reported; shapenet: ViewNet trained on CAD models; else the key or "
        "folder of a run",
        label=_start_label,
    ),
    "viewpoints": Parameter(
        "",
        lambda value, what: _path(value, what) if value else None,
        "a CSV of annotated viewpoints (viewnet.data.annotated_viewpoints); empty: a stand-in is generated",
        label="viewpoints".format,
    ),
    "backgrounds": Parameter(
        "",
        lambda value, what: value if value == "drawn" else folder_named(value, what) or "drawn",
        "a folder of images (SUN397) to composite training views over; empty: generated ones",
        label="backgrounds".format,
    ),
    "subset": Parameter(
        "imagenet",
        _one_of("imagenet", "pascal", "both"),
        "of PASCAL3D+: imagenet, pascal or both",
        label="{}".format,
    ),
    "keep": Parameter(
        "all",
        _one_of("all", "easy", "first"),
        "photographs: all, easy (neither difficult, truncated nor occluded) or first (one object an image)",
        label="{}".format,
    ),
    "margin": Parameter(
        0.0,
        _number(lambda x: 0 <= x <= 2, "0 to 2 sides of the box"),
        "how much of a box's longer side is cropped beyond it, 0 to 2",
        label="margin{:g}".format,
    ),
    "backbone": Parameter(
        "auto",
        _backbone,
        "of the view regression: vgg16, squeezenet1_1, another of torchvision's, or pixels; auto: the first of vgg16, "
        "squeezenet1_1 and pixels that is available",
        label="{}".format,
    ),
    "ridge": Parameter(
        baselines.RIDGE,
        _number(lambda x: 0 < x < math.inf, "more than 0"),
        "strength of the view regression's ridge penalty",
        label="ridge{:g}".format,
    ),
    "calibration": Parameter(
        0,
        _calibration,
        "number of photographs that predictions are aligned, and baselines fitted, on; 0: all",
        label="calibration{}".format,
    ),
    "output": Parameter(
        "",
        lambda value, what: _path(value, what) if value else paths.tables(),
        "where tables and figures go; empty: paper_tables",
    ),
    "workers": Parameter(0, _workers, "trainings side by side; 0: what the machine has room for"),
}
"""Every parameter, in the order of the parts of a folder's name."""
