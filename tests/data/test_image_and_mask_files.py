"""Images and masks as people have them: every mode, every orientation, every use."""

from __future__ import annotations

import io
import logging
import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.irregular_files import IRREGULAR
from PIL import Image, ImageCms, ImageOps

from viewnet.data import mask_files
from viewnet.data.backgrounds import random_square
from viewnet.data.clips import Clip, read_frames
from viewnet.data.masks import from_alpha, from_files
from viewnet.errors import ViewnetError
from viewnet.estimator.inputs import read_image
from viewnet.render.mtl import Home, read_texture
from viewnet.runtime import image_files

PACKAGE = Path(image_files.__file__).parents[1]
WIDE, HIGH = 12, 8
GREY = np.linspace(0, 255, WIDE * HIGH).round().astype(np.uint8).reshape(HIGH, WIDE)  # all pixels differ
COLOURS = np.dstack([GREY, GREY[::-1], GREY[:, ::-1]])
MUTED = COLOURS // 4 + 96  # what is printed or projected has not all colours of screens
ALPHA = np.where(GREY > 99, 255, 60).astype(np.uint8)
OBJECT = np.zeros((HIGH, WIDE), bool)
OBJECT[1:4, 2:9] = True  # of no symmetry
OBJECT[4, 2] = True
ORIENTATIONS: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda stored: stored,
    2: lambda stored: stored[:, ::-1],
    3: lambda stored: stored[::-1, ::-1],
    4: lambda stored: stored[::-1],
    5: lambda stored: stored.swapaxes(0, 1),
    6: lambda stored: np.rot90(stored, -1),
    7: lambda stored: stored[::-1, ::-1].swapaxes(0, 1),
    8: lambda stored: np.rot90(stored),
}
"""EXIF's orientation -> what shows stored pixels (H, W, ...) upright, without Pillow."""


def grey_and(alpha: np.ndarray, grey: np.ndarray) -> np.ndarray:
    return np.dstack([grey] * 3 + [alpha])


def palette(numbers: np.ndarray, colours: list[int], transparent: int | None = None) -> Image.Image:
    image = Image.fromarray(numbers.astype(np.uint8))
    image.putpalette(colours)  # makes it one of mode P
    if transparent is not None:
        image.info["transparency"] = transparent
    return image


def lab(rgb: np.ndarray) -> Image.Image:
    profiles = [ImageCms.createProfile(name) for name in ("sRGB", "LAB")]
    return ImageCms.profileToProfile(Image.fromarray(rgb), *profiles, outputMode="LAB")


def white_on_black(marked: np.ndarray) -> np.ndarray:
    return np.dstack([marked.astype(np.uint8) * 255] * 3)


