"""A stand-in for PASCAL3D+ in its layout: built-in CAD models before backgrounds, viewpoints distributed as in it.

Numbers measured on it are numbers of the stand-in.
"""

import hashlib
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from PIL import Image, ImageDraw, ImageFilter

from viewnet.config import CATEGORIES, known
from viewnet.data.annotated_viewpoints import histogram_file, sample
from viewnet.data.crop import bounds
from viewnet.data.readers.image_folder import list_images
from viewnet.data.readers.pascal3d import EXTENSIONS, LISTS, SPLITS, VOC, annotation_file, image_file, parts
from viewnet.data.synthetic import scenes
from viewnet.data.synthetic.stand_in import StandIn, add_shadow, as_image, built_in_mesh
from viewnet.errors import ViewnetError
from viewnet.render import render_cameras
from viewnet.render.camera import look_from
from viewnet.runtime import image_files
from viewnet.runtime.files import write_text
from viewnet.runtime.splits import seeded_generator

MODEL_SEED = 1000  # added to the seed, so that models differ from those of a training with the same one
SIZE = (200, 150)  # width and height of an image, pixels
OBJECT = 144  # pixels along a side of the rendering that an object is pasted from
HARD = {"imagenet": 0.1, "pascal": 0.5}  # the share of objects that are truncated or occluded
DISTANCE = 7.0  # the annotated distance of the camera; 0 would mean that the viewpoint is coarse


@dataclass(frozen=True)
class Photograph:
    """One image to make."""

    subset: str
    name: str
    azimuth: float
    elevation: float
    world_from_camera: np.ndarray  # (3, 3)


@dataclass(frozen=True)
class Pascal3DStandIn(StandIn):
    """`count` photographs of each split, which shows `models` built-in models of its own, in equal shares.

    Viewpoints are sampled from the published histogram (annotated_viewpoints.sample). Backgrounds are a folder's
    images, else synthetic scenes. Some objects are annotated as truncated or occluded, and are. `subset` is "imagenet",
    "pascal" (with more of these) or "both". An image depends on (seed, category, subset, split, its number, models) and
    the backgrounds.
    """

    FOLDER = "pascal3d-stand-in"
    VERSION = 1
    category: str
    subset: str = "imagenet"
    models: int = 60
    count: int = 600
    seed: int = 0
    backgrounds: str | None = None

    def describe(self) -> dict[str, Any]:
        """See StandIn.describe. Backgrounds are known by their paths and sizes."""
        values = super().describe() | {"viewpoints": hashlib.sha256(histogram_file().read_bytes()).hexdigest()}
        del values["backgrounds"]
        if self.backgrounds is not None:
            folder = Path(self.backgrounds)
            names = [(path, (folder / path).stat().st_size) for path, _ in list_images(folder)[0]]
            values["backgrounds"] = hashlib.sha256(repr(names).encode()).hexdigest()
        return values

    def prepare(self, root: Path) -> list[Callable[[], None]]:
        """See StandIn.prepare."""
        known(self.category, CATEGORIES, "category")
        folder = Path(self.backgrounds or "")
        images = [] if self.backgrounds is None else [folder / path for path, _ in list_images(folder)[0]]
        for part in parts(self.subset):
            for split in SPLITS:
                names = [self.name(split, number) for number in range(self.count)]
                write_list(root, self.category, part, split, names)
        return [partial(_write_model, root, self, *planned, images) for planned in self.plan().items()]

    def plan(self) -> dict[int, list[Photograph]]:
        """The photographs of each model. Models of the first split are numbered before those of the second."""
        viewpoints = sample(np.random.default_rng(self.seed), self.count).query("category == @self.category")
        planned: dict[int, list[Photograph]] = {}
        for place, split in enumerate(SPLITS):
            angles = viewpoints.loc[viewpoints["split"] == split, ["azimuth", "elevation"]].to_numpy()
            cameras = look_from(*angles.T.copy())
            for part in parts(self.subset):
                for number, ((azimuth, elevation), camera) in enumerate(zip(angles.tolist(), cameras, strict=True)):
                    photograph = Photograph(part, self.name(split, number), azimuth, elevation, camera)
                    planned.setdefault(place * self.models + number % self.models, []).append(photograph)
        return planned

    def name(self, split: str, number: int) -> str:
        """The name of an image."""
        return f"{self.category}_{split}_{number:05d}"


