"""Recipes (how a run is trained), variants (rows of the tables) and profiles (how big), as changes to viewnet.config.

Each is a dictionary of changes to the base configuration, so Table 2 is literally `VARIANTS`. A setting has its value
from the last of these layers that changes it: the recipe, the profile, both together (`TOGETHER`), videos (`FILMED`),
weights to start from (`STARTED`), the variant, labels (`LABELLED`), its length at the smallest profile (`BRIEF`), a
collection of files (`COLLECTED`), and what the user sets. Methods of other papers have recipes of their own (`PEERS`,
`PEER_RECIPES`).

>>> config = make_config("single_head", "chair", profile="smoke", epochs=3)
>>> config.model.heads, config.train.epochs, config.data.models, config.recipe
(1, 3, 30, 'matting')
"""

from dataclasses import replace
from typing import Any

from viewnet.config import RunConfig, build, known, known_category, nearest, settings
from viewnet.errors import ViewnetError

Changes = dict[str, Any]
"""Section ("data", "model", "train") -> field -> value; for groups of training's settings one level deeper."""


def merged(*changes: Changes) -> Changes:
    """One dictionary of all changes; of two values of one setting the later one counts."""
    result: Changes = {}
    for change in changes:
        for name, value in change.items():
            both = isinstance(value, dict) and isinstance(result.get(name), dict)
            result[name] = merged(result[name], value) if both else value
    return result


RECIPES: dict[str, Changes] = {
    # As reported, and as released where the paper is silent: black background, VGG16 perceptual loss, a learned focal
    # length, the viewpoint network's input cropped to the object, stopping by validation accuracy.
    "paper": {"model": {"crop": "square"}, "train": {"augment": True}},
    # Ours: masks beside colours, known elevations, heads that start apart, viewpoints tried beside theirs, stopping
    # without labels. See docs/recipes.md.
    "matting": {
        "model": {"head_spread": 0.5, "elevation_limits": (-22.0, 42.0)},
        "train": {
            "perceptual": "none",
            "pixel_weight": 0.3,
            "mask_weight": 1.0,
            "select_by": "reconstruction",
            "comparison": {"neighbours": 8.0, "temperature": 0.1},
            "search": {"share": 0.3},
            "cycle": {"weight": 0.3, "head": "closest"},
            "optimiser": {"learning_rate": 1e-3, "betas": (0.9, 0.99), "muon": 0.02, "schedule": "hold"},
        },
    },
}

# Section 4.3: training for photographs. Ten views a model, and a background behind both inputs; in ours behind the
# viewpoint network's alone: see docs/recipes.md for what that changes, and our explanation.
RECIPES["paper_photos"] = merged(RECIPES["paper"], {"data": {"views": 10, "backgrounds": "drawn"}})
RECIPES["photos"] = merged(
    RECIPES["matting"],
    {
        # A view cropped to its object should still have as many pixels as the networks see.
        "data": {"views": 10, "image_size": 128, "supersample": 1, "backgrounds": "drawn"},
        "model": {"crop": "stretched"},
        "train": {"photo": {"views_per_target": 3, "box_error": 0.05, "tilt": 5.0, "exposure": 1.0, "cut_out": True}},
    },
)

NO_SEARCH: Changes = {"train": {"search": {"share": 0.0}, "comparison": {"neighbours": 0.0}}}
"""Heads are compared by their own viewpoints alone, as in the paper."""

VARIANTS: dict[str, Changes] = {
    "viewnet": {},
    "viewnet_cycle": {"train": {"cycle": {"on": True}}},
    # What MVC and Pointcloud see in their trainings, seven times the usual: a comparison that is fair in data.
    "as_many_targets": {"train": {"epochs": 100, "patience": 100}},
    "single_head": {"model": {"heads": 1}},
    "segmentation_target": {"train": {"target": "mask"}},
    "no_shape_prior": {"model": {"shape_prior": False}},
    "encoder_decoder": {"model": {"decoder": "encoder_decoder"}},
    # Each viewpoint that is compared is an image by the HoloGAN decoder: 32 a target in a search.
    "hologan_decoder": merged(NO_SEARCH, {"model": {"decoder": "hologan"}}),
    "no_search": NO_SEARCH,  # what the row above is to be compared with
    # For the study of photographs: it sees objects over black alone, and may teach another one.
    "over_black": {"data": {"backgrounds": None}, "train": {"photo": {"views_per_target": 1, "cut_out": False}}},
    # For photographs, as in the paper: what the recipe `photos` has behind the viewpoint network's input alone.
    "behind_both": {"train": {"photo": {"cut_out": False}}},
    # Twice the side of the profile tiny, whose widths these are, and a layer more that halves it.
    "larger_input": {"model": {"input_size": 128, "encoder_channels": (16, 32, 64, 128, 128, 128, 128)}},
}
"""The trained rows of Tables 1 to 3, and of the study of photographs."""