RED_ON_BLACK = [0, 0, 0, 200, 0, 0]
WORD = GREY.astype(np.uint16) * 257
RAMP = list(np.repeat(np.arange(256), 3))
MODES: dict[str, tuple[str, Image.Image, np.ndarray, Image.Image]] = {
    "1": ("PNG", Image.fromarray(GREY > 99), np.dstack([(GREY > 99) * 255] * 3), Image.fromarray(OBJECT)),
    "L": ("PNG", Image.fromarray(GREY), np.dstack([GREY] * 3), Image.fromarray(OBJECT.astype(np.uint8) * 255)),
    "LA": (
        "PNG",
        Image.fromarray(np.dstack([GREY, ALPHA])),
        grey_and(ALPHA, GREY),
        Image.fromarray(np.dstack([np.full_like(GREY, 255), OBJECT.astype(np.uint8) * 255])),
    ),
    "P": ("PNG", palette(GREY, RAMP), np.dstack([GREY] * 3), palette(OBJECT, RED_ON_BLACK)),
    "P, one entry transparent": (
        "PNG",
        palette(GREY, RAMP, 0),
        grey_and(np.where(GREY == 0, 0, 255), GREY),
        palette(OBJECT, [0, 0, 0] * 2, 0),
    ),
    "RGB": ("PNG", Image.fromarray(COLOURS), COLOURS, Image.fromarray(white_on_black(OBJECT))),
    "RGBA": (
        "PNG",
        Image.fromarray(np.dstack([COLOURS, ALPHA])),
        np.dstack([COLOURS, ALPHA]),
        Image.fromarray(np.dstack([np.zeros_like(COLOURS), OBJECT.astype(np.uint8) * 255])),
    ),
    "CMYK": (
        "TIFF",
        Image.fromarray(COLOURS).convert("CMYK"),
        COLOURS,
        Image.fromarray(white_on_black(OBJECT)).convert("CMYK"),
    ),
    "LAB": ("TIFF", lab(MUTED), MUTED, lab(white_on_black(OBJECT))),
    "I;16": ("PNG", Image.fromarray(WORD), np.dstack([GREY] * 3), Image.fromarray(OBJECT.astype(np.uint16) * 65535)),
    "I;16B": (
        "TIFF",
        Image.fromarray(WORD.astype(">u2")),
        np.dstack([GREY] * 3),
        Image.fromarray((OBJECT * 65535).astype(">u2")),
    ),
    "I": (
        "TIFF",
        Image.fromarray(WORD.astype(np.int32)),
        np.dstack([GREY] * 3),
        Image.fromarray(OBJECT.astype(np.int32) * 65535),
    ),
    "F": (
        "TIFF",
        Image.fromarray((GREY / 255).astype(np.float32)),
        np.dstack([GREY] * 3),
        Image.fromarray(OBJECT.astype(np.float32)),
    ),
    # No file has these: images of Pillow's own.
    "YCbCr": (
        "",
        Image.fromarray(COLOURS).convert("YCbCr"),
        COLOURS,
        Image.fromarray(white_on_black(OBJECT)).convert("YCbCr"),
    ),
    "HSV": (
        "",
        Image.fromarray(COLOURS).convert("HSV"),
        COLOURS,
        Image.fromarray(white_on_black(OBJECT)).convert("HSV"),
    ),
    "RGBa": (
        "",
        Image.fromarray(np.dstack([COLOURS, np.full_like(GREY, 255)])).convert("RGBa"),
        np.dstack([COLOURS, np.full_like(GREY, 255)]),
        Image.fromarray(np.dstack([white_on_black(OBJECT), OBJECT.astype(np.uint8) * 255])).convert("RGBa"),
    ),
}
"""Mode -> the format of a file of it, an image, its pixels in 8 bits (H, W, 3 or 4), and OBJECT as a mask."""
CLIPPED = ("I;16", "I;16B", "I", "F")  # modes that Pillow converts without scaling them to 8 bits
NEAR = {"LAB": 6, "YCbCr": 3, "HSV": 6}  # modes that are not exact: by how many levels they may be off


def marked(image: Image.Image, kind: str, orientation: int, folder: Path) -> Path | Image.Image:
    """The image stored with an orientation of EXIF."""
    if not kind:
        image = image.copy()
        image.getexif()[274] = orientation
        return image
    exif = Image.Exif()
    exif[274] = orientation
    file = folder / f"{orientation}.{kind.lower()}"
    options = {"transparency": image.info["transparency"]} if "transparency" in image.info else {}
    image.save(file, kind, exif=exif, **options)
    return file


def by_pillow(stored: Path | Image.Image) -> np.ndarray:
    """An image (H, W, 3 or 4) as Pillow turns and converts it."""
    # Of a path Pillow maps some TIFF files into memory, and turned ones wrongly.
    image = stored if isinstance(stored, Image.Image) else Image.open(io.BytesIO(stored.read_bytes()))
    upright = ImageOps.exif_transpose(image)
    return np.asarray(upright.convert("RGBA" if upright.has_transparency_data else "RGB")).astype(int)


def pixels(image: Image.Image, channels: int) -> np.ndarray:
    return np.asarray(image.convert("RGB" if channels == 3 else "RGBA")).astype(int)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
@pytest.mark.parametrize("mode", MODES)
def test_a_photograph_of_any_mode_and_orientation(mode, orientation, tmp_path):
    kind, image, meant, _ = MODES[mode]
    stored = marked(image, kind, orientation, tmp_path)
    read = read_image(stored)
    expected = ORIENTATIONS[orientation](meant)
    assert image.mode == mode.partition(",")[0] or mode == "I;16B"
    assert read.image.mode == ("RGB" if meant.shape[2] == 3 else "RGBA")
    assert np.abs(pixels(read.image, meant.shape[2]) - expected).max() <= NEAR.get(mode, 0)
    assert (pixels(read.image, meant.shape[2]) == by_pillow(stored)).all() == (mode not in CLIPPED)
    if meant.shape[2] == 4 and meant[..., 3].min() < 255:
        assert (read.mask == expected[..., 3]).all()


