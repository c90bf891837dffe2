"""Data that is not ours to give: where each data set is named, under what terms it is had, and what a copy of it holds.

Nothing is downloaded. A folder is held against the layouts that the project reads, by their own readers: what those
refuse, training and scoring would refuse, with the same words.
"""

from __future__ import annotations

import contextlib
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from viewnet.config import CATEGORIES, SYNSETS
from viewnet.data import backgrounds, masks, photo_store
from viewnet.data.readers import freiburg, objectron, pascal3d, shapenet
from viewnet.errors import ViewnetError
from viewnet.runtime import torchvision_weights


@dataclass(frozen=True)
class DataSet:
    """One that the project reads.

    key      its short name
    title    its own name
    use      what for
    named    how a copy is named to the project
    layout   what must lie in the folder
    terms    under what terms it is had, and where they are
    source   where it is had
    """

    key: str
    title: str
    use: str
    named: str
    layout: str
    terms: str
    source: str


@dataclass(frozen=True)
class Weights:
    """Weights of a network from torchvision: a file and not a folder."""

    network: str
    use: str
    variable: str
    path: str
    there: bool
    source: str


@dataclass
class Contents:
    """What a folder holds: counts by category ("" where there are none), and problems, each in a line."""

    key: str
    folder: str
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def add(self, category: str, found: Iterable[str], rejected: Iterable[str] = ()) -> None:
        """Count what was found, by kind, and what cannot be used, by reason."""
        self.counts[category] = dict(Counter(found))
        self.problems += [
            f"{category + ': ' if category else ''}{count} left out: {reason}"
            for reason, count in sorted(pascal3d.tally(rejected).items())
        ]


DATA_SETS = {
    found.key: found
    for found in (
        DataSet(
            "shapenet",
            "ShapeNetCore v1 or v2",
            "CAD models to train on; Tables 1 and 2",
            "-p data_root FOLDER (Tables 1 and 2), -p cad_root FOLDER (Tables 3 and 4), train --data-root FOLDER",
            "<synset>/<id>/model.obj (v1) or <synset>/<id>/models/model_normalized.obj (v2); all.csv if there is one",
            "ShapeNet's terms of use: https://shapenet.org/terms",
            "https://shapenet.org, and on application https://huggingface.co/datasets/ShapeNet",
        ),
        DataSet(
            "pascal3d",
            "PASCAL3D+ release 1.1",
            "photographs to score on: Tables 3 and 4, DVA, the study of alignments",
            "-p data_root FOLDER",
            "Annotations/, Images/, Image_sets/ and, for the subset pascal, PASCAL/VOCdevkit/",
            "its images are ImageNet's and PASCAL VOC's: see https://cvgl.stanford.edu/projects/pascal3d.html",
            "ftp://cs.stanford.edu/cs/cvgl/PASCAL3D+_release1.1.zip",
        ),
        DataSet(
            "photographs",
            "photographs of your own",
            "in place of PASCAL3D+",
            "-p data_root FOLDER",
            f"images/ and {photo_store.LIST}: file, azimuth_deg, elevation_deg, split (val or test); boxes x0, y0, x1, y1",
            "yours",
            "you",
        ),
        DataSet(
            "freiburg",
            "Freiburg static cars 52, release 1.1",
            "videos to train on: Table 4",
            "-p video_root FOLDER",
            "car001/<frame>.png ... and annotations/<number>_annot.txt; masks/car001/<frame>.png of your own",
            "see https://lmb.informatik.uni-freiburg.de/resources/datasets/",
            "https://lmb.informatik.uni-freiburg.de/resources/datasets/FreiburgStaticCars52/"
            "freiburg_static_cars_52_v1.1.tar.gz",
        ),
        DataSet(
            "objectron",
            "Objectron",
            "videos to train on: bicycles, bottles and chairs",
            "-p video_root FOLDER (notebook objectron)",
            "annotations/<class>/batch-N/M.pbdata and videos/<class>/batch-N/M/video.MOV, or its frames as images",
            "C-UDA 1.0: https://github.com/google-research-datasets/Objectron",
            "https://storage.googleapis.com/objectron (videos/ and annotations/; v1/index/ has the lists)",
        ),
        DataSet(
            "backgrounds",
            "SUN397, or any folder of images",
            "behind what is trained on for photographs",
            "-p backgrounds FOLDER",
            "images in folders; SUN397's ClassName.txt if it is there",
            "see https://vision.princeton.edu/projects/2010/SUN/",
            "http://vision.princeton.edu/projects/2010/SUN/SUN397.tar.gz",
        ),
    )
}

