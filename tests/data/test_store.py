"""View stores: errors, and rendering that is the same however it was interrupted, ordered or parallelised."""

from __future__ import annotations

import errno
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers.cad_files import obj_file, write_box

from viewnet.config import SYNSETS, DataConfig
from viewnet.data import build, rendered_store
from viewnet.data.build import view_store
from viewnet.data.readers.shapenet import ModelFile, find_models
from viewnet.data.rendered_store import Rendering, render_views, sample_viewpoints
from viewnet.data.store import ViewStore, check_index, identity_of, write_store
from viewnet.errors import ViewnetError

CAR = SYNSETS["car"]
FILES = ("views.npy", "index.parquet", "meta.json", "rejected.csv")


def make_index(models: int = 3, count: int = 2) -> pd.DataFrame:
    rows = models * count
    return pd.DataFrame(
        {
            "model_id": np.repeat([f"m{i}" for i in range(models)], count),
            "category": "car",
            "split": np.repeat(["train", "val", "test"][:models], count),
            "view": np.tile(np.arange(count), models),
            "azimuth": np.linspace(0, 300, rows),
            "elevation": np.linspace(-20, 40, rows),
            "source": "x.obj",
        }
    )


@pytest.fixture
def images() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (6, 8, 8, 4), dtype=np.uint8)


@pytest.fixture
def store(tmp_path: Path, images: np.ndarray) -> ViewStore:
    return write_store(tmp_path / "s", [images[:4], images[4:]], make_index(), {"seed": 1}, [("m9", "p", "why, so")])


@pytest.fixture
def models(tmp_path: Path) -> list[ModelFile]:
    for number in range(7):
        write_box(tmp_path / "cad", CAR, f"model{number}")
    return find_models(tmp_path / "cad", "car")


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendered_store, "CHUNK", 2)


def draw(models: list[ModelFile], folder: Path, **changes) -> ViewStore:
    return render_views(models, folder, **{"views": 2, "image_size": 16, "workers": 1, "progress": False, **changes})


