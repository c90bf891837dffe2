"""Alignment: from a predictor's own frame to the annotated one, fitted on calibration images.

Unsupervised predictions hold up to a rotation of the world (section 4.1). `procrustes` finds that rotation by least
squares, `robust` the one that most predictions agree on; `linear` is the affine map of the starred rows of Table 3,
`per_angle` the linear regression of each angle by itself, as SSV does; `none` is for predictors that speak in the
annotated frame already.

>>> truth = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]])
>>> predicted = truth[:, [1, 2, 0]]  # right, in a frame of its own
>>> found = ALIGNMENTS["procrustes"].fit(predicted, truth)
>>> np.allclose(found.apply(predicted), truth)
True
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
import torch

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Floats, Predictions

MINIMUM = 4
"""Calibration images that any fit needs: an affine map of view vectors has four unknowns a coordinate."""
WEISZFELD = 40
"""Rounds of reweighting of a robust fit."""
COLLAPSED = 1e-6
"""Predictions are constant where the second singular value of their correlation is below this share of the first."""


class Alignment(Protocol):
    """What every fit returns."""

    kind: ClassVar[str]

    def apply(self, vectors: Floats) -> Floats:
        """Unit vectors (..., 3) of the predictor's frame as unit vectors (..., 3) of the annotated frame."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, with the `kind` that `from_dict` reads."""
        ...


@dataclass(frozen=True)
class Identity:
    """Leaves vectors as they are."""

    kind: ClassVar[str] = "none"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Identity:
        """Nothing to fit."""
        return cls()

    def apply(self, vectors: Floats) -> Floats:
        """The same vectors (..., 3)."""
        return np.asarray(vectors, dtype=np.float64)

    def to_dict(self) -> dict[str, Any]:
        """Only the kind."""
        return {"kind": self.kind}


@dataclass(frozen=True)
class Procrustes:
    """The rotation of the world that best maps predicted to true view vectors."""

    rotation: Floats  # (3, 3), determinant +1
    kind: ClassVar[str] = "procrustes"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Procrustes:
        """`fit_rotation` of (N, 3) and (N, 3)."""
        return cls(fit_rotation(predicted, truth))

    def apply(self, vectors: Floats) -> Floats:
        """Rotated vectors (..., 3)."""
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T

    def to_dict(self) -> dict[str, Any]:
        """The matrix row by row."""
        return {"kind": self.kind, "rotation": self.rotation.tolist()}


@dataclass(frozen=True)
class Robust(Procrustes):
    """The rotation of the world by the least sum of distances, and not of their squares (the L1 mean).

    Where a share of the predictions is off by half a turn and the viewpoints are few-sided, squares are least for a
    rotation that tilts the world to go between the two; distances are least for the one that most agree on.
    """

    kind: ClassVar[str] = "robust"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Robust:
        """`fit_robust` of (N, 3) and (N, 3)."""
        return cls(fit_robust(predicted, truth))


@dataclass(frozen=True)
class Linear:
    """The affine map of view vectors that fits best, its outcome scaled to length 1 (the starred rows of Table 3).

    The paper names neither dimension nor representation; three coordinates in, three out. Its weights may shrink to
    nothing and leave the mean viewpoint, which is what the paper warns of.
    """

    weights: Floats  # (3, 3)
    bias: Floats  # (3,)
    kind: ClassVar[str] = "linear"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Linear:
        """Least squares from (N, 3) to (N, 3); of several equally good maps the one of the smallest norm."""
        _check(predicted, truth)
        design = np.column_stack([predicted, np.ones(len(predicted))])
        solution = np.asarray(np.linalg.lstsq(design, truth, rcond=None)[0], dtype=np.float64)  # (4, 3)
        return cls(solution[:3].T, solution[3])

    def apply(self, vectors: Floats) -> Floats:
        """Mapped and normalised vectors (..., 3). ViewnetError where one is mapped to nothing."""
        mapped = np.asarray(vectors, dtype=np.float64) @ self.weights.T + self.bias
        lengths = np.linalg.norm(mapped, axis=-1, keepdims=True)
        if (lengths < 1e-12).any():
            raise ViewnetError("linear alignment maps a viewpoint to the zero vector, which has no direction")
        return mapped / lengths

    def to_dict(self) -> dict[str, Any]:
        """Weights row by row, and bias."""
        return {"kind": self.kind, "weights": self.weights.tolist(), "bias": self.bias.tolist()}


