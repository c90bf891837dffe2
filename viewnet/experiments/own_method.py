"""A method of your own, scored as ViewNet is: a row of its own in a table.

    class Mine:                                 # any class with the methods of `Method`
        def predict(self, images): ...          # images (N, S, S, 3) uint8 -> unit view vectors (N, 3)

    asked = experiment("table3_pascal3d", categories="car")
    table = with_methods(asked, asked.run(), [Submission("Mine", Mine())])

A method is given images, and to fit on, where it has `fit`, the true viewpoints of calibration images. Where an
image comes from, and the viewpoint of an image that is scored, stay here. What it says goes through the same alignment,
scores and bootstrap intervals as every other row. Instead of a method there may be a file that another program wrote
(viewnet.evaluation.submitted_predictions).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
import torch
from numpy.typing import ArrayLike, NDArray

from viewnet import geometry
from viewnet.config import known
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, submitted_predictions
from viewnet.evaluation.alignment import ALIGNMENTS
from viewnet.evaluation.predictions import ID_COLUMNS, UNIT_TOLERANCE, Floats, Predictions, joined, true_vectors
from viewnet.evaluation.run import Run
from viewnet.experiments.photos import PhotoExperiment
from viewnet.experiments.request import Experiment
from viewnet.runtime import provenance
from viewnet.tables.layouts import ADDED, LAYOUTS
from viewnet.tables.table import Entry, Table

BATCH = 256
"""Images that a method is shown at once, at most."""

Images = NDArray[np.uint8]


class Method(Protocol):
    """Estimates viewpoints.

    Images are (N, S, S, 3) uint8, RGB. Photographs are cut to the object's box and brought to 128 pixels a side, as the
    view regression sees them; the profile's networks see the same at their own size. Views of CAD models have the size
    they are drawn at (32 pixels at the profile smoke, else 64) and black where nothing is, which is what ViewNet's
    viewpoint network sees of them but for the recipe `paper`'s cut to the object.
    """

    def predict(self, images: Images) -> ArrayLike:
        """Unit view vectors (N, 3), from object to camera: see viewnet.geometry, and `view_vectors` for angles.

        They may be in any frame that a rotation takes to the annotated one (alignment "procrustes" or "robust"), an
        affine map ("linear"), or nothing needs to ("none"). Called several times, with at most BATCH images in an order
        drawn at random.
        """
        ...


class Supervised(Method, Protocol):
    """One that learns from calibration images, as SSV's regression does."""

    def fit(self, images: Images, view_vectors: Floats) -> None:
        """Learn from the images that predictions are aligned on, and their true view vectors (N, 3).

        Called before `predict`, for each category anew: what was learned of another must not stay.
        """
        ...


@dataclass(frozen=True)
class Submission:
    """A method, the row it fills and how it is aligned.

    label      the row's
    method     a Method; several by category, where each has its own; or a file (viewnet.evaluation.submitted_predictions)
    alignment  none, procrustes, robust, linear or per_angle (viewnet.evaluation.alignment), fitted on calibration images. "none"
               is for methods that speak in the annotated frame, as those do that are fitted on it

    Raises ViewnetError for a label that cannot stand in a table, a class in place of a method, and unknown alignments.
    """

    label: str
    method: Method | Mapping[str, Method] | Path | str
    alignment: str = "procrustes"

    def __post_init__(self) -> None:
        if not isinstance(self.label, str) or not self.label.strip() or not self.label.isprintable():
            raise ViewnetError(f"method {self.label!r}: expected a label in a line of text")
        known(self.alignment, ALIGNMENTS, f"alignment of {self.label}")
        methods = self.method.values() if isinstance(self.method, Mapping) else [self.method]
        for method in methods:
            if isinstance(method, type):
                raise ViewnetError(f"method {self.label!r}: {method.__name__} is a class: give {method.__name__}()")
            if not isinstance(method, (str, Path)) and not callable(getattr(method, "predict", None)):
                raise ViewnetError(
                    f"method {self.label!r}: has no predict(images): see viewnet.experiments.own_method.Method"
                )

    @property
    def file(self) -> Path | None:
        """The file of its predictions, where it is one."""
        return Path(self.method) if isinstance(self.method, (str, Path)) else None

    def of(self, category: str) -> Any:
        """The method of a category. ViewnetError where there is none."""
        if not isinstance(self.method, Mapping):
            return self.method
        if category not in self.method:
            raise ViewnetError(
                f"method {self.label!r}: there is none for {category}, only for {', '.join(self.method)}"
            )
        return self.method[category]

    @property
    def remark(self) -> str:
        """What is said of it under a table."""
        made = f"from {self.file.name}" if self.file else "by predict"
        methods = self.method.values() if isinstance(self.method, Mapping) else [self.method]
        if any(hasattr(method, "fit") for method in methods):
            made += ", fitted on calibration images"
        return f"{self.label}: added, {made}; alignment {self.alignment}"


