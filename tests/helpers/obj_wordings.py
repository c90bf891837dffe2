"""The same meshes in other words: OBJ and MTL files whose surface is known, as exporters and people write them."""

from __future__ import annotations

import io
import math
import random
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from viewnet.render.mesh import GREY, Mesh

Corner = tuple[float, ...]
PALETTE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 0.0), (1.0, 0.0, 1.0), (0.0, 1.0, 1.0))


@dataclass(frozen=True, eq=False)
class Triangles:
    """A surface: corners (F, 3, 3), their colours (F, 3, 3) in 0..1 and texture coordinates (F, 3, 2), NaN without."""

    corners: np.ndarray
    colours: np.ndarray
    uv: np.ndarray

    def described(self) -> tuple[dict[Corner, float], set[Corner]]:
        """Area by colour (NaN where a face has several), and its corners: position, colour and texture coordinate."""
        edges = self.corners[:, 1:] - self.corners[:, :1]
        areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
        shown = areas > 1e-9
        by_colour: dict[Corner, float] = defaultdict(float)
        for area, colours in zip(areas[shown], self.colours[shown].round(2) + 0.0, strict=True):
            plain = (colours == colours[0]).all()
            by_colour[tuple(colours[0]) if plain else (math.inf,)] += float(area)
        rows = np.concatenate([self.corners, self.colours, np.nan_to_num(self.uv, nan=-9)], axis=2)[shown]
        return dict(by_colour), {tuple(row) for row in (rows.reshape(-1, 8).round(2) + 0.0).tolist()}

    def same_as(self, other: Triangles) -> bool:
        """Whether both are one surface, up to its triangulation, which needs no corners but those of this one."""
        (area, corners), (other_area, other_corners) = self.described(), other.described()
        if area.keys() != other_area.keys() or not corners >= other_corners:
            return False
        return all(math.isclose(area[colour], other_area[colour], rel_tol=1e-3) for colour in area)


@dataclass(frozen=True)
class Worded:
    """Files of a model, what is unusual in them, and the surface they state; None where a file must be refused.

    `junk` is then what the refusal has to name.
    """

    name: str
    files: dict[str, bytes]
    features: tuple[str, ...]
    truth: Triangles | None
    junk: str = ""

    def write(self, folder: Path) -> Path:
        """Write the files to a folder; the .obj."""
        for name, content in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return folder / "model.obj"


def as_triangles(mesh: Mesh) -> Triangles:
    """The surface of a mesh as the renderers show it, textures by their mean colour."""
    colours = np.array([entry.diffuse for entry in mesh.materials])[mesh.material][:, None].repeat(3, axis=1)
    if mesh.colours is not None:
        colours = mesh.colours.astype(float)
    uv = np.full((len(mesh.faces), 3, 2), np.nan)
    for number, entry in enumerate(mesh.materials):
        if entry.texture is not None and mesh.uv is not None:
            mine = mesh.material == number
            colours[mine], uv[mine] = entry.texture[..., :3].mean((0, 1)) / 255, mesh.uv[mine]
    return Triangles(mesh.vertices[mesh.faces], colours, uv)


# ---- shapes: polygons with a triangulation that is known by construction


@dataclass
class Polygon:
    """Corners in a plane (n, 2), and the corner numbers of the triangles that they are made of."""

    outline: list[tuple[float, float]]
    parts: list[tuple[int, int, int]]


def quad() -> Polygon:
    return Polygon([(0, 0), (1, 0), (1, 1), (0, 1)], [(0, 1, 2), (0, 2, 3)])


def star(rng: random.Random) -> Polygon:
    """A star about the origin: every other corner is near it."""
    count = 2 * rng.randint(3, 6)
    turns = [2 * math.pi * i / count + 0.1 for i in range(count)]
    outline = [
        ((0.2 if i % 2 else 0.7) * math.cos(turn), (0.2 if i % 2 else 0.7) * math.sin(turn))
        for i, turn in enumerate(turns)
    ]
    tips = [(i, i + 1, (i - 1) % count) for i in range(0, count, 2)]
    return Polygon(outline, tips + [(1, i, i + 2) for i in range(3, count - 2, 2)])


def letter_u() -> Polygon:
    outline = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.75, 1.0), (0.75, 0.25), (0.25, 0.25), (0.25, 1.0), (0.0, 1.0)]
    return Polygon(outline, [(0, 1, 4), (0, 4, 5), (1, 2, 3), (1, 3, 4), (0, 5, 6), (0, 6, 7)])


