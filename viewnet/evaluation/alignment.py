"""Alignment: maps from a predictor's own frame to the annotated one, fitted on calibration images.

Unsupervised predictions are determined up to a rotation of the world (section 4.1). `procrustes` fits that rotation by
least squares, `robust` by least absolute distances, `yaw` so about the vertical alone; `linear` is the affine map of
the starred rows of Table 3, `per_angle` the linear regression of each angle, as in SSV; `none` is for predictions in
the annotated frame already.

>>> truth = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]])
>>> predicted = truth[:, [1, 2, 0]]  # right, in another frame
>>> np.allclose(ALIGNMENTS["procrustes"].fit(predicted, truth).apply(predicted), truth)
True
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Floats

MINIMUM = 4  # calibration images that any fit needs: an affine map of view vectors has four unknowns per coordinate
WEISZFELD_ROUNDS = 40  # of reweighting in a robust fit
DEGENERATE = 0.25  # spread of predictions below which they determine hardly any rotation
COLLAPSED = 1e-6  # share of the correlation's first singular value below which the second is 0: constant predictions


@dataclass(frozen=True)
class Alignment(ABC):
    """A map of view vectors, and how it is fitted."""

    kind: ClassVar[str]

    @classmethod
    @abstractmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Self:
        """The map that best takes predicted to true view vectors, (N, 3) each."""

    @abstractmethod
    def apply(self, vectors: Floats) -> Floats:
        """Unit vectors (..., 3) of the predictor's frame as unit vectors (..., 3) of the annotated frame."""

    def to_dict(self) -> dict[str, Any]:
        """Kind and parameters as plain JSON types, matrices row by row."""
        return {"kind": self.kind, **{f.name: np.asarray(getattr(self, f.name)).tolist() for f in fields(self)}}


@dataclass(frozen=True)
class Identity(Alignment):
    """Leaves vectors as they are."""

    kind: ClassVar[str] = "none"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Self:
        """Nothing to fit."""
        return cls()

    def apply(self, vectors: Floats) -> Floats:
        """The same vectors (..., 3)."""
        return np.asarray(vectors, dtype=np.float64)


@dataclass(frozen=True)
class Procrustes(Alignment):
    """The rotation of the world with the least sum of squared distances, see `fit_rotation`."""

    rotation: Floats  # (3, 3), determinant +1
    singular_values: Floats = field(default_factory=lambda: np.full(3, np.nan))  # (3,), of the mean of t p^T
    spread: float = 1.0  # the second of them, as a share of what it is where predictions are right
    kind: ClassVar[str] = "procrustes"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Self:
        """`fit_rotation` of (N, 3) and (N, 3)."""
        return cls._of(fit_rotation(predicted, truth), predicted, truth)

    @classmethod
    def _of(cls, rotation: Floats, predicted: Floats, truth: Floats) -> Self:
        values, right = (np.asarray(np.linalg.svd(truth.T @ p / len(truth))[1]) for p in (predicted, truth))  # (3,)
        return cls(rotation, values, float(values[1] / max(right[1], 1e-12)))

    @property
    def degenerate(self) -> bool:
        """Whether rotations about an axis fit nearly alike, as predictions have little spread: no score means much."""
        return self.spread < DEGENERATE

    def apply(self, vectors: Floats) -> Floats:
        """Rotated vectors (..., 3)."""
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T


@dataclass(frozen=True)
class Robust(Procrustes):
    """The rotation R of the world with the least sum of distances |R p - t|, not of their squares (L1).

    Where some of one-sided predictions are off by 180 degrees, squares are least for a rotation that tilts the world as
    a compromise; distances are least for the rotation that most predictions agree on.
    """

    kind: ClassVar[str] = "robust"
    order: ClassVar[int] = 1  # so many turns of the object about its vertical count as one viewpoint

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Self:
        """Weiszfeld's algorithm: `fit_rotation` with images weighted by the reciprocal of their distance, repeatedly.

        It starts from the least-squares rotation and from rotations about the vertical, twelve each, since predictions
        in two groups have several local minima; the least sum wins. Errors as in `fit_rotation`.
        """
        first, turned = fit_rotation(predicted, truth), cls.turned(truth)  # (3, 3), (order, N, 3)
        turns = [_about_vertical(angle) for angle in np.radians(np.arange(0, 360, 30))]
        rotations = np.stack([start for turn in turns for start in (turn @ first, turn)])  # (K, 3, 3)
        # Of all t p^T, as |R p - t|^2 = |p|^2 + |t|^2 - 2 <R, t p^T>: products of matrices, however many rotations.
        products = (turned[..., None] * predicted[:, None]).reshape(-1, 9)  # (order N, 9)
        squares = np.square(turned).sum(axis=2) + np.square(predicted).sum(axis=1)  # (order, N)

        def distances(rotations: Floats) -> Floats:  # (K, order, N)
            alike = (rotations.reshape(-1, 9) @ products.T).reshape(-1, *squares.shape)
            return np.sqrt(np.maximum(squares - 2 * alike, 0))

        for _ in range(WEISZFELD_ROUNDS):
            away = distances(rotations)
            nearest = np.arange(cls.order)[:, None] == away.argmin(axis=1)[:, None]  # (K, order, N)
            weights = (nearest / np.maximum(away, 0.01)).reshape(len(away), -1)  # or an exact fit would outweigh all
            rotations = _rotations((weights @ products).reshape(-1, 3, 3), weights.sum(axis=1))
        sums = distances(rotations).min(axis=1).sum(axis=1)  # (K,)
        best = int(np.argmax(sums <= sums.min() * (1 + 1e-9)))  # the first of those that symmetry makes equal
        return cls._of(rotations[best], predicted, truth)

    @classmethod
    def turned(cls, truth: Floats) -> Floats:
        """View vectors (N, 3) of the object in each of its turns (order, N, 3), as it is first."""
        angles = np.linspace(0, 2 * np.pi, cls.order, endpoint=False)
        return np.stack([truth @ _about_vertical(angle).T for angle in angles])


