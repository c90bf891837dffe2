"""Malicious files: false sizes, references to other files, and code that unpickling would execute."""

from __future__ import annotations

import io
import json
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io
import torch
from helpers.imagenet3d_files import archive, pickle_of, thing
from helpers.readers import SYNSET
from PIL import Image

CANARY = "executed"
"""A folder beside the input's that appears if anything in a file is executed."""


@dataclass(frozen=True)
class Case:
    """`spoil` damages a valid input of a reader and returns the file that an error may name.

    `says` is in the error, or in the result where that is text: what was left out.
    """

    reader: str
    name: str
    spoil: Callable[[Path], Path]
    says: str


def put(place: str, content: bytes | Callable[[bytes], bytes]) -> Callable[[Path], Path]:
    """Replace a file's content; `place` may be a pattern, and the content a function of the present one."""

    def spoil(folder: Path) -> Path:
        (file,) = sorted(folder.glob(place))[:1]
        file.write_bytes(content if isinstance(content, bytes) else content(file.read_bytes()))
        return file

    return spoil


class _Harm:
    """Creates a folder when unpickled."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.place),)


def executing(place: str, save: Callable[[Any], bytes]) -> Callable[[Path], Path]:
    """A file that creates a folder when unpickled."""

    def spoil(folder: Path) -> Path:
        return put(place, save(_Harm(folder.parent / CANARY)))(folder)

    return spoil


# ---- images


def png(width: int, height: int, rows: bytes = b"") -> bytes:
    """A grey image whose header claims a size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def saved(image: Image.Image, kind: str) -> bytes:
    target = io.BytesIO()
    image.save(target, kind)
    return target.getvalue()


BOMB = "has more than 100000000 pixels"
HUGE = png(100_000, 100_000)
LAB = saved(Image.new("LAB", (64, 48)), "TIFF")
EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n"
LONG = png(60_000, 2, bytes(2 * 60_001))
LARGE = png(9_000, 9_000, bytes(9_000 * 9_001))

# ---- MATLAB files


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def array(kind: int, shape: tuple[int, ...], name: bytes, content: bytes) -> bytes:
    flags = element(6, struct.pack("<II", kind, 0))
    return element(14, flags + element(5, struct.pack(f"<{len(shape)}i", *shape)) + element(1, name) + content)


def mat(*variables: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", 0x0100, b"IM") + b"".join(variables)


def cells_in_cells(depth: int) -> bytes:
    """A cell in a cell in a cell ..."""
    inner, heads = array(6, (1, 1), b"", element(9, bytes(8))), []
    size = len(inner)
    for number in range(depth):
        name = b"record" if number == depth - 1 else b""
        head = element(6, struct.pack("<II", 1, 0)) + element(5, struct.pack("<2i", 1, 1)) + element(1, name)
        heads.append(struct.pack("<II", 14, len(head) + size) + head)
        size += len(heads[-1])
    return mat(b"".join(reversed(heads)) + inner)


FIELDLESS = mat(array(2, (100_000, 100_000), b"record", element(5, struct.pack("<i", 8)) + element(1, b"")))
ZEROS = zlib.compress(bytes(2**26))
UNPACKED = mat(struct.pack("<II", 15, len(ZEROS)) + ZEROS)


def record(value: Any) -> bytes:
    target = io.BytesIO()
    scipy.io.savemat(target, {"record": value})
    return target.getvalue()


# ---- other containers


def npy(shape: tuple[int, ...], kind: str = "|u1") -> bytes:
    """A header without the data it claims."""
    header = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(header)) + header


def pickled_array(value: Any) -> bytes:
    target = io.BytesIO()
    np.save(target, np.array([value], dtype=object), allow_pickle=True)
    return target.getvalue()


def pickled_archive(value: Any) -> bytes:
    target = io.BytesIO()
    np.savez(target, images=np.array([value], dtype=object), rejected=np.array("{}"))
    return target.getvalue()


def torch_file(value: Any) -> bytes:
    target = io.BytesIO()
    torch.save(value, target)
    return target.getvalue()


