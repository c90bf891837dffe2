"""All readers by their keys. A data set is added by one module with a `READER`, and one line here."""

from viewnet.data.readers import freiburg, image_folder, objectron, pascal3d, photo_folder, shapenet, video_folder
from viewnet.data.readers.reader import Reader

READERS: dict[str, Reader] = {
    "shapenet": shapenet.READER,
    "pascal3d": pascal3d.READER,
    "photographs": photo_folder.READER,
    "freiburg": freiburg.READER,
    "objectron": objectron.READER,
    "backgrounds": image_folder.READER,
    "folder": video_folder.READER,
}
"""In the order in which a folder is held against their layouts."""