@pytest.mark.parametrize("orientation", ORIENTATIONS)
@pytest.mark.parametrize("mode", MODES)
def test_a_mask_of_any_mode_is_turned_as_its_image(mode, orientation, tmp_path):
    kind, _, _, mask = MODES[mode]
    (tmp_path / "image").mkdir()
    photograph = marked(Image.fromarray(COLOURS), "PNG", orientation, tmp_path / "image")
    stored = marked(mask, kind, orientation, tmp_path)
    read = read_image(photograph, stored)
    upright = ORIENTATIONS[orientation](OBJECT)
    assert (read.mask == upright * 255).all()
    seen = by_pillow(stored)
    shade = seen[..., 3] if seen.shape[2] == 4 and (seen[..., 3] < 255).any() else seen[..., :3].max(axis=2)
    assert (upright == (shade > shade.max() / 2)).all()
    assert (read.image.height, read.image.width) == upright.shape
    rows, columns = np.nonzero(upright)
    assert read.box == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
@pytest.mark.parametrize("mode", [mode for mode in MODES if MODES[mode][0]])
def test_a_texture_of_any_mode_and_orientation(mode, orientation, tmp_path):
    kind, image, meant, _ = MODES[mode]
    stored = marked(image, kind, orientation, tmp_path)
    found = read_texture(Home(tmp_path / "model.obj", tmp_path), stored)
    expected = ORIENTATIONS[orientation](meant)
    assert found.shape == expected.shape
    assert (found == by_pillow(stored)).all() == (mode not in CLIPPED)
    assert np.abs(found.astype(int) - expected).max() <= NEAR.get(mode, 0)


# -- images


def png(colour_type: int, depth: int, rows: list[bytes], *more: tuple[bytes, bytes], spoilt: bytes = b"") -> bytes:
    """A PNG WIDE pixels wide; `more` chunks before the pixels; of `spoilt` chunks the checksum is wrong."""
    header = struct.pack(">IIBBBBB", WIDE, len(rows), depth, colour_type, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + row for row in rows))
    chunks = [(b"IHDR", header), *more, (b"IDAT", body), (b"IEND", b"")]
    sums = [zlib.crc32(kind + data) ^ (kind == spoilt) for kind, data in chunks]
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", total)
        for (kind, data), total in zip(chunks, sums, strict=True)
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