def content(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


# The store itself


def test_what_is_written_is_read(store: ViewStore, images: np.ndarray) -> None:
    assert np.array_equal(store.images, images) and len(store) == 6
    assert isinstance(store.images, np.memmap) and not store.images.flags.writeable
    pd.testing.assert_frame_equal(store.index, make_index(), check_dtype=False)
    assert store.rejected.to_dict("records") == [{"model_id": "m9", "path": "p", "reason": "why, so"}]
    assert store.split("val").tolist() == [2, 3]
    assert store.identity == identity_of({"seed": 1}) != identity_of({"seed": 2})
    assert [p.name for p in store.folder.parent.iterdir()] == ["s"]


def test_a_split_without_views(store: ViewStore) -> None:
    with pytest.raises(ViewnetError, match=r"split 'full' .only test, train, val"):
        store.split("full")


def damage_array(change):
    return lambda folder: np.save(folder / "views.npy", change(np.load(folder / "views.npy")))


def damage_index(change):
    return lambda folder: change(pd.read_parquet(folder / "index.parquet")).to_parquet(folder / "index.parquet")


def damage_meta(**change):
    def apply(folder: Path) -> None:
        meta = json.loads((folder / "meta.json").read_text())
        (folder / "meta.json").write_text(json.dumps({**meta, **change}))

    return apply


def truncate(name: str):
    return lambda folder: os.truncate(folder / name, (folder / name).stat().st_size // 2)


DAMAGE = {
    **{f"no {name}": (lambda folder, name=name: (folder / name).unlink(), f"{name}: missing") for name in FILES},
    "cut array": (truncate("views.npy"), "not a whole array"),
    "cut index": (truncate("index.parquet"), "cannot be read"),
    "cut meta": (truncate("meta.json"), "meta.json: not JSON"),
    "no array": (lambda folder: (folder / "views.npy").write_bytes(b"text"), "not a whole array"),
    "floats": (damage_array(lambda x: x.astype(np.float32)), r"float32 \(6, 8, 8, 4\): expected uint8"),
    "three channels": (damage_array(lambda x: x[..., :3]), r"expected uint8 \(N, H, W, 4\)"),
    "fewer views": (damage_array(lambda x: x[:5]), "6 rows for 5 views"),
    "fewer rows": (damage_index(lambda x: x[:5]), "5 rows for 6 views"),
    "no column": (damage_index(lambda x: x.drop(columns="azimuth")), "no column azimuth"),
    "more columns": (damage_index(lambda x: x.assign(roll=0.0)), "unknown column roll"),
    "azimuth": (
        damage_index(lambda x: x.assign(azimuth=360.0)),
        r"azimuth .*360.* in row 0: expected degrees in \[0, 360",
    ),
    "nan": (damage_index(lambda x: x.assign(elevation=[0, 0, np.nan, 0, 0, 0])), "elevation .*nan.* in row 2"),
    "text angle": (damage_index(lambda x: x.assign(elevation="up")), "elevation 'up'"),
    "numeric id": (
        damage_index(lambda x: x.assign(model_id=[1, 1, 2, 2, 3, 3])),
        "model_id .*1.* in row 0: expected text",
    ),
    "fractional view": (damage_index(lambda x: x.assign(view=x["view"] + 0.5)), "expected whole numbers"),
    "shuffled": (damage_index(lambda x: x.iloc[[0, 2, 1, 3, 4, 5]]), "are not in consecutive rows"),
    "reversed views": (damage_index(lambda x: x.iloc[::-1]), "are not in consecutive rows in order"),
    "format": (damage_meta(format=99), "format 99"),
    "identity": (damage_meta(identity="0" * 16), "identity does not match"),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGE.values(), ids=DAMAGE.keys())
def test_damage_is_named(store: ViewStore, damage, message: str) -> None:
    folder = store.folder
    del store
    damage(folder)
    with pytest.raises(ViewnetError, match=message) as error:
        ViewStore.open(folder)
    assert str(folder) in str(error.value) and "\n" not in str(error.value)


def test_a_store_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ViewnetError, match="no such view store"):
        ViewStore.open(tmp_path / "none")


def test_writing_refuses_what_does_not_fit_and_leaves_nothing(tmp_path: Path, images: np.ndarray) -> None:
    for batches in ([images[:5]], [images, images], []):
        with pytest.raises(ViewnetError, match="rows of the index"):
            write_store(tmp_path / "s", batches, make_index(), {})
    with pytest.raises(ViewnetError, match="no column source"):
        write_store(tmp_path / "s", [images], make_index().drop(columns="source"), {})
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "s").mkdir()
    with pytest.raises(ViewnetError, match="exists already"):
        write_store(tmp_path / "s", [images], make_index(), {})


def test_an_index_may_hold_unequal_numbers_of_views() -> None:
    index = make_index().iloc[[0, 1, 2, 4, 5]].reset_index(drop=True)
    check_index(index, 5, Path("index.parquet"))


# Rendering into a store


def test_rendered_store(models: list[ModelFile], tmp_path: Path) -> None:
    store = draw(models, tmp_path / "views")
    assert store.images.shape == (14, 16, 16, 4)
    assert store.index["model_id"].tolist() == [m.id for m in models for _ in range(2)]
    assert store.index["view"].tolist() == [0, 1] * 7
    assert store.index["source"][0] == f"{CAR}/model0/models/model_normalized.obj"
    assert dict(zip(store.index["model_id"], store.index["split"], strict=True)) == {m.id: m.split for m in models}
    assert store.index["azimuth"].between(0, 360).all() and store.index["elevation"].between(-20, 40).all()
    assert (store.images[..., 3].reshape(14, -1) == 255).any(axis=1).all()
    assert store.meta["made_by"]["renderer"]["name"] == "raycast"
    assert not [p for p in tmp_path.iterdir() if p.name.endswith(".partial")]


