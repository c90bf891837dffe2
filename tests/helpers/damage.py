"""Ways to damage a file, as hypothesis strategies: of its bytes, or of a well-formed file's content."""

from __future__ import annotations

import io
import json
import os
import pickle
import pickletools
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io
from helpers.imagenet3d_files import archive, pickle_of, pickled
from hypothesis import strategies as st

EXTREMES = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"1e400", b"-1e308", b"1e-320", b"0x10", b"1_0", b"9" * 25, b"-" + b"9" * 25,
    b"2147483648", b"-9223372036854775808", b"1000000000000000000", b"1.5", b"", b"None", b"[]", b"\xd9\xa3",
)  # fmt: skip
WORDS = (
    b"\0", b"\n", b"\r\n", b"\t", b" ", b"\\", b"/", b"..", b"../../../../etc/passwd", b"/etc/passwd", b"C:\\x", b'"',
    b"'", b",", b";", b"#", b"{", b"[", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\x1b[2J", b"a" * 300, b"%s%n",
    b"~root", b"$HOME", b"\xe2\x80\xa8", b"=",
)  # fmt: skip
INTEGERS = tuple(
    struct.pack(kind, value)
    for kind, values in (
        ("B", (0, 127, 128, 255)),
        ("<H", (0, 32767, 65535)),
        (">H", (0, 32767, 65535)),
        ("<I", (0, 0x7FFFFFFF, 0xFFFFFFFF, 100_000)),
        (">I", (0, 0x7FFFFFFF, 0xFFFFFFFF, 100_000)),
        ("<Q", (0, 2**63 - 1, 2**64 - 1, 10**11)),
        ("<d", (float("nan"), float("inf"), 1e300)),
        ("<f", (float("nan"), float("inf"), 1e38)),
    )
    for value in values
)
DIGITS = b"0123456789"


@st.composite
def damaged(draw: Callable[[Any], Any], content: bytes) -> bytes:
    """`content` with one to three things done to it."""
    for _ in range(draw(st.integers(1, 3))):
        content = draw(st.sampled_from(_KINDS))(draw, content)
    return content[: 2**22]


def _place(draw: Callable[[Any], Any], content: bytes) -> int:
    # Headers decide more than what follows them.
    last = len(content)
    return draw(st.one_of(st.integers(0, min(last, 400)), st.integers(0, last)))


def _part(draw: Callable[[Any], Any], content: bytes) -> tuple[int, int]:
    start = _place(draw, content)
    return start, min(len(content), start + draw(st.integers(1, 64)))


def _truncated(draw: Callable[[Any], Any], content: bytes) -> bytes:
    return content[: _place(draw, content)]


def _flipped(draw: Callable[[Any], Any], content: bytes) -> bytes:
    spoilt = bytearray(content)
    for _ in range(draw(st.integers(1, 8)) if content else 0):
        spoilt[min(_place(draw, content), len(content) - 1)] ^= 1 << draw(st.integers(0, 7))
    return bytes(spoilt)


def _removed(draw: Callable[[Any], Any], content: bytes) -> bytes:
    start, end = _part(draw, content)
    return content[:start] + content[end:]


def _spliced(draw: Callable[[Any], Any], content: bytes) -> bytes:
    start, end = _part(draw, content)
    place = _place(draw, content)
    return content[:place] + content[start:end] + content[place:]


def _repeated(draw: Callable[[Any], Any], content: bytes) -> bytes:
    start, end = _part(draw, content)
    times = draw(st.sampled_from([2, 3, 50, 2000]))
    return content[:start] + content[start:end] * times + content[end:]


def _inserted(draw: Callable[[Any], Any], content: bytes) -> bytes:
    place, word = _place(draw, content), draw(st.sampled_from(WORDS))
    return content[:place] + word + content[place:]


def _overwritten(draw: Callable[[Any], Any], content: bytes) -> bytes:
    place, number = _place(draw, content), draw(st.sampled_from(INTEGERS))
    return content[:place] + number + content[place + len(number) :]


def _numbered(draw: Callable[[Any], Any], content: bytes) -> bytes:
    """With a number in the text replaced by an extreme one."""
    begins = [i for i, c in enumerate(content[:20_000]) if c in DIGITS and (i == 0 or content[i - 1] not in DIGITS)]
    if not begins:
        return content
    start = end = draw(st.sampled_from(begins))
    while end < len(content) and content[end] in DIGITS + b".":
        end += 1
    return content[:start] + draw(st.sampled_from(EXTREMES)) + content[end:]


_KINDS = (_truncated, _flipped, _removed, _spliced, _repeated, _inserted, _overwritten, _numbered)

hostile_text = st.one_of(
    st.sampled_from([word.decode("utf-8", "replace") for word in (*WORDS, *EXTREMES)]), st.text(max_size=8)
)
hostile_numbers = st.one_of(
    st.sampled_from([0, -1, 1, 2**31, 2**63 - 1, -(2**63), 10**400, 1e308, -1e308, float("nan"), float("inf"), -0.0]),
    st.integers(-10, 400),
    st.floats(),
)
hostile_values = st.recursive(
    st.one_of(st.none(), st.booleans(), hostile_numbers, hostile_text),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(hostile_text, inner, max_size=3)),
    max_leaves=6,
)


