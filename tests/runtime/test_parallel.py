from __future__ import annotations

import os

import pytest

from viewnet.data import rendered_store
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


def test_environment_is_that_of_before_after_the_block(monkeypatch):
    monkeypatch.setenv("VIEWNET_A", "1")
    monkeypatch.delenv("VIEWNET_B", raising=False)
    with pytest.raises(ZeroDivisionError), parallel.environment(VIEWNET_A="2", VIEWNET_B="3"):
        assert (os.environ["VIEWNET_A"], os.environ["VIEWNET_B"]) == ("2", "3")
        raise ZeroDivisionError
    assert os.environ["VIEWNET_A"] == "1" and "VIEWNET_B" not in os.environ