def test_views_do_not_depend_on_order_company_or_chunks(
    models: list[ModelFile], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = draw(models, tmp_path / "whole")
    few = draw([models[5], models[2]], tmp_path / "few")
    monkeypatch.setattr(rendered_store, "CHUNK", 3)
    draw(models[::-1], tmp_path / "turned")
    assert content(tmp_path / "turned") == content(tmp_path / "whole")
    rows = whole.index["model_id"].isin(["model2", "model5"]).to_numpy()
    assert np.array_equal(whole.images[rows], few.images)
    assert whole.index[rows]["azimuth"].tolist() == few.index["azimuth"].tolist()


def test_seeds_and_settings_change_images_and_identity(models: list[ModelFile], tmp_path: Path) -> None:
    changes = [{}, {"seed": 1}, {"elevation_range": (0, 40)}, {"supersample": 1}, {"image_size": 8}, {"views": 3}]
    stores = [draw(models, tmp_path / str(i), **change) for i, change in enumerate(changes)]
    assert len({store.identity for store in stores}) == len(changes)
    assert len({store.images.tobytes() for store in stores}) == len(changes)
    # More views leave the first ones as they were.
    assert np.array_equal(stores[5].images.reshape(7, 3, 16, 16, 4)[:, :2].reshape(14, 16, 16, 4), stores[0].images)


def test_viewpoints_are_uniform_in_their_ranges() -> None:
    models = [ModelFile(f"m{i}", "car", Path("x"), "v2", "train") for i in range(4000)]
    azimuth, elevation, light = sample_viewpoints(models, Rendering(views=1))
    assert azimuth.shape == (4000, 1) and light.shape == (4000, 1, 3)
    for values, low, high in ((azimuth, 0, 360), (elevation, -20, 40), (light[..., 2], 0, 1)):
        counts = np.histogram(values, 10, (low, high))[0]
        assert counts.sum() == 4000 and np.abs(counts - 400).max() < 100
    assert np.allclose(np.linalg.norm(light, axis=-1), 1)
    assert abs(np.corrcoef(azimuth[:, 0], elevation[:, 0])[0, 1]) < 0.06
    azimuth, _, _ = sample_viewpoints(
        models, Rendering(views=1, azimuth_range=(-30.0, 30.0), elevation_range=(0.0, 0.0))
    )
    assert ((azimuth <= 30) | (azimuth >= 330)).all() and (azimuth < 360).all()


def test_a_store_that_is_there_is_reused_or_refused(models: list[ModelFile], tmp_path: Path) -> None:
    first = draw(models, tmp_path / "views")
    before = (tmp_path / "views" / "views.npy").stat().st_mtime_ns
    assert draw(models, tmp_path / "views").identity == first.identity
    assert (tmp_path / "views" / "views.npy").stat().st_mtime_ns == before
    with pytest.raises(ViewnetError, match="holds views of other models or settings"):
        draw(models, tmp_path / "views", seed=5)


def test_unusable_models_are_listed_and_the_rest_go_through(
    models: list[ModelFile], tmp_path: Path, small_chunks: None, caplog: pytest.LogCaptureFixture
) -> None:
    models[0].path.write_text("")
    models[3].path.write_text("v 0 0 0\n")
    models[6].path.unlink()
    with caplog.at_level(logging.WARNING):
        store = draw(models, tmp_path / "views")
    assert "3 of 7 models cannot be used" in caplog.text
    assert store.index["model_id"].unique().tolist() == ["model1", "model2", "model4", "model5"]
    assert store.rejected["reason"].tolist() == ["empty file", "no faces", "no such file"]
    assert store.rejected["path"][1] == f"{CAR}/model3/models/model_normalized.obj"
    for model in models:
        if model.path.exists():
            model.path.write_text("")
    with pytest.raises(ViewnetError, match=r"7 models can.* model0: empty file"):
        draw(models, tmp_path / "none")


def test_a_killed_call_goes_on_from_what_is_done(
    models: list[ModelFile], tmp_path: Path, small_chunks: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(models, tmp_path / "undisturbed")
    drawn: list[str] = []
    real = rendered_store.render_chunk

    def dies(chunk):
        if len(drawn) == 2:
            raise KeyboardInterrupt
        drawn.append(chunk.models[0].id)
        return real(chunk)

    monkeypatch.setattr(rendered_store, "render_chunk", dies)
    with pytest.raises(KeyboardInterrupt):
        draw(models, tmp_path / "views")
    assert not (tmp_path / "views").exists()
    # Leftovers of a killed process are no obstacle.
    half = tmp_path / ".views.partial" / ".00000004.npz.part-abcdefgh" / "00000004.npz"
    half.parent.mkdir()
    half.write_bytes(b"half")
    again: list[str] = []
    monkeypatch.setattr(rendered_store, "render_chunk", lambda chunk: again.append(chunk.models[0].id) or real(chunk))
    draw(models, tmp_path / "views")
    assert (drawn, again) == (["model0", "model2"], ["model4", "model6"])
    assert content(tmp_path / "views") == content(tmp_path / "undisturbed")


def test_what_is_done_of_another_request_is_thrown_away(
    models: list[ModelFile], tmp_path: Path, small_chunks: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(models, tmp_path / "undisturbed", seed=2)
    with monkeypatch.context() as patch:
        patch.setattr(rendered_store, "assemble", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt()))
        with pytest.raises(KeyboardInterrupt):
            draw(models, tmp_path / "views", seed=1)
    draw(models, tmp_path / "views", seed=2)
    assert content(tmp_path / "views") == content(tmp_path / "undisturbed")


def test_no_room_is_said_before_drawing(
    models: list[ModelFile], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = SimpleNamespace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    monkeypatch.setattr(rendered_store, "render_chunk", lambda _: pytest.fail("drawn without room"))
    with pytest.raises(ViewnetError, match=r"\d+ bytes needed and 1000 free"):
        draw(models, tmp_path / "views")


def test_a_full_disk_is_said(models: list[ModelFile], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.raises(ViewnetError, match=r"00000000.npz: cannot be written \(No space"):
            draw(models, tmp_path / "views")
    assert [path.name for path in (tmp_path / ".views.partial").iterdir()] == ["plan.json"]
    draw(models, tmp_path / "views")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": 0}, "views 0: expected 1 to"),
        ({"image_size": 0}, "image_size 0"),
        ({"supersample": 99}, "supersample 99"),
        ({"workers": 0}, "workers 0"),
        ({"azimuth_range": (0, 400)}, "azimuth_range"),
        ({"elevation_range": (40, -20)}, "elevation_range"),
        ({"elevation_range": (0, float("nan"))}, "elevation_range"),
        ({"backend": "blender"}, "unknown renderer"),
        ({"models": []}, "no models to render"),
    ],
)
def test_bad_arguments(models: list[ModelFile], tmp_path: Path, change: dict, message: str) -> None:
    with pytest.raises(ViewnetError, match=message):
        draw(change.pop("models", models), tmp_path / "views", **change)
    assert not (tmp_path / "views").exists()


def test_a_model_given_twice(models: list[ModelFile], tmp_path: Path) -> None:
    with pytest.raises(ViewnetError, match="model1 of car is given twice"):
        draw([*models, models[1]], tmp_path / "views")


# Several processes


@pytest.mark.slow
def test_number_of_processes_does_not_matter(models: list[ModelFile], tmp_path: Path, small_chunks: None) -> None:
    draw(models, tmp_path / "one")
    draw(models, tmp_path / "two", workers=2)
    assert content(tmp_path / "one") == content(tmp_path / "two")


SCRIPT = """
import sys, time
from pathlib import Path
from viewnet.data import rendered_store as views
from viewnet.data.readers.shapenet import find_models

views.CHUNK = 1
real = views.render_chunk
def slow(chunk):
    time.sleep(float(sys.argv[3]))
    return real(chunk)
views.render_chunk = slow
store = views.render_views(
    find_models(sys.argv[1], "car"), Path(sys.argv[2]), views=2, image_size=16, workers=1, progress=False
)
print(store.identity)
"""


def start(cad: Path, folder: Path, pause: float) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(cad), str(folder), str(pause)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2],
    )  # fmt: skip


