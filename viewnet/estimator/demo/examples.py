"""Images to try a trained network on: built-in CAD models that it has not seen, from viewpoints that are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image

from viewnet.config import CATEGORIES
from viewnet.data.crop import Box, bounds
from viewnet.data.synthetic import scenes
from viewnet.data.synthetic.pascal3d_standin import built_in_mesh
from viewnet.estimator import ViewpointEstimator
from viewnet.render import render_mesh

VIEWPOINTS = ((35.0, 15.0), (140.0, 10.0), (250.0, 25.0), (320.0, 5.0))
"""Azimuth and elevation in degrees, of a model each."""
SEED = 2000
"""Of the models: not those that are trained on, nor those of the stand-ins for photographs."""
SIZE = 256
WIDE, HIGH = 400, 300


@dataclass(frozen=True, eq=False)
class Example:
    """An image, its object's box where it needs one, and the viewpoint that it was drawn from."""

    image: Image.Image
    box: Box | None
    azimuth: float
    elevation: float


def rendered(estimator: ViewpointEstimator) -> list[Example]:
    """Images as the network was trained to see them: cut out, or before a background with the object's box.

    None of a category that is not built in.
    """
    category, framing = estimator.config.category, estimator.framing
    if category not in CATEGORIES:
        return []
    found = []
    for number, (azimuth, elevation) in enumerate(VIEWPOINTS):
        mesh = built_in_mesh(category, number, SEED)
        view = render_mesh(mesh, np.array([azimuth]), np.array([elevation]), SIZE, 2)[0]
        image, box = Image.fromarray(view), None
        if not framing.cutout:
            image, box = _before(image, np.random.default_rng([SEED, number]))
        found.append(Example(image, box, azimuth, elevation))
    return found


def _before(view: Image.Image, rng: np.random.Generator) -> tuple[Image.Image, Box]:
    """A view somewhere before a drawn background, and its object's box."""
    scenery = Image.fromarray(scenes.draw(rng, WIDE, HIGH))
    place = (int(rng.integers(WIDE - SIZE)), int(rng.integers(HIGH - SIZE)))
    scenery.paste(view, place, view)
    x0, y0, x1, y1 = bounds(np.array(view.getchannel("A")))
    return scenery, (x0 + place[0], y0 + place[1], x1 + place[0], y1 + place[1])
