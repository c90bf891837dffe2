"""The tables of the paper: their rows, categories and metrics."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from viewnet.config import SHAPENET_CATEGORIES
from viewnet.errors import ViewnetError
from viewnet.recipes import ABLATIONS, RECIPES, make_config
from viewnet.tables.columns import HEADLINE, upper_bound

ADDED = "method"
"""The variant of rows for the user's own methods (viewnet.experiments.own_method)."""
MARKS = {None: "", "linear": "*", "robust": " (robust)"}
"""Alignment of a row -> what its label ends with, as in the paper."""


PAIRS = "pairs + masks"
"""What ViewNet knows of its training images: which show the same object, and where in them it is."""
_RANGE = f"{PAIRS}, range of elevations"
"""And with our recipes, which limit predictions to the elevations of the views. The paper does not know them."""
CALIBRATION = "viewpoints of calibration images"
TRAINING = "viewpoints of training images"
IMAGENET = "ImageNet labels"
NONE = "none"


@dataclass(frozen=True)
class Row:
    """A row of a table."""

    name: str  # its label without the mark of an alignment
    variant: str | None = None  # the variant that fills it; None: this project has no such method
    alignment: str | None = None  # of its predictions; None: the usual one of its variant
    supervision: str = PAIRS  # what is known in training, beyond images
    optional: bool = False  # whether it is measured and shown only where it is asked for

    @property
    def label(self) -> str:
        """The name with the mark of the alignment."""
        return self.name + MARKS[self.alignment]

    def supervision_as(self, label: str, recipe: str = "") -> str:
        """What is known in training by `recipe`, in a row shown as `label`: features of pixels need no labels."""
        if self.variant and recipe in RECIPES and self.supervision == PAIRS:
            return _RANGE if make_config(self.variant, recipe=recipe).model.elevation_limits else PAIRS
        return self.supervision.removeprefix(f"{IMAGENET}, ") if label.endswith("(pixels)") else self.supervision


@dataclass(frozen=True)
class Layout:
    """A table of the paper, its rows from top to bottom."""

    title: str
    rows: tuple[Row, ...]
    categories: tuple[str, ...] = SHAPENET_CATEGORIES  # its columns by default
    metrics: tuple[str, ...] = HEADLINE  # of each row and category
    own: dict[str, str] = field(default_factory=dict)  # label -> metric, for rows with a metric of their own
    reported: bool = True  # whether the paper has it: its numbers are in the file of published/ with its name
    reported_as: dict[str, str] = field(default_factory=dict)  # label -> row of that file, where they differ
    blocks: bool = False  # whether metrics stand one below the other instead of side by side

    @property
    def variants(self) -> tuple[str, ...]:
        """The variants that fill its rows."""
        return tuple(dict.fromkeys(row.variant for row in self.rows if row.variant))

    @property
    def usual(self) -> tuple[str, ...]:
        """The variants that fill its rows but for optional ones."""
        return tuple(dict.fromkeys(row.variant for row in self.rows if row.variant and not row.optional))

    @property
    def reference(self) -> str:
        """The label of the row that others are compared with: ViewNet's, by its usual alignment if it is there."""
        own = [row.label for row in sorted(self.rows, key=lambda row: bool(row.alignment)) if row.variant == "viewnet"]
        return own[0] if own else ""

    def rows_of(self, variant: str) -> list[Row]:
        """The rows that a variant fills."""
        return [row for row in self.rows if row.variant == variant]

    def extended(self, labels: Iterable[str]) -> "Layout":
        """The layout with a row for each of `labels` added. ViewnetError for a label that is taken.

        Upper bounds come last.
        """
        rows = self.rows
        for label in labels:
            if label in {*self.reported_as.values(), *(row.label for row in rows)}:
                raise ViewnetError(f"row {label!r}: the table has a row of that name: choose another label")
            rows += (Row(label, ADDED, supervision=""),)
        rows = tuple(sorted(rows, key=lambda row: upper_bound(row.supervision)))  # stable
        return replace(self, rows=rows)


