from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.estimators import PHOTOS, SQUARE, photograph, untrained
from helpers.untrained_models import turned
from PIL import Image

from viewnet.data.crop import bounds
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.estimator.demo import analysis, examples
from viewnet.estimator.demo.box_picker import SHOWN, Chosen, box_of, box_text
from viewnet.geometry import vector_angle, view_vector

BOX = (10.0, 8.0, 70.0, 50.0)


@pytest.mark.parametrize("overrides", [{}, SQUARE, PHOTOS], ids=["whole", "square", "photos"])
def test_an_inspection_is_what_the_estimator_says_and_draws(overrides):
    estimator, image = untrained(rotation=turned(40), **overrides), photograph()
    mask = np.zeros(image.shape[:2], bool)
    mask[15:40, 20:60] = True
    for alpha, box in ((None, None), (None, BOX), (mask, None), (mask, BOX)):
        found = analysis.inspect(estimator, image, alpha, box)
        given = ([image], None if alpha is None else [alpha], None if box is None else [box])
        said = estimator.predict(*given)[0]
        assert (found.viewpoint.azimuth, found.viewpoint.elevation) == (said.azimuth, said.elevation)
        assert np.array_equal(found.viewpoint.probabilities, said.probabilities)
        drawn = analysis.novel_view(estimator, found.encoded, 70, -10)
        again = estimator.novel_view(image, 70, -10, *given[1:], size=len(drawn))[0]
        assert np.abs(drawn.astype(int) - again).max() <= 1
        assert np.array_equal(found.posed, estimator.reconstruct(*given, size=len(found.posed))[0])
    assert len({analysis.inspect(estimator, image, None, box).seen.tobytes() for box in (None, BOX)}) == 2


def test_what_speaks_against_an_answer_is_said():
    def notes(estimator, **known):
        return " ".join(analysis.inspect(estimator, photograph(), **known).notes)

    photos, cutouts, whole = untrained(**PHOTOS), untrained(**SQUARE), untrained()
    mask = np.ones(photograph().shape[:2], bool)
    assert "whole image" in notes(photos)
    assert notes(photos, box=BOX) == notes(photos, mask=mask) == ""
    assert "cut out" in notes(cutouts, box=BOX)
    assert notes(cutouts, mask=mask) == ""
    assert "rendering camera" in notes(whole, mask=mask)
    transparent = np.dstack([photograph(), np.full(mask.shape, 255, np.uint8)])
    transparent[:5, :, 3] = 0
    assert analysis.inspect(whole, transparent).notes == ()


def test_what_the_model_is_is_said():
    config = untrained(**PHOTOS).config
    network = untrained(**PHOTOS).network
    scores = {"images": 40, "acc30": 81.25, "median": 12.5}
    scored = ViewpointEstimator(network, config, np.eye(3), {"key": "0123456789ab", "metrics": {"procrustes": scores}})
    told = " ".join(analysis.about(scored))
    for part in ("car", "`photos`", "0123456789ab", "81.2 %", "12.5 degrees", "90 its left side"):
        assert part in told
    own = " ".join(analysis.about(ViewpointEstimator(network, config)))
    assert "not aligned" in own
    assert "left side" not in own
    assert "not scored" in own
    assert "recipe `photos`: " not in " ".join(analysis.about(untrained(**SQUARE)))
    assert "rendering camera" in " ".join(analysis.about(untrained()))


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({"box": (100, 0, 120, 30)}, "^box has no part in the image"),
        ({"box": (30, 0, 20, 30)}, "^box .*x0 below x1"),
        ({"mask": np.zeros((60, 90), bool)}, "^mask is empty"),
        ({"mask": np.ones((60, 91), bool)}, "^mask is 91 x 60"),
    ],
)
def test_what_cannot_be_looked_at_is_said(known, message):
    with pytest.raises(ViewnetError, match=message):
        analysis.inspect(untrained(**PHOTOS), photograph(), **known)


