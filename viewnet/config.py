"""The settings of a run as frozen dataclasses: its views, its networks, its training.

Values for them come from profiles, recipes and variants (viewnet.recipes). After each setting stand its meaning and
unit, its source in brackets (a section, table or equation of the paper; "released": the authors' code where the
paper is silent; "ours"), and who changes it: P profiles, R recipes, V variants (rows of the tables), U users alone.
"""

import dataclasses
import difflib
import hashlib
import json
import re
import types
import typing
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
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

LIMITS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("seed", "sequences"), (0, 2**32 - 1)),
    **dict.fromkeys(("models", "count"), (0, 1_000_000)),
    **dict.fromkeys(("epochs", "patience", "validate_every", "frames", "videos"), (1, 1_000_000)),
    "views": (1, 10_000),
    "image_size": (1, 4096),
    "supersample": (1, 16),
    "size": (1, 1024),
    "input_size": (8, 512),
    **dict.fromkeys(("volume_size", "render_size"), (8, 256)),
    **dict.fromkeys(("encoder_channels", "generator_channels"), (1, 2048)),
    **dict.fromkeys(("code_size", "appearance_size"), (1, 16_384)),
    **dict.fromkeys(("heads", "search_views"), (1, 1024)),
    **dict.fromkeys(("batch_size", "targets_per_object"), (1, 4096)),
    "views_per_target": (1, 64),
    "margin": (0, 2),
    "side": (0, 4096),
    **dict.fromkeys(("backdrop", "focal", "search", "blur", "box_error", "extra_share"), (0, 1)),
    **dict.fromkeys(("neighbours", "tilt"), (0, 180)),
    "azimuth_range": (-360, 720),
    **dict.fromkeys(("elevation_range", "elevation_limits"), (-90, 90)),
    "learning_rate": (1e-12, 1e12),
    **dict.fromkeys(("muon", "head_spread", "exposure", "selection_temperature"), (0, 1e6)),
    **dict.fromkeys(("pull_weight", "cycle_weight", "pixel_weight", "mask_weight"), (0, 1e6)),
    "betas": (0, 0.999999),
}
"""Setting -> the least and the most that it, or each of its values, may be: beyond, it fails or fills the memory."""
MOST_WIDTHS = 16  # of encoder_channels and generator_channels: each halves or doubles a side


@dataclass(frozen=True)
class DataConfig:
    """Views of one category to train on: rendered from CAD models (section 4.2), or frames of videos (section 4.4)."""

    category: str  # a PASCAL3D+ name, of own data any other [4.2] (U)
    root: str | None = None  # ShapeNetCore folder, v1 or v2 layout; None: built-in models [4.2] (U)
    splits: str | None = None  # folder of <synset>_{train,val,test}.txt; None: all.csv, else a seeded split [4.2] (U)
    models: int = 1000  # built-in: how many to make; real: at most so many, 0 for all [ours] (P)
    extra: str | None = None  # second ShapeNetCore folder whose models all join the training split [ours] (U)
    extra_share: float = 0.3  # its share of the training models, where `models` counts the others [ours] (U)
    views: int = 5  # rendered views of each model [4.2; 10 in 4.3] (R)
    image_size: int = 64  # pixels a side of the stored views [4.2] (P, R)
    supersample: int = 2  # samples a pixel and axis when rendering [ours] (P, R)
    azimuth_range: tuple[float, float] = (0.0, 360.0)  # degrees, uniform [4.2] (U)
    elevation_range: tuple[float, float] = (-20.0, 40.0)  # degrees, uniform [4.2] (U)
    seed: int = 0  # of models and viewpoints [ours] (U)
    renderer: Literal["auto", "raycast", "pyrender"] = "auto"  # [ours] (U)
    # Behind inputs in training (photo.cut_out), never behind the target: a folder (SUN397) or "drawn" [4.3] (R)
    backgrounds: str | None = None
    video: "VideoConfig | None" = None  # views are frames of its clips: only backgrounds count beside [4.4] (U)


@dataclass(frozen=True)
class PhotoConfig:
    """Photographs of one category to score on (section 4.3), and how they are cropped."""

    category: str
    root: str | None = None  # PASCAL3D+ 1.1, ImageNet3D, photographs or crops with a list; None: a stand-in is made
    subset: Literal["imagenet", "pascal", "both"] = "imagenet"  # of PASCAL3D+; its "train" calibrates, its "val" scores
    keep: Literal["all", "easy", "first"] = "all"  # easy: not difficult, truncated or occluded; first: of each image
    size: int = 64  # pixels a side
    margin: float = 0.0  # beyond the box on either side, as a share of its longer side
    square: bool = True  # whether the object keeps its shape, or its box is stretched to a square
    models: int = 60  # of the stand-in: CAD models a split
    count: int = 600  # of the stand-in: photographs a split
    backgrounds: str | None = None  # of the stand-in: a folder of images; None: drawn ones
    seed: int = 0  # of the stand-in


