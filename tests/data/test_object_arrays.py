"""Arrays of objects in .npz files: what NumPy writes is read as NumPy reads it, and anything else is refused."""

from __future__ import annotations

import collections
import contextlib
import datetime
import pickletools
import random
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.imagenet3d_files import archive, pickle_of, thing

from viewnet.data.readers import object_arrays
from viewnet.data.readers.object_arrays import Array, load
from viewnet.errors import ViewnetError

VALUES = (
    *(None, True, False, 0, -1, 255, 70_000, -(2**40), 2**70, 1.5, float("inf"), "", "car", "é" * 300, b"", b"xyz"),
    *([], [1, [2.0, "a"]], (), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4), {}, {"a": {"b": [None]}}),
    *(np.float64(2.5), np.float32(0.5), np.float16(0.5), np.uint16(300), np.int8(-3), np.bool_(True), np.str_("é")),
    *(np.bytes_(b"q"), np.array(3.0), np.zeros(0), np.arange(4.0), np.arange(6).reshape(2, 3).T, np.ones(2, ">f8")),
    *(np.array(["a", "bé"]), np.array([True, False]), np.array([None, {"a": 1}], dtype=object)),
)
PROTOCOLS = range(2, 6)


def stored(folder: Path, pickled: bytes) -> Path:
    (folder / "a.npz").write_bytes(archive(pickled))
    return folder / "a.npz"


def plain(value: Any) -> Any:
    """Values to compare: NumPy's as Python's, and arrays by their type, shape and elements."""
    if isinstance(value, Array):
        value = value.values
        if isinstance(value, list):
            return "array", [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        if value.dtype == object:
            return "array", [plain(item) for item in value.tolist()]
        return "array", value.dtype.newbyteorder("=").str, value.shape, value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(plain(item) for item in value)
    return value


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_numpy_writes_is_read(tmp_path, protocol):
    objects = [{f"n{number}": value for number, value in enumerate(VALUES)}, *VALUES]
    found = load(stored(tmp_path, pickle_of(objects, protocol)), "annotations")
    assert [plain(item) for item in found] == [plain(item) for item in objects]
    assert [type(plain(item)) for item in found] == [type(plain(item)) for item in objects]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_names_of_both_numpys_are_read(tmp_path, protocol):
    pickled = pickle_of([thing()], protocol)
    assert b"numpy._core" in pickled or b"numpy.core" in pickled
    for module in (b"multiarray", b"numeric"):
        for name in (b"numpy._core." + module, b"numpy.core." + module):
            # A text's length stands before it, but not that of a name in the first protocols.
            pickled = pickled.replace(b"\x8c" + bytes([len(name)]) + name, b"\x8c\x00" + module)
            pickled = pickled.replace(b"c" + name, b"c\x00" + module)
    for core in (b"numpy._core.", b"numpy.core."):
        changed = pickled
        for module in (b"multiarray", b"numeric"):
            changed = changed.replace(b"\x8c\x00" + module, b"\x8c" + bytes([len(core + module)]) + core + module)
            changed = changed.replace(b"c\x00" + module, b"c" + core + module)
        assert plain(load(stored(tmp_path, changed), "annotations")) == [plain(thing())]


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_files_of_numpy_are_read(tmp_path, save):
    save(tmp_path / "a.npz", other=np.zeros(3), annotations=[thing(), thing(azimuth=90)])
    assert plain(load(tmp_path / "a.npz", "annotations")) == [plain(thing()), plain(thing(azimuth=90))]
    for name in ("other", "missing"):
        with pytest.raises(ViewnetError, match=name):
            load(tmp_path / "a.npz", name)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (1j, "'builtins.complex'|'__builtin__.complex'"),
        ({1, 2}, "EMPTY_SET|'builtins.set'|'__builtin__.set'"),
        (collections.OrderedDict(a=1), "'collections.OrderedDict'"),
        (datetime.date(2020, 1, 1), "'datetime.date'"),
        (Path("a"), "'pathlib[a-z._]*.PosixPath'"),
        (print, "print'"),
        (np.dtype, "as NumPy does not write it|no array of objects|damaged|^$"),
        ({1: 2}, "other keys than texts"),
        (np.datetime64("2020-01-01"), "dtype as NumPy does not write it"),
        (np.complex64(1), "dtype as NumPy does not write it"),
        (np.longdouble(1), "dtype as NumPy does not write it"),
        (np.zeros(2, "f4,i4"), "dtype as NumPy does not write it"),
        (np.ma.array([1.0]), "numpy.ma"),
    ],
)
def test_anything_else_is_refused_by_name(tmp_path, protocol, value, message):
    path = stored(tmp_path, pickle_of([{"a": value}], protocol))
    if value is np.dtype:  # a name alone is nothing that is called
        assert not isinstance(load(path, "annotations")[0]["a"], type)
        return
    with pytest.raises(ViewnetError, match=message):
        load(path, "annotations")


