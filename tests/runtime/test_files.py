"""Files and folders are complete or absent; leftovers of killed processes are removed; a full disk is reported."""

from __future__ import annotations

import multiprocessing
import os
import signal
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.simulated_faults import can_mount, file_limit, grow, read_only, small_disk
from safetensors.torch import save_file

from viewnet.errors import ViewnetError
from viewnet.runtime.files import PART, filling, locked, replacing, scratch, write_text

MIB = 2**20


def hidden(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob(".*"))


def test_a_file_is_replaced_when_the_block_ends_well_only(tmp_path):
    file = tmp_path / "below" / "a.txt"
    write_text(file, "one")
    with pytest.raises(KeyError), replacing(file) as temporary:
        temporary.write_text("half")
        raise KeyError
    assert file.read_text() == "one" and not hidden(tmp_path)
    write_text(file, "two")
    assert file.read_text() == "two" and file.stat().st_mode & 0o777 == 0o644


def test_a_folder_appears_when_it_is_full(tmp_path):
    with pytest.raises(KeyError), filling(tmp_path / "a") as temporary:
        (temporary / "b").mkdir()
        raise KeyError
    assert not list(tmp_path.iterdir())
    with filling(tmp_path / "a") as temporary:
        (temporary / "b").write_text("b")
        assert not (tmp_path / "a").exists()
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "b"]
    with scratch(tmp_path / "a") as temporary:
        (temporary / "c").write_text("c")
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "b"]


def _dies_within(folder: Path) -> None:
    with replacing(folder / "a.txt") as file, filling(folder / "b") as temporary:
        file.write_text("half")
        (temporary / "c").write_text("half")
        os.kill(os.getpid(), signal.SIGKILL)


def test_what_the_dead_left_goes_and_what_the_living_write_stays(tmp_path):
    process = multiprocessing.get_context("fork").Process(target=_dies_within, args=(tmp_path,))
    process.start()
    process.join()
    assert len(hidden(tmp_path)) == 2 and all(PART in name for name in hidden(tmp_path))
    others = [tmp_path / ".a.txt.part-abc", tmp_path / ".a.txt.personal", tmp_path / ".x.txt.part-abcdefgh"]
    for other in others:
        other.mkdir()
    with replacing(tmp_path / "a.txt") as one, replacing(tmp_path / "a.txt") as two:
        assert one.parent.is_dir() and two.parent.is_dir()
        one.write_text("one"), two.write_text("two")
    with filling(tmp_path / "b") as temporary, scratch(tmp_path / "b") as beside:
        assert temporary.is_dir() and beside.is_dir()
    assert {path.name for path in tmp_path.iterdir()} == {"a.txt", "b", *(path.name for path in others)}
    assert (tmp_path / "a.txt").read_text() == "one"  # the last to finish


WRITERS = {
    "bytes": lambda path: path.write_bytes(bytes(MIB)),
    "numpy": lambda path: np.save(path, np.zeros(MIB, np.uint8)),
    "several arrays": lambda path: np.savez(path, a=np.zeros(MIB, np.uint8)),
    "torch": lambda path: torch.save({"a": torch.zeros(MIB // 4)}, path),
    "safetensors": lambda path: save_file({"a": torch.zeros(MIB // 4)}, path),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_file_that_cannot_grow_is_told_whoever_writes_it(tmp_path, writer):
    file = tmp_path / ("a.npz" if writer == "several arrays" else "a.npy")
    file.write_text("before")
    with (
        pytest.raises(ViewnetError, match=r"a\.np.: cannot be written \(File too large"),
        file_limit(MIB // 2),
        replacing(file) as temporary,
    ):
        WRITERS[writer](temporary)
    assert file.read_text() == "before" and not hidden(tmp_path)
    with replacing(file) as temporary:
        WRITERS[writer](temporary)
    assert file.stat().st_size >= MIB


@pytest.mark.parametrize("writer", WRITERS)
def test_a_full_disk_is_told_whoever_writes_to_it(tmp_path, writer):
    if not can_mount(tmp_path):
        pytest.skip("needs the right to mount file systems")
    file = tmp_path / ("a.npz" if writer == "several arrays" else "a.npy")
    with small_disk(tmp_path, MIB // 2):
        with pytest.raises(ViewnetError, match=r"\(No space left on device\): make room"), replacing(file) as temporary:
            WRITERS[writer](temporary)
        assert not list(tmp_path.iterdir())
        grow(tmp_path, 4 * MIB)
        with replacing(file) as temporary:
            WRITERS[writer](temporary)


def test_a_folder_is_not_replaced_by_a_file(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(ViewnetError, match=r"a: cannot be written \(Is a directory\)"):
        write_text(tmp_path / "a", "one")
    assert not hidden(tmp_path)


def test_other_errors_stay_what_they_are(tmp_path):
    with pytest.raises(FileNotFoundError), replacing(tmp_path / "a") as temporary:
        temporary.write_text("half")
        (tmp_path / "nothing").read_text()
    with pytest.raises(RuntimeError, match="of its own"), file_limit(MIB), replacing(tmp_path / "a") as temporary:
        raise RuntimeError("of its own")
    with pytest.raises(PermissionError), replacing(tmp_path / "a") as temporary:
        raise PermissionError(13, "Permission denied", "/elsewhere/b")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("make", [replacing, filling, locked])
def test_folders_that_cannot_be_written_to_are_told(tmp_path, make):
    (tmp_path / "file").write_text("")
    told = r"/a: cannot be written \(.*\): make it writable or choose another folder"
    with pytest.raises(ViewnetError, match=told), make(tmp_path / "file" / "a"):
        pytest.fail("entered")
    if os.geteuid() == 0 and not can_mount(tmp_path):
        pytest.skip("the superuser must be able to mount")
    with read_only(tmp_path), pytest.raises(ViewnetError, match=told), make(tmp_path / "a"):
        pytest.fail("entered")