DEEP = [WORD[row].astype(">u2").tobytes() for row in range(HIGH)]
DEEP_RGB = [np.repeat(WORD[row], 3).astype(">u2").tobytes() for row in range(HIGH)]
TWO_BITS = [bytes([0b00011011] * (WIDE // 4))] * 2


@pytest.mark.parametrize(
    ("content", "grey", "alpha"),
    [
        (png(0, 16, DEEP, (b"tRNS", struct.pack(">H", WORD[2, 3]))), GREY, np.where(GREY[2, 3] == GREY, 0, 255)),
        (
            png(2, 16, DEEP_RGB, (b"tRNS", struct.pack(">3H", *[WORD[2, 3]] * 3))),
            GREY,
            np.where(GREY[2, 3] == GREY, 0, 255),
        ),
        (
            png(0, 2, TWO_BITS, (b"tRNS", struct.pack(">H", 2))),
            np.array([[0, 85, 170, 255] * 3] * 2),
            np.array([[255, 255, 0, 255] * 3] * 2),
        ),
    ],
    ids=["16 bits", "16 bits of three colours", "2 bits"],
)
def test_a_transparent_colour_has_the_bits_of_its_file(content, grey, alpha):
    found = np.asarray(image_files.read(io.BytesIO(content)))
    assert (found[..., :3] == grey[..., None]).all()
    assert (found[..., 3] == alpha).all()


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (GREY.astype(np.float32), "floating point from 0 to 255: expected 0 to 1"),
        (np.full((8, 12), np.nan, np.float32), "floating point from nan to nan"),
        (GREY.astype(np.int32) * 1000, "32-bit numbers from 0 to 255000"),
        (GREY.astype(np.int32), "32-bit numbers from 0 to 255"),
        (-GREY.astype(np.int32), "32-bit numbers from -255 to 0"),
    ],
)
def test_numbers_of_no_known_range_are_refused_with_theirs(values, reason, tmp_path):
    Image.fromarray(values).save(tmp_path / "a.tif")
    with pytest.raises(ViewnetError, match=f"^image is of {reason}"):
        read_image(tmp_path / "a.tif")
    with pytest.raises(ViewnetError, match=f"broken texture 'a.tif' is of {reason}"):
        read_texture(Home(tmp_path / "model.obj", tmp_path), tmp_path / "a.tif")


def in_jpeg(**options: bytes) -> bytes:
    return saved("JPEG", Image.fromarray(COLOURS), **options)


def saved(kind: str, image: Image.Image, **options: bytes) -> bytes:
    target = io.BytesIO()
    image.save(target, kind, **options)
    return target.getvalue()


ROWS = [row.tobytes() for row in GREY]
ROTATED = Image.Exif()
ROTATED[274] = 6
DAMAGED = {
    "EXIF of a JPEG": in_jpeg(exif=b"Exif\0\0no TIFF header"),
    "EXIF of a JPEG, cut off": in_jpeg(exif=ROTATED.tobytes()[:20]),
    "orientation 77": in_jpeg(exif=ROTATED.tobytes().replace(b"\x00\x06", b"\x00\x4d")),
    "profile of a JPEG": in_jpeg(icc_profile=b"no profile"),
    "EXIF of a WebP": saved("WEBP", Image.fromarray(COLOURS), exif=b"no TIFF header", lossless=True),
    "EXIF of a PNG": png(0, 8, ROWS, (b"eXIf", b"no TIFF header")),
    "EXIF with a wrong checksum": png(0, 8, ROWS, (b"eXIf", ROTATED.tobytes()[6:]), spoilt=b"eXIf"),
    "profile with a wrong checksum": png(0, 8, ROWS, (b"iCCP", b"a\0\0" + zlib.compress(b"b")), spoilt=b"iCCP"),
    "profile without a name": png(0, 8, ROWS, (b"iCCP", b"xx")),
    "text of 64 MB": png(0, 8, ROWS, (b"zTXt", b"a\0\0" + zlib.compress(bytes(2**26)))),
    "resolution cut off": png(0, 8, ROWS, (b"pHYs", b"x")),
}


@pytest.mark.parametrize("name", DAMAGED)
@pytest.mark.filterwarnings("ignore")
def test_damage_beside_the_pixels_does_them_no_harm(name, tmp_path):
    (tmp_path / "a").write_bytes(DAMAGED[name])
    plain = {b"\xff\xd8": in_jpeg(), b"RI": saved("WEBP", Image.fromarray(COLOURS), lossless=True)}
    whole = plain.get(DAMAGED[name][:2], png(0, 8, ROWS))
    expected = np.asarray(Image.open(io.BytesIO(whole)).convert("RGB"))
    assert (np.asarray(read_image(tmp_path / "a").image) == expected).all()


def test_a_wrong_checksum_of_something_else_does_not_hide_the_orientation():
    chunks = (b"eXIf", ROTATED.tobytes()[6:]), (b"iCCP", b"xx")
    assert image_files.read(io.BytesIO(png(0, 8, ROWS, *chunks))).size == (HIGH, WIDE)


def test_damaged_pixels_are_refused_all_the_same(tmp_path):
    transparent = png(0, 8, ROWS, (b"tRNS", b"\0\0"), spoilt=b"tRNS")
    for content in (png(0, 8, ROWS)[:60], transparent):
        (tmp_path / "a.png").write_bytes(content)
        with pytest.raises(ViewnetError, match=r"^image does not decode"):
            read_image(tmp_path / "a.png")


@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_deflate", "packbits"])
@pytest.mark.parametrize("pixels", [GREY, COLOURS, WORD], ids=["8 bits", "colours", "16 bits"])
def test_a_turned_tiff_of_any_compression(compression, pixels, tmp_path):
    Image.fromarray(pixels).save(tmp_path / "a.tif", compression=compression, tiffinfo={274: 5})
    found = np.asarray(read_image(tmp_path / "a.tif").image)
    expected = GREY[..., None] if pixels is WORD else pixels.reshape(HIGH, WIDE, -1)
    assert (found == ORIENTATIONS[5](expected)).all()
    assert image_files.size(tmp_path / "a.tif") == (HIGH, WIDE)


def test_the_size_of_a_header_is_that_of_the_upright_image(tmp_path):
    for orientation in ORIENTATIONS:
        (tmp_path / "a.jpg").write_bytes(in_jpeg(exif=ROTATED.tobytes().replace(b"\x00\x06", bytes([0, orientation]))))
        assert image_files.size(tmp_path / "a.jpg") == image_files.read(tmp_path / "a.jpg").size
        assert image_files.size(tmp_path / "a.jpg", upright=False) == (WIDE, HIGH)


def test_a_known_format_of_an_unknown_kind_is_told(tmp_path):
    tags = {256: 2, 257: 2, 258: 32, 259: 1, 262: 2, 277: 3, 339: 3}  # three channels of floating point
    fields = b"".join(struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in tags.items())
    (tmp_path / "a.tif").write_bytes(b"II*\0\x08\0\0\0" + struct.pack("<H", len(tags)) + fields + bytes(60))
    with pytest.raises(ViewnetError, match=r"^image does not decode \(TIFF, damaged or of an unknown kind\)"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("name", "content", "kind"),
    [
        ("a.psd", b"8BPS" + bytes(60), "PSD"),
        ("a.jpg", b"%!PS-Adobe-3.0", "EPS"),
        ("a.svg", b"<svg/>", "no known format"),
        ("a.heic", b"\0\0\0\x18ftypheic" + bytes(30), "HEIC, for which install pillow-heif"),
        ("a", b"?", "no known format"),
    ],
)
def test_what_is_not_read_is_refused_with_its_format(name, content, kind, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ViewnetError, match=rf"^image does not decode \({kind}: save it as one of JPEG, PNG, BMP"):
        read_image(tmp_path / name)


@pytest.mark.parametrize("make", IRREGULAR.values(), ids=IRREGULAR.keys())
def test_what_is_no_regular_file_is_refused(make, tmp_path):
    make(tmp_path / "a.png")
    with pytest.raises(ViewnetError, match=r"image is (not a regular file|a folder: expected a file)"):
        image_files.read(tmp_path / "a.png")


def test_what_the_system_refuses_is_told_in_its_words(tmp_path):
    (tmp_path / "a.png").symlink_to("a.png")
    for name, reason in (("a.png", "Too many levels of symbolic links"), ("a" * 300, "File name too long")):
        with pytest.raises(ViewnetError, match=rf"^image does not decode \({reason}\)$"):
            image_files.read(tmp_path / name)


@pytest.mark.parametrize("side", [10_100, 20_000])
def test_too_large_an_image_is_refused_in_one_line(side, tmp_path):
    Image.new("1", (side, side)).save(tmp_path / "a.png")
    code = "import sys; from pathlib import Path; from viewnet.runtime import image_files\n"
    code += "try: image_files.read(Path(sys.argv[1]))\nexcept Exception as error: print(error)"
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "a.png"], capture_output=True, text=True)
    assert done.stdout.startswith("image has more than 100000000 pixels") and not done.stderr