def _aligned(name: str, variant: str = "viewnet") -> tuple[Row, ...]:
    """The rows of one training, one for each alignment; the robust one is not in the paper."""
    return tuple(Row(name, variant, alignment) for alignment in ("linear", None, "robust"))


_SINGLE_IMAGES = "single images, range of viewpoints, mirror symmetry"
_ON_PHOTOGRAPHS = (
    Row("SSV (reduced)", "ssv", "linear", _SINGLE_IMAGES),
    *_aligned("ViewNet"), *_aligned("ViewNet + cycle", "viewnet_cycle"),
    *_aligned("ViewNet, backgrounds behind both", "behind_both"),  # as in the paper
)  # fmt: skip
_VIEWPOINTS, _BOXES = "absolute viewpoints", "absolute viewpoints, boxes"
_SUPERVISED = (
    Row("Liao (trained here)", "spherical_regression", None, _VIEWPOINTS),
    Row("Liao (trained here, SqueezeNet)", "spherical_regression_imagenet", None, f"{_VIEWPOINTS}, {IMAGENET}", True),
    Row("Grabner (trained here)", "box_corners", None, _BOXES),
    Row("Grabner (trained here, SqueezeNet)", "box_corners_imagenet", None, f"{_BOXES}, {IMAGENET}", True),
)
"""Trained with viewpoints, on CAD models as all are here; the paper's rows of these methods saw photographs.

Those of a pretrained network are optional: its weights come from a file of the user's."""
_FITTED = (
    Row("Constant", "constant", supervision=CALIBRATION),
    # Not in the paper: the mean of frames, not of view vectors.
    Row("Constant (rotation)", "constant_rotation", supervision=CALIBRATION),
    Row("VGG view*", "view_regression", supervision=f"{IMAGENET}, {CALIBRATION}"),
)

_TAKEN_AWAY = {
    "pull": "pull to a better viewpoint",
    "temperature": "shares in the selection",
    "head_spread": "heads that start apart",
    "betas": "Adam's faster second moment",
    "learning_rate": "learning rate of 1e-3",
    "muon": "Muon",
    "schedule": "falling learning rate",
}

