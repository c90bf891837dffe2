"""Arrays of objects in NumPy's .npz files, without unpickling.

NumPy pickles such an array, and unpickling calls whatever a file names. Here the file is only parsed: the opcodes and
the few names that NumPy writes for numbers, texts, lists, dictionaries and arrays of them are understood, and anything
else is refused by name. Nothing that a file names is imported or called, and what it may make of itself is bounded.
"""

import io
import math
import pickletools
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from viewnet.errors import ViewnetError

# Bytes of a file, of it once it is unpacked, and of what it makes arrays of: a thousand objects have less.
LARGEST = 2**20
MOST_PARTS = 100_000  # opcodes: an annotated object has about a hundred


@dataclass(eq=False)
class Array:
    """An array in a file: of numbers, or the objects of an array of objects, in one list."""

    values: np.ndarray | list[Any]


@dataclass(frozen=True)
class _Name:
    """Something that the file would have called."""

    name: str


@dataclass(eq=False)
class _Kind:
    """The type of an array's elements: NumPy's code for it, and once that has come the order of its bytes."""

    code: str
    order: str = "="

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(self.order + self.code)


_NAMES = {
    f"{module} {name}": _Name(name)
    for modules, names in (
        (("numpy.core.multiarray", "numpy._core.multiarray"), ("_reconstruct", "scalar")),
        (("numpy.core.numeric", "numpy._core.numeric"), ("_frombuffer",)),  # protocol 5
        (("numpy",), ("ndarray", "dtype")),
        (("_codecs",), ("encode",)),  # bytes in protocol 2, and the next one where there are none
        (("builtins", "__builtin__"), ("bytes",)),
    )
    for module in modules
    for name in names
}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_VALUES = {
    *("BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT"),
    *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
}
# As NumPy writes it, up to the shape.
_HEADER = re.compile(
    rb"\x93NUMPY(?:\x01\0..|[\x02\x03]\0....)\{'descr': '\|O', 'fortran_order': (?:True|False), 'shape': [^{}]*\} *\n",
    re.DOTALL,
)
_CODE = re.compile(r"b1|[iu][1248]|f[248]|O[48]|[SU][1-9][0-9]{0,2}")


def load(path: Path, name: str) -> list[Any]:
    """The objects of the array `name` of a file: None, bool, int, float, str, bytes, and lists, tuples, dictionaries
    with texts as keys, and `Array`s of such. Numbers and texts of NumPy's types become Python's.

    Raises ViewnetError for a file that cannot be read, holds anything else, or more than an annotation has.
    """
    content = _member(path, f"{name}.npy")
    header = _HEADER.match(content)
    if header is None:
        raise ViewnetError(f"{name!r} is no array of objects")
    try:
        array = _parsed(content[header.end() :])
    except ViewnetError:
        raise
    except (LookupError, ValueError) as error:
        raise ViewnetError(f"damaged ({type(error).__name__})") from None
    if not isinstance(array, Array) or isinstance(array.values, np.ndarray):
        raise ViewnetError(f"{name!r} is no array of objects")
    return array.values


