"""Wavefront MTL material libraries and their textures.

Nothing outside a model's folder is ever opened: an absolute path, or one that leads out, makes the model unusable.
"""

import codecs
import math
import re
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TypeVar

import numpy as np
from PIL import Image

from viewnet.errors import ViewnetError
from viewnet.render.mesh import GREY, UnusableModel
from viewnet.runtime import image_files

TEXTURE_SIZE = 256  # images are 64 to 224 pixels wide: a larger texture would only alias, and cost memory
FORMATS = (*image_files.FORMATS, "TGA")
MAX_BYTES = 64 * 2**20
MAX_SCALE = 1e6

# Options of a texture without effect here, and how many words follow them.
_OPTIONS = {"-mm": 2} | dict.fromkeys(
    ("-blendu", "-blendv", "-bm", "-boost", "-cc", "-clamp", "-imfchan", "-texres", "-type", "-colorspace"), 1
)
Found = TypeVar("Found")


@dataclass
class Entry:
    """The entry of one material in an MTL file, its texture not opened yet."""

    diffuse: tuple[float, float, float] = GREY
    opacities: dict[str, float] = field(default_factory=dict)  # as `d` and as `Tr` have it
    texture: Path | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)

    @property
    def opacity(self) -> float:
        """Opacity 0..1: where statements contradict each other, that of the one which shows the material."""
        return max(self.opacities.values(), default=1.0)


@dataclass
class Home:
    """An OBJ file, the folder that what it names must lie in, and every file that was looked for."""

    obj: Path
    folder: Path
    asked: dict[Path, None] = field(default_factory=dict)

    def refused(self, reason: str) -> UnusableModel:
        """The error that says why the model cannot be used."""
        return UnusableModel(self.obj, reason)

    def find(self, name: str) -> Path:
        """The file that `name` in an OBJ or MTL means."""
        relative = name.replace("\\", "/")
        if "\0" in name or any(len(part.encode("utf-8", "surrogateescape")) > 255 for part in relative.split("/")):
            raise self.refused(f"path '{name}' names no file")
        if PurePosixPath(relative).is_absolute() or PureWindowsPath(name).drive:
            raise self.refused(f"absolute path '{name}'")
        file = (self.obj.parent / relative).resolve()
        if not file.is_relative_to(self.folder.resolve()):
            raise self.refused(f"path '{name}' leads out of the model's folder")
        self.asked[file] = None
        return file

    def there(self, name: str) -> Path | None:
        """The same if there is such a file."""
        return file if name and (file := self.find(name)).is_file() else None


def named(find: Callable[[str], Found | None], text: str) -> Found | None:
    """What the name that ends a line means: all of `text`, else what stands before a comment, else within quotes."""
    plain = re.split(r"\s#", text)[0].strip()
    found = (find(name) for name in dict.fromkeys((text, plain, plain.strip('"'))))
    return next((each for each in found if each is not None), None)


def unread(file: Path) -> str | None:
    """Why a file is not opened, None for a regular one: a pipe or a device may never end."""
    return None if file.is_file() else "not a regular file" if file.exists() else "no such file"


def read_lines(home: Home, file: Path, most: int) -> bytes:
    """The lines of an OBJ or MTL, as UTF-8: each with its line feed, joined where continued, without marks or tabs.

    Raises UnusableModel for a file that is missing, not regular, cannot be read, or has more than `most` bytes.
    """
    try:
        if reason := unread(file):
            raise home.refused(reason)
        if (size := file.stat().st_size) > most:
            raise home.refused(f"{size} bytes in {file.name}, more than {most}")
        data = file.read_bytes()
    except OSError as error:
        raise home.refused(f"{file.name} cannot be read ({error.strerror})") from None
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16", "replace").encode()
    data = data.removeprefix(codecs.BOM_UTF8) + b"\n"
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    data = data.replace(b"\t", b" ").replace(b"\v", b" ").replace(b"\f", b" ")
    if b"\\" in data:
        data = re.sub(rb"#[^\n]*\\ *\n", b"\n", data)  # a comment ends with its line
        data = re.sub(rb"\\ *\n", b" ", data)
    return data


