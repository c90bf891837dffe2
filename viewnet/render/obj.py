"""Wavefront OBJ files as triangle meshes: all that CAD collections hold, read by array operations.

`benchmarks/obj_readers.py` compares it with trimesh and tinyobjloader (docs/decisions.md has the counts).
"""

import contextlib
import re
import warnings
from pathlib import Path

import numpy as np

from viewnet.render.mesh import Material, Mesh, UnusableModel
from viewnet.render.mtl import Entry, Home, named, read_libraries, read_lines, read_texture
from viewnet.render.polygons import triangles

MAX_BYTES = 512 * 2**20
MAX_FACES = 2_000_000
MAX_TEXTURED = 1000
_CORNER = re.compile(rb"[^/]+(/[^/]*){0,2}")
COLOUR_RANGES = ((2.0, 1.0), (255.0, 255.0), (65535.0, 65535.0))
"""Up to which largest value colours of vertices have which range; rounding leaves a little more than 1."""
MIN_OPACITY = 0.05  # faces less opaque than this are left out; the others are rendered opaque
MAX_UV = 1e30  # of a texture coordinate: times a texture's scale it is still finite in single precision


def read_obj(path: Path, folder: Path | None = None) -> Mesh:
    """The visible faces of an OBJ file as it stands (no change of frame or scale), polygons as triangles.

    Faces without area and invisible ones are left out (see `_hidden`); those without a defined material are light grey.
    Libraries and textures must lie in `folder` (default: the file's own). Raises UnusableModel with the reason: a file
    that is missing, empty or unreadable, no faces, a line that cannot be understood, a broken or missing library or
    texture, a path that leads out of the folder, more than MAX_FACES faces or MAX_BYTES bytes.
    """
    home = Home(path, folder or path.parent)
    lines = _Lines(home)
    values = lines.table("v", least=3, most=6)
    vertices = values[:, :3]
    corner_v, corner_t, sizes = _corners(lines, len(vertices))
    corners, owner = triangles(vertices, corner_v, sizes)
    if not len(corners):
        raise home.refused("no faces")
    library = read_libraries(home, [name for _, name in lines.words("mtllib")])
    begins, uses = zip((0, ""), *lines.words("usemtl"), strict=True)
    numbers = {name: number for number, name in enumerate(dict.fromkeys(uses))}  # 0: no material
    entries = [named(library.get, name) or Entry() for name in numbers]
    polygon_material = np.repeat([numbers[name] for name in uses], np.diff(begins, append=len(sizes)))
    faces, material = corner_v[corners], polygon_material[owner]

    edge, other = (vertices[faces[:, i]] - vertices[faces[:, 0]] for i in (1, 2))
    with np.errstate(over="ignore", invalid="ignore"):  # the normalisation of the mesh rejects what is too large
        keep = (np.cross(edge, other) != 0).any(axis=1)
    if not keep.any():
        raise home.refused("no face has an area")
    keep[keep] = ~_hidden(entries, material[keep])
    faces, material, corners = faces[keep], material[keep], corners[keep]
    colours = _colours(lines, values[:, 3:], entries, faces, material)
    materials, uv = _materials(lines, list(numbers), entries, material, corner_t[corners])
    return Mesh(vertices, faces.astype(np.int32), material.astype(np.int32), materials, uv, colours)


def files_of(path: Path, folder: Path) -> list[Path]:
    """Every file that `read_obj` opens or looks for, there or not: the OBJ, its libraries, the textures these name."""
    home = Home(path, folder)
    with contextlib.suppress(UnusableModel):  # what was asked for until then decided that the model is unusable
        read_libraries(home, [name for _, name in _Lines(home).words("mtllib")])
    return [path, *home.asked]