def torch_bomb(content: bytes) -> bytes:
    """The same file, compressed, with 128 MB of zeros in its storage; it could be many GB."""
    target = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as source, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as to:
        for name in source.namelist():
            with to.open(name, "w", force_zip64=True) as file:
                file.write(source.read(name))
                for _ in range(2**3 if name.endswith("data/0") else 0):
                    file.write(bytes(2**24))
    return target.getvalue()


def configured(**model: Any) -> Callable[[bytes], bytes]:
    """A checkpoint whose configuration is another network's."""

    def change(content: bytes) -> bytes:
        size = struct.unpack("<Q", content[:8])[0]
        header = json.loads(content[8 : 8 + size])
        config = json.loads(header["__metadata__"]["config"])
        config["model"].update(model)
        header["__metadata__"]["config"] = json.dumps(config)
        head = json.dumps(header).encode()
        return struct.pack("<Q", len(head)) + head + content[8 + size :]

    return change


def parquet(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Callable[[bytes], bytes]:
    def changed(content: bytes) -> bytes:
        target = io.BytesIO()
        change(pd.read_parquet(io.BytesIO(content))).to_parquet(target, index=False)
        return target.getvalue()

    return changed


BRACKETS = b"[" * 10**6

# ---- arrays of objects in .npz files


def executed_objects(value: Any) -> bytes:
    target = io.BytesIO()
    np.savez(target, annotations=np.array([thing(), value], dtype=object))
    return target.getvalue()


def with_command(folder: Path) -> Path:
    """A call of os.system in the oldest protocol."""
    command = f"cos\nsystem\n(S'mkdir {folder.parent / CANARY}'\ntR."
    return put(NPZ, archive(command.encode()))(folder)


def ended(*parts: bytes) -> bytes:
    return archive(b"\x80\x04" + b"".join(parts) + b".", zipfile.ZIP_DEFLATED)


NPZ = "annotations/*/n0_0.npz"
LETTERS = b"X" + struct.pack("<I", 900_000) + b"a" * 900_000 + b"\x94"
ENCODED = b"c_codecs\nencode\nh\0\x8c\x06latin1\x86R"
OF_F8 = b"cnumpy\ndtype\n(X\x02\0\0\0f8\x89\x88tR(K\x03X\x01\0\0\0<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\0tb"
EMPTY = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\0tC\x01btR"
# A tuple of two of a tuple of two ...: to look at all 2^60 parts would take years.
DOUBLED = b"N\x94" + b"".join(b"h" + bytes([n, ord("h"), n]) + b"\x86\x94" for n in range(60))
ARRAYS = (
    ("ImageNet3D", "objects that execute", executing(NPZ, executed_objects), "holds 'posix.mkdir', which is not read"),
    ("ImageNet3D", "command", with_command, "holds 'os.system', which is not read"),
    ("ImageNet3D", "text of 10^18 letters", put(NPZ, ended(b"\x8d", struct.pack("<Q", 10**18))), "damaged"),
    ("ImageNet3D", "number of 2 GB", put(NPZ, ended(b"\x8b\xff\xff\xff\x7f")), "damaged"),
    ("ImageNet3D", "lists in lists", put(NPZ, ended(b"]" * 500_000)), "more than 100000 parts"),
    ("ImageNet3D", "marks", put(NPZ, ended(b"(" * 90_000)), "damaged"),
    ("ImageNet3D", "text encoded again and again", put(NPZ, ended(LETTERS, ENCODED * 9_000)), "more than 1 MiB of it"),
    ("ImageNet3D", "key of 2^60 parts", put(NPZ, ended(DOUBLED, b"}h\x3cNs")), "other keys than texts"),
    (
        "ImageNet3D",
        "objects of 2^60 parts",
        put(NPZ, ended(DOUBLED, EMPTY, b"h\x3cb")),
        "a state as NumPy does not write it",
    ),
    (
        "ImageNet3D",
        "array of 10^18 numbers",
        put(NPZ, ended(EMPTY, b"(K\x01\x8a\x08", struct.pack("<Q", 10**18), b"\x85", OF_F8, b"\x89C\0tb")),
        "damaged",
    ),
    (
        "ImageNet3D",
        "number of a million bits",
        put(NPZ, archive(pickle_of([thing(distance=2**1_000_000)], 4))),
        "no finite number",
    ),
    ("ImageNet3D", "64 MiB in 64 KiB", put(NPZ, archive(bytes(2**26), zipfile.ZIP_DEFLATED)), "more than 1 MiB of it"),
    ("ImageNet3D", "another compression", put(NPZ, archive(b"N.", zipfile.ZIP_LZMA)), "another way than NumPy's"),
    ("ImageNet3D", "no archive", put(NPZ, b"\0" * 200), "not an .npz file"),
    ("ImageNet3D", "another array", put(NPZ, pickled_archive({})), "no annotations.npy in it"),
    ("ImageNet3D", "image elsewhere", put("lists/*train.txt", b"../../../n0_0\n"), "the name of one image"),
    ("ImageNet3D", "image absolute", put("lists/*train.txt", b"/etc/passwd\n"), "the name of one image"),
)

# ---- the cases

OBJ, MTL, PNG = "*/*/models/*.obj", "*/*/models/*.mtl", "*/*/images/*.png"


def before(text: bytes) -> Callable[[bytes], bytes]:
    return lambda content: text + b"\n" + content


def after(text: bytes) -> Callable[[bytes], bytes]:
    return lambda content: content + b"\n" + text + b"\n"


def instead(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    def change(content: bytes) -> bytes:
        assert old in content
        return content.replace(old, new)

    return change


def linked_texture(folder: Path) -> Path:
    """A texture that is a link to an image elsewhere."""
    file = folder / SYNSET / "box/images/texture.png"
    file.rename(folder.parent / "elsewhere.png")
    file.symlink_to(folder.parent / "elsewhere.png")
    return file


def many_textures(folder: Path) -> Path:
    """More textured materials than are rendered from memory."""
    names = [f"m{i}" for i in range(1_001)]
    file = put(MTL, after("".join(f"newmtl {n}\nmap_Kd ../images/texture.png\n" for n in names).encode()))(folder)
    put(OBJ, after("".join(f"usemtl {n}\nf 1/1 2/2 3/3\n" for n in names).encode()))(folder)
    return file


CAD = (
    ("library outside", put(OBJ, before(b"mtllib ../../../../etc/passwd")), "leads out of the model's folder"),
    ("library absolute", put(OBJ, before(b"mtllib /etc/passwd")), "absolute path"),
    ("library with a zero in its name", put(OBJ, before(b"mtllib a\0b.mtl")), "names no file"),
    ("library with a long name", put(OBJ, before(b"mtllib " + b"a" * 5000)), "missing material library"),
    ("library with a name that is no UTF-8", put(OBJ, before(b"mtllib \xff.mtl")), "missing material library"),
    ("face index of 10^18", put(OBJ, after(b"f 1 2 1000000000000000000")), "refers to vertex 1000000000000000000"),
    ("face index of 10^30", put(OBJ, after(b"f 1 2 1" + b"0" * 30)), "a face refers to vertex"),
    ("least face index", put(OBJ, after(b"f 1 2 -9223372036854775808")), "a face refers to vertex"),
    ("vertex of 1e308", put(OBJ, after(b"v 1e308 -1e308 1e308\nf 1 2 -1")), "size inf"),
    ("face of three million corners", put(OBJ, after(b"f" + b" 1" * 3_000_000)), "faces, more than 2000000"),
    ("colour that is no number", put(OBJ, b"v 0 0 0 nan 0 0\nv 1 0 0 0 0 0\nv 1 1 0 0 0 0\nf 1 2 3"), "NaN or inf"),
    ("texture coordinate of 1e300", put(OBJ, instead(b"vt 1 0", b"vt 1e300 0")), "texture coordinate is too large"),
    ("texture absolute", put(MTL, instead(b"../images/texture.png", b"/etc/passwd")), "absolute path"),
    ("texture outside", put(MTL, instead(b"../images", b"..\\..\\..")), "leads out of the model's folder"),
    ("texture linked outside", linked_texture, "leads out of the model's folder"),
    ("texture scaled by infinity", put(MTL, instead(b"-s 2 2", b"-s 1e999 2")), "cannot understand"),
    ("a million texture options", put(MTL, instead(b"-s 2 2", b"-clamp on " * 10**6)), "cannot understand"),
    ("many materials with textures", many_textures, "materials with textures, more than 1000"),
    ("texture of 100000 x 100000", put(PNG, HUGE), BOMB),
    ("texture that is a program", put(PNG, EPS), "does not decode (EPS: save it as one of JPEG"),
)


def long_image(folder: Path) -> Path:
    """An image of some hundred bytes, the square about which has 3.6 billion pixels."""
    put("viewpoints.csv", instead(b"test,2,3,20,22\nd", b"test,0,0,60000,2\nd"))(folder)
    return put("images/c.png", LONG)(folder)


PASCAL = "Annotations/*/n0_0.mat"
DATA = (
    ("ShapeNet's lists", "list that is no text", put("lists/*_val.txt", b"\xff\xfe\0"), "val.txt: cannot be read"),
    ("ShapeNet's lists", "empty list", put("all.csv", b""), "not a readable CSV file"),
    ("ShapeNet's lists", "quotes without end", put("all.csv", after(b'"')), "not a readable CSV file"),
    ("pictures", "image of 100000 x 100000", put("a/a.png", HUGE), BOMB),
    ("pictures", "image that is a program", put("a/b.jpg", EPS), "does not decode (EPS: save it"),
    ("pictures", "class elsewhere", put("ClassName.txt", b"/a/../../etc\n"), "expected a folder such as"),
    ("pictures", "class with a long name", put("ClassName.txt", b"a" * 5000), "expected a folder such as"),
    ("pictures", "classes that are no text", put("ClassName.txt", b"\xff\xfe"), "cannot be read"),
    ("photographs", "large image", put("images/c.png", LARGE), ""),
    ("photographs", "long image", long_image, "too large to be cut"),
    ("photographs", "image elsewhere", put("viewpoints.csv", instead(b"a.png", b"../../a.png")), "name of an image"),
    ("photographs", "image with a zero", put("viewpoints.csv", instead(b"a.png", b'"a\0.png"')), ""),
    ("photographs", "angle of 1e400", put("viewpoints.csv", instead(b"30.5", b"1e400")), "expected a number"),
    ("PASCAL3D+", "cells within cells", put(PASCAL, cells_in_cells(50_000)), "more than 10000 arrays"),
    ("PASCAL3D+", "10^10 structures without fields", put(PASCAL, FIELDLESS), "an array of 100000 x 100000 values"),
    ("PASCAL3D+", "64 MiB in 64 KiB", put(PASCAL, UNPACKED), "more than 4 MiB of it"),
    ("PASCAL3D+", "no MATLAB file", put(PASCAL, b"\0" * 200), "not a MATLAB 5 file"),
    ("PASCAL3D+", "array of objects", put(PASCAL, record(np.array([1.0, "a", {}], dtype=object))), "without objects"),
    ("PASCAL3D+", "image elsewhere", put("Image_sets/*train.txt", b"../../../n0_0\n"), "the name of one image"),
    ("PASCAL3D+", "image absolute", put("Image_sets/*train.txt", b"/etc/passwd\n"), "the name of one image"),
    ("PASCAL3D+", "image with a long name", put("Image_sets/*train.txt", b"a" * 5000), "the name of one image"),
    ("Freiburg cars", "box of no numbers", put("annotations/1*.txt", instead(b"8 6", b"nan 1e400")), "malformed"),
    ("Freiburg cars", "mask of 100000 x 100000", put("masks/car001/1.png", HUGE), BOMB),
    ("Freiburg cars", "mask of no grey levels", put("masks/car001/1.png", LAB), ""),
    ("Freiburg cars", "frame of 100000 x 100000", put("car001/1.png", HUGE), BOMB),
    ("videos", "list of videos", put("b.avi", b"ffconcat version 1.0\nfile a.mp4\n"), "video cannot be read"),
    ("videos", "empty video", put("b.avi", b""), "video cannot be read"),
    ("videos", "half a video", put("b.avi", lambda content: content[: len(content) // 2]), ""),
    ("frames with alpha", "frame that is a program", put("c/0.png", EPS), "does not decode (EPS: save it as one"),
    ("Objectron", "list that is no text", put("index/*train", b"\xff\xfe"), "cannot be read"),
)
VIEWS = {"split": np.nan, "view": 2.0**70, "azimuth": 1e308}
OWN = (
    ("view store", "views that would be unpickled", executing("views.npy", pickled_array), "not a whole array"),
    ("view store", "views of 10 TB", put("views.npy", npy((10**7, 500, 500, 4))), "not a whole array"),
    ("view store", "header without end", put("views.npy", npy((1,))[:20] + b"(" * 9000), "not a whole array"),
    ("view store", "brackets", put("meta.json", BRACKETS), "too many brackets"),
    ("view store", "odd index", put("index.parquet", parquet(lambda t: t.assign(**VIEWS))), "expected"),
    ("view store", "index of lists", put("index.parquet", parquet(lambda t: t.assign(split=[[1]] * len(t)))), "text"),
    ("view store", "empty list", put("rejected.csv", b""), "not a readable CSV file"),
    ("view store", "other columns", put("rejected.csv", b"a,b\n1,2\n"), "column 'model_id'"),
    ("predictions", "text", put("predictions.parquet", parquet(lambda t: t.assign(h0_x="a"))), "predictions.parquet"),
    ("predictions", "lists", put("predictions.parquet", parquet(lambda t: t.assign(h0_x=[[1]] * len(t)))), "parquet"),
    ("predictions", "large views", put("predictions.parquet", parquet(lambda t: t.assign(view=1e300))), "whole number"),
    ("run", "brackets", put("result.json", BRACKETS), "too many brackets"),
    ("run", "a list", put("result.json", b"[]"), "not a run's result"),
    ("run", "no metrics", put("result.json", b"{}"), "no metrics"),
    ("run", "empty log", put("log.csv", b""), "not a readable CSV file"),
    ("run", "log of text", put("log.csv", b"epoch,step,seconds\na,b,c\n"), "values that are not numbers"),
    (
        "checkpoint",
        "header of 10 GB",
        put("*.safetensors", struct.pack("<Q", 10**10) + b"{}"),
        "not a whole checkpoint",
    ),
    ("checkpoint", "empty", put("*.safetensors", b""), "not a whole checkpoint"),
    ("checkpoint", "volume of 512 voxels a side", put("*.safetensors", configured(volume_size=512)), "checkpoint"),
    ("checkpoint", "10^9 heads", put("*.safetensors", configured(heads=10**9)), "checkpoint"),
    ("checkpoint", "channels of 10^9", put("*.safetensors", configured(encoder_channels=[10**9] * 3)), "checkpoint"),
    ("checkpoint to start from", "10^9 heads", put("*.safetensors", configured(heads=10**9)), "heads 1000000000"),
    ("weights of a network", "pickled", executing("weights.pth", pickle.dumps), "does not hold"),
    ("weights of a network", "pickled within", executing("weights.pth", torch_file), "does not hold"),
    ("weights of a network", "compressed", put("weights.pth", torch_bomb), "is compressed"),
    ("drawings kept", "pickled", executing("*.npz", pickled_archive), "damaged"),
    ("drawings kept", "brackets", put("*.npz", BRACKETS), "damaged"),
    ("backgrounds kept", "images of 16 GB", put("*/*/pictures.npy", npy((2**31,), "<i8")), "not a whole array"),
    ("backgrounds kept", "pickled", executing("*/*/pictures.npy", pickled_array), "not a whole array"),
    ("backgrounds kept", "one number", put("*/*/pictures.npy", npy(()) + b"\0"), "damaged"),
    ("features kept", "not finite", put("features/*", lambda content: content[:-4] + b"\xff\xff\xff\xff"), "delete it"),
    ("notebook", "brackets", put("notebooks/*.ipynb", BRACKETS), "not a notebook"),
    ("list of viewpoints", "infinite", put("viewpoints.csv", instead(b"30.5", b"-inf")), ""),
    ("run that is drawn", "a list", put("run/result.json", b"[]"), ""),
)
CASES = (*(Case("CAD model", *case) for case in CAD), *(Case(*case) for case in (*DATA, *ARRAYS, *OWN)))
