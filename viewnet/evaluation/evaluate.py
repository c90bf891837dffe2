"""From predictions to numbers: one function for every predictor, fitted on validation images, scored on test images.

>>> import pandas as pd
>>> from viewnet.evaluation.predictions import true_vectors
>>> ids = pd.DataFrame({"model_id": list("abcdefgh"), "category": "car", "split": ["val", "test"] * 4, "view": 0,
...                     "azimuth": np.arange(0.0, 360, 45), "elevation": [0.0, 20, 20, 0] * 2})
>>> own = true_vectors(ids)[:, [1, 2, 0]]  # right, in a frame of its own
>>> predictions = Predictions(ids, own[:, None], np.zeros((8, 1)))
>>> [round(evaluate(predictions, kind, draws=10)["acc30"]) for kind in ("procrustes", "none")]
[100, 25]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.alignment import ALIGNMENTS, Alignment, calibration_rows
from viewnet.evaluation.predictions import Floats, Predictions


@dataclass(frozen=True)
class Aligned:
    """Test predictions in the annotated frame.

    predictions  the test rows
    alignment    the map, fitted on `calibration`
    hypotheses   (N, M, 3) mapped view vectors
    errors       (N, M) geodesic error of each hypothesis, degrees
    """

    predictions: Predictions
    calibration: Predictions
    alignment: Alignment
    hypotheses: Floats
    errors: Floats

    @property
    def selected(self) -> Floats:
        """(N, 3) view vectors of the selected hypotheses, mapped."""
        return self.hypotheses[np.arange(len(self.predictions)), self.predictions.choice]

    @property
    def selected_errors(self) -> Floats:
        """(N,) errors of the selected hypotheses: what the tables are made of."""
        return self.errors[np.arange(len(self.predictions)), self.predictions.choice]


def align(
    predictions: Predictions, alignment: str = "procrustes", calibration: int | None = None, seed: int = 0
) -> Aligned:
    """Fit on the split "val", map the split "test".

    `calibration` images (all, if None) are drawn by objects from `seed`. Raises ViewnetError where a split is missing,
    an object is in both, or there is more than one category: each has a frame of its own.
    """
    fit = ALIGNMENTS[known(alignment, ALIGNMENTS, "alignment")].fit
    val, test = predictions.subset("val"), predictions.subset("test")
    if len(categories := sorted(set(test.ids["category"]) | set(val.ids["category"]))) > 1:
        raise ViewnetError(f"evaluation: one category at a time, got {', '.join(categories)}")
    if both := set(val.objects) & set(test.objects):
        raise ViewnetError(f"evaluation: {sorted(both)[0]} is in the validation split and in the test split")
    rows = calibration_rows(val, calibration, seed)
    fitted = fit(rows.selected, rows.truth)
    hypotheses = fitted.apply(test.hypotheses)
    # An affine map of view vectors says nothing of the tilt, a rotation of the world turns the up vectors along.
    ups = fitted.apply(test.ups) if test.ups is not None and alignment in ("procrustes", "robust", "none") else None
    truth = np.repeat(test.truth[:, None], test.heads, axis=1)
    errors = metrics.geodesic_error(hypotheses, truth, ups)
    return Aligned(test, rows, fitted, hypotheses, errors)


def evaluate(
    predictions: Predictions,
    alignment: str = "procrustes",
    calibration: int | None = None,
    seed: int = 0,
    draws: int = 1000,
) -> dict[str, Any]:
    """Every measure of the predictions' test split, as plain JSON types; per cent and degrees.

    acc10 acc15 acc30  share of geodesic errors strictly below
    median, flips      median error; share of errors over 150 degrees
    dva                mean of acc30 over the azimuth bins, of 30 degrees, that are not empty
    confidence_index   share of those twelve bins with more than ten images: how far dva can be trusted
    intervals          95 % bootstrap intervals over objects of acc30, median and dva (None with a single object)
    oracle             acc30 and median of the best hypothesis of each image: what perfect selection would reach
    heads              per hypothesis: how often it is selected, how often it is the best, and its acc30
    audit              acc30 and median by the three other definitions of the error (see `metrics`)
    alignment          the fitted map, and on how many images of how many objects
    """
    aligned = align(predictions, alignment, calibration, seed)
    test, errors = aligned.predictions, aligned.selected_errors
    rng = np.random.default_rng(seed)
    azimuths = test.ids["azimuth"].to_numpy()
    intervals = metrics.bootstrap_intervals(
        [errors], [test.objects], rng, draws, statistics=("acc30", "median", "dva"), azimuths=[azimuths]
    )
    best = aligned.errors.argmin(axis=1)
    level = metrics.geodesic_error(aligned.selected, test.truth)
    audit = {
        "vector": metrics.vector_error(aligned.selected, test.truth),
        "folded": metrics.folded(level),
        "scaled": metrics.scaled(level),
    }
    return {
        "images": len(test),
        "objects": len(set(test.objects)),
        **metrics.summary(errors),
        "dva": metrics.dva(errors, azimuths),
        "confidence_index": metrics.confidence_index(azimuths),
        "intervals": {name: None if bounds is None else list(bounds) for name, bounds in intervals.items()},
        "oracle": _headline(aligned.errors.min(axis=1)),
        "heads": [
            {
                "selected": 100 * float(np.mean(test.choice == m)),
                "best": 100 * float(np.mean(best == m)),
                "acc30": metrics.accuracy(aligned.errors[:, m], 30),
            }
            for m in range(test.heads)
        ],
        "audit": {name: _headline(values) for name, values in audit.items()},
        "alignment": {
            **aligned.alignment.to_dict(),
            "images": len(aligned.calibration),
            "objects": len(set(aligned.calibration.objects)),
            "seed": seed,
        },
    }


def _headline(errors: Floats) -> dict[str, float]:
    return {"acc30": metrics.accuracy(errors, 30), "median": metrics.median(errors)}
