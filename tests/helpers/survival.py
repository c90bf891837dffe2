"""The guarantee of every reader, for any file: a result or a ViewnetError that names it, in bounded memory."""

from __future__ import annotations

import resource
import threading
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from viewnet.errors import ViewnetError

PEAK = 2**30
"""Bytes of additional memory that reading one small file may use."""
ROOM = 3 * 2**30
"""Bytes of address space it may request; beyond that a MemoryError protects the machine."""


@dataclass(frozen=True)
class Outcome:
    """How a call ended: its result or the ViewnetError it raised, CPU seconds, peak bytes."""

    result: object
    error: ViewnetError | None
    seconds: float
    peak: int


class Broken(AssertionError):
    """A reader broke the guarantee."""


def survives(call: Callable[[], object], names: Iterable[str]) -> Outcome:
    """Make the call; Broken where it ends in anything but a result or a ViewnetError with one of `names` in it.

    NumPy's warnings of overflow and invalid values, and Pillow's of bombs, count as failures too: something was
    computed with a value that should have been refused.
    """
    names = list(names)
    result, error = None, None
    soft, grown = resource.getrlimit(resource.RLIMIT_AS), growth()
    begun = time.process_time()
    resource.setrlimit(resource.RLIMIT_AS, (_status("VmSize") + ROOM, soft[1]))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            result = call()
    except ViewnetError as raised:
        error = raised
    except Exception as raised:
        raise Broken(f"{type(raised).__name__}: {(str(raised).splitlines() or [''])[0][:300]}") from raised
    finally:
        resource.setrlimit(resource.RLIMIT_AS, soft)
    seconds, peak = time.process_time() - begun, grown()
    if error is not None:
        _check(str(error), names)
    if peak > PEAK:
        raise Broken(f"{peak >> 20} MiB of memory")
    if threading.active_count() > 64:
        raise Broken(f"{threading.active_count()} threads left behind")
    return Outcome(result, error, seconds, peak)


def growth() -> Callable[[], int]:
    """What says how many bytes of memory this process has used, at most, beside those that it uses now."""
    before = _status("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here on
    return lambda: _status("VmHWM") - before


def _check(message: str, names: list[str]) -> None:
    """Check that it is one printable line of a readable length that names the file."""
    if not any(name in message for name in names):
        raise Broken(f"names none of {names}: {message[:300]!r}")
    if len(message) > 2000:
        raise Broken(f"a message of {len(message)} characters: {message[:300]!r}")
    try:
        message.encode()
    except UnicodeEncodeError as error:
        raise Broken(f"a message that cannot be written: {message[:300]!r}") from error


def _status(name: str) -> int:
    """Bytes of a line of this process's status."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) * 1024
    raise KeyError(name)
