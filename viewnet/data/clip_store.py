"""Clips as a view store: every frame's object cropped by its mask, made square, in one size.

A clip is a model of the store and its frames are its views. Viewpoints without annotation are NaN.
"""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from PIL import Image
from scipy import ndimage

from viewnet.config import known, known_category
from viewnet.data import contents
from viewnet.data.clips import Clip, Frame, frame_count, read_frames
from viewnet.data.crop import Crop, bounds, cut, inside, shrunk
from viewnet.data.masks import MaskSource, from_files
from viewnet.data.photo_store import describe_crop
from viewnet.data.store import COLUMNS, Rejected, ViewStore, in_words, rejecting, tally, within, write_store
from viewnet.errors import ViewnetError
from viewnet.runtime.files import scratch
from viewnet.runtime.parallel import cores
from viewnet.runtime.progress import bar
from viewnet.runtime.splits import SPLITS

VERSION = 3  # raise it when a change alters the crops: it is part of every store's identity
CROP = Crop(128, margin=0.05)
LONGEST = 0.95
"""The share of a clip's views that stay within their frame when objects are made equally high: masks can be wrong."""
SHARPNESS = 96  # pixels along a side of the crop whose sharpness is measured
Scale = Literal["clip", "view"]
LEAST = 2  # usable frames of a clip, whose views are compared with each other
LOST_MASK = "mask"  # how every reason for a frame without a usable mask begins


@dataclass(frozen=True)
class Cutting:
    """Which frames are used, and how their object is cut out. Raises ViewnetError for values out of range.

    The object is what its mask covers (within the frame's box where there is one), cropped to the square around it.
    With `scale` "clip" it is then equally high in all views of its clip; with "view" it fills every square, so that a
    car looks larger from the front. Without `masks` it is the whole box, or else image, and nothing is transparent.
    """

    masks: MaskSource | None
    crop: Crop = CROP
    scale: Scale = "clip"
    side: float = 16.0  # least pixels of the object's shorter side
    blur: float = 0.0  # least sharpness, as a share of the median of its clip

    def __post_init__(self) -> None:
        if not (math.isfinite(self.side) and self.side >= 0):
            raise ViewnetError(f"side {self.side}: expected 0 or more pixels")
        if not 0 <= self.blur < 1:
            raise ViewnetError(f"blur {self.blur}: expected 0 to less than 1, a share of a clip's sharpness")

    def describe(self, clips: Sequence[Clip], root: Path | None = None) -> dict[str, Any]:
        """What decides a store of these clips, as JSON values; files are known by their names and sizes.

        Those of a data set, in `root`, are known by their names and contents.
        """
        files_in = {place: _files(place) for clip in clips for place in (clip.source, clip.masks) if place is not None}
        every = [file for files in files_in.values() for file in files]
        marks: Mapping[Path, int | str]
        marks = {file: file.stat().st_size for file in every} if root is None else contents.of_files(root, every)
        hashed = hashlib.sha256()
        for clip in sorted(clips, key=lambda clip: clip.id):
            values = [(f.number, f.azimuth, f.elevation, f.box) for f in clip.frames]
            known_of = [[None if value != value else value for value in row] for row in values]  # JSON has no NaN
            files = [
                None if place is None else [place.name, [(file.name, marks[file]) for file in files_in[place]]]
                for place in (clip.source, clip.masks)
            ]
            hashed.update(json.dumps([clip.id, clip.category, clip.split, known_of, files]).encode())
        return {
            "version": VERSION,
            "clips": {"count": len(clips), "sha256": hashed.hexdigest()},
            "masks": None if self.masks is None else self.masks.described,
            "crop": describe_crop(self.crop),
            "limits": {"side": self.side, "blur": self.blur},
            "scale": self.scale if self.masks else "view",
        }


@dataclass(frozen=True)
class _View:
    frame: Frame
    name: str
    pixels: np.ndarray
    sharpness: float


def clip_store(
    clips: Sequence[Clip],
    folder: Path,
    root: Path,
    cutting: Cutting,
    rejected: Iterable[Rejected] = (),
    workers: int | None = None,
    progress: bool = False,
    made_by: dict[str, Any] | None = None,
) -> ViewStore:
    """Crop the frames of clips from the data set at `root` into a view store and open it.

    Frames that do not decode, have no usable mask, or are too small or blurred, and clips with fewer than two usable
    frames join `rejected`. `made_by` is what Cutting.describe has of the clips. Raises ViewnetError for two clips of
    one name, and where no clip to train on is left.
    """
    if twice := [name for name, count in Counter(clip.id for clip in clips).items() if count > 1]:
        raise ViewnetError(f"clip {twice[0]!r} is there twice: give every clip a name of its own")
    for clip in clips:
        known_category(clip.category)
        known(clip.split, SPLITS, "split")
    rejected = list(rejected)
    ordered = sorted(clips, key=lambda clip: clip.id)
    rows: list[tuple[Any, ...]] = []
    # Crops wait on the disk until their number is known.
    with scratch(folder) as waiting:

        def work(number: int) -> tuple[list[tuple[Any, ...]], list[Rejected]]:
            clip = ordered[number]
            views, lost = _views(clip, root, cutting)
            if views:
                np.save(waiting / f"{number}.npy", np.stack([view.pixels for view in views]))
            return [_row(clip, view, root) for view in views], lost

        parallel = (workers or cores()) if cutting.masks is None or cutting.masks.parallel else 1
        with ThreadPoolExecutor(parallel) as pool:
            work_done = pool.map(work, range(len(ordered)))
            results = bar(progress, iterable=work_done, total=len(ordered), desc="clips", unit="clip")
            for views, lost in results:
                rejected += lost
                rows += views
        kinds = {"view": np.int64, "azimuth": np.float64, "elevation": np.float64}
        index = pd.DataFrame(rows, columns=list(COLUMNS)).astype(kinds)
        if not (index["split"] == "train").any():
            first = f" (the first that was left out: {': '.join(rejected[0])})" if rejected else ""
            remedy = ": put masks in masks/<clip>/, named as the frames" if "mask is missing" in first else ""
            raise ViewnetError(f"{root}: no clip to train on can be used{first}{remedy}")
        files = (waiting / f"{number}.npy" for number in range(len(ordered)))
        batches = (np.load(file) for file in files if file.exists())
        return write_store(folder, batches, index, made_by or cutting.describe(clips), rejected)