@dataclass(frozen=True)
class HeldOut:
    """The images of one category that a table aligns on, split "val", and scores, split "test".

    ids     a row an image (predictions.ID_COLUMNS)
    stores  the view stores of the two splits, and which of their rows
    """

    ids: pd.DataFrame
    stores: dict[str, tuple[ViewStore, NDArray[np.intp]]]

    @property
    def identity(self) -> str:
        """Of everything that decided the images."""
        return "-".join(dict.fromkeys(store.identity for store, _ in self.stores.values()))

    def images(self, split: str, rows: NDArray[np.intp]) -> Images:
        """Some images (n, S, S, 3) of a split, over black: new arrays that know nothing of their store."""
        store, mine = self.stores[split]
        straight = np.array(store.images[mine[rows]], dtype=np.uint16)
        return ((straight[..., :3] * straight[..., 3:] + 127) // 255).astype(np.uint8)


def held_out(asked: Experiment, category: str) -> HeldOut:
    """The images that a table's rows are aligned on and scored on, of one of its categories.

    Raises ViewnetError where a model is in the collection trained on and in the one scored on.
    """
    if isinstance(asked, PhotoExperiment):
        store = asked.stores()[category]
        stores = {split: (store, store.split(split)) for split in ("val", "test")}
    else:
        from viewnet.data.build import view_store

        config = next(config for config in asked.configs if config.data.category == category)
        own = view_store(config.data, asked.workers)
        stores = {split: (own, own.split(split)) for split in ("val", "test")}
        if asked.eval_root is not None:
            other = view_store(asked.eval_data(config), asked.workers)
            if both := set(own.index["model_id"]) & set(other.index["model_id"]):
                raise ViewnetError(
                    f"{asked.eval_root}: model {sorted(both)[0]} is in the collection trained on as well"
                )
            stores["test"] = (other, np.arange(len(other)))
    for split, (store, _) in stores.items():
        store.require_viewpoints(store.index["split"].iloc[stores[split][1]].unique(), "nothing can be scored on it")
    ids = [store.index.iloc[rows].assign(split=split) for split, (store, rows) in stores.items()]
    return HeldOut(pd.concat(ids, ignore_index=True)[list(ID_COLUMNS)], stores)


def with_methods(asked: Experiment, runs: Sequence[Run], submissions: Sequence[Submission]) -> Table:
    """The table of these runs with a row for each method below. Raises ViewnetError as `entries` does."""
    return asked.table(runs, entries(asked, submissions), [submission.remark for submission in submissions])


def entries(asked: Experiment, submissions: Sequence[Submission]) -> list[Entry]:
    """What the methods say of each category of a table, ready to stand in it.

    Raises ViewnetError, before a method is asked anything, for a notebook that makes no table, and for a label that is
    there twice or is a row already; and for predictions that `Submission.method` may not give.
    """
    known(asked.name, LAYOUTS, "table")
    layout = LAYOUTS[asked.name]
    if isinstance(asked, PhotoExperiment):
        layout = layout.extended(asked.called.values())
    for submission in submissions:
        layout = layout.extended([submission.label])
    found = []
    for category in asked.categories:
        images = held_out(asked, category)
        for submission in submissions:
            said = _said(submission, images, category, _calibration(asked))
            found.append(_entry(submission, images, category, said, _calibration(asked)))
    return found


def predictions(asked: Experiment, submission: Submission) -> Predictions:
    """What one method says of all images that a table aligns on and scores, one category after another.

    Its `to_parquet` writes a file that is a submission itself.
    """
    parts = [_said(submission, held_out(asked, c), c, _calibration(asked)) for c in asked.categories]
    return joined(parts)


def view_vectors(azimuth: ArrayLike, elevation: ArrayLike) -> Floats:
    """Unit view vectors (N, 3) of azimuths and elevations (N,) in degrees; the conventions are viewnet.geometry's.

    >>> view_vectors([0, 90], [0, 30]).round(3)
    array([[1.   , 0.   , 0.   ],
           [0.   , 0.866, 0.5  ]])
    """
    return true_vectors(pd.DataFrame({"azimuth": np.asarray(azimuth), "elevation": np.asarray(elevation)}))


def angles(vectors: ArrayLike) -> tuple[Floats, Floats]:
    """Azimuths in [0, 360) and elevations (N,), degrees, of view vectors (N, 3): the inverse of `view_vectors`.

    >>> angles([[0.0, -1.0, 0.0]])
    (array([270.]), array([0.]))
    """
    azimuth, elevation = geometry.azimuth_elevation(torch.from_numpy(np.array(vectors, dtype=np.float64)))
    return azimuth.numpy(), elevation.numpy()


def _calibration(asked: Experiment) -> int | None:
    return asked.calibration if isinstance(asked, PhotoExperiment) else None


def _said(submission: Submission, images: HeldOut, category: str, calibration: int | None) -> Predictions:
    if submission.file is not None:
        return submitted_predictions.read(submission.file, images.ids)
    method, who = submission.of(category), f"method {submission.label!r}, {category}"
    if hasattr(method, "fit"):
        rows = np.flatnonzero(baselines.calibrating(images.ids, calibration)[: len(images.stores["val"][1])])
        method.fit(images.images("val", rows), true_vectors(images.ids.iloc[rows]))
    # Neighbours in a store show the same object, and its order may tell more than an image does.
    rng = np.random.default_rng(0)
    found = []
    for split, (_, mine) in images.stores.items():
        vectors = np.empty((len(mine), 3))
        shuffled = rng.permutation(len(mine))
        for start in range(0, len(mine), BATCH):
            rows = shuffled[start : start + BATCH]
            vectors[rows] = _checked(method.predict(images.images(split, rows)), len(rows), who)
        found.append(vectors)
    return Predictions(images.ids, np.concatenate(found)[:, None], np.zeros((len(images.ids), 1)))


def _checked(said: Any, count: int, who: str) -> Floats:
    """What `predict` returned as unit vectors (count, 3)."""
    try:
        vectors = np.asarray(said, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        problem = str(error).splitlines()[0]
        raise ViewnetError(f"{who}: predict returned no array of numbers ({problem})") from error
    if vectors.shape != (count, 3):
        raise ViewnetError(f"{who}: predict returned {vectors.shape} for {count} images: expected ({count}, 3)")
    lengths = np.linalg.norm(vectors, axis=1)
    off = ~(np.abs(lengths - 1) <= UNIT_TOLERANCE)  # NaN is off as well
    if off.any():
        at = int(np.flatnonzero(off)[0])
        told = ", ".join(f"{value:g}" for value in vectors[at])
        raise ViewnetError(
            f"{who}: predict returned ({told}) for image {at} of the {count} it was shown: expected unit vectors"
            f" ({int(off.sum())} are none)"
        )
    return vectors


def _entry(submission: Submission, images: HeldOut, category: str, said: Predictions, calibration: int | None) -> Entry:
    method = None if submission.file is not None else submission.of(category)
    origin: dict[str, Any] = {
        "variant": ADDED,
        "label": submission.label,
        "category": category,
        "alignment": submission.alignment,
        "calibration": calibration,
        "images": images.identity,
        "source": submission.file.name if submission.file is not None else type(method).__qualname__,
        "fitted": hasattr(method, "fit"),
        "predictions": digest(said),
    }
    key = f"{ADDED}-{hashlib.sha256(json.dumps(origin, sort_keys=True).encode()).hexdigest()[:12]}"
    origin["git"] = provenance.commit()
    return Entry(submission.label, category, 0, submission.alignment, key, said, origin, calibration)


def digest(said: Predictions) -> str:
    """16 hex digits of predictions: of which images, and every number."""
    hashed = hashlib.sha256(said.ids.to_csv(index=False, lineterminator="\n").encode())
    for values in (said.hypotheses, said.logits, *([] if said.ups is None else [said.ups])):
        hashed.update(json.dumps(values.shape).encode() + np.ascontiguousarray(values, dtype="<f8").tobytes())
    return hashed.hexdigest()[:16]
