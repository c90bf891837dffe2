"""A method of your own, scored as ViewNet is: a row of its own in a table.

    class Mine:                                 # any class with the methods of `Method`
        def predict(self, images): ...          # images (N, S, S, 3) uint8 -> unit view vectors (N, 3)

    table3 = experiment("table3_pascal3d", categories="car")
    table = with_methods(table3, table3.run(), [Submission("Mine", Mine())])

A method is given images and, if it has `fit`, calibration images with their true viewpoints to learn from. It never
learns where an image comes from, nor the viewpoint of an image that is scored. Its predictions go through the same
alignment, scores and bootstrap intervals as every other row. Instead of a method there may be a file that another
program wrote (viewnet.evaluation.submitted_predictions).
"""

import functools
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from viewnet.config import RunConfig, known
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, submitted_predictions
from viewnet.evaluation.alignment import ALIGNMENTS
from viewnet.evaluation.predictions import ID_COLUMNS, UNIT_TOLERANCE, Floats, Predictions, joined, true_vectors
from viewnet.evaluation.run import Run
from viewnet.experiments.cad import Experiment, Rows
from viewnet.experiments.parameters import PARAMETERS
from viewnet.experiments.photos import PhotoExperiment, content_key
from viewnet.experiments.request import DESIGNS, accepted
from viewnet.runtime import provenance
from viewnet.tables.layouts import ADDED, LAYOUTS
from viewnet.tables.table import Entry, Table

BATCH = 256  # images in one call of `predict`, at most

Images = NDArray[np.uint8]  # (N, S, S, 3)


class Method(Protocol):
    """Estimates viewpoints. May have a method `fit(images, view_vectors)`.

    Images are (N, S, S, 3) uint8, RGB: photographs cropped to the object's box at 128 pixels a side, as the view
    regression gets them, and views of CAD models over black, in the size they are rendered at. `fit` is given the
    images that predictions are aligned on and their true view vectors (N, 3), before `predict`, once for each category:
    nothing learned from another category may remain.
    """

    def predict(self, images: Images) -> ArrayLike:
        """Unit view vectors (N, 3), from object to camera: see viewnet.geometry, and `view_vectors` for angles.

        They may be in any frame that a rotation takes to the annotated one (alignment "procrustes" or "robust"), an
        affine map ("linear"), or in the annotated frame itself ("none"). Called several times, each with at most BATCH
        images in random order.
        """


@dataclass(frozen=True)
class Submission:
    """A method, the label of its row and its alignment.

    Raises ViewnetError for a label that cannot stand in a table, a class in place of a method, and unknown alignments.
    """

    label: str
    method: Method | Mapping[str, Method] | Path | str  # for every category, by category, or a file of predictions
    alignment: str = "procrustes"  # a kind of viewnet.evaluation.alignment; "none" for what is fitted to annotations

    def __post_init__(self) -> None:
        # LaTeX ends a row at a new line.
        if not isinstance(self.label, str) or not self.label.strip() or not self.label.isprintable():
            raise ViewnetError(f"method {self.label!r}: expected a label in a line of text")
        known(self.alignment, ALIGNMENTS, f"alignment of {self.label}")
        for method in self._methods:
            if isinstance(method, type):  # a mistake that would show itself late, after the training
                raise ViewnetError(f"method {self.label!r}: {method.__name__} is a class: give {method.__name__}()")
            if not isinstance(method, (str, Path)) and not callable(getattr(method, "predict", None)):
                raise ViewnetError(f"method {self.label!r}: has no predict(images): see {__name__}.Method")

    @property
    def _methods(self) -> list[Any]:
        return list(self.method.values()) if isinstance(self.method, Mapping) else [self.method]

    @property
    def file(self) -> Path | None:
        """The file of its predictions; None for a method."""
        return Path(self.method) if isinstance(self.method, (str, Path)) else None

    def of(self, category: str) -> Any:
        """The method of a category. Raises ViewnetError where there is none."""
        if not isinstance(self.method, Mapping):
            return self.method
        return self.method[known(category, self.method, f"category of method {self.label!r}")]

    @property
    def remark(self) -> str:
        """The line about it under a table."""
        source = f"from {self.file.name}" if self.file else "by predict"
        fitted = ", fitted on calibration images" if any(hasattr(method, "fit") for method in self._methods) else ""
        return f"{self.label}: added, {source}{fitted}; alignment {self.alignment}"


