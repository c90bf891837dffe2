"""Photographs cropped into view stores: crops, rejected objects, and that no store is made twice."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cad_files import real_data
from PIL import Image

from viewnet.config import PhotoConfig
from viewnet.data import build, photo_store
from viewnet.data.build import photo_views
from viewnet.data.crop import Crop, cut
from viewnet.data.photo_store import summary
from viewnet.data.readers import pascal3d, photo_folder
from viewnet.data.store import ViewStore
from viewnet.data.synthetic.pascal3d_standin import Pascal3DStandIn
from viewnet.errors import ViewnetError
from viewnet.runtime import image_files

SMALL = PhotoConfig("bus", models=2, count=6, size=32)  # twelve photographs of four models


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


def views(config: PhotoConfig) -> ViewStore:
    return photo_views(config, workers=1, progress=False)


def folder(root: Path, *rows: str, header: str = "file,azimuth_deg,elevation_deg,split") -> Path:
    """A folder with three images, each of another grey, and a list."""
    (root / "images").mkdir(parents=True, exist_ok=True)
    for number in range(3):
        Image.new("RGB", (40, 20), (60 * number + 30,) * 3).save(root / "images" / f"{number}.png")
    (root / "viewpoints.csv").write_text("\n".join((header, *rows)) + "\n")
    return root


# -- crops


@pytest.mark.parametrize(
    ("crop", "wanted"),
    [
        (Crop(4), "exact"),  # a square box of one colour: nothing else is seen
        (Crop(4, margin=0.5), "around"),
    ],
)
def test_a_box_is_cut_with_so_much_around_it(crop, wanted):
    image = Image.new("RGB", (40, 40), (0, 0, 255))
    image.paste((255, 0, 0), (10, 10, 20, 20))
    small = cut(image, (10, 10, 20, 20), crop)
    assert small.shape == (4, 4, 4) and (small[..., 3] == 255).all()
    if wanted == "exact":
        assert (small[..., :3] == (255, 0, 0)).all()
    else:
        # A pixel at the box's edge includes a little of its surroundings.
        red = np.full((4, 4), False)
        red[1:3, 1:3] = True
        assert ((small[..., 0] > 220) == red).all() and ((small[..., 2] > 220) == ~red).all()


def test_beyond_the_edge_it_is_black_and_shape_is_kept():
    small = cut(Image.new("RGB", (40, 10), (200, 200, 200)), None, Crop(8))
    assert (small[[0, 1, 6, 7], :, :3] == 0).all()
    assert (small[3:5, :, :3] > 180).all()
    stretched = cut(Image.new("RGB", (40, 10), (200, 200, 200)), None, Crop(8, square=False))
    assert (stretched[..., :3] == 200).all()


def test_a_square_shows_what_is_around_a_narrow_box():
    image = Image.new("RGB", (60, 60), (0, 200, 0))
    small = cut(image, (10, 25, 50, 35), Crop(8))
    assert (small[..., :3] == (0, 200, 0)).all()


def test_shrinking_averages_and_enlarging_does_not_shift():
    checks = np.indices((256, 256)).sum(axis=0) % 2 * 255
    small = cut(Image.fromarray(checks.astype(np.uint8)), None, Crop(16))
    assert np.abs(small[..., :3].astype(int) - 127).max() <= 2
    steps = np.repeat(np.arange(4, dtype=np.uint8) * 60, 4)[None].repeat(16, axis=0)
    large = cut(Image.fromarray(steps), None, Crop(64))
    middles = large[32, 8::16, 0]
    assert middles.tolist() == pytest.approx([0, 60, 120, 180], abs=2)


def test_boxes_outside_of_the_image_are_refused():
    with pytest.raises(ViewnetError, match=r"no part in the image \(40 x 10\)"):
        cut(Image.new("RGB", (40, 10)), (50, 0, 60, 10), Crop(8))
    for values, message in (
        ({"size": 0}, "size 0: expected 1 to 1024 pixels"),
        ({"margin": -0.1}, "margin -0.1: expected 0 to 2"),
    ):
        with pytest.raises(ViewnetError, match=message):
            Crop(**values)


def test_grey_of_16_bits_keeps_its_brightness():
    ramp = np.linspace(0, 65535, 16).astype(np.uint16)[None].repeat(16, axis=0)
    small = cut(image_files.read(Image.fromarray(ramp)), None, Crop(16))
    assert small[0, :, 0].tolist() == pytest.approx(np.linspace(0, 255, 16).tolist(), abs=1.5)


# -- PASCAL3D+ and its stand-in


def test_the_stand_in_becomes_a_store(monkeypatch, data):
    store = views(SMALL)
    assert store.folder.parent == data / "views" and store.folder.name.startswith("photos-bus-")
    assert store.images.shape == (12, 32, 32, 4)
    assert store.index["split"].value_counts().to_dict() == {"val": 6, "test": 6}
    assert store.index["model_id"].is_unique
    assert summary(store) == "bus: 6 calibrate, 6 scored"
    root = build.written(build.photo_stand_in(SMALL))
    for ours, theirs in (("val", "train"), ("test", "val")):
        wanted = {a.id: a for a in pascal3d.read(root, "bus", "imagenet", theirs)[0]}
        mine = store.index[store.index["split"] == ours]
        assert set(mine["model_id"]) == set(wanted)
        for row in mine.itertuples():
            a = wanted[row.model_id]
            assert (row.azimuth, row.elevation) == pytest.approx((a.azimuth, a.elevation))
            assert (root / row.source) == a.image_path
            with Image.open(a.image_path) as image:
                assert (store.images[row.Index] == cut(image, a.box, Crop(32))).all()
    # Opened again without rendering, reading or cropping anything.
    monkeypatch.setattr(build, "written", None)
    monkeypatch.setattr(photo_store, "photo_store", None)
    assert views(SMALL).folder == store.folder


def test_every_setting_that_decides_pixels_is_in_the_key():
    base = views(SMALL)
    for changes in ({"margin": 0.2}, {"square": False}, {"size": 16}, {"seed": 1}):
        assert views(replace(SMALL, **changes)).identity != base.identity, changes


def test_the_stand_in_before_given_images(tmp_path):
    (tmp_path / "p").mkdir()
    Image.new("RGB", (300, 300), (0, 255, 0)).save(tmp_path / "p/a.png")
    config = replace(SMALL, backgrounds=str(tmp_path / "p"), margin=0.1)
    edges = views(config).images[:, 0, :, :3].astype(float)
    within = edges.max(axis=-1) > 0  # beyond the photograph it is black
    assert (edges[..., 1] > edges[..., 0] + 60)[within].mean() > 0.8
    Image.new("RGB", (300, 300), (0, 0, 255)).save(tmp_path / "p/b.png")
    assert views(config).images[:, 0, :, 2].mean() > edges[..., 2].mean() + 20


def test_pascal3d_by_its_root_with_things_left_out(tmp_path):
    root = tmp_path / "PASCAL3D+_release1.1"
    Pascal3DStandIn("bus", "both", 2, 6).write(root, workers=1, progress=False)
    (root / "Images/bus_imagenet/bus_val_00001.JPEG").write_bytes(
        (root / "Images/bus_imagenet/bus_val_00001.JPEG").read_bytes()[:900]  # the header is complete
    )
    (root / "Annotations/bus_imagenet/bus_train_00002.mat").unlink()
    config = replace(SMALL, root=str(root))
    store = views(config)
    assert summary(store) == ("bus: 5 calibrate, 5 scored; left out: 1 image does not decode, 1 no such annotation")
    assert set(store.rejected["path"]) == {
        "Annotations/bus_imagenet/bus_train_00002.mat",
        "Images/bus_imagenet/bus_val_00001.JPEG",
    }
    both = views(replace(config, subset="both"))
    assert len(both) == 22 and both.index["model_id"].is_unique
    easy = views(replace(config, subset="pascal", keep="easy"))
    assert len(easy) + len(easy.rejected) == 12 and "truncated, occluded or difficult" in summary(easy)
    # A changed annotation is another store; a root elsewhere is not.
    (tmp_path / "elsewhere").mkdir()
    moved = root.rename(tmp_path / "elsewhere/root")
    assert views(replace(config, root=str(moved))).folder == store.folder
    annotation = moved / "Annotations/bus_imagenet/bus_val_00003.mat"
    annotation.write_bytes((moved / "Annotations/bus_imagenet/bus_val_00004.mat").read_bytes())
    assert views(replace(config, root=str(moved))).folder != store.folder


def test_one_photograph_in_both_splits_is_refused(tmp_path):
    root = tmp_path / "root"
    Pascal3DStandIn("bus", models=1, count=3).write(root, workers=1, progress=False)
    with (root / "Image_sets/bus_imagenet_val.txt").open("a") as file:
        file.write("bus_train_00001\n")
    with pytest.raises(ViewnetError, match=r"bus_train_00001\.JPEG: is both"):
        views(replace(SMALL, root=str(root)))


def test_the_same_image_under_two_names_is_not_calibrated_on(tmp_path):
    root = folder(tmp_path / "f", "0.png,1,2,val", "1.png,3,4,val", "2.png,5,6,test")
    with Image.open(root / "images/2.png") as image:
        image.save(root / "images/1.png", compress_level=0)  # other bytes of the same pixels
    store = views(PhotoConfig("car", str(root), size=8))
    assert store.index["model_id"].tolist() == ["0.png", "2.png"]
    assert summary(store).endswith("left out: 1 image to calibrate on that is scored on under another name")


# -- a folder with a list


def test_a_folder_with_a_list_becomes_a_store(tmp_path):
    root = folder(
        tmp_path / "f",
        "0.png,10,5,val,first",
        "1.png,-90,-5,test,second",
        "2.png,370,0,test,third",
        header="file,azimuth_deg,elevation_deg,split,remark",
    )
    store = views(PhotoConfig("car", str(root), size=8))
    assert store.index[["model_id", "split", "azimuth", "elevation", "source"]].to_numpy().tolist() == [
        ["0.png", "val", 10, 5, "images/0.png"],
        ["1.png", "test", 270, -5, "images/1.png"],
        ["2.png", "test", 10, 0, "images/2.png"],
    ]
    assert (store.images[:, 4, 4, 0] == [30, 90, 150]).all()
    assert (store.images[:, 0, :, :3] == 0).all()
    assert summary(store) == "car: 1 calibrate, 2 scored"
    # A longer list is another store.
    (root / "viewpoints.csv").write_text((root / "viewpoints.csv").read_text() + "0.png,20,5,val,again\n")
    again = views(PhotoConfig("car", str(root), size=8))
    assert again.index["model_id"].tolist() == ["0.png", "0.png/1", "1.png", "2.png"]


def test_boxes_of_a_list_are_cut(tmp_path):
    header = "file,azimuth_deg,elevation_deg,split,x0,y0,x1,y1"
    rows = ("0.png,0,0,val,5,5,15,15", "1.png,0,0,test,,,,", "2.png,0,0,test,90,0,99,9")
    root = folder(tmp_path / "f", *rows, header=header)
    Image.fromarray(np.arange(40, dtype=np.uint8)[None].repeat(20, axis=0) * 6).save(root / "images/0.png")
    store = views(PhotoConfig("car", str(root), size=10))
    assert store.images[0, 5, :, 0].tolist() == [6 * x for x in range(5, 15)]
    assert summary(store) == "car: 1 calibrate, 1 scored; left out: 1 box has no part in the image"


def test_images_of_a_folder_are_turned_as_their_camera_says(tmp_path):
    root = folder(tmp_path / "f", "0.jpg,0,0,val", "1.png,0,0,test")
    sideways = Image.new("RGB", (40, 20), (0, 0, 0))
    sideways.paste((255, 255, 255), (0, 0, 20, 20))
    exif = Image.Exif()
    exif[0x0112] = 6  # its left side is up
    sideways.save(root / "images/0.jpg", exif=exif, quality=95)
    turned = views(PhotoConfig("car", str(root), size=8, square=False)).images[0, ..., 0]
    assert (turned[:3] > 200).all() and (turned[5:] < 55).all()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0.png,abc,0,val", "line 3: azimuth_deg 'abc'"),
        ("0.png,0,,val", "line 3: elevation_deg ''"),
        ("0.png,0,91,val", "line 3: elevation_deg 91"),
        ("0.png,0,0,train", r"line 3: split 'train'"),
        ("../0.png,0,0,val", r"line 3: file '\.\./0\.png'"),
        (",0,0,val", "line 3: file ''"),
    ],
)
def test_a_wrong_row_is_named(tmp_path, row, message):
    with pytest.raises(ViewnetError, match=message):
        photo_folder.read(folder(tmp_path / "f", "1.png,0,0,test", row), "car")


def test_a_wrong_list_is_named(tmp_path):
    with pytest.raises(ViewnetError, match="column 'split' is missing"):
        photo_folder.read(folder(tmp_path / "f", "1.png,0,0", header="file,azimuth_deg,elevation_deg"), "car")
    header = "file,azimuth_deg,elevation_deg,split,x0,y0,x1"
    with pytest.raises(ViewnetError, match="only x0, y0, x1 of a box"):
        photo_folder.read(folder(tmp_path / "f", "1.png,0,0,val,1,1,2", header=header), "car")
    with pytest.raises(ViewnetError, match="line 2: y1 '': expected a number"):
        photo_folder.read(folder(tmp_path / "f", "1.png,0,0,val,1,1,2,", header=f"{header},y1"), "car")
    with pytest.raises(ViewnetError, match="lists no photograph"):
        photo_folder.read(folder(tmp_path / "f"), "car")
    with pytest.raises(ViewnetError, match="no usable photograph in the test split"):
        views(PhotoConfig("car", str(folder(tmp_path / "f", "1.png,0,0,val"))))
    with pytest.raises(ViewnetError, match=r"the val split .*images/9\.png"):
        views(PhotoConfig("car", str(folder(tmp_path / "f", "1.png,0,0,test", "9.png,0,0,val"))))
    with pytest.raises(ViewnetError, match="use keep='all'"):
        views(PhotoConfig("car", str(tmp_path / "f"), keep="easy"))


HEADER = "file,azimuth_deg,elevation_deg,split"


@pytest.mark.parametrize(
    ("name", "files", "header", "kinds", "said"),
    [
        ("f", ["1.png", "2.png"], HEADER, ["", ""], None),
        ("train", ["train/1.png", "2.png"], HEADER, ["", ""], None),
        ("cars", ["1.png", "2.png"], HEADER, ["", ""], None),
        ("Chairs", ["1.png", "2.png"], HEADER, ["", ""], "2 of 2 .*2 chair"),
        ("Chairs", ["car_1.png", "2.png"], HEADER, ["", ""], "1 of 2 .*1 chair"),
        ("f", ["dining_tables/1.png", "n02924116_2.png"], HEADER, ["", ""], "2 of 2 .*1 diningtable, 1 bus"),
        ("chairs", ["1.png", "2.png"], f"{HEADER},category", [",car", ",Automobile"], "1 of 2 .*1 automobile"),
        ("cars", ["1.png", "2.png"], f"{HEADER},class", [",03001627", ",airplane"], "2 of 2 .*1 chair, 1 aeroplane"),
        ("cars", ["1.png", "2.png"], f"{HEADER},category", [",car", ",train"], "1 of 2 .*1 train"),
    ],
)
def test_photographs_that_are_named_as_another_category_are_told_and_used(
    name, files, header, kinds, said, tmp_path, caplog
):
    rows = [f"{files[0]},0,0,val{kinds[0]}", f"{files[1]},10,0,test{kinds[1]}"]
    root = folder(tmp_path / name, *rows, header=header)
    for number, file in enumerate(files):
        (root / "images" / file).parent.mkdir(exist_ok=True)
        Image.new("RGB", (30, 20), (number * 99,) * 3).save(root / "images" / file)
    assert len(views(PhotoConfig("car", str(root), size=8))) == 2
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == (said is not None)
    assert said is None or re.search(f"^{root}: {said}", told[0])


def test_a_root_that_is_neither_is_refused_with_one_message(tmp_path):
    with pytest.raises(ViewnetError, match=r"no photographs that can be read"):
        views(PhotoConfig("car", str(tmp_path)))
    with pytest.raises(ViewnetError, match="nowhere: no photographs"):
        views(PhotoConfig("car", str(tmp_path / "nowhere")))
    with pytest.raises(ViewnetError, match="unknown category 'cow'"):
        views(PhotoConfig("cow"))


def test_real_cars():
    root = real_data() / "real_cars"
    if not root.is_dir():
        pytest.skip("no real_cars among the real data")
    store = views(PhotoConfig("car", str(root)))
    assert summary(store) == "car: 300 calibrate, 700 scored"
    assert store.images.shape == (1000, 64, 64, 4)
    # Cars are wider than high: above and below the object it is black.
    assert (store.images[:, 0, :, :3].max(axis=(1, 2)) == 0).mean() > 0.9
    assert store.images[:, 24:40, :, :3].mean() > 60
