"""One image looked at by a trained network, all that a page shows of it; and what is to be known of the network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from viewnet.estimator import ViewpointEstimator, inputs, preprocess
from viewnet.estimator.inputs import Given, ImageLike
from viewnet.estimator.viewpoints import Viewpoint
from viewnet.geometry import look_at, view_vector
from viewnet.model import rendering
from viewnet.model.reconstruction import Encoded

SIZE = 256
"""Pixels along a side of what is drawn for people, about."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a network says and shows of one image.

    viewpoint   as ViewpointEstimator.predict has it
    seen        (S, S, 3) uint8, the image as the network sees it
    posed       (D, D, 3) uint8, its reconstruction from the predicted viewpoint
    encoded    what the object became, for `novel_view`
    notes       what speaks against trusting the answer, a sentence each
    """

    viewpoint: Viewpoint
    seen: np.ndarray
    posed: np.ndarray
    encoded: Encoded
    notes: tuple[str, ...]


def inspect(estimator: ViewpointEstimator, image: ImageLike, mask: Any = None, box: Any = None) -> Inspection:
    """Look at one image. Raises ViewnetError as ViewpointEstimator.predict does, without an image's number."""
    given = inputs.opened(image, mask, inputs.boxes_of([box], 1)[0])
    view = preprocess.viewed(given, estimator.framing)
    shown = preprocess.shown([view], estimator.framing, estimator.device)
    known = ([image], None if mask is None else [mask], None if box is None else [box])
    with torch.no_grad():
        encoded = Encoded(*estimator.network.encode(shown.object, background=shown.behind))
    return Inspection(
        estimator.predict(*known)[0],
        rendering.to_uint8(shown.images)[0],
        estimator.reconstruct(*known, size=_size(estimator))[0],
        encoded,
        tuple(_notes(estimator, given, view.cutout, mask is not None)),
    )


def novel_view(estimator: ViewpointEstimator, encoded: Encoded, azimuth: float, elevation: float) -> np.ndarray:
    """(S, S, 3) uint8: as ViewpointEstimator.novel_view, of an object that has been encoded already."""
    angles = (torch.tensor([value], dtype=torch.float64) for value in (azimuth, elevation))
    frames = estimator.in_own_frame(look_at(view_vector(*angles)))
    found: np.ndarray = estimator.displayed(estimator.render(encoded, frames, _size(estimator)))[0]
    return found


def about(estimator: ViewpointEstimator) -> list[str]:
    """What a reader of answers is to know of the network, a sentence each, in Markdown."""
    config = estimator.config
    scores = (estimator.about.get("metrics") or {}).get("procrustes")
    told = [
        f"It knows the category **{config.category}** alone, and answers for any image.",
        f"Recipe `{config.recipe}`, profile `{config.profile}`, variant `{config.variant}`, seed {config.seed}; "
        f"run {estimator.about.get('key', 'unknown')}.",
    ]
    if scores:
        told.append(
            f"On {scores['images']} test views of objects that it had not seen it is within 30 degrees on "
            f"{scores['acc30']:.1f} %; its median error is {scores['median']:.1f} degrees. On other images it may do "
            "worse."
        )
    else:
        told.append("It was not scored: nothing is known of how often it is right.")
    told.append(
        "Azimuth 0 shows the object's front and 90 its left side; elevation is the height above the horizon."
        if estimator.aligned
        else "**It is not aligned.** Azimuth 0 and up are those of its own frame, and arbitrary: only differences "
        "between viewpoints tell something."
    )
    if estimator.framing.rendered:
        told.append(
            "It sees whole views, as a rendering camera frames them; of other images its answers are worth little: "
            "for photographs train one with the recipe `photos`."
        )
    elif estimator.framing.cutout:
        told.append("It was trained on objects cut out: give a mask, or an image with transparency.")
    return told


def _notes(estimator: ViewpointEstimator, given: Given, cutout: bool, masked: bool) -> list[str]:
    notes = []
    if given.mask is None and given.box is None:
        notes.append("Neither box nor mask was given: the whole image is taken for the object.")
    if estimator.framing.cutout and not cutout:
        notes.append("This model has only seen objects cut out, before black: give a mask or a transparent image.")
    elif estimator.framing.rendered and (masked or given.box is not None):
        notes.append(
            "This model knows whole views as a rendering camera frames them: of an image that is cut its answer is "
            "worth little."
        )
    return notes


def _size(estimator: ViewpointEstimator) -> int | None:
    """A whole multiple of the size that was learned."""
    learned = estimator.network.config.render_size
    return max(1, round(SIZE / learned)) * learned
