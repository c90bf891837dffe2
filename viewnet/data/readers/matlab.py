"""MATLAB 5 files read by SciPy, after a look at what they claim.

SciPy believes a file: a kilobyte that says it holds ten gigabytes is unpacked, and structures within structures are
entered until the process dies.
"""

import io
import math
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import scipy.io

from viewnet.errors import ViewnetError

LARGEST = 4 * 2**20  # bytes of a file once it is unpacked: a thousand times an annotation
MOST_ARRAYS = 10_000
"""Arrays in a file, structures and their fields among them; so many within each other are still read."""
MOST_VALUES = 1_000_000
"""Of one array: a structure without fields takes no room in the file, however many of it there are."""

_HEADER = 128
_COMPRESSED, _ARRAY = 15, 14


def load(path: Path) -> dict[str, Any]:
    """The variables of a file, structures as objects with their fields as attributes.

    Raises ViewnetError for a file that cannot be read, is of another kind, or claims more than an annotation has.
    """
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise ViewnetError(f"{error.strerror}") from None
    order = {b"IM": "<", b"MI": ">"}.get(content[_HEADER - 2 : _HEADER])
    if order is None:
        raise ViewnetError("not a MATLAB 5 file")
    try:
        plain = _unpacked(content, order)
        _check(plain, order)
        return scipy.io.loadmat(io.BytesIO(plain), squeeze_me=True, struct_as_record=False)
    except ViewnetError:
        raise
    except Exception as error:  # SciPy raises whatever a damaged file makes it stumble over.
        raise ViewnetError(f"{type(error).__name__}: {(str(error).splitlines() or [''])[0][:200]}") from None


def _unpacked(content: bytes, order: str) -> bytes:
    """The same file without compression."""
    parts, room, place = [content[:_HEADER]], LARGEST - _HEADER, _HEADER
    while place < len(content):
        kind, size = struct.unpack_from(f"{order}II", content, place)
        end = place + 8 + size
        part = content[place:end]
        if kind == _COMPRESSED:
            part = zlib.decompressobj().decompress(part[8:], room + 1)
        parts.append(part)
        room -= len(part)
        if room < 0:
            raise ViewnetError(f"more than {LARGEST >> 20} MiB of it")
        place = end
    return b"".join(parts)


def _check(content: bytes, order: str) -> None:
    """Raise ViewnetError where there are too many arrays, or one of too many values: wherever one could begin."""
    mark = struct.pack(f"{order}I", _ARRAY)
    places = [found.start() for found in re.finditer(re.escape(mark), content)]
    if len(places) > MOST_ARRAYS:
        raise ViewnetError(f"more than {MOST_ARRAYS} arrays in it")
    for place in places:
        # An array begins with its own tag (8 bytes) and flags (16); then come its dimensions.
        dimensions = _integers(content, place + 24, order)
        if math.prod(max(number, 0) for number in dimensions) > MOST_VALUES:
            raise ViewnetError(f"an array of {' x '.join(map(str, dimensions[:4]))} values")


def _integers(content: bytes, place: int, order: str) -> tuple[int, ...]:
    """The 32 bit numbers of an element; () where there is none."""
    if place + 8 > len(content):
        return ()
    kind, size = struct.unpack_from(f"{order}II", content, place)
    start = place + 8
    if kind >> 16:  # an element of up to four bytes, which has its size beside its kind
        size, start = kind >> 16, place + 4
    if size > 128 or start + size > len(content):
        return ()
    return struct.unpack_from(f"{order}{size // 4}i", content, start)