@dataclass(frozen=True)
class VideoConfig:
    """Videos of one category to train on (section 4.4), and how their objects are cropped."""

    category: str
    root: str | None = None  # Freiburg cars, Objectron, uCO3D, a folder of videos or of frames; None: a stand-in
    # auto: by what lies in root; without one the stand-in is of Freiburg for cars, of Objectron for others
    kind: Literal["auto", "freiburg", "objectron", "uco3d", "folder"] = "auto"
    split_rule: Literal["45/2/rest", "all"] = "45/2/rest"  # Freiburg's sequences by number; all: train on every clip
    count: int = 0  # frames a clip, 0 for all
    pick: Literal["random", "evenly"] = "random"  # which frames
    masks: Literal["files", "alpha", "maskrcnn", "deeplabv3", "none"] = "files"
    mask_folder: str = "masks"  # of masks in files, within root or anywhere, laid out as root's own masks/ is
    size: int = 128  # pixels a side
    margin: float = 0.05  # beyond the object on either side, as a share of its longer side
    square: bool = True  # whether the object keeps its shape, or its box is stretched to a square
    scale: Literal["clip", "view"] = "clip"  # with masks: one object height a clip, or every view filled
    side: float = 16.0  # pixels: objects whose shorter side is less are left out
    blur: float = 0.0  # frames less sharp than this share of their clip's median are left out
    seed: int = 0  # of picking frames, of splits that are not given, and of the stand-in
    sequences: tuple[int, ...] = ()  # Freiburg's stand-in: their numbers; (): the 48 of the data set
    videos: int = 60  # Objectron's stand-in: how many
    frames: int = 120  # of the stand-ins: frames a clip


@dataclass(frozen=True)
class ModelConfig:
    """The networks and the volume renderer (section 3 and the supplement's architecture tables)."""

    input_size: int = 64  # pixels a side of what both encoders see [4.1] (P)
    volume_size: int = 64  # voxels a side [supplement] (P)
    render_size: int = 64  # pixels a side of reconstructions [4.1] (P)
    # The viewpoint network sees the object's square box enlarged, or its own box stretched [released] (R)
    crop: Literal["none", "square", "stretched"] = "none"
    backdrop: float = 0.0  # grey level in [0, 1] behind what both encoders see [released] (U)
    encoder_channels: tuple[int, ...] = (64, 128, 256, 512, 512, 512)  # [supplement] (P)
    code_size: int = 1024  # channels of the fixed canonical code [supplement] (P)
    generator_channels: tuple[int, ...] = (512, 128, 128, 16)  # at 4, 8, 16, 32 voxels a side [supplement] (P)
    generator_refine: bool = True  # a second, 3x3x3 layer at each resolution [supplement] (P)
    generator_last_kernel: Literal[2, 4] = 4  # of the layer to full resolution; 2: far cheaper [supplement; ours] (P)
    appearance_size: int = 256  # channels of the appearance code [supplement] (P)
    heads: int = 3  # M, viewpoint hypotheses an image [3.1, 4.1] (V)
    head_spread: float = 0.0  # length of a vector added to each head's, evenly around the object [ours] (R)
    elevation_limits: tuple[float, float] | None = None  # degrees of predicted elevations; None: the sphere [ours] (R)
    in_plane: bool = False  # learn the camera's up vector too [3.1, the general case] (U)
    decoder: Literal["adain", "encoder_decoder", "hologan"] = "adain"  # [3.2, Table 2] (V)
    shape_prior: bool = True  # the Gaussian S in Q = S + Q' [3.3, Table 2] (V)
    # Perspective: half sides of the volume over the camera's distance. None: learned, from 0.4 on [3.2, released] (U)
    focal: float | None = None


def _setting(default: Any, name: str) -> Any:
    """A field of a group, set from outside by the one name that no other setting has."""
    return field(default=default, metadata={"setting": name})


@dataclass(frozen=True)
class ComparisonConfig:
    """How the hypotheses of a target are compared: equation 2, whose minimum is the head that learns."""

    neighbours: float = 0.0  # degrees to the four viewpoints tried around each head; 0: only its own [ours] (R)
    pull_weight: float = 1.0  # of the squared distance from the best head to a better viewpoint tried [ours] (V)
    # The selection is taught softmax(-error / (temperature * least error)), [ours]; 0: the best head [3.1] (R)
    temperature: float = _setting(0.0, "selection_temperature")