NAMES = """PROTO FRAME STOP MARK NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 LONG4 BINFLOAT BINUNICODE
SHORT_BINUNICODE BINUNICODE8 BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8 EMPTY_LIST APPEND APPENDS EMPTY_DICT SETITEM
SETITEMS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 MEMOIZE BINPUT LONG_BINPUT BINGET LONG_BINGET GLOBAL STACK_GLOBAL REDUCE
BUILD"""
READ = set(NAMES.split())
ARGUMENTS = {pickletools.TAKEN_FROM_ARGUMENT1: b"\0", pickletools.TAKEN_FROM_ARGUMENT8U: bytes(8)}


@pytest.mark.parametrize("opcode", pickletools.opcodes, ids=lambda opcode: opcode.name)
def test_no_other_opcode_is_read(tmp_path, opcode):
    size = 0 if opcode.arg is None else opcode.arg.n
    argument = bytes(size) if size >= 0 else ARGUMENTS.get(size, bytes(4))
    if size == pickletools.UP_TO_NEWLINE:
        argument = b"'1'\n" if opcode.name == "STRING" else b"1\n1\n"
    path = stored(tmp_path, b"NNN" + opcode.code.encode("latin-1") + argument + b".")
    with pytest.raises(ViewnetError) as raised:
        load(path, "annotations")
    assert (f"holds the opcode {opcode.name}," in str(raised.value)) == (opcode.name not in READ)


def test_every_opcode_that_numpy_writes_is_among_those_read():
    objects = [{f"n{number}": value for number, value in enumerate(VALUES)}, *VALUES]
    for protocol in PROTOCOLS:
        assert {opcode.name for opcode, *_ in pickletools.genops(pickle_of(objects, protocol))} <= READ


def test_what_is_too_large_is_refused(tmp_path):
    for objects, message in (
        ([[0] * object_arrays.MOST_PARTS], "parts"),
        (["a" * object_arrays.LARGEST], "MiB"),
        ([np.zeros(object_arrays.LARGEST, np.uint8)], "MiB"),
    ):
        with pytest.raises(ViewnetError, match=f"more than [0-9]+ {message}"):
            load(stored(tmp_path, pickle_of(objects, 4)), "annotations")
    with pytest.raises(ViewnetError, match="No such file"):
        load(tmp_path / "missing.npz", "annotations")


def test_a_letter_that_is_none_is_refused(tmp_path):
    pickled = pickle_of([np.str_("ab")], 4)
    assert pickled.count(b"b\0\0\0") == 1
    with pytest.raises(ViewnetError, match="damaged"):
        load(stored(tmp_path, pickled.replace(b"b\0\0\0", b"\xff\xff\xff\xff")), "annotations")


def test_nothing_is_imported_compiled_or_called_for_a_damaged_file(tmp_path):
    path, listening = stored(tmp_path, pickle_of([thing(bbox=np.array([1.0, 2, 3, 4]))], 4)), False
    happened: list[tuple[str, str]] = []

    def hook(event: str, arguments: object) -> None:
        if listening and event in ("import", "compile", "exec", "marshal.loads", "pickle.find_class", "os.system"):
            happened.append((event, str(arguments)[:80]))

    sys.addaudithook(hook)  # cannot be taken away again, so it is told when to listen
    whole = path.read_bytes()
    b"".decode("cp437")  # a name in an archive may be in this code, which Python loads when it first meets one
    numbers = random.Random(0)
    for _ in range(300):
        damaged = bytearray(whole)
        for _ in range(numbers.randint(1, 6)):
            damaged[numbers.randrange(len(damaged))] = numbers.randrange(256)
        path.write_bytes(damaged)
        listening = True
        with contextlib.suppress(ViewnetError):
            load(path, "annotations")
        listening = False
    assert not happened
