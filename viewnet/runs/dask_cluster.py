"""Workers of a Dask cluster as a standard executor. Dask is an extra: pip install 'viewnet[cluster]'."""

import contextlib
import os
import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

from viewnet.errors import ViewnetError
from viewnet.runtime.parallel import CLUSTER

FILE = "scheduler-file:"


@contextlib.contextmanager
def executor(address: str | None = None, timeout: float = 30) -> Iterator[Executor | None]:
    """The workers of a scheduler: its address (tcp://host:8786) or `scheduler-file:PATH`.

    By default it is the one that VIEWNET_CLUSTER names, or else there is none (None).
    Dask submits the job of a worker that dies to another, up to three times. ViewnetError where Dask is not installed,
    or no scheduler answers within `timeout` seconds.
    """
    address = address or os.environ.get(CLUSTER)
    if not address:
        yield None
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise ViewnetError(f"cluster {address}: Dask is not installed: pip install 'viewnet[cluster]'") from error
    file = address.removeprefix(FILE)
    if address.startswith(FILE) and not Path(file).is_file():
        raise ViewnetError(f"cluster {address}: no such file: start the scheduler with --scheduler-file first")
    scheduler = {"scheduler_file" if address.startswith(FILE) else "address": file}
    try:
        client = Client(**scheduler, timeout=timeout)
    except (OSError, ValueError) as error:
        raise ViewnetError(f"cluster {address}: no scheduler answers there ({error}): is it running?") from error
    with client:
        if not client.scheduler_info()["workers"]:
            print(f"cluster {address}: no worker is connected yet: waits for one", file=sys.stderr)
        # Not pure: a job submitted again must run again, since only its folder knows whether it is done.
        yield client.get_executor(pure=False)
