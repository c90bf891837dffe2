"""ImageNet3D in its own layout, with every oddity that its annotations may have."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.imagenet3d_files import listed, thing, write
from PIL import Image

from viewnet.config import PhotoConfig
from viewnet.data.build import photo_views
from viewnet.data.catalogue import check
from viewnet.data.photo_store import summary
from viewnet.data.readers import imagenet3d
from viewnet.data.store import ViewStore, tally
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def root(tmp_path) -> Path:
    """Two cars to calibrate, two to score, and what cannot be used."""
    folder = tmp_path / "imagenet3d"
    write(folder, "n1_1", thing(90, -10), thing(object_status="status_bad"), thing(45, 20, dense="dense_yes"))
    write(folder, "n1_2", thing(), image=False)
    write(folder, "n1_3", thing(350, 0), thing(distance=0.0), thing(object_status=None), thing(**{"class": "bus"}))
    write(folder, "n1_4", thing(180, 3, object_status="status_barely"))
    listed(folder, "train", "n1_1", "n1_2")
    listed(folder, "val", "n1_3", "n1_4")
    return folder


def views(config: PhotoConfig) -> ViewStore:
    return photo_views(config, workers=1, progress=False)


def reasons(report: imagenet3d.Report) -> dict[str, int]:
    return tally(reason for *_, reason in report.rejected)


def test_angles_are_read_in_degrees_and_elevations_unwrapped(root):
    found, report = imagenet3d.read(root, "car", "train")
    assert [(a.id, round(a.azimuth, 9), round(a.elevation, 9)) for a in found] == [
        ("n1_1/0", 90, -10),
        ("n1_1/2", 45, 20),
    ]
    assert found[0].box == (10, 20, 60, 80) and found[0].image_path == root / "images/car/n1_1.JPEG"
    assert report.rejected == [
        ("n1_1/1", "annotations/car/n1_1.npz", "status_bad"),
        ("n1_2", "images/car/n1_2.JPEG", "no such image"),
    ]
    _, report = imagenet3d.read(root, "car", "val")
    assert reasons(report) == {"distance of 0 or less": 1, "object without a status": 1}
    assert report.others == 1


@pytest.mark.parametrize(
    ("stored", "wanted"),
    [(0.0, 0), (math.pi / 2, 90), (2 * math.pi, 0), (2 * math.pi - 1e-12, 0), (-math.pi / 6, -30), (-1e-20, 0)],
)
def test_both_ways_to_write_an_angle_are_read(tmp_path, stored, wanted):
    write(tmp_path, "a", thing() | {"azimuth": stored, "elevation": stored})
    listed(tmp_path, "val", "a")
    (found,), _ = imagenet3d.read(tmp_path, "car", "val")
    assert found.elevation == pytest.approx(wanted, abs=1e-9)
    assert 0 <= found.azimuth < 360
    assert math.cos(math.radians(found.azimuth - wanted)) == pytest.approx(1)


def test_what_cannot_be_used_is_told(tmp_path):
    odd = {
        "steep": thing(elevation=95),
        "degrees": thing() | {"azimuth": 270.0},
        "nan": thing() | {"azimuth": np.float64("nan")},
        "huge": thing() | {"elevation": 10**400},
        "words": thing() | {"elevation": "low"},
        "true": thing() | {"elevation": True},
        "many": thing() | {"azimuth": np.zeros(3)},
        "without": {name: value for name, value in thing().items() if name != "azimuth"},
        "near": thing(distance=-1.0),
        "far": {name: value for name, value in thing().items() if name != "distance"},
        "status": thing(object_status="status_fine"),
        "number": thing(object_status=3),
        "boxless": thing(bbox=None),
        "three": thing(bbox=np.zeros(3)),
        "listed": thing(bbox=[1, 2, 3, 4]),
        "objects": thing(bbox=np.array([1, 2, [3], 4], dtype=object)),
        "nowhere": thing(bbox=np.array([200.0, 5, 300, 40])),
        "infinite": thing(bbox=np.array([0.0, 5, np.inf, 40])),
        "other": thing(**{"class": "bus"}),
    }
    for name, item in odd.items():
        write(tmp_path, name, item)
    write(tmp_path, "good", thing() | {"azimuth": np.array([1.0]), "elevation": np.float32(0.5)})
    write(tmp_path, "empty")
    write(tmp_path, "texts", "car")
    write(tmp_path, "broken").write_bytes(b"PK but not really")
    write(tmp_path, "alone").unlink()
    write(tmp_path, "blind", thing())
    (tmp_path / "images/car/blind.JPEG").write_bytes(b"no image")
    np.savez(write(tmp_path, "numbers", thing()), annotations=np.zeros(3))
    names = [path.stem for path in sorted((tmp_path / "images/car").iterdir())]
    listed(tmp_path, "val", *names, "good")
    found, report = imagenet3d.read(tmp_path, "car", "val")
    assert [a.id for a in found] == ["good/0"]
    assert reasons(report) == {
        "elevation beyond 90 degrees": 1,
        "azimuth beyond 2 pi radians": 1,
        "field 'azimuth' is no finite number": 1,
        "field 'elevation' is no finite number": 1,
        "field 'elevation' is no number": 2,
        "field 'azimuth' is no number": 1,
        "field 'azimuth' is missing": 1,
        "distance of 0 or less": 1,
        "field 'distance' is missing": 1,
        "object_status is unknown": 2,
        "box is not four numbers": 5,
        "box has no part in the image": 1,
        "no object of the category": 1,
        "annotation without objects": 2,
        "annotation cannot be read": 2,
        "no such annotation": 1,
        "image does not decode": 1,
    }
    assert sum(reasons(report).values()) + len(found) == len(names)
    assert report.mended == [("good", "listed twice")]


def test_boxes_are_mended_as_those_of_pascal3d(tmp_path):
    half = {"width": np.uint16(50), "height": np.uint16(45), "bbox": np.array([5.0, 10, 30, 40])}
    beyond = {"bbox": np.array([-30, 5, 400, 40])}
    exchanged = {"bbox": np.array([60.0, 80, 10, 20], np.float32)}
    write(tmp_path, "a", thing(**half), thing(**beyond), thing(**exchanged), thing(width=None, height=None))
    listed(tmp_path, "val", "a")
    found, report = imagenet3d.read(tmp_path, "car", "val")
    assert [a.box for a in found] == [(10, 20, 60, 80), (0, 5, 100, 40), (10, 20, 60, 80), (10, 20, 60, 80)]
    assert report.mended == [
        ("a/0", "box in another scale than its picture"),
        ("a/1", "box beyond the picture's edges"),
        ("a/2", "box with exchanged corners"),
    ]


def test_easy_and_first_objects(tmp_path):
    statuses = ("status_barely", "status_good", "status_partially", "status_bad", "status_good")
    write(tmp_path, "a", *(thing(object_status=status) for status in statuses))
    listed(tmp_path, "val", "a")
    for keep, wanted in {"all": "0124", "easy": "14", "first": "0"}.items():
        assert "".join(a.id[-1] for a in imagenet3d.read(tmp_path, "car", "val", keep)[0]) == wanted


def test_an_image_with_another_suffix_is_found(root):
    path = root / "images/car/n1_4.JPEG"
    path.rename(path.with_suffix(".jpg"))
    assert [a.image_path.name for a in imagenet3d.read(root, "car", "val")[0]] == ["n1_3.JPEG", "n1_4.jpg"]


def test_what_is_no_imagenet3d_is_refused(tmp_path):
    with pytest.raises(ViewnetError, match=r"car_imagenet_val\.txt: no such list"):
        imagenet3d.read(tmp_path, "car", "val")
    for names, message in (((), "the list is empty"), (("gone",), "1 no such image"), (("a 1",), "line 'a 1'")):
        listed(tmp_path, "val", *names)
        with pytest.raises(ViewnetError, match=message):
            imagenet3d.read(tmp_path, "car", "val")
    for changes in ({"category": "cow"}, {"split": "test"}, {"keep": "hard"}):
        with pytest.raises(ViewnetError, match=f"'{next(iter(changes.values()))}'"):
            imagenet3d.read(tmp_path, **{"category": "car", "split": "val", **changes})


def test_it_becomes_a_store_that_calibrates_on_train_and_scores_val(root):
    store = views(PhotoConfig("car", str(root), size=16))
    assert summary(store) == (
        "car: 2 calibrate, 2 scored; left out: 1 distance of 0 or less, 1 no such image, 1 object without a status, "
        "1 status_bad"
    )
    rows = store.index[["model_id", "split", "source"]].to_numpy().tolist()
    assert rows == [
        ["n1_1/0", "val", "images/car/n1_1.JPEG"],
        ["n1_1/2", "val", "images/car/n1_1.JPEG"],
        ["n1_3/0", "test", "images/car/n1_3.JPEG"],
        ["n1_4/0", "test", "images/car/n1_4.JPEG"],
    ]
    assert store.meta["made_by"]["objects of other categories"] == 1
    assert len(views(PhotoConfig("car", str(root), size=16, keep="easy"))) == 3
    assert views(PhotoConfig("car", str(root), size=16)).identity == store.identity
    # A changed annotation, and the image that was missing, are other stores.
    write(root, "n1_4", thing(170, 3))
    changed = views(PhotoConfig("car", str(root), size=16))
    Image.new("RGB", (100, 90)).save(root / "images/car/n1_2.JPEG")
    whole = views(PhotoConfig("car", str(root), size=16))
    assert len({store.identity, changed.identity, whole.identity}) == 3 and len(whole) == 5
    with pytest.raises(ViewnetError, match="subset 'pascal'"):
        views(PhotoConfig("car", str(root), subset="pascal"))
    with pytest.raises(ViewnetError, match=r"bus_imagenet_train\.txt: no such list"):
        views(PhotoConfig("bus", str(root)))


def test_a_copy_is_checked_and_named(root):
    listed(root, "train", "n2_1", category="bed")
    found = check(root)
    assert (found.key, found.counts) == ("imagenet3d", {"car": {"objects to calibrate": 2, "objects to score": 2}})
    assert found.problems == [
        "car: 1 left out: distance of 0 or less: n1_3/1",
        "car: 1 left out: no such image: n1_2",
        "car: 1 left out: object without a status: n1_3/2",
        "car: 1 left out: status_bad: n1_1/1",
    ]
    assert len(found.notes) == 1 and "bed" in found.notes[0]
    (root / "lists/car_imagenet_val.txt").unlink()
    assert any("no such list" in problem for problem in check(root).problems)
    for table in ("table3_pascal3d", "table5_dva"):
        assert experiment(table, data_root=str(root), categories="car").note.startswith("ImageNet3D; ")
