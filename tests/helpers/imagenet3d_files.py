"""Small folders in the layout of ImageNet3D, annotated as NumPy saves lists of dictionaries."""

from __future__ import annotations

import io
import math
import pickle
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from viewnet.data.readers import imagenet3d

SIZE = (100, 90)


def thing(azimuth: float = 10.0, elevation: float = 5.0, **changes: Any) -> dict[str, Any]:
    """An annotated car with angles in degrees, written in radians from 0 to 2 pi; None leaves a field out."""
    base = {
        "azimuth": math.radians(azimuth % 360),
        "elevation": math.radians(elevation % 360),
        "theta": 0.1,
        "distance": 4.5,
        "px": 50.0,
        "py": 45.0,
        "viewport": 3000,
        "height": np.uint16(SIZE[1]),
        "width": np.uint16(SIZE[0]),
        "bbox": np.array([10.0, 20, 60, 80]),
        "class": "car",
        "cad_index": 3,
        "object_status": "status_good",
        "dense": "dense_no",
    }
    return {name: value for name, value in {**base, **changes}.items() if value is not None}


def write(root: Path, name: str, *objects: Any, category: str = "car", image: bool = True) -> Path:
    """Write an image and its annotations, the path of which is returned."""
    picture, annotation = imagenet3d.image_file(root, category, name), imagenet3d.annotation_file(root, category, name)
    for file in (picture, annotation):
        file.parent.mkdir(parents=True, exist_ok=True)
    if image:
        pixels = np.random.default_rng([*name.encode()]).integers(0, 255, (*SIZE[::-1], 3), dtype=np.uint8)
        Image.fromarray(pixels).save(picture)
    np.savez(annotation, annotations=np.array(objects, dtype=object))
    return annotation


def listed(root: Path, split: str, *names: str, category: str = "car") -> None:
    """Write the list of a split."""
    path = imagenet3d.list_file(root, category, split)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(names))  # the release's end without a line break


def archive(pickled: bytes, compression: int = zipfile.ZIP_STORED) -> bytes:
    """An .npz file of an array of objects, which is stored as these bytes."""
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }".ljust(117) + b"\n"
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", compression) as opened:
        opened.writestr("annotations.npy", b"\x93NUMPY\x01\0" + len(header).to_bytes(2, "little") + header + pickled)
    return target.getvalue()


def pickled(content: bytes) -> bytes:
    """The bytes that the array of objects of an .npz file is stored as."""
    with zipfile.ZipFile(io.BytesIO(content)) as opened:
        plain = opened.read("annotations.npy")
    return plain[plain.index(b"\n") + 1 :]


def pickle_of(objects: Sequence[Any], protocol: int) -> bytes:
    """What an array of objects is stored as, by a protocol of Python's pickle."""
    array = np.empty(len(objects), dtype=object)
    array[:] = objects
    return pickle.dumps(array, protocol)
