from __future__ import annotations

import os
import subprocess
import sys

import pytest

from viewnet.data import rendered_store
from viewnet.errors import ViewnetError
from viewnet.runtime import parallel, provenance


@pytest.mark.parametrize(
    ("quota", "expected"),
    [("100000 100000", 1), ("250000 100000", 2), ("50000 100000", 1), ("max 100000", 8), ("99900000 100000", 8)],
)
def test_cores_are_those_of_the_container_s_quota(tmp_path, monkeypatch, quota, expected):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)), raising=False)
    monkeypatch.setattr(parallel, "QUOTA", tmp_path / "cpu.max")
    assert parallel.cores() == 8
    (tmp_path / "cpu.max").write_text(f"{quota}\n")
    assert parallel.cores() == expected
    assert provenance.hardware()["cores"] == expected


def test_rendering_uses_no_more_processes_than_the_quota_allows():
    assert rendered_store.cores is parallel.cores


@pytest.mark.parametrize(("text", "expected"), [("1", 1), ("3", 3), ("2,1", 2), (" 4 ", 4), ("1024", 1024)])
def test_threads_are_those_that_openmp_is_told(monkeypatch, text, expected):
    monkeypatch.setattr(parallel, "cores", lambda: 8)
    monkeypatch.setenv("OMP_NUM_THREADS", text)
    assert parallel.threads() == parallel.threads(side_by_side=4) == expected
    assert parallel.room() == max(1, 8 // expected)


@pytest.mark.parametrize("text", [None, "", " "])
def test_without_it_runs_share_the_cores(monkeypatch, text):
    monkeypatch.setattr(parallel, "cores", lambda: 8)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if text is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", text)
    assert [parallel.threads(runs) for runs in (1, 2, 3, 16)] == [8, 4, 2, 1]
    assert parallel.room() == 8


@pytest.mark.parametrize("text", ["0", "-1", "junk", "1.5", "1025", "9" * 5000, ",2", "²"])
def test_other_numbers_of_threads_are_refused(monkeypatch, text):
    monkeypatch.setenv("OMP_NUM_THREADS", text)
    with pytest.raises(ViewnetError, match=r"^OMP_NUM_THREADS=.*from 1 to 1024"):
        parallel.threads()


def test_environment_is_that_of_before_after_the_block(monkeypatch):
    monkeypatch.setenv("VIEWNET_A", "1")
    monkeypatch.delenv("VIEWNET_B", raising=False)
    with pytest.raises(ZeroDivisionError), parallel.environment(VIEWNET_A="2", VIEWNET_B="3"):
        assert (os.environ["VIEWNET_A"], os.environ["VIEWNET_B"]) == ("2", "3")
        raise ZeroDivisionError
    assert os.environ["VIEWNET_A"] == "1" and "VIEWNET_B" not in os.environ


PLAIN = """
from viewnet.runs.worker_pool import LocalPool
from viewnet.runtime import parallel

print("begun")
print(sorted(parallel.as_done(abs, [-1, 2, -3], 2, "numbers")))
with LocalPool(2) as pool:
    print(pool.submit(abs, -4).result())
"""
GUARDED = """
from viewnet.runtime import parallel

def twice(number):
    return 2 * number

if __name__ == "__main__":
    print(sorted(parallel.as_done(twice, [1, 2], 2, "numbers")))
"""


@pytest.mark.slow
@pytest.mark.parametrize(("script", "said"), [(PLAIN, "begun\n[1, 2, 3]\n4\n"), (GUARDED, "[2, 4]\n")])
def test_scripts_start_processes_with_and_without_a_guard(script, said, tmp_path):
    (tmp_path / "script.py").write_text(script)
    ran = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, timeout=120)
    assert ran.stdout == said, ran.stderr