@dataclass(frozen=True)
class HalfTurns(Robust):
    """As `Robust`, where an object and the same turned by 180 degrees about its vertical count as one."""

    kind: ClassVar[str] = "half_turns"
    order: ClassVar[int] = 2


@dataclass(frozen=True)
class QuarterTurns(Robust):
    """As `Robust`, where an object and the same turned by 90, 180 and 270 degrees count as one."""

    kind: ClassVar[str] = "quarter_turns"
    order: ClassVar[int] = 4


@dataclass(frozen=True)
class AnyTurn(Robust):
    """As `Robust`, where objects look alike from all sides: turns ten degrees apart count as one."""

    kind: ClassVar[str] = "any_turn"
    order: ClassVar[int] = 36


@dataclass(frozen=True)
class Yaw(Procrustes):
    """The rotation about the vertical with the least sum of distances, for predictors whose vertical is the world's."""

    kind: ClassVar[str] = "yaw"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Self:
        """The best of 720 angles, half a degree apart. Errors as in `fit_rotation`."""
        _check(predicted, truth)
        rotations = [_about_vertical(angle) for angle in np.radians(np.arange(0, 360, 0.5))]
        sums = [np.linalg.norm(predicted @ rotation.T - truth, axis=1).sum() for rotation in rotations]
        return cls._of(rotations[int(np.argmin(sums))], predicted, truth)


@dataclass(frozen=True)
class Linear(Alignment):
    """The least-squares affine map of the three coordinates of view vectors, normalised (the starred rows of Table 3).

    The paper names no representation. Weights may shrink to zero and leave the mean viewpoint, as the paper warns.
    """

    weights: Floats  # (3, 3)
    bias: Floats  # (3,)
    kind: ClassVar[str] = "linear"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Self:
        """Of several equally good maps the one of the smallest norm."""
        _check(predicted, truth)
        design = np.column_stack([predicted, np.ones(len(predicted))])  # (N, 4)
        solution = np.asarray(np.linalg.lstsq(design, truth, rcond=None)[0], dtype=np.float64)  # (4, 3)
        return cls(solution[:3].T, solution[3])

    def apply(self, vectors: Floats) -> Floats:
        """Mapped and normalised vectors (..., 3). ViewnetError where one is mapped to zero."""
        mapped = np.asarray(vectors, dtype=np.float64) @ self.weights.T + self.bias
        lengths = np.linalg.norm(mapped, axis=-1, keepdims=True)
        if (lengths < 1e-12).any():
            raise ViewnetError("linear alignment maps a viewpoint to the zero vector, which has no direction")
        return mapped / lengths


@dataclass(frozen=True)
class PerAngle(Alignment):
    """A linear function of the azimuth in (-180, 180] and one of the elevation, in degrees, as in SSV.

    That azimuths wrap around is ignored: it suits a narrow range of viewpoints, not a full turn.
    """

    azimuth: tuple[float, float]  # slope, intercept
    elevation: tuple[float, float]
    kind: ClassVar[str] = "per_angle"

    @classmethod
    def fit(cls, predicted: Floats, truth: Floats) -> Self:
        """Two simple regressions; constant predictions get slope 0."""
        _check(predicted, truth)
        azimuths, elevations = zip(_angles(predicted), _angles(truth), strict=True)
        return cls(_line(*azimuths), _line(*elevations))

    def apply(self, vectors: Floats) -> Floats:
        """View vectors (..., 3) of the mapped angles."""
        a, e = _angles(np.asarray(vectors, dtype=np.float64))  # (...) each
        a, e = self.azimuth[0] * a + self.azimuth[1], self.elevation[0] * e + self.elevation[1]
        return geometry.view_vector(torch.from_numpy(a), torch.from_numpy(np.clip(e, -90, 90))).numpy()