def with_a_hole() -> Polygon:
    """A square with a square hole that an edge, gone along twice, joins to the outside."""
    outline = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (0.3, 0.3), (0.3, 0.7), (0.7, 0.7), (0.7, 0.3), (0.3, 0.3)]
    parts = [(0, 1, 8), (0, 8, 5), (1, 2, 7), (1, 7, 8), (2, 3, 6), (2, 6, 7), (3, 4, 5), (3, 5, 6)]
    return Polygon([(float(x), float(y)) for x, y in outline], parts)


def touching_itself() -> Polygon:
    """Two triangles of one outline that meet in a point, a corner of one on an edge of the other."""
    outline = [(0.0, 0.0), (0.5, 0.5), (1.0, 0.0), (1.0, 1.0), (0.5, 0.5), (0.0, 1.0)]
    return Polygon(outline, [(0, 1, 5), (2, 3, 4)])


def with_needless_corners() -> Polygon:
    """An L with corners along straight edges, and one given twice."""
    outline = [(0, 0), (0.5, 0), (1, 0), (1, 0.4), (0.4, 0.4), (0.4, 0.4), (0.4, 0.7), (0.4, 1), (0, 1), (0, 0.5)]
    parts = [(0, 1, 4), (1, 2, 3), (1, 3, 4), (0, 4, 9), (4, 6, 9), (6, 7, 8), (6, 8, 9)]
    return Polygon([(float(x), float(y)) for x, y in outline], parts)


SHAPES: dict[str, Callable[[random.Random], Polygon]] = {
    "convex": lambda rng: quad(),
    "star": star,
    "letter U": lambda rng: letter_u(),
    "hole by a bridge": lambda rng: with_a_hole(),
    "touching itself": lambda rng: touching_itself(),
    "needless corners": lambda rng: with_needless_corners(),
}


# ---- words


FEATURES = (
    "backslashes in paths", "blanks and tabs", "byte order mark in the mtl", "byte order mark in the obj",
    "colours beside a material", "colours of some vertices", "colours to 255", "colours to 65535", "comments",
    "continued lines", "corners that leave out what others have", "exponents", "forms that differ by face", "junk",
    "keywords in other case", "library names with blanks", "line ends of Windows", "line ends of old Macs",
    "names with blanks", "negative indices", "no line end at the end", "other statements", "several libraries",
    "several libraries on one line", "texture options", "vertices first",
    *(shape for shape in SHAPES if shape != "convex"),
)  # fmt: skip
"""What can be unusual in a file."""


@dataclass
class _Words:
    """How a file is written: what is unusual in it."""

    rng: random.Random
    features: frozenset[str]

    def has(self, feature: str) -> bool:
        """Whether this is unusual in the file."""
        assert feature in FEATURES
        return feature in self.features

    @property
    def scale(self) -> int:
        """What colours of vertices are multiplied by."""
        return 255 if self.has("colours to 255") else 65535 if self.has("colours to 65535") else 1


STATEMENTS = "o thing\ng part one\ns off\ns 1\nl 1 2\np 1\nvn 0 0 1\nvp 0 1\nmg 1 0.5\nusemap off\n".splitlines()
JUNK = {"v": ("nan", "one", "1,5", "inf", "0x1f"), "f": ("nan", "x", "1/x", "0", "99999", "-99999", "1.5")}


def wordings(count: int, seed: int = 0) -> Iterator[Worded]:
    """So many models; the same for the same seed. Those with junk must be refused."""
    for number in range(count):
        yield _worded(number, random.Random(f"{seed} {number}"))


def _worded(number: int, rng: random.Random) -> Worded:
    # Each in turn, so that every one is there, and up to two others.
    words = _Words(rng, frozenset({FEATURES[number % len(FEATURES)], *rng.sample(FEATURES, rng.randint(0, 2))}))
    coloured = any(feature.startswith("colours") for feature in words.features)
    kind = "colours" if coloured else rng.choice(["materials", "materials", "colours", "plain"])
    shapes = ["convex", "convex", *(shape for shape in SHAPES if shape in words.features)]
    polygons = [_placed(SHAPES[shape](rng), place, rng) for place, shape in enumerate(shapes)]
    files, looks, obj = _materials(words, len(polygons)) if kind == "materials" else ({}, [None] * len(polygons), [])
    plain = GREY
    colours = _vertex_colours(words, polygons) if kind == "colours" else [None] * len(polygons)
    if kind == "colours" and words.has("colours beside a material"):
        files, obj, plain = {"c.mtl": b"newmtl white\nKd 1 1 1\n"}, ["mtllib c.mtl", "usemtl white"], (1.0, 1.0, 1.0)
    body, refused = _body(words, polygons, looks, colours)
    lines = [*obj, *body]
    lines = _dressed(words, lines)
    files["model.obj"] = _encoded(words, lines, "obj")
    truth = None if refused else _truth(polygons, looks, colours, plain)
    return Worded(f"{number:03d}", files, tuple(sorted(words.features)), truth, refused)


