"""Finished runs that the tests of plots and of figure 3 share."""

from __future__ import annotations

import pytest
from helpers.fake_steps import STEPS

from viewnet.recipes import make_config
from viewnet.runs.run_store import ensure, untrained


@pytest.fixture(scope="package")
def smoke_runs(tmp_path_factory):
    """ViewNet on cars and on chairs, and the constant on cars."""
    root = tmp_path_factory.mktemp("figures")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VIEWNET_RUNS", str(root / "runs"))
        patch.setenv("VIEWNET_DATA", str(root / "data"))
        configs = [make_config(category=c, profile="smoke") for c in ("car", "chair")]
        yield ensure([*configs, untrained("constant", configs[0])], workers=1, progress=False, steps=STEPS)