NETWORKS = {
    "vgg16": "perceptual loss of the recipe paper, view regression",
    "squeezenet1_1": "view regression without VGG16",
    **{full: f"masks of videos (masks={short})" for short, full in masks.NETWORKS.items()},
}


def weights() -> list[Weights]:
    """The networks whose weights are read, where they are looked for, and whether they are there."""
    return [
        Weights(
            network,
            use,
            torchvision_weights.variable(network),
            str(path := torchvision_weights.weights_file(network)),
            path.is_file(),
            masks.weights_url(network),
        )
        for network, use in NETWORKS.items()
    ]


def recognise(folder: Path) -> str:
    """The key of the data set whose layout a folder has.

    Raises ViewnetError where there is no such folder, or it has none of them; where one lies a folder deeper, its name.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Path(folder, "02958343").mkdir()
    ...     recognise(Path(folder))
    'shapenet'
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ViewnetError(f"{folder}: no such folder")
    if key := _layout(folder):
        return key
    for inside in sorted(path for path in folder.iterdir() if path.is_dir()):
        if key := _layout(inside):
            raise ViewnetError(f"{folder}: no data set by itself, but {inside.name}/ in it is {key}: name {inside}")
    if any(path.suffix.lower() in backgrounds.SUFFIXES for path in folder.rglob("*")):
        return "backgrounds"
    expected = "; ".join(f"{found.key}: {found.layout}" for found in DATA_SETS.values())
    raise ViewnetError(f"{folder}: none of the layouts that are read ({expected})")


def check(folder: Path) -> Contents:
    """What a folder holds, by the readers of the data set that it is. Raises ViewnetError as `recognise` does."""
    folder = Path(folder)
    contents = Contents(recognise(folder), str(folder))
    try:
        _CHECKS[contents.key](folder, contents)
    except ViewnetError as error:
        contents.problems.append(str(error))
    return contents


def as_dict(found: Contents | None = None) -> dict[str, Any]:
    """JSON values: of a checked folder, or of all there is to say without one."""
    if found is not None:
        return asdict(found)
    return {"data sets": [asdict(d) for d in DATA_SETS.values()], "weights": [asdict(w) for w in weights()]}


def as_text(found: Contents | None = None) -> str:
    """The same for reading."""
    if found is None:
        lines = []
        for data in DATA_SETS.values():
            lines += [f"{data.key}: {data.title}", f"  for     {data.use}", f"  named   {data.named}"]
            lines += [f"  layout  {data.layout}", f"  terms   {data.terms}", f"  from    {data.source}", ""]
        lines.append("weights, torchvision's (terms: https://github.com/pytorch/vision#pre-trained-model-license)")
        for w in weights():
            lines += [f"  {w.network}: {'there' if w.there else 'missing'}: {w.path}", f"    for    {w.use}"]
            lines += [f"    named  {w.variable}", f"    from   {w.source}"]
        return "\n".join([*lines, "", "viewnet data check FOLDER says what a copy holds"])
    lines = [f"{found.folder}: {DATA_SETS[found.key].title}"]
    for category, counts in found.counts.items():
        told = ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "nothing that can be used"
        lines.append(f"  {category + ': ' if category else ''}{told}")
    lines += [f"  problem: {problem}" for problem in found.problems]
    return "\n".join(lines)


def _layout(folder: Path) -> str | None:
    if any((folder / name).is_dir() or (folder / f"{name}.zip").is_file() for name in SYNSETS.values()):
        return "shapenet"
    if (folder / "Annotations").is_dir():
        return "pascal3d"
    if (folder / photo_store.LIST).is_file():
        return "photographs"
    notes = folder / freiburg.ANNOTATIONS
    if notes.is_dir() and any(notes.glob("*_annot.txt")):
        return "freiburg"
    if notes.is_dir() and any((notes / name).is_dir() for name in objectron.CLASSES.values()):
        return "objectron"
    return "backgrounds" if (folder / backgrounds.CLASSES).is_file() else None


@contextlib.contextmanager
def _told(contents: Contents) -> Iterator[None]:
    """What a reader refuses is a problem of its part, and the others are read all the same."""
    try:
        yield
    except ViewnetError as error:
        contents.problems.append(str(error))


def _shapenet(root: Path, contents: Contents) -> None:
    for category, synset in SYNSETS.items():
        if (root / synset).is_dir() or (root / f"{synset}.zip").is_file():
            with _told(contents):
                models = shapenet.find_models(root, category)
                found = [f"{model.layout} models to {model.split}" for model in models if model.path.is_file()]
                missing = [f"no {model.path.name}" for model in models if not model.path.is_file()]
                contents.add(category, found, missing)


def _pascal3d(root: Path, contents: Contents) -> None:
    lists = [
        (category, subset)
        for category in CATEGORIES
        for subset in pascal3d.SUBSETS
        if any(pascal3d.list_file(root, category, subset, split).is_file() for split in pascal3d.SPLITS)
    ]
    if not lists:
        contents.problems.append(f"{root / pascal3d.LISTS}: no list of any category: expected PASCAL3D+ release 1.1")
    for category in dict.fromkeys(category for category, _ in lists):
        found: list[str] = []
        rejected: list[str] = []
        for subset in (subset for name, subset in lists if name == category):
            for split, use in zip(pascal3d.SPLITS, ("calibrate", "score"), strict=True):
                with _told(contents):
                    mine, report = pascal3d.read(root, category, subset, split)
                    found += [f"{subset} objects to {use}"] * len(mine)
                    rejected += [reason for _, _, reason in report.rejected]
        contents.add(category, found, rejected)


def _photographs(root: Path, contents: Contents) -> None:
    # The list does not say of what: it is read as any category.
    listed = photo_store.read_folder(root, CATEGORIES[0])
    there = [entry for entry in listed if entry.image_path.is_file()]
    uses = {"val": "calibrate", "test": "score"}
    contents.add(
        "", [f"objects to {uses[entry.split]}" for entry in there], ["no such image"] * (len(listed) - len(there))
    )
    contents.problems += [
        f"{photo_store.LIST}: no row of split {split}" for split in uses if split not in {e.split for e in there}
    ]


def _freiburg(root: Path, contents: Contents) -> None:
    clips, rejected = freiburg.read(root, "all")
    found = ["sequences"] * len(clips) + ["frames"] * sum(len(clip.frames) for clip in clips)
    found += ["sequences with masks"] * sum(clip.masks is not None for clip in clips)
    contents.add(freiburg.CATEGORY, found, [reason for *_, reason in rejected])


def _objectron(root: Path, contents: Contents) -> None:
    for category, name in objectron.CLASSES.items():
        if (root / freiburg.ANNOTATIONS / name).is_dir():
            with _told(contents):
                clips, rejected = objectron.read(root, category, sys.maxsize)
                found = [f"videos to {clip.split}" for clip in clips]
                found += ["frames"] * sum(len(clip.frames) for clip in clips)
                found += ["videos with masks"] * sum(clip.masks is not None for clip in clips)
                contents.add(category, found, [reason for *_, reason in rejected])


def _backgrounds(root: Path, contents: Contents) -> None:
    images, missing = backgrounds.list_images(root)
    classes = {number for _, number in images}
    contents.add("", ["pictures"] * len(images) + ["classes"] * len(classes), [reason for _, reason in missing])


_CHECKS: dict[str, Callable[[Path, Contents], None]] = {
    "shapenet": _shapenet,
    "pascal3d": _pascal3d,
    "photographs": _photographs,
    "freiburg": _freiburg,
    "objectron": _objectron,
    "backgrounds": _backgrounds,
}