@dataclass(frozen=True)
class SearchConfig:
    """The search for viewpoints around the whole object, beside the heads', that begins training (ours)."""

    share: float = _setting(0.0, "search")  # of training during which it runs [ours] (R)
    views: int = _setting(32, "search_views")  # viewpoints tried for each target [ours] (U)


@dataclass(frozen=True)
class CycleConfig:
    """Cycle consistency: novel views are rendered, and their known viewpoints predicted (section 3.4)."""

    on: bool = _setting(False, "cycle")  # [3.4, Table 1] (V)
    weight: float = _setting(1.0, "cycle_weight")  # [released] (R)
    head: Literal["selected", "closest"] = _setting("selected", "cycle_head")  # which head it pulls [released] (R)


@dataclass(frozen=True)
class OptimiserConfig:
    """Adam (section 4.1), beside Muon where it is asked for."""

    learning_rate: float = 1e-4  # of Adam [4.1] (R)
    betas: tuple[float, float] = (0.9, 0.999)  # of Adam [4.1] (R)
    muon: float = 0.0  # learning rate of Muon for the networks' inner convolutions; 0: Adam for all [ours] (R)
    schedule: Literal["constant", "cosine", "hold"] = "constant"  # hold: constant for 60 %, then cosine [ours] (R)


@dataclass(frozen=True)
class PhotoAugmentationConfig:
    """The viewpoint network's input made to look like a crop of a photograph (viewnet.data.augment; section 4.3).

    Only with DataConfig.backgrounds.
    """

    views_per_target: int = 1  # differently made images of each target [ours] (R)
    box_error: float = 0.0  # the crop is off by up to this share of its sides [ours] (R)
    tilt: float = 0.0  # degrees: and tilted by up to so much [ours] (R)
    exposure: float = 0.0  # strength of changes of light, contrast, blur and noise [ours] (R)
    cut_out: bool = False  # whether the appearance network sees the object alone, cut out by its mask [ours] (R, P, V)


