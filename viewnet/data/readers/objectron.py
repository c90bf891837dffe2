"""Objectron: videos of single objects with the poses of camera and object, in the data set's own layout.

    annotations/<class>/batch-N/M.pbdata        a record (viewnet.data.readers.objectron_record)
    videos/<class>/batch-N/M/video.MOV          the video; or, extracted beforehand,
    videos/<class>/batch-N/M/<number>.jpg       its frames as images (.jpg, .jpeg or .png): <number> is the frame's
                                                number in the record, from 0, with leading zeros so that names sort
    masks/<class>/batch-N/M/<number>.png        masks, which are not part of the data set; or none
    index/<class>_annotations_{train,test}      one <class>/batch-N/M a line

The lists may name videos that were not downloaded. Boxes are pixels of the upright image: of the frames' images where
there are some, else of the size that the camera recorded. Whatever else is not used is listed with the reason.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from viewnet.config import VideoConfig, known
from viewnet.data.clips import Clip, Frame, natural
from viewnet.data.readers.objectron_record import Record, View, read_record
from viewnet.data.readers.reader import Contents, Reader, no_usable, read_text
from viewnet.data.store import Rejected, rejecting, within
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files
from viewnet.runtime.splits import seeded_rank, seeded_splits

CLASSES = {"bicycle": "bike", "bottle": "bottle", "chair": "chair"}  # Objectron's classes that are categories here
VIDEO = "video.MOV"
MASKS = "masks"

_SUFFIXES = (".jpg", ".jpeg", ".png")
_Images = dict[int, tuple[int, Path]]  # frame number -> place in the order of names, and file


def read(root: Path, category: str, frames: int = 10, seed: int = 0) -> tuple[list[Clip], list[Rejected]]:
    """The videos of a category under `root`, each with up to `frames` of its usable frames, sampled by seed and video.

    The second value lists the videos, frames and further objects that cannot be used, but not frames that were merely
    not sampled. A frame's number is that of the video, or its image's place among the images. With the published lists,
    their test split is used and a seeded tenth of their train split is val; without, a tenth is val and a fifth test.

    Raises ViewnetError where Objectron has no such category, `root` is not Objectron or nothing can be used.
    """
    known(category, CLASSES, "category of Objectron")
    if frames < 1:
        raise ViewnetError(f"Objectron: frames {frames}: expected 1 or more of each video")
    root, name = Path(root), CLASSES[category]
    folder = root / "annotations" / name
    records = sorted(folder.glob("*/*.pbdata"), key=lambda path: natural(path.as_posix()))
    if not records:
        raise ViewnetError(f"{folder}: no records: expected Objectron's annotations/<class>/batch-N/M.pbdata")
    listed = _lists(root, name)
    clips: list[Clip] = []
    rejected: list[Rejected] = []
    videos = {path: within(path.with_suffix(""), root / "annotations") for path in records}
    for path, video in videos.items():
        with rejecting(rejected, video, within(path, root)):
            clips.append(_clip(root, video, category, _split(listed, video), frames, seed, rejected))
    there = set(videos.values())
    for place in sorted((root / "videos" / name).glob("*/*"), key=lambda path: natural(path.as_posix())):
        video = within(place, root / "videos")
        if place.is_dir() and video not in there:
            rejected.append((video, within(place, root), "video without a record"))
    if not clips:
        raise no_usable(root, f"video of {name}", rejected, "")
    free = [clip.id for clip in clips if clip.split == "train"]
    splits = seeded_splits(free, seed, {"val": 1, "test": 2}, order=("val", "test") if listed is None else ("val",))
    return [replace(clip, split=splits.get(clip.id, clip.split)) for clip in clips], rejected


def _clip(root: Path, video: str, category: str, split: str, count: int, seed: int, rejected: list[Rejected]) -> Clip:
    """One video; what cannot be used joins `rejected`."""
    where = f"annotations/{video}.pbdata"
    record = read_record(root / where)
    source, images = _source(root / "videos" / video, record)
    rejected += [(f"{video}/{number}", where, reason) for number, reason in record.rejected]
    rejected += [(f"{video}/object {name}", where, "object smaller than another one") for name in record.others]
    order = np.random.default_rng(list(seeded_rank(seed, "frames", video))).permutation(len(record.views))
    sampled: list[Frame] = []
    missing = {view.number for view in record.views} - images.keys() if images else set()
    rejected += [(f"{video}/{number}", where, "no such image") for number in sorted(missing)]
    for view in (record.views[place] for place in order):
        if len(sampled) == count:
            break
        if view.number in missing:
            continue
        with rejecting(rejected, f"{video}/{view.number}", where):
            sampled.append(_frame(view, images))
    if not sampled:
        raise ViewnetError("no usable frame")
    frames = tuple(sorted(sampled, key=lambda frame: frame.number))
    masks = root / MASKS / video
    return Clip(video, category, split, source, frames, masks if masks.is_dir() else None)


def _source(folder: Path, record: Record) -> tuple[Path, _Images]:
    """The folder of a video's images, with these, or the video file where there are none."""
    files = sorted(path for path in folder.glob("*") if path.stem.isdecimal() and path.suffix.lower() in _SUFFIXES)
    if not files:
        if (folder / VIDEO).is_file():
            return folder / VIDEO, {}
        raise ViewnetError("neither video nor images")
    numbers = [int(path.stem) for path in files]
    if len(set(numbers)) < len(numbers):
        raise ViewnetError("two images of one frame")
    if numbers != sorted(numbers):
        raise ViewnetError("images' names do not sort by number (write zeros before the numbers)")
    if numbers[0] == 1 and record.frames[0] == 0 and numbers[-1] == record.frames[-1] + 1:
        raise ViewnetError("images are numbered from 1 (the first frame is 0)")
    return folder, dict(zip(numbers, enumerate(files), strict=True))


