"""uCO3D: a video all around each of many objects, and one of the object's masks, in the data set's own layout.

    <super-category>/<category>/<sequence>/rgb_video.mp4     the video
    <super-category>/<category>/<sequence>/mask_video.mkv    its masks, a frame for each of the video's

Of a category's folder, LVIS's name, brackets are underscores. A clip's name is its folder's path. Cameras are not read:
they are of frames that differ from one sequence to the next, so that no viewpoint of the object follows from them.
Splits are those of a folder of videos. Whatever is not used is listed with the reason.
"""

from pathlib import Path

from viewnet.config import CATEGORIES, known
from viewnet.data.clips import Clip, Pick, frame_count
from viewnet.data.readers import video_folder
from viewnet.data.readers.reader import Contents, Reader, no_usable
from viewnet.data.store import Rejected, within
from viewnet.errors import ViewnetError

CLASSES = {
    "aeroplane": "airplane", "bicycle": "bicycle", "boat": "boat", "bottle": "bottle", "bus": "bus__vehicle_",
    "car": "car__automobile_", "chair": "chair", "diningtable": "dining_table", "motorbike": "motorcycle",
    "sofa": "sofa", "train": "train__railroad_vehicle_", "tvmonitor": "television_set",
}  # fmt: skip
"""Our name -> that of its folder."""
VIDEO = "rgb_video.mp4"
MASKS = "mask_video.mkv"
SAMPLE = 3  # videos of a category that a check opens, as opening one means decoding it


def read(
    root: Path, category: str, count: int | None = 10, pick: Pick = "random", seed: int = 0
) -> tuple[list[Clip], list[Rejected]]:
    """The sequences of a category, `count` frames each (None: all), and what cannot be used.

    Raises ViewnetError as video_folder.read does.
    """
    sources, masks, rejected = _sequences(Path(root), known(category, CATEGORIES, "category"))
    clips, lost = video_folder.as_clips(Path(root), category, sources, masks, count, pick, seed)
    rejected += lost
    if not clips:
        raise no_usable(Path(root), f"video of {CLASSES[category]}", rejected, f"no <super>/{CLASSES[category]}/")
    return clips, rejected


def _sequences(root: Path, category: str) -> tuple[dict[str, Path], dict[str, Path], list[Rejected]]:
    """Videos and masks by clip, and the sequences without a video."""
    folders = {within(path, root): path for path in sorted(root.glob(f"*/{CLASSES[category]}/*")) if path.is_dir()}
    videos = {clip: file for clip, folder in folders.items() if (file := folder / VIDEO).is_file()}
    masks = {clip: file for clip, folder in folders.items() if (file := folder / MASKS).is_file()}
    return videos, masks, [(clip, clip, f"no {VIDEO}") for clip in folders if clip not in videos]


def _count(root: Path, contents: Contents) -> None:
    from viewnet.data.masks import from_files  # slow to import

    follow = from_files().follow
    for category in CLASSES:
        videos, masks, rejected = _sequences(root, category)
        reasons = {name: reason for name, _, reason in rejected}
        names = list(videos)
        for name in (names[number] for number in contents.opened(category, len(names), "videos", most=SAMPLE)):
            try:
                frame_count(videos[name])
                if name in masks:
                    follow(Clip(name, category, "train", videos[name], (), masks[name]))
            except ViewnetError as error:
                reasons[name] = str(error)
        usable = [name for name in videos if name not in reasons]
        if usable or reasons:
            kinds = ["videos"] * len(usable) + ["videos with masks"] * sum(name in masks for name in usable)
            contents.add(category, kinds, reasons.items())
    if others := sorted({path.name for path in root.glob("*/*") if path.is_dir()} - set(CLASSES.values())):
        contents.notes.append(f"folders of other categories: {', '.join(others)}")


def _recognises(folder: Path) -> bool:
    return any(folder.glob(f"*/*/*/{VIDEO}"))


READER = Reader(
    recognises=_recognises,
    count=_count,
    accepts=_recognises,
    videos=lambda config, root: read(root, config.category, config.count or None, config.pick, config.seed),
)
