"""A store is what it was made from: what was read decides it, and neither times nor the names of folders do."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.cad_files import write_box
from helpers.irregular_files import IRREGULAR
from PIL import Image

from viewnet import paths
from viewnet.config import SYNSETS, DataConfig, PhotoConfig, VideoConfig
from viewnet.data import backgrounds, catalogue, contents
from viewnet.data.build import photo_views, video_views, view_store
from viewnet.data.store import tally
from viewnet.recipes import make_config
from viewnet.runs.run_store import locate

CAR = SYNSETS["car"]
MODEL = f"{CAR}/m0/models"


def write_image(file: Path, shade: int) -> None:
    """An image whose file has the same size for any shade."""
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (8, 8), (shade, shade, shade)).save(file.with_suffix(".bmp"))
    file.with_suffix(".bmp").rename(file)


def collection(root: Path) -> None:
    """Three models in lists; the first has a texture, names a second one that is missing, and a library."""
    for number in range(3):
        file = write_box(root / "data", CAR, f"m{number}")
    file = root / "data" / MODEL / "model_normalized.mtl"
    file.write_text(f"{file.read_text()}map_Kd t.png\nnewmtl unused\nmap_Kd later.png\n")
    write_image(file.with_name("t.png"), 10)
    (root / "lists").mkdir()
    for name, split in (("m0", "train"), ("m1", "val"), ("m2", "test")):
        (root / "lists" / f"{CAR}_{split}.txt").write_text(f"{name}\n")


def photographs(root: Path) -> None:
    for name in ("a", "b"):
        write_image(root / f"data/images/{name}.png", 10)
    rows = ["file,azimuth_deg,elevation_deg,split", "a.png,10,0,val", "b.png,20,0,test"]
    (root / "data/viewpoints.csv").write_text("\n".join(rows) + "\n")
    write_image(root / "data/images/b.png", 11)


def clips(root: Path) -> None:
    for name in ("a", "b"):
        for number in range(2):
            write_image(root / f"data/{name}/{number}.png", 40 + number)
            Image.new("L", (8, 8), 255).save(root / f"data/{name}/mask.bmp")
            (root / f"data/masks/{name}").mkdir(parents=True, exist_ok=True)
            (root / f"data/{name}/mask.bmp").rename(root / f"data/masks/{name}/{number}.png")
    (root / "data/splits.csv").write_text("clip,split\na,train\nb,train\n")


def pictures(root: Path) -> None:
    for number in range(2):
        write_image(root / f"data/{number}.png", 40 + number)


def of_models(root: Path) -> str:
    config = DataConfig("car", root=str(root / "data"), splits=str(root / "lists"), views=1, image_size=8, models=0)
    return view_store(config, 1, progress=False).identity


def of_photographs(root: Path) -> str:
    return photo_views(PhotoConfig("car", str(root / "data"), size=8), 1, progress=False).identity


def of_clips(root: Path) -> str:
    config = VideoConfig("car", str(root / "data"), size=8, side=1.0, kind="folder", masks="files", count=0)
    return video_views(config, 1, progress=False).identity


def of_pictures(root: Path) -> str:
    return backgrounds.load(str(root / "data"), 8, 2, progress=False).identity


KINDS: dict[str, tuple[Callable[[Path], None], Callable[[Path], str]]] = {
    "models": (collection, of_models),
    "photographs": (photographs, of_photographs),
    "clips": (clips, of_clips),
    "pictures": (pictures, of_pictures),
}


def last_byte(file: Path) -> None:
    """Change a file's last byte, and neither its size nor the time of its content."""
    before = file.stat()
    content = file.read_bytes()
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))


def comment(file: Path) -> None:
    file.write_text(file.read_text() + "# more\n")


def swapped(old: str, new: str) -> Callable[[Path], None]:
    return lambda file: file.write_text(file.read_text().replace(old, new, 1))


