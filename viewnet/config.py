"""What a run is: profiles (how big), recipes (how trained), variants (rows of the tables), and the key that names it.

Everything is a frozen dataclass. A variant is a named set of changes to the base configuration, so that Table 2 is
literally `VARIANTS`; a recipe and a profile are the same, so there is one place where each setting is decided.

>>> config = make_config("single_head", "chair", profile="smoke", epochs=3)
>>> config.model.heads, config.train.epochs, config.data.models, config.recipe
(1, 3, 30, 'matting')
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import types
import typing
from dataclasses import dataclass, field
from typing import Any, Literal

from viewnet.errors import ViewnetError

SYNSETS = {
    "aeroplane": "02691156",
    "bicycle": "02834778",
    "boat": "04530566",
    "bottle": "02876657",
    "bus": "02924116",
    "car": "02958343",
    "chair": "03001627",
    "diningtable": "04379243",
    "motorbike": "03790512",
    "sofa": "04256520",
    "train": "04468005",
    "tvmonitor": "03211117",
}
"""PASCAL3D+ category name -> ShapeNet (WordNet) synset id."""
CATEGORIES = tuple(SYNSETS)
SHAPENET_CATEGORIES = ("aeroplane", "car", "chair")
"""The three categories of Tables 1 and 2."""


@dataclass(frozen=True)
class DataConfig:
    """Which views: CAD models of one category, rendered from random viewpoints (section 4.2)."""

    category: str
    root: str | None = None  # a ShapeNetCore folder (v1 or v2 layout); None: the built-in models
    splits: str | None = None  # a folder of <synset>_{train,val,test}.txt lists; None: all.csv, else a seeded split
    models: int = 1000  # built-in: how many to make; real: use at most so many, 0 for all
    extra: str | None = None  # a second ShapeNetCore folder; all its models of the category join the training split
    extra_share: float = 0.3  # of the training models, where `models` says how many the others are
    views: int = 5
    image_size: int = 64
    supersample: int = 2
    azimuth_range: tuple[float, float] = (0.0, 360.0)
    elevation_range: tuple[float, float] = (-20.0, 40.0)
    seed: int = 0
    renderer: Literal["auto", "raycast", "pyrender"] = "auto"
    # Behind both inputs in training, never behind the target: SUN397, any folder of images, or "drawn"; None: nothing
    backgrounds: str | None = None
    video: VideoConfig | None = None  # given: views are its clips' frames (section 4.4); only backgrounds count beside


@dataclass(frozen=True)
class PhotoConfig:
    """Which photographs of one category to score on (section 4.3), and how they are cut."""

    category: str
    root: str | None = None  # PASCAL3D+ 1.1, or a folder with images/ and viewpoints.csv; None: a stand-in is made
    subset: Literal["imagenet", "pascal", "both"] = "imagenet"  # of PASCAL3D+; its "train" calibrates, its "val" scores
    keep: Literal["all", "easy", "first"] = "all"  # easy: not difficult, truncated or occluded; first: of each image
    coarse: bool = False  # objects whose viewpoint is only known to an eighth of a turn count too
    size: int = 64  # pixels along a side
    margin: float = 0.0  # so much of the box's longer side is seen beyond it, on either side
    square: bool = True  # whether the object keeps its shape, or its box is stretched to a square
    pad: tuple[int, int, int] = (0, 0, 0)  # colour of what lies beyond the photograph's edges
    models: int = 60  # the stand-in: CAD models a split
    count: int = 600  # the stand-in: photographs a split
    backgrounds: str | None = None  # the stand-in: a folder of images; None: drawn ones
    seed: int = 0  # the stand-in's


@dataclass(frozen=True)
class VideoConfig:
    """Which videos of one category to train on (section 4.4), and how their objects are cut out."""

    category: str
    # Freiburg static cars, Objectron, or a folder of videos or of folders of frames; None: a stand-in is made
    root: str | None = None
    # auto: what lies in root tells, and without one the stand-in is of Freiburg for cars and of Objectron for others
    kind: Literal["auto", "freiburg", "objectron", "folder"] = "auto"
    # Freiburg's sequences by number; all: every clip is trained on
    split_rule: Literal["45/2/rest", "all"] = "45/2/rest"
    count: int = 0  # frames a clip, 0 for all
    pick: Literal["random", "evenly"] = "random"  # which
    masks: Literal["files", "alpha", "maskrcnn", "deeplabv3", "none"] = "files"
    mask_folder: str = "masks"  # where masks in files lie, within root or anywhere, laid out as root's own masks/ is
    size: int = 128  # pixels along a side
    margin: float = 0.05  # so much of the object's longer side is seen beyond it, on either side
    square: bool = True  # whether the object keeps its shape, or its box is stretched to a square
    # With masks: the object is as high in all views of its clip, or fills every one, however long it then is
    scale: Literal["clip", "view"] = "clip"
    side: float = 16.0  # objects with fewer pixels along their shorter side are left out
    blur: float = 0.0  # and frames less sharp than this share of their clip's median
    seed: int = 0  # of picking, of splits that are not given, and the stand-in's
    sequences: tuple[int, ...] = ()  # Freiburg's stand-in: their numbers; (): the 48 of the data set
    videos: int = 60  # Objectron's stand-in: how many
    frames: int = 120  # the stand-in: a clip


@dataclass(frozen=True)
class ModelConfig:
    """The networks and the volume renderer (section 3 and the supplement's architecture tables)."""

    input_size: int = 64  # pixels along a side of what both encoders see
    volume_size: int = 64  # voxels along a side
    render_size: int = 64  # pixels along a side of the reconstruction
    # The viewpoint network sees the object's tight square box, enlarged (the released code), or its own box stretched
    crop: Literal["none", "square", "stretched"] = "none"
    backdrop: float = 0.0  # grey level behind what both encoders see
    encoder_padding: Literal["replicate", "zeros"] = "replicate"
    encoder_channels: tuple[int, ...] = (64, 128, 256, 512, 512, 512)
    code_size: int = 1024  # the fixed canonical code
    generator_channels: tuple[int, ...] = (
        512,
        128,
        128,
        16,
    )  # at 4, 8, 16, 32 ... voxels, up to half the volume's side
    generator_refine: bool = True  # a second, 3x3x3 layer at each resolution, as in the supplement
    generator_last_kernel: Literal[2, 4] = 4  # of the layer to the full resolution; 2 is much the cheaper
    appearance_size: int = 256
    heads: int = 3  # M, the number of viewpoint hypotheses
    head_spread: float = 0.0  # the heads start facing different azimuths: how strongly
    elevation_limits: tuple[float, float] | None = None  # predicted elevations stay within, degrees; None: the sphere
    in_plane: bool = False  # learn the up vector too (section 3.1, the general case)
    decoder: Literal["adain", "encoder_decoder", "hologan"] = "adain"
    shape_prior: bool = True  # the Gaussian S in Q = S + Q'
    colour_prior: bool = False  # colours start from the appearance image's mean one
    balance_bands: int = 1  # in how many bands of elevation TrainConfig.balance tells viewpoints apart
    focal: float = 0.4  # initial perspective: reciprocal of the camera's distance in half sides of the volume
    learn_focal: bool = True


@dataclass(frozen=True)
class TrainConfig:
    """The optimisation (sections 3 and 4.1)."""

    start: str | None = None  # a run's key or folder, or its checkpoint, whose weights come first; None: random ones
    epochs: int = 1000
    batch_size: int = 64  # target images a step
    targets_per_object: int = 1  # target images that share one appearance image
    compare_colours: float = 1.0  # viewpoints are compared by squared errors: the weight of colours
    compare_masks: float = 0.0  # and of masks
    search: float = 0.0  # in this first share of training a search over all viewpoints finds those to draw from
    search_views: int = 48  # how many viewpoints it tries a target, beside the heads'
    shared_shape: float = 0.0  # share of training in which objects come by shapes of their own; at first all have one
    neighbours: float = 0.0  # degrees: heads are compared by the best of five viewpoints so far around each; 0: itself
    pull_weight: float = 0.0  # of the pull of the best head towards the viewpoint found by search or among neighbours
    balance: float = 0.0  # how strongly viewpoints from where too many are chosen are avoided
    mirror: bool = False  # half of the targets are shown as in a mirror, as views of an object that is as likely
    learning_rate: float = 1e-4
    muon: float = 0.0  # learning rate of Muon, which then trains the networks' inner convolutions. 0: Adam
    betas: tuple[float, float] = (0.9, 0.999)
    schedule: Literal["constant", "cosine", "hold"] = "constant"  # hold: constant for 60 %, then down along a cosine
    patience: int = 30  # epochs without gain on validation before stopping
    select_by: Literal["accuracy", "reconstruction"] = "accuracy"  # what "gain" means; accuracy uses validation labels
    target: Literal["image", "mask"] = "image"
    background: Literal["black", "random"] = "black"  # behind target and reconstruction alike
    perceptual: Literal["none", "squeezenet", "vgg16"] = "vgg16"
    pixel_weight: float = 0.0  # of L1 + MSE on pixels at two scales, beside the perceptual term
    mask_weight: float = 0.0  # of the same on masks
    selection_weight: float = 1.0
    selection_angle: float = 0.0  # degrees: heads so close to the one to select are as right a choice
    trust: float = 0.0  # in training's second half the selection has a say, so strong, in which head is drawn
    cycle: bool = False  # section 3.4
    cycle_weight: float = 1.0
    cycle_start: float = 0.0  # fraction of training before the cycle sets in (then ramped up over a tenth)
    cycle_elevation: tuple[float, float] = (-36.0, 72.0)  # where its viewpoints are drawn, degrees
    cycle_head: Literal["selected", "closest"] = "selected"  # which head it pulls
    augment: bool = False  # random crop and +-3 degree rotation of the viewpoint encoder's input
    jitter: float = 0.0  # colours of that input change places, and strength by up to exp(+-2 jitter); 0: neither
    # The same input made to look as if cut from a photograph (viewnet.data.augment), with DataConfig.backgrounds only:
    sightings: int = 1  # differently made images of each target that the viewpoint network learns from
    box_error: float = 0.0  # the crop is off by up to this share of its sides
    tilt: float = 0.0  # and tilted by up to so many degrees
    occlude: float = 0.0  # in this share of the images something is before the object
    exposure: float = 0.0  # how strongly light, contrast, blur and noise vary
    amp: Literal["auto", "off"] = "auto"  # bfloat16 where the hardware has it
    validate_every: int = 1  # epochs


@dataclass(frozen=True)
class RunConfig:
    """One training: variant x category x profile x recipe x seed, with everything they stand for written out."""

    variant: str
    category: str
    profile: str
    recipe: str
    seed: int
    data: DataConfig
    model: ModelConfig = field(default_factory=ModelConfig)
    train: TrainConfig = field(default_factory=TrainConfig)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> RunConfig:
        """The inverse of `to_dict`. Unknown or missing keys and wrong types raise ViewnetError.

        >>> RunConfig.from_dict(make_config().to_dict()) == make_config()
        True
        """
        return _build(cls, values, "config")

    def key(self, *identities: str) -> str:
        """12 hex digits of everything that decides the result; `identities` add the view store's and the code's."""
        canonical = json.dumps([self.to_dict(), *identities], sort_keys=True)
        return hashlib.sha256(canonical.encode()).hexdigest()[:12]


Changes = dict[str, dict[str, Any]]
"""Section ("data", "model", "train") -> field -> value."""


def _joined(*parts: Changes) -> Changes:
    """Later parts have the last word."""
    sections = dict.fromkeys(name for part in parts for name in part)
    return {name: {k: v for part in parts for k, v in part.get(name, {}).items()} for name in sections}


RECIPES: dict[str, Changes] = {
    # As printed, and as released where the paper is silent: black background, VGG16 perceptual loss, a free focal
    # length, the viewpoint network's input cut to the object, stopping by validation accuracy.
    "paper": {"model": {"crop": "square"}, "train": {"augment": True}},
    # Ours: masks first and colours over a random background; a search for viewpoints to begin with; heads that start
    # apart; elevations within a plausible camera range; stopping without labels. See docs/recipes.md.
    "matting": {
        "model": {
            "encoder_padding": "zeros",
            "head_spread": 0.5,
            "elevation_limits": (-22.0, 42.0),
            # The camera the views are made with: a free focal length shrinks where depth is mirrored, and so hides it.
            "focal": 0.268,
            "learn_focal": False,
            "colour_prior": True,
            "balance_bands": 4,
        },
        "train": {
            "background": "random",
            "perceptual": "none",
            "pixel_weight": 0.3,
            "mask_weight": 1.0,
            "compare_colours": 0.1,
            "compare_masks": 1.0,
            "select_by": "reconstruction",
            "selection_weight": 0.2,
            "selection_angle": 30.0,
            "trust": 0.5,
            "shared_shape": 0.15,
            "search": 0.3,
            "search_views": 32,
            "neighbours": 8.0,
            "pull_weight": 1.0,
            "balance": 1.0,
            "mirror": True,
            "jitter": 0.6,
            "muon": 0.02,
            "learning_rate": 1e-3,
            "betas": (0.9, 0.99),
            "schedule": "hold",
            "cycle_weight": 0.3,
            "cycle_start": 0.15,
            "cycle_elevation": (-20.0, 40.0),
            "cycle_head": "closest",
        },
    },
}

# Section 4.3: training for photographs. Ten views a model, something behind both inputs.
RECIPES["paper_photos"] = _joined(RECIPES["paper"], {"data": {"views": 10, "backgrounds": "drawn"}})
RECIPES["photos"] = _joined(
    RECIPES["matting"],
    {
        # Cut to the object a view should still have as many pixels as the networks see.
        "data": {"views": 10, "image_size": 128, "supersample": 1, "backgrounds": "drawn"},
        "model": {"crop": "stretched"},
        "train": {"sightings": 3, "box_error": 0.05, "tilt": 5.0, "exposure": 1.0},
    },
)

VARIANTS: dict[str, Changes] = {
    "viewnet": {},
    "viewnet_cycle": {"train": {"cycle": True}},
    "single_head": {"model": {"heads": 1}},
    "segmentation_target": {"train": {"target": "mask"}},
    "no_shape_prior": {"model": {"shape_prior": False}},
    "encoder_decoder": {"model": {"decoder": "encoder_decoder"}},
    # Nothing separates object and background after learned layers: trained on black, as printed, and without masks.
    "hologan_decoder": {
        "model": {"decoder": "hologan"},
        "train": {"background": "black", "mask_weight": 0.0, "compare_masks": 0.0, "search": 0.0, "neighbours": 0.0},
    },
}
"""The trained rows of Tables 1 and 2. The constant predictor needs no training (viewnet.evaluation.evaluate)."""

_TINY: Changes = {
    "data": {"models": 1000},
    "model": {
        "volume_size": 32,
        "render_size": 32,
        "encoder_channels": (16, 32, 64, 128, 256, 128),
        "code_size": 64,
        "generator_channels": (64, 32, 16),
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
    # Three categories fit in five megabytes of half precision, small enough to come with the package.
    "pocket": _joined(
        _TINY,
        {
            "model": {
                "encoder_channels": (16, 32, 64, 128, 128, 128),
                "code_size": 32,
                "generator_channels": (32, 32, 16),
            },
            "train": {"epochs": 24, "validate_every": 6},
        },
    ),
    "small": {
        "data": {"models": 2000},
        "model": {"encoder_channels": (64, 128, 256, 512, 512, 512), "generator_channels": (256, 128, 64, 32)},
        "train": {"epochs": 60},
    },
    "paper": {"data": {"models": 0}},
}

FITTED: dict[tuple[str, str], Changes] = {("tiny", "photos"): {"train": {"epochs": 6}}}
"""What a profile and a recipe change only together: twice the views a model are half as many epochs, or less."""

# It has shapes and viewpoints already: neither is looked for again.
STARTED: Changes = {"train": {"search": 0.0, "shared_shape": 0.0}}
"""What changes for a run that starts from another one's weights."""

FILMED: dict[str, Changes] = {
    # Of the 48 Freiburg cars all frames, 5800 views: with and without cycles side by side in about ten minutes.
    # So few cars are told front from rear only while they share a shape.
    "tiny": {"train": {"epochs": 14, "shared_shape": 0.4}},
}
"""What a profile changes only for videos."""

PROFILE_RECIPE = {"smoke": "matting", "tiny": "matting", "pocket": "photos", "small": "matting", "paper": "paper"}
"""The recipe a profile uses unless another is named."""


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
    """The configuration of one run. Overrides name a field of any section, e.g. `epochs=3` or `volume_size=16`.

    Raises ViewnetError naming the valid choices for an unknown variant, category, profile, recipe or override.

    >>> make_config(category="car", recipe="photos", heads=5).model.heads
    5
    >>> make_config(profile="huge")
    Traceback (most recent call last):
    viewnet.errors.ViewnetError: unknown profile 'huge': choose one of smoke, tiny, pocket, small, paper
    """
    known(variant, VARIANTS, "variant")
    known(category, CATEGORIES, "category")
    known(profile, PROFILES, "profile")
    recipe = PROFILE_RECIPE[profile] if recipe is None else known(recipe, RECIPES, "recipe")
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ViewnetError(f"seed {seed!r}: expected a whole number of 0 or more")
    sections: dict[str, dict[str, Any]] = {
        "data": {"category": category, "root": data_root, "splits": splits},
        "model": {},
        "train": {},
    }
    fitted = FITTED.get((profile, recipe), {})
    if overrides.get("video") is not None:
        fitted = _joined(fitted, FILMED.get(profile, {}))
    if overrides.get("start") is not None:
        fitted = _joined(fitted, STARTED)
    for changes in (RECIPES[recipe], PROFILES[profile], fitted, VARIANTS[variant], _by_section(overrides)):
        for section, values in changes.items():
            sections[section].update(values)
    if data_root is not None and profile != "smoke" and "models" not in overrides:
        sections["data"]["models"] = 0
    values = {"variant": variant, "category": category, "profile": profile, "recipe": recipe, "seed": seed}
    return _build(RunConfig, {**values, **sections}, "config")


def known(value: str, choices: typing.Iterable[str], what: str) -> str:
    """`value` itself if it is one of `choices`; ViewnetError naming them all otherwise."""
    choices = tuple(choices)
    if value not in choices:
        raise ViewnetError(f"unknown {what} {value!r}: choose one of {', '.join(map(str, choices))}")
    return value


def _by_section(overrides: dict[str, Any]) -> Changes:
    changes: Changes = {}
    for name, value in overrides.items():
        for section, cls in (("data", DataConfig), ("model", ModelConfig), ("train", TrainConfig)):
            if name in {f.name for f in dataclasses.fields(cls)}:
                changes.setdefault(section, {})[name] = value
                break
        else:
            names = sorted(f.name for c in (DataConfig, ModelConfig, TrainConfig) for f in dataclasses.fields(c))
            raise ViewnetError(f"unknown setting {name!r}: choose one of {', '.join(names)}")
    return changes


def _build(cls: Any, values: Any, where: str) -> Any:
    """A dataclass from plain values, strictly: every name known, every type right, tuples restored from lists."""
    if not isinstance(values, dict):
        raise ViewnetError(f"{where}: expected a mapping, got {values!r}")
    hints = typing.get_type_hints(cls)
    if unknown := sorted(set(values) - set(hints)):
        raise ViewnetError(f"{where}: unknown setting {unknown[0]!r}: choose one of {', '.join(hints)}")
    missing = [
        f.name
        for f in dataclasses.fields(cls)
        if f.name not in values and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise ViewnetError(f"{where}: {missing[0]!r} is missing")
    return cls(**{name: _typed(hints[name], value, f"{where}.{name}") for name, value in values.items()})


def _typed(hint: Any, value: Any, where: str) -> Any:
    """`value` as the annotated type `hint`; ViewnetError where it is of another."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return _build(hint, dataclasses.asdict(value) if isinstance(value, hint) else value, where)
    if origin is Literal:
        return known(value, args, where)
    if origin in (types.UnionType, typing.Union):
        if value is None and type(None) in args:
            return None
        return _typed(next(a for a in args if a is not type(None)), value, where)
    if origin is tuple and isinstance(value, (tuple, list)):
        kinds = [args[0]] * len(value) if args[-1] is Ellipsis else list(args)
        if len(kinds) == len(value):
            return tuple(_typed(kind, item, where) for kind, item in zip(kinds, value, strict=True))
    if hint is float and isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300:
        return float(value)
    if origin is None and isinstance(value, hint) and (hint is bool or not isinstance(value, bool)):
        return value
    raise ViewnetError(f"{where}: expected {getattr(hint, '__name__', hint)}, got {value!r}")
