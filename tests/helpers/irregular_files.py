"""What has the name of a file and is none: a pipe, which waits for a writer; a device, which may not end; a folder."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path


def pipe(file: Path) -> None:
    """A named pipe; who opens it finds it empty rather than wait for ever."""
    os.mkfifo(file)

    def write_nothing() -> None:
        while True:
            file.open("wb").close()

    threading.Thread(target=write_nothing, daemon=True).start()


IRREGULAR: dict[str, Callable[[Path], None]] = {
    "a pipe": pipe,
    "a device": lambda file: file.symlink_to("/dev/null"),
    "a folder": Path.mkdir,
}
"""Makes each at a path."""
