"""How much work a collection is, on paper: views, disk space, rendering and training, from rates that were measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

from viewnet.errors import ViewnetError
from viewnet.recipes import make_config
from viewnet.runtime.splits import SHARES

SHAPENETCORE = (55, 51_300)
"""Categories of ShapeNetCore, and how many models they have together, about."""
RENDERING = {64: (309.0, 854.0)}
"""Image side -> views a second and core, slowest and fastest category, measured on the built-in models. Those of
ShapeNet, read from a disk and often of more faces, are not measured, nor is any other side."""


@dataclass(frozen=True)
class Work:
    """What a collection asks for. None: a rate it follows from was not measured."""

    views: int
    store_bytes: int
    core_hours: tuple[float, float] | None  # of rendering, least and most
    targets: int  # images that all trainings together go through
    device_hours: float | None  # of training


def work(
    models: int,
    *,
    views: int,
    size: int,
    epochs: int,
    rendering: tuple[float, float] | None,
    training: float | None,
    runs: int = 1,
) -> Work:
    """The work of rendering `views` views of each model, `size` pixels a side, and training on all of them.

    rendering  views a second and core, slowest and fastest
    training   targets a second and device (a GPU, or a core): batch_size times steps a second
    runs       trainings of each category: variants times seeds

    A run sees each of its training views `epochs` times as a target. Raises ViewnetError for what is not above 0.

    >>> found = work(1000, views=5, size=64, epochs=14, rendering=None, training=100.0)
    >>> found.views, found.store_bytes, found.targets, round(found.device_hours, 2)
    (5000, 81920000, 49000, 0.14)
    """
    rates = {"rendering": min(rendering) if rendering else 1, "training": 1 if training is None else training}
    counts = {"models": models, "views": views, "size": size, "epochs": epochs, "runs": runs}
    for name, value in (counts | rates).items():
        if not (math.isfinite(value) and value > 0):
            raise ViewnetError(f"{name} {value}: expected a number above 0")
    total = models * views
    targets = round(SHARES["train"] * total) * epochs * runs
    return Work(
        total,
        total * 4 * size**2,
        None if rendering is None else (total / max(rendering) / 3600, total / min(rendering) / 3600),
        targets,
        None if training is None else targets / training / 3600,
    )


def table(training: dict[str, float | None] | None = None) -> str:
    """The Markdown table of docs/scaling.md: all of ShapeNetCore, one run a category, by profile and recipe.

    `training` gives measured targets a second and device by row; what is not in it stays open.
    """
    lines = [
        "| profile, recipe | views | view stores | rendering, core-hours | targets in training | device-hours |",
        "|---|---|---|---|---|---|",
    ]
    for profile, recipe in (("small", "matting"), ("small", "photos"), ("paper", "paper"), ("paper", "paper_photos")):
        config, name = make_config(profile=profile, recipe=recipe), f"{profile}, {recipe}"
        found = work(
            SHAPENETCORE[1],
            views=config.data.views,
            size=config.data.image_size,
            epochs=config.train.epochs,
            rendering=RENDERING.get(config.data.image_size),
            training=(training or {}).get(name),
        )
        hours = "not measured" if found.core_hours is None else "{:.2f} to {:.2f}".format(*found.core_hours)
        spent = "not measured" if found.device_hours is None else f"{found.device_hours:.0f}"
        lines.append(
            f"| {name} | {found.views:,} | {found.store_bytes / 1e9:.1f} GB | {hours} | {found.targets / 1e6:,.0f} M"
            f" | {spent} |"
        )
    return "\n".join(lines) + "\n"
