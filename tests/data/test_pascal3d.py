"""PASCAL3D+ in its own layout: the stand-in, and records with every oddity of the real ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from helpers.pascal3d_files import listed, thing, viewpoint, write
from PIL import Image

from viewnet import cad
from viewnet.config import CATEGORIES
from viewnet.data.annotated_viewpoints import sample
from viewnet.data.readers import pascal3d
from viewnet.data.store import tally
from viewnet.data.synthetic import pascal3d_standin
from viewnet.data.synthetic.pascal3d_standin import Pascal3DStandIn
from viewnet.errors import ViewnetError


@pytest.fixture(scope="module")
def stand_in(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("pascal3d") / "root"
    Pascal3DStandIn("bus", "both", 3, 12).write(root, workers=1, progress=False)
    return root


def counts(report: pascal3d.Report) -> dict[str, int]:
    """Reason -> number of objects or images that cannot be used."""
    return tally(reason for *_, reason in report.rejected)


def read(root: Path, **filters):
    return pascal3d.read(root, "car", "imagenet", "val", **filters)


def test_what_is_written_is_read(stand_in):
    wanted = sample(np.random.default_rng(0), 12).query("category == 'bus' and split == 'val'")
    for subset in pascal3d.SUBSETS:
        found, report = pascal3d.read(stand_in, "bus", subset, "val")
        assert [a.azimuth for a in found] == pytest.approx(wanted["azimuth"].tolist())
        assert [a.elevation for a in found] == pytest.approx(wanted["elevation"].tolist())
        assert report == pascal3d.Report()
        for a in found:
            with Image.open(a.image_path) as image:
                assert 0 <= a.box[0] < a.box[2] <= image.width and 0 <= a.box[1] < a.box[3] <= image.height
    both, _ = pascal3d.read(stand_in, "bus", "both", "val")
    assert [a.id.split("/")[0] for a in both] == ["imagenet"] * 12 + ["pascal"] * 12
    assert len({a.id for a in both}) == 24


def test_the_files_lie_where_the_release_has_them(stand_in):
    for path in (
        "Annotations/bus_imagenet/bus_train_00000.mat",
        "Annotations/bus_pascal/bus_val_00011.mat",
        "Images/bus_imagenet/bus_val_00000.JPEG",
        "Images/bus_pascal/bus_train_00000.jpg",
        "Image_sets/bus_imagenet_train.txt",
        "Image_sets/bus_imagenet_val.txt",
        "PASCAL/VOCdevkit/VOC2012/ImageSets/Main/bus_train.txt",
        "PASCAL/VOCdevkit/VOC2012/ImageSets/Main/bus_val.txt",
    ):
        assert (stand_in / path).is_file(), path
    record = scipy.io.loadmat(stand_in / "Annotations/bus_imagenet/bus_train_00000.mat")["record"]
    assert str(record["objects"][0, 0]["class"][0, 0][0]) == "bus"


def test_the_stand_in_is_the_same_whatever_the_number_of_processes(stand_in, tmp_path):
    Pascal3DStandIn("bus", "both", 3, 12).write(tmp_path / "again", workers=2, progress=False)
    files = sorted(path.relative_to(stand_in) for path in stand_in.rglob("*") if path.is_file())
    assert len(files) == 2 * 2 * 12 * 2 + 4
    for file in files:
        assert (tmp_path / "again" / file).read_bytes() == (stand_in / file).read_bytes(), file


def test_the_stand_in_shows_other_models_than_training(stand_in):
    shown = {cad.model_id("bus", i, pascal3d_standin.MODEL_SEED) for i in range(6)}
    assert shown.isdisjoint(cad.model_id("bus", i) for i in range(2000))
    plan = Pascal3DStandIn("bus", "imagenet", 3, 12).plan()
    assert [{p.name.split("_")[1] for p in plan[model]} for model in range(6)] == [{"train"}] * 3 + [{"val"}] * 3
    assert {len(photographs) for photographs in plan.values()} == {4}


def test_a_box_of_the_stand_in_holds_its_object(tmp_path):
    # On white, other pixels are the object, its shadow or noise, and all of them are near the box.
    (tmp_path / "white").mkdir()
    Image.new("RGB", (300, 300), (255, 255, 255)).save(tmp_path / "white/a.png")
    made = Pascal3DStandIn("car", models=2, count=6, backgrounds=str(tmp_path / "white"))
    made.write(tmp_path / "root", workers=1, progress=False)
    for a in pascal3d.read(tmp_path / "root", "car", "imagenet", "val")[0]:
        with Image.open(a.image_path) as image:
            pixels = np.asarray(image.convert("L"), dtype=float)
        x0, y0, x1, y1 = (int(value) for value in a.box)
        inside = pixels[y0:y1, x0:x1]
        outside = np.concatenate([pixels[: max(y0 - 4, 0)].ravel(), pixels[:, : max(x0 - 15, 0)].ravel()])
        assert (inside < pixels.max() - 60).mean() > 0.3
        assert len(outside) == 0 or (outside < pixels.max() - 60).mean() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("category", CATEGORIES)
def test_every_category_has_a_stand_in(category, tmp_path):
    Pascal3DStandIn(category, models=2, count=3).write(tmp_path / "root", workers=1, progress=False)
    for split in pascal3d.SPLITS:
        assert len(pascal3d.read(tmp_path / "root", category, "imagenet", split)[0]) == 3


def test_a_stand_in_is_described_by_all_that_decides_it(tmp_path):
    (tmp_path / "p").mkdir()
    Image.new("RGB", (30, 30)).save(tmp_path / "p/a.png")
    base = ("bus", "imagenet", 3, 12, 0)
    changed = [("car", *base[1:]), ("bus", "both", 3, 12, 0), (*base[:2], 4, 12, 0), (*base[:3], 13, 0), (*base[:4], 1)]
    made = [Pascal3DStandIn(*item) for item in (base, *changed, (*base, str(tmp_path / "p")))]
    values = [stand_in.describe() for stand_in in made]
    assert len({json.dumps(value, sort_keys=True) for value in values}) == 7


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"models": 0}, "models 0"),
        ({"count": 0}, "count 0"),
        ({"category": "cow"}, "category 'cow'"),
        ({"subset": "coco"}, "subset 'coco'"),
        ({"backgrounds": "/nowhere"}, "/nowhere: no such folder"),
    ],
)
def test_a_stand_in_that_cannot_be_made(tmp_path, changes, message):
    with pytest.raises(ViewnetError, match=message):
        Pascal3DStandIn(**{"category": "bus", **changes}).write(tmp_path / "root", progress=False)
    with pytest.raises(ViewnetError, match="workers 0"):
        Pascal3DStandIn("bus").write(tmp_path / "root", workers=0)


def test_a_stand_in_is_never_written_over_something(stand_in):
    with pytest.raises(ViewnetError, match="is not empty"):
        Pascal3DStandIn("bus").write(stand_in, progress=False)


def test_filters_by_name(stand_in):
    everything, _ = pascal3d.read(stand_in, "bus", "pascal", "val")
    easy, report = pascal3d.read(stand_in, "bus", "pascal", "val", keep="easy")
    flagged = {name: reason for name, _, reason in report.rejected}
    assert [a for a in everything if a.id not in flagged] == easy
    assert 0 < len(easy) < len(everything) and set(flagged.values()) == {"truncated, occluded or difficult"}


def test_boxes_flags_and_several_objects(tmp_path):
    write(tmp_path, "a", thing(), thing(**{"class": "bus"}), thing(truncated=1, bbox=np.array([60.0, 80, 11, 21])))
    listed(tmp_path, "a")
    found, report = read(tmp_path)
    assert [a.id for a in found] == ["imagenet/a/0", "imagenet/a/2"]
    assert found[0].box == found[1].box == (10, 20, 60, 80)  # the second one's corners are exchanged
    assert read(tmp_path, keep="easy")[0] == found[:1]
    assert report.rejected == [] and report.others == 1
    assert report.mended == [("imagenet/a/2", "box with exchanged corners")]
    first, report = read(tmp_path, keep="first")
    assert first == found[:1]
    assert counts(report) == {"not the first of its image": 1}


def test_boxes_beyond_the_image_and_in_another_scale(tmp_path):
    write(tmp_path, "a", thing(bbox=np.array([-30.0, 5, 400, 40])), thing(bbox=np.array([1.0, 1, 100.5, 90])))
    write(tmp_path, "b", thing(bbox=np.array([200.0, 5, 300, 40])), thing())
    write(tmp_path, "c", thing(bbox=np.array([21.0, 41, 120, 160])))
    record = scipy.io.loadmat(tmp_path / "Annotations/car_imagenet/c.mat")["record"]
    record["imgsize"][0, 0] = np.array([200.0, 180, 3])
    scipy.io.savemat(tmp_path / "Annotations/car_imagenet/c.mat", {"record": record})
    listed(tmp_path, "a", "b", "c")
    found, report = read(tmp_path)
    assert {a.id: a.box for a in found} == {
        "imagenet/a/0": (0, 4, 100, 40),
        "imagenet/a/1": (0, 0, 100, 90),
        "imagenet/b/1": (10, 20, 60, 80),
        "imagenet/c/0": (10, 20, 60, 80),
    }
    assert report.mended == [
        ("imagenet/a/0", "box beyond the picture's edges"),
        ("imagenet/c/0", "box in another scale than its picture"),
    ]
    where = "Annotations/car_imagenet/b.mat"
    assert report.rejected == [("imagenet/b/0", where, "box has no part in the image (100 x 90)")]


def test_what_cannot_be_used_is_told(tmp_path):
    write(tmp_path, "good", thing())
    write(tmp_path, "coarse", thing(viewpoint=viewpoint(distance=0, azimuth=0, elevation=0)))
    write(tmp_path, "lacking", thing(viewpoint=viewpoint(azimuth=None, elevation=None, distance=None, theta=None)))
    write(tmp_path, "hollow", thing(viewpoint=viewpoint(azimuth=np.zeros(0))))
    write(tmp_path, "bare", thing(viewpoint=np.zeros(0)))
    write(tmp_path, "without", thing(viewpoint=None))
    write(tmp_path, "steep", thing(viewpoint=viewpoint(elevation=95.0)))
    write(tmp_path, "nan", thing(viewpoint=viewpoint(azimuth=np.nan)))
    write(tmp_path, "words", thing(viewpoint=viewpoint(elevation="low")))
    write(tmp_path, "nothing", thing(viewpoint={"distance": 0.0}))
    write(tmp_path, "boxless", thing(bbox=np.zeros(0)))
    write(tmp_path, "other", thing(**{"class": "bus"}))
    write(tmp_path, "broken", thing())
    (tmp_path / "Annotations/car_imagenet/broken.mat").write_bytes(b"MATLAB 5.0 but not really")
    write(tmp_path, "alone", thing())
    (tmp_path / "Annotations/car_imagenet/alone.mat").unlink()
    write(tmp_path, "blind", thing())
    (tmp_path / "Images/car_imagenet/blind.JPEG").write_bytes(b"no image")
    for name, content in (("strange", {"x": 1}), ("vacant", {"record": {"size": 1}}), ("empty", None)):
        write(tmp_path, name, thing())
        content = {"record": {"objects": np.zeros((0, 0))}} if content is None else content
        scipy.io.savemat(tmp_path / f"Annotations/car_imagenet/{name}.mat", content)
    names = [path.stem for path in (tmp_path / "Images/car_imagenet").iterdir()]
    listed(tmp_path, *names, "missing", "good")
    found, report = read(tmp_path)
    assert [a.id for a in found] == ["imagenet/good/0"]
    assert counts(report) == {
        "only coarsely annotated": 4,
        "object without a viewpoint": 2,
        "elevation beyond 90 degrees": 1,
        "field 'azimuth' is no finite number": 1,
        "field 'elevation' is no number": 1,
        "box is not four numbers": 1,
        "no object of the category": 2,
        "annotation cannot be read": 1,
        "no such annotation": 1,
        "annotation without a record": 1,
        "annotation without objects": 1,
        "image does not decode": 1,
        "no such image": 1,
    }
    assert sum(counts(report).values()) + len(found) == len(names) + 1
    assert report.mended == [("imagenet/good", "listed twice")]
    assert report.others == 1
    assert ("imagenet/missing", "Images/car_imagenet/missing.JPEG", "no such image") in report.rejected


def test_a_front_view_from_some_distance_is_no_coarse_one(tmp_path):
    write(tmp_path, "front", thing(viewpoint=viewpoint(azimuth=0.0, elevation=0.0, theta=0.0)))
    write(tmp_path, "near", thing(viewpoint=viewpoint(distance=None)))
    write(tmp_path, "zeros", thing(viewpoint=viewpoint(azimuth=0.0, elevation=0.0, theta=0.0, distance=None)))
    write(tmp_path, "turned", thing(viewpoint=viewpoint(azimuth=-1e-20)))
    listed(tmp_path, "front", "near", "zeros", "turned")
    found, report = read(tmp_path)
    assert {a.image_path.stem: a.azimuth for a in found} == {"front": 0, "near": 10, "turned": 0}
    assert counts(report) == {"only coarsely annotated": 1}


def test_lists_of_both_kinds(tmp_path):
    for name in ("a", "b", "c", "d"):
        write(tmp_path, name, thing(), subset="pascal")
    voc = tmp_path / "PASCAL/VOCdevkit/VOC2012/ImageSets/Main"
    voc.mkdir(parents=True)
    (voc / "car_val.txt").write_text("a  1 \nb -1\r\nc  0\n\n")
    assert [a.image_path.stem for a in pascal3d.read(tmp_path, "car", "pascal", "val")[0]] == ["a", "c"]
    # Copies of the data set have PASCAL's lists beside ImageNet's, with or without the last column.
    (tmp_path / "Image_sets").mkdir()
    (tmp_path / "Image_sets/car_pascal_val.txt").write_text("d  \nb 1\n")
    (tmp_path / "Images/car_pascal/d.jpg").rename(tmp_path / "Images/car_pascal/d.png")
    found = pascal3d.read(tmp_path, "car", "pascal", "val")[0]
    assert [a.image_path.name for a in found] == ["d.png", "b.jpg"]
    (tmp_path / "Image_sets/car_pascal_val.txt").write_text("a yes\n")
    with pytest.raises(ViewnetError, match=r"car_pascal_val\.txt: line 'a yes'"):
        pascal3d.read(tmp_path, "car", "pascal", "val")
    (tmp_path / "Image_sets/car_imagenet_val.txt").write_text("a 1\n")
    with pytest.raises(ViewnetError, match=r"car_imagenet_val\.txt: line 'a 1'"):
        read(tmp_path)


def test_what_is_no_pascal3d_is_refused(tmp_path):
    with pytest.raises(ViewnetError, match=r"car_imagenet_val\.txt: no such list"):
        read(tmp_path)
    listed(tmp_path, "missing")
    with pytest.raises(ViewnetError, match=r"car in imagenet val .1 no such image"):
        read(tmp_path)
    listed(tmp_path)
    with pytest.raises(ViewnetError, match=r"car in imagenet val .the list is empty"):
        read(tmp_path)
    for changes in ({"category": "cow"}, {"subset": "coco"}, {"split": "test"}, {"keep": "hard"}):
        with pytest.raises(ViewnetError, match=f"'{next(iter(changes.values()))}'"):
            pascal3d.read(tmp_path, **{"category": "car", "subset": "imagenet", "split": "val", **changes})
