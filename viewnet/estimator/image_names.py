"""Which images the words of a command line mean, and lists of boxes."""

import glob
import os
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from viewnet.data.crop import Box
from viewnet.errors import ViewnetError
from viewnet.estimator.inputs import box_of
from viewnet.runtime import image_files
from viewnet.runtime.lists import one_form, read_list

SUFFIXES = (*image_files.SUFFIXES, ".gif", ".jfif")  # of videos and collections a GIF is no single image
CORNERS = ("x0", "y0", "x1", "y1")


def expanded(words: Sequence[str]) -> list[str]:
    """The images that words mean: of a folder, or a pattern that no shell has expanded, its image files by name.

    Folders within a folder are not searched, `**` of a pattern finds any. Other words stand for themselves. Raises
    ViewnetError for a folder or pattern without image files.
    """
    found: list[str] = []
    for word in words:
        pattern = os.path.join(glob.escape(word), "*") if os.path.isdir(word) else word
        if pattern != word or (glob.has_magic(word) and "://" not in word and not os.path.exists(word)):
            files = [path for path in glob.iglob(pattern, recursive=True) if path.lower().endswith(SUFFIXES)]
            if not files:
                raise ViewnetError(f"{word}: no images there: expected files that end in {', '.join(SUFFIXES)}")
            if "**" in word:  # links between folders lead to some of them more than once, without end
                files = list({os.path.realpath(path): path for path in sorted(files, key=len, reverse=True)}.values())
            found += sorted(files)
        else:
            found.append(word)
    return found


def boxed(images: Sequence[str], file: Path) -> tuple[list[str], list[Box], list[str]]:
    """Images, each as often as a list has boxes in it, their boxes, and the images of which it has none.

    Columns: image, x0, y0, x1, y1, the edges of a box in pixels; all others are ignored. A row names an image by its
    path or the end of it. Without `images` all rows count, and names are relative to the list's folder. Raises
    ViewnetError for a list that cannot be read, naming the line, and where no box is of any of the images.
    """
    table = read_list(file, ("image", *CORNERS), CORNERS.__contains__)
    rows: list[tuple[str, Box]] = []
    for line, row in zip(table.index, table.to_dict("records"), strict=True):
        try:
            if row["image"] in ("", "-"):
                raise ViewnetError(f"image {row['image']!r}: expected a file")
            rows.append((os.path.normpath(row["image"].replace("\\", "/")), box_of([row[name] for name in CORNERS])))
        except ViewnetError as error:
            raise ViewnetError(f"{file}: line {line}: {error}") from None
    by_name = defaultdict[str, list[Box]](list)
    for name, box in rows:
        for way in {name, os.path.abspath(file.parent / name)}:
            by_name[one_form(way)].append(box)
    pairs = [] if images else [(str(file.parent / name), box) for name, box in rows]
    without = []
    for image in images:
        parts = one_form(os.path.abspath(image)).split(os.sep)
        ends = (os.sep.join(parts[start:]) for start in range(len(parts)))
        boxes = next((by_name[end] for end in ends if end in by_name), [])
        pairs += [(image, box) for box in boxes]
        without += [] if boxes else [image]
    if not pairs:
        raise ViewnetError(f"{file}: has no box of any of the images")
    return [image for image, _ in pairs], [box for _, box in pairs], without
