"""Lists as spreadsheets write them: separators, marks, decimal commas, names in any form."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from viewnet.data.catalogue import check
from viewnet.data.readers import photo_folder, video_folder
from viewnet.errors import ViewnetError
from viewnet.runtime.lists import read_list

PHOTOGRAPH = np.zeros((8, 12, 3), np.uint8)
PLAIN = ["file,azimuth_deg,elevation_deg,split", "été.jpg,250.5,25.5,val", "b.jpg,10,-5,test"]
SEMICOLONS = [line.replace(",", ";").replace(".5", ",5") for line in PLAIN]
LISTS = {
    "plain": "\n".join(PLAIN).encode(),
    "byte order mark and CRLF": "\r\n".join(PLAIN).encode("utf-8-sig"),
    "semicolons and decimal commas": "\r\n".join(SEMICOLONS).encode("utf-8-sig"),
    "powers of ten": "\n".join(SEMICOLONS).replace("25,5", "2,55E+01").encode(),
    "tabs": "\n".join(SEMICOLONS).replace(";", "\t").encode(),
    "UTF-16 with tabs": "\r\n".join(PLAIN).replace(",", "\t").encode("utf-16"),
    "a line for Excel": "\n".join(["sep=;", *SEMICOLONS]).encode(),
    "line ends of old": "\r".join(PLAIN).encode(),
    "everything quoted": "\n".join('"' + line.replace(",", '","') + '"' for line in PLAIN).encode(),
    "decimal commas in quotes": "\n".join([PLAIN[0], 'été.jpg,"250,5","25,5",val', PLAIN[2]]).encode(),
    "empty rows and columns": "\n".join([PLAIN[0] + ",,", PLAIN[1] + ",,", ",,,,,", "", PLAIN[2]]).encode(),
    "blanks": "\n".join(line.replace(",", " , ") for line in PLAIN).encode(),
    "decomposed": unicodedata.normalize("NFD", "\n".join(PLAIN)).encode(),
    "composed": unicodedata.normalize("NFC", "\n".join(PLAIN)).encode(),
    "folder before names": "\n".join(PLAIN).replace("b.jpg", "images/b.jpg").replace("été", "images/été").encode(),
    "folder as in Windows": "\n".join(PLAIN).replace("b.jpg", "images\\b.jpg").encode(),
}


def written(folder: Path, content: bytes, form: str = "NFC") -> Path:
    (folder / "images").mkdir()
    for grey, name in enumerate(("été.jpg", "b.jpg")):  # they differ: one photograph in both splits is refused
        Image.fromarray(PHOTOGRAPH + np.uint8(200 * grey)).save(folder / "images" / unicodedata.normalize(form, name))
    (folder / "viewpoints.csv").write_bytes(content)
    return folder


@pytest.mark.parametrize("form", ["NFC", "NFD"])
@pytest.mark.parametrize("name", LISTS)
def test_a_list_is_read_as_any_spreadsheet_writes_it(name, form, tmp_path):
    first, second = photo_folder.read(written(tmp_path, LISTS[name], form), "car")
    assert (first.azimuth, first.elevation, first.split) == (250.5, 25.5, "val")
    assert (second.azimuth, second.elevation, second.split) == (10, -5, "test")
    assert first.image_path.is_file() and second.image_path.is_file()
    found = check(tmp_path)
    assert found.counts == {"": {"objects to calibrate": 1, "objects to score": 1}} and not found.problems


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["a.jpg,250,5,25,5,val"], r"line 2: 6 values in 4 columns: put values with ',' in them into quotes"),
        ([PLAIN[1], '"b.jpg","10,125","5",val'], r"line 3: azimuth_deg '10,125': may mean thousands or thousandths"),
        (['"a.jpg,1,2,val', PLAIN[1], PLAIN[2]], r"line 2: not a readable CSV file"),
        (["\\etc\\a.jpg,1,2,val"], r"line 2: file '/etc/a.jpg': expected the name of an image in images/"),
        (["", "a.jpg,1.234,5°,val"], r"line 3: elevation_deg '5°': expected a number"),
    ],
)
def test_an_ambiguous_line_is_named(lines, message, tmp_path):
    folder = written(tmp_path, "\n".join([PLAIN[0], *lines]).encode())
    with pytest.raises(ViewnetError, match=rf"viewpoints\.csv: {message}"):
        photo_folder.read(folder, "car")


def test_lists_that_are_none_are_refused_by_name(tmp_path):
    written(tmp_path, b"file azimuth_deg elevation_deg split\na 1 2 val")
    with pytest.raises(ViewnetError, match=r"column 'file' is missing: .* separated by commas, semicolons or tabs"):
        photo_folder.read(tmp_path, "car")
    (tmp_path / "viewpoints.csv").write_bytes("file,azimuth_deg,elevation_deg,split\nété,1,2,val".encode("cp1252"))
    with pytest.raises(ViewnetError, match=r"not a readable CSV file .*: save it as CSV UTF-8"):
        photo_folder.read(tmp_path, "car")
    (tmp_path / "viewpoints.csv").write_bytes("\n".join(PLAIN).replace(".jpg", ".png").encode())
    assert check(tmp_path).problems == ["2 left out: no such image: été.png and 1 more"]


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no /dev/zero here")
def test_a_device_without_an_end_is_refused():
    with pytest.raises(ViewnetError, match="/dev/zero: is a device: name a file"):
        read_list(Path("/dev/zero"), ["image"])


def test_names_of_clips_have_any_form(tmp_path):
    for name in ("été", "b"):
        (tmp_path / unicodedata.normalize("NFD", name)).mkdir()
        Image.fromarray(PHOTOGRAPH).save(tmp_path / unicodedata.normalize("NFD", name) / "0.png")
    (tmp_path / "splits.csv").write_bytes("clip;split\r\nété;train\r\nb;val\r\n".encode("utf-8-sig"))
    clips, rejected = video_folder.read(tmp_path, "car")
    assert [clip.split for clip in clips] == ["val", "train"] and not rejected


def test_a_header_without_end_is_refused_by_name(tmp_path):
    for header in ("a" * 200_000, '"file', "file,azimuth_deg,elevation_deg,split,file"):
        (tmp_path / "viewpoints.csv").write_text(f"{header}\n")
        with pytest.raises(ViewnetError, match=r"^.*/viewpoints\.csv: (line 2: not a|column '\w+' is)"):
            photo_folder.read(tmp_path, "car")
