"""Requests: the checked parameters of a notebook, and what each notebook takes and shows by default."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from viewnet.config import SHAPENET_CATEGORIES, known
from viewnet.errors import ViewnetError
from viewnet.experiments.parameters import PARAMETERS, SHAPENET
from viewnet.recipes import ABSOLUTE, PROFILE_RECIPE, VARIANTS
from viewnet.tables.layouts import LAYOUTS

PHOTO_RECIPE = {"smoke": "photos", "tiny": "photos", "pocket": "photos", "small": "photos", "paper": "paper_photos"}
"""The recipe of a profile where photographs are scored: backgrounds in training, ten views a model."""

_ALL = ("profile", "seeds", "data_root", "output", "workers")
_CAD = (*_ALL, "categories", "recipe", "splits")
_FIGURE = (*(name for name in _CAD if name != "seeds"), "seed", "variant")
_TRAINED_ON = ("categories", "recipe", "cad_root", "extra_cad", "backgrounds")
_PHOTOS = (*_ALL, *_TRAINED_ON, "splits", "subset", "keep", "margin", "features", "ridge", "calibration")
_VIDEOS = (*_ALL, "recipe", "video_root", "masks", "cad_root", "backgrounds")
TAKES = {
    # Nothing is trained for these.
    "architecture": ("profile", "output"),
    "audit_metrics": ("viewpoints", "output"),
    # The runs of Table 2 serve the figures after it, those of Table 3 what scores photographs.
    **dict.fromkeys(("table1_shapenet", "table2_ablation"), (*_CAD, "rows", "eval_root")),
    **dict.fromkeys(("figure3_azimuth", "failures", "learned_volumes"), _FIGURE),
    "training_curves": (*_CAD, "variant"),
    "novel_views": _CAD,
    "test_sets": ("profile", "categories", "seeds", "recipe", "eval_root", "output", "workers"),
    "recipe_ablation": tuple(name for name in _CAD if name != "recipe"),
    **dict.fromkeys(("table3_pascal3d", "table5_dva"), (*_PHOTOS, "rows")),
    "photographs_study": (*_PHOTOS, "rows"),
    "alignment_study": _PHOTOS,
    "reconstructions": ("profile", "seed", "data_root", "output", "workers", *_TRAINED_ON),
    "table4_freiburg": (*_VIDEOS, "rows", "split_rule", "start", "features"),
    "objectron": (*_VIDEOS, "category", "weak_masks"),
    "your_method": (*_ALL, "categories", "cad_root", "backgrounds", "calibration"),
    "quickstart": ("image", "box", "model"),
}
"""Notebook -> the parameters that it takes; in the order to run them, where the first of those that share runs trains
them and the others take no time."""
ON_CAD = ("cad", "novel_views", "test_sets")
"""The kinds that are scored on CAD models."""


@dataclass(frozen=True)
class Design:
    """What a notebook shows unless its parameters say otherwise.

    kind    what is trained on and scored on, a class each: cad, novel_views, test_sets, photos, photographs_study,
            alignment_study, videos, objectron or own_method
    tables  to which a notebook of own methods adds rows
    fixed   values of parameters that it does not take
    """

    variants: tuple[str, ...] = ()
    kind: str = "cad"
    categories: tuple[str, ...] = SHAPENET_CATEGORIES
    profile: str = "tiny"
    tables: tuple[str, ...] = ()
    smoke: int | None = None  # so many variants only at the profile smoke
    fixed: dict[str, Any] = field(default_factory=dict)

    def usual(self, profile: str) -> dict[str, Any]:
        """Field of Request -> its value where no parameter says otherwise: no part of a folder's name."""
        values = {p.field or name: p.of(p.default, name) for name, p in PARAMETERS.items() if name not in _DESIGNED}
        recipe = (PROFILE_RECIPE if self.kind in ON_CAD else PHOTO_RECIPE)[profile]
        variants = self.variants[: self.smoke] if profile == "smoke" else self.variants
        categories = self.categories[:2] if profile == "smoke" else self.categories  # where it takes a minute
        designed = {"profile": self.profile, "recipes": (recipe,), "categories": categories, "variants": variants}
        return values | designed | self.fixed


_DESIGNED = ("profile", "recipe", "categories", "category", "variant", "rows")
"""Parameters whose defaults are the notebook's."""
_TABLE_KINDS = dict.fromkeys(("table3_pascal3d", "table5_dva"), "photos")
_TABLE_KINDS |= {"test_sets": "test_sets", "table4_freiburg": "videos"}
_ABLATION = tuple(variant for variant in LAYOUTS["table2_ablation"].variants if variant in VARIANTS)
"""The trained rows of Table 2."""
_METHOD_TABLES = ("table1_shapenet", "table3_pascal3d", "table5_dva")
_METHOD_VARIANTS = tuple(dict.fromkeys(v for table in _METHOD_TABLES for v in LAYOUTS[table].usual))

