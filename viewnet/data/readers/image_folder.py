"""SUN397, or any folder of images: backgrounds, by class where there is a `ClassName.txt`."""

import os
from collections.abc import Iterator
from pathlib import Path

from viewnet.data.clips import is_image
from viewnet.data.readers.reader import Contents, Reader, read_text
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files

CLASSES = "ClassName.txt"


def list_images(root: Path) -> tuple[list[tuple[str, int]], list[tuple[str, str]]]:
    """The images of a folder and all folders in it, (path from `root`, class) sorted by path.

    Classes are those of the folder's own list, a class folder such as /a/abbey a line, counted from 0; without a list
    there is one. The second value is (class folder, reason) of those that are missing.

    Raises ViewnetError where there is no such folder or no image in it, and for a line of the list that is no folder.
    """
    if not root.is_dir():
        raise ViewnetError(f"{root}: no such folder: give one of images, SUN397's, or 'drawn' for synthetic scenes")
    classes: dict[str, int] = {}
    missing: list[tuple[str, str]] = []
    if (root / CLASSES).is_file():
        lines = read_text(root / CLASSES, "a text file, one folder a line").splitlines()
        for number, name in enumerate(line.strip() for line in lines if line.strip()):
            inside = Path(name.lstrip("/"))
            if ".." in inside.parts or len(name) > 200 or not name.isprintable():
                raise ViewnetError(f"{root / CLASSES}: line {name[:60]!r}: expected a folder such as /a/abbey")
            if not (root / inside).is_dir():
                missing.append((name, "no such class folder"))
                continue
            # A class may lie within another's folder; its images are its own.
            classes |= {(inside / path.name).as_posix(): number for path in filter(is_image, (root / inside).iterdir())}
    else:
        classes = {path.relative_to(root).as_posix(): 0 for path in _walk(root, {root.resolve()})}
    if not classes:
        lost = f", and {len(missing)} of the folders in {CLASSES} are missing" if missing else ""
        suffixes = ", ".join(image_files.SUFFIXES)
        raise ViewnetError(f"{root}: no images in it ({suffixes}){lost}: name a folder that has some")
    return sorted(classes.items()), missing


def _walk(folder: Path, seen: set[Path]) -> Iterator[Path]:
    """The images below a folder. Linked folders are followed, but none is entered twice."""
    for entry in os.scandir(folder):
        path = Path(entry.path)
        if entry.is_dir() and not entry.name.startswith("."):
            if (real := path.resolve()) not in seen:
                seen.add(real)
                yield from _walk(path, seen)
        elif is_image(path):
            yield path


def _count(root: Path, contents: Contents) -> None:
    images, lost = list_images(root)
    left = dict(images)
    for path, _ in (images[number] for number in contents.opened("", len(images), "images")):
        try:
            image_files.read(root / path)
        except ViewnetError as error:
            lost.append((path, str(error)))
            del left[path]
    contents.add("", ["images"] * len(left) + ["classes"] * len(set(left.values())), lost)


READER = Reader(recognises=lambda folder: (folder / CLASSES).is_file(), count=_count)