ABLATIONS: dict[str, Changes] = {
    "whole_views": {"model": {"crop": "square"}, "train": {"augment": True}},
    "elevation_limits": {"model": {"elevation_limits": None}},
    "masks": {"train": {"mask_weight": 0.0}},
    "neighbours": {"train": {"comparison": {"neighbours": 0.0}}},
    "pull": {"train": {"comparison": {"pull_weight": 0.0}}},
    "temperature": {"train": {"comparison": {"temperature": 0.0}}},
    "head_spread": {"model": {"head_spread": 0.0}},
    "search": {"train": {"search": {"share": 0.0}}},
    "learning_rate": {"train": {"optimiser": {"learning_rate": 1e-4}}},
    "betas": {"train": {"optimiser": {"betas": (0.9, 0.999)}}},
    "muon": {"train": {"optimiser": {"muon": 0.0}}},
    "schedule": {"train": {"optimiser": {"schedule": "constant"}}},
}
"""What the recipe `matting` has -> the changes that take it away, to what `paper` has in its place.

Each is a variant, "without_" and its name: a row of the notebook recipe_ablation."""
VARIANTS |= {f"without_{name}": changes for name, changes in ABLATIONS.items()}

_SUPERVISED: Changes = {"train": {"targets_per_object": 4, "optimiser": {"learning_rate": 1e-3, "schedule": "cosine"}}}

PEERS: dict[str, Changes] = {
    "mvc": {
        "model": {
            "input_size": 32,
            "backdrop": 1.0,
            "heads": 8,
            "encoder_channels": (16, 32, 64, 128, 128),
            "appearance_size": 64,
            "generator_channels": (32, 16),
            "volume_size": 24,
            "render_size": 32,
            "shape_prior": False,
        },
        "train": {
            "epochs": 100,
            "patience": 100,
            "batch_size": 48,
            "targets_per_object": 3,
            "optimiser": {"learning_rate": 2e-3, "schedule": "hold"},
        },
    },
    # Eight objects a step, four views of each. The heads are a student and four candidates.
    "pointcloud": {
        "model": {
            "heads": 5,
            "backdrop": 1.0,
            "input_size": 32,
            "volume_size": 24,
            "encoder_channels": (16, 32, 64),
            "code_size": 256,
        },
        "train": {
            "epochs": 100,
            "patience": 100,
            "batch_size": 24,
            "targets_per_object": 3,
            "validate_every": 10,
            "optimiser": {"learning_rate": 1e-3, "schedule": "hold"},
        },
    },
    "spherical_regression": _SUPERVISED,
    "spherical_regression_imagenet": _SUPERVISED,
    "spherical_regression_frozen": _SUPERVISED,
    "spherical_regression_larger": merged(_SUPERVISED, VARIANTS["larger_input"]),
    "box_corners": _SUPERVISED,
    "box_corners_imagenet": _SUPERVISED,
    "relative_pose": merged(_SUPERVISED, {"model": {"in_plane": True}}),
    "ssv": {
        "model": {"input_size": 32, "volume_size": 8, "code_size": 16, "elevation_limits": (-20.0, 40.0)},
        "train": {
            "epochs": 25,
            "patience": 25,
            "batch_size": 16,
            "targets_per_object": 1,
            "optimiser": {"learning_rate": 5e-4, "betas": (0.0, 0.99), "schedule": "hold"},
        },
    },
}
"""Methods of other papers (viewnet.peers) -> what they change of their recipe: rows of the tables as well."""
ABSOLUTE = tuple(name for name in PEERS if name.startswith(("spherical_regression", "box_corners")))
"""Peers that learn from viewpoints and predict them in the annotated frame: no alignment is fitted."""
_LABELLED: Changes = {"train": {"epochs": 80, "patience": 80, "select_by": "accuracy", "augment": True}}
_LONGER = merged(_LABELLED, {"train": {"epochs": 120, "patience": 120}})
LABELLED = dict.fromkeys(ABSOLUTE, _LABELLED) | dict.fromkeys(("box_corners", "box_corners_imagenet"), _LONGER)
"""What methods that learn from viewpoints change on views of CAD models.

They get better for long if no image is seen twice alike, but ever surer of what they get wrong: the loss on validation
views rises, and accuracy chooses the weights."""
BRIEF: Changes = {"train": {"epochs": 2, "patience": 2}}
"""What the profile smoke changes of peers and variants that have a length of training of their own."""
PEER_RECIPES: dict[str, Changes] = {
    "peer": {"model": {"heads": 1}, "train": {"perceptual": "none", "select_by": "reconstruction"}}
}
PEER_RECIPES["peer_photos"] = merged(
    PEER_RECIPES["peer"],
    {
        "data": RECIPES["photos"]["data"],
        "model": {"crop": "stretched"},
        "train": {"photo": {"box_error": 0.05, "tilt": 5.0, "exposure": 1.0}},
    },
)
"""How peers are trained: on views of CAD models, or before backgrounds for photographs. None of ViewNet's settings."""