def wait_for(condition, process: subprocess.Popen) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert process.poll() is None and time.monotonic() < end, process.communicate()
        time.sleep(0.02)


@pytest.mark.slow
def test_kill_minus_nine_and_again(models: list[ModelFile], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendered_store, "CHUNK", 1)
    draw(models, tmp_path / "undisturbed")
    process = start(tmp_path / "cad", tmp_path / "views", 0.3)
    wait_for(lambda: len(list(tmp_path.glob(".views.partial/*.npz"))) >= 2, process)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (tmp_path / "views").exists()
    draw(models, tmp_path / "views")
    assert content(tmp_path / "views") == content(tmp_path / "undisturbed")


@pytest.mark.slow
def test_two_at_once_make_one_store(models: list[ModelFile], tmp_path: Path) -> None:
    first = start(tmp_path / "cad", tmp_path / "views", 0.3)
    wait_for(lambda: (tmp_path / ".views.partial").exists(), first)
    second = start(tmp_path / "cad", tmp_path / "views", 0.0)
    (out_one, err_one), (out_two, err_two) = first.communicate(), second.communicate()
    assert (first.returncode, second.returncode) == (0, 0), err_one + err_two
    assert out_one == out_two and "waiting for it" in err_two
    assert len(ViewStore.open(tmp_path / "views")) == 14


