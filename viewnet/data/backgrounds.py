"""Backgrounds: images of SUN397, of any folder, or synthetic ones; cropped to squares of one size.

Made once and kept under `<paths.data()>/backgrounds/<identity>`: pictures.npy and rejected.csv.
"""

import csv
import hashlib
import itertools
import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from viewnet import paths
from viewnet.data import contents
from viewnet.data.readers.image_folder import list_images
from viewnet.data.store import filled_once, identity_of
from viewnet.data.synthetic import scenes
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files
from viewnet.runtime.files import load_array
from viewnet.runtime.progress import bar
from viewnet.runtime.splits import seeded_generator, seeded_rank

SYNTHETIC = "drawn"  # the source that needs no images
VERSION = 2  # raise it when a change alters how images are chosen or cropped
LARGEST = 1024  # pixels along a side


@dataclass(frozen=True, eq=False)
class Backgrounds:
    """Square images and what decided them."""

    images: np.ndarray  # (K, 3, size, size) uint8, by class
    identity: str  # 16 hex digits of what decided the images, wherever their folder lies


def load(source: str, size: int, count: int = 2000, seed: int = 0, progress: bool = True) -> Backgrounds:
    """`count` images of size x size pixels, or fewer where there are no more, randomly cropped to squares.

    `source` is "drawn" (synthetic.scenes) or a folder (image_folder.list_images), of which classes have equal shares.
    Raises ViewnetError for values out of range, and a folder that does not exist or holds no usable image.
    """
    described, listed, missing = _described(source, size, count, seed)

    def fill(folder: Path) -> None:
        rejected: list[tuple[str, str]] = []
        if source == SYNTHETIC:
            numbers = bar(progress, iterable=range(count), desc="backgrounds", unit="image")
            drawn = [scenes.sample(np.random.default_rng([seed, number]), size, size) for number in numbers]
            images = np.stack(drawn).transpose(0, 3, 1, 2)  # (count, 3, size, size)
        else:
            images, rejected = _crop_all(Path(source), listed, size, count, seed, progress)
        np.save(folder / "pictures.npy", images)
        with (folder / "rejected.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([("path", "reason"), *missing, *rejected])

    name = identity_of(described)
    folder = filled_once(paths.data() / "backgrounds" / name, fill)
    again = "remove the folder, and it is made again"
    images = load_array(folder / "pictures.npy", again)
    if images.dtype != np.uint8 or images.shape[1:] != (3, size, size) or not images.size:
        raise ViewnetError(f"{folder}: damaged ({images.dtype} {images.shape} images): {again}")
    return Backgrounds(images, name)


def identity(source: str, size: int, count: int, seed: int = 0) -> str:
    """The identity of the images that `load` gives; makes nothing. Raises ViewnetError as that does."""
    return identity_of(_described(source, size, count, seed)[0])


def _described(
    source: str, size: int, count: int, seed: int
) -> tuple[dict[str, int | str], list[tuple[str, int]], list[tuple[str, str]]]:
    """What decides the images, and those of a folder that are listed and missing."""
    if not 1 <= size <= LARGEST:
        raise ViewnetError(f"backgrounds: size {size}: expected 1 to {LARGEST} pixels")
    if count < 1:
        raise ViewnetError(f"backgrounds: count {count}: expected 1 or more")
    described: dict[str, int | str] = {"version": VERSION, "size": size, "count": count, "seed": seed}
    if source == SYNTHETIC:
        return described | {"drawn": scenes.VERSION}, [], []
    listed, missing = list_images(Path(source))
    pictures = _digest(Path(source), listed, missing, _balanced(listed, seed)[:count])
    return described | {"pictures": pictures}, listed, missing


def _digest(
    root: Path, listed: list[tuple[str, int]], missing: list[tuple[str, str]], first: list[tuple[str, int]]
) -> str:
    """Of paths within the folder, classes, sizes, and the contents of the images that are used `first`."""
    hashed = hashlib.sha256(json.dumps(missing).encode())
    for path, number in listed:
        hashed.update(json.dumps([path, number, (root / path).stat().st_size]).encode())
    hashed.update(json.dumps([*contents.of_files(root, [root / path for path, _ in first]).values()]).encode())
    return hashed.hexdigest()


def _crop_all(
    root: Path, listed: list[tuple[str, int]], size: int, count: int, seed: int, progress: bool
) -> tuple[np.ndarray, list[tuple[str, str]]]:
    found: list[tuple[int, np.ndarray]] = []
    rejected: list[tuple[str, str]] = []
    with bar(progress, total=min(count, len(listed)), desc="backgrounds", unit="image") as shown:
        for path, number in _balanced(listed, seed):
            if len(found) == count:
                break
            try:
                square = random_square(root / path, size, seeded_generator(seed, "place", path))
            except ViewnetError as error:
                rejected.append((path, str(error)))
                continue
            found.append((number, square.transpose(2, 0, 1)))  # (3, size, size)
            shown.update()
    if not found:
        raise ViewnetError(f"{root}: none of its {len(listed)} images can be used ({': '.join(rejected[0])})")
    found.sort(key=lambda item: item[0])
    return np.stack([image for _, image in found]), rejected


def _balanced(listed: list[tuple[str, int]], seed: int) -> list[tuple[str, int]]:
    """Shuffled so that any beginning has equally many images of each class, but for classes that are exhausted."""
    shuffled = sorted(listed, key=lambda item: seeded_rank(seed, item[0]))
    rank: defaultdict[int, Iterator[int]] = defaultdict(itertools.count)  # of an image among those of its class
    return sorted(shuffled, key=lambda item: next(rank[item[1]]))


def random_square(path: Path, size: int, rng: np.random.Generator) -> np.ndarray:
    """A random square of an image, 0.7 to 1 of its shorter side wide: (size, size, 3)."""
    whole = image_files.read(path, enough=3 * size).convert("RGB")
    side = min(whole.size) * rng.uniform(0.7, 1)
    left, upper = rng.random(2) * (np.array(whole.size) - side)
    box = (left, upper, left + side, upper + side)
    return np.asarray(whole.resize((size, size), Image.Resampling.LANCZOS, box=box, reducing_gap=3))
