"""The tables of the paper: their rows, columns and measures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from viewnet.config import SHAPENET_CATEGORIES
from viewnet.errors import ViewnetError

HEADLINE = ("acc30", "median")
"""The two measures of the paper's tables."""
ADDED = "method"
"""The variant of rows that a reader's own methods fill (viewnet.experiments.own_method)."""


@dataclass(frozen=True)
class Layout:
    """A table of the paper.

    rows        (label, variant), the variant None where this project has no such method. A label that ends in a star
                is of predictions aligned linearly, one that ends in (robust) of such that are aligned robustly.
    categories  its columns unless others are asked for
    metrics     what a row holds for a category
    own         rows that hold something else
    printed     the file of printed numbers, where it is not named like the table
    printed_as  label -> row of that file, where they differ
    blocks      whether metrics stand one below the other, and not side by side
    videos      the data set of videos that its rows are trained on: "freiburg", "objectron" or none
    """

    title: str
    rows: tuple[tuple[str, str | None], ...]
    categories: tuple[str, ...] = SHAPENET_CATEGORIES
    metrics: tuple[str, ...] = HEADLINE
    own: dict[str, str] = field(default_factory=dict)
    printed: str | None = None
    printed_as: dict[str, str] = field(default_factory=dict)
    blocks: bool = False
    videos: str = ""

    @property
    def variants(self) -> tuple[str, ...]:
        """The variants to have predictions of."""
        return tuple(dict.fromkeys(variant for _, variant in self.rows if variant))

    def labels(self, variant: str) -> list[str]:
        """The rows that a variant fills."""
        return [label for label, mine in self.rows if mine == variant]

    def extended(self, labels: Iterable[str]) -> Layout:
        """The same with a row below for each of `labels`. ViewnetError for one that is a row, or is in print."""
        rows = dict(self.rows)
        for label in labels:
            if label in rows or label in self.printed_as.values():
                raise ViewnetError(f"row {label!r}: there is one of that name already: choose another label")
            rows[label] = ADDED
        return replace(self, rows=tuple(rows.items()))


def alignment_of(label: str) -> str | None:
    """The alignment that a row's label names, where it names one."""
    return "linear" if label.endswith("*") else "robust" if label.endswith("(robust)") else None


def unaligned(label: str) -> str:
    """A row's label without the alignment that it names."""
    return label.removesuffix("*").removesuffix(" (robust)")


def _aligned(label: str, variant: str = "viewnet") -> tuple[tuple[str, str | None], ...]:
    """The rows of one training by each alignment; the robust one is never in print."""
    return (f"{label}*", variant), (label, variant), (f"{label} (robust)", variant)


_ON_PHOTOGRAPHS = (*_aligned("ViewNet"), *_aligned("ViewNet + cycle", "viewnet_cycle"))

LAYOUTS = {
    "table1_shapenet": Layout(
        "ShapeNet results of unsupervised methods",
        (("MVC", None), ("Pointcloud", None), ("ViewNet", "viewnet"), ("ViewNet + cycle", "viewnet_cycle")),
    ),
    "table2_ablation": Layout(
        "Ablation study",
        (
            ("ViewNet", "viewnet"),
            ("Single-head", "single_head"),
            ("Segmentation Target", "segmentation_target"),
            ("No Shape Prior", "no_shape_prior"),
            ("Encoder-Decoder", "encoder_decoder"),
            ("HoloGAN-Decoder", "hologan_decoder"),
            ("Constant", "constant"),
            ("Best constant", "best_constant"),  # not in print: the printed constant points to the sky
        ),
    ),
    "table3_pascal3d": Layout(
        "PASCAL3D+ results",
        (
            ("Constant", "constant"),
            ("Constant (rotation)", "constant_rotation"),  # not in print: the mean of frames and not of view vectors
            ("VGG view*", "view_regression"),
            ("SSV*", None),
            *_ON_PHOTOGRAPHS,
            ("Liao (withdrawn)", None),
            ("Liao (corrected)", None),
            ("Grabner", None),
        ),
        printed_as={"Liao (withdrawn)": "Liao"},
        blocks=True,
    ),
    "table4_freiburg": Layout(
        "Trained on Freiburg Cars, evaluated on PASCAL3D+",
        (
            ("Constant", "constant"),  # not in print
            # Printed with Table 3's numbers, so fitted as there, on calibration photographs.
            ("VGG view", "view_regression"),
            ("VGG view, videos", "video_regression"),  # not in print: fitted on the videos' viewpoints
            ("VpDR-Net + FrC", None),
            ("ViewNet", "viewnet"),
            ("ViewNet + cycle", "viewnet_cycle"),
        ),
        categories=("car",),
        printed="table5_freiburg",
        blocks=True,
        videos="freiburg",
    ),
    "objectron": Layout(
        "Trained on Objectron, evaluated on PASCAL3D+",
        (
            ("Constant", "constant"),  # not in print
            *_aligned("ShapeNet"),
            *_aligned("+ Objectron, supervised masks"),
            *_aligned("+ Objectron, weak masks"),
        ),
        categories=("chair",),
        blocks=True,
        videos="objectron",
    ),
    "table5_dva": Layout(
        "Discretized viewpoint accuracy",
        (
            ("Confidence index", "photographs"),
            ("Constant", "constant"),
            ("Constant (rotation)", "constant_rotation"),
            ("VGG view*", "view_regression"),
            *_ON_PHOTOGRAPHS,
        ),
        metrics=("dva",),
        own={"Confidence index": "confidence_index"},
        printed="table4_dva",
        blocks=True,
    ),
}

LABELS = {
    variant: label
    for name in ("table1_shapenet", "table2_ablation")
    for label, variant in LAYOUTS[name].rows
    if variant is not None
}
"""Variant -> what the paper's tables of trained models call it."""
