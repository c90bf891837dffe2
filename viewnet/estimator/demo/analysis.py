"""What the page shows of one image, and the facts about the network beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from viewnet.estimator import ViewpointEstimator, inputs, preprocess
from viewnet.estimator.inputs import ImageLike
from viewnet.estimator.preprocess import Prepared
from viewnet.estimator.viewpoints import Viewpoint
from viewnet.geometry import look_at, view_vector
from viewnet.model import rendering
from viewnet.model.reconstruction import Encoded

SIZE = 256
"""Pixels along a side of rendered images, about."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """What a network predicts and renders for one image.

    viewpoint        as of ViewpointEstimator.predict
    prepared         the image as the network sees it
    reconstruction   (S, S, 3) uint8, rendered from the predicted viewpoint
    encoded         the encoded object, for `novel_view`
    notes            reasons not to trust the prediction, a sentence each
    """

    viewpoint: Viewpoint
    prepared: Prepared
    reconstruction: np.ndarray
    encoded: Encoded
    notes: tuple[str, ...]

    @property
    def input(self) -> np.ndarray:
        """(S, S, 3) uint8, what the network sees of the image."""
        return rendering.to_uint8(self.prepared.images)[0]


def analyse(estimator: ViewpointEstimator, image: ImageLike, mask: Any = None, box: Any = None) -> Analysis:
    """Analyse one image. ViewnetError for an image, mask or box that cannot be used."""
    framing = estimator.framing
    given = inputs.read_image(image, mask, inputs.boxes_of([box], 1)[0])
    prepared = preprocess.prepare([preprocess.crop_to_object(given, framing)], framing, estimator.device)
    with torch.no_grad():
        encoded = Encoded(*estimator.network.encode(prepared.appearance, background=prepared.background))
    notes = []
    if box is None and not prepared.masked[0]:
        notes.append("Neither box nor mask was given: the whole image is taken for the object.")
    if framing.cutout and not prepared.cutout[0]:
        notes.append("This model has only seen cut-out objects on black: give a mask or a transparent image.")
    elif framing.rendered and (mask is not None or box is not None):
        notes.append(
            "This model was trained on whole views as a rendering camera frames them: its predictions for images that "
            "are cut are unreliable."
        )
    reconstruction = estimator.reconstruct(prepared, size=_size(estimator))[0]
    return Analysis(estimator.predict(prepared)[0], prepared, reconstruction, encoded, tuple(notes))


def novel_view(estimator: ViewpointEstimator, encoded: Encoded, azimuth: float, elevation: float) -> np.ndarray:
    """(S, S, 3) uint8: an encoded object from another viewpoint, as ViewpointEstimator.novel_view renders it."""
    angles = (torch.tensor([value], dtype=torch.float64) for value in (azimuth, elevation))
    pose = estimator.in_own_frame(look_at(view_vector(*angles)))
    image: np.ndarray = estimator.displayed(estimator.render(encoded, pose, _size(estimator)))[0]
    return image


def model_facts(estimator: ViewpointEstimator) -> list[str]:
    """What to know of the network when reading its predictions: a sentence each, in Markdown."""
    config = estimator.config
    facts = [
        f"It was trained on the category **{config.category}** only, and gives a prediction for any image.",
        f"Recipe `{config.recipe}`, profile `{config.profile}`, variant `{config.variant}`, seed {config.seed}; "
        f"run {estimator.about.get('key', 'unknown')}.",
    ]
    if scores := (estimator.about.get("metrics") or {}).get("procrustes"):
        accuracy = f"{scores['acc30']:.1f} % of its predictions are within 30 degrees"
        facts.append(
            f"On {scores['images']} test views of objects not used in training, {accuracy}; the median error is "
            f"{scores['median']:.1f} degrees. On other images it may do worse."
        )
    else:
        facts.append("It was not scored: its accuracy is unknown.")
    facts.append(
        "Azimuth 0 shows the object's front and 90 its left side; elevation is the height above the horizon."
        if estimator.aligned
        else "**It is not aligned.** Azimuth 0 and up of its own frame are arbitrary: only differences between "
        "viewpoints mean anything."
    )
    if estimator.framing.rendered:
        facts.append(
            "It was trained on whole views, as a rendering camera frames them; for other images its predictions are "
            "unreliable: for photographs train one with the recipe `photos`."
        )
    elif estimator.framing.cutout:
        facts.append("It was trained on cut-out objects: give a mask, or an image with transparency.")
    return facts


def _size(estimator: ViewpointEstimator) -> int | None:
    """A whole multiple of the size that the network renders."""
    trained = estimator.network.config.render_size
    return max(1, round(SIZE / trained)) * trained