def _placed(shape: Polygon, place: int, rng: random.Random) -> tuple[Polygon, np.ndarray]:
    """The shape's corners (n, 3) in a plane of its own, either way round."""
    flat = np.array(shape.outline)
    z = np.full(len(flat), float(place))
    points = np.stack([flat[:, 0], flat[:, 1], z + 0.5 * flat[:, 0]], axis=1)
    points = points[:, rng.choice([[0, 1, 2], [2, 0, 1], [1, 2, 0]])].round(4)
    if rng.random() < 0.5:
        last = len(points) - 1
        shape = Polygon(shape.outline, [(last - a, last - b, last - c) for a, b, c in shape.parts])
        points = points[::-1]
    return shape, points


def _materials(words: _Words, count: int) -> tuple[dict[str, bytes], list[tuple[str, Corner, bool]], list[str]]:
    """Library files, the material of each polygon (name, colour, whether textured), and the first lines of the OBJ."""
    rng = words.rng
    blank = words.has("names with blanks")
    looks = []
    entries = []
    files: dict[str, bytes] = {}
    for number in range(count):
        colour = PALETTE[number % len(PALETTE)]
        name = f"look {number}" if blank else f"look{number}"
        lines = [f"newmtl {name}", "Ka 0.1 0.1 0.1", "Ns 10", "illum 2"]
        textured = rng.random() < 0.4
        if textured:
            image = f"images/an image {number}.png" if blank else f"images/image{number}.png"
            target = io.BytesIO()
            Image.new("RGB", (4, 4), tuple(int(255 * part) for part in colour)).save(target, "PNG")
            files[image] = target.getvalue()
            shown = image.replace("/", "\\") if words.has("backslashes in paths") else image
            options = "-blendu on -s 1 1 1 " if words.has("texture options") else ""
            lines += ["Kd 0 0 0", f"map_Kd {options}{shown}"]
        else:
            lines.append("Kd {:g} {:g} {:g}".format(*colour))
        entries.append(_dressed(words, lines))
        looks.append((name, colour, textured))
    on_one_line = words.has("several libraries on one line")
    if on_one_line or words.has("several libraries"):
        names = (
            ["a.mtl", "c.mtl"]
            if on_one_line
            else ["a b.mtl" if words.has("library names with blanks") else "a.mtl", "c.mtl"]
        )
        halves = [entries[:1], entries[1:]]
        obj = [f"mtllib {' '.join(names)}"] if on_one_line else [f"mtllib {name}" for name in names]
    else:
        names, halves = ["library of it.mtl" if words.has("library names with blanks") else "model.mtl"], [entries]
        obj = [f"mtllib {names[0]}"]
    for name, half in zip(names, halves, strict=True):
        files[name] = _encoded(words, [line for entry in half for line in entry], "mtl")
    return files, looks, obj


def _vertex_colours(words: _Words, polygons: list[tuple[Polygon, np.ndarray]]) -> list[list[Corner | None]]:
    partly = words.has("colours of some vertices")
    chosen: list[list[Corner | None]] = []
    for number, (_, points) in enumerate(polygons):
        own = PALETTE[number % len(PALETTE)]
        chosen.append([None if partly and number == 0 else own for _ in points])
    return chosen


