"""PASCAL3D+ read in its own layout: on the stand-in, and on records that are odd in every way the real ones are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from viewnet.cad import write_collection
from viewnet.data import pascal3d, pascal3d_standin
from viewnet.data.pascal3d_standin import write_stand_in
from viewnet.data.photos import Crop, cut, photo_store
from viewnet.data.shapenet import find_models, load_model
from viewnet.errors import ViewnetError
from viewnet.viewpoints import drawn


@pytest.fixture(scope="module")
def stand_in(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pascal3d")
    write_collection(folder / "cad", ["bus"], 4, 0, progress=False)
    meshes = [load_model(model) for model in find_models(folder / "cad", "bus")]
    write_stand_in(folder / "root", {"bus": {"train": meshes[:2], "val": meshes[2:]}}, 12)
    return folder / "root"


def viewpoint(**changes):
    base = {
        "azimuth": 10.0,
        "elevation": 5.0,
        "distance": 3.0,
        "theta": 2.0,
        "azimuth_coarse": 45,
        "elevation_coarse": 0,
    }
    return {**base, **changes}


def thing(**changes):
    base = {
        "class": "car",
        "bbox": np.array([11.0, 21, 60, 80]),
        "truncated": 0,
        "occluded": 0,
        "difficult": 0,
        "viewpoint": viewpoint(),
    }
    return {**base, **changes}


def write(root: Path, name: str, *objects) -> None:
    pascal3d_standin._write(root, "car", "imagenet", name, Image.new("RGB", (100, 90), (9, 99, 199)), objects)


def listed(root: Path, *names: str) -> None:
    pascal3d_standin._write_list(root, "car", "imagenet", "val", names)


def test_what_is_written_is_read(stand_in):
    wanted = drawn(np.random.default_rng(0), 12).query("category == 'bus' and split == 'val'")
    for subset in pascal3d.SUBSETS:
        found, report = pascal3d.read(stand_in, "bus", subset, "val")
        assert [a.azimuth for a in found] == pytest.approx(wanted["azimuth"].tolist())
        assert [a.elevation for a in found] == pytest.approx(wanted["elevation"].tolist())
        assert report.rejected == []
        for a in found:
            with Image.open(a.picture) as picture:
                assert 0 <= a.box[0] < a.box[2] <= picture.width and 0 <= a.box[1] < a.box[3] <= picture.height
    everything = {("bus", subset, split) for subset in pascal3d.SUBSETS for split in pascal3d.SPLITS}
    assert set(pascal3d.subsets(stand_in)) == everything


def test_filters_by_name(stand_in):
    everything, _ = pascal3d.read(stand_in, "bus", "pascal", "val")
    easy, _ = pascal3d.read(stand_in, "bus", "pascal", "val", keep="easy")
    assert [a for a in everything if a.easy] == easy
    assert 0 < len(easy) < len(everything)


def test_boxes_flags_and_several_objects(tmp_path):
    write(tmp_path, "a", thing(), thing(**{"class": "bus"}), thing(truncated=1, bbox=np.array([60.0, 80, 11, 21])))
    listed(tmp_path, "a")
    found, report = pascal3d.read(tmp_path, "car", "imagenet", "val")
    assert [a.number for a in found] == [0, 2]
    assert found[0].box == found[1].box == (10, 20, 59, 79)  # the second one's corners are exchanged
    assert [a.easy for a in found] == [True, False]
    assert found[0].tilt == 2
    assert found[0].id == "imagenet/a/0"
    assert len(pascal3d.read(tmp_path, "car", "imagenet", "val", keep="first")[0]) == 1
    assert report.counts == {}


def test_what_cannot_be_used_is_told(tmp_path):
    write(tmp_path, "good", thing())
    write(tmp_path, "coarse", thing(viewpoint=viewpoint(distance=0)))
    write(tmp_path, "bare", thing(viewpoint=np.zeros(0)))
    write(tmp_path, "steep", thing(viewpoint=viewpoint(elevation=95.0)))
    write(tmp_path, "nan", thing(viewpoint=viewpoint(azimuth=np.nan)))
    write(tmp_path, "boxless", thing(bbox=np.zeros(0)))
    write(tmp_path, "other", thing(**{"class": "bus"}))
    write(tmp_path, "broken", thing())
    (tmp_path / "Annotations/car_imagenet/broken.mat").write_bytes(b"MATLAB 5.0 but not really")
    write(tmp_path, "alone", thing())
    (tmp_path / "Annotations/car_imagenet/alone.mat").unlink()
    listed(tmp_path, "good", "coarse", "bare", "steep", "nan", "boxless", "other", "broken", "alone", "missing")
    found, report = pascal3d.read(tmp_path, "car", "imagenet", "val")
    assert [a.image for a in found] == ["good"]
    assert report.counts == {
        "only coarsely annotated": 1,
        "object without a viewpoint": 1,
        "elevation beyond 90 degrees": 1,
        "field 'azimuth' is no finite number": 1,
        "box is not four numbers": 1,
        "no object of the category": 1,
        "annotation cannot be read": 1,
        "no such annotation": 1,
        "no such picture": 1,
    }
    with_coarse, _ = pascal3d.read(tmp_path, "car", "imagenet", "val", coarse=True)
    assert [(a.image, a.azimuth) for a in with_coarse] == [("good", 10), ("coarse", 45)]


def test_what_is_no_pascal3d_is_refused(tmp_path):
    with pytest.raises(ViewnetError, match=r"car_imagenet_val\.txt: no such list: expected the folder of PASCAL3D"):
        pascal3d.read(tmp_path, "car", "imagenet", "val")
    listed(tmp_path, "missing")
    with pytest.raises(ViewnetError, match=r"no usable car in imagenet val \(1 no such picture\)"):
        pascal3d.read(tmp_path, "car", "imagenet", "val")


@pytest.mark.parametrize(
    ("crop", "wanted"),
    [
        (Crop(4), "exact"),  # a square box of one colour: nothing else is seen
        (Crop(4, margin=0.5), "around"),
    ],
)
def test_a_box_is_cut_with_so_much_around_it(crop, wanted):
    picture = Image.new("RGB", (40, 40), (0, 0, 255))
    picture.paste((255, 0, 0), (10, 10, 20, 20))
    small = cut(picture, (10, 10, 20, 20), crop)
    assert small.shape == (4, 4, 4) and (small[..., 3] == 255).all()
    if wanted == "exact":
        assert (small[..., :3] == (255, 0, 0)).all()
    else:
        assert (small[[0, -1], :, :3] == (0, 0, 255)).all() and (small[1:3, 1:3, :3] == (255, 0, 0)).all()


def test_beyond_the_edge_there_is_the_colour_and_shape_is_kept():
    small = cut(Image.new("RGB", (40, 10), (200, 200, 200)), None, Crop(8, colour=(1, 2, 3)))
    assert (small[[0, 1, 6, 7], :, :3] == (1, 2, 3)).all()
    assert (small[3:5, :, :3] == 200).all()
    stretched = cut(Image.new("RGB", (40, 10), (200, 200, 200)), None, Crop(8, square=False))
    assert (stretched[..., :3] == 200).all()


def test_boxes_outside_of_the_picture_are_refused():
    with pytest.raises(ViewnetError, match=r"box has no part in the picture \(40 x 10\)"):
        cut(Image.new("RGB", (40, 10)), (50, 0, 60, 10), Crop(8))


def test_photographs_become_a_view_store(stand_in, tmp_path):
    found, _ = pascal3d.read(stand_in, "bus", "imagenet", "val")
    found[3].picture.with_suffix(".JPEG").write_bytes(b"no picture")
    store = photo_store(found, tmp_path / "store", Crop(32), {"data": "stand-in"}, {"val": "test"})
    assert len(store) == len(found) - 1
    assert store.rejected["reason"].tolist() == ["picture does not decode (UnidentifiedImageError)"]
    assert set(store.index["split"]) == {"test"}
    assert store.images.shape[1:] == (32, 32, 4)
    by_id = {a.id: a for a in found}
    for row in store.index.itertuples():
        assert row.azimuth == pytest.approx(by_id[row.model_id].azimuth)
    with pytest.raises(ViewnetError, match="none of 1 photographs can be used"):
        photo_store(found[3:4], tmp_path / "none", Crop(32), {})
