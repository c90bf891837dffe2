from __future__ import annotations

import numpy as np
import pytest
from helpers.estimators import photograph
from PIL import Image

from viewnet.errors import ViewnetError
from viewnet.estimator.demo.box_picker import SHOWN, BoxPicker, format_box, parse_box

BOX = (10.0, 8.0, 70.0, 50.0)


def test_two_clicks_in_any_order_are_a_box_in_the_images_pixels(tmp_path):
    width, height = 2 * SHOWN, 1500
    Image.new("RGB", (width, height)).save(tmp_path / "a.png")
    chosen = BoxPicker.of(tmp_path / "a.png", "a.png")
    assert chosen.size == (width, height)
    assert chosen.display.size == (SHOWN, 750)
    begun, box = chosen.click(400, 50)
    assert (begun.corner, box) == ((800, 100), None)
    ended, box = begun.click(100, 300)
    assert (ended.corner, box) == (None, (200, 100, 800, 600))
    assert begun.clear().corner is None
    coloured = np.asarray(ended.shown(box)).any(-1)
    y, x = np.nonzero(coloured)
    frame = 2 * max(2, SHOWN // 150)
    assert np.allclose((x.min(), y.min(), x.max(), y.max()), (100, 50, 400, 300), atol=frame)
    assert not coloured[50 + frame : 300 - frame, 100 + frame : 400 - frame].any()
    assert np.asarray(begun.shown())[50, 400].any()
    assert not np.asarray(ended.shown()).any()


def test_images_are_shown_upright_and_transparency_white(tmp_path):
    image = Image.fromarray(photograph())
    exif = Image.Exif()
    exif[0x0112] = 6
    image.transpose(Image.Transpose.ROTATE_90).save(tmp_path / "turned.png", exif=exif)
    chosen = BoxPicker.of(tmp_path / "turned.png", "turned.png")
    assert chosen.image().tobytes() == image.tobytes()
    assert chosen.display.size == (SHOWN, round(SHOWN * 60 / 90))
    assert np.abs(np.asarray(chosen.display.resize(image.size)).astype(int) - image).max() < 8
    cut = np.dstack([photograph(), np.zeros((60, 90), np.uint8)])
    cut[:30, :, 3] = 255
    Image.fromarray(cut).save(tmp_path / "cut.png")
    display = BoxPicker.of(tmp_path / "cut.png", "cut.png").display
    white = (np.asarray(display) == 255).all(-1)
    edge = display.height // 2
    assert white[edge + 30 :].all()
    assert not white[: edge - 30].any()


def test_grey_of_16_bits_is_shown_as_grey(tmp_path):
    Image.fromarray(np.linspace(0, 65535, 6400).astype(np.uint16).reshape(80, 80)).save(tmp_path / "grey.png")
    display = np.asarray(BoxPicker.of(tmp_path / "grey.png", "grey.png").display)
    assert display[0].mean() < 10 < 120 < display[512].mean() < 136 < 245 < display[-1].mean()


def test_a_file_that_is_no_image_is_named_as_its_sender_knows_it(tmp_path):
    (tmp_path / "upload0").write_text("no image")
    with pytest.raises(ViewnetError, match=r"^image notes\.txt does not decode"):
        BoxPicker.of(tmp_path / "upload0", "notes.txt")
    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    chosen = BoxPicker.of(tmp_path / "a.png", "car.png")
    (tmp_path / "a.png").unlink()
    with pytest.raises(ViewnetError, match=r"^no such image car\.png"):
        chosen.image()


def test_a_box_is_typed_as_four_edges_or_none():
    assert parse_box("  ") is None
    assert parse_box("0 1 2.5 3") == parse_box("0, 1, 2.5, 3") == (0, 1, 2.5, 3)
    assert parse_box(format_box(BOX)) == BOX
    assert parse_box(format_box(None)) is None
    for text in ("1 2 3", "1 2 3 4 5", "left 0 1 2"):
        with pytest.raises(ViewnetError, match=r"^box '.*': expected its left"):
            parse_box(text)


def test_an_image_that_is_all_length_is_shown_with_a_side_of_one_pixel(tmp_path):
    Image.new("RGB", (60_000, 2)).save(tmp_path / "long.png")
    assert BoxPicker.of(tmp_path / "long.png", "long.png").display.size == (SHOWN, 1)
