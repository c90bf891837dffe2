"""Predicted viewpoints for a set of images: what evaluation, tables and figures read."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import ArrayLike, NDArray

from viewnet import geometry
from viewnet.errors import ViewnetError
from viewnet.runtime.files import replacing

Floats = NDArray[np.float64]

ID_COLUMNS = ("model_id", "category", "split", "view", "azimuth", "elevation")
UNIT_TOLERANCE = 1e-3  # of a view vector's length: float16 and bfloat16 outputs pass, an unnormalised one does not


@dataclass(frozen=True)
class Predictions:
    """N images with M viewpoint hypotheses each.

    ViewnetError for missing columns, no rows, wrong shapes, values that are not finite and vectors of a length not 1.

    >>> ids = pd.DataFrame([["a", "car", "test", 0, 90.0, 0.0]], columns=ID_COLUMNS)
    >>> predictions = Predictions(ids, np.array([[[1.0, 0, 0], [0, 1, 0]]]), np.array([[0.2, 1.5]]))
    >>> predictions.choice, predictions.selected
    (array([1]), array([[0., 1., 0.]]))
    """

    ids: pd.DataFrame  # a row for each image: `ID_COLUMNS`, text, an integer (view), and the true angles in degrees
    hypotheses: Floats  # (N, M, 3) unit view vectors in the predictor's own frame, which alignment maps to the true one
    logits: Floats  # (N, M) selection logits: the hypothesis of the largest is the prediction
    ups: Floats | None = None  # (N, M, 3) unit up vectors of a predictor of in-plane rotation; None: a level camera

    def __post_init__(self) -> None:
        ids = _checked_ids(self.ids)
        vectors = ("hypotheses",) if self.ups is None else ("hypotheses", "ups")
        arrays = {name: _floats(getattr(self, name), name) for name in (*vectors, "logits")}
        shape = arrays["hypotheses"].shape
        if len(shape) != 3 or shape[0] != len(ids) or shape[1] < 1 or shape[2] != 3:
            raise ViewnetError(f"predictions: hypotheses are {shape}, expected ({len(ids)}, M, 3) with M of 1 or more")
        for name, array in arrays.items():
            expected = shape[:2] if name == "logits" else shape
            if array.shape != expected:
                raise ViewnetError(f"predictions: {name} are {array.shape}, expected {expected}")
        for name in vectors:
            lengths = np.linalg.norm(arrays[name], axis=-1)  # (N, M)
            worst = np.unravel_index(np.abs(lengths - 1).argmax(), lengths.shape)
            if abs(lengths[worst] - 1) > UNIT_TOLERANCE:
                raise ViewnetError(f"predictions: {name} of row {worst[0]} have length {lengths[worst]:g}, expected 1")
        for name, value in {"ids": ids, **arrays}.items():
            object.__setattr__(self, name, value)  # the only way into a frozen dataclass

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def heads(self) -> int:
        """M, the number of hypotheses."""
        return self.hypotheses.shape[1]

    @property
    def choice(self) -> NDArray[np.intp]:
        """(N,) index of the selected hypothesis; of ties the first."""
        return self.logits.argmax(axis=1)

    @property
    def selected(self) -> Floats:
        """(N, 3) view vectors of the selected hypotheses, in the predictor's own frame."""
        return self.hypotheses[np.arange(len(self)), self.choice]

    @cached_property
    def truth(self) -> Floats:
        """(N, 3) true view vectors."""
        return true_vectors(self.ids)

    @property
    def objects(self) -> NDArray[np.object_]:
        """(N,) the object each image shows, see `object_names`: the unit that is drawn and resampled."""
        return object_names(self.ids)

    def subset(self, split: str) -> "Predictions":
        """The rows of one split. ViewnetError, naming the splits there are, where it has none."""
        rows = (self.ids["split"] == split).to_numpy()
        if not rows.any():
            splits = ", ".join(sorted(self.ids["split"].unique()))  # so that a mistaken name is seen
            raise ViewnetError(f"predictions: no rows of split {split!r}, only of {splits}: predict that split too")
        return self.take(rows)

    def take(self, rows: ArrayLike) -> "Predictions":
        """The rows of a mask (N,) or of a list of positions, in that order."""
        rows = np.asarray(rows)
        ups = None if self.ups is None else self.ups[rows]
        ids, hypotheses, logits = self.ids.iloc[rows], self.hypotheses[rows], self.logits[rows]
        if not len(ids) or (rows.dtype != np.bool_ and len(np.unique(rows)) < len(rows)):
            return Predictions(ids, hypotheses, logits, ups)  # which refuses it
        part = object.__new__(Predictions)  # rows of what was checked need no check
        values = {"hypotheses": hypotheses, "logits": logits} | ({} if ups is None else {"ups": ups})
        for array in values.values():
            array.flags.writeable = False
        for name, value in {"ids": ids.reset_index(drop=True), "ups": None, **values}.items():
            object.__setattr__(part, name, value)
        return part

    def to_frame(self) -> pd.DataFrame:
        """A column for each number: the ids, then h0_x h0_y h0_z logit_0 (up0_x up0_y up0_z), h1_x and so on."""
        ups = [] if self.ups is None else [self.ups]
        values = np.concatenate([self.hypotheses, self.logits[:, :, None], *ups], axis=2)  # (N, M, 4 or 7)
        names = ("h{}_x", "h{}_y", "h{}_z", "logit_{}", "up{}_x", "up{}_y", "up{}_z")[: values.shape[2]]
        columns = [name.format(m) for m in range(self.heads) for name in names]
        numbers = pd.DataFrame(values.reshape(len(self), -1), columns=columns)  # (N, 4 M or 7 M)
        return pd.concat([self.ids, numbers], axis=1)

    @classmethod
    def from_frame(cls, frame: pd.DataFrame) -> "Predictions":
        """The inverse of `to_frame`. ViewnetError where a column is missing, or values are no predictions."""
        # Of none, the missing column is named below.
        heads = max(1, sum(name.startswith("logit_") for name in frame.columns))
        vectors, ups = ([f"{part}{m}_{axis}" for m in range(heads) for axis in "xyz"] for part in ("h", "up"))
        logits = [f"logit_{m}" for m in range(heads)]
        if missing := [name for name in (*ID_COLUMNS, *vectors, *logits) if name not in frame.columns]:
            raise ViewnetError(f"column {missing[0]!r} is missing: delete the file and make it again")
        return cls(
            frame[list(ID_COLUMNS)],
            frame[vectors].to_numpy().reshape(-1, heads, 3),  # (N, M, 3)
            frame[logits].to_numpy(),
            frame[ups].to_numpy().reshape(-1, heads, 3) if set(ups) <= set(frame.columns) else None,
        )

    def to_parquet(self, path: Path) -> None:
        """The table of `to_frame`."""
        with replacing(path) as temporary:
            self.to_frame().to_parquet(temporary, index=False)

    @classmethod
    def from_parquet(cls, path: Path) -> "Predictions":
        """Read what `to_parquet` wrote. ViewnetError, naming the file, where it is missing, damaged or incomplete."""
        frame = read_parquet(path)
        try:
            return cls.from_frame(frame)
        except ViewnetError as error:
            raise ViewnetError(f"{path}: {error}") from error