def _write_model(
    root: Path, made: Pascal3DStandIn, model: int, photographs: list[Photograph], backgrounds: list[Path]
) -> None:
    """Write the photographs of one model, each by a generator of its own: none depends on how many there are."""
    mesh = built_in_mesh(made.category, model, made.seed + MODEL_SEED)
    generators = [seeded_generator(made.seed, made.category, shown.subset, shown.name) for shown in photographs]
    cameras = np.stack([photograph.world_from_camera for photograph in photographs])  # (V, 3, 3)
    lights = []
    for rng, camera in zip(generators, cameras, strict=True):
        # Mostly from above, and never from behind, where the object would be dark.
        light = rng.normal(size=3) * 0.7 + camera[:, 2] * 0.6 + np.array([0.0, 0.0, 0.8])
        lights.append(light / np.linalg.norm(light))
    renderings = render_cameras(mesh, cameras, np.stack(lights), OBJECT, 2, "raycast")
    for photograph, rendering, rng in zip(photographs, renderings, generators, strict=True):
        image, entry = _photograph(rendering, photograph, backgrounds, rng)
        entry["class"] = made.category
        write_annotated_image(root, made.category, photograph.subset, photograph.name, image, [entry])


def _photograph(
    rendering: np.ndarray, photograph: Photograph, backgrounds: Sequence[Path], rng: np.random.Generator
) -> tuple[Image.Image, dict[str, Any]]:
    """An image, and its object as in a record's `objects` (but for its class)."""
    thing = Image.fromarray(rendering).crop(bounds(rendering[..., 3]))
    width, height = SIZE
    scale = min(0.95 * width / thing.width, 0.95 * height / thing.height) * rng.uniform(0.45, 1)
    size = (max(8, round(thing.width * scale)), max(8, round(thing.height * scale)))
    thing = thing.resize(size, Image.Resampling.HAMMING)
    truncated, occluded = rng.random(2) < HARD[photograph.subset] / 2
    left, upper = (int(rng.integers(0, room + 1)) for room in (width - thing.width, height - thing.height))
    if truncated:
        beyond = rng.uniform(0.1, 0.35)
        left, upper = (
            (left, height - round(thing.height * (1 - beyond))),
            (-round(thing.width * beyond), upper),
            (width - round(thing.width * (1 - beyond)), upper),
        )[int(rng.integers(3))]
    image = _background(backgrounds, rng)
    high = thing.height * rng.uniform(0.08, 0.25)
    foot = upper + thing.height
    ground = (left, foot - 1.3 * high, left + thing.width, foot + 0.4 * high)
    add_shadow(image, ground, int(255 * rng.uniform(0, 0.7)), 0.04 * thing.width)
    image.paste(thing, (left, upper), thing)
    x0, y0 = max(left, 0), max(upper, 0)
    x1, y1 = min(left + thing.width, width), min(upper + thing.height, height)
    if occluded:
        _occlude(image, (x0, y0, x1, y1), rng)
    azimuth, elevation = photograph.azimuth, photograph.elevation
    viewpoint: dict[str, float]  # the record's bytes depend on the order of its fields
    viewpoint = {"azimuth_coarse": round(azimuth / 45) * 45 % 360, "elevation_coarse": round(elevation / 30) * 30}
    viewpoint |= {"azimuth": azimuth, "elevation": elevation, "distance": DISTANCE}
    viewpoint |= {"focal": 1, "px": width / 2, "py": height / 2, "theta": 0.0}
    box = np.array([x0 + 1, y0 + 1, x1, y1], dtype=np.float64)  # from 1, the last pixel included
    flags = {"occluded": int(occluded), "truncated": int(truncated), "difficult": 0}
    return _exposed(image, rng), {"view": "Unspecified", "bbox": box, **flags, "viewpoint": viewpoint}