def summary(store: ViewStore) -> str:
    """What a store of clips holds and what it leaves out, in a line for under a table."""
    index = store.index
    clips = index.drop_duplicates("model_id")["split"].value_counts()
    splits = ", ".join(f"{clips[split]} {split}" for split in SPLITS if split in clips)
    text = f"{index['category'].iloc[0]}: {len(index)} views of {clips.sum()} clips ({splits})"
    reasons = tally(store.rejected["reason"])
    lost = sum(count for reason, count in reasons.items() if reason.startswith(LOST_MASK))
    if store.meta["made_by"]["masks"] is not None:
        text += f"; {100 * lost / (len(index) + lost):.1f} % of the frames without a usable mask"
    return f"{text}; left out: {in_words(dict(sorted(reasons.items())))}" if reasons else text


def unusable(clip: Clip, root: Path, enough: int | None = None) -> list[Rejected]:
    """What of a clip, cut by its own masks if it has some, cannot be used, up to its first `enough` usable frames."""
    return _views(clip, root, Cutting(from_files() if clip.masks else None), enough)[1]


def _views(clip: Clip, root: Path, cutting: Cutting, enough: int | None = None) -> tuple[list[_View], list[Rejected]]:
    """The usable frames of a clip, the first `enough`, none where there are fewer than two, and what cannot be used."""
    where = within(clip.source, root)
    views: list[_View] = []
    lost: list[Rejected] = []
    try:
        mine = {frame.number: frame for frame in clip.frames or map(Frame, range(frame_count(clip.source)))}
        follow = cutting.masks.follow(clip) if cutting.masks else None
        for number, name, image in read_frames(clip.source, mine):
            with rejecting(lost, f"{clip.id}/{name}", where):
                if isinstance(image, ViewnetError):
                    raise image
                mask = follow(number, name, image) if follow else None
                views.append(_view(mine[number], name, image, mask, cutting))
            if len(views) == enough:
                break
    except (ViewnetError, OSError) as error:
        return [], [*lost, (clip.id, where, str(error))]
    if cutting.blur and views:
        least = cutting.blur * float(np.median([view.sharpness for view in views]))
        lost += [(f"{clip.id}/{view.name}", where, "blurred") for view in views if view.sharpness < least]
        views = [view for view in views if view.sharpness >= least]
    if len(views) < LEAST:
        return [], [*lost, (clip.id, where, f"fewer than two usable frames ({len(views)})")]
    return _levelled(views) if cutting.masks and cutting.scale == "clip" else views, lost


def _levelled(views: Sequence[_View]) -> list[_View]:
    """Views that fill their squares, shrunk so that the object is equally high in all of them.

    A rigid object's height hardly depends on its viewpoint, so that equal heights remove the camera's distance.
    """
    sides = np.array([(x1 - x0, y1 - y0) for x0, y0, x1, y1 in (bounds(view.pixels[..., 3]) for view in views)])
    longer = sides.max(axis=1) / sides[:, 1]
    shares = np.minimum(longer / np.quantile(longer, LONGEST), 1.0)
    return [replace(view, pixels=shrunk(view.pixels, share)) for view, share in zip(views, shares, strict=True)]


def _view(frame: Frame, name: str, image: Image.Image, mask: np.ndarray | None, cutting: Cutting) -> _View:
    if math.isnan(frame.azimuth) != math.isnan(frame.elevation):
        raise ViewnetError("half of the viewpoint is missing: expected azimuth and elevation, or neither")
    box = frame.box
    if mask is not None:
        if box is not None:
            mask = inside(mask, box)
        box = bounds(mask)
    x0, y0, x1, y1 = box or (0, 0, *image.size)
    if min(x1 - x0, y1 - y0) < cutting.side:
        raise ViewnetError(f"object is too small ({x1 - x0:.0f} x {y1 - y0:.0f} pixels)")
    pixels = cut(image, box, cutting.crop, mask)
    if mask is not None and not (pixels[..., 3] > 127).any():
        raise ViewnetError("mask is empty (at the size of the views)")
    sharp = sharpness(cut(image, box, Crop(SHARPNESS), mask)) if cutting.blur else math.nan
    return _View(frame, name, pixels, sharp)


def sharpness(view: np.ndarray) -> float:
    """The Laplacian's variance over the image's own, within the object of a view (S, S, 4) uint8."""
    grey = view[..., :3].mean(axis=2)
    # The mask's outline is sharp in any image.
    inner = ndimage.binary_erosion(view[..., 3] > 127, iterations=3, border_value=1)
    if not inner.any():
        return 0.0
    return float(ndimage.laplace(grey)[inner].var() / max(grey[inner].var(), 1.0))


def _row(clip: Clip, view: _View, root: Path) -> tuple[Any, ...]:
    frame, source = view.frame, f"{within(clip.source, root)}#{view.name}"
    azimuth = frame.azimuth % 360 % 360  # NaN stays NaN
    return clip.id, clip.category, clip.split, frame.number, azimuth, frame.elevation, source


def _files(path: Path) -> list[Path]:
    """A file, or the files of a folder."""
    return [path] if path.is_file() else sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else []
