"""Wavefront OBJ files as triangle meshes: all that CAD collections hold, read by array operations.

trimesh, in contrast, ignores missing libraries and textures, opacity and texture options, and is slower.
"""

import re
import warnings
from pathlib import Path

import numpy as np

from viewnet.render.mesh import Material, Mesh, UnusableModel
from viewnet.render.mtl import Entry, read_libraries, read_texture

MAX_BYTES = 512 * 2**20
MAX_FACES = 2_000_000
MAX_TEXTURED = 1000
MAX_COLOUR = 65536.0  # of a vertex, as exporters write it: 0 to 1, or to 255 or 65535
MAX_UV = 1e30  # of a texture coordinate: times a texture's scale it is still finite in single precision
MIN_OPACITY = 0.05  # faces less opaque than this are left out; the others are rendered opaque


def read_obj(path: Path, folder: Path | None = None) -> Mesh:
    """The visible faces of an OBJ file as it stands (no change of frame or scale), polygons triangulated as fans.

    Faces without area and (almost) transparent ones are left out; faces without a defined material are light grey.
    Libraries and textures must lie in `folder` (default: the file's own). Raises UnusableModel with the reason: a file
    that is missing, empty or unreadable, no faces, NaN or infinite vertices, a broken or missing library or texture, a
    path that leads out of the folder, more than MAX_FACES faces or MAX_BYTES bytes.
    """
    folder = path.parent if folder is None else folder
    lines = _Lines(path)
    values, counts = lines.numbers("v", lines.text("v"))
    if len(counts) == 0:
        raise UnusableModel(path, "no vertices")
    if counts.min() < 3:
        raise UnusableModel(path, "a vertex with fewer than three coordinates")
    vertices = values[(np.cumsum(counts) - counts)[:, None] + np.arange(3)]
    if not np.isfinite(vertices).all():
        raise UnusableModel(path, "a vertex is NaN or infinite")
    coloured = counts.min() == counts.max() and counts[0] in (6, 7)
    colours = values.reshape(len(counts), -1)[:, 3:6] if coloured else None
    if colours is not None and not (np.abs(colours) <= MAX_COLOUR).all():
        raise UnusableModel(path, "a vertex's colour is out of range")

    corner_v, corner_t, sizes = _corners(lines, len(vertices))
    corners, owner = _fans(path, sizes)
    names, polygon_material = _assign(lines.words("usemtl"), len(sizes))
    library = read_libraries(path, folder, dict.fromkeys(name for _, name in lines.words("mtllib")))
    faces, material = corner_v[corners], polygon_material[owner]

    edge, other = (vertices[faces[:, i]] - vertices[faces[:, 0]] for i in (1, 2))
    with np.errstate(over="ignore", invalid="ignore"):  # the normalisation of the mesh rejects what is too large
        keep = (np.cross(edge, other) != 0).any(axis=1)
    opacity = np.array([1.0, *(library[name].shown if name in library else 1.0 for name in names)])
    if (visible := keep & (opacity >= MIN_OPACITY)[material]).any():
        # Some exporters write opacity for transparency, so a file that hides everything means the opposite.
        keep = visible
    if not keep.any():
        raise UnusableModel(path, "no face has an area")
    faces, material, corners = faces[keep], material[keep], corners[keep]
    materials, uv = _materials(lines, folder, names, library, material, corner_t[corners])
    shades = None if colours is None else colours.astype(np.float32)
    return Mesh(vertices, faces.astype(np.int32), material.astype(np.int32), materials, uv, shades)


