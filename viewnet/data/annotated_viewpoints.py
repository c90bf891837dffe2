"""Lists of annotated viewpoints, without images: what constants, biases and printed numbers are checked against."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from viewnet import paths
from viewnet.config import CATEGORIES
from viewnet.errors import ViewnetError
from viewnet.runtime.files import read_csv

REQUIRED = ("category", "azimuth_deg", "elevation_deg")
OPTIONAL = {"subset": "all", "split": "val", "easy": 0, "annotated": 1}
"""Columns that a list may lack, and what then holds for all of its rows."""


def read(path: Path) -> tuple[pd.DataFrame, dict[str, int]]:
    """A CSV of viewpoints: category, azimuth_deg, elevation_deg; also subset (imagenet, pascal), split (train, val),
    easy (1: neither difficult nor truncated nor occluded) and annotated (0: only coarsely) where it has them.

    Returns the usable rows, columns category, azimuth (degrees, [0, 360)), elevation, subset, split and easy, and how
    many rows were left out for which reason. Raises ViewnetError for a file that cannot be read, a missing column, and
    a list in which nothing is usable.
    """
    frame = read_csv(path, dtype={"category": str, "subset": str, "split": str})
    if missing := [name for name in REQUIRED if name not in frame.columns]:
        raise ViewnetError(
            f"{path}: column {missing[0]!r} is missing: expected {', '.join(REQUIRED)}, and if there are "
            f"{', '.join(OPTIONAL)}"
        )
    for name, value in OPTIONAL.items():
        frame[name] = frame[name].fillna(value) if name in frame.columns else value
    azimuth = pd.to_numeric(frame["azimuth_deg"], errors="coerce").to_numpy(dtype=np.float64, copy=True)
    elevation = pd.to_numeric(frame["elevation_deg"], errors="coerce").to_numpy(dtype=np.float64)
    reasons = {
        "of another category": ~frame["category"].isin(CATEGORIES).to_numpy(),
        "only coarsely annotated": (pd.to_numeric(frame["annotated"], errors="coerce") == 0).to_numpy(),
        "azimuth or elevation is no number": ~(np.isfinite(azimuth) & np.isfinite(elevation)),
        "elevation beyond 90 degrees": np.abs(elevation) > 90,
    }
    left = np.zeros(len(frame), dtype=bool)
    counts = {}
    for reason, rows in reasons.items():
        counts[reason] = int((rows & ~left).sum())
        left |= rows
    if left.all():
        told = ", ".join(f"{count} {reason}" for reason, count in counts.items() if count)
        raise ViewnetError(f"{path}: no usable viewpoint ({told or 'the list is empty'})")
    azimuth[left] = 0.0  # of rows that are not kept: infinity has no remainder
    kept = pd.DataFrame(
        {
            "category": frame["category"],
            "azimuth": azimuth % 360 % 360,  # a tiny negative angle is 360 after rounding
            "elevation": elevation,
            "subset": frame["subset"],
            "split": frame["split"],
            "easy": pd.to_numeric(frame["easy"], errors="coerce").fillna(0) == 1,
        }
    )
    return kept[~left].reset_index(drop=True), {reason: count for reason, count in counts.items() if count}


def histogram_file() -> Path:
    """The published histogram. Raises ViewnetError where the project's folders are missing."""
    return paths.part("paper_tables", "published") / "pascal3d_viewpoints.csv"


def histogram() -> pd.DataFrame:
    """How viewpoints are spread over PASCAL3D+'s ImageNet training images, a row a category (its index).

    Columns "0", "30" ... "330" count azimuths in bins of 30 degrees from there; elevation_mean and elevation_sd are in
    degrees. Raises ViewnetError for a file with other columns or rows.
    """
    path = histogram_file()
    frame = read_csv(path)
    bins = [str(azimuth) for azimuth in range(0, 360, 30)]
    named = frame.reindex(columns=[*bins, "elevation_mean", "elevation_sd"])
    numbers = named.apply(pd.to_numeric, errors="coerce").astype(np.float64)
    complete = np.isfinite(numbers).all(axis=None) and (numbers.drop(columns="elevation_mean") >= 0).all(axis=None)
    if not complete or "category" not in frame.columns or not (numbers[bins].sum(axis=1) > 0).all():
        raise ViewnetError(f"{path}: expected category, counts {', '.join(bins)}, elevation_mean and elevation_sd")
    if missing := [name for name in CATEGORIES if (frame["category"] == name).sum() != 1]:
        raise ViewnetError(f"{path}: {missing[0]} is missing or there twice")
    return frame.set_index("category").loc[list(CATEGORIES)]


def sample(rng: np.random.Generator, count: int = 600) -> pd.DataFrame:
    """A stand-in for an annotated list: `count` viewpoints a category and split, with the columns of `read`.

    Drawn from `histogram`: uniform within a bin of azimuth, elevations normal, within 89 degrees.
    """
    parts = []
    for category, row in histogram().iterrows():
        bins = row.filter(regex=r"^\d+$").to_numpy(dtype=np.float64)
        for split in ("train", "val"):
            azimuth = 30 * (rng.choice(len(bins), count, p=bins / bins.sum()) + rng.random(count))
            elevation = rng.normal(row["elevation_mean"], row["elevation_sd"], count).clip(-89, 89)
            parts.append(
                pd.DataFrame(
                    {
                        "category": category,
                        "azimuth": azimuth,
                        "elevation": elevation,
                        "subset": "imagenet",
                        "split": split,
                        "easy": False,
                    }
                )
            )
    return pd.concat(parts, ignore_index=True)
