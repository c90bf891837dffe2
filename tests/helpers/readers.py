"""Every reader of the package: how to write a small valid input for it, how to read it, and which files to damage."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pandas as pd
import scipy.io
from helpers import imagenet3d_files
from helpers.cad_files import model_of, write_box
from helpers.damage import EXECUTED, damaged, other_array, other_objects, other_record
from helpers.photo_data import write_crops
from helpers.video_data import write_frames, write_freiburg, write_uco3d, write_video
from hypothesis import strategies as st
from PIL import Image

from viewnet import paths
from viewnet.config import PhotoConfig, VideoConfig
from viewnet.data import backgrounds, clip_store, photo_store
from viewnet.data.build import photo_views, video_views
from viewnet.data.readers import imagenet3d, pascal3d
from viewnet.data.readers.shapenet import find_models, load_model
from viewnet.data.store import ViewStore
from viewnet.data.synthetic import pascal3d_standin
from viewnet.data.synthetic.objectron_standin import ObjectronStandIn
from viewnet.render import render_mesh

Rewriter = Callable[[bytes], st.SearchStrategy[bytes]]


@dataclass(frozen=True)
class Reader:
    """`write` puts a valid input into an empty folder, `read` reads all of it and checks the result.

    files   those to damage, patterns within the folder -> None, or a strategy of well-formed files with other content
    names   what a ViewnetError has to name: the damaged file, or one of these, "{folder}" being its folder
    """

    name: str
    write: Callable[[Path], None]
    read: Callable[[Path], object]
    files: Mapping[str, Rewriter | None]
    names: tuple[str, ...] = field(default=())

    def spoilt(self, folder: Path) -> list[tuple[Path, Rewriter | None]]:
        """The files that exist, with their strategies."""
        found = [(path, other) for pattern, other in self.files.items() for path in sorted(folder.glob(pattern))]
        assert len({path for path, _ in found}) >= len(self.files), f"{self.name}: a file is missing"
        return found

    def places(self, folder: Path, file: Path) -> list[str]:
        """What a message may name when `file` is damaged."""
        return [str(file), *(name.format(folder=folder) for name in self.names)]


def contents(original: bytes, other: Rewriter | None) -> st.SearchStrategy[bytes]:
    """Damaged versions of a file."""
    if other is None:
        return damaged(original)
    return st.one_of(damaged(original), other(original))


def placed(files: Mapping[str, bytes]) -> Callable[[Path], None]:
    """Writes files into a folder."""

    def write(folder: Path) -> None:
        for name, content in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)

    return write


def fresh(make: Callable[[], Any]) -> Any:
    """`make()` with a new data folder, so that nothing is reused."""
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(os.environ, VIEWNET_DATA=folder):
        return make()


def check_store(store: ViewStore) -> str:
    """Check what all readers of view stores rely on. Returns what was rejected, in words."""
    index = store.index
    assert len(store) == len(index) > 0 and store.images.dtype == np.uint8
    assert int(np.asarray(store.images[-1]).max()) <= 255
    known = index["azimuth"].notna()
    assert index.loc[known, "azimuth"].between(0, 360, inclusive="left").all()
    assert index.loc[known, "elevation"].between(-90, 90).all()
    assert list(store.rejected.columns) == ["model_id", "path", "reason"]
    assert not any("\n" in reason or len(reason) > 2000 for reason in store.rejected["reason"])
    return "; ".join(store.rejected["reason"])


# ---- CAD models

SYNSET = "02958343"


def _textured(root: Path) -> None:
    file = write_box(root, SYNSET, "box")
    folder = file.parent.parent / "images"
    folder.mkdir()
    image = Image.fromarray(np.random.default_rng(0).integers(0, 255, (8, 8, 4), dtype=np.uint8))
    image.save(folder / "texture.png")
    image.convert("RGB").save(folder / "texture.jpg")
    file.with_suffix(".mtl").write_text(
        "newmtl front\nKd 0.2 0.4 0.6\nd 0.9\nmap_Kd -s 2 2 -o 0.5 0 ../images/texture.png\n"
        "newmtl back\nTr 0.1\nmap_Kd ../images/texture.jpg\n"
    )
    text = file.read_text().splitlines()
    corners = ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines = [
        " ".join(f"{n}/{1 + i}" for i, n in enumerate(line[2:].split())) if line[0] == "f" else line for line in text
    ]
    lines = [f"f {line}" if "/" in line else line for line in lines]
    file.write_text("\n".join([lines[0], "mtllib model_normalized.mtl", *corners, *lines[1:]]) + "\n")


def _mesh(root: Path) -> object:
    mesh = load_model(model_of(root / SYNSET / "box/models/model_normalized.obj"))
    assert np.isfinite(mesh.vertices).all() and np.abs(mesh.vertices).max() <= 0.5001
    assert mesh.uv is None or np.isfinite(mesh.uv).all()
    assert mesh.colours is None or np.isfinite(mesh.colours).all()
    assert mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
    assert mesh.material.min() >= 0 and mesh.material.max() < len(mesh.materials)
    image = render_mesh(mesh, np.array([30.0]), np.array([20.0]), 16, 1)
    assert image.shape == (1, 16, 16, 4)
    return mesh


def _collection(root: Path) -> None:
    rows = ["id,synsetId,subSynsetId,modelId,split"]
    for number, split in enumerate(("train", "val", "test")):
        (root / SYNSET / f"{number}" / "models").mkdir(parents=True)
        (root / SYNSET / f"{number}" / "models/model_normalized.obj").write_text("")
        rows.append(f"{number},{SYNSET},{SYNSET},{number},{split}")
        (root / "lists").mkdir(exist_ok=True)
        (root / f"lists/{SYNSET}_{split}.txt").write_text(f"{number}\n")
    (root / "all.csv").write_text("\n".join(rows) + "\n")


def _models(root: Path) -> object:
    listed = find_models(root, "car", root / "lists"), find_models(root, "car")
    assert {model.split for models in listed for model in models} == {"train", "val", "test"}
    return listed


# ---- images

IMAGES = ("a.png", "b.jpg", "c.bmp", "d.webp", "e.ppm", "f.tif")


def _images(root: Path) -> None:
    rng = np.random.default_rng(0)
    (root / "a").mkdir()
    for number, name in enumerate(IMAGES):
        image = Image.fromarray(rng.integers(0, 255, (24, 32, 3), dtype=np.uint8))
        image.save(root / "a" / name, **({"exif": _turned()} if number in (1, 3) else {}))
    (root / "ClassName.txt").write_text("/a\n/b\n")


def _turned() -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112] = 6
    return exif


def _backgrounds(root: Path) -> object:
    def load() -> tuple[np.ndarray, pd.DataFrame]:
        made = backgrounds.load(str(root), 8, 10, progress=False)
        return made.images, pd.read_csv(paths.data() / "backgrounds" / made.identity / "rejected.csv")

    images, rejected = fresh(load)
    assert images.shape[1:] == (3, 8, 8) and len(images) + len(rejected) >= len(IMAGES)
    return "; ".join(rejected["reason"])


def _kept(root: Path) -> None:
    with mock.patch.dict(os.environ, VIEWNET_DATA=str(root)):
        backgrounds.load("drawn", 4, 3, progress=False)


def _kept_again(root: Path) -> object:
    with mock.patch.dict(os.environ, VIEWNET_DATA=str(root)):
        found = backgrounds.load("drawn", 4, 3, progress=False)
    assert found.images.shape == (3, 3, 4, 4) and found.images.dtype == np.uint8
    return found


def _photographs(root: Path) -> None:
    rng = np.random.default_rng(0)
    (root / "images").mkdir()
    rows = ["file,azimuth_deg,elevation_deg,split,x0,y0,x1,y1"]
    for number, (name, split) in enumerate((("a.png", "val"), ("b.jpg", "val"), ("c.png", "test"), ("d.webp", "test"))):
        deep = number == 0
        pixels = rng.integers(0, 65535 if deep else 255, (24, 32) if deep else (24, 32, 3))
        image = Image.fromarray(pixels.astype(np.uint16 if deep else np.uint8))
        image.save(root / "images" / name, **({"exif": _turned()} if number in (1, 3) else {}))
        rows.append(f"{name},{30.5 * number},{number},{split},2,3,20,22")
    (root / "viewpoints.csv").write_text("\n".join(rows) + "\n")


def _photo_store(root: Path) -> object:
    config = PhotoConfig("car", str(root), size=8)

    def read() -> object:
        store = photo_views(config, 1, progress=False)
        return f"{photo_store.summary(store)}; {check_store(store)}"

    return fresh(read)


def _crops(root: Path) -> None:
    write_crops(root, [(30.5 * number, number) for number in range(8)], "car", ".png")


def _thing(**changes: Any) -> dict[str, Any]:
    viewpoint = {"azimuth": 10.0, "elevation": 5.0, "distance": 3.0, "theta": 2.0}
    base = {"class": "car", "bbox": np.array([1.0, 2, 20, 22]), "truncated": 0, "occluded": 0, "difficult": 0}
    return {**base, "viewpoint": viewpoint, **changes}


def _pascal3d(root: Path) -> None:
    for number, split in enumerate(pascal3d.SPLITS):
        names = [f"n{number}_{i}" for i in range(2)]
        for name in names:
            image = Image.fromarray(np.random.default_rng(number).integers(0, 255, (24, 32, 3), dtype=np.uint8))
            pascal3d_standin.write_annotated_image(
                root, "car", "imagenet", name, image, [_thing(), _thing(difficult=1)]
            )
        pascal3d_standin.write_list(root, "car", "imagenet", split, names)
    # One record without compression, in which damage is not caught by a checksum.
    path = pascal3d.annotation_file(root, "car", "imagenet", "n0_0")
    scipy.io.savemat(path, {"record": {"objects": _thing(), "imgsize": np.array([32.0, 24, 3])}})


def _imagenet3d(root: Path) -> None:
    small = {"bbox": np.array([2.0, 3, 60, 70]), "width": None, "height": np.uint16(90)}
    for number, split in enumerate(pascal3d.SPLITS):
        names = [f"n{number}_{i}" for i in range(2)]
        for name in names:
            things = (
                imagenet3d_files.thing(elevation=-10),
                imagenet3d_files.thing(object_status="status_barely", **small),
            )
            imagenet3d_files.write(root, name, *things)
        imagenet3d_files.listed(root, split, *names)


def _imagenet3d_objects(root: Path) -> object:
    """What decides the views, without cutting them as PASCAL3D+'s are: there are many files to try."""
    reasons = []
    for split in pascal3d.SPLITS:
        found, report = imagenet3d.read(root, "car", split)
        assert all(0 <= a.azimuth < 360 and abs(a.elevation) <= 90 for a in found)
        assert all(0 <= a.box[0] < a.box[2] <= 100 and 0 <= a.box[1] < a.box[3] <= 90 for a in found if a.box)
        reasons += [reason for *_, reason in report.rejected]
    assert not any("\n" in reason or len(reason) > 2000 for reason in reasons)
    assert not EXECUTED.exists(), "a file was executed"
    return "; ".join(reasons).encode().decode()  # which can be written


