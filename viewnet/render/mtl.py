"""Wavefront MTL material libraries and their textures.

Nothing outside a model's folder is ever opened: an absolute path, or one that leads out, makes the model unusable.
"""

import math
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath

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


@dataclass
class Entry:
    """The entry of one material in an MTL file, its texture not opened yet."""

    diffuse: tuple[float, float, float] = GREY
    opacity: float | None = None
    transparency: float = 0.0
    texture: Path | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)

    @property
    def shown(self) -> float:
        """Opacity 0..1 from `d` or, without it, `Tr`; 1 where there is neither."""
        return 1.0 - self.transparency if self.opacity is None else self.opacity


def _inside(obj: Path, folder: Path, name: str) -> Path:
    """The file that `name` in an OBJ or MTL means, which must lie in the model's folder."""
    relative = name.replace("\\", "/")
    if "\0" in name or any(len(part.encode("utf-8", "surrogateescape")) > 255 for part in relative.split("/")):
        raise UnusableModel(obj, f"path '{name}' names no file")
    if PurePosixPath(relative).is_absolute() or PureWindowsPath(name).drive:
        raise UnusableModel(obj, f"absolute path '{name}'")
    file = (obj.parent / relative).resolve()
    if not file.is_relative_to(folder.resolve()):
        raise UnusableModel(obj, f"path '{name}' leads out of the model's folder")
    return file


def read_libraries(obj: Path, folder: Path, lines: Iterable[str]) -> dict[str, Entry]:
    """The materials of `mtllib` lines, each of which names one file (perhaps with spaces) or several."""
    files = [file for names in lines for file in _files(obj, folder, names)]
    library: dict[str, Entry] = {}
    # Each file once, however often it is named: the last definition of a material counts.
    for file in reversed(dict.fromkeys(reversed(files))):
        library.update(_read(obj, folder, file))
    return library


def _files(obj: Path, folder: Path, names: str) -> list[Path]:
    if len(names) <= 4096 and (file := _inside(obj, folder, names)).is_file():
        return [file]
    if len(parts := names.split()) < 2:
        raise UnusableModel(obj, f"missing material library '{names}'")
    return [file for part in parts for file in _files(obj, folder, part)]


def _read(obj: Path, folder: Path, file: Path) -> dict[str, Entry]:
    if (size := file.stat().st_size) > MAX_BYTES:
        raise UnusableModel(obj, f"{size} bytes in {file.name}, more than {MAX_BYTES}")
    library: dict[str, Entry] = {}
    entry = Entry()
    for line in file.read_text(encoding="utf-8", errors="surrogateescape").splitlines():
        word, _, rest = line.replace("\t", " ").strip().partition(" ")
        rest = rest.strip()
        try:
            if word == "newmtl":
                entry = library[rest] = Entry()
            elif word == "Kd" and not rest.startswith(("spectral", "xyz")):
                red, green, blue, *_ = (min(max(float(x), 0.0), 1.0) for x in rest.split() * 3)
                if math.isnan(red + green + blue):
                    raise ValueError(rest)
                entry.diffuse = red, green, blue
            elif word == "d":
                entry.opacity = float(rest.removeprefix("-halo"))
            elif word == "Tr":
                entry.transparency = float(rest)
            elif word == "map_Kd":
                entry.scale, entry.offset, name = _texture_options(rest)
                entry.texture = _inside(obj, folder, name) if name else None
        except UnusableModel:
            raise
        except ValueError:
            raise UnusableModel(obj, f"cannot understand '{line.strip()[:60]}' in {file.name}") from None
    return library


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


def read_texture(obj: Path, folder: Path, file: Path) -> np.ndarray:
    """(h, w, 3 or 4) uint8, at most TEXTURE_SIZE a side."""
    name = file.relative_to(folder.resolve())
    if not file.is_file():
        raise UnusableModel(obj, f"missing texture '{name}'")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = image_files.read(file, f"texture '{name}'", FORMATS, enough=TEXTURE_SIZE)
            image.thumbnail((TEXTURE_SIZE, TEXTURE_SIZE), Image.Resampling.BOX)
            return np.array(image)
    except ViewnetError as error:
        raise UnusableModel(obj, f"broken {error}") from None
