"""Work that is killed, and work that two processes need at once; `python benchmarks/crashes.py` does it 50 times.

The comparison itself is tested too: one that notices nothing would pass everything.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from random import Random

import numpy as np
import psutil
import pytest
from helpers.interrupted_work import damage, differences, drawing, leftovers, training
from helpers.killed_processes import Tally, kill_all, trial, undisturbed
from helpers.two_processes import QUESTIONS, two_processes

from viewnet.runtime.files import PART


@pytest.mark.slow
@pytest.mark.parametrize("work", [drawing(models=40), training(epochs=3)], ids=lambda work: work.name)
def test_killed_work_ends_as_if_nothing_had_been(tmp_path, work):
    tally = Tally()
    tally.seconds = undisturbed(work, tmp_path / "whole", None)
    data = tmp_path / "whole" / "data" if work.makes == ("runs",) else None
    while not tally.kills:  # the machine may be faster the second time
        trial(work, tmp_path / "killed", tmp_path / "whole", data, Random(tally.late), 2, tally)
        shutil.rmtree(tmp_path / "killed")
    assert tally.problems == [] and tally.identical == tally.trials


@pytest.mark.slow
def test_what_two_processes_ask_for_is_made_once(tmp_path):
    with two_processes(tmp_path / "data") as ask:
        for question in ("view store", "run"):
            for number in range(2):
                pair = ask(question, tmp_path / f"{question} {number}")
                assert (pair.made, pair.makers, pair.same, pair.problems) == (QUESTIONS[question][1], 1, True, [])


def test_a_process_is_killed_with_all_that_it_started(tmp_path):
    note = tmp_path / "children"
    child = "import time; time.sleep(600)"
    code = (
        "import subprocess, sys, time\n"
        f"crew = [subprocess.Popen([sys.executable, '-c', {child!r}], start_new_session=alone) for alone in (0, 1)]\n"
        f"open({str(note)!r}, 'w').write(' '.join(str(one.pid) for one in crew) + '.')\n"
        "time.sleep(600)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code])
    while not (note.exists() and note.read_text().endswith(".")):
        assert process.poll() is None
        time.sleep(0.01)
    children = [int(number) for number in note.read_text()[:-1].split()]
    assert kill_all(process)
    for child in children:
        with contextlib.suppress(psutil.NoSuchProcess):  # one that nobody waits for stays as a zombie
            assert psutil.Process(child).status() == psutil.STATUS_ZOMBIE
    late = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, late.pid, os.WEXITED | os.WNOWAIT)
    assert not kill_all(late)


@pytest.fixture
def finished(tmp_path) -> tuple[Path, Path]:
    """Two folders with the same finished work, made at different times."""
    for name, seconds in (("here", 1.5), ("there", 2.5)):
        folder = tmp_path / name / "runs" / "viewnet" / "key"
        folder.mkdir(parents=True)
        np.save(folder / "a.npy", np.arange(5))
        (folder / "log.csv").write_text(f"epoch,seconds,loss\n1,{seconds},0.5\n")
        result = {"metrics": 1, "training": {"seconds": seconds, "resumed": name == "here", "seeds": [0]}}
        (folder / "result.json").write_text(json.dumps(result))
        (tmp_path / name / "runs" / "viewnet" / ".key.lock").touch()
    return tmp_path / "here", tmp_path / "there"


def test_work_that_is_the_same_is_seen_as_such(finished):
    assert differences(*finished, ("runs",)) == damage(*finished, ("runs",)) == []
    (finished[0] / "runs" / "viewnet" / "key" / "a.npy").unlink()  # not there yet
    assert damage(*finished, ("runs",)) == []


@pytest.mark.parametrize(
    ("file", "content", "amid", "at_the_end"),
    [
        ("a.npy", b"\x93NUMPY", True, True),
        ("result.json", b'{"metrics": 1', True, True),
        ("result.json", b'{"metrics": 2, "training": {"seeds": [0]}}', False, True),
        ("log.csv", b"epoch,seconds,loss\n1,1,0.6\n", False, True),
        ("checkpoint.safetensors", b"half", True, True),
        ("state.pt", b"half", True, True),
        ("stray.csv", b"", True, True),
        (f".a.npy{PART}abcdefgh", b"", False, True),
    ],
)
def test_what_is_damaged_left_or_other_is_seen(finished, file, content, amid, at_the_end):
    here, there = finished
    (here / "runs" / "viewnet" / "key" / file).write_bytes(content)
    assert bool(damage(here, there, ("runs",))) == amid
    assert bool(differences(here, there, ("runs",))) == at_the_end
    assert bool(leftovers(here)) == file.startswith(".")


def test_undisturbed_work_with_a_file_more_is_no_match(finished):
    (finished[1] / "runs" / "viewnet" / "key" / "more.csv").touch()
    assert differences(*finished, ("runs",)) == ["runs/viewnet/key/more.csv: is missing"]
