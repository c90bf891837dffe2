"""Writing files and folders so that they are there whole or not at all, and a folder by one process at a time."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import logging
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from filelock import FileLock, Timeout

from viewnet.errors import ViewnetError

log = logging.getLogger(__name__)

PART = ".part-"
"""What marks temporary folders, whose names begin with a dot; random letters follow."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_CLOSED = (errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO)


@contextlib.contextmanager
def writing(place: Path) -> Iterator[None]:
    """A full disk, or a folder that may not be written to, ends the block with a ViewnetError that names `place`."""
    try:
        yield
    except OSError as error:
        if error.errno not in _FULL + _CLOSED or _elsewhere(error, place):
            raise
        raise _refused(place, error) from error


def _elsewhere(error: OSError, place: Path) -> bool:
    """Whether it is told of a file that has nothing to do with `place`."""
    if not isinstance(error.filename, str | os.PathLike):
        return False
    file, place = Path(error.filename).absolute(), place.absolute()
    return not (file.is_relative_to(place.parent) or place.is_relative_to(file))


def _refused(place: Path, error: OSError) -> ViewnetError:
    full = error.errno in _FULL
    advice = "make room and give the same command again" if full else "make it writable or choose another folder"
    reason = os.strerror(error.errno) if error.errno else error.strerror  # libraries put sentences there
    return ViewnetError(f"{place}: cannot be written ({reason}): {advice}")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name for `path`; what is written there takes its place when the block ends well, and vanishes if not.

    Raises ViewnetError as `scratch` does.
    """
    path = Path(path)
    with scratch(path) as folder:
        temporary = folder / path.name
        try:
            yield temporary
        except ViewnetError:
            raise
        except Exception as error:
            if reason := _reason(error, temporary):
                raise _refused(path, reason) from error
            raise
        temporary.chmod(0o644)  # some libraries' files are private to their maker
        temporary.replace(path)


@contextlib.contextmanager
def filling(folder: Path) -> Iterator[Path]:
    """A temporary folder that becomes `folder`, which must not exist, when the block ends well; see `scratch`."""
    with scratch(folder) as temporary:
        yield temporary
        temporary.chmod(0o755)
        temporary.rename(folder)


@contextlib.contextmanager
def scratch(place: Path) -> Iterator[Path]:
    """A temporary folder beside `place`, private to its maker, that vanishes with the block.

    A folder, since some libraries write temporary files of their own beside the one they are given. Those that killed
    processes left of the same place are removed. Raises ViewnetError where the folder about it cannot be made or
    written to, and where the disk is full.
    """
    place = Path(place)
    temporary, claim = _claimed(place)
    try:
        with writing(place):
            yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        os.close(claim)


def _claimed(place: Path) -> tuple[Path, int]:
    """A new temporary folder, and a descriptor that holds a lock on it as long as this process lives."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        _sweep(place)
        while True:
            temporary = Path(tempfile.mkdtemp(prefix=f".{place.name}{PART}", dir=place.parent))
            claim = os.open(temporary, os.O_RDONLY)
            with contextlib.suppress(OSError):  # a file system without locks: nothing is swept there
                fcntl.flock(claim, fcntl.LOCK_EX)
            if temporary.exists():
                return temporary, claim
            os.close(claim)  # swept between its making and its claim
    except OSError as error:
        raise _refused(place, error) from error


def _sweep(place: Path) -> None:
    left = re.compile(re.escape(f".{place.name}{PART}") + "[a-z0-9_]{8}")
    for name in filter(left.fullmatch, os.listdir(place.parent)):
        with contextlib.suppress(OSError):  # it is still being written, or somebody else was faster
            claim = os.open(place.parent / name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(place.parent / name)
            finally:
                os.close(claim)


def _reason(error: Exception, file: Path) -> OSError | None:
    """Why nothing more can be written to a file, if that is what is behind an error: libraries have their own."""
    if isinstance(error, OSError) and error.errno:
        return None  # it says so itself
    if (said := re.search(r"\(os error (\d+)\)", str(error))) and int(said[1]) in _FULL + _CLOSED:
        return OSError(int(said[1]), os.strerror(int(said[1])))
    try:
        with file.open("ab") as stream:
            stream.write(bytes(2**16))
    except OSError as error:
        return error
    return None


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
    """One process at a time makes `folder`; others wait. The system drops the lock of a process that dies.

    Raises ViewnetError where there cannot be a lock, since the folder it would lie in cannot be made or written to.
    """
    lock = FileLock(folder.with_name(f".{folder.name}.lock"))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            log.warning("%s is being made by another process: waiting for it", folder)
            lock.acquire()
    except OSError as error:
        raise _refused(folder, error) from error
    try:
        yield
    finally:
        lock.release()