@st.composite
def other_json(draw: Callable[[Any], Any], content: bytes) -> bytes:
    """JSON in which some values are others, or keys are missing."""
    return json.dumps(draw(_changed(json.loads(content)))).encode()


@st.composite
def _changed(draw: Callable[[Any], Any], value: Any) -> Any:
    if isinstance(value, dict) and value and draw(st.integers(0, 3)):
        key = draw(st.sampled_from(sorted(value)))
        if draw(st.integers(0, 5)) == 0:
            return {name: item for name, item in value.items() if name != key}
        return {**value, key: draw(_changed(value[key]))}
    if isinstance(value, list) and value and draw(st.booleans()):
        place = draw(st.integers(0, len(value) - 1))
        return [*value[:place], draw(_changed(value[place])), *value[place + 1 :]]
    return draw(hostile_values)


@st.composite
def other_table(draw: Callable[[Any], Any], content: bytes) -> bytes:
    """A parquet file in which a column is missing, there once more, of another type, or holds other values."""
    frame = pd.read_parquet(io.BytesIO(content))
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(list(frame.columns)))
        change = draw(st.sampled_from(["drop", "add", "rename", "retype", "values", "rows", "one"]))
        if change == "drop":
            frame = frame.drop(columns=name)
        elif change == "add":
            frame[draw(hostile_text)] = 1.0
        elif change == "rename":
            frame = frame.rename(columns={name: draw(hostile_text)})
        elif change == "retype":
            kind = draw(st.sampled_from(["str", "float32", "bool", "category", "Int64", "Float64", "complex", "list"]))
            frame[name] = _retyped(frame[name], kind)
        elif change == "values":
            frame[name] = pd.Series([draw(hostile_numbers)] * len(frame), dtype=object, index=frame.index)
        elif change == "rows":
            frame = frame.iloc[draw(st.sampled_from([slice(0, 0), slice(1, None), slice(None, None, -1)]))]
        else:
            column = frame[name].astype(object)
            column.iloc[: 1 if len(column) else 0] = draw(st.one_of(hostile_numbers, hostile_text, st.none()))
            frame[name] = column
        if frame.columns.empty or frame.columns.duplicated().any():
            break
    target = io.BytesIO()
    try:
        frame.to_parquet(target, index=draw(st.booleans()))
    except Exception:  # what has no place in the format: as text
        frame.astype(str).set_axis([f"c{i}" for i in range(len(frame.columns))], axis=1).to_parquet(target)
    return target.getvalue()


def _retyped(column: pd.Series, kind: str) -> pd.Series:
    if kind == "list":
        return pd.Series([[1.0, 2.0]] * len(column), index=column.index, dtype=object)
    try:
        return column.astype(kind)
    except (TypeError, ValueError):
        return column.astype(str)


@st.composite
def other_array(draw: Callable[[Any], Any], content: bytes) -> bytes:
    """A .npy file of another shape or type, or with a header that claims one."""
    array = np.load(io.BytesIO(content), allow_pickle=False)
    kinds = ["u1", "<i8", "<f4", "<f8", "<c16", "?", "S3", "<U2", "<M8[s]", "|V4"]
    if draw(st.booleans()):
        shape = tuple(draw(st.lists(st.integers(0, 5), max_size=5)))
        target = io.BytesIO()
        np.save(target, np.zeros(shape, draw(st.sampled_from(kinds))), allow_pickle=False)
        return target.getvalue()
    size = st.sampled_from([0, 1, 3, -1, 2**31, 2**62, 2**63, 10**30])
    shape = tuple(draw(size) if draw(st.booleans()) else n for n in array.shape)
    described = {"descr": draw(st.sampled_from([*kinds, "|O", "x", "<u1,<u2"])), "fortran_order": False, "shape": shape}
    header = repr(described).encode() if draw(st.integers(0, 3)) else draw(st.sampled_from([b"(" * 9000, b"{'", b"1+"]))
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(header) + 1) + header + b"\n" + array.tobytes()


@st.composite
def other_record(draw: Callable[[Any], Any], content: bytes) -> bytes:
    """A MATLAB file in which parts of the record are others."""
    record = _plain(scipy.io.loadmat(io.BytesIO(content), squeeze_me=True, struct_as_record=False)["record"])
    target = io.BytesIO()
    scipy.io.savemat(target, {"record": draw(_changed_record(record))}, do_compression=draw(st.booleans()))
    return target.getvalue()


_matlab = st.one_of(
    st.sampled_from(["", "x", 0.0, -1.0, float("nan"), float("inf"), 1e308, True, 10**18, 2**63]),
    st.sampled_from([np.zeros(0), np.zeros((2, 2)), np.zeros((1, 4)), np.array([1 + 2j]), np.array(["a", "bc"])]),
    st.just(np.array([1.0, "x", np.zeros(2)], dtype=object)),
    st.dictionaries(st.sampled_from(["objects", "viewpoint", "class_", "a"]), st.floats(), max_size=3),
)


