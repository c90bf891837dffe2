"""What files hold, as hashes that are remembered, so that files are read again only where they may have changed.

The table of a folder lies in `<paths.data()>/contents`. A file counts as unchanged while its size, its times and its
place on the disk are; what it holds alone is in a hash, so neither times nor names of folders decide a store.
"""

import contextlib
import hashlib
import json
import os
import stat
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from viewnet import paths
from viewnet.errors import ViewnetError
from viewnet.runtime.files import read_json, write_text
from viewnet.runtime.parallel import cores

SETTLED = 2 * 10**9  # nanoseconds after which another change would show in a file's times
Named = dict[str, Path]
"""Files by names that do not depend on where their folder lies."""


def digests(root: Path, groups: Mapping[str, Callable[[], Named]]) -> list[str]:
    """A hash of the names and contents of each group of files, of which one that is missing has no content.

    `groups` maps a name that is its own below `root` to a function that lists the group's files; it is called only
    where one of those that it listed before may have changed.
    """
    table = paths.data() / "contents" / f"{hashlib.sha256(str(root.absolute()).encode()).hexdigest()[:16]}.json"
    known: dict[str, Any] = {}
    with contextlib.suppress(ViewnetError, TypeError, ValueError):  # no table yet, or a damaged one
        known = dict(read_json(table))
    begun = time.time_ns()

    def read(name: str) -> tuple[list[list[Any]], str]:
        """The group's files with their states, and its hash."""
        states = [(label, path, _state(path)) for label, path in groups[name]().items()]
        hashed = json.dumps([[label, state and _content(path)] for label, path, state in states])
        return [[str(path), state] for _, path, state in states], hashlib.sha256(hashed.encode()).hexdigest()

    changed = [name for name in groups if not _unchanged(known.get(name))]
    with ThreadPoolExecutor(cores()) as pool:
        known |= zip(changed, pool.map(read, changed), strict=True)
    result = [known[name][1] for name in groups]
    for name in changed:
        if any(state and max(state[1:3]) > begun - SETTLED for _, state in known[name][0]):
            del known[name]
    if known.keys() & changed:
        with contextlib.suppress(ViewnetError):  # a folder that cannot be written to: read again the next time
            write_text(table, json.dumps(known))
    return result


def of_files(root: Path, files: Iterable[Path]) -> dict[Path, str]:
    """File -> a hash of its content."""
    unique = dict.fromkeys(files)
    groups = {str(file.absolute()): lambda file=file: {"": file} for file in unique}
    return dict(zip(unique, digests(root, groups), strict=True))


def _unchanged(entry: Any) -> bool:
    """Whether an entry of the table is one, and of files that are as they were."""
    try:
        files, digest = entry
        return isinstance(digest, str) and all(_state(path) == state for path, state in files)
    except (TypeError, ValueError):
        return False


def _state(path: Path | str) -> list[int] | None:
    """What changes with a regular file: size, times of its content and of itself, and number on its disk; else None."""
    with contextlib.suppress(OSError, ValueError):  # a name may hold a zero
        if stat.S_ISREG((status := os.stat(path)).st_mode):
            return [status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]
    return None


def _content(path: Path) -> str | None:
    with contextlib.suppress(OSError), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
    return None
