from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.estimators import PHOTOS, photograph, untrained
from PIL import Image

from viewnet.data.crop import bounds
from viewnet.errors import ViewnetError
from viewnet.estimator.demo import examples
from viewnet.geometry import vector_angle, view_vector


def test_examples_are_drawn_as_the_network_was_trained_to_see_them():
    cutouts, photographs = examples.rendered(untrained()), examples.rendered(untrained(**PHOTOS))
    assert len(cutouts) == len(photographs) == len(examples.VIEWPOINTS)
    assert len({example.image.tobytes() for example in cutouts}) == len(cutouts)
    for cutout, photo in zip(cutouts, photographs, strict=True):
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


def test_own_images_are_offered_as_they_are(tmp_path):
    file = tmp_path / "street.png"
    Image.fromarray(photograph()).save(file)
    (shown,) = examples.of_files([str(file)])
    assert np.array_equal(np.asarray(shown.image), photograph())
    assert (shown.box, shown.drawn) == (None, False)
    with pytest.raises(ViewnetError, match=r"image .*nowhere\.png"):
        examples.of_files([str(tmp_path / "nowhere.png")])