LAYOUTS = {
    "table1_shapenet": Layout(
        "ShapeNet results of unsupervised methods",
        (
            Row("MVC", "mvc", supervision=f"{PAIRS}, camera, distribution of viewpoints"),
            Row("Pointcloud", "pointcloud", supervision=f"{PAIRS}, camera"),
            Row("ViewNet", "viewnet"), Row("ViewNet + cycle", "viewnet_cycle"),
            Row("ViewNet, as many targets", "as_many_targets"),  # not in the paper: as MVC and Pointcloud have here
            Row("SSV (reduced)", "ssv", supervision=_SINGLE_IMAGES),  # not in the paper: no pairs
            # Not in the paper: what more supervision would bring.
            Row("VpDR-Net (pairs of CAD views)", "relative_pose", supervision="relative rotations"), *_SUPERVISED,
        ),
    ),
    "table2_ablation": Layout(
        "Ablation study",
        (
            Row("ViewNet", "viewnet"), Row("Single-head", "single_head"),
            Row("Segmentation Target", "segmentation_target"), Row("No Shape Prior", "no_shape_prior"),
            Row("Encoder-Decoder", "encoder_decoder"), Row("HoloGAN-Decoder", "hologan_decoder"),
            Row("ViewNet without search", "no_search"),  # not in the paper: what HoloGAN's row is compared with
            Row("Constant", "best_constant", supervision=TRAINING),
            # The mean of view vectors, which points to the sky.
            Row("Constant, as printed", "constant", supervision=TRAINING),
            Row("Random", "random", supervision=NONE),  # not in the paper
        ),
    ),
    "recipe_ablation": Layout(
        "What each setting of the recipe matting brings",
        (Row("ViewNet", "viewnet"),
         *(Row(f"without {_TAKEN_AWAY.get(name, name.replace('_', ' '))}", f"without_{name}") for name in ABLATIONS)),
        reported=False,
    ),
    "test_sets": Layout(
        "ViewNet on other test models",
        (Row("Test split", "viewnet"), Row("Another seed", "viewnet"), Row("Another collection", "viewnet")),
        reported=False,
    ),
    "table3_pascal3d": Layout(
        "PASCAL3D+ results",
        (
            *_FITTED, Row("SSV*", supervision="single images, range of viewpoints"), *_ON_PHOTOGRAPHS,
            Row("Liao (withdrawn)", supervision=f"absolute viewpoints, {IMAGENET}"),
            Row("Liao (corrected)", supervision=f"absolute viewpoints, {IMAGENET}"),
            Row("Grabner", supervision=f"absolute viewpoints, boxes, {IMAGENET}"),
            *_SUPERVISED,
        ),
        reported_as={"Liao (withdrawn)": "Liao"}, blocks=True,
    ),
    "photographs_study": Layout(
        "Photographs: what is lost where",
        (
            Row("ViewNet", "viewnet", "robust"), Row("ViewNet over black", "over_black", "robust"),
            Row("Student of ViewNet", "student", "robust", _RANGE),
            Row("Student of ViewNets over black", "student_of_black", "robust", _RANGE),
            Row("ViewNet, 128 pixels", "larger_input", "robust"),
            Row("ViewNet, backgrounds behind both", "behind_both", "robust"),
            Row("VGG view", "view_regression", supervision=f"{IMAGENET}, {CALIBRATION}"),
            Row("Viewpoints of CAD views", "spherical_regression", None, _VIEWPOINTS),
            Row("the same, 128 pixels", "spherical_regression_larger", None, _VIEWPOINTS),
            Row("the same, SqueezeNet", "spherical_regression_imagenet", None, f"{_VIEWPOINTS}, {IMAGENET}", True),
            Row("the same, SqueezeNet frozen", "spherical_regression_frozen", None, f"{_VIEWPOINTS}, {IMAGENET}", True),
        ),
        categories=("car",), metrics=(*HEADLINE, "flips", "dva"), reported=False, blocks=True,
    ),
    "table4_freiburg": Layout(
        "Trained on Freiburg Cars, evaluated on PASCAL3D+",
        (
            Row("Constant", "constant", supervision=CALIBRATION),  # not in the paper
            # Reported with Table 3's numbers, so fitted as there, on calibration photographs.
            Row("VGG view", "view_regression", supervision=f"{IMAGENET}, {CALIBRATION}"),
            # Not in the paper: fitted on the videos' viewpoints.
            Row("VGG view, videos", "video_regression", supervision=f"{IMAGENET}, {TRAINING}"),
            Row("ViewNet", "viewnet"), Row("ViewNet + cycle", "viewnet_cycle"),
            Row("VpDR-Net + FrC", supervision=f"relative rotations, {IMAGENET}"),
            Row("VpDR-Net (trained here)", "relative_pose", supervision="relative rotations"),
        ),
        categories=("car",), blocks=True,
    ),
    "objectron": Layout(
        "Trained on Objectron, evaluated on PASCAL3D+",
        (
            Row("Constant", "constant", supervision=CALIBRATION),  # not in the paper
            *_aligned("ShapeNet"), *_aligned("+ Objectron, supervised masks"), *_aligned("+ Objectron, weak masks"),
        ),
        categories=("chair",), blocks=True,
    ),
    "table5_dva": Layout(
        "Discretized viewpoint accuracy",
        (
            Row("Confidence index", "photographs", supervision=NONE), *_FITTED, *_ON_PHOTOGRAPHS, *_SUPERVISED,
        ),
        metrics=("dva",), own={"Confidence index": "confidence_index"}, blocks=True,
    ),
}  # fmt: skip

LABELS = {
    row.variant: row.name
    for name in ("table3_pascal3d", "table1_shapenet", "table2_ablation")
    for row in LAYOUTS[name].rows
    if row.variant is not None
}
"""Trained variant, or constant -> its label in the paper's tables."""
