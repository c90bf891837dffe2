"""Triangle meshes with materials, and the Wavefront OBJ/MTL reader that fills them.

The reader covers what CAD collections hold: polygons, every index form (`v`, `v/t`, `v//n`, `v/t/n`, negative), several
materials and libraries, vertex colours, texture options and texture names with spaces. It exists because a general loader
spends several times longer on a model than the ray caster does, and drops the opacity (`d`, `Tr`) that decides what is seen.

Taken literally nothing outside a model's own folder is ever opened: a library or texture path that is absolute or leads out
of the folder makes the model unusable.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
from PIL import Image

from viewnet.errors import ViewnetError

MAX_BYTES = 512 * 2**20
MAX_FACES = 2_000_000
# Pictures are 64 to 224 pixels wide: a larger texture would only alias, and cost memory.
TEXTURE_SIZE = 256
MAX_TEXTURE_PIXELS = 2**26
# What a face without a (defined) material looks like.
GREY = (0.8, 0.8, 0.8)
# Faces less opaque than this are not drawn; the others are drawn opaque.
MIN_OPACITY = 0.05

_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2, "-texres": 1,
    "-type": 1, "-colorspace": 1,
}  # fmt: skip


class UnusableModel(ViewnetError):
    """A CAD model that cannot be rendered; `reason` says why in a few words, `path` which file."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path, self.reason = path, reason

    def __reduce__(self) -> tuple[type, tuple[Path, str]]:
        return type(self), (self.path, self.reason)


@dataclass(frozen=True)
class Material:
    """Diffuse colour (3,) in 0..1, opacity 0..1 and, where given, a texture (h, w, 3 or 4) uint8 with its first row on top.

    A texture replaces the diffuse colour (exporters often write it black beside a texture).
    """

    name: str = ""
    diffuse: tuple[float, float, float] = GREY
    opacity: float = 1.0
    texture: np.ndarray | None = None


@dataclass(frozen=True)
class Mesh:
    """Triangles: vertices (V, 3) float64, faces (F, 3) int32, material (F,) int32 into `materials`.

    `uv` (F, 3, 2) float32 are the texture coordinates of each face's corners (origin at the lower left, repeating) or None;
    `colours` (V, 3) float32 in 0..1 are vertex colours or None, which count only on faces without a material of their own
    (material 0).
    """

    vertices: np.ndarray
    faces: np.ndarray
    material: np.ndarray
    materials: tuple[Material, ...]
    uv: np.ndarray | None = None
    colours: np.ndarray | None = None


@dataclass
class _Entry:
    """What an MTL file says of one material before its texture is opened."""

    diffuse: tuple[float, float, float] = GREY
    opacity: float | None = None
    transparency: float | None = None
    texture: Path | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