@st.composite
def _changed_record(draw: Callable[[Any], Any], value: Any) -> Any:
    if isinstance(value, dict) and draw(st.integers(0, 4)):
        key = draw(st.sampled_from(sorted(value)))
        if draw(st.integers(0, 5)) == 0 and len(value) > 1:
            return {name: item for name, item in value.items() if name != key}
        return {**value, key: draw(_changed_record(value[key]))}
    return draw(_matlab)


def _plain(value: Any) -> Any:
    if hasattr(value, "_fieldnames"):
        return {name: _plain(getattr(value, name)) for name in value._fieldnames}
    return value


EXECUTED = Path(tempfile.gettempdir(), f"viewnet-executed-{os.getpid()}")
"""A folder that appears if anything in a drawn pickle is executed."""


class _Harm:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(EXECUTED),)


_CALLS = (
    *(pickle.dumps(_Harm(), protocol)[:-1] for protocol in range(6)),
    f"cos\nsystem\n(S'mkdir {EXECUTED}'\ntR".encode(),
    f"(S'mkdir {EXECUTED}'\nios\nsystem\n".encode(),
    f"c__builtin__\neval\n(V__import__('os').mkdir({str(EXECUTED)!r})\ntR".encode(),
    b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(J\xff\xff\xff\x7ftC\x01btR",
    b"cnumpy\ndtype\n(X\x02\0\0\0f8K\0K\x01tR",
)
"""Parts of pickles that execute something where they are unpickled, and two of NumPy's own."""


@st.composite
def other_objects(draw: Callable[[Any], Any], content: bytes) -> bytes:
    """An .npz file with a right checksum whose array of objects is damaged, has other objects, or other opcodes."""
    stored = pickled(content)
    how = draw(st.sampled_from(["damaged", "values", "opcodes"]))
    if how == "damaged":
        stored = draw(damaged(stored))
    elif how == "values":
        objects = list(pickle.loads(stored))  # of the tests' own making
        stored = pickle_of(draw(_changed_objects(objects)), draw(st.integers(2, 5)))
    else:
        ends = [place for _, _, place in pickletools.genops(stored)]
        for _ in range(draw(st.integers(1, 4))):
            place = draw(st.sampled_from(ends))
            stored = stored[:place] + draw(_parts) + stored[place + draw(st.integers(0, 2)) :]
    return archive(stored, draw(st.sampled_from([0, 8])))


@st.composite
def _opcodes(draw: Callable[[Any], Any]) -> bytes:
    """One of all opcodes of all protocols, with an argument that may claim another length."""
    opcode = draw(st.sampled_from(pickletools.opcodes))
    code, argument = opcode.code.encode("latin-1"), opcode.arg
    if argument is None:
        return code
    if argument.n >= 0:
        return code + draw(st.binary(min_size=argument.n, max_size=argument.n))
    if argument.n == pickletools.UP_TO_NEWLINE:
        lines = st.sampled_from([b"1", b"'a'", b"os\nsystem", b"numpy\nndarray", b"9" * 5000, b"\xff", b"1e999", b""])
        return code + draw(lines) + b"\n"
    kind = {pickletools.TAKEN_FROM_ARGUMENT1: "<B", pickletools.TAKEN_FROM_ARGUMENT8U: "<Q"}.get(argument.n, "<I")
    text = draw(st.binary(max_size=20))
    most = 256 ** struct.calcsize(kind) - 1
    size = draw(st.sampled_from([len(text), len(text), most, most // 2, 0]))
    return code + struct.pack(kind, size) + text


_parts = st.one_of(
    st.lists(_opcodes(), min_size=1, max_size=4).map(b"".join),
    st.sampled_from(_CALLS),
    st.sampled_from(
        [b"]" * 3000, b"(" * 3000, b"2" * 3000, b"h\0" * 3000, b"\x94" * 3000, b"(]" * 50_000, b"h\0\x86" * 900]
    ),
)

_objects = st.one_of(
    hostile_values,
    st.sampled_from(
        [np.float32(3), np.uint16(9), np.str_("status_good"), np.array(2.0), np.zeros(0), np.zeros((2, 2))]
    ),
    st.sampled_from([np.array([1, 2, 30, 40]), np.array([np.nan] * 4), np.array(["a"] * 4), np.array([1j] * 4)]),
    st.sampled_from([np.float16(1), np.datetime64("2020-01-01"), np.zeros(2, "f4,i4"), 1j, {1: 2}, {(1,): 2}, {1, 2}]),
    st.just(np.array([{}, [1.0]], dtype=object)),
)


@st.composite
def _changed_objects(draw: Callable[[Any], Any], value: Any) -> Any:
    if isinstance(value, list) and value:
        place = draw(st.integers(0, len(value) - 1))
        return [*value[:place], draw(_changed_objects(value[place])), *value[place + 1 :]]
    if isinstance(value, dict) and value and draw(st.integers(0, 5)):
        key = draw(st.sampled_from(sorted(value)))
        return {**value, key: draw(_objects)}
    return draw(_objects)
