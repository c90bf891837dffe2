"""Any folder of videos, or of folders of frames, one object each.

    <clip>.mp4              a video (viewnet.data.clips.VIDEOS), or
    <clip>/<frame>.png      its frames, whose names sort in the order of time
    masks/<clip>, or
    <clip>_mask             if there are any: a folder of PNG masks named like the frames, or 000000.png by a frame's
                            number; or a video of masks (<clip>.mkv, <clip>_mask.mkv), a frame for each of the clip's
    splits.csv              if there is one: columns clip, split (train, val or test)

Nothing is left out silently: whatever is not used is listed with the reason.
"""

from collections.abc import Mapping
from pathlib import Path

from viewnet.config import known_category
from viewnet.data.clips import Clip, Frame, Pick, frame_count, is_video, masks_in, pick_frames
from viewnet.data.readers.reader import Contents, Reader
from viewnet.data.store import Rejected, within
from viewnet.errors import ViewnetError
from viewnet.runtime.lists import one_form, read_list
from viewnet.runtime.splits import SPLITS, seeded_splits

LIST = "splits.csv"
MASKS = "masks"
MASK = "_mask"


def read(
    root: Path, category: str, count: int | None = 10, pick: Pick = "random", seed: int = 0
) -> tuple[list[Clip], list[Rejected]]:
    """The clips of a folder by name, `count` frames each (None: all), and what cannot be used.

    A clip's name is its file's without the suffix, or its folder's. Without `splits.csv` names are shuffled by `seed`
    and split 0.7, 0.1 and 0.2. Clips that the list leaves out are not used.
    Raises ViewnetError for a folder that does not exist, a malformed list, and where no clip can be used.
    """
    root = Path(root)
    known_category(category)
    if not root.is_dir():
        raise ViewnetError(f"{root}: no such folder: give one of videos, or of folders of frames")
    rejected: list[Rejected] = []
    sources: dict[str, Path] = {}
    for path in sorted(root.iterdir()):
        if path.name.startswith(".") or path.name in (LIST, MASKS):
            continue
        name = path.name if path.is_dir() else path.stem
        if not path.is_dir() and not is_video(path):
            rejected.append((name, path.name, "neither a video nor a folder of frames"))
        elif name in sources:
            rejected.append((name, path.name, f"another clip has its name ({sources[name].name})"))
        else:
            sources[name] = path
    beside = {f"{name}{MASK}" for name in sources}
    sources = {name: path for name, path in sources.items() if name not in beside}
    masks: dict[str, Path] = {}
    for name, path in list(sources.items()):
        try:
            inside, near = masks_in(root / MASKS, name), masks_in(root, f"{name}{MASK}")
            if inside and near:
                raise ViewnetError(f"masks are there twice ({MASKS}/{inside.name}, {near.name})")
            if place := inside or near:
                masks[name] = place
        except ViewnetError as error:
            rejected.append((name, path.name, str(error)))
            del sources[name]
    clips, lost = as_clips(root, category, sources, masks, count, pick, seed)
    rejected += lost
    if not clips:
        first = f" (the first that was left out: {': '.join(rejected[0][1:])})" if rejected else ""
        raise ViewnetError(f"{root}: no usable video or folder of frames{first}")
    return clips, rejected


def as_clips(
    root: Path,
    category: str,
    sources: Mapping[str, Path],
    masks: Mapping[str, Path],
    count: int | None,
    pick: Pick,
    seed: int,
) -> tuple[list[Clip], list[Rejected]]:
    """Clips of videos and folders of frames by name, with masks where there are some, and what cannot be used.

    Frames and splits are as `read` has them.
    """
    rejected: list[Rejected] = []
    frames: dict[str, list[int]] = {}
    for name, path in sources.items():
        try:
            total = frame_count(path)
        except ViewnetError as error:
            rejected.append((name, within(path, root), str(error)))
        else:
            frames[name] = pick_frames(total, count, pick, name, seed)
    chosen = _listed(root) or seeded_splits(map(one_form, frames), seed, {"val": 1, "test": 2})
    clips: list[Clip] = []
    for name, numbers in frames.items():
        if one_form(name) not in chosen:
            rejected.append((name, within(sources[name], root), "in no split"))
            continue
        split = chosen[one_form(name)]
        clips.append(Clip(name, category, split, sources[name], tuple(map(Frame, numbers)), masks.get(name)))
    return clips, rejected


def _listed(root: Path) -> dict[str, str]:
    """Clip -> split by the folder's own list, nothing where there is none."""
    path = root / LIST
    if not path.is_file():
        return {}
    listed: dict[str, str] = {}
    for row in read_list(path, ("clip", "split")).itertuples():
        if row.split not in SPLITS:
            raise ViewnetError(
                f"{path}: line {row.Index}: split {row.split[:60]!r}: expected one of {', '.join(SPLITS)}"
            )
        if one_form(row.clip) in listed:
            raise ViewnetError(f"{path}: clip {row.clip[:60]!r} is listed twice")
        listed[one_form(row.clip)] = row.split
    return listed


def _count(root: Path, contents: Contents) -> None:
    clips, rejected = read(root, "own", None)
    contents.add_clips(root, "", [("clips", clip) for clip in clips], "clips", rejected)


READER = Reader(
    recognises=lambda folder: (folder / MASKS).is_dir() or any(map(is_video, folder.iterdir())),
    count=_count,
    accepts=lambda folder: True,
    videos=lambda config, root: read(root, config.category, config.count or None, config.pick, config.seed),
)
