"""From predictions to numbers, for every predictor alike: aligned on validation images, scored on test images.

>>> import pandas as pd
>>> from viewnet.evaluation.predictions import true_vectors
>>> ids = pd.DataFrame({"model_id": list("abcdefgh"), "category": "car", "split": ["val", "test"] * 4, "view": 0,
...                     "azimuth": np.arange(0.0, 360, 45), "elevation": [0.0, 20, 20, 0] * 2})
>>> own = true_vectors(ids)[:, [1, 2, 0]]  # right, in another frame
>>> predictions = Predictions(ids, own[:, None], np.zeros((8, 1)))
>>> [round(evaluate(predictions, kind, draws=10)["acc30"]) for kind in ("procrustes", "none")]
[100, 25]
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.alignment import ALIGNMENTS, Alignment, Identity, Procrustes, draw_calibration
from viewnet.evaluation.predictions import Floats, Predictions
from viewnet.evaluation.symmetry import symmetry


@dataclass(frozen=True)
class Aligned:
    """Test predictions in the annotated frame."""

    predictions: Predictions  # the test rows, in the predictor's frame
    calibration: Predictions | None  # what the alignment was fitted on; None: there was nothing, and nothing to fit
    alignment: Alignment
    hypotheses: Floats  # (N, M, 3) mapped view vectors
    errors: Floats  # (N, M) geodesic error of each hypothesis, degrees
    alike: Floats  # (N,) those of the selected hypotheses up to the category's symmetry

    @property
    def selected(self) -> Floats:
        """(N, 3) view vectors of the selected hypotheses, mapped."""
        return self.hypotheses[np.arange(len(self.predictions)), self.predictions.choice]

    @property
    def selected_errors(self) -> Floats:
        """(N,) errors of the selected hypotheses, which the tables are made of."""
        return self.errors[np.arange(len(self.predictions)), self.predictions.choice]


def align(
    predictions: Predictions, alignment: str = "procrustes", calibration: int | None = None, seed: int = 0
) -> Aligned:
    """Fit an alignment on the split "val" and apply it to the split "test".

    `calibration` images (None: all) are drawn by objects from `seed`. Raises ViewnetError where a split is missing
    ("val" may be, for the alignment "none"), an object is in both, or there is more than one category: each has its own
    frame.
    """
    kind = ALIGNMENTS[known(alignment, ALIGNMENTS, "alignment")]
    test, rows = predictions.subset("test"), None
    if len(categories := sorted(set(predictions.ids["category"]))) > 1:
        raise ViewnetError(f"evaluation: one category at a time, got {', '.join(categories)}")
    if kind is not Identity or (predictions.ids["split"] == "val").any():
        rows = calibrating(predictions, calibration, seed)
    fitted = Identity() if rows is None else kind.fit(rows.selected, rows.truth)
    hypotheses = fitted.apply(test.hypotheses)  # (N, M, 3)
    # Rotations of the world apply to up vectors too; other maps of view vectors do not determine the tilt.
    rigid = isinstance(fitted, Procrustes | Identity)
    ups = fitted.apply(test.ups) if rigid and test.ups is not None else None
    truth = np.repeat(test.truth[:, None], test.heads, axis=1)  # (N, M, 3)
    errors = alike = metrics.geodesic_error(hypotheses, truth, ups)  # (N, M)
    if (turns := symmetry(categories[0]).turns) != 1:
        alike = metrics.geodesic_error(hypotheses, truth, ups, turns)  # (N, M)
    return Aligned(test, rows, fitted, hypotheses, errors, alike[np.arange(len(test)), test.choice])


def calibrating(predictions: Predictions, calibration: int | None = None, seed: int = 0) -> Predictions:
    """Those that alignments are fitted on. Raises ViewnetError as `align` does."""
    val = predictions.subset("val")
    if both := set(val.objects) & set(predictions.subset("test").objects):
        raise ViewnetError(f"evaluation: {sorted(both)[0]} is in the validation split and in the test split")
    return val.take(draw_calibration(val.objects, calibration, seed))


def evaluate(
    predictions: Predictions,
    alignment: str = "procrustes",
    calibration: int | None = None,
    seed: int = 0,
    draws: int = 1000,
) -> dict[str, Any]:
    """Every metric of the test split as plain JSON types, in per cent and degrees.

    acc10 acc15 acc30  accuracy: share of geodesic errors strictly below 10, 15, 30 degrees
    median, flips      median error; share of errors over 150 degrees
    dva                mean of acc30 over the non-empty azimuth bins of 30 degrees
    confidence_index   share of the twelve bins with more than ten images: how far dva can be trusted
    intervals          95 % bootstrap intervals over objects of acc30, median and dva (None with a single object)
    alike              of symmetric categories the above, from acc10 on, of errors up to their symmetry
    oracle             acc30 and median of the best hypothesis of each image: the limit of perfect selection
    heads              per hypothesis: how often it is selected, how often it is the best, and its acc30
    audit              acc30 and median by three other definitions of the error (see `metrics`)
    alignment          the fitted map, and the images and objects it was fitted on
    """
    aligned = align(predictions, alignment, calibration, seed)
    test, fitted_on = aligned.predictions, aligned.calibration
    azimuths = test.ids["azimuth"].to_numpy()

    def scored(errors: Floats) -> dict[str, Any]:
        statistics = ("acc30", "median", "dva")
        intervals = metrics.bootstrap_intervals([errors], [test.objects], draws, statistics, [azimuths], seed)
        bounds = {name: None if each is None else list(each) for name, each in intervals.items()}
        return metrics.summary(errors, azimuths) | {"intervals": bounds}

    best = aligned.errors.argmin(axis=1)  # (N,)
    level = metrics.geodesic_error(aligned.selected, test.truth)  # (N,), without in-plane rotation
    audit = {"vector": metrics.vector_error(aligned.selected, test.truth)}
    audit |= {name: metrics.DEFINITIONS[name](level) for name in ("folded", "scaled")}
    return {
        "images": len(test),
        "objects": len(set(test.objects)),
        **scored(aligned.selected_errors),
        **({} if symmetry(test.ids["category"].iloc[0]).turns == 1 else {"alike": scored(aligned.alike)}),
        "oracle": _headline(aligned.errors.min(axis=1)),
        "heads": [
            {"selected": 100 * float(np.mean(test.choice == m)), "best": 100 * float(np.mean(best == m))}
            | {"acc30": metrics.accuracy(aligned.errors[:, m], 30)}
            for m in range(test.heads)
        ],
        "audit": {name: _headline(values) for name, values in audit.items()},
        "alignment": aligned.alignment.to_dict()
        | {"images": len(fitted_on or ()), "objects": len(set(fitted_on.objects)) if fitted_on else 0, "seed": seed},
    }


def _headline(errors: Floats) -> dict[str, float]:
    return {"acc30": metrics.accuracy(errors, 30), "median": metrics.median(errors)}


def scores(predictions: Predictions, kinds: Sequence[str]) -> dict[str, dict[str, Any]]:
    """`evaluate` by alignments; also by that of the category's symmetry, or by the robust one where there is none.

    The latter only where predictions in two groups leave Procrustes open.
    """
    rows = calibrating(predictions)
    robust = "robust" if Procrustes.fit(rows.selected, rows.truth).degenerate else ""
    more = symmetry(rows.ids["category"].iloc[0]).alignment or robust
    return {kind: evaluate(predictions, kind) for kind in (*kinds, more) if kind}
