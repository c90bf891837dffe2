"""Example images for the page: files, or built-in CAD models that the network was not trained on."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from viewnet.config import CATEGORIES
from viewnet.data.crop import Box, bounds
from viewnet.data.synthetic import scenes, stand_in
from viewnet.estimator import ViewpointEstimator
from viewnet.render import render_mesh
from viewnet.runtime import image_files

VIEWPOINTS = ((35.0, 15.0), (140.0, 10.0), (250.0, 25.0), (320.0, 5.0))  # azimuth, elevation: one for each model
SEED = 2000  # of the models: other ones than in training and in the stand-ins for photographs
SIZE = 256
BACKGROUND = (400, 300)


@dataclass(frozen=True, eq=False)
class Example:
    """An image, and its object's box if it needs one."""

    image: Image.Image
    box: Box | None
    drawn: bool = True


def of_files(paths: Iterable[str]) -> list[Example]:
    """Images of files. ViewnetError naming one that cannot be read."""
    return [Example(image_files.read(Path(path), f"image {path}"), None, drawn=False) for path in paths]


def rendered(estimator: ViewpointEstimator) -> list[Example]:
    """Images of the kind the network was trained on: cut out, or over a background with the object's box.

    Empty for a category without built-in models.
    """
    category = estimator.config.category
    if category not in CATEGORIES:
        return []
    examples = []
    for number, (azimuth, elevation) in enumerate(VIEWPOINTS):
        mesh = stand_in.built_in_mesh(category, number, SEED)
        view = render_mesh(mesh, np.array([azimuth]), np.array([elevation]), SIZE, 2)[0]
        image, box = Image.fromarray(view), None
        if not estimator.framing.cutout:
            image, box = _on_background(image, np.random.default_rng([SEED, number]))
        examples.append(Example(image, box))
    return examples


def _on_background(view: Image.Image, rng: np.random.Generator) -> tuple[Image.Image, Box]:
    """A view at a random place on a random background, and its object's box."""
    width, height = BACKGROUND
    background = Image.fromarray(scenes.sample(rng, width, height))
    left, top = int(rng.integers(width - SIZE)), int(rng.integers(height - SIZE))
    background.paste(view, (left, top), view)
    x0, y0, x1, y1 = bounds(np.array(view.getchannel("A")))
    return background, (x0 + left, y0 + top, x1 + left, y1 + top)
