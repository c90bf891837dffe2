"""A model whose confidences are true on photographs: the selection's logits divided by a fitted temperature."""

import numpy as np

from viewnet.data import build
from viewnet.errors import ViewnetError
from viewnet.estimator.pretrained import Pretrained
from viewnet.estimator.viewpoints import Viewpoints
from viewnet.evaluation.confidence import temperature
from viewnet.evaluation.metrics import geodesic_error
from viewnet.evaluation.predict import predict
from viewnet.experiments.parameters import folder_named
from viewnet.experiments.photos import photographs


def calibrate(model: Pretrained, data_root: str) -> None:
    """Fit a temperature to what `model` has right of the calibration split of photographs.

    Nothing but its confidences changes. Raises ViewnetError for a model without a rotation of its own, for a single
    hypothesis, and for photographs that cannot be read or have no calibration split.
    """
    model.require_viewnet("calibrating confidences")
    rotation, config = model.annotated_from_model, model.config
    if rotation is None or config.model.heads == 1:
        why = "no rotation to the annotated frame" if rotation is None else "a single hypothesis, always of 100 %"
        raise ViewnetError(f"calibrating confidences: the model has {why}: calibrate another one")
    root, square = folder_named(data_root, "calibrate"), config.model.crop != "stretched"
    store = build.photo_views(photographs(config.category, root, square, smoke=False))
    if not (store.index["split"] == "val").any():
        raise ViewnetError(f"{data_root}: has no calibration split: mark some photographs val in its list")
    said = predict(model.network, store, ("val",), config=config)
    ups = None if said.ups is None else said.ups @ rotation.T
    viewpoints = Viewpoints.of(said.hypotheses @ rotation.T, said.logits, ups, aligned=True)
    right = geodesic_error(viewpoints.vector, said.truth) < 30
    value = temperature(viewpoints.hypothesis_frames, said.logits, right)
    model.network.viewpoint.divide_logits(value)
    found = {"images": len(right), "right": 100 * float(np.mean(right)), "temperature": round(value, 3)}
    model.about["calibrated"] = found
