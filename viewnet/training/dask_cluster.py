"""Runs on a Dask cluster: its workers seen as a standard executor. Dask is an extra: pip install 'viewnet[cluster]'."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

from viewnet.errors import ViewnetError

VARIABLE = "VIEWNET_CLUSTER"
FILE = "scheduler-file:"


def named() -> str:
    """The cluster that VIEWNET_CLUSTER names, "" where there is none."""
    return os.environ.get(VARIABLE, "")


@contextlib.contextmanager
def executor(address: str | None = None, patience: float = 30) -> Iterator[Executor]:
    """The workers of a scheduler: its address (tcp://host:8786) or `scheduler-file:PATH`, else what is `named`.

    A worker that dies costs a job its place, not the job: Dask begins it again on another, up to three times. Raises
    ViewnetError where Dask is not installed, or no scheduler answers within `patience` seconds.
    """
    address = address or named()
    if not address:
        raise ViewnetError(f"no cluster: give tcp://HOST:PORT or {FILE}PATH, or set {VARIABLE}")
    try:
        from distributed import Client
    except ImportError as error:
        raise ViewnetError(f"cluster {address}: Dask is not installed: pip install 'viewnet[cluster]'") from error
    where = {"address": address}
    if address.startswith(FILE):
        where = {"scheduler_file": address.removeprefix(FILE)}
        if not Path(where["scheduler_file"]).is_file():
            raise ViewnetError(f"cluster {address}: no such file: start the scheduler with --scheduler-file first")
    try:
        client = Client(**where, timeout=patience)
    except (OSError, ValueError) as error:
        raise ViewnetError(f"cluster {address}: no scheduler answers there ({error}): is it running?") from error
    with client:
        # A job that is asked for again is to be made again: whether it is needed is for its folder to say.
        yield client.get_executor(pure=False)