@dataclass(frozen=True)
class HeldOut:
    """The images of one category that a table aligns on, split "val", and scores, "test"; ids have a row an image."""

    ids: pd.DataFrame
    stores: Rows

    @property
    def identity(self) -> str:
        """Identifies the content of both view stores."""
        return "-".join(dict.fromkeys(store.identity for store, _ in self.stores.values()))  # both are often the same

    def images(self, split: str, rows: NDArray[np.intp]) -> Images:
        """Some images (n, S, S, 3) of a split, over black: new arrays without a reference to their store."""
        store, mine = self.stores[split]
        straight = np.array(store.images[mine[rows]], dtype=np.uint16)  # (n, S, S, 4), wide enough for the products
        return ((straight[..., :3] * straight[..., 3:] + 127) // 255).astype(np.uint8)


class OwnMethodExperiment(Experiment):
    """The tables that methods are added to. CAD models to train on, and to score Table 1 on, are in `cad_root`."""

    @functools.cached_property
    def tables(self) -> dict[str, Experiment]:
        """Table -> the experiment that makes it."""
        # As plain values: "" and 0 for None.
        own = {key: getattr(self, key) or PARAMETERS[key].default for key in accepted(self.name) if key != "output"}
        tables: dict[str, Experiment] = {}
        for table in DESIGNS[self.name].tables:
            if DESIGNS[table].kind == "photos":
                tables[table] = PhotoExperiment.check(table, **own)
            else:
                names = ("profile", "categories", "seeds", "workers")
                tables[table] = Experiment.check(table, data_root=own["cad_root"], **{n: own[n] for n in names})
        return tables

    @property
    def configs(self) -> list[RunConfig]:
        """The runs of all tables, each once."""
        return list(dict.fromkeys(config for table in self.tables.values() for config in table.configs))

    @functools.cached_property
    def kept(self) -> dict[str, list[Entry]]:
        """Table -> the entries of its runs that are kept beside it."""
        return {name: table.kept_entries() for name, table in self.tables.items()}

    @property
    def to_run(self) -> list[RunConfig]:
        """The runs that a table needs and has not kept."""
        kept = {name: {entry.origin["settings"] for entry in entries} for name, entries in self.kept.items()}
        parts = self.tables.items()
        return list(dict.fromkeys(c for name, t in parts for c in t.configs if c.settings_key() not in kept[name]))

    @property
    def folder(self) -> Path:
        """Where the tables go: apart from the paper's."""
        return self.output / self.name / self.label  # the tables of the paper have no such rows

    def score(self, runs: Sequence[Run], submissions: Sequence[Submission]) -> dict[str, Table]:
        """Every table with a row for each method. Raises ViewnetError as `entries` does."""
        return {
            name: with_methods(table, [r for r in runs if r.config in table.configs], submissions, self.kept[name])
            for name, table in self.tables.items()
        }


def held_out(table: Experiment, category: str) -> HeldOut:
    """The images that a table's rows are aligned on and scored on, of one of its categories.

    Raises ViewnetError as Experiment.scored_views does, and for images without annotated viewpoints.
    """
    stores = table.scored_views(category)
    for store, rows in stores.values():
        store.require_viewpoints(store.index["split"].iloc[rows].unique(), "nothing can be scored on it")
    # A store may have other splits.
    ids = [store.index.iloc[rows].assign(split=split) for split, (store, rows) in stores.items()]
    return HeldOut(pd.concat(ids, ignore_index=True)[list(ID_COLUMNS)], stores)


def with_methods(
    table: Experiment, runs: Sequence[Run], submissions: Sequence[Submission], kept: Sequence[Entry] = ()
) -> Table:
    """The table of these runs with a row for each method below; `kept` are entries of its other runs.

    Raises ViewnetError as `entries` does.
    """
    added, remarks = entries(table, submissions), [submission.remark for submission in submissions]
    if not kept:
        return table.table(runs, added, remarks)
    known_runs = {entry.origin["settings"] for entry in kept}
    others = [run for run in runs if run.config.settings_key() not in known_runs]
    own = [*table.untrained(), *kept, *(entry for run in others for entry in table.entries_of(run))]
    return table.table_of([*own, *added], remarks)


def entries(table: Experiment, submissions: Sequence[Submission]) -> list[Entry]:
    """The entries of the methods in a table, for each of its categories.

    ViewnetError, before any method is called, for an experiment without a table and for a label that is given twice or
    is a row already; then for invalid predictions.
    """
    labels = [*table.renamed_rows.values(), *(submission.label for submission in submissions)]
    LAYOUTS[known(table.name, LAYOUTS, "table")].extended(labels)  # each label once
    found = []
    for category in table.categories:
        images = held_out(table, category)  # once for all methods
        found += [_entry(submission, images, category, table.calibration) for submission in submissions]
    return found


def predictions(table: Experiment, submission: Submission) -> Predictions:
    """One method's predictions of all images that a table aligns on and scores, one category after another.

    Their `to_parquet` writes a file that is a submission itself.
    """
    return joined([_predict(submission, held_out(table, c), c, table.calibration) for c in table.categories])


def view_vectors(azimuth: ArrayLike, elevation: ArrayLike) -> Floats:
    """Unit view vectors (N, 3) of azimuths and elevations (N,) in degrees, by viewnet.geometry's conventions.

    >>> view_vectors([0, 90], [0, 30]).round(3)
    array([[1.   , 0.   , 0.   ],
           [0.   , 0.866, 0.5  ]])
    """
    return true_vectors(pd.DataFrame({"azimuth": np.asarray(azimuth), "elevation": np.asarray(elevation)}))


def _predict(submission: Submission, images: HeldOut, category: str, calibration: int | None) -> Predictions:
    if submission.file is not None:
        return submitted_predictions.read(submission.file, images.ids)
    method = submission.of(category)
    who = f"method {submission.label!r}, {category}"
    if hasattr(method, "fit"):  # on the images whose labels an alignment uses, and no others
        rows = np.flatnonzero(baselines.calibrating(images.ids, calibration)[: len(images.stores["val"][1])])
        method.fit(images.images("val", rows), true_vectors(images.ids.iloc[rows]))
    # Neighbours in a store show the same object: its order may tell more than an image does.
    rng = np.random.default_rng(0)  # so that a method sees the same order each time
    parts = []
    for split, (_, mine) in images.stores.items():
        vectors = np.empty((len(mine), 3))
        order = rng.permutation(len(mine))
        for start in range(0, len(mine), BATCH):
            rows = order[start : start + BATCH]
            vectors[rows] = _unit_vectors(method.predict(images.images(split, rows)), len(rows), who)
        parts.append(vectors)
    return Predictions(images.ids, np.concatenate(parts)[:, None], np.zeros((len(images.ids), 1)))


def _unit_vectors(values: Any, count: int, who: str) -> Floats:
    """What `predict` returned, checked to be unit vectors (count, 3)."""
    try:
        vectors = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ViewnetError(f"{who}: predict returned no array of numbers ({str(error).splitlines()[0]})") from error
    if vectors.shape != (count, 3):
        raise ViewnetError(f"{who}: predict returned {vectors.shape} for {count} images: expected ({count}, 3)")
    wrong = np.flatnonzero(~(np.abs(np.linalg.norm(vectors, axis=1) - 1) <= UNIT_TOLERANCE))  # NaN is wrong as well
    if wrong.size:
        which = f"{vectors[wrong[0]].tolist()} for image {wrong[0]} of the {count} in this call"
        raise ViewnetError(f"{who}: predict returned {which}: expected unit vectors ({wrong.size} are none)")
    return vectors


def _entry(submission: Submission, images: HeldOut, category: str, calibration: int | None) -> Entry:
    predicted = _predict(submission, images, category, calibration)
    method, alignment = submission.of(category), submission.alignment
    origin: dict[str, Any] = {"variant": ADDED, "label": submission.label, "category": category}
    origin |= {"alignment": alignment, "calibration": calibration, "images": images.identity}
    origin["source"] = submission.file.name if submission.file else type(method).__qualname__
    origin |= {"fitted": hasattr(method, "fit"), "predictions": digest(predicted)}
    key = content_key(ADDED, origin)
    origin["git"] = provenance.commit()  # not in the key: the same predictions keep theirs
    return Entry(submission.label, category, 0, alignment, key, predicted, origin, calibration)


def digest(predictions: Predictions) -> str:
    """16 hex digits that identify predictions: which images, and every number."""
    rows = pd.util.hash_pandas_object(predictions.to_frame(), index=False).to_numpy()  # in their order
    return hashlib.sha256(rows.tobytes()).hexdigest()[:16]