class _Lines:
    """The lines of an OBJ file by keyword."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if (size := path.stat().st_size) > MAX_BYTES:
                raise UnusableModel(path, f"{size} bytes, more than {MAX_BYTES}")
            data = path.read_bytes()
        except FileNotFoundError:
            raise UnusableModel(path, "no such file") from None
        except OSError as error:
            raise UnusableModel(path, f"cannot be read ({error.strerror})") from None
        if not data.strip():
            raise UnusableModel(path, "empty file")
        data = re.sub(rb"\\\r?\n", b" ", data).replace(b"\r", b"\n").replace(b"\t", b" ")
        if b"\n " in data or data.startswith(b" "):
            data = re.sub(rb"(?m)^ +", b"", data)
        self.data = data + b"\n"
        self.characters = np.frombuffer(self.data, np.uint8)
        self.ends = np.flatnonzero(self.characters == 10) + 1
        self.starts = np.append(0, self.ends[:-1])
        second = np.minimum(self.starts + 1, len(self.characters) - 1)
        self.key = self.characters[self.starts].astype(np.int32) << 8 | self.characters[second]

    def of(self, keyword: str) -> np.ndarray:
        """(lines,) bool: which lines begin with `keyword` of one or two letters."""
        return self.key == int.from_bytes(keyword.ljust(2).encode(), "big")

    def text(self, keyword: str) -> bytes:
        """The lines with this keyword, without it and without comments; each ends in a line feed."""
        mine = self.of(keyword)
        characters = self.characters.copy()
        characters[self.starts[mine][:, None] + np.arange(len(keyword))] = 32
        text = characters[np.repeat(mine, self.ends - self.starts)].tobytes()
        return re.sub(rb"#[^\n]*", b"", text) if b"#" in text else text

    def numbers(self, keyword: str, text: bytes, dtype: type = np.float64) -> tuple[np.ndarray, np.ndarray]:
        """All numbers of the `text` of the lines with this keyword in one array, and how many each line has."""
        counts, _ = _word_counts(text)
        with warnings.catch_warnings():
            # NumPy only warns and stops at something that is not a number; the count is then wrong.
            warnings.simplefilter("ignore", DeprecationWarning)
            try:
                values: np.ndarray = np.fromstring(text, dtype, sep=" ")
            except ValueError:
                values = np.zeros(0, dtype)
        if len(values) != counts.sum():
            raise UnusableModel(self.path, f"a '{keyword}' line holds something that is not a number")
        return values, counts

    def words(self, keyword: str) -> list[tuple[int, str]]:
        """What follows a longer keyword on each of its lines, and how many faces stand before it."""
        lines = np.flatnonzero(self.of(keyword[:2]))
        before = np.cumsum(self.of("f"))[lines]
        words = []
        for line, faces in zip(lines, before, strict=True):
            word, _, rest = self.data[self.starts[line] : self.ends[line]].partition(b" ")
            if word == keyword.encode():
                words.append((int(faces), rest.decode("utf-8", errors="surrogateescape").strip()))
        return words


def _word_counts(text: bytes) -> tuple[np.ndarray, np.ndarray]:
    """The number of words on each line of `text`, and the position of each line's end."""
    characters = np.frombuffer(text, np.uint8)
    inside = characters > 32
    first = inside.copy()
    first[1:] &= ~inside[:-1]
    ends = np.flatnonzero(characters == 10)
    return _per_line(first, ends), ends


