"""The support of an alignment: firm where images determine it, low where it does not help others of them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.evaluation_data import make_index
from scipy.spatial.transform import Rotation

from viewnet.evaluation.predictions import Predictions, true_vectors
from viewnet.evaluation.support import support


def predictions(models: int, views: int = 1, noise: float = 0.1) -> Predictions:
    index = make_index(models, views, splits=(("val", 1.0),))
    said = true_vectors(index) + np.random.default_rng(0).normal(scale=noise, size=(len(index), 3))
    said /= np.linalg.norm(said, axis=1, keepdims=True)
    return Predictions(index, said[:, None], np.zeros((len(index), 1)))


@pytest.mark.parametrize("kind", ["procrustes", "robust", "linear"])
def test_what_images_determine_is_right_on_others_of_them(kind):
    found = support(predictions(200), kind)
    assert found["acc30"] > 95
    assert (found["uncertainty"] is None) == (kind == "linear")
    assert kind == "linear" or found["uncertainty"] < 5


def test_fewer_images_determine_less():
    many, few = (support(predictions(count, noise=0.3), "procrustes") for count in (200, 8))
    assert few["uncertainty"] > 2 * many["uncertainty"] and few["acc30"] < many["acc30"]


def test_an_object_s_own_views_do_not_speak_for_a_fit():
    said, rng = predictions(12, views=20), np.random.default_rng(0)
    each = Rotation.from_rotvec(np.outer(2 * np.pi * rng.random(12), [0, 0, 1])).as_matrix()  # a frame for each object
    turned = (said.hypotheses.reshape(12, 20, 3) @ each).reshape(-1, 1, 3)
    assert support(type(said)(said.ids, turned, said.logits), "procrustes")["acc30"] < 50


def test_the_own_rotation_is_scored_as_it_is():
    found = support(predictions(40), "none")
    assert found["acc30"] > 90 and found["uncertainty"] is None
