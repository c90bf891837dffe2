"""Backgrounds: synthetic, from folders, from SUN397's layout; evenly sampled, reproducible, no silent losses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.cad_files import real_data
from PIL import Image

from viewnet import paths
from viewnet.data import backgrounds
from viewnet.data.backgrounds import Backgrounds, load
from viewnet.data.synthetic import scenes
from viewnet.errors import ViewnetError


@pytest.fixture(autouse=True)
def _data(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))


def plain(path: Path, colour: tuple[int, int, int] = (200, 100, 50), size: tuple[int, int] = (40, 30)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, colour).save(path)


def sun397(root: Path, classes: dict[str, int]) -> None:
    """Class number n is a plain grey of 10 n."""
    for number, (name, count) in enumerate(classes.items()):
        for i in range(count):
            plain(root / name.lstrip("/") / f"sun_{i}.png", (10 * number,) * 3)
    (root / "ClassName.txt").write_text("".join(f"{name}\n" for name in classes))


def rejected(made: Backgrounds) -> dict[str, str]:
    """Path -> reason of what could not be used."""
    table = pd.read_csv(paths.data() / "backgrounds" / made.identity / "rejected.csv")
    return dict(zip(table["path"], table["reason"], strict=True))


def test_drawn_ones_differ_and_are_the_same_again():
    made = load("drawn", 24, 40)
    assert made.images.shape == (40, 3, 24, 24) and made.images.dtype == np.uint8
    assert rejected(made) == {} and len(made.identity) == 16
    assert len({image.tobytes() for image in made.images}) == 40
    assert len(np.unique(made.images.mean(axis=(1, 2, 3)).round())) > 20
    again = np.stack([scenes.sample(np.random.default_rng([0, n]), 24, 24) for n in range(40)]).transpose(0, 3, 1, 2)
    assert (again == made.images).all()
    assert (load("drawn", 24, 40, seed=1).images != made.images).mean() > 0.5


@pytest.mark.parametrize("kind", scenes.KINDS, ids=lambda kind: kind.__name__)
def test_every_kind_draws_any_shape_with_something_in_it(kind, monkeypatch):
    monkeypatch.setattr(scenes, "KINDS", (kind,))
    spread = []
    for seed in range(12):
        for width, height in ((64, 64), (50, 20), (7, 31)):
            image = scenes.sample(np.random.default_rng(seed), width, height)
            assert image.shape == (height, width, 3) and image.dtype == np.uint8
            spread.append(float(image.std()))
    assert np.median(spread) > 8


@pytest.mark.parametrize("size", [1, 2, 5])
def test_even_tiny_ones_are_drawn(size):
    assert load("drawn", size, 60).images.shape == (60, 3, size, size)


def test_a_folder_is_read_with_all_folders_in_it(tmp_path):
    root = tmp_path / "pictures"
    plain(root / "a.png", (10, 0, 0))
    plain(root / "deep/er/b.JPG", (0, 90, 0), (300, 200))
    plain(root / ".hidden/c.png")
    (root / "notes.txt").write_text("no image")
    (root / "deep/loop").symlink_to(root)
    made = load(str(root), 8)
    assert sorted(image.mean(axis=(1, 2)).round().tolist() for image in made.images) == [[0, 90, 0], [10, 0, 0]]
    assert rejected(made) == {}


def test_the_square_lies_within_the_image_and_keeps_its_shape(tmp_path):
    # Columns of one colour each: a crop that is not square, or left the image, would have other steps.
    columns = np.broadcast_to(np.arange(120, dtype=np.uint8)[None, :, None] * 2, (60, 120, 3))
    (tmp_path / "p").mkdir()
    for number in range(20):
        Image.fromarray(np.ascontiguousarray(columns)).save(tmp_path / "p" / f"{number}.png")
    made = load(str(tmp_path / "p"), 30)
    ramp = made.images[:, 0, 15].astype(float)
    steps = (ramp[:, -1] - ramp[:, 0]) / 29 / 2  # columns of the image per column of the crop
    assert (steps > 0.7 * 60 / 30 - 0.05).all() and (steps < 60 / 30 + 0.05).all() and steps.std() > 0.05
    assert len(np.unique(ramp[:, 0])) > 10


def test_unreadable_ones_are_told_and_replaced(tmp_path):
    root = tmp_path / "p"
    for number in range(6):
        plain(root / f"{number}.png")
    (root / "broken.png").write_bytes(b"no image")
    whole = (root / "0.png").read_bytes()
    plain(root / "cut.jpg", size=(200, 200))
    (root / "cut.jpg").write_bytes((root / "cut.jpg").read_bytes()[:700])
    (root / "empty.jpg").write_bytes(b"")
    made = load(str(root), 8, count=100)
    assert len(made.images) == 6 and whole
    reasons = {path: reason.split(" (")[0] for path, reason in rejected(made).items()}
    assert reasons == dict.fromkeys(("broken.png", "cut.jpg", "empty.jpg"), "image does not decode")
    assert len(load(str(root), 8, count=6).images) == 6


def test_classes_of_sun397_are_drawn_evenly(tmp_path):
    root = tmp_path / "SUN397"
    sun397(root, {"/a/abbey": 9, "/a/apse": 2, "/b/barn": 7, "/b/barn/indoor": 5})
    made = load(str(root), 4, count=14)
    assert np.bincount(made.images[:, 0, 0, 0] // 10).tolist() == [4, 2, 4, 4]
    everything = load(str(root), 4, count=1000)
    assert np.bincount(everything.images[:, 0, 0, 0] // 10).tolist() == [9, 2, 7, 5]


def test_a_class_without_its_folder_is_told(tmp_path):
    root = tmp_path / "SUN397"
    sun397(root, {"/a/abbey": 2, "/b/barn": 2})
    with (root / "ClassName.txt").open("a") as file:
        file.write("/z/zoo\n")
    assert rejected(load(str(root), 4)) == {"/z/zoo": "no such class folder"}
    (root / "ClassName.txt").write_text("/a/../../etc\n")
    with pytest.raises(ViewnetError, match=r"ClassName\.txt: line '/a/\.\./\.\./etc'"):
        load(str(root), 4)


def test_the_identity_is_of_the_images_not_of_the_place(tmp_path):
    sun397(tmp_path / "one", {"/a/abbey": 3})
    sun397(tmp_path / "two", {"/a/abbey": 3})
    first = load(str(tmp_path / "one"), 4)
    assert load(str(tmp_path / "two"), 4).identity == first.identity
    others = [load(str(tmp_path / "one"), *values).identity for values in ((5,), (4, 2), (4, 2000, 1))]
    plain(tmp_path / "two/a/abbey/sun_3.png")
    others.append(load(str(tmp_path / "two"), 4).identity)
    others.append(load("drawn", 4, 3).identity)
    assert len({first.identity, *others}) == 6


def test_made_once_and_kept(tmp_path, monkeypatch):
    plain(tmp_path / "p/a.png")
    first = load(str(tmp_path / "p"), 4)
    monkeypatch.setattr(backgrounds, "random_square", None)
    assert (load(str(tmp_path / "p"), 4).images == first.images).all()
    (tmp_path / "data/backgrounds" / first.identity / "pictures.npy").write_bytes(b"")
    with pytest.raises(ViewnetError, match=f"{first.identity}/pictures.npy"):
        load(str(tmp_path / "p"), 4)


def test_what_cannot_be_used_is_refused(tmp_path):
    with pytest.raises(ViewnetError, match="nowhere: no such folder"):
        load(str(tmp_path / "nowhere"), 8)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ViewnetError, match=r"empty: no images in it"):
        load(str(tmp_path / "empty"), 8)
    (tmp_path / "empty/a.png").write_bytes(b"no image")
    with pytest.raises(ViewnetError, match=r"a\.png: image does not decode"):
        load(str(tmp_path / "empty"), 8)
    with pytest.raises(ViewnetError, match="size 0: expected 1 to 1024"):
        load("drawn", 0)
    with pytest.raises(ViewnetError, match="count 0: expected 1 or more"):
        load("drawn", 8, 0)


@pytest.mark.parametrize("name", ["backgrounds", "sun397_sample"])
def test_real_photographs(name):
    root = real_data() / name
    if not root.is_dir():
        pytest.skip(f"no {name} among the real data")
    made = load(str(root), 32)
    assert len(made.images) == len(list(root.rglob("*.jpg"))) and rejected(made) == {}
    assert 40 < made.images.mean() < 200 and made.images.std() > 30
