from __future__ import annotations

import numpy as np
import pytest
from helpers.boxes import box_store
from helpers.untrained_models import finished_run


@pytest.fixture(scope="session")
def store(tmp_path_factory):
    """Views of boxes: three objects each for val and test, three views of each."""
    return box_store(tmp_path_factory.mktemp("estimator") / "views", {"val": 3, "test": 3}, views=3)


@pytest.fixture(scope="session")
def images(store):
    """The test views (9, 32, 32, 4)."""
    return np.asarray(store.images[store.split("test")])


@pytest.fixture
def run(store, tmp_path, monkeypatch):
    """A finished run with the key 0123456789ab in a run store of its own."""
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    return finished_run(tmp_path / "runs" / "viewnet" / "0123456789ab", store)