# ---- videos

_SMALL: dict[str, Any] = {"size": 8, "side": 1.0}


def _freiburg(root: Path) -> None:
    write_freiburg(root, [1, 2], frames=3)
    for number in (1, 2):
        write_frames(root / f"masks/car{number:03d}", {f"{k + 1}.png": 255 for k in range(3)})


def _video_folder(root: Path) -> None:
    write_video(root / "a.mp4", [10, 90, 200], (32, 24))
    write_video(root / "b.avi", [10, 90, 200], (32, 24))
    rng = np.random.default_rng(0)
    (root / "c").mkdir()
    for number in range(3):
        Image.fromarray(rng.integers(0, 255, (24, 32, 4), dtype=np.uint8)).save(root / f"c/{number}.png")
    (root / "splits.csv").write_text("clip,split\na,train\nb,train\nc,train\n")


def _uco3d(root: Path) -> None:
    write_uco3d(root, [f"personal_vehicles/car__automobile_/{name}" for name in "ab"], frames=3)


def _objectron(root: Path) -> None:
    ObjectronStandIn("chair", videos=3, frames=3, size=(90, 120)).write(root, progress=False)


def _clips(category: str, masks: str = "files") -> Callable[[Path], object]:
    def read(root: Path) -> object:
        config = VideoConfig(category, str(root), masks=masks, **_SMALL)  # type: ignore[arg-type]

        def make() -> object:
            store = video_views(config, 1, progress=False)
            return f"{clip_store.summary(store)}; {check_store(store)}"

        return fresh(make)

    return read


