"""How well calibration images support an alignment: how it does on others of them, and how firmly they determine it.

Of few images, or of predictions of which many are half a turn off, a fit can be worse than a rotation that a model
brings along. Only calibration images are used, so that an alignment may be chosen by it.
"""

import numpy as np

from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import ALIGNMENTS, Procrustes
from viewnet.evaluation.metrics import geodesic_error
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.symmetry import symmetry

DRAWS = 20


def support(calibration: Predictions, kind: str) -> dict[str, float | None]:
    """The support of an alignment `kind` by calibration images, in per cent and degrees.

    It is fitted again on as many of their objects, drawn with replacement, DRAWS times.

    acc30        images within 30 degrees, up to a symmetry, by the fits that have not seen their objects; 0 for none
    uncertainty  19 of 20 rotations fitted again are within it of the one of all images; None for other alignments
    """
    names, owner = np.unique(calibration.objects.astype(str), return_inverse=True)  # (K,), (N,)
    predicted, truth, fit = calibration.selected, calibration.truth, ALIGNMENTS[kind].fit
    turns = symmetry(calibration.ids["category"].iloc[0]).turns
    if kind == "none":
        return {"acc30": 100 * float((geodesic_error(predicted, truth, turns=turns) < 30).mean()), "uncertainty": None}
    rng = np.random.default_rng(0)
    right, apart, whole = [], [], fit(predicted, truth)
    for _ in range(DRAWS):
        times = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))[owner]  # (N,)
        rows, left_out = np.repeat(np.arange(len(owner)), times), times == 0
        try:
            again = fit(predicted[rows], truth[rows])
        except ViewnetError:  # too few of them, or all alike
            right.append(np.zeros(left_out.sum()))
            continue
        right.append(geodesic_error(again.apply(predicted[left_out]), truth[left_out], turns=turns) < 30)
        if isinstance(again, Procrustes) and isinstance(whole, Procrustes):
            cosine = (np.trace(again.rotation.T @ whole.rotation) - 1) / 2
            apart.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    found = np.concatenate(right)
    uncertainty = float(np.percentile(apart, 95)) if apart else None
    return {"acc30": 100 * float(found.mean()) if len(found) else 0.0, "uncertainty": uncertainty}
