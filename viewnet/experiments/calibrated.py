"""A model whose confidences are true on photographs: the selection's logits divided by a fitted temperature."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from viewnet.data import build
from viewnet.errors import ViewnetError
from viewnet.estimator.pretrained import Pretrained
from viewnet.estimator.viewpoints import Viewpoints
from viewnet.evaluation.alignment import Procrustes
from viewnet.evaluation.confidence import Floats, temperature
from viewnet.evaluation.evaluate import Aligned
from viewnet.evaluation.metrics import geodesic_error
from viewnet.evaluation.predict import predict
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.symmetry import symmetry
from viewnet.experiments.parameters import folder_named
from viewnet.experiments.photos import photographs

Answers = tuple[Floats, NDArray[np.bool_]]
"""Confidences (N,), and whether each viewpoint is within 30 degrees."""


STAND_IN = "stand-in"
"""In the place of a folder: the project's stand-in for photographs."""


def calibrate(model: Pretrained, data_root: str) -> None:
    """Fit a temperature to what `model` has right of the calibration split of photographs, or of STAND_IN.

    Nothing but its confidences changes. Raises ViewnetError for a model without a rotation of its own, for a single
    hypothesis, and for photographs that cannot be read or have no calibration split.
    """
    model.require_viewnet("calibrating confidences")
    config = model.config
    if model.annotated_from_model is None or config.model.heads == 1:
        none = model.annotated_from_model is None
        why = "no rotation to the annotated frame" if none else "a single hypothesis, always of 100 %"
        raise ViewnetError(f"calibrating confidences: the model has {why}: calibrate another one")
    root = None if data_root == STAND_IN else folder_named(data_root, "calibrate")
    square = config.model.crop != "stretched"
    store = build.photo_views(photographs(config.category, root, square, smoke=False))
    if not (store.index["split"] == "val").any():
        raise ViewnetError(f"{data_root}: has no calibration split: mark some photographs val in its list")
    said = turned(predict(model.network, store, ("val",), config=config), model.annotated_from_model)
    viewpoints, turns = Viewpoints.of(said.hypotheses, said.logits, said.ups, True), symmetry(config.category).turns
    right = geodesic_error(viewpoints.vector, said.truth, turns=turns) < 30
    value = temperature(viewpoints.hypothesis_frames, said.logits, right, turns)
    model.network.viewpoint.divide_logits(value)
    found = {"images": len(right), "right": 100 * float(np.mean(right)), "temperature": round(value, 3)}
    model.about["calibrated"] = found | {"stand_in": root is None}


def turned(said: Predictions, rotation: NDArray[np.float64]) -> Predictions:
    """Predictions in another frame, to which `rotation` (3, 3) takes the one they are in."""
    ups = None if said.ups is None else said.ups @ rotation.T
    return replace(said, hypotheses=said.hypotheses @ rotation.T, ups=ups)


def answers(aligned: Aligned) -> Answers:
    """How sure aligned predictions are, and which are right, up to their category's symmetry."""
    said, turns = aligned.predictions, symmetry(aligned.predictions.ids["category"].iloc[0]).turns
    if isinstance(aligned.alignment, Procrustes):
        said = turned(said, aligned.alignment.rotation)
    sure = Viewpoints.of(said.hypotheses, said.logits, said.ups, True, turns).confidence  # (N,)
    return sure, aligned.alike < 30
