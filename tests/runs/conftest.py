from __future__ import annotations

import pytest

from viewnet.runtime import parallel


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """A run store and view stores of the test's own, and no cluster."""
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.delenv(parallel.CLUSTER, raising=False)
    return tmp_path