def test_the_first_of_several_frames_is_used_and_this_told_once(tmp_path, caplog):
    frames = [Image.new("L", (WIDE, HIGH), grey) for grey in (50, 200)]
    frames[0].save(tmp_path / "a.gif", save_all=True, append_images=frames[1:])
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            assert (np.asarray(read_image(tmp_path / "a.gif").image) == 50).all()
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path / 'a.gif'} has several frames: the first is used"
    ]


def test_plug_ins_of_pillow_add_their_format(tmp_path):
    (tmp_path / "pillow_heif.py").write_text(
        "from PIL import Image, PpmImagePlugin\n"
        "def register_heif_opener():\n"
        "    Image.register_open('HEIF', PpmImagePlugin.PpmImageFile, lambda head: head[4:8] == b'ftyp')\n"
    )
    program = "from viewnet.runtime import image_files; print(*image_files.FORMATS)"
    paths = [str(tmp_path), str(PACKAGE.parent)]
    with_it, without = (
        subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path[:0] = {places}; {program}"],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for places in (paths, paths[1:])
    )
    assert with_it[-1] == "HEIF"
    assert "HEIF" not in without or "pillow_heif" in sys.modules


def test_there_is_one_door_for_images():
    openings = [
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if re.search(r"\bImage\.open\(|imread\(|read_image\(.*io\b", path.read_text(encoding="utf-8"))
    ]
    assert openings == ["runtime/image_files.py"]


