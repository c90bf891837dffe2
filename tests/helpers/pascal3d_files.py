"""Small folders in the layout of PASCAL3D+, with one annotated car an image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from viewnet.data.synthetic import pascal3d_standin


def viewpoint(**changes: Any) -> dict[str, Any]:
    """The viewpoint of an annotated object; None leaves a field out."""
    base = {
        "azimuth": 10.0,
        "elevation": 5.0,
        "distance": 3.0,
        "theta": 2.0,
        "azimuth_coarse": 45,
        "elevation_coarse": 0,
    }
    return {name: value for name, value in {**base, **changes}.items() if value is not None}


def thing(**changes: Any) -> dict[str, Any]:
    """An annotated car; None leaves a field out."""
    base = {
        "class": "car",
        "bbox": np.array([11.0, 21, 60, 80]),
        "truncated": 0,
        "occluded": 0,
        "difficult": 0,
        "viewpoint": viewpoint(),
    }
    return {name: value for name, value in {**base, **changes}.items() if value is not None}


def write(root: Path, name: str, *objects: dict[str, Any], subset: str = "imagenet") -> None:
    """Write an image of 100 x 90 pixels with an annotation of objects."""
    pascal3d_standin.write_annotated_image(
        root, "car", subset, name, Image.new("RGB", (100, 90), (9, 99, 199)), objects
    )


def listed(root: Path, *names: str) -> None:
    """Write the list of validation images."""
    pascal3d_standin.write_list(root, "car", "imagenet", "val", names)