def read_obj(path: Path, folder: Path | None = None) -> Mesh:
    """The visible faces of an OBJ file as it stands (no change of frame or scale).

    Polygons are cut as fans; faces of no area and faces that are (almost) wholly transparent are left out; normals in the
    file are not used. `folder` (default: the file's own) is the one that libraries and textures must lie in.
    Raises UnusableModel with the reason.
    """
    folder = path.parent if folder is None else folder
    data = _read(path)
    if b"\\" in data:
        data = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    positions: list[bytes] = []
    coordinates: list[bytes] = []
    polygons: list[bytes] = []
    uses: list[tuple[int, str]] = []
    libraries: list[str] = []
    lines = data.replace(b"\t", b" ").splitlines()
    for line in lines:
        key = line[:2]
        if key == b"v ":
            positions.append(line[2:])
        elif key == b"f ":
            polygons.append(line[2:])
        elif key == b"vt":
            coordinates.append(line[3:])
        elif key in (b"us", b"mt") or key[:1] == b" ":
            word, _, rest = line.strip().partition(b" ")
            if word == b"usemtl":
                uses.append((len(polygons), _text(rest)))
            elif word == b"mtllib":
                libraries.append(_text(rest))
            elif key[:1] == b" " and word in (b"v", b"f", b"vt"):
                {b"v": positions, b"f": polygons, b"vt": coordinates}[word].append(rest)
    if not polygons:
        raise UnusableModel(path, "no faces")
    if len(polygons) > MAX_FACES:
        raise UnusableModel(path, f"{len(polygons)} faces, more than {MAX_FACES}")

    values, counts = _numbers(path, positions, "v")
    if len(counts) == 0:
        raise UnusableModel(path, "no vertices")
    if counts.min() == counts.max() and counts[0] >= 3:
        table = values.reshape(len(counts), -1)
    elif counts.min() >= 3:
        table = values[(np.cumsum(counts) - counts)[:, None] + np.arange(3)]
    else:
        raise UnusableModel(path, "a vertex with fewer than three coordinates")
    vertices = table[:, :3]
    if not np.isfinite(vertices).all():
        raise UnusableModel(path, "a vertex is NaN or infinite")
    colours = table[:, 3:6].astype(np.float32) if table.shape[1] in (6, 7) else None
    corner_v, corner_t, sizes = _corners(path, lines, polygons, len(vertices), len(coordinates))

    library: dict[str, _Entry] = {}
    for name in libraries:
        library.update(_read_library(path, folder, name))
    names, polygon_material = _assign(uses, len(polygons))
    corners, owner = _fans(path, sizes)
    faces = corner_v[corners]
    material = polygon_material[owner]

    edge = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
    keep = np.abs(np.cross(edge[:, 0], edge[:, 1])).max(axis=1) > 0
    opacity = np.array([1.0, *(_opacity(library.get(name)) for name in names)])
    if (visible := keep & (opacity[material] >= MIN_OPACITY)).any():
        # Some exporters write opacity where transparency belongs, so a file that hides everything means the opposite.
        keep = visible
    if not keep.any():
        raise UnusableModel(path, "no face has an area")
    faces, material, corners = faces[keep], material[keep], corners[keep]

    materials, uv = [Material()], None
    used = np.bincount(material, minlength=len(names) + 1) > 0
    if coordinates and any(used[i + 1] and _textured(library.get(n)) for i, n in enumerate(names)):
        uv = _uv(path, coordinates, corner_t[corners])
    for number, name in enumerate(names, start=1):
        entry = library.get(name)
        if entry is None or not used[number]:
            materials.append(Material(name))
            continue
        texture = None
        if uv is not None and entry.texture is not None:
            texture = _read_texture(path, folder, entry.texture)
            mine = material == number
            if entry.scale != (1.0, 1.0) or entry.offset != (0.0, 0.0):
                uv[mine] = uv[mine] * np.float32(entry.scale) + np.float32(entry.offset)
        materials.append(Material(name, entry.diffuse, _opacity(entry), texture))
    return Mesh(vertices, faces.astype(np.int32), material.astype(np.int32), tuple(materials), uv, colours)