def write_compact(frame: pd.DataFrame, path: Path) -> None:
    """A parquet file as small as may be, of numbers in float32 and other columns with few values."""
    numbers = list(frame.columns[frame.dtypes == "float32"])
    # Bytes of numbers apart by their place, exponents together: a file of three fifths of the size.
    how = {"use_byte_stream_split": numbers, "use_dictionary": [c for c in frame if c not in numbers]}
    with replacing(path) as temporary:
        frame.to_parquet(temporary, index=False, compression="zstd", compression_level=19, **how)


def read_parquet(path: Path) -> pd.DataFrame:
    """A parquet file. ViewnetError, naming it, where it is missing or damaged."""
    try:
        return pd.read_parquet(path)
    except FileNotFoundError as error:
        raise ViewnetError(f"{path}: no such file") from error
    except Exception as error:  # The parquet reader raises its own types on damaged files.
        raise ViewnetError(f"{path}: not a readable parquet file: delete it and make it again") from error


def joined(parts: "Sequence[Predictions]") -> "Predictions":
    """Predictions of one predictor, concatenated. ViewnetError where they differ in hypotheses or up vectors."""
    frames = [part.to_frame() for part in parts]
    if len({tuple(frame.columns) for frame in frames}) != 1:
        heads = " and ".join(str(part.heads) for part in parts)
        raise ViewnetError(f"predictions of {heads} hypotheses, or with and without up vectors, cannot be joined")
    return Predictions.from_frame(pd.concat(frames))