def _body(
    words: _Words,
    polygons: list[tuple[Polygon, np.ndarray]],
    looks: list[tuple[str, Corner, bool] | None],
    colours: list[list[Corner | None] | None],
) -> tuple[list[str], str]:
    """Vertices and faces, and the line that must be refused if there is one."""
    rng = words.rng
    negative, later = words.has("negative indices"), words.has("vertices first")
    forms = ["v", "v/t", "v//n", "v/t/n"]
    form_of_file = rng.choice(forms)
    mixed, odd = words.has("forms that differ by face"), words.has("corners that leave out what others have")
    vertices, faces, between = [], [], []
    counted_v = counted_t = 0
    total = sum(len(points) for _, points in polygons)
    for (_, points), look, tints in zip(polygons, looks, colours, strict=True):
        lines = []
        for place, point in enumerate(points):
            row = " ".join(_number(words, x) for x in point)
            if tints is not None and tints[place] is not None:
                row += " " + " ".join(f"{x * words.scale:g}" for x in tints[place])
            lines += [f"v {row}", f"vt {point[0]:g} {point[1]:g}"]
        first_v, first_t = counted_v, counted_t
        counted_v, counted_t = counted_v + len(points), counted_t + len(points)
        textured = look is not None and look[2]
        form = rng.choice(forms) if mixed else form_of_file
        if textured and "t" not in form:
            form = "v/t"
        corners = []
        for place in range(len(points)):
            v, t = first_v + place + 1, first_t + place + 1
            if negative:
                seen = total if later else counted_v
                v, t = v - seen - 1, t - seen - 1
            mine = rng.choice(["v", "v/t", "v/", "v//", "v/t/"]) if odd and not textured else form
            corners.append(mine.replace("v", str(v)).replace("t", str(t)).replace("n", "1"))
        face = [f"usemtl {look[0]}"] if look is not None else []
        face.append("f " + " ".join(corners))
        vertices.append(lines)
        faces.append(face)
        between.append([rng.choice(STATEMENTS)] if words.has("other statements") else [])
    refused = ""
    if words.has("junk"):
        keyword = rng.choice(["v", "f"])
        lines = rng.choice(vertices if keyword == "v" else faces)
        place = next(i for i, line in enumerate(lines) if line.startswith(f"{keyword} "))
        parts = lines[place].split(" ")
        parts[2] = rng.choice(JUNK[keyword])
        refused, lines[place] = parts[2], " ".join(parts)
    lines = ["vn 0 0 1"]
    if later:
        lines += [line for group in vertices for line in group]
    for group, face, other in zip(vertices, faces, between, strict=True):
        lines += [*([] if later else group), *other, *face]
    return lines, refused


def _number(words: _Words, value: float) -> str:
    """A number in one of the ways that C's printf has."""
    if words.has("exponents"):
        return words.rng.choice([f"{value:E}", f"{value:+.6e}", f"{value:.6f}"])
    return f"{value:g}"


def _dressed(words: _Words, lines: list[str]) -> list[str]:
    """The same lines with comments, blanks, other letters and breaks."""
    rng = words.rng
    comments, blanks = words.has("comments"), words.has("blanks and tabs")
    case, continued = words.has("keywords in other case"), words.has("continued lines")
    dressed = []
    for line in lines:
        keyword, _, rest = line.partition(" ")
        named = keyword.lower() in ("mtllib", "usemtl", "newmtl", "map_kd", "o", "g")
        if case and rng.random() < 0.5:
            keyword = rng.choice([keyword.upper(), keyword.lower(), keyword.capitalize()])
        if continued and not named and " " in rest and rng.random() < 0.5:
            head, _, tail = rest.rpartition(" ")
            rest = f"{head} \\\n {tail}"
        if blanks and not named:
            rest = rest.replace(" ", rng.choice(["  ", "\t", " \t "]))
        gap = rng.choice([" ", "\t", "   "]) if blanks else " "
        start, end = (rng.choice(["", " ", "\t"]), rng.choice(["", " ", "\t "])) if blanks else ("", "")
        if comments and rng.random() < 0.3:
            dressed.append(rng.choice(["# f 1 2 3", "#", "  # v nan nan nan", "", "# C:\\models\\"]))
        if comments and rng.random() < 0.3:
            end += rng.choice([" # the face", " # 3", "\t#", " #v"])
        dressed.append(f"{start}{keyword}{gap}{rest}{end}")
    return dressed


def _encoded(words: _Words, lines: list[str], kind: str) -> bytes:
    """The bytes of a file's lines."""
    ends = "\r\n" if words.has("line ends of Windows") else "\r" if words.has("line ends of old Macs") else "\n"
    text = ends.join("\n".join(lines).split("\n"))
    if not words.has("no line end at the end"):
        text += ends
    mark = b"\xef\xbb\xbf" if words.has(f"byte order mark in the {kind}") else b""
    return mark + text.encode()


def _truth(
    polygons: list[tuple[Polygon, np.ndarray]],
    looks: list[tuple[str, Corner, bool] | None],
    colours: list[list[Corner | None] | None],
    plain: Corner,
) -> Triangles:
    corners, shades, uv = [], [], []
    for (shape, points), look, tints in zip(polygons, looks, colours, strict=True):
        for part in shape.parts:
            corners.append([points[i] for i in part])
            if look is not None:
                shades.append([look[1]] * 3)
            else:
                shades.append([(tints[i] or plain) if tints is not None else plain for i in part])
            textured = look is not None and look[2]
            uv.append([points[i][:2] if textured else (np.nan, np.nan) for i in part])
    return Triangles(np.array(corners), np.array(shades), np.array(uv, dtype=float))