CHANGES: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "a model": ("models", f"data/{MODEL}/model_normalized.obj", comment),
    "a library of the same size": ("models", f"data/{MODEL}/model_normalized.mtl", swapped("Kd 1.0", "Kd 0.5")),
    "a texture of the same size and time": ("models", f"data/{MODEL}/t.png", last_byte),
    "a texture that arrives": ("models", f"data/{MODEL}/later.png", lambda file: write_image(file, 9)),
    "a model that goes": ("models", f"data/{MODEL}/model_normalized.obj", Path.unlink),
    "the lists": ("models", f"lists/{CAR}_val.txt", lambda file: file.rename(file.with_name(f"{CAR}_test.txt"))),
    "a photograph": ("photographs", "data/images/a.png", last_byte),
    "the list of photographs": ("photographs", "data/viewpoints.csv", swapped("a.png,10", "a.png,11")),
    "a frame": ("clips", "data/a/1.png", last_byte),
    "a mask": ("clips", "data/masks/b/0.png", last_byte),
    "the list of clips": ("clips", "data/splits.csv", swapped("b,train", "b,val")),
    "a background": ("pictures", "data/1.png", last_byte),
}


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "kept"))


@pytest.mark.parametrize("change", [name for name in CHANGES if name != "the lists"])
def test_a_change_makes_another_store(tmp_path: Path, change: str) -> None:
    kind, file, apply = CHANGES[change]
    write, identity = KINDS[kind]
    write(tmp_path)
    before = identity(tmp_path)
    apply(tmp_path / file)
    after = identity(tmp_path)
    assert after != before
    config = make_config("viewnet", "car", "smoke")
    assert locate(config, after) != locate(config, before)


@pytest.mark.parametrize("kind", KINDS)
def test_touched_and_moved_files_are_the_same_store(tmp_path: Path, kind: str) -> None:
    write, identity = KINDS[kind]
    root = tmp_path / "here"
    root.mkdir()
    write(root)
    before = identity(root)
    for file in root.rglob("*"):
        os.utime(file, (1, 1))
    assert identity(root) == before
    root.rename(tmp_path / "there")
    assert identity(tmp_path / "there") == before
    assert len(list((paths.data() / ("backgrounds" if kind == "pictures" else "views")).glob("[!.]*"))) == 1


def test_lists_that_give_models_another_split(tmp_path: Path) -> None:
    collection(tmp_path)
    before = of_models(tmp_path)
    for old, new in (("train", "x"), ("val", "train"), ("x", "val")):
        (tmp_path / "lists" / f"{CAR}_{old}.txt").rename(tmp_path / "lists" / f"{CAR}_{new}.txt")
    assert of_models(tmp_path) != before


def test_what_is_not_read_of_photographs_does_not_matter(tmp_path: Path) -> None:
    photographs(tmp_path)
    before = of_photographs(tmp_path)
    write_image(tmp_path / "data/images/unlisted.png", 12)
    file = tmp_path / "data/viewpoints.csv"
    file.write_text(file.read_text().replace("split\n", "split,remark\n").replace("val\n", "val,mine\n"))
    assert of_photographs(tmp_path) == before


def test_what_is_not_read_does_not_matter(tmp_path: Path) -> None:
    collection(tmp_path)
    before = of_models(tmp_path)
    (tmp_path / "data" / MODEL / "model.binvox").write_text("other")
    (tmp_path / "data" / MODEL / "other.mtl").write_text("newmtl other\n")
    assert of_models(tmp_path) == before


def test_unchanged_files_are_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contents, "SETTLED", 0)
    collection(tmp_path)
    before = of_models(tmp_path)
    read: list[str] = []
    real = hashlib.file_digest
    monkeypatch.setattr(
        hashlib, "file_digest", lambda file, kind: read.append(Path(file.name).name) or real(file, kind)
    )
    assert of_models(tmp_path) == before and read == []
    os.utime(tmp_path / "data" / MODEL / "t.png", (1, 1))
    assert of_models(tmp_path) == before
    assert sorted(read) == ["model_normalized.mtl", "model_normalized.obj", "t.png"]


def test_files_that_have_just_changed_are_read_again(tmp_path: Path) -> None:
    """Two changes in a row may leave the same times."""
    (tmp_path / "a").write_text("1")
    contents.of_files(tmp_path, [tmp_path / "a"])
    assert not (paths.data() / "contents").exists()


