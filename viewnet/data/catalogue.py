"""The catalogue of data sets: how each is named to the project, its terms and its address; and what a copy holds.

Nothing is downloaded. A copy is read by the readers of training and scoring, so problems are theirs, in their words.
"""

import tomllib
from dataclasses import asdict
from pathlib import Path
from typing import Any

from viewnet.data import masks
from viewnet.data.readers.reader import Contents
from viewnet.data.readers.registry import READERS
from viewnet.data.readers.shapenet import other_formats
from viewnet.data.store import in_words
from viewnet.errors import ViewnetError
from viewnet.runtime import torchvision_weights
from viewnet.runtime.image_files import SUFFIXES

DATA_SETS: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_name("data_sets.toml").read_text("utf-8"))
LABELS = {"for": "use", "named": "named", "layout": "layout", "terms": "terms", "from": "source"}

NETWORKS = {
    "vgg16": "perceptual loss of the recipe paper, view regression",
    "squeezenet1_1": "view regression without VGG16, variants that end in _imagenet",
    **{full: f"masks of videos (masks={short})" for short, full in masks.NETWORKS.items()},
}


def weights() -> list[dict[str, Any]]:
    """The networks whose weights are read, where they are expected, and whether they are there."""
    listed = []
    for network, use in NETWORKS.items():
        path, source = torchvision_weights.weights_file(network), torchvision_weights.published(network).url
        named = {"network": network, "use": use, "variable": torchvision_weights.variable(network)}
        listed.append({**named, "path": str(path), "there": path.is_file(), "source": source})
    return listed


def recognise(folder: Path) -> str:
    """The key of the data set whose layout a folder has; a ViewnetError otherwise names one that lies a folder deeper.

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
    if any(path.suffix.lower() in SUFFIXES for path in folder.rglob("*")):
        return "backgrounds"
    expected = "; ".join(f"{key}: {data['layout']}" for key, data in DATA_SETS.items())
    raise ViewnetError(f"{folder}: none of the layouts that are read{other_formats(folder)} ({expected})")


def check(folder: Path, deep: bool = False) -> Contents:
    """What a folder holds, by its data set's reader; `deep` opens every file, not a sample.

    Raises ViewnetError as `recognise` does.
    """
    folder = Path(folder)
    contents = Contents(recognise(folder), str(folder), deep=deep)
    with contents.error_is_problem():
        READERS[contents.key].count(folder, contents)
    return contents


def as_dict(contents: Contents | None = None) -> dict[str, Any]:
    """JSON values: of a checked folder, or the whole catalogue."""
    if contents is not None:
        return {name: value for name, value in asdict(contents).items() if name != "deep"}
    return {"data sets": [{"key": key, **data} for key, data in DATA_SETS.items()], "weights": weights()}


def as_text(contents: Contents | None = None) -> str:
    """The same for reading."""
    if contents is None:
        lines = []
        for key, data in DATA_SETS.items():
            lines += [f"{key}: {data['title']}", *(f"  {label:8}{data[name]}" for label, name in LABELS.items()), ""]
        lines.append("weights, torchvision's (terms: https://github.com/pytorch/vision#pre-trained-model-license)")
        for file in weights():
            there = "there" if file["there"] else "missing"
            lines += [f"  {file['network']}: {there}: {file['path']}", f"    for    {file['use']}"]
            lines += [f"    named  {file['variable']}", f"    from   {file['source']}"]
        return "\n".join([*lines, "", "viewnet data check FOLDER says what a copy holds"])
    lines = [f"{contents.folder}: {DATA_SETS[contents.key]['title']}"]
    for category, counts in contents.counts.items():
        lines.append(f"  {category + ': ' if category else ''}{in_words(counts) or 'nothing that can be used'}")
    lines += [f"  problem: {problem}" for problem in contents.problems]
    lines += [f"  {note}" for note in contents.notes]
    return "\n".join(lines)


def _layout(folder: Path) -> str | None:
    return next((key for key, reader in READERS.items() if reader.recognises(folder)), None)
