"""Settings of the test session: set before any import, inherited by kernels and worker processes."""

from __future__ import annotations

import os

os.environ.setdefault("TQDM_DISABLE", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
from hypothesis import settings

if (worker := os.environ.get("PYTEST_XDIST_WORKER")) and hasattr(os, "sched_setaffinity"):
    # Processes side by side keep to cores of their own: what they start then starts no more processes than it has room.
    cores = sorted(os.sched_getaffinity(0))
    own = cores[int(worker.removeprefix("gw")) :: int(os.environ["PYTEST_XDIST_WORKER_COUNT"])]
    os.sched_setaffinity(0, own or cores)

# Compiled kernels make a first example slow, so there is no deadline; examples are the same every time.
settings.register_profile("viewnet", deadline=None, derandomize=True, max_examples=50, print_blob=True)
settings.load_profile("viewnet")

FIRST = ("notebooks/", "tests/web/", "tests/cad/", "tests/bench/")
"""What takes minutes a file: begun first, as two processes otherwise end with one of them waiting for the other."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: not item.nodeid.startswith(FIRST))


@pytest.fixture
def one_thread():
    """PyTorch on a single thread, for sums in a fixed order."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
