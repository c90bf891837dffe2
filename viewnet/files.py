"""Writing a file so that it is there whole or not at all, and a folder by one process at a time."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from filelock import FileLock, Timeout

from viewnet.errors import ViewnetError

log = logging.getLogger(__name__)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name beside `path` that takes its place when the block ends well, and vanishes when it does not.

    Raises ViewnetError where the folder cannot be made or written to.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise ViewnetError(f"{path}: cannot be written ({error.strerror}): choose another folder") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)  # mkstemp's files are private to their maker
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """`text` in UTF-8 with plain line ends."""
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


def write_json(path: Path, value: Any) -> None:
    """`value` as indented JSON. NaN and infinity have no place in JSON and raise ValueError."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """The value of a JSON file; ViewnetError where there is none or it cannot be read."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ViewnetError(f"{path}: cannot be read ({error.strerror})") from error
    except RecursionError:
        raise ViewnetError(f"{path}: not JSON that can be read (too many brackets within each other)") from None
    except ValueError as error:
        raise ViewnetError(f"{path}: not JSON ({error})") from error


def read_csv(path: Path, **options: Any) -> Any:
    """A CSV file by pandas, as a DataFrame; ViewnetError where there is none or it cannot be read."""
    # pandas is slow to import and this module is imported by every rendering process.
    import pandas as pd

    try:
        return pd.read_csv(path, **options)
    except FileNotFoundError:
        raise ViewnetError(f"{path}: no such file") from None
    except (OSError, ValueError, OverflowError) as error:
        problem = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise ViewnetError(f"{path}: not a readable CSV file ({problem})") from None


def load_array(path: Path, again: str, mmap_mode: Literal["r"] | None = None) -> np.ndarray:
    """The array of a .npy file, of numbers only; ViewnetError, which ends in `again`, for anything else.

    Nothing is unpickled, and no more room is asked for than the file has.
    """
    try:
        # As a map first: the header may claim any size, and a map cannot be longer than its file.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "biufc":
            raise ValueError("no array of numbers")
        return array if mmap_mode else np.array(array)
    except Exception as error:  # NumPy raises whatever a damaged header makes it stumble over
        problem = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise ViewnetError(f"{path}: not a whole array ({problem}): {again}") from None


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """One process at a time makes `folder`; others wait. The system drops the lock of a process that dies."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder.with_name(f".{folder.name}.lock"))
    try:
        lock.acquire(timeout=0)
    except Timeout:
        log.warning("%s is being made by another process: waiting for it", folder)
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