@dataclass(frozen=True)
class TrainConfig:
    """The optimisation (sections 3 and 4.1). ViewnetError for numbers of targets that cannot be trained with."""

    start: str | None = None  # run key, folder or checkpoint whose weights come first; None: random ones [4.3] (U)
    epochs: int = 1000  # an epoch has as many targets as there are views [4.1] (P)
    batch_size: int = 64  # target images a step [4.1] (P)
    targets_per_object: int = 1  # target images that share one appearance image [ours] (P)
    target: Literal["image", "mask"] = "image"  # what is reconstructed [3.2, Table 2] (V)
    perceptual: Literal["none", "squeezenet", "vgg16"] = "vgg16"  # network of the perceptual loss [3.2, 4.1] (R)
    pixel_weight: float = 0.0  # of L1 + MSE of pixels at two scales [ours] (R)
    mask_weight: float = 0.0  # of L1 + MSE of masks at two scales, and of masks in comparing heads [ours] (R, V)
    augment: bool = False  # random crop and rotation by +-3 degrees of the viewpoint network's input [released] (R)
    patience: int = 30  # epochs without improvement on validation views before stopping [4.1] (P)
    select_by: Literal["accuracy", "reconstruction"] = "accuracy"  # "improvement"; accuracy needs labels [4.1] (R)
    validate_every: int = 1  # epochs [ours] (P)
    amp: Literal["auto", "off"] = "auto"  # bfloat16 where the hardware has it [ours] (U)
    comparison: ComparisonConfig = field(default_factory=ComparisonConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    cycle: CycleConfig = field(default_factory=CycleConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    photo: PhotoAugmentationConfig = field(default_factory=PhotoAugmentationConfig)

    @property
    def objects(self) -> int:
        """Appearance images a step."""
        return self.batch_size // self.targets_per_object

    def __post_init__(self) -> None:
        together = f"batch_size {self.batch_size} with targets_per_object {self.targets_per_object}"
        if self.targets_per_object < 1 or self.batch_size % self.targets_per_object:
            raise ViewnetError(f"{together}: expected a multiple of it, and 1 or more")
        if self.objects < 2:
            raise ViewnetError(f"{together} is one object a step: batch normalisation needs two or more")


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
    def from_dict(cls, values: dict[str, Any]) -> "RunConfig":
        """The inverse of `to_dict`. Unknown or missing keys and wrong types raise ViewnetError."""
        return build(cls, values, "config")

    def key(self, *identities: str) -> str:
        """12 hex digits of everything that decides the result; `identities` add the view store's and the code's."""
        canonical = json.dumps([self.to_dict(), *identities], sort_keys=True)
        return hashlib.sha256(canonical.encode()).hexdigest()[:12]

    def settings_key(self) -> str:
        """12 hex digits of every setting that is not at its default: says whether a run kept from an earlier version,
        which may have had fewer settings, is the one that is asked for.
        """
        usual = replace(self, data=DataConfig(self.category), model=ModelConfig(), train=TrainConfig())
        changed = _differences(self.to_dict(), usual.to_dict())
        named = [self.variant, self.category, self.profile, self.recipe, self.seed]
        return hashlib.sha256(json.dumps([named, changed], sort_keys=True).encode()).hexdigest()[:12]


def _differences(values: dict[str, Any], usual: dict[str, Any]) -> dict[str, Any]:
    """The values that are not the usual ones, of groups of values those within them."""
    found = {}
    for name, value in values.items():
        other = usual.get(name)
        if isinstance(value, dict) and isinstance(other, dict):
            value, other = _differences(value, other), {}
        if value != other:
            found[name] = value
    return found


def settings(cls: Any = RunConfig, path: tuple[str, ...] = ()) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every setting's name and where it stands: ("search_views", ("train", "search", "views"))."""
    hints = typing.get_type_hints(cls)
    for each in dataclasses.fields(cls):
        place = (*path, each.name)
        if dataclasses.is_dataclass(hints[each.name]):
            yield from settings(hints[each.name], place)
        elif path:  # what stands beside the sections names the run
            yield each.metadata.get("setting", each.name), place


def known(value: str, choices: Iterable[str], what: str) -> str:
    """`value` itself if it is one of `choices`; ViewnetError naming them all and the `nearest` otherwise."""
    choices = tuple(choices)
    if value not in choices:
        names = ", ".join(map(str, choices))
        raise ViewnetError(f"unknown {what} {value!r}: choose one of {names}{nearest(value, choices)}")
    return value


def known_category(name: str, own: object = True) -> str:
    """`name` itself if it is a category: one of CATEGORIES, of people's own data any name. ViewnetError otherwise."""
    if own and not re.fullmatch(r"\w[\w-]{0,49}", name):
        raise ViewnetError(f"category {name!r}: expected letters, digits, _ and -, 50 at most, such as teapot")
    return name if own else known(name, CATEGORIES, "category")


def nearest(value: object, choices: Iterable[object]) -> str:
    """The end of a message that names what may have been meant; "" where nothing is spelt much alike.

    >>> nearest("Cart", ["car", "chair"]), nearest("table", ["car", "chair"])
    (". Did you mean 'car'?", '')
    """
    names = {str(name).lower(): name for name in choices}
    close = difflib.get_close_matches(str(value).lower(), names, 1)
    return f". Did you mean {names[close[0]]!r}?" if close else ""


def build(cls: Any, values: Any, where: str) -> Any:
    """A dataclass from plain values, strictly: every name known, every type right, tuples restored from lists.

    Raises ViewnetError naming what is wrong, within `where`.
    """
    if not isinstance(values, dict):
        raise ViewnetError(f"{where}: expected a mapping, got {values!r}")
    hints = typing.get_type_hints(cls)
    if unknown := sorted(set(values) - set(hints)):
        raise ViewnetError(
            f"{where}: unknown setting {unknown[0]!r}: choose one of {', '.join(hints)}{nearest(unknown[0], hints)}"
        )
    fields = dataclasses.fields(cls)
    required = (f.name for f in fields if f.default is f.default_factory is dataclasses.MISSING)
    if missing := [name for name in required if name not in values]:
        raise ViewnetError(f"{where}: {missing[0]!r} is missing")
    typed = {name: _typed(hints[name], value, f"{where}.{name}") for name, value in values.items()}
    for each in fields:
        _check_limits(each.metadata.get("setting", each.name), typed.get(each.name))
    return cls(**typed)


def _check_limits(name: str, value: Any) -> None:
    """Raise ViewnetError for a setting beyond its `LIMITS`, ranges from high to low, and too many channels."""
    if name not in LIMITS or value is None or dataclasses.is_dataclass(value):
        return
    (least, most), numbers = LIMITS[name], value if isinstance(value, tuple) else (value,)
    if not all(least <= number <= most for number in numbers):
        raise ViewnetError(f"{name} {value!r:.80}: expected {least:.10g} to {most:.10g}")
    if name.endswith(("_range", "_limits")) and numbers[0] > numbers[1]:
        raise ViewnetError(f"{name} {value}: expected the lower angle first")
    if name.endswith("_channels") and not 1 <= len(numbers) <= MOST_WIDTHS:
        raise ViewnetError(f"{name}: {len(numbers)} of them: expected 1 to {MOST_WIDTHS}")


def _typed(hint: Any, value: Any, where: str) -> Any:
    """`value` as the annotated type `hint`; ViewnetError where it is of another."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return build(hint, dataclasses.asdict(value) if isinstance(value, hint) else value, where)
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