_TINY: Changes = {
    "data": {"models": 1000},
    "model": {
        "volume_size": 32,
        "render_size": 32,
        "encoder_channels": (16, 32, 64, 128, 128, 128),
        "code_size": 64,
        "generator_channels": (64, 16, 16),
        "generator_refine": False,
        "generator_last_kernel": 2,
        "appearance_size": 64,
    },
    "train": {"epochs": 14, "batch_size": 32, "targets_per_object": 2, "validate_every": 5},
}

PROFILES: dict[str, Changes] = {
    "smoke": {
        "data": {"models": 30, "image_size": 32, "supersample": 1},
        "model": {
            "input_size": 32,
            "volume_size": 16,
            "render_size": 16,
            "encoder_channels": (8, 16, 16, 32, 32, 32),
            "code_size": 16,
            "generator_channels": (16, 8),
            "generator_refine": False,
            "appearance_size": 16,
        },
        "train": {"epochs": 2, "batch_size": 16, "patience": 2},
    },
    "tiny": _TINY,
    # Half a megabyte in half precision: twelve categories are small enough to come with the package. Their appearance
    # networks are to draw photographs that nobody cut out.
    "pocket": merged(
        _TINY,
        {
            "model": {
                "encoder_channels": (16, 32, 48, 64, 64, 64),
                "code_size": 32,
                "generator_channels": (32, 16, 16),
            },
            "train": {"epochs": 6, "validate_every": 3, "photo": {"cut_out": False}},
        },
    ),
    "small": {
        "data": {"models": 2000},
        "model": {"encoder_channels": (64, 128, 256, 512, 512, 512), "generator_channels": (256, 128, 64, 32)},
        "train": {"epochs": 60},
    },
    "paper": {"data": {"models": 0}},
}

PROFILE_RECIPE = {"smoke": "matting", "tiny": "matting", "pocket": "photos", "small": "matting", "paper": "paper"}
"""The recipe of a profile unless another is named."""

# As reported, at least a million targets. The features of a network of five megabytes stand for VGG16's, which would
# take nearly all of the time beside networks so small.
_REPORTED: Changes = {
    "train": {
        "epochs": 290,
        "patience": 290,
        "validate_every": 10,
        "batch_size": 64,
        "targets_per_object": 1,
        "perceptual": "squeezenet",
    }
}
TOGETHER: dict[tuple[str, str], Changes] = {
    ("tiny", "paper"): _REPORTED,
    ("tiny", "paper_photos"): merged(_REPORTED, {"train": {"epochs": 145, "validate_every": 5}}),
    ("tiny", "photos"): {"train": {"epochs": 6}},
    ("tiny", "peer"): {"train": {"epochs": 40}},
    ("tiny", "peer_photos"): {"train": {"epochs": 12}},
}
"""What a profile and a recipe change only together: twice the views a model are half as many epochs, or less."""

# Shapes and viewpoints are there already, so neither is searched for again.
STARTED: Changes = {"train": {"search": {"share": 0.0}}}
"""What changes for a run that starts from another one's weights."""
COLLECTED: Changes = {"data": {"models": 0}}
"""What changes for CAD models in files, at every profile but the smallest: all of them are used."""