READERS = (
    Reader(
        "CAD model",
        _textured,
        _mesh,
        {"*/*/models/*.obj": None, "*/*/models/*.mtl": None, "*/*/images/*.png": None, "*/*/images/*.jpg": None},
        ("{folder}/" + SYNSET + "/box/models/model_normalized.obj",),
    ),
    Reader("ShapeNet's lists", _collection, _models, {"all.csv": None, "lists/*.txt": None}, ("{folder}/lists",)),
    Reader("pictures", _images, _backgrounds, {"a/*": None, "ClassName.txt": None}, ("{folder}",)),
    Reader("backgrounds kept", _kept, _kept_again, {"backgrounds/*/*.npy": other_array}, ("{folder}/backgrounds",)),
    Reader("photographs", _photographs, _photo_store, {"images/*": None, "viewpoints.csv": None}, ("{folder}",)),
    Reader("crops", _crops, _photo_store, {"test_crop/0.png": None, "*_meta.csv": None}, ("{folder}",)),
    Reader(
        "PASCAL3D+",
        _pascal3d,
        _photo_store,
        {"Annotations/*/n0_*.mat": other_record, "Images/*/n0_0.JPEG": None, "Image_sets/*.txt": None},
        ("{folder}",),
    ),
    Reader("ImageNet3D", _imagenet3d, _imagenet3d_objects, {"annotations/*/*.npz": other_objects}, ("{folder}",)),
    Reader(
        "Freiburg cars",
        _freiburg,
        _clips("car"),
        {"annotations/*.txt": None, "car001/1.png": None, "masks/car001/*.png": None},
        ("{folder}",),
    ),
    Reader(
        "Objectron",
        _objectron,
        _clips("chair"),
        {"annotations/*/*/0.pbdata": None, "index/*": None, "videos/*/*/0/*0.jpg": None, "masks/*/*/0/*0.png": None},
        ("{folder}",),
    ),
    Reader(
        "videos",
        _video_folder,
        _clips("car", "none"),
        {"*.mp4": None, "*.avi": None, "splits.csv": None},
        ("{folder}",),
    ),
    Reader("uCO3D", _uco3d, _clips("car"), {"*/*/a/*.mp4": None, "*/*/a/*.mkv": None}, ("{folder}",)),
    Reader("frames with alpha", _video_folder, _clips("car", "alpha"), {"c/*.png": None}, ("{folder}",)),
)