@dataclass(frozen=True)
class PerAngle:
    """A line for the azimuth and one for the elevation, in degrees, as SSV fits them.

    Azimuths are taken in (-180, 180], and the fit knows nothing of their wrapping around: it suits a narrow range of
    viewpoints, not a full turn. Elevations are clipped to +-90.
    """

    azimuth: tuple[float, float]  # slope, intercept
    elevation: tuple[float, float]
    kind: ClassVar[str] = "per_angle"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> PerAngle:
        """Two simple regressions over (N, 3) and (N, 3); predictions that are all alike get slope 0."""
        _check(predicted, truth)
        (a, e), (true_a, true_e) = _angles(predicted), _angles(truth)
        return cls(_line(a, true_a), _line(e, true_e))

    def apply(self, vectors: Floats) -> Floats:
        """View vectors (..., 3) of the mapped angles."""
        a, e = _angles(np.asarray(vectors, dtype=np.float64))
        a, e = self.azimuth[0] * a + self.azimuth[1], self.elevation[0] * e + self.elevation[1]
        return geometry.view_vector(torch.from_numpy(a), torch.from_numpy(np.clip(e, -90, 90))).numpy()

    def to_dict(self) -> dict[str, Any]:
        """Slope and intercept of each angle."""
        return {"kind": self.kind, "azimuth": list(self.azimuth), "elevation": list(self.elevation)}


ALIGNMENTS: dict[str, type[Identity] | type[Procrustes] | type[Robust] | type[Linear] | type[PerAngle]] = {
    cls.kind: cls for cls in (Procrustes, Robust, Linear, PerAngle, Identity)
}