def object_names(ids: pd.DataFrame) -> NDArray[np.object_]:
    """(N,) names of the objects of images: category and model id."""
    return (ids["category"] + "/" + ids["model_id"]).to_numpy(dtype=object)


def true_vectors(ids: pd.DataFrame) -> Floats:
    """(N, 3) unit view vectors of the columns azimuth and elevation, in degrees."""
    angles = torch.from_numpy(ids[["azimuth", "elevation"]].to_numpy(dtype=np.float64, copy=True))
    return geometry.view_vector(angles[:, 0], angles[:, 1]).numpy()


def _checked_ids(ids: pd.DataFrame) -> pd.DataFrame:
    if missing := [name for name in ID_COLUMNS if name not in ids.columns]:
        raise ViewnetError(f"predictions: column {missing[0]!r} is missing: expected {', '.join(ID_COLUMNS)}")
    if len(ids) == 0:
        raise ViewnetError("predictions: no rows")
    ids = ids[list(ID_COLUMNS)].reset_index(drop=True)
    if empty := [name for name in ID_COLUMNS if ids[name].isna().any()]:
        raise ViewnetError(f"predictions: column {empty[0]!r} has empty values")
    for name in ID_COLUMNS:
        # A number in place of text is an id that has lost its leading zeros.
        kind = "text" if name in ("model_id", "category", "split") else "numbers"
        found = pd.api.types.infer_dtype(ids[name].astype(object), skipna=False)
        if not (found == "string" if kind == "text" else pd.api.types.is_numeric_dtype(ids[name])):
            raise ViewnetError(f"predictions: column {name!r} holds values that are not {kind}")
    views = ids["view"].to_numpy(dtype=np.float64)
    if not (np.abs(views) < 2**53).all() or (views % 1).any():  # doubles hold every whole number below
        raise ViewnetError("predictions: column 'view' holds values that are not whole numbers")
    ids = ids.astype(dict(zip(ID_COLUMNS, (str, str, str, np.int64, np.float64, np.float64), strict=True)))
    if not np.isfinite(ids[["azimuth", "elevation"]].to_numpy()).all():
        raise ViewnetError("predictions: azimuth or elevation is not finite")
    if not ids["elevation"].between(-90, 90).all():
        raise ViewnetError(f"predictions: elevation {ids['elevation'].abs().max():g} is outside -90 to 90 degrees")
    duplicate = ids.duplicated(["category", "model_id", "view"])
    if duplicate.any():
        row = ids[duplicate].iloc[0]
        raise ViewnetError(f"predictions: view {row['view']} of model {row['model_id']} appears twice")
    return ids


def _floats(values: ArrayLike, name: str) -> Floats:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ViewnetError(f"predictions: {name} hold values that are not numbers") from None
    if not np.isfinite(array).all():
        rows = np.nonzero(~np.isfinite(array))[0]
        raise ViewnetError(f"predictions: {name} of row {rows[0]} are not finite ({len(set(rows.tolist()))} such rows)")
    array.flags.writeable = False  # frozen as well
    return array
