"""Predicted viewpoints of images, with their hypotheses and probabilities."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from viewnet import geometry
from viewnet.estimator import camera_axes
from viewnet.evaluation.confidence import confidence, probabilities

if TYPE_CHECKING:
    import pandas as pd  # loaded only for tables

Floats = NDArray[np.float64]  # an array of double precision
LINES = 12  # images that a summary lists
DOUBT = 0.1  # probability of hypotheses behind the object from which on the answer is in doubt


class Rotated:
    """What has camera frames (..., 3, 3) in `frame`, columns right, up and back."""

    frame: Floats

    def rotation(self, frame: str = "opencv", form: str = "matrix") -> Floats:
        """The rotation between object and camera as opencv, opengl, pytorch3d or blender has it (see camera_axes).

        matrix (..., 3, 3), quaternion (..., 4): w, x, y, z, or euler (..., 3): Blender's XYZ in degrees. Raises
        ViewnetError for another frame or form.

        >>> (viewpoint,) = Viewpoints.of([[[1.0, 0, 0]]], [[0.0]], None, aligned=True)
        >>> viewpoint.rotation("opencv").tolist()  # from the front: the object's left is right, its front towards us
        [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]
        >>> viewpoint.rotation("blender", "euler").round(6).tolist()
        [90.0, 0.0, 90.0]
        """
        return camera_axes.rotation(self.frame, frame, form)


@dataclass(frozen=True)
class Hypothesis(Rotated):
    """One of the viewpoints that the network proposes; `number` counts from 1 by falling probability."""

    number: int
    azimuth: float
    elevation: float
    frame: Floats = field(compare=False)  # == of arrays is no single answer
    probability: float
    chosen: bool


@dataclass(frozen=True)
class Viewpoint(Rotated):
    """The viewpoint of one image: a row of `Viewpoints`, which documents the fields."""

    azimuth: float
    elevation: float
    vector: Floats
    frame: Floats
    hypotheses: Floats
    hypothesis_frames: Floats
    probabilities: Floats
    choice: int
    confidence: float
    aligned: bool
    turns: int

    @property
    def rival(self) -> Hypothesis | None:
        """The likeliest hypothesis of the object's other side, if those of that side have DOUBT or more together.

        None where opposite sides look alike.
        """
        opposite = [each for each in self.ranked() if each.frame[:, 2] @ self.vector < 0]
        return opposite[0] if self.turns == 1 and sum(each.probability for each in opposite) >= DOUBT else None

    def ranked(self) -> list[Hypothesis]:
        """Every hypothesis by falling probability; among equals the chosen one comes first.

        >>> (viewpoint,) = Viewpoints.of([[[1.0, 0, 0], [0, 1, 0]]], [[0.0, 2.0]], None, aligned=True)
        >>> [(each.azimuth, round(each.probability, 2)) for each in viewpoint.ranked()]
        [(90.0, 0.88), (0.0, 0.12)]
        """
        azimuth, elevation = (a.tolist() for a in geometry.azimuth_elevation(torch.from_numpy(self.hypotheses)))
        shares, frames = self.probabilities.tolist(), self.hypothesis_frames
        order = sorted(range(len(shares)), key=lambda row: (-shares[row], row != self.choice))
        return [
            Hypothesis(number, azimuth[row], elevation[row], frames[row], shares[row], row == self.choice)
            for number, row in enumerate(order, 1)
        ]


@dataclass(frozen=True, repr=False, eq=False)
class Viewpoints(Rotated):
    """The viewpoints of N images, M hypotheses each, all in one frame (see viewnet.geometry).

    azimuth            (N,) degrees in [0, 360): 0 shows the object's front, 90 its left side
    elevation          (N,) degrees in [-90, 90]
    vector             (N, 3) unit view vectors, from the object to the camera
    frame              (N, 3, 3) camera frames, columns right, up and back; level unless in-plane rotation was learned
    hypotheses         (N, M, 3) unit view vectors, one of which is `vector`
    hypothesis_frames  (N, M, 3, 3) their camera frames, one of which is `frame`
    probabilities      (N, M) that each hypothesis is the best
    choice             (N,) the most probable hypothesis
    confidence         (N,) that of the viewpoint: the probability of all hypotheses within 30 degrees of the chosen one
    aligned            whether the frame is the annotated one; otherwise it is the network's own, whose azimuth 0 and up
                       are arbitrary: only differences between viewpoints mean anything
    turns              of the object that count as one viewpoint for its confidence (viewnet.evaluation.symmetry)

    >>> Viewpoints.of([[[1.0, 0, 0], [0, 1, 0]]], [[0.0, 2.0]], None, aligned=True)
    1 viewpoint in the annotated frame
      azimuth  elevation  confidence
        90.0°       0.0°         88 %
    """

    azimuth: Floats
    elevation: Floats
    vector: Floats
    frame: Floats
    hypotheses: Floats
    hypothesis_frames: Floats
    probabilities: Floats
    choice: NDArray[np.int64]
    confidence: Floats
    aligned: bool
    turns: int = 1

    @classmethod
    def of(
        cls, hypotheses: ArrayLike, logits: ArrayLike, ups: ArrayLike | None, aligned: bool, turns: int = 1
    ) -> "Viewpoints":
        """From unit view vectors (N, M, 3), logits (N, M) and, with in-plane rotation, unit up vectors (N, M, 3)."""
        vectors, scores = np.array(hypotheses, dtype=np.float64), np.array(logits, dtype=np.float64)
        shares = probabilities(scores)
        rows, choice = np.arange(len(scores)), scores.argmax(1)
        chosen = vectors[rows, choice]
        up = None if ups is None else torch.from_numpy(np.array(ups, dtype=np.float64))
        azimuth, elevation = (angle.numpy() for angle in geometry.azimuth_elevation(torch.from_numpy(chosen)))
        frames = geometry.look_at(torch.from_numpy(vectors), up).numpy()
        sure, frame = confidence(frames, scores, turns), frames[rows, choice]
        return cls(azimuth, elevation, chosen, frame, vectors, frames, shares, choice, sure, aligned, turns)

    def __len__(self) -> int:
        return len(self.azimuth)

    @overload
    def __getitem__(self, rows: int) -> Viewpoint: ...

    @overload
    def __getitem__(self, rows: slice | ArrayLike) -> "Viewpoints": ...

    def __getitem__(self, rows: Any) -> "Viewpoint | Viewpoints":
        """The viewpoint of one image, or those of a slice, a mask (N,) or a list of positions."""
        single = isinstance(rows, (int, np.integer))
        rows = rows if single or isinstance(rows, slice) else np.asarray(rows)
        whole: dict[str, Any] = {"aligned": self.aligned, "turns": self.turns}
        values = {each.name: getattr(self, each.name)[rows] for each in fields(self) if each.name not in whole}
        if not single:
            return Viewpoints(**values, **whole)
        plain = {name: value.item() if np.ndim(value) == 0 else value for name, value in values.items()}
        return Viewpoint(**plain, **whole)

    def __iter__(self) -> Iterator[Viewpoint]:
        return (self[row] for row in range(len(self)))

    def to_frame(self, frame: str | None = None, form: str = "matrix") -> "pd.DataFrame":
        """A row for each image: azimuth, elevation, confidence, choice, and azimuth_m, elevation_m, probability_m.

        With a `frame` the numbers of `rotation(frame, form)` too, named as in camera_axes.FORMS, _m after those of m.
        """
        import pandas as pd

        names = ("azimuth", "elevation", "confidence", "choice")
        columns: dict[str, Any] = {name: getattr(self, name) for name in names}
        angles = geometry.azimuth_elevation(torch.from_numpy(self.hypotheses))
        for m in range(self.hypotheses.shape[1]):
            columns |= {f"azimuth_{m}": angles[0][:, m].numpy(), f"elevation_{m}": angles[1][:, m].numpy()}
            columns[f"probability_{m}"] = self.probabilities[:, m]
        if frame is not None:
            hypotheses = ((f"_{m}", self.hypothesis_frames[:, m]) for m in range(self.hypotheses.shape[1]))
            for suffix, frames in (("", self.frame), *hypotheses):
                rotations = camera_axes.rotation(frames, frame, form)
                numbers = rotations.reshape(len(self), len(camera_axes.FORMS[form])).T
                columns |= {f"{name}{suffix}": numbers[i] for i, name in enumerate(camera_axes.FORMS[form])}
        return pd.DataFrame(columns)

    def __repr__(self) -> str:
        where = "the annotated frame" if self.aligned else "the network's own frame: not aligned"
        lines = [f"{len(self)} viewpoint{'s' * (len(self) != 1)} in {where}", "  azimuth  elevation  confidence"]
        for row in self[:LINES]:
            lines.append(f"  {row.azimuth:6.1f}°    {row.elevation:6.1f}°       {100 * row.confidence:4.0f} %")
        return "\n".join([*lines, f"  and {len(self) - LINES} more"] if len(self) > LINES else lines)
