"""All readers by key. A data set is added by a module with a `READER`, a line here and an entry in data_sets.toml."""

from viewnet.data.readers import (
    crop_list,
    freiburg,
    image_folder,
    imagenet3d,
    objectron,
    pascal3d,
    photo_folder,
    shapenet,
    uco3d,
    video_folder,
)
from viewnet.data.readers.reader import Reader

READERS: dict[str, Reader] = {
    "shapenet": shapenet.READER,
    "imagenet3d": imagenet3d.READER,  # before PASCAL3D+, for file systems that do not tell capitals
    "pascal3d": pascal3d.READER,
    "photographs": photo_folder.READER,
    "crops": crop_list.READER,
    "freiburg": freiburg.READER,
    "objectron": objectron.READER,
    "uco3d": uco3d.READER,
    "backgrounds": image_folder.READER,
    "folder": video_folder.READER,
}
"""In the order in which a folder is held against their layouts."""