def _read(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise UnusableModel(path, f"{size} bytes, more than {MAX_BYTES}")
        data = path.read_bytes()
    except FileNotFoundError:
        raise UnusableModel(path, "no such file") from None
    except OSError as error:
        raise UnusableModel(path, f"cannot be read ({error.strerror})") from None
    if not data.strip():
        raise UnusableModel(path, "empty file")
    return data


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", errors="surrogateescape").strip()


def _numbers(path: Path, lines: list[bytes], what: str, dtype: type = np.float64) -> tuple[np.ndarray, np.ndarray]:
    """All numbers of `lines` in one array, and how many each line has."""
    if not lines:
        return np.zeros(0, dtype), np.zeros(0, np.int64)
    text = b"\n".join(lines)
    if b"#" in text:
        text = b"\n".join(line.partition(b"#")[0] for line in lines)
    counts, _ = _words(text)
    with warnings.catch_warnings():
        # NumPy only warns where it stops at something that is not a number; the count then tells.
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            values = np.fromstring(text, dtype, sep=" ")
        except ValueError:
            values = np.zeros(0, dtype)
    if len(values) != counts.sum():
        raise UnusableModel(path, f"a '{what}' line holds something that is not a number")
    return values, counts


def _words(text: bytes) -> tuple[np.ndarray, np.ndarray]:
    """The number of words on each line of `text`, and where each line ends."""
    characters = np.frombuffer(text, np.uint8)
    space = characters <= 32
    ends = np.append(np.flatnonzero(characters == 10), len(text))
    starts = ~space
    starts[1:] &= space[:-1]
    return np.diff(np.searchsorted(np.flatnonzero(starts), ends), prepend=0), ends


def _corners(
    path: Path, lines: list[bytes], polygons: list[bytes], vertices: int, coordinates: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """0-based vertex and texture indices of all corners (-1: no texture coordinate), and each polygon's corner count.

    Polygons may differ in form (`v`, `v/t`, `v//n`, `v/t/n`); the corners of one may not.
    """
    text = b"\n".join(polygons)
    if b"-" in text or b"#" in text:
        text = b"\n".join(_absolute(path, lines))
    sizes, ends = _words(text)
    characters = np.frombuffer(text, np.uint8)
    slash = characters == 47
    slashes = np.diff(np.searchsorted(np.flatnonzero(slash), ends), prepend=0)
    doubles = np.diff(np.searchsorted(np.flatnonzero(slash[1:] & slash[:-1]) + 1, ends), prepend=0)
    values, counts = _numbers(path, text.replace(b"/", b" ").split(b"\n"), "f", np.int64)
    width = np.select(
        [slashes == 0, (slashes == sizes) & (doubles == 0), (slashes == 2 * sizes) & (doubles == 0)],
        [1, 2, 3],
        default=2 * ((slashes == 2 * sizes) & (doubles == sizes)),
    )
    if (width * sizes != counts).any():
        raise UnusableModel(path, f"cannot understand the face 'f {_text(text.splitlines()[np.argmax(width * sizes != counts)])}'")
    step = np.repeat(width, sizes)
    at = np.cumsum(step) - step
    v = values[at] - 1
    textured = np.repeat((slashes > 0) & (doubles == 0), sizes)
    t = np.full(len(v), -1)
    t[textured] = values[at[textured] + 1] - 1
    if v.min() < 0 or v.max() >= vertices:
        raise UnusableModel(path, f"a face refers to vertex {(v.max() if v.min() >= 0 else v.min()) + 1} of {vertices}")
    if t.max() >= coordinates or (t[textured] < 0).any():
        raise UnusableModel(path, f"a face refers to a texture coordinate that is not among the {coordinates}")
    return v, t, sizes


def _absolute(path: Path, lines: list[bytes]) -> list[bytes]:
    """The face lines with negative (relative) indices made positive and comments taken out."""
    seen = {b"v": 0, b"vt": 0, b"vn": 0}
    kinds = (b"v", b"vt", b"vn")
    result = []
    for line in lines:
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        if words[0] in seen:
            seen[words[0]] += 1
        elif words[0] == b"f":
            corners = []
            for word in words[1:]:
                try:
                    parts = [
                        p if not p.startswith(b"-") else b"%d" % (seen[kind] + 1 + int(p))
                        for p, kind in zip(word.split(b"/"), kinds, strict=False)
                    ]
                except ValueError:
                    raise UnusableModel(path, "a 'f' line holds something that is not a number") from None
                corners.append(b"/".join(parts))
            result.append(b" ".join(corners))
    return result


def _fans(path: Path, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner numbers (F, 3) of the triangles of polygons with `sizes` corners, and the polygon each belongs to."""
    first = np.cumsum(sizes) - sizes
    triangles = np.maximum(sizes - 2, 0)
    count = int(triangles.sum())
    if count == 0:
        raise UnusableModel(path, "no faces")
    if count > MAX_FACES:
        raise UnusableModel(path, f"{count} faces, more than {MAX_FACES}")
    owner = np.repeat(np.arange(len(sizes)), triangles)
    step = np.arange(count) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    start = first[owner]
    return np.stack([start, start + step + 1, start + step + 2], axis=1), owner


def _assign(uses: list[tuple[int, str]], polygons: int) -> tuple[list[str], np.ndarray]:
    """Names of the materials in order of use, and each polygon's number: 0 for none, i + 1 for names[i]."""
    numbers: dict[str, int] = {}
    material = np.zeros(polygons, np.int64)
    for (start, name), (end, _) in zip(uses, [*uses[1:], (polygons, "")], strict=True):
        if end > start:
            material[start:end] = numbers.setdefault(name, len(numbers) + 1)
    return list(numbers), material


def _uv(path: Path, lines: list[bytes], corners: np.ndarray) -> np.ndarray:
    values, counts = _numbers(path, lines, "vt")
    if counts.min() < 2:
        raise UnusableModel(path, "a texture coordinate with fewer than two numbers")
    table = values[(np.cumsum(counts) - counts)[:, None] + np.arange(2)]
    if not np.isfinite(table).all():
        raise UnusableModel(path, "a texture coordinate is NaN or infinite")
    # The last row serves index -1, a corner without coordinates.
    return np.concatenate([table, np.zeros((1, 2))]).astype(np.float32)[corners]


def _opacity(entry: _Entry | None) -> float:
    if entry is None:
        return 1.0
    if entry.opacity is not None:
        return entry.opacity
    return 1.0 - entry.transparency if entry.transparency is not None else 1.0


def _textured(entry: _Entry | None) -> bool:
    return entry is not None and entry.texture is not None


def _inside(obj: Path, folder: Path, name: str) -> Path:
    """The file that `name` in an OBJ or MTL means, which must lie in the model's folder."""
    relative = name.replace("\\", "/")
    if PurePosixPath(relative).is_absolute() or PureWindowsPath(name).drive:
        raise UnusableModel(obj, f"absolute path '{name}'")
    file = (obj.parent / relative).resolve()
    if not file.is_relative_to(folder.resolve()):
        raise UnusableModel(obj, f"path '{name}' leads out of the model's folder")
    return file


def _read_library(obj: Path, folder: Path, names: str) -> dict[str, _Entry]:
    """The materials of a `mtllib` line, which names one file (perhaps with spaces) or several."""
    file = _inside(obj, folder, names)
    if not file.is_file():
        parts = names.split()
        if len(parts) > 1:
            return {k: v for part in parts for k, v in _read_library(obj, folder, part).items()}
        raise UnusableModel(obj, f"missing material library '{names}'")
    library: dict[str, _Entry] = {}
    entry = _Entry()
    for raw in file.read_bytes().splitlines():
        word, _, rest = _text(raw).replace("\t", " ").partition(" ")
        rest = rest.strip()
        try:
            if word == "newmtl":
                entry = library[rest] = _Entry()
            elif word == "Kd" and not rest.startswith(("spectral", "xyz")):
                numbers = [min(max(float(x), 0.0), 1.0) for x in rest.split()]
                entry.diffuse = (numbers[0], numbers[1], numbers[2]) if len(numbers) >= 3 else (numbers[0],) * 3
            elif word == "d":
                entry.opacity = float(rest.removeprefix("-halo"))
            elif word == "Tr":
                entry.transparency = float(rest)
            elif word == "map_Kd":
                entry.scale, entry.offset, name = _texture_options(rest)
                entry.texture = _inside(obj, folder, name) if name else None
        except (ValueError, IndexError) as error:
            if isinstance(error, UnusableModel):
                raise
            raise UnusableModel(obj, f"cannot understand '{_text(raw)}' in {file.name}") from None
    return library


def _texture_options(rest: str) -> tuple[tuple[float, float], tuple[float, float], str]:
    """Scale, offset and file name of a `map_Kd` line; the other options do not change what we draw."""
    scale, offset = (1.0, 1.0), (0.0, 0.0)
    while match := re.match(r"(-[a-z]+)\s+", rest):
        option = match.group(1)
        if option in ("-s", "-o", "-t"):
            found = re.match(r"-[a-z]\s+((?:[-+]?[\d.]+(?:[eE][-+]?\d+)?(?:\s+|$)){1,3})", rest)
            if found is None:
                raise ValueError(rest)
            numbers = [float(x) for x in found.group(1).split()]
            u, v = numbers[0], numbers[1] if len(numbers) > 1 else (1.0 if option == "-s" else 0.0)
            if option == "-s":
                scale = (u, v)
            elif option == "-o":
                offset = (u, v)
            rest = rest[found.end() :]
        elif option in _OPTIONS:
            rest = re.split(r"\s+", rest, maxsplit=1 + _OPTIONS[option])[-1]
        else:
            break
    return scale, offset, rest.strip()


def _read_texture(obj: Path, folder: Path, file: Path) -> np.ndarray:
    """(h, w, 3 or 4) uint8, at most TEXTURE_SIZE a side."""
    name = file.relative_to(folder.resolve())
    if not file.is_file():
        raise UnusableModel(obj, f"missing texture '{name}'")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(file) as picture:
                if picture.width * picture.height > MAX_TEXTURE_PIXELS:
                    raise UnusableModel(obj, f"texture '{name}' has more than {MAX_TEXTURE_PIXELS} pixels")
                picture.draft("RGB", (TEXTURE_SIZE, TEXTURE_SIZE))
                alpha = "A" in picture.getbands() or "transparency" in picture.info
                picture = picture.convert("RGBA" if alpha else "RGB")
                picture.thumbnail((TEXTURE_SIZE, TEXTURE_SIZE), Image.Resampling.BOX)
                return np.array(picture)
    except UnusableModel:
        raise
    except Exception as error:  # Pillow's decoders raise errors of many types on broken files.
        raise UnusableModel(obj, f"broken texture '{name}' ({type(error).__name__})") from None