ALIGNMENTS: dict[str, type[Alignment]] = {
    cls.kind: cls for cls in (Procrustes, Robust, HalfTurns, QuarterTurns, AnyTurn, Yaw, Linear, PerAngle, Identity)
}


def fit_rotation(predicted: Floats, truth: Floats) -> Floats:
    """The rotation R (3, 3) that minimises the sum of |R p - t|^2 over rows p of `predicted` and t of `truth`, (N, 3).

    Kabsch: U V^T of the singular value decomposition of sum t p^T, or U diag(1, 1, -1) V^T where that is a reflection.
    Constant predictions leave the rotation about their direction open: the smallest is taken. ViewnetError for fewer
    than four images, and where predictions and truth have no direction in common.
    """
    _check(predicted, truth)
    return _rotation(truth.T @ predicted, len(truth))  # (3, 3)


def draw_calibration(objects: NDArray[Any], count: int | None = None, seed: int = 0) -> NDArray[np.intp]:
    """Positions of `count` calibration images (None: all) of these objects (N,), object by object in a random order.

    Random, so that it does not depend on the listing's order. The released code used 128 images. ViewnetError where
    there are fewer than `count`.
    """
    if count is None:
        return np.arange(len(objects))
    if not MINIMUM <= count <= len(objects):
        raise ViewnetError(f"calibration: {count} images requested, expected {MINIMUM} to {len(objects)}")
    names, owner = np.unique(objects.astype(str), return_inverse=True)  # (K,), (N,)
    rank = np.random.default_rng(seed).permutation(len(names))[owner]  # (N,)
    return np.sort(np.argsort(rank, kind="stable")[:count])


def _check(predicted: Floats, truth: Floats) -> None:
    if predicted.shape != truth.shape or predicted.ndim != 2 or predicted.shape[1] != 3:
        raise ViewnetError(f"alignment: vectors are {predicted.shape} and {truth.shape}, expected (N, 3) twice")
    if len(predicted) < MINIMUM:
        raise ViewnetError(f"alignment: {len(predicted)} calibration images, expected {MINIMUM} or more")
    if not (np.isfinite(predicted).all() and np.isfinite(truth).all()):
        raise ViewnetError("alignment: a calibration vector is not finite")


def _rotation(correlation: Floats, count: float) -> Floats:
    """The rotation (3, 3) of the largest trace with sums (3, 3) of t p^T over `count` images; see `fit_rotation`."""
    return _rotations(correlation[None], np.array([count]))[0]


def _rotations(correlations: Floats, counts: Floats) -> Floats:
    """`_rotation` of several (K, 3, 3), over (K,) images: (K, 3, 3)."""
    u, s, vt = np.linalg.svd(correlations)  # (K, 3, 3), (K, 3), (K, 3, 3)
    if (s[:, 0] < 1e-9 * counts).any():
        raise ViewnetError("alignment: the calibration images determine no rotation: use more of them")
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]  # no reflections
    rotations = u @ vt
    for one in np.flatnonzero(s[:, 1] < COLLAPSED * s[:, 0]):  # arbitrary signs, both together the correlation's
        rotations[one] = _smallest_rotation(vt[one, 0], u[one, :, 0])
    return np.asarray(rotations)


def _about_vertical(angle: float) -> Floats:
    """The rotation (3, 3) about the z axis by an angle in radians."""
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def _smallest_rotation(source: Floats, target: Floats) -> Floats:
    """The rotation by the smallest angle that takes unit vector `source` (3,) to `target` (3,) (Rodrigues)."""
    axis, cosine = np.cross(source, target), float(source @ target)
    if cosine < -1 + 1e-12:  # opposite: half a turn about any perpendicular axis
        across = np.cross(source, np.eye(3)[np.abs(source).argmin()])
        across /= np.linalg.norm(across)
        return 2 * np.outer(across, across) - np.eye(3)
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + cosine)


def _angles(vectors: Floats) -> tuple[Floats, Floats]:
    """Azimuths in (-180, 180] and elevations of view vectors (..., 3), in degrees."""
    azimuth, elevation = geometry.azimuth_elevation(torch.from_numpy(np.array(vectors)))
    a = azimuth.numpy()
    return np.where(a > 180, a - 360, a), elevation.numpy()  # (...) each


def _line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope and intercept of the regression of y on x."""
    dx = x - x.mean()
    slope = float(dx @ (y - y.mean())) / spread if (spread := float(dx @ dx)) > 1e-9 else 0.0
    return slope, float(y.mean() - slope * x.mean())