def fit_rotation(predicted: Floats, truth: Floats) -> Floats:
    """The rotation R (3, 3) that minimises the sum of |R p - t|^2 over rows p of `predicted` and t of `truth`, (N, 3).

    The singular value decomposition of sum t p^T gives the best orthogonal map U V^T; where that is a reflection, the
    best rotation is U diag(1, 1, -1) V^T, the sign on the direction that matters least (Kabsch). Predictions that are
    all alike leave the turn about their common direction open: of the equally good rotations the smallest is taken.
    ViewnetError for fewer than four images, and where predictions and truth have no direction in common at all.

    >>> truth = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    >>> turned = np.array([[0.0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 0, 0]])  # by a quarter
    >>> fit_rotation(turned, truth).round(3) + 0.0
    array([[ 0.,  1.,  0.],
           [-1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    _check(predicted, truth)
    return _rotation(truth.T @ predicted, len(truth))


def fit_robust(predicted: Floats, truth: Floats) -> Floats:
    """The rotation R (3, 3) that minimises the sum of |R p - t| over rows p of `predicted` and t of `truth`, (N, 3).

    Weiszfeld's algorithm: `fit_rotation` with every image weighted by the reciprocal of its distance, again and again.
    It begins at the least-squares rotation and at turns of the world about the vertical, twelve each, since where
    predictions fall into two camps either may be a minimum; the least sum wins. Errors as in `fit_rotation`.
    """
    first = fit_rotation(predicted, truth)
    best, least = first, np.inf
    for angle in np.radians(np.arange(0, 360, 30)):
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        for rotation in (turn @ first, turn):
            for _ in range(WEISZFELD):
                distances = np.linalg.norm(predicted @ rotation.T - truth, axis=1)
                # An image that fits exactly would count for everything.
                weights = 1 / np.maximum(distances, 0.01)
                rotation = _rotation((truth * weights[:, None]).T @ predicted, weights.sum())
            if (total := float(np.linalg.norm(predicted @ rotation.T - truth, axis=1).sum())) < least:
                best, least = rotation, total
    return best


def _rotation(correlation: Floats, count: float) -> Floats:
    """The rotation (3, 3) of the largest trace with sums (3, 3) of t p^T over `count` images; see `fit_rotation`."""
    u, s, vt = np.linalg.svd(correlation)
    if s[0] < 1e-9 * count:
        raise ViewnetError("alignment: the calibration images determine no rotation: use more of them")
    if s[1] < COLLAPSED * s[0]:
        # The signs of u and v are arbitrary one by one, but their product is that of the correlation.
        return _smallest_rotation(vt[0], u[:, 0])
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt


def from_dict(values: dict[str, Any]) -> Alignment:
    """The inverse of every `to_dict`. ViewnetError for an unknown kind or missing values.

    >>> from_dict({"kind": "none"})
    Identity()
    >>> from_dict({"kind": "affine"})
    Traceback (most recent call last):
    viewnet.errors.ViewnetError: unknown alignment 'affine': choose one of procrustes, robust, linear, per_angle, none
    """
    kind = values.get("kind")
    try:
        if kind in ("procrustes", "robust"):
            rotation = np.array(values["rotation"], dtype=np.float64).reshape(3, 3)
            return Procrustes(rotation) if kind == "procrustes" else Robust(rotation)
        if kind == "linear":
            weights = np.array(values["weights"], dtype=np.float64).reshape(3, 3)
            return Linear(weights, np.array(values["bias"], dtype=np.float64).reshape(3))
        if kind == "per_angle":
            (a0, a1), (e0, e1) = values["azimuth"], values["elevation"]
            return PerAngle((float(a0), float(a1)), (float(e0), float(e1)))
    except (KeyError, TypeError, ValueError) as error:
        raise ViewnetError(f"alignment of kind {kind!r}: values are missing or damaged ({error})") from error
    if kind == "none":
        return Identity()
    raise ViewnetError(f"unknown alignment {kind!r}: choose one of {', '.join(ALIGNMENTS)}")


def calibration_rows(predictions: Predictions, count: int | None = None, seed: int = 0) -> Predictions:
    """The images to fit on: `count` of them (all, if None), taken object by object in an order drawn from `seed`.

    Objects and not images are drawn, and not simply the first, so that the draw is one of the collection and not of its
    listing. The released code used 128 images. Raises ViewnetError where there are fewer than `count`.
    """
    if count is None:
        return predictions
    if not MINIMUM <= count <= len(predictions):
        raise ViewnetError(f"calibration: {count} images asked for, expected {MINIMUM} to {len(predictions)}")
    objects, owner = np.unique(predictions.objects.astype(str), return_inverse=True)
    rank = np.random.default_rng(seed).permutation(len(objects))[owner]
    return predictions.take(np.sort(np.argsort(rank, kind="stable")[:count]))


def _check(predicted: Floats, truth: Floats) -> None:
    if predicted.shape != truth.shape or predicted.ndim != 2 or predicted.shape[1] != 3:
        raise ViewnetError(f"alignment: vectors are {predicted.shape} and {truth.shape}, expected (N, 3) twice")
    if len(predicted) < MINIMUM:
        raise ViewnetError(f"alignment: {len(predicted)} calibration images, expected {MINIMUM} or more")
    if not (np.isfinite(predicted).all() and np.isfinite(truth).all()):
        raise ViewnetError("alignment: a calibration vector is not finite")


def _smallest_rotation(source: Floats, target: Floats) -> Floats:
    """The rotation by the smallest angle that takes unit vector `source` (3,) to `target` (3,) (Rodrigues)."""
    axis, cosine = np.cross(source, target), float(source @ target)
    if cosine < -1 + 1e-12:  # opposite: half a turn about any axis across
        across = np.cross(source, np.eye(3)[np.abs(source).argmin()])
        across /= np.linalg.norm(across)
        return 2 * np.outer(across, across) - np.eye(3)
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + cosine)


def _angles(vectors: Floats) -> tuple[Floats, Floats]:
    azimuth, elevation = geometry.azimuth_elevation(torch.from_numpy(np.array(vectors)))
    a = azimuth.numpy()
    return np.where(a > 180, a - 360, a), elevation.numpy()


def _line(x: Floats, y: Floats) -> tuple[float, float]:
    dx = x - x.mean()
    spread = float(dx @ dx)
    slope = float(dx @ (y - y.mean())) / spread if spread > 1e-9 else 0.0
    return slope, float(y.mean() - slope * x.mean())
