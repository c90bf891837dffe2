"""A stand-in for PASCAL3D+ in its own layout: CAD models before backgrounds, biased as its photographs are.

It lets everything that reads the data set run, and be tested, where it is not to be had. Numbers measured on it are
numbers of the stand-in.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from PIL import Image, ImageFilter

from viewnet.data.mesh import Mesh
from viewnet.data.pascal3d import EXTENSIONS, SPLITS, SUBSETS, VOC
from viewnet.errors import ViewnetError
from viewnet.render import render
from viewnet.viewpoints import drawn

SIZE = (200, 150)
"""Width and height of a picture, pixels."""
OBJECT = 110
"""Pixels along a side of the drawing that an object is pasted from."""
HARD = {"imagenet": 0.1, "pascal": 0.5}
"""The share of objects that are cut by the picture's edge or hidden in part."""
DISTANCE = 7.0
"""Of the camera, as annotated; 0 would mean that the viewpoint is coarse."""


def write_stand_in(
    root: Path,
    meshes: Mapping[str, Mapping[str, Sequence[Mesh]]],
    count: int,
    backgrounds: Sequence[Path] = (),
    seed: int = 0,
) -> None:
    """`count` photographs of each category, subset and split under `root`, as PASCAL3D+ 1.1 lays them out.

    `meshes` holds normalised meshes by category and split ("train", "val"). Viewpoints are drawn from the published
    histogram of the real ones (viewnet.viewpoints.drawn). Backgrounds are the given pictures, or drawn. Some objects
    are cut by the edge or hidden in part, and say so. Raises ViewnetError where `root` holds something already.
    """
    root = Path(root)
    if root.exists() and any(root.iterdir()):
        raise ViewnetError(f"{root}: is not empty: name another folder")
    viewpoints = drawn(np.random.default_rng(seed), count)
    for category, by_split in meshes.items():
        for subset in SUBSETS:
            for split in SPLITS:
                mine = viewpoints[(viewpoints["category"] == category) & (viewpoints["split"] == split)]
                names = []
                for number, (azimuth, elevation) in enumerate(zip(mine["azimuth"], mine["elevation"], strict=True)):
                    name = f"{category}_{split}_{number:05d}"
                    rng = _generator(seed, subset, name)
                    mesh = by_split[split][int(rng.integers(len(by_split[split])))]
                    picture, entry = _photograph(mesh, azimuth, elevation, HARD[subset], backgrounds, rng)
                    entry["class"] = category
                    _write(root, category, subset, name, picture, [entry])
                    names.append(name)
                _write_list(root, category, subset, split, names)