def _per_line(marks: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """How many of the marked characters each line has."""
    return np.diff(np.searchsorted(np.flatnonzero(marks), ends), prepend=0)


def _corners(lines: _Lines, vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """0-based vertex and texture indices of all corners (-1: no texture coordinate), and each polygon's corner count.

    Polygons may differ in form (`v`, `v/t`, `v//n`, `v/t/n`); the corners of one may not.
    """
    path, text = lines.path, lines.text("f")
    if not text:
        raise UnusableModel(path, "no faces")
    sizes, ends = _word_counts(text)
    if len(sizes) > MAX_FACES:
        raise UnusableModel(path, f"{len(sizes)} faces, more than {MAX_FACES}")
    slash = np.frombuffer(text, np.uint8) == 47
    slashes = _per_line(slash, ends)
    doubles = _per_line(np.append(False, slash[1:] & slash[:-1]), ends)
    values, counts = lines.numbers("f", text.replace(b"/", b" "), np.int64)
    width = np.select(
        [slashes == 0, (slashes == sizes) & (doubles == 0), (slashes == 2 * sizes) & (doubles == 0)],
        [1, 2, 3],
        default=2 * ((slashes == 2 * sizes) & (doubles == sizes)),
    )
    if (wrong := width * sizes != counts).any():
        face = text.splitlines()[int(wrong.argmax())].decode().strip()
        raise UnusableModel(path, f"cannot understand the face '{face}'")
    step = np.repeat(width, sizes)
    at = np.cumsum(step) - step
    textured = np.repeat((slashes > 0) & (doubles == 0), sizes)
    v, t, faces = values[at], values[at[textured] + 1], lines.of("f")
    if v.min(initial=0) < 0:
        v = np.where(v < 0, v + 1 + np.repeat(np.cumsum(lines.of("v"))[faces], sizes), v)
    if t.min(initial=0) < 0:
        t = np.where(t < 0, t + 1 + np.repeat(np.cumsum(lines.of("vt"))[faces], sizes)[textured], t)
    if (wrong := (v < 1) | (v > vertices)).any():
        raise UnusableModel(path, f"a face refers to vertex {v[wrong.argmax()]} of {vertices}")
    coordinates = int(lines.of("vt").sum())
    if (wrong := (t < 1) | (t > coordinates)).any():
        raise UnusableModel(path, f"a face refers to texture coordinate {t[wrong.argmax()]} of {coordinates}")
    every_t = np.full(len(v), -1)
    every_t[textured] = t - 1
    return v - 1, every_t, sizes


def _fans(path: Path, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner numbers (F, 3) of the triangles of polygons with `sizes` corners, and the polygon each belongs to."""
    triangles = np.maximum(sizes - 2, 0)
    if (count := int(triangles.sum())) == 0:
        raise UnusableModel(path, "no faces")
    if count > MAX_FACES:
        raise UnusableModel(path, f"{count} faces, more than {MAX_FACES}")
    owner = np.repeat(np.arange(len(sizes)), triangles)
    step = np.arange(count) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    start = (np.cumsum(sizes) - sizes)[owner]
    return np.stack([start, start + step + 1, start + step + 2], axis=1), owner


def _assign(uses: list[tuple[int, str]], polygons: int) -> tuple[list[str], np.ndarray]:
    """Names of the materials in order of use, and each polygon's number: 0 for none, i + 1 for names[i]."""
    numbers: dict[str, int] = {}
    material = np.zeros(polygons, np.int64)
    ends = [*(start for start, _ in uses[1:]), polygons]
    for (start, name), end in zip(uses, ends, strict=False):
        if end > start:
            material[start:end] = numbers.setdefault(name, len(numbers) + 1)
    return list(numbers), material


def _materials(
    lines: _Lines, folder: Path, names: list[str], library: dict[str, Entry], material: np.ndarray, corners: np.ndarray
) -> tuple[tuple[Material, ...], np.ndarray | None]:
    """Material 0 (none) and those of `names` with the textures that faces use, and (F, 3, 2) coordinates if any do."""
    used = np.bincount(material, minlength=len(names) + 1) > 0
    textured = {
        number: entry.texture
        for number, name in enumerate(names, start=1)
        if used[number] and (entry := library.get(name)) and entry.texture and (corners[material == number] >= 0).any()
    }
    if len(textured) > MAX_TEXTURED:
        raise UnusableModel(lines.path, f"{len(textured)} materials with textures, more than {MAX_TEXTURED}")
    images: dict[Path, np.ndarray] = {}
    uv = _uv(lines, corners) if textured else None
    materials = [Material()]
    for number, name in enumerate(names, start=1):
        entry, texture = library.get(name, Entry()) if used[number] else Entry(), None
        if uv is not None and number in textured:
            file = textured[number]
            texture = images[file] = images[file] if file in images else read_texture(lines.path, folder, file)
            if entry.scale != (1.0, 1.0) or entry.offset != (0.0, 0.0):
                mine = material == number
                uv[mine] = uv[mine] * np.array(entry.scale) + np.array(entry.offset)
        materials.append(Material(name, entry.diffuse, entry.shown, texture))
    return tuple(materials), uv


def _uv(lines: _Lines, corners: np.ndarray) -> np.ndarray:
    values, counts = lines.numbers("vt", lines.text("vt"))
    if counts.min() < 2:
        raise UnusableModel(lines.path, "a texture coordinate with fewer than two numbers")
    table = values[(np.cumsum(counts) - counts)[:, None] + np.arange(2)]
    if not (np.abs(table) <= MAX_UV).all():
        raise UnusableModel(lines.path, "a texture coordinate is NaN or infinite")
    # The last row is for index -1, a corner without coordinates.
    return np.concatenate([table, np.zeros((1, 2))]).astype(np.float32)[corners]