def test_a_background_is_turned_and_scaled_too(tmp_path):
    upright = np.zeros((60, 60), np.uint16)
    upright[:30] = 65535
    file = marked(Image.fromarray(np.ascontiguousarray(np.rot90(upright))), "PNG", 6, tmp_path)
    square = random_square(file, 8, np.random.default_rng(0))
    assert (square[0] > 250).all() and (square[-1] < 5).all()


# -- masks

LABELS = np.zeros((HIGH, WIDE), np.uint8)
LABELS[1:4, 2:9] = 7
LABELS[4, 2] = 15
EDGED = LABELS.copy()
EDGED[5:7, 2:4] = 255  # the number of edges, or of what is not annotated
SOFT = np.zeros((64, 64), np.uint8)
SOFT[8:40, 8:50] = np.linspace(0, 255, 42).round()
LOSSY = np.where(OBJECT, 252, 3).astype(np.uint8)
TRIMAP = np.where(OBJECT, 255, 0).astype(np.uint8)
TRIMAP[1, 2:4] = 128


@pytest.mark.parametrize(
    ("mask", "expected"),
    [
        (Image.fromarray(LABELS), OBJECT * 255),
        (palette(LABELS, RAMP), OBJECT * 255),
        (palette(LABELS, [0, 0, 0, *[9, 99, 9] * 255]), OBJECT * 255),
        (palette(~OBJECT, [255] * 3 + [0] * 3), OBJECT * 255),  # black and white by colours, whatever their numbers
        (Image.fromarray(LABELS.astype(np.uint16)), OBJECT * 255),
        (Image.fromarray(LABELS.astype(np.uint16) * 1000), OBJECT * 255),
        (Image.fromarray(np.where(OBJECT, 70_001, 0).astype(np.int32)), OBJECT * 255),
        (Image.fromarray(OBJECT.astype(np.uint16)), OBJECT * 255),
        (Image.fromarray(np.dstack([OBJECT * 128, OBJECT * 0, OBJECT * 0]).astype(np.uint8)), OBJECT * 255),
        (Image.fromarray(np.dstack([COLOURS, OBJECT * 255]).astype(np.uint8)), OBJECT * 255),  # cut out
        (Image.fromarray(np.dstack([white_on_black(OBJECT), np.full_like(GREY, 255)])), OBJECT * 255),
        (Image.fromarray(np.dstack([white_on_black(OBJECT), OBJECT * 255]).astype(np.uint8)), OBJECT * 255),
        (Image.fromarray(SOFT), SOFT),
        (Image.fromarray(SOFT.astype(np.uint16) * 257), SOFT),
        (Image.fromarray((SOFT / 255).astype(np.float32)), SOFT),
        (Image.fromarray(LOSSY), LOSSY),
        (Image.fromarray(TRIMAP), TRIMAP),
        (Image.fromarray(np.zeros_like(GREY)), OBJECT * 0),
        (Image.fromarray(np.zeros((HIGH, WIDE, 4), np.uint8)), OBJECT * 0),
        (Image.fromarray(np.full_like(GREY, 1)), OBJECT * 0 + 255),
        (Image.fromarray(np.full_like(GREY, 255)), OBJECT * 0 + 255),
    ],
)
def test_what_masks_mean(mask, expected, tmp_path):
    mask.save(tmp_path / "frame.tif")
    clip = Clip("c", "car", "train", tmp_path, (), tmp_path / "masks")
    assert (mask_files.read(tmp_path / "frame.tif") == expected).all()
    if mask.mode not in ("F", "I"):
        (tmp_path / "masks").mkdir()
        mask.save(tmp_path / "masks/frame.png")
        assert (from_files().follow(clip)(0, "frame", Image.new("RGB", mask.size)) == expected).all()