class _Lines:
    """The lines of an OBJ file by keyword."""

    def __init__(self, home: Home) -> None:
        self.home = home
        self.data = read_lines(home, home.obj, MAX_BYTES)
        if self.data.isspace():
            raise home.refused("empty file")
        self.characters, self.starts, self.ends = _split(self.data)
        if (self.characters[self.starts] == 32).any():
            self.data = re.sub(rb"(?m)^ +", b"", self.data)
            self.characters, self.starts, self.ends = _split(self.data)
        second = self.characters[np.minimum(self.starts + 1, len(self.characters) - 1)]
        second = np.where(second <= 32, 32, second | 32)
        self.key = (self.characters[self.starts] | 32).astype(np.int32) << 8 | second  # in small letters

    def of(self, keyword: str) -> np.ndarray:
        """(lines,) bool: which lines begin with `keyword` of one or two letters."""
        return self.key == int.from_bytes(keyword.ljust(2).encode(), "big")

    def text(self, keyword: str) -> bytes:
        """The lines with this keyword, without it and without comments; each ends in a line feed."""
        mine, lengths = self.of(keyword), self.ends - self.starts
        text = self.characters[np.repeat(mine, lengths)]
        begins = np.cumsum(lengths[mine]) - lengths[mine]
        text[begins[:, None] + np.arange(len(keyword))] = 32
        return re.sub(rb"#[^\n]*", b"", text.tobytes()) if (text == 35).any() else text.tobytes()

    def wrong(self, reason: str, keyword: str, row: int) -> UnusableModel:
        """The error that names a line, by its number among those with its keyword."""
        line = self.text(keyword).split(b"\n")[row].decode("utf-8", "replace")
        return self.home.refused(f"{reason}: '{keyword} {' '.join(line.split())[:100]}'")

    def numbers(self, keyword: str, text: bytes, dtype: type = np.float64) -> tuple[np.ndarray, np.ndarray]:
        """All numbers of the `text` of the lines with this keyword in one array, and how many each line has."""
        counts = _word_counts(text)
        values = _parsed(text, dtype)
        if len(values) != counts.sum():
            rows = enumerate(text.split(b"\n"))
            row = next((row for row, line in rows if len(_parsed(line, dtype)) != len(line.split())), 0)
            raise self.wrong("not a number", keyword, row)
        if dtype is np.float64 and not (finite := np.isfinite(values)).all():
            row = np.searchsorted(np.cumsum(counts), finite.argmin(), side="right")
            raise self.wrong("NaN or infinite", keyword, int(row))
        return values, counts

    def table(self, keyword: str, least: int, most: int) -> np.ndarray:
        """The first `most` numbers (lines, most) of the lines with this keyword, NaN where there are only `least`."""
        values, counts = self.numbers(keyword, self.text(keyword))
        if not len(counts):
            raise self.home.refused("no vertices")
        if (short := counts < least).any():
            raise self.wrong(f"fewer than {least} numbers", keyword, int(short.argmax()))
        used = np.where(counts < most, least, most)
        if (counts == counts[0]).all():
            return values.reshape(len(counts), -1)[:, : used[0]]
        column = np.arange(used.max())
        places = np.minimum((np.cumsum(counts) - counts)[:, None] + column, len(values) - 1)
        return np.where(column < used[:, None], values[places], np.nan)

    def words(self, keyword: str) -> list[tuple[int, str]]:
        """What follows a longer keyword on each of its lines, and how many faces stand before it."""
        lines = np.flatnonzero(self.of(keyword[:2]))
        before = np.cumsum(self.of("f"))[lines]
        words = []
        for line, faces in zip(lines, before, strict=True):
            word, _, rest = self.data[self.starts[line] : self.ends[line]].partition(b" ")
            if word.lower() == keyword.encode():
                words.append((int(faces), rest.decode("utf-8", errors="surrogateescape").strip()))
        return words


