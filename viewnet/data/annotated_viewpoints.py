"""Lists of annotated viewpoints, without images: what constants, biases and reported numbers are compared with."""

from pathlib import Path

import numpy as np
import pandas as pd

from viewnet import paths
from viewnet.config import CATEGORIES
from viewnet.data.store import in_words
from viewnet.errors import ViewnetError
from viewnet.runtime.files import read_csv
from viewnet.runtime.lists import read_list

REQUIRED = ("category", "azimuth_deg", "elevation_deg")
OPTIONAL = {"subset": "all", "split": "val", "easy": "0", "annotated": "1"}
"""Columns that a list may lack, and their values for all rows then."""


def read(path: Path) -> tuple[pd.DataFrame, dict[str, int]]:
    """A CSV of viewpoints: category, azimuth_deg, elevation_deg; also subset (imagenet, pascal), split (train, val),
    easy (1: neither difficult nor truncated nor occluded) and annotated (0: only coarsely) where it has them.

    Returns the usable rows, with azimuth in [0, 360), and the number of rejected rows by reason. Raises ViewnetError
    for a file that cannot be read, a missing column, and a list without usable rows.
    """
    numeric = ("azimuth_deg", "elevation_deg", "annotated", "easy")
    table = read_list(path, REQUIRED, numeric.__contains__)
    for name, value in OPTIONAL.items():
        table[name] = table[name].replace("", value) if name in table.columns else value
    for name in numeric:
        table[name] = pd.to_numeric(table[name], errors="coerce").astype(np.float64)
    reasons = {
        "of another category": ~table["category"].isin(CATEGORIES),
        "only coarsely annotated": table["annotated"] == 0,
        "azimuth or elevation is no number": ~np.isfinite(table[["azimuth_deg", "elevation_deg"]]).all(axis=1),
        "elevation beyond 90 degrees": table["elevation_deg"].abs() > 90,
    }
    # The first reason that applies counts.
    reason = np.select(list(reasons.values()), list(reasons), default="")
    counts = {name: count for name in reasons if (count := int((reason == name).sum()))}
    table = table[reason == ""]
    if table.empty:
        raise ViewnetError(f"{path}: no usable viewpoint ({in_words(counts) or 'the list is empty'})")
    azimuth = table["azimuth_deg"] % 360 % 360  # a tiny negative angle is 360 after rounding
    usable = table.assign(azimuth=azimuth, elevation=table["elevation_deg"], easy=table["easy"] == 1)
    return usable[["category", "azimuth", "elevation", "subset", "split", "easy"]].reset_index(drop=True), counts


def histogram_file() -> Path:
    """The published histogram. Raises ViewnetError where the project's folders are missing."""
    return paths.part("paper_tables", "published") / "pascal3d_viewpoints.csv"


def histogram() -> pd.DataFrame:
    """The distribution of viewpoints of PASCAL3D+'s ImageNet training images, a row a category (its index).

    Columns "0", "30" ... "330" count azimuths in bins of 30 degrees from there; elevation_mean and elevation_sd are in
    degrees.
    """
    return read_csv(histogram_file(), index_col="category").loc[list(CATEGORIES)]


def sample(rng: np.random.Generator, count: int = 600) -> pd.DataFrame:
    """A stand-in for an annotated list: `count` viewpoints a category and split, with the columns of `read`.

    Sampled from `histogram`: uniform within a bin of azimuth, elevations normal, within 89 degrees.
    """
    parts = []
    for category, row in histogram().iterrows():
        bins = row.filter(regex=r"^\d+$").to_numpy(dtype=np.float64)
        for split in ("train", "val"):
            azimuth = 30 * (rng.choice(len(bins), count, p=bins / bins.sum()) + rng.random(count))
            elevation = rng.normal(row["elevation_mean"], row["elevation_sd"], count).clip(-89, 89)
            angles = {"category": category, "azimuth": azimuth, "elevation": elevation}
            parts.append(pd.DataFrame({**angles, "subset": "imagenet", "split": split, "easy": False}))
    return pd.concat(parts, ignore_index=True)