FILMED: dict[str | tuple[str, str], Changes] = {
    # All frames of the 48 Freiburg cars, 5800 views: with and without cycles side by side in about ten minutes.
    "tiny": {"train": {"epochs": 14}},
    # Few objects, filmed at eye level: a wide code has room for a frame of its own for each of them, and from the front
    # left and the rear left silhouettes are alike, so that colours must count for more. See docs/recipes.md.
    "photos": {
        "model": {"appearance_size": 8},
        "train": {"pixel_weight": 1.0, "mask_weight": 0.3, "photo": {"cut_out": False}},
    },
    # Relative rotations may teach nothing for some thousand steps, and then nearly all.
    ("tiny", "peer_photos"): {"train": {"epochs": 42, "patience": 42}},
}
"""What a profile, a recipe that does not start from other weights, or both together change only for videos."""


def make_config(
    variant: str = "viewnet",
    category: str = "car",
    profile: str = "tiny",
    recipe: str | None = None,
    seed: int = 0,
    data_root: str | None = None,
    splits: str | None = None,
    **overrides: Any,
) -> RunConfig:
    """The configuration of one run. Overrides are settings by name, e.g. `epochs=3` or `search_views=16`.

    Raises ViewnetError naming the valid choices for an unknown variant, profile, recipe or setting, for an unknown
    category without data of one's own, and for a value that a setting cannot have.

    >>> make_config(category="car", recipe="photos", heads=5).model.heads
    5
    >>> make_config(profile="huge")
    Traceback (most recent call last):
    viewnet.errors.ViewnetError: unknown profile 'huge': choose one of smoke, tiny, pocket, small, paper
    """
    known(variant, (*VARIANTS, *PEERS), "variant")
    known(profile, PROFILES, "profile")
    recipes = (*RECIPES, *PEER_RECIPES) if variant in PEERS else RECIPES
    recipe = PROFILE_RECIPE[profile] if recipe is None else known(recipe, recipes, "recipe")
    if variant in PEERS:
        recipe = "peer_photos" if "photos" in recipe else "peer"
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ViewnetError(f"seed {seed!r}: expected a whole number of 0 or more")
    filmed, started = (overrides.get(name) is not None for name in ("video", "start"))
    own, labelled = (VARIANTS | PEERS)[variant], LABELLED.get(variant, {}) if recipe == "peer" else {}
    changes = [
        {"data": {"category": category, "root": data_root, "splits": splits}, "model": {}, "train": {}},
        (RECIPES | PEER_RECIPES)[recipe],
        PROFILES[profile],
        TOGETHER.get((profile, recipe), {}),
        FILMED.get(profile, {}) if filmed else {},
        FILMED.get(recipe, {}) if filmed and not started else {},
        FILMED.get((profile, recipe), {}) if filmed else {},
        STARTED if started else {},
        own,
        labelled,
        BRIEF if profile == "smoke" and (labelled or "epochs" in own.get("train", {})) else {},
        COLLECTED if data_root is not None and profile != "smoke" else {},
        overridden(overrides),
    ]
    run = {"variant": variant, "category": category, "profile": profile, "recipe": recipe, "seed": seed}
    config = build(RunConfig, {**run, **merged(*changes)}, "config")
    known_category(category, own=config.data.root or (config.data.video and config.data.video.root))
    return config


def repeats_viewnet(variant: str, recipe: str) -> bool:
    """Whether a variant changes nothing of a recipe, as "no_search" of the paper's, which has none: no row of its own.

    >>> repeats_viewnet("no_search", "paper"), repeats_viewnet("no_search", "matting")
    (True, False)
    """
    changed = replace(make_config(variant, recipe=recipe), variant="viewnet")
    return variant != "viewnet" and changed == make_config(recipe=recipe)


def overridden(overrides: dict[str, Any]) -> Changes:
    """Settings by name as changes. ViewnetError naming the nearest for an unknown one.

    >>> overridden({"heads": 2, "search_views": 16})
    {'model': {'heads': 2}, 'train': {'search': {'views': 16}}}
    """
    places = dict(settings())
    changes: Changes = {}
    for name, value in overrides.items():
        if name not in places:
            raise ViewnetError(f"unknown setting {name!r}: viewnet train --settings lists all{nearest(name, places)}")
        change: Any = value
        for step in reversed(places[name]):
            change = {step: change}
        changes = merged(changes, change)
    return changes
