"""Files and folders that appear complete or not at all, and locks so that one process at a time makes a folder."""

import contextlib
import errno
import fcntl
import json
import logging
import os
import re
import resource
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from filelock import FileLock, Timeout

from viewnet.errors import ViewnetError

log = logging.getLogger(__name__)

PART = ".part-"  # part of the names of temporary folders: a dot, the target's name, this, and random letters
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_CLOSED = (errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EISDIR)


def _refused(place: Path, error: OSError) -> ViewnetError:
    full = error.errno in _FULL
    advice = "make room and give the same command again" if full else "make it writable or choose another folder"
    reason = os.strerror(error.errno) if error.errno else error.strerror  # libraries put sentences there
    return ViewnetError(f"{place}: cannot be written ({reason}): {advice}")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path; the file written there replaces `path` when the block succeeds; see `scratch`."""
    path = Path(path)
    with scratch(path) as folder:
        temporary = folder / path.name
        try:
            yield temporary
        except Exception as error:
            if cause := _cause(error, temporary):
                raise _refused(path, cause) from error
            raise
        temporary.chmod(0o644)  # some libraries make files that only their owner can read
        temporary.replace(path)


@contextlib.contextmanager
def filling(folder: Path) -> Iterator[Path]:
    """A temporary folder that becomes `folder`, which must not exist, when the block succeeds; see `scratch`."""
    with scratch(folder) as temporary:
        yield temporary
        temporary.chmod(0o755)
        temporary.rename(folder)


@contextlib.contextmanager
def scratch(place: Path) -> Iterator[Path]:
    """A temporary folder beside `place`, private to this process, removed after the block.

    A folder, since some libraries write temporary files of their own beside the one they are given. Those that killed
    processes left for the same place are removed. Raises ViewnetError, which names `place`, where the parent folder
    cannot be made or written to, and where the disk is full.
    """
    place = Path(place)
    temporary, claim = _claimed(place)
    try:
        yield temporary
    except OSError as error:
        other = False  # whether the error names a file that has nothing to do with `place`
        if isinstance(error.filename, str | os.PathLike):
            file = Path(error.filename).absolute()
            other = not (file.is_relative_to(place.absolute().parent) or place.absolute().is_relative_to(file))
        if other or error.errno not in _FULL + _CLOSED:
            raise
        raise _refused(place, error) from error
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
            os.close(claim)  # another process removed it before it was locked
    except OSError as error:
        raise _refused(place, error) from error


def _sweep(place: Path) -> None:
    """Remove temporary folders of killed processes: those that nobody holds a lock on."""
    pattern = re.compile(re.escape(f".{place.name}{PART}") + "[a-z0-9_]{8}")
    for name in filter(pattern.fullmatch, os.listdir(place.parent)):
        with contextlib.suppress(OSError):  # it is in use, or another process has removed it
            claim = os.open(place.parent / name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(place.parent / name)
            finally:
                os.close(claim)


def _cause(error: Exception, file: Path) -> OSError | None:
    """The operating system's error behind a library's own one, where `file` could not be written."""
    code = None
    if isinstance(error, ViewnetError) or (isinstance(error, OSError) and error.errno):
        return None  # `scratch` handles it
    if named := re.search(r"\(os error (\d+)\)", str(error)):
        code = int(named[1])
    elif shutil.disk_usage(file.parent).free < 2**16:
        code = errno.ENOSPC
    elif file.is_file() and 0 <= resource.getrlimit(resource.RLIMIT_FSIZE)[0] <= file.stat().st_size:
        code = errno.EFBIG
    return OSError(code, os.strerror(code)) if code in _FULL + _CLOSED else None


def write_text(path: Path, text: str) -> None:
    """Write `text` in UTF-8, its line ends as they are."""
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


def write_csv(path: Path, table: Any, index: bool = False) -> Path:
    """Write a DataFrame; returns the path."""
    write_text(path, table.to_csv(index=index, lineterminator="\n"))
    return path


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON. ValueError for NaN and infinity, which JSON does not have."""
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


def read_csv(path: Path, columns: Sequence[str] = (), **options: Any) -> Any:
    """A CSV file by pandas, as a DataFrame; ViewnetError where it cannot be read or lacks one of some columns."""
    # pandas is slow to import and this module is imported by every rendering process.
    import pandas as pd

    try:
        table = pd.read_csv(path, **options)
    except FileNotFoundError:
        raise ViewnetError(f"{path}: no such file") from None
    except (OSError, ValueError, OverflowError) as error:
        problem = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise ViewnetError(f"{path}: not a readable CSV file ({problem})") from None
    if missing := [name for name in columns if name not in table.columns]:
        raise ViewnetError(f"{path}: column {missing[0]!r} is missing: expected {', '.join(columns)}")
    return table


def load_array(path: Path, again: str, mmap_mode: Literal["r"] | None = None) -> np.ndarray:
    """The array of numbers in a .npy file, nothing unpickled; ViewnetError, ending in `again`, for anything else."""
    try:
        # Memory-mapped first: the header may claim any size, but a map cannot be longer than its file.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "biufc":
            raise ValueError("no array of numbers")
        return array if mmap_mode else np.array(array)
    except Exception as error:  # NumPy raises many types for damaged headers
        problem = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise ViewnetError(f"{path}: not a whole array ({problem}): {again}") from None


@contextlib.contextmanager
def locked(folder: Path, wait: bool = True) -> Iterator[None]:
    """Hold the lock of `folder`, waiting while a living process does.

    ViewnetError where it cannot be written and, without `wait`, where a living process holds it.
    """
    lock = FileLock(folder.with_name(f".{folder.name}.lock"))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            if not wait:
                raise ViewnetError(f"{folder} is being made by another process: try again when it is done") from None
            log.warning("%s is being made by another process: waiting for it", folder)
            lock.acquire()
    except OSError as error:
        raise _refused(folder, error) from error
    try:
        yield
    finally:
        lock.release()