def _occlude(image: Image.Image, box: tuple[int, int, int, int], rng: np.random.Generator) -> None:
    """Paste a part of another scene over the object: a post, or one that covers its foot or a side."""
    x0, y0, x1, y1 = box
    width, height = x1 - x0, y1 - y0
    share, where = rng.uniform(0.2, 0.45), int(rng.integers(4))
    part: tuple[float, float, float, float]
    if where == 0:  # a post
        left = x0 + rng.uniform(0.1, 0.8) * width
        part = (left, 0, left + 0.4 * share * width, image.height)
    elif where == 1:
        part = (x0 - 0.1 * width, y1 - share * height, x1 + 0.1 * width, image.height)
    else:
        left = x0 - 0.2 * width if where == 2 else x1 - share * width
        part = (left, y0 + rng.uniform(0, 0.5) * height, left + (share + 0.2) * width, image.height)
    mask = Image.new("L", image.size, 0)
    radius = 0.0 if rng.random() < 0.5 else 0.3 * min(part[2] - part[0], part[3] - part[1])
    ImageDraw.Draw(mask).rounded_rectangle(part, radius, 255)
    image.paste(Image.fromarray(scenes.sample(rng, *image.size)), mask=mask)


def _background(backgrounds: Sequence[Path], rng: np.random.Generator) -> Image.Image:
    """A part of a given image, or a synthetic scene."""
    if not backgrounds:
        return Image.fromarray(scenes.sample(rng, *SIZE))
    path = backgrounds[int(rng.integers(len(backgrounds)))]
    try:
        image = image_files.read(path).convert("RGB")
    except ViewnetError as error:
        raise ViewnetError(f"{path}: {error}: remove it from the backgrounds") from None
    scale = min(image.width / SIZE[0], image.height / SIZE[1]) * rng.uniform(0.7, 1)
    wide, high = SIZE[0] * scale, SIZE[1] * scale
    left, upper = rng.random(2) * [image.width - wide, image.height - high]
    return image.resize(SIZE, Image.Resampling.HAMMING, box=(left, upper, left + wide, upper + high))


def _exposed(image: Image.Image, rng: np.random.Generator) -> Image.Image:
    """Random blur, brightness, tint, gamma and noise, on object and background alike."""
    pixels = np.asarray(image.filter(ImageFilter.GaussianBlur(rng.uniform(0, 0.9))), dtype=np.float64) / 255
    pixels = pixels * rng.uniform(0.75, 1.2) * np.exp(rng.normal(0, 0.05, 3))
    pixels = pixels.clip(0, 1) ** np.exp(rng.normal(0, 0.15))
    return as_image(pixels + rng.normal(0, rng.uniform(0, 0.03), pixels.shape))


def write_annotated_image(
    root: Path, category: str, subset: str, name: str, image: Image.Image, objects: Sequence[Mapping[str, Any]]
) -> None:
    """Write an image and its record."""
    path, annotation = image_file(root, category, subset, name), annotation_file(root, category, subset, name)
    for file in (path, annotation):
        file.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, "JPEG", quality=88)
    # A structure array, one element an object, as MATLAB writes it.
    rows = [tuple(entry.get(field, 0) for field in objects[0]) for entry in objects]
    fields = np.array(rows, dtype=[(field, object) for field in objects[0]])
    record = {
        "folder": path.parent.name,
        "filename": f"{name}{EXTENSIONS[subset]}",
        "size": {"width": image.width, "height": image.height, "depth": 3},
        "imgsize": np.array([*image.size, 3], dtype=np.float64),
        "segmented": 0,
        "objects": fields,
    }
    stream = io.BytesIO()
    scipy.io.savemat(stream, {"record": record})
    # The file's first 116 bytes are a text with the time, which would make every stand-in another one.
    annotation.write_bytes(b"MATLAB 5.0 MAT-file".ljust(116) + stream.getvalue()[116:])


def write_list(root: Path, category: str, subset: str, split: str, names: Sequence[str]) -> None:
    """Write the list of a split; PASCAL's also names an image without an object of the category."""
    if subset == "imagenet":
        path, lines = root / LISTS / f"{category}_imagenet_{split}.txt", list(names)
    else:
        path, lines = root / VOC / f"{category}_{split}.txt", [f"{name}  1" for name in names] + ["nothing_of_it -1"]
    write_text(path, "".join(f"{line}\n" for line in lines))