def _photograph(
    mesh: Mesh, azimuth: float, elevation: float, hard: float, backgrounds: Sequence[Path], rng: np.random.Generator
) -> tuple[Image.Image, dict[str, Any]]:
    """A picture, and its object as a record's `objects` has it (but for its class)."""
    light = rng.normal(size=3)
    light[2] = abs(light[2])
    drawing = render(
        mesh, np.array([azimuth]), np.array([elevation]), OBJECT, lights=(light / np.linalg.norm(light))[None]
    )[0]
    ys, xs = np.nonzero(drawing[..., 3] > 127)
    if not len(xs):
        raise ViewnetError("a model of the stand-in cannot be seen")
    thing = Image.fromarray(drawing, "RGBA").crop((xs.min(), ys.min(), xs.max() + 1, ys.max() + 1))
    scale = rng.uniform(0.7, 1.2)
    thing = thing.resize((max(8, round(thing.width * scale)), max(8, round(thing.height * scale))))
    width, height = SIZE
    truncated = rng.random() < hard / 2
    beyond_x, beyond_y = (thing.width // 3, thing.height // 3) if truncated else (0, 0)
    left = int(rng.integers(-beyond_x, max(1 - beyond_x, width - thing.width + beyond_x)))
    upper = int(rng.integers(-beyond_y, max(1 - beyond_y, height - thing.height + beyond_y)))
    picture = _background(backgrounds, rng)
    picture.paste(thing, (left, upper), thing)
    x0, y0 = max(left, 0), max(upper, 0)
    x1, y1 = min(left + thing.width, width), min(upper + thing.height, height)
    occluded = rng.random() < hard / 2
    if occluded:
        part = (x0, y0 + (y1 - y0) * 2 // 3, x0 + (x1 - x0) * 2 // 3, y1)
        picture.paste(tuple(int(v) for v in rng.integers(0, 256, 3)), part)
    pixels = np.asarray(picture.filter(ImageFilter.GaussianBlur(rng.uniform(0, 0.8))), dtype=np.float64)
    pixels = pixels * rng.uniform(0.7, 1.2) + rng.normal(0, rng.uniform(0, 8), pixels.shape)
    viewpoint = {
        "azimuth_coarse": round(azimuth / 45) * 45 % 360,
        "elevation_coarse": round(elevation / 30) * 30,
        "azimuth": azimuth,
        "elevation": elevation,
        "distance": DISTANCE,
        "focal": 1,
        "px": width / 2,
        "py": height / 2,
        "theta": 0.0,
    }
    entry = {
        "view": "Unspecified",
        "bbox": np.array([x0 + 1, y0 + 1, x1, y1], dtype=np.float64),  # from 1, the last pixel included
        "occluded": int(occluded),
        "truncated": int(truncated and (x1 - x0, y1 - y0) != thing.size),
        "difficult": 0,
        "viewpoint": viewpoint,
    }
    return Image.fromarray(pixels.clip(0, 255).astype(np.uint8)), entry


def _background(backgrounds: Sequence[Path], rng: np.random.Generator) -> Image.Image:
    """A given picture in the right size, or blurred patches of a few colours above a ground."""
    if backgrounds:
        with Image.open(backgrounds[int(rng.integers(len(backgrounds)))]) as picture:
            return picture.convert("RGB").resize(SIZE)
    small = rng.integers(0, 256, (int(rng.integers(2, 9)), int(rng.integers(2, 9)), 3), dtype=np.uint8)
    picture = Image.fromarray(small).resize(SIZE, Image.Resampling.BICUBIC)
    ground = Image.new("RGB", SIZE, tuple(int(v) for v in rng.integers(0, 256, 3)))
    horizon = int(SIZE[1] * rng.uniform(0.4, 0.8))
    picture.paste(ground.crop((0, 0, SIZE[0], SIZE[1] - horizon)), (0, horizon))
    return picture


def _write(
    root: Path, category: str, subset: str, name: str, picture: Image.Image, objects: Sequence[Mapping[str, Any]]
) -> None:
    image = root / "Images" / f"{category}_{subset}" / f"{name}{EXTENSIONS[subset]}"
    annotation = root / "Annotations" / f"{category}_{subset}" / f"{name}.mat"
    for path in (image, annotation):
        path.parent.mkdir(parents=True, exist_ok=True)
    picture.save(image, "JPEG", quality=85)
    # A structure array, one element an object, as MATLAB writes it.
    fields = np.zeros(len(objects), dtype=[(field, object) for field in objects[0]])
    for number, entry in enumerate(objects):
        for field, value in entry.items():
            fields[number][field] = value
    width, height = picture.size
    record = {
        "folder": image.parent.name,
        "filename": image.name,
        "size": {"width": width, "height": height, "depth": 3},
        "imgsize": np.array([width, height, 3], dtype=np.float64),
        "segmented": 0,
        "objects": fields,
    }
    scipy.io.savemat(annotation, {"record": record})


def _write_list(root: Path, category: str, subset: str, split: str, names: Sequence[str]) -> None:
    if subset == "imagenet":
        path, lines = root / "Image_sets" / f"{category}_imagenet_{split}.txt", list(names)
    else:
        path, lines = root / VOC / f"{category}_{split}.txt", [f"{name}  1" for name in names] + ["nothing_of_it -1"]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _generator(seed: int, *names: str) -> np.random.Generator:
    """Every picture has its own, so that none depends on how many there are."""
    digest = hashlib.sha256(" ".join((str(seed), *names)).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))