DESIGNS = {
    **{name: Design(t.usual, _TABLE_KINDS.get(name, "cad"), t.categories) for name, t in LAYOUTS.items()},
    "recipe_ablation": Design(LAYOUTS["recipe_ablation"].usual, smoke=2),
    "photographs_study": Design(LAYOUTS["photographs_study"].usual, "photographs_study", ("car",), smoke=3),
    "objectron": Design(("constant", "viewnet"), "objectron", ("chair",), fixed={"start": SHAPENET}),
    # The paper's rows; supervised ones are in the annotated frame.
    "alignment_study": Design(
        tuple(variant for variant in LAYOUTS["table3_pascal3d"].usual if variant not in (*ABSOLUTE, "behind_both")),
        "alignment_study",
    ),
    "figure3_azimuth": Design(("viewnet",)),
    "training_curves": Design(_ABLATION),
    # The supplement's figure is of the last four.
    "novel_views": Design(
        ("viewnet", "viewnet_cycle", "segmentation_target", "no_shape_prior", "encoder_decoder", "hologan_decoder"),
        "novel_views",
    ),
    "learned_volumes": Design(("viewnet",)),
    "failures": Design(("viewnet",)),
    "reconstructions": Design(("behind_both",), "photos"),  # of photographs that nobody cut out
    # It shows how, in a minute.
    "your_method": Design(_METHOD_VARIANTS, "own_method", profile="smoke", tables=_METHOD_TABLES),
    # Nothing is trained for these, so the default is the paper's size.
    "architecture": Design(categories=(), profile="paper"),
    "audit_metrics": Design(categories=(), profile="paper"),
    "quickstart": Design(categories=()),
}


@dataclass(frozen=True)
class Request:
    """The checked parameters of a notebook (viewnet.experiments.parameters); those it does not take are at defaults.

    `label` names what is not the notebook's usual value ("smoke", "tiny-car"), "" if all is usual.
    """

    name: str
    profile: str
    recipes: tuple[str, ...]
    variants: tuple[str, ...]
    categories: tuple[str, ...]
    seeds: tuple[int, ...]
    video_root: str | None
    weak_masks: str
    data_root: str | None
    cad_root: str | None
    eval_root: str | None
    extra_cad: str | None
    splits: str | None
    split_rule: str
    masks: str
    start: str
    viewpoints: Path | None
    backgrounds: str
    subset: str
    keep: str
    margin: float
    features: str
    ridge: float
    calibration: int | None
    output: Path
    workers: int | None
    image: Path | None
    box: tuple[float, ...] | None
    model: str
    label: str

    def __post_init__(self) -> None:
        """Subclasses check here what depends on several parameters."""

    @classmethod
    def check(cls, name: str, **given: Any) -> Self:
        """The request of the notebook `name` for these parameters; others are ignored at their defaults.

        Raises ViewnetError naming the parameter and its valid values.
        """
        design, taken = DESIGNS[known(name, DESIGNS, "notebook")], accepted(name)
        for key in [key for key in given if key not in taken]:
            if key not in PARAMETERS or given.pop(key) not in ("", PARAMETERS[key].default):
                known(key, taken, f"parameter of {name}")
        profile = given.pop("profile", "default")
        profile = os.environ.get("VIEWNET_PROFILE", design.profile) if profile == "default" else profile
        values: dict[str, Any] = {"profile": PARAMETERS["profile"].of(profile, "profile")}
        for key, parameter in PARAMETERS.items():
            plain = given.get(key, parameter.default)
            # Only text is compared with the default: True == 1.
            if key in given and not (isinstance(plain, str) and plain == parameter.default):
                values[parameter.field or key] = parameter.of(plain, key)
        if "rows" in taken and "variants" in values:
            for variant in values["variants"]:
                known(variant, LAYOUTS[name].variants, f"row of {name}")
        usual = design.usual(values["profile"])
        # Two parameters of one field say it alike.
        told = {
            at: parameter.label.format(parameter.text(values[at]))
            for at, parameter in ((p.field or key, p) for key, p in PARAMETERS.items())
            if parameter.label and at in values and values[at] != usual[at]
        }
        parts = list(told.values())
        # The profile stands first wherever there is anything, except for a list of viewpoints, which has none.
        if parts not in ([], ["viewpoints"]) and parts[0] != values["profile"]:
            parts = [values["profile"], *parts]
        request = cls(name=name, **(usual | values), label="-".join(parts))
        if len(request.recipes) > 1 and design.kind not in ON_CAD:
            raise ViewnetError(f"recipe {','.join(request.recipes)}: {name} takes one")
        return request

    @property
    def recipe(self) -> str:
        """The recipe, the first of several."""
        return self.recipes[0]

    @property
    def smoke(self) -> bool:
        """Whether the profile is the smallest, with small stand-ins."""
        return self.profile == "smoke"

    @property
    def folder(self) -> Path:
        """Where tables and figures go: a subfolder of the output folder for what is not usual."""
        return self.output / self.label

    @property
    def figures(self) -> Path:
        """Where images go that are no part of a table."""
        return self.output / "figures" / self.label


def accepted(name: str) -> tuple[str, ...]:
    """The parameters that a notebook takes, in the order of PARAMETERS. Raises ViewnetError for an unknown notebook."""
    taken = TAKES[known(name, DESIGNS, "notebook")]
    return tuple(key for key in PARAMETERS if key in taken)
