"""Settings of the test session: made before anything is imported, handed on to kernels and worker processes."""

from __future__ import annotations

import os

os.environ.setdefault("TQDM_DISABLE", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
from hypothesis import settings

# Compiled kernels make a first example slow, so there is no deadline; the same examples are drawn every time.
settings.register_profile("viewnet", deadline=None, derandomize=True, max_examples=50, print_blob=True)
settings.load_profile("viewnet")


@pytest.fixture
def one_thread():
    """PyTorch on a single thread: where sums have to come out in one order."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