@pytest.mark.parametrize("damage", ["", "[]", "{", '{"%s": 1}', '{"%s": [[["%s"]], "x"]}', '{"%s": [[], 5]}'])
def test_a_damaged_table_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str) -> None:
    monkeypatch.setattr(contents, "SETTLED", 0)
    (tmp_path / "a").write_text("1")
    files = [tmp_path / "a", tmp_path / "none"]
    before = contents.of_files(tmp_path, files)
    (table,) = (paths.data() / "contents").iterdir()
    whole = table.read_bytes()
    table.write_text(damage.replace("%s", str(tmp_path / "a")))
    assert contents.of_files(tmp_path, files) == before
    assert table.read_bytes() == whole


# What a check of a folder opens


def test_a_check_says_what_rendering_would(tmp_path: Path) -> None:
    collection(tmp_path)
    (tmp_path / "data" / MODEL / "model_normalized.mtl").unlink()
    found = catalogue.check(tmp_path / "data")
    assert found.problems == ["car: 1 left out: missing material library 'model_normalized.mtl': m0"]
    assert sum(found.counts["car"].values()) == 2 and found.notes == []


def cut_off(file: Path) -> None:
    """Leave a file's header, and little more."""
    file.write_bytes(file.read_bytes()[:60])


def other_size(file: Path) -> None:
    write_image(file, 255)
    with Image.open(file) as image:
        larger = image.resize((9, 9))
    larger.save(file, "PNG")


DAMAGES: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "a photograph": ("photographs", "images/c.png", cut_off),
    "a missing photograph": ("photographs", "images/c.png", Path.unlink),
    "a photograph under two names": ("photographs", "images/c.png", lambda file: write_image(file, 11)),
    "a box": ("photographs", "viewpoints.csv", swapped("1,1,7,7", "9,9,12,12")),
    "a frame": ("cars", "car001/0.png", cut_off),
    "a mask": ("cars", "masks/car001/1.png", cut_off),
    "a mask of another size": ("cars", "masks/car001/1.png", other_size),
    "a missing mask": ("cars", "masks/car002/1.png", Path.unlink),
    "all masks but one": (
        "cars",
        "masks/car002",
        lambda folder: [file.unlink() for file in sorted(folder.iterdir())[1:]],
    ),
    "an empty mask": ("cars", "masks/car001/1.png", lambda file: Image.new("L", (40, 30)).save(file)),
    "a small box": ("cars", "annotations/1_annot.txt", swapped("2 2 30 25 10", "2 2 12 12 10")),
    "a box outside": ("cars", "annotations/1_annot.txt", swapped("2 2 30 25 10", "50 2 60 20 10")),
}


def listed_photographs(root: Path) -> None:
    for number, name in enumerate("abc"):
        write_image(root / f"images/{name}.png", 10 + number)
    rows = ["file,azimuth_deg,elevation_deg,split,x0,y0,x1,y1", "a.png,1,0,val,,,,", "b.png,2,0,test,,,,"]
    (root / "viewpoints.csv").write_text("\n".join([*rows, "c.png,3,0,val,1,1,7,7"]) + "\n")


def cars(root: Path) -> None:
    for name in ("annotations", "car001", "car002", "masks/car001", "masks/car002"):
        (root / name).mkdir(parents=True)
    for number in (1, 2):
        for frame in range(4):
            Image.new("RGB", (40, 30), (40 * frame, 90, 9)).save(root / f"car00{number}/{frame}.png")
            Image.new("L", (40, 30), 255).save(root / f"masks/car00{number}/{frame}.png")
        lines = [f"car00{number}/{frame}.png 2 2 30 25 {10 * frame}\n" for frame in range(4)]
        (root / f"annotations/{number}_annot.txt").write_text("".join(lines))


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_deep_check_says_of_images_and_masks_what_views_say(tmp_path: Path, damage: str) -> None:
    kind, file, apply = DAMAGES[damage]
    root = tmp_path / "data"
    {"photographs": listed_photographs, "cars": cars}[kind](root)
    apply(root / file)
    found = catalogue.check(root, deep=True)
    if kind == "cars":
        store = video_views(VideoConfig("car", str(root), size=8, split_rule="all"), 1, progress=False)
        views = found.counts["car"].get("frames", 0)
    else:
        store = photo_views(PhotoConfig("car", str(root), size=8), 1, progress=False)
        views = sum(found.counts[""].values())
    reasons = [problem.split("left out: ")[1].split(": ")[0] for problem in found.problems]
    assert sorted(reasons) == sorted(tally(store.rejected["reason"]))
    assert views == len(store) and found.problems and found.notes == []