# From a configuration


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> DataConfig:
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    return DataConfig("car", models=10, views=2, image_size=16, supersample=1)


def test_built_in_views_are_made_once(config: DataConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = view_store(config, progress=False)
    assert len(store) == 20 and store.index["split"].value_counts().to_dict() == {"train": 14, "test": 4, "val": 2}
    assert len(store.rejected) == 0
    # The views are found even without the collection.
    shutil.rmtree(tmp_path / "data" / "cad")
    monkeypatch.setattr(build, "render_views", lambda *_, **__: pytest.fail("drawn again"))
    assert view_store(config, progress=False).folder == store.folder


def test_a_real_collection_is_read_the_same_way(config: DataConfig, models: list[ModelFile], tmp_path: Path) -> None:
    real = DataConfig(**{**config.__dict__, "root": str(tmp_path / "cad"), "models": 0})
    store = view_store(real, progress=False)
    assert store.index["model_id"].nunique() == 7
    some = view_store(DataConfig(**{**real.__dict__, "models": 4}), progress=False)
    assert some.folder != store.folder and 3 <= some.index["model_id"].nunique() <= 5
    write_box(tmp_path / "cad", CAR, "another")
    obj_file(tmp_path / "cad", CAR, "bad").write_text("")
    more = view_store(real, progress=False)
    assert more.index["model_id"].nunique() == 8 and more.rejected["model_id"].tolist() == ["bad"]


def test_a_second_collection_joins_the_training_models(
    config: DataConfig, models: list[ModelFile], tmp_path: Path
) -> None:
    root = str(tmp_path / "cad")
    alone = view_store(config, progress=False)
    # Seven training models of ten; seven more, each once, are half.
    store = view_store(DataConfig(**{**config.__dict__, "extra": root, "extra_share": 0.5}), progress=False)
    names = store.index[store.index["model_id"].str.startswith("extra")]
    assert names["model_id"].nunique() == 7 and set(names["split"]) == {"train"}
    others = store.index[~store.index["model_id"].str.startswith("extra")].reset_index(drop=True)
    assert others.equals(alone.index) and store.folder != alone.folder
    # At three quarters each comes three times, every time from other viewpoints.
    more = view_store(DataConfig(**{**config.__dict__, "extra": root, "extra_share": 0.75}), progress=False)
    names = more.index[more.index["model_id"].str.startswith("extra")]
    assert names["model_id"].nunique() == 21 and names["azimuth"].nunique() == len(names)
    for share in (0.0, 1.0):
        with pytest.raises(ViewnetError, match=f"extra_share {share}"):
            view_store(DataConfig(**{**config.__dict__, "extra": root, "extra_share": share}), progress=False)


@pytest.mark.parametrize(("models", "message"), [(0, "built-in ones have no end"), (-1, "models -1")])
def test_numbers_of_models_that_make_no_sense(config: DataConfig, models: int, message: str) -> None:
    with pytest.raises(ViewnetError, match=message):
        view_store(DataConfig(**{**config.__dict__, "models": models}), progress=False)