def read_libraries(home: Home, lines: Iterable[str]) -> dict[str, Entry]:
    """The materials of `mtllib` lines, each of which names one file (perhaps with spaces) or several."""
    files = [file for names in dict.fromkeys(lines) for file in _files(home, names)]
    library: dict[str, Entry] = {}
    # Each file once, however often it is named: the last definition of a material counts.
    for file in reversed(dict.fromkeys(reversed(files))):
        library.update(_read(home, file))
    return library


def _files(home: Home, names: str) -> list[Path]:
    if len(names) <= 4096 and (file := named(home.there, names)):
        return [file]
    if len(parts := names.split(" #")[0].split()) < 2:
        raise home.refused(f"missing material library '{names}'")
    return [file for part in parts for file in _files(home, part)]


def _read(home: Home, file: Path) -> dict[str, Entry]:
    library: dict[str, Entry] = {}
    entry = Entry()
    for line in read_lines(home, file, MAX_BYTES).decode("utf-8", errors="surrogateescape").split("\n"):
        word, _, rest = (part.strip() for part in line.strip().partition(" "))
        word, values = word.lower(), rest.split("#")[0].split()
        try:
            if word == "newmtl":
                entry = library[rest] = Entry()
            elif word == "kd" and values[:1] not in (["spectral"], ["xyz"]):
                red, green, blue, *_ = (min(max(float(x), 0.0), 1.0) for x in values * 3)
                if math.isnan(red + green + blue):
                    raise ValueError(rest)
                entry.diffuse = red, green, blue
            elif word in ("d", "tr"):
                value = float(next(value for value in values if value != "-halo"))
                entry.opacities[word] = 1 - value if word == "tr" else value
            elif word == "map_kd":
                entry.scale, entry.offset, name = _texture_options(rest)
                entry.texture = (named(home.there, name) or home.find(name)) if name else None
        except UnusableModel:
            raise
        except (ValueError, StopIteration):
            raise home.refused(f"cannot understand '{line.strip()[:60]}' in {file.name}") from None
    # What follows a # may be a comment or part of a name.
    return {re.split(r"\s#", name)[0].strip(): entry for name, entry in reversed(library.items())} | library


def _texture_options(rest: str) -> tuple[tuple[float, float], tuple[float, float], str]:
    """Scale, offset and file name of a `map_Kd` line; its other options have no effect here."""
    values = {"-s": (1.0, 1.0), "-o": (0.0, 0.0), "-t": (0.0, 0.0)}
    if len(rest) > 4096:  # no path is longer
        raise ValueError(rest)
    while match := re.match(r"(-[a-z]+)\s+", rest):
        option = match[1]
        if option in values:
            match = re.match(r"-[a-z]\s+((?:[-+]?[\d.]+(?:[eE][-+]?\d+)?(?:\s+|$)){1,3})", rest)
            numbers = [float(x) for x in match[1].split()] if match else []
            if match is None or max(map(abs, numbers)) > MAX_SCALE:
                raise ValueError(rest)
            u, v, *_ = *numbers, 1.0 if option == "-s" else 0.0
            values[option] = u, v
            rest = rest[match.end() :]
        elif option in _OPTIONS:
            rest = re.split(r"\s+", rest, maxsplit=1 + _OPTIONS[option])[-1]
        else:
            break
    return values["-s"], values["-o"], rest.strip()


def read_texture(home: Home, file: Path) -> np.ndarray:
    """(h, w, 3 or 4) uint8, at most TEXTURE_SIZE a side."""
    name = file.relative_to(home.folder.resolve())
    if not file.is_file():
        raise home.refused(f"missing texture '{name}'")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = image_files.read(file, f"texture '{name}'", FORMATS, enough=TEXTURE_SIZE)
            image.thumbnail((TEXTURE_SIZE, TEXTURE_SIZE), Image.Resampling.BOX)
            return np.array(image)
    except ViewnetError as error:
        raise home.refused(f"broken {error}") from None
