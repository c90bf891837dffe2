from __future__ import annotations

import numpy as np
import pytest
from helpers.estimators import PHOTOS, SQUARE, photograph, untrained
from helpers.untrained_models import turned

from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.estimator.demo import analysis

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
    assert "cut-out" in notes(cutouts, box=BOX)
    assert notes(cutouts, mask=mask) == ""
    assert "rendering camera" in notes(whole, mask=mask)
    transparent = np.dstack([photograph(), np.full(mask.shape, 255, np.uint8)])
    transparent[:5, :, 3] = 0
    assert analysis.analyse(whole, transparent).notes == ()


def test_facts_about_the_model():
    config = untrained(**PHOTOS).config
    network = untrained(**PHOTOS).network
    scores = {"images": 40, "acc30": 81.25, "median": 12.5}
    scored = ViewpointEstimator(network, config, np.eye(3), {"key": "0123456789ab", "metrics": {"procrustes": scores}})
    told = analysis.model_facts(scored)
    for part in ("car", "`photos`", "0123456789ab", "81.2 %", "12.5 degrees", "90 its left side"):
        assert part in told
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