def test_two_clicks_in_any_order_are_a_box_in_the_images_pixels(tmp_path):
    width, height = 2 * SHOWN, 1500
    Image.new("RGB", (width, height)).save(tmp_path / "a.png")
    chosen = Chosen.of(tmp_path / "a.png", "a.png")
    assert chosen.size == (width, height)
    assert chosen.display.size == (SHOWN, 750)
    begun, box = chosen.clicked(400, 50)
    assert (begun.corner, box) == ((800, 100), None)
    ended, box = begun.clicked(100, 300)
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
    chosen = Chosen.of(tmp_path / "turned.png", "turned.png")
    assert chosen.image().tobytes() == image.tobytes()
    assert chosen.display.size == (SHOWN, round(SHOWN * 60 / 90))
    assert np.abs(np.asarray(chosen.display.resize(image.size)).astype(int) - image).max() < 8
    cut = np.dstack([photograph(), np.zeros((60, 90), np.uint8)])
    cut[:30, :, 3] = 255
    Image.fromarray(cut).save(tmp_path / "cut.png")
    display = Chosen.of(tmp_path / "cut.png", "cut.png").display
    white = (np.asarray(display) == 255).all(-1)
    edge = display.height // 2
    assert white[edge + 30 :].all()
    assert not white[: edge - 30].any()


def test_grey_of_16_bits_is_shown_as_grey(tmp_path):
    Image.fromarray(np.linspace(0, 65535, 6400).astype(np.uint16).reshape(80, 80)).save(tmp_path / "grey.png")
    display = np.asarray(Chosen.of(tmp_path / "grey.png", "grey.png").display)
    assert display[0].mean() < 10 < 120 < display[512].mean() < 136 < 245 < display[-1].mean()


def test_a_file_that_is_no_image_is_named_as_its_sender_knows_it(tmp_path):
    (tmp_path / "upload0").write_text("no image")
    with pytest.raises(ViewnetError, match=r"^image notes\.txt does not decode"):
        Chosen.of(tmp_path / "upload0", "notes.txt")
    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    chosen = Chosen.of(tmp_path / "a.png", "car.png")
    (tmp_path / "a.png").unlink()
    with pytest.raises(ViewnetError, match=r"^no such image car\.png"):
        chosen.image()


def test_a_box_is_typed_as_four_edges_or_none():
    assert box_of("  ") is None
    assert box_of("0 1 2.5 3") == box_of("0, 1, 2.5, 3") == (0, 1, 2.5, 3)
    assert box_of(box_text(BOX)) == BOX
    assert box_of(box_text(None)) is None
    for text in ("1 2 3", "1 2 3 4 5", "left 0 1 2"):
        with pytest.raises(ViewnetError, match=r"^box '.*': expected its left, top, right and bottom edge"):
            box_of(text)


def test_examples_are_drawn_as_the_network_was_trained_to_see_them():
    cutouts, photographs = examples.rendered(untrained()), examples.rendered(untrained(**PHOTOS))
    assert len(cutouts) == len(photographs) == len(examples.VIEWPOINTS)
    assert len({example.image.tobytes() for example in cutouts}) == len(cutouts)
    for cutout, photo in zip(cutouts, photographs, strict=True):
        assert (cutout.azimuth, cutout.elevation) == (photo.azimuth, photo.elevation)
        alpha = np.array(cutout.image.getchannel("A"))
        assert cutout.box is None
        assert alpha.min() == 0
        x0, y0, x1, y1 = photo.box
        assert (x1 - x0, y1 - y0) == tuple(np.subtract(bounds(alpha)[2:], bounds(alpha)[:2]))
        inside = photo.image.crop((int(x0), int(y0), int(x1), int(y1)))
        object_alone = cutout.image.crop(tuple(int(edge) for edge in bounds(alpha)))
        solid = np.array(object_alone.getchannel("A")) == 255
        assert np.array_equal(np.asarray(inside)[solid], np.asarray(object_alone.convert("RGB"))[solid])


def test_examples_viewpoints_differ():
    azimuth, elevation = torch.tensor(examples.VIEWPOINTS, dtype=torch.float64).T
    vectors = view_vector(azimuth, elevation)
    apart = vector_angle(vectors[:, None], vectors[None])
    assert apart[~torch.eye(len(vectors), dtype=torch.bool)].min() > 45