def test_of_many_images_and_clips_some_are_opened(tmp_path: Path) -> None:
    (tmp_path / "p").mkdir()
    rows = ["file,azimuth_deg,elevation_deg,split"]
    for number in range(45):
        write_image(tmp_path / f"p/images/{number:02d}.png", number)
        rows.append(f"{number:02d}.png,1,0,{'val' if number % 2 else 'test'}")
    (tmp_path / "p/viewpoints.csv").write_text("\n".join(rows) + "\n")
    for number in (3, 4):
        cut_off(tmp_path / f"p/images/{number:02d}.png")
    some, every = (catalogue.check(tmp_path / "p", deep) for deep in (False, True))
    assert some.notes == ["15 of 45 objects opened: --deep opens all"] and every.notes == []
    assert some.problems == ["1 left out: image does not decode: 03.png"]
    assert every.problems == ["2 left out: image does not decode: 03.png and 1 more"]
    some, every = (catalogue.check(tmp_path / "p/images", deep) for deep in (False, True))
    assert some.notes == ["15 of 45 images opened: --deep opens all"] and some.counts[""]["images"] == 44
    assert every.problems == ["2 left out: image does not decode: 03.png and 1 more"]
    assert every.counts[""]["images"] == 43


def test_a_clip_is_opened_until_it_can_be_used(tmp_path: Path) -> None:
    cars(tmp_path)
    for file in ("car001/0.png", "car001/3.png", "car002/0.png", "car002/1.png", "car002/2.png"):
        cut_off(tmp_path / file)
    found = catalogue.check(tmp_path)
    assert found.counts["car"] == {"sequences": 1, "frames": 3, "sequences with masks": 1}
    assert found.notes == ["car: 2 of 2 sequences opened, each up to its second usable frame: --deep opens all"]
    assert sorted(found.problems) == [
        "car: 1 left out: fewer than two usable frames: car002",
        "car: 4 left out: frame does not decode: car001/0 and 3 more",
    ]


@pytest.mark.parametrize("make", IRREGULAR.values(), ids=IRREGULAR.keys())
def test_a_model_that_is_no_regular_file_is_left_out_alike(tmp_path: Path, make: Callable[[Path], None]) -> None:
    for name in ("m0", "m1", "odd"):
        write_box(tmp_path / "data", CAR, name, "v1")
    (odd := tmp_path / "data" / CAR / "odd/model.obj").unlink()
    make(odd)
    found = catalogue.check(tmp_path / "data")
    assert found.problems == ["car: 1 left out: not a regular file: odd"]
    config = DataConfig("car", root=str(tmp_path / "data"), views=1, image_size=8, models=0)
    store = view_store(config, 1, progress=False)
    assert set(store.index["model_id"]) == {"m0", "m1"}
    assert store.rejected.values.tolist() == [["odd", f"{CAR}/odd/model.obj", "not a regular file"]]


def test_a_deep_check_opens_every_model(tmp_path: Path) -> None:
    for number in range(50):
        write_box(tmp_path, CAR, f"m{number:02d}")
    (tmp_path / CAR / "m49/models/model_normalized.obj").write_text("v 0 0 0\n")
    some, every = catalogue.check(tmp_path), catalogue.check(tmp_path, deep=True)
    assert some.notes == ["car: 17 of 50 models opened: --deep opens all"] and some.problems == []
    assert every.notes == [] and every.problems == ["car: 1 left out: no faces: m49"]
    assert sum(every.counts["car"].values()) == 49