@pytest.mark.parametrize(
    ("mask", "found"),
    [
        (Image.fromarray(EDGED), r"its values are 0, 7, 15, 255: expected"),
        (Image.fromarray(np.full_like(GREY, 7)), "its values are 7:"),
        (Image.fromarray(np.where(OBJECT, 2, 1).astype(np.uint8)), "its values are 1, 2:"),
        (Image.fromarray(SOFT // 3), r"its values are 0, 2, 4, 6, 8, 10, ..., 85:"),
        (Image.fromarray(COLOURS), "it has 96 colours"),
        (Image.fromarray(SOFT.astype(np.float32)[:, ::-1] - 1), "its values are -1"),
        (Image.fromarray(np.dstack([white_on_black(OBJECT), GREY])), "its alpha and its colours differ"),
        (Image.fromarray(np.dstack([white_on_black(OBJECT), GREY * 0])), "its alpha and its colours differ"),
        (palette(OBJECT, [200, 0, 0, 0, 0, 0]), r"entry 0 of its palette is \[200, 0, 0\] and not black"),
    ],
)
def test_an_ambiguous_mask_is_refused_with_what_is_in_it(mask, found, tmp_path):
    mask.save(tmp_path / "m.tif")
    with pytest.raises(ViewnetError, match=rf"^mask {tmp_path}/m\.tif is ambiguous \({found}"):
        read_image(Image.new("RGB", mask.size), tmp_path / "m.tif")


@pytest.mark.parametrize("kind", [Image.Resampling.BOX, Image.Resampling.BILINEAR, Image.Resampling.LANCZOS])
@pytest.mark.parametrize("size", [(9, 7), (30, 20), (100, 70)])
def test_soft_edges_of_a_resized_mask_stay(kind, size):
    large = np.zeros((210, 300), np.uint8)
    large[40:150, 60:222] = 255
    small = Image.fromarray(large).resize(size, kind)
    assert (mask_files.read(small) == np.asarray(small)).all()


@pytest.mark.parametrize("quality", [30, 60, 95])
@pytest.mark.parametrize("kind", [kind for kind in ("JPEG", "WEBP", "AVIF") if kind in image_files.FORMATS])
def test_a_mask_in_a_lossy_file_is_that_mask(kind, quality, tmp_path):
    large = np.zeros((210, 300), bool)
    large[40:150, 60:222] = large[20:60, 200:280] = True
    Image.fromarray(white_on_black(large)).save(tmp_path / "m", kind, quality=quality)
    assert ((mask_files.read(tmp_path / "m") > 127) == large).mean() > 0.99


def test_arrays_of_numbers_are_masks_too():
    photograph = Image.fromarray(COLOURS)
    for mask in (OBJECT, OBJECT.astype(int), LABELS.astype(np.int64), OBJECT.astype(float), OBJECT * 255.0):
        assert (read_image(photograph, mask).mask == OBJECT * 255).all()
    for kind in (np.float16, np.float32, np.float64):
        assert (mask_files.coverage((TRIMAP / 255).astype(kind)) == TRIMAP).all()
    assert (mask_files.coverage(TRIMAP.astype(">u2") * 257) == TRIMAP).all()
    with pytest.raises(ViewnetError, match="mask is ambiguous"):
        read_image(photograph, np.where(OBJECT, 0.5, np.nan))


def test_frames_of_a_folder_bring_their_alpha_upright(tmp_path):
    image = Image.fromarray(np.dstack([COLOURS, OBJECT * 255]).astype(np.uint8))
    marked(image, "PNG", 6, tmp_path)
    ((number, name, frame),) = read_frames(tmp_path, [0])
    follow = from_alpha().follow(Clip("c", "car", "train", tmp_path, ()))
    assert (follow(number, name, frame) == ORIENTATIONS[6](OBJECT) * 255).all()
