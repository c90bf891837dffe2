from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from helpers.estimators import PHOTOS, SQUARE, photograph, untrained
from helpers.untrained_models import turned

from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.estimator.demo import analysis
from viewnet.estimator.viewpoints import Viewpoints
from viewnet.geometry import view_vector

pytest.importorskip("gradio", reason='the page needs gradio: pip install "viewnet[demo]"')

from viewnet.estimator.demo import app

BOX = (10.0, 8.0, 70.0, 50.0)


@pytest.mark.parametrize("overrides", [{}, SQUARE, PHOTOS], ids=["whole", "square", "photos"])
def test_an_analysis_holds_what_the_estimator_gives(overrides):
    estimator, image = untrained(rotation=turned(40), **overrides), photograph()
    mask = np.zeros(image.shape[:2], bool)
    mask[15:40, 20:60] = True
    for alpha, box in ((None, None), (None, BOX), (mask, None), (mask, BOX)):
        found = analysis.analyse(estimator, image, alpha, box)
        given = ([image], None if alpha is None else [alpha], None if box is None else [box])
        said = estimator.predict(*given)[0]
        assert (found.viewpoint.azimuth, found.viewpoint.elevation) == (said.azimuth, said.elevation)
        assert np.array_equal(found.viewpoint.probabilities, said.probabilities)
        drawn = analysis.novel_view(estimator, found.encoded, 70, -10)
        again = estimator.novel_view(image, 70, -10, *given[1:], size=len(drawn))[0]
        assert np.abs(drawn.astype(int) - again).max() <= 1
        assert np.array_equal(found.reconstruction, estimator.reconstruct(*given, size=len(found.reconstruction))[0])
    assert len({analysis.analyse(estimator, image, None, box).input.tobytes() for box in (None, BOX)}) == 2


def test_notes_say_why_a_prediction_may_be_wrong():
    def notes(estimator, **known):
        return " ".join(analysis.analyse(estimator, photograph(), **known).notes)

    photos, cutouts, whole = untrained(**PHOTOS), untrained(**SQUARE), untrained()
    mask = np.ones(photograph().shape[:2], bool)
    assert "whole image" in notes(photos)
    assert notes(photos, box=BOX) == notes(photos, mask=mask) == ""
    assert "outside of the image" in notes(photos, box=(40, 0, 160, 60))
    assert "cut-out" in notes(cutouts, box=BOX)
    assert notes(cutouts, mask=mask) == ""
    assert "rendering camera" in notes(whole, mask=mask)
    transparent = np.dstack([photograph(), np.full(mask.shape, 255, np.uint8)])
    transparent[:5, :, 3] = 0
    assert analysis.analyse(whole, transparent).notes == ()


@pytest.mark.parametrize(
    ("azimuths", "shares", "other"),
    [
        ((27, 206), (0.6, 0.4), 206),
        ((206, 27), (0.6, 0.4), 27),
        ((27, 206), (0.95, 0.05), None),  # hardly likely
        ((27, 60), (0.6, 0.4), None),  # the same side
        ((27, 190, 210, 30), (0.84, 0.07, 0.06, 0.03), 190),  # likely together
    ],
)
def test_a_likely_hypothesis_of_the_other_side_puts_the_answer_in_doubt(azimuths, shares, other):
    vectors = view_vector(torch.tensor(azimuths, dtype=torch.float64), torch.full((len(azimuths),), 10.0).double())
    (viewpoint,) = Viewpoints.of(vectors[None].numpy(), np.log([shares]), None, True)
    found = viewpoint.rival
    assert (found and round(found.azimuth)) == other
    encoded = analysis.Analysis(viewpoint, *[None] * 3, ())
    told = app.answer(encoded, ())
    assert ("In doubt" in told) == (other is not None)
    assert (f"°</b> or <b>{other}.0°</b>" in told) == (other is not None)


def test_a_mesh_is_drawn_from_four_sides():
    """A cube whose sides have a colour each, from its front and on by quarters."""
    cube = trimesh.creation.box((1, 1, 1))
    cube.unmerge_vertices()
    sides = {(1, 0): (250, 0, 0), (0, 1): (0, 250, 0), (-1, 0): (0, 0, 250), (0, -1): (250, 250, 0)}
    colours = [sides.get(tuple(np.round(normal[:2]).astype(int)), (9, 9, 9)) for normal in cube.face_normals]
    cube.visual.vertex_colors = np.repeat(colours, 3, axis=0).astype(np.uint8)
    drawn = analysis.four_sides(cube, 0.0, 0.0)
    size = len(drawn) // 2
    middles = [drawn[y, x] for y in (size // 2, size * 3 // 2) for x in (size // 2, size * 3 // 2)]
    assert [tuple((middle > 60).astype(int)) for middle in middles] == [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0)]
    assert (drawn[0, 0] == 255).all()


def test_facts_about_the_model():
    config = untrained(**PHOTOS).config
    network = untrained(**PHOTOS).network
    scores = {"images": 40, "acc30": 81.25, "median": 12.5, "flips": 7.5}
    about = {"key": "0123456789ab", "metrics": {"procrustes": scores}}
    told = analysis.model_facts(ViewpointEstimator(network, config, np.eye(3), about))
    for part in ("car", "`photos`", "0123456789ab", "81.2 %", "12.5 degrees", "7.5 %", "90 its left side"):
        assert part in told
    assert "not scored on photographs" in told
    measured = {"on": "photographs of cars", "alignments": {"own": scores | {"acc30": 60.5, "images": 9}}}
    told = analysis.model_facts(ViewpointEstimator(network, config, np.eye(3), about | {"scores": [measured]}))
    assert told.index("photographs of cars (9 images), **60.5 %**") < told.index("81.2 %")
    assert "not scored" not in told
    own = analysis.model_facts(ViewpointEstimator(network, config))
    assert "not aligned" in own
    assert "left side" not in own
    assert "not scored" in own
    assert "recipe `photos`: " not in analysis.model_facts(untrained(**SQUARE))
    assert "rendering camera" in analysis.model_facts(untrained())


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({"box": (100, 0, 120, 30)}, "^box has no part in the image"),
        ({"box": (30, 0, 20, 30)}, "^box .*x0 below x1"),
        ({"mask": np.zeros((60, 90), bool)}, "^mask is empty"),
        ({"mask": np.ones((60, 91), bool)}, "^mask is 91 x 60"),
    ],
)
def test_errors_of_analysis(known, message):
    with pytest.raises(ViewnetError, match=message):
        analysis.analyse(untrained(**PHOTOS), photograph(), **known)