def _frame(view: View, images: _Images) -> Frame:
    if images:
        number, file = images[view.number]
        size = image_files.size(file)
        width, height = view.size if view.size and view.upright is not None else size
        if (size[0] - size[1]) * (width - height) < 0:
            raise ViewnetError("image is not rotated as its annotation")
    elif view.size is None:
        raise ViewnetError("size of the video's image is not recorded")
    else:
        number, size = view.number, view.size
    x0, x1 = (value * size[0] for value in view.box[::2])
    y0, y1 = (value * size[1] for value in view.box[1::2])
    if x1 - x0 < 1 or y1 - y0 < 1:
        raise ViewnetError("object smaller than a pixel")
    return Frame(number, view.azimuth, view.elevation, (x0, y0, x1, y1))


def _lists(root: Path, name: str) -> dict[str, set[str]] | None:
    """Split -> videos of the published lists; None where there are none. Raises ViewnetError for half of them."""
    files = {split: root / "index" / f"{name}_annotations_{split}" for split in ("train", "test")}
    missing = [file for file in files.values() if not file.is_file()]
    if len(missing) == len(files):
        return None
    if missing:
        raise ViewnetError(f"{missing[0]}: no such list: give both lists of {name}, or none")
    return {split: set(read_text(file, "one <class>/batch-N/M a line").split()) for split, file in files.items()}


def _split(listed: dict[str, set[str]] | None, video: str) -> str:
    if listed is None:
        return "train"
    splits = [split for split, videos in listed.items() if video in videos]
    if len(splits) != 1:
        raise ViewnetError("video in both lists" if splits else "video in neither list")
    return splits[0]


def _read_videos(config: VideoConfig, root: Path) -> tuple[list[Clip], list[Rejected]]:
    if config.pick != "random":
        raise ViewnetError(f"pick {config.pick}: frames of Objectron are chosen at random: use random")
    return read(root, config.category, config.count or sys.maxsize, config.seed)


def _count(root: Path, contents: Contents) -> None:
    for category, name in CLASSES.items():
        if (root / "annotations" / name).is_dir():
            with contents.error_is_problem():
                clips, rejected = read(root, category, sys.maxsize)
                found = [(f"videos to {clip.split}", clip) for clip in clips]
                contents.add_clips(root, category, found, "videos", rejected)


READER = Reader(
    recognises=lambda folder: any((folder / "annotations" / name).is_dir() for name in CLASSES.values()),
    count=_count,
    accepts=lambda folder: (folder / "annotations").is_dir() and (folder / "videos").is_dir(),
    videos=_read_videos,
)