def _split(data: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The characters of a text, and where each of its lines begins and ends."""
    characters = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(characters == 10) + 1
    return characters, np.append(0, ends[:-1]), ends


def _parsed(text: bytes, dtype: type) -> np.ndarray:
    """The numbers of a text, up to the first word that is none."""
    with warnings.catch_warnings(), contextlib.suppress(ValueError):
        warnings.simplefilter("ignore", DeprecationWarning)
        return np.fromstring(text, dtype, sep=" ")
    return np.zeros(0, dtype)


def _word_counts(text: bytes) -> np.ndarray:
    """The number of words on each line of `text`."""
    characters = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(characters == 10)
    return np.diff(np.searchsorted(np.flatnonzero(_begins(characters > 32)), ends), prepend=0)


def _begins(inside: np.ndarray) -> np.ndarray:
    """Where runs begin."""
    first = inside.copy()
    first[1:] &= ~inside[:-1]
    return first


def _corners(lines: _Lines, vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """0-based vertex and texture indices of all corners (-1: no texture coordinate), and each polygon's corner count.

    A corner is `v`, `v/t`, `v//n` or `v/t/n`; what stands after a slash may be left out.
    """
    text = lines.text("f")
    sizes = _word_counts(text)
    if (count := int(np.maximum(sizes - 2, 0).sum())) > MAX_FACES:
        raise lines.home.refused(f"{count} faces, more than {MAX_FACES}")
    values, _ = lines.numbers("f", text.replace(b"/", b" "), np.int64)
    characters = np.frombuffer(text, np.uint8)
    at = np.flatnonzero(_begins((characters > 32) & (characters != 47)))
    slash, second = (characters[at - back] == 47 for back in (1, 2))  # each line begins with a blank for its keyword
    first = np.flatnonzero(~slash)  # of a corner's numbers
    place = np.arange(len(at)) - np.repeat(first, np.diff(first, append=len(at)))
    place += slash & second  # 0: vertex, 1: texture coordinate, 2: normal
    if len(first) != sizes.sum() or place.max(initial=0) > 2:
        rows = enumerate(text.split(b"\n"))
        wrong = next(row for row, line in rows if not all(map(_CORNER.fullmatch, line.split())))
        raise lines.wrong("cannot understand the face", "f", wrong)
    faces = lines.of("f")

    def checked(keyword: str, name: str, corner: np.ndarray, index: np.ndarray, total: int) -> np.ndarray:
        """0-based numbers of what corners refer to; negative ones count back from where they stand."""
        if index.min(initial=1) < 1 or index.max(initial=1) > total:
            owner = np.repeat(np.arange(len(sizes)), sizes)[corner]
            index = np.where(index < 0, index + 1 + np.cumsum(lines.of(keyword))[faces][owner], index)
            if (wrong := (index < 1) | (index > total)).any():
                reason = f"a face refers to {name} {index[wrong.argmax()]} of {total}"
                raise lines.wrong(reason, "f", int(owner[wrong.argmax()]))
        return index - 1

    every_t = np.full(len(first), -1)
    of_t = np.flatnonzero(place == 1)
    corner_t = np.cumsum(~slash)[of_t] - 1
    every_t[corner_t] = checked("vt", "texture coordinate", corner_t, values[of_t], int(lines.of("vt").sum()))
    return checked("v", "vertex", np.arange(len(first)), values[first], vertices), every_t, sizes


def _hidden(entries: list[Entry], material: np.ndarray) -> np.ndarray:
    """(F,) bool: which faces are of materials that are (almost) transparent; all others are rendered opaque.

    Some exporters write opacity for transparency. Where that would hide more faces than it leaves, it is meant.
    """
    opacity = np.array([entry.opacity for entry in entries])[material]
    hidden = opacity < MIN_OPACITY
    return hidden & (hidden.sum() <= (opacity > 1 - MIN_OPACITY).sum())


def _colours(
    lines: _Lines, given: np.ndarray, entries: list[Entry], faces: np.ndarray, material: np.ndarray
) -> np.ndarray | None:
    """Colours (F, 3, 3) of corners from those of vertices (V, 3), NaN for none, and of materials; None without any.

    They are multiplied, but for materials without a hue, which exporters write beside colours. A vertex without a
    colour has its face's material's.
    """
    if not given.size or np.isnan(given).all():
        return None
    if (wrong := (given > COLOUR_RANGES[-1][0]).any(axis=1)).any():
        raise lines.wrong("a vertex's colour is out of range", "v", int(wrong.argmax()))
    full = next(full for largest, full in COLOUR_RANGES if np.nanmax(given) <= largest)
    shades = np.clip(given / full, 0, 1)
    diffuse = np.array([entry.diffuse for entry in entries])  # (M, 3)
    plain = np.ptp(diffuse, axis=1, keepdims=True) == 0
    plain[1:] &= bool((shades[~np.isnan(shades)] != 1).any())  # white everywhere says nothing beside a material
    own = shades[faces] * np.where(plain, 1, diffuse)[material][:, None]
    return np.where(np.isnan(own), diffuse[material][:, None], own).astype(np.float32)


def _materials(
    lines: _Lines, names: list[str], entries: list[Entry], material: np.ndarray, corners: np.ndarray
) -> tuple[tuple[Material, ...], np.ndarray | None]:
    """The materials with the textures that faces use, and (F, 3, 2) coordinates if any do."""
    used = np.unique(material[(corners >= 0).any(axis=1)])
    textured = {int(number): file for number in used if (file := entries[number].texture)}
    if len(textured) > MAX_TEXTURED:
        raise lines.home.refused(f"{len(textured)} materials with textures, more than {MAX_TEXTURED}")
    images = {file: read_texture(lines.home, file) for file in dict.fromkeys(textured.values())}
    pictures = [images.get(textured.get(number)) for number in range(len(names))]
    materials = tuple(Material(*each) for each in zip(names, [e.diffuse for e in entries], pictures, strict=True))
    if not textured:
        return materials, None
    table = np.nan_to_num(lines.table("vt", least=1, most=2))
    if (wrong := (np.abs(table) > MAX_UV).any(axis=1)).any():
        raise lines.wrong("a texture coordinate is too large", "vt", int(wrong.argmax()))
    # The last row is for index -1, a corner without coordinates.
    uv = np.concatenate([table, np.zeros((1, 2))]).astype(np.float32)[corners]
    for number in textured:
        entry, mine = entries[number], material == number
        if (entry.scale, entry.offset) != ((1.0, 1.0), (0.0, 0.0)):
            uv[mine] = uv[mine] * np.array(entry.scale) + np.array(entry.offset)
    return materials, uv
