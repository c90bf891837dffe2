"""How sure a prediction is, whether that is true, and how to make it so.

A confidence is the probability that a viewpoint is within 30 degrees: that of all hypotheses so close to the most
probable one, by a selection whose logits may be divided by a temperature (Guo et al. 2017). Where `turns` of the object
look alike (viewnet.evaluation.symmetry), frames are the annotated ones, and all this is up to these turns.
"""

import numpy as np
import torch
from numpy.typing import NDArray

from viewnet import geometry

Floats = NDArray[np.float64]  # of viewnet.evaluation.predictions, which loads pandas
RIGHT = 30.0  # degrees, see viewnet.evaluation.metrics
BINS = 10  # of confidence, of equal width
TEMPERATURES = np.geomspace(0.25, 4, 161)
SURE = 0.999  # no confidence counts as more when temperatures are compared, nor as less than the rest


def probabilities(logits: Floats) -> Floats:
    """(N, M) of the selection's logits (N, M)."""
    shares = np.exp(logits - logits.max(1, keepdims=True))
    return shares / shares.sum(1, keepdims=True)


def confidence(frames: Floats, logits: Floats, turns: int = 1) -> Floats:
    """(N,) of hypotheses with camera frames (N, M, 3, 3) and logits (N, M).

    >>> front, beside, behind = np.eye(3), np.eye(3), np.diag([-1.0, -1.0, 1.0])
    >>> confidence(np.array([[front, beside, behind]]), np.log([[0.5, 0.3, 0.2]])).round(2).tolist()
    [0.8]
    """
    return (probabilities(logits) * _near(frames, logits, turns)).sum(1)


def calibration_error(confidence: Floats, right: NDArray[np.bool_]) -> float:
    """The expected calibration error, in points: how far confidences (N,) are from the share that is right, by BINS.

    >>> round(calibration_error(np.array([0.9, 0.9, 0.6, 0.6]), np.array([True, True, True, False])), 6)
    10.0
    """
    place = np.minimum((confidence * BINS).astype(int), BINS - 1)  # (N,)
    off = np.bincount(place, confidence, BINS) - np.bincount(place, right, BINS)  # (BINS,), times images
    return 100 * float(np.abs(off).sum()) / len(confidence)


def temperature(frames: Floats, logits: Floats, right: NDArray[np.bool_], turns: int = 1) -> float:
    """Of TEMPERATURES the one by which confidences make it most likely that just those (N,) are right that are."""
    near = _near(frames, logits, turns)

    def surprise(value: float) -> float:
        sure = (probabilities(logits / value) * near).sum(1).clip(1 - SURE, SURE)  # (N,)
        return -float(np.log(np.where(right, sure, 1 - sure)).mean())

    return float(min(TEMPERATURES, key=surprise))


def _near(frames: Floats, logits: Floats, turns: int) -> NDArray[np.bool_]:
    """(N, M) which hypotheses are within 30 degrees of the most probable one."""
    chosen = frames[np.arange(len(logits)), logits.argmax(1)]  # (N, 3, 3)
    return (geometry.rotation_angle(torch.from_numpy(frames), torch.from_numpy(chosen[:, None]), turns) < RIGHT).numpy()