def _member(path: Path, name: str) -> bytes:
    """A file within an archive, whose checksum is right."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise ViewnetError(f"{error.strerror}") from None
    try:
        _check_size(content)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            part = archive.getinfo(name)
            if part.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ViewnetError("compressed in another way than NumPy's")
            with archive.open(part) as opened:
                plain = opened.read(LARGEST + 1)
        _check_size(plain)
    except ViewnetError:
        raise
    except KeyError:
        raise ViewnetError(f"no {name} in it") from None
    except Exception as error:  # zipfile and zlib raise whatever a damaged file makes them stumble over.
        raise ViewnetError(f"not an .npz file ({type(error).__name__})") from None
    return plain


def _check_size(content: bytes) -> None:
    if len(content) > LARGEST:
        raise ViewnetError(f"more than {LARGEST >> 20} MiB of it")


def _parsed(pickled: bytes) -> Any:
    """The object that pickled bytes stand for. ValueError and LookupError where they are damaged."""
    stack: list[Any] = []
    outer: list[list[Any]] = []  # the stacks below each mark
    memo: dict[int, Any] = {}
    used = 0
    value: Any
    for number, (opcode, value, _) in enumerate(pickletools.genops(pickled)):
        if number == MOST_PARTS:
            raise ViewnetError(f"more than {MOST_PARTS} parts in it")
        match opcode.name:
            case "PROTO" | "FRAME":
                pass
            case "STOP":
                return stack.pop()
            case name if name in _VALUES:
                stack.append(value)
            case name if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            case "EMPTY_LIST":
                stack.append([])
            case "EMPTY_DICT":
                stack.append({})
            case "MARK":
                outer.append(stack)
                stack = []
            case "TUPLE":
                items, stack = stack, outer.pop()
                stack.append(tuple(items))
            case "TUPLE1" | "TUPLE2" | "TUPLE3" as name:
                items = [stack.pop() for _ in range(int(name[-1]))]
                stack.append(tuple(reversed(items)))
            case "APPEND":
                item = stack.pop()
                _extend(stack[-1], [item])
            case "APPENDS":
                items, stack = stack, outer.pop()
                _extend(stack[-1], items)
            case "SETITEM":
                item, key = stack.pop(), stack.pop()
                _update(stack[-1], [key, item])
            case "SETITEMS":
                items, stack = stack, outer.pop()
                _update(stack[-1], items)
            case "MEMOIZE":
                memo[len(memo)] = stack[-1]
            case "BINPUT" | "LONG_BINPUT":
                memo[value] = stack[-1]
            case "BINGET" | "LONG_BINGET":
                stack.append(memo[value])
            case "GLOBAL":
                stack.append(_named(value))
            case "STACK_GLOBAL":
                name, module = stack.pop(), stack.pop()
                stack.append(_named(f"{module} {name}" if isinstance(module, str) and isinstance(name, str) else ""))
            case "REDUCE" | "BUILD" as name:
                state, target = stack.pop(), stack.pop()
                used += _size(state)  # what is in the file once can be named again and again
                if used > LARGEST:
                    raise ViewnetError(f"more than {LARGEST >> 20} MiB of it")
                stack.append(_made(target, state) if name == "REDUCE" else _built(target, state))
            case other:
                raise ViewnetError(f"holds the opcode {other}, which is not read")
    raise ValueError("no end")


def _named(name: str) -> _Name:
    if name not in _NAMES:
        raise ViewnetError(f"holds {name.replace(' ', '.')[:60]!r}, which is not read")
    return _NAMES[name]


def _extend(target: Any, items: list[Any]) -> None:
    if not isinstance(target, list):
        raise ValueError("no list")
    target += items


def _update(target: Any, items: list[Any]) -> None:
    """Add keys and values, which take turns in `items`."""
    # The hash of a tuple within tuples can take for ever.
    if not isinstance(target, dict) or not all(isinstance(key, str) for key in items[::2]):
        raise ViewnetError("holds a dictionary with other keys than texts, which is not read")
    target.update(zip(items[::2], items[1::2], strict=True))


def _made(function: Any, arguments: Any) -> Any:
    """What a call would give; an array, but for those of protocol 5, still without its elements."""
    match function, arguments:
        case _Name("dtype"), (str(code), 0, 1) if _CODE.fullmatch(code):
            return _Kind(code)
        case _Name("_reconstruct"), (_Name("ndarray"), (0,), b"b"):
            return Array([])
        case _Name("_frombuffer"), (bytes() | bytearray() as data, _Kind() as kind, tuple(shape), "C" | "F" as order):
            return Array(_array(data, kind, shape, order == "F"))
        case _Name("scalar"), (_Kind() as kind, bytes(data)):
            return _array(data, kind, (), False).item()
        case _Name("encode"), (str(text), "latin1"):
            return text.encode("latin1")
        case _Name("bytes"), ():
            return b""
    what = function.name if isinstance(function, _Name) else "something"
    raise ViewnetError(f"holds a call of {what} as NumPy does not write it, which is not read")


def _built(target: Any, state: Any) -> Any:
    """An array or a type of elements, completed."""
    match target, state:
        case _Kind(), (_, "<" | ">" | "|" | "=" as order, None, None, None, _, _, _):
            target.order = order
        case Array(), (1, tuple(shape), _Kind(code="O8" | "O4"), 0 | 1, list(items)):
            if len(items) != _count(shape):
                raise ValueError("shape")
            target.values = items
        case Array(), (1, tuple(shape), _Kind() as kind, 0 | 1 as transposed, bytes(data)):
            target.values = _array(data, kind, shape, transposed)
        case _:
            raise ViewnetError("holds a state as NumPy does not write it, which is not read")
    return target


def _size(arguments: Any) -> int:
    """The bytes and letters that a call gets; none of those read has more than eight arguments."""
    few = arguments if isinstance(arguments, tuple) and len(arguments) <= 8 else ()
    return sum(len(part) for part in few if isinstance(part, (str, bytes, bytearray)))


def _array(data: bytes | bytearray, kind: _Kind, shape: tuple[Any, ...], transposed: bool) -> np.ndarray:
    """An array of numbers or texts over the bytes of a file."""
    dtype = kind.dtype
    if dtype.kind == "O" or len(data) != _count(shape) * dtype.itemsize:
        raise ValueError("size")
    if dtype.kind == "U":
        data.decode("utf-32-be" if kind.order == ">" else "utf-32-le")  # NumPy would take any number for a letter
    return np.frombuffer(data, dtype).reshape(shape, order="F" if transposed else "C")


def _count(shape: tuple[Any, ...]) -> int:
    """The number of elements of an array."""
    if len(shape) > 32 or not all(type(size) is int and 0 <= size <= LARGEST for size in shape):
        raise ValueError("shape")
    return math.prod(shape)
