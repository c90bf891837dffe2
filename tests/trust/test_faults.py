"""Full disks, read-only folders, broken downloads, wrong clocks: one error, no partial files, then the same result.

`python benchmarks/faults.py` is the report; tests/test_files.py has what single files and folders promise.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from helpers import fake_steps
from helpers.boxes import box_store
from helpers.fake_steps import STEPS
from helpers.interrupted_work import differences, leftovers
from helpers.simulated_faults import can_mount, file_limit, read_only
from helpers.work_in_process import Task, undisturbed

from viewnet.config import DataConfig, VideoConfig
from viewnet.data import build
from viewnet.data.rendered_store import partial_folder
from viewnet.data.store import ViewStore, write_store
from viewnet.errors import ViewnetError
from viewnet.recipes import make_config
from viewnet.runs.make_run import STATE
from viewnet.runs.run_store import ensure
from viewnet.runtime.parallel import pool

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "faults.py"
spec = importlib.util.spec_from_file_location("faults", SCRIPT)
faults = importlib.util.module_from_spec(spec)
sys.modules["faults"] = faults  # which its data classes ask for


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    for name in ("runs", "data", "tables"):
        monkeypatch.setenv(f"VIEWNET_{name.upper()}", str(tmp_path / name))
    return tmp_path


def config():
    return make_config(profile="smoke")


# The whole report


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "environ", os.environ.copy())
        spec.loader.exec_module(faults)
    place = tmp_path_factory.mktemp("undisturbed")
    undisturbed(place)
    return place


@pytest.mark.slow
@pytest.mark.parametrize("part", ["full_disks", "closed_folders", "broken_downloads", "wrong_clocks", "losses"])
def test_every_fault_ends_in_one_error_and_then_as_if_nothing_had_been(part, reference, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    rows = list(getattr(faults, part)(tmp_path, reference))
    assert rows and [problem for row in rows for problem in row.problems] == []
    for row in rows:
        assert row.named == row.errors and row.damaged == 0
        assert row.afterwards.startswith(("identical", "trained", "the same error", "not measured")), row


# View stores


def small_store(folder: Path) -> ViewStore:
    return box_store(folder, {"train": 3, "val": 1, "test": 1}, views=2, size=16)


def drawn() -> ViewStore:
    return build.view_store(DataConfig("car", models=8, views=2, image_size=32), workers=1, progress=False)


def test_views_that_have_no_room_are_drawn_when_there_is_some(tmp_path, monkeypatch):
    monkeypatch.setattr("viewnet.data.rendered_store.CHUNK", 4)
    whole = drawn()
    (tmp_path / "whole").mkdir()
    (tmp_path / "data" / "views").rename(tmp_path / "whole" / "views")
    for size, place in ((10, "plan.json"), (10_000, "00000000.npz"), (50_000, whole.folder.name)):
        with file_limit(size):
            message = Task("", "data", drawn).message()
        assert f"{place}: cannot be written (File too large): make room and give the same command again" in message
        assert not whole.folder.exists() and "\n" not in message
    drawn()
    assert differences(tmp_path / "data", tmp_path / "whole", ("views",)) == []


def test_a_store_is_opened_without_a_lock(tmp_path, monkeypatch):
    videos = VideoConfig("car", sequences=(1, 2), frames=4, size=16)
    store, clips = drawn(), build.video_views(videos, progress=False)

    def closed(folder):
        raise AssertionError(f"{folder}: locked")

    monkeypatch.setattr(build, "locked", closed)
    monkeypatch.setattr("viewnet.data.store.locked", closed)
    assert drawn().identity == store.identity
    assert build.video_views(videos, progress=False).identity == clips.identity


def test_what_a_killed_call_left_beside_a_whole_store_goes(tmp_path):
    store = drawn()
    left = partial_folder(store.folder)
    left.mkdir()
    (left / "00000000.npz").write_bytes(b"drawn")
    drawn()
    assert not leftovers(tmp_path)


def test_views_of_two_sizes_are_no_store(tmp_path):
    store = small_store(tmp_path / "whole")
    half = store.images[:5]
    for other in (store.images[5:, :8], store.images[5:].astype(np.float32)):
        with pytest.raises(ViewnetError, match=r"views (uint8 \(8, 16, 4\)|float32 .*) among others of uint8 \(16, 16"):
            write_store(tmp_path / "mixed", [half, other], store.index, {})
        assert not (tmp_path / "mixed").exists() and not leftovers(tmp_path)
    again = write_store(tmp_path / "again", [half, store.images[5:]], store.index, {})
    assert np.array_equal(again.images, store.images)


# Runs


def test_a_run_that_cannot_be_written_is_told(tmp_path):
    if os.geteuid() == 0 and not can_mount(tmp_path):
        pytest.skip("the superuser must be able to mount")
    fake_steps.views(config().data)
    with (
        read_only(tmp_path / "runs"),
        pytest.raises(ViewnetError, match=r"/runs/viewnet/\w+: cannot be written \(.*\): make it writable or choose"),
    ):
        ensure([config()], workers=1, progress=False, steps=STEPS)
    (run,) = ensure([config()], workers=1, progress=False, steps=STEPS)
    with read_only(tmp_path / "runs"):
        assert ensure([config()], workers=1, progress=False, steps=STEPS) == [run]


def test_a_crash_where_nothing_can_be_written_is_told_too(tmp_path, monkeypatch):
    def crashes(config, views, folder, **_):
        raise ZeroDivisionError("division by zero")

    def full(path, text):
        raise ViewnetError(f"{path}: cannot be written")

    with monkeypatch.context() as patch, pytest.raises(ViewnetError) as caught:
        patch.setattr("viewnet.runs.make_run.write_text", full)
        ensure([config()], workers=1, progress=False, steps=replace(STEPS, train=crashes))
    assert str(caught.value).endswith("ZeroDivisionError: division by zero")
    with pytest.raises(ViewnetError, match=r"division by zero \(see .*error.log\)$"):
        ensure([config()], workers=1, progress=False, steps=replace(STEPS, train=crashes))


def test_a_training_that_fails_says_what_is_kept(tmp_path):
    kept: list[Path] = []

    def fails(config, views, folder, **_):
        if kept:
            (folder / STATE).write_bytes(b"state")
            (folder / "log.csv").write_text("epoch,step,seconds,loss,val_accuracy\n1,5,1,1,1\n2,10,2,1,1\n")
        kept.append(folder)
        raise ViewnetError("the loss is not finite at step 12: lower the learning rate")

    with pytest.raises(ViewnetError, match=r"lower the learning rate$"):
        ensure([config()], workers=1, progress=False, steps=replace(STEPS, train=fails))
    with pytest.raises(ViewnetError) as caught:
        ensure([config()], workers=1, progress=False, steps=replace(STEPS, train=fails))
    assert str(caught.value).endswith(f"lower the learning rate (the state of epoch 2 is kept in {kept[1] / STATE})")


def test_the_state_of_a_training_that_has_ended_goes(tmp_path):
    def killed_late(config, views, folder, **options):
        STEPS.train(config, views, folder, **options)
        (folder / STATE).write_bytes(b"state")

    (run,) = ensure([config()], workers=1, progress=False, steps=replace(STEPS, train=killed_late))
    assert not (run.folder / STATE).exists()


# Processes


def _draw_for_ever(note: Path) -> None:
    with pool(1) as crew:
        note.write_text(f"{crew.submit(os.getpid).result()}.")
        crew.submit(time.sleep, 600).result()


@pytest.mark.slow
def test_rendering_processes_end_with_the_one_that_asked(tmp_path):
    note = tmp_path / "note"
    parent = multiprocessing.get_context("spawn").Process(target=_draw_for_ever, args=(note,))
    parent.start()
    while not (note.exists() and note.read_text().endswith(".")):
        assert parent.is_alive()
        time.sleep(0.02)
    child = psutil.Process(int(note.read_text()[:-1]))
    os.kill(parent.pid, signal.SIGKILL)
    parent.join()
    gone, _ = psutil.wait_procs([child], timeout=120)
    assert gone or child.status() == psutil.STATUS_ZOMBIE
