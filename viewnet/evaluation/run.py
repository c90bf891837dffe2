"""A finished run on disk: its configuration, result, predictions and log. Needs nothing that trains."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from viewnet.config import RunConfig
from viewnet.errors import ViewnetError
from viewnet.evaluation.baselines import UNTRAINED
from viewnet.evaluation.predictions import Predictions
from viewnet.recipes import ABSOLUTE
from viewnet.runtime.files import read_csv, read_json

NOT_SCORED = "its own views have no annotated val and test split"
ROBUST_PREDICTIONS = "predictions_robust.parquet"  # by model.checkpoint.ROBUST
LEARNED_ALIGNMENTS = ("procrustes", "linear")  # without pose labels: the tables' rows, then the paper's starred rows
FITTED_ALIGNMENTS = ("none", "procrustes")  # what is fitted on labels is in the annotated frame already
LOG_COLUMNS = ("epoch", "loss", "seconds", "step", "val_accuracy")  # of every training log


@dataclass(frozen=True)
class Run:
    """A configuration and the folder that training filled."""

    config: RunConfig
    folder: Path

    @property
    def key(self) -> str:
        """The name of the folder."""
        return self.folder.name

    @property
    def name(self) -> str:
        """What messages call it, see `run_name`."""
        return run_name(self.config)

    @property
    def trained(self) -> bool:
        """Whether there is a checkpoint."""
        return self.config.variant not in UNTRAINED  # constants and random predictions are runs as well

    @property
    def alignments(self) -> tuple[str, ...]:
        """The alignments it is scored by."""
        fitted = not self.trained or self.config.variant in ABSOLUTE
        return FITTED_ALIGNMENTS if fitted else LEARNED_ALIGNMENTS

    @property
    def alignment(self) -> str:
        """The alignment of its row in the tables."""
        return self.alignments[0]  # the paper reports the rotation, and the affine map beside it

    @property
    def result(self) -> dict[str, Any]:
        """The content of result.json. ViewnetError where there is none, or a damaged one."""
        return read_result(self.folder / "result.json")

    @property
    def scored(self) -> bool:
        """Whether its own views could be scored, so that there are predictions. ViewnetError for an unfinished run."""
        result = self.result
        if "metrics" not in result:
            raise ViewnetError(f"{self.folder / 'result.json'}: no metrics: the run is not finished, train it again")
        return result["metrics"] is not None

    @property
    def predictions(self) -> Predictions:
        """Of the splits "val" and "test". ViewnetError where the run's own views could not be scored."""
        if not self.scored:
            raise ViewnetError(f"{self.name}: {NOT_SCORED}: score it on photographs")
        return Predictions.from_parquet(self.folder / "predictions.parquet")

    @property
    def log(self) -> pd.DataFrame:
        """The training log, see `read_log`. ViewnetError where there is none."""
        if not (path := self.folder / "log.csv").is_file():
            raise ViewnetError(f"{self.folder}: no log.csv: {self.name} needs no training, or it was removed")
        return read_log(path)

    @property
    def reconstruction(self) -> float:
        """The least error with which validation views were reconstructed, NaN where none was logged; needs no label."""
        return float(self.log.get("val_reconstruction", pd.Series(dtype=float)).min())


def run_name(config: RunConfig) -> str:
    """What messages call a run.

    >>> from viewnet.recipes import make_config
    >>> run_name(make_config("viewnet_cycle", "chair", seed=1))
    'viewnet_cycle chair seed 1 (tiny, matting)'
    """
    return f"{config.variant} {config.category} seed {config.seed} ({config.profile}, {config.recipe})"


def read_result(path: Path) -> dict[str, Any]:
    """The content of a result.json, of a run that may not be finished. ViewnetError for anything but a JSON object."""
    if not isinstance(result := read_json(path), dict):
        raise ViewnetError(f"{path}: not a run's result: delete it, and what is missing of the run is made again")
    return result


def read_log(path: Path) -> pd.DataFrame:
    """A training log: a row for each validation, or none yet. ViewnetError unless it has `LOG_COLUMNS`, all numeric."""
    log = read_csv(path)
    if log.empty:  # nothing has been validated yet
        return log
    if wrong := [name for name in log.columns if not pd.api.types.is_numeric_dtype(log[name])]:
        raise ViewnetError(f"{path}: column {str(wrong[0])[:60]!r} holds values that are not numbers")
    if missing := set(LOG_COLUMNS) - set(log.columns):
        raise ViewnetError(f"{path}: column {min(missing)!r} is missing")
    return log


def can_be_scored(index: pd.DataFrame) -> bool:
    """Whether a view store has the splits val, to align on, and test, to score, with every viewpoint annotated."""
    held_out = index[index["split"].isin(("val", "test"))]
    return held_out["split"].nunique() == 2 and bool(held_out[["azimuth", "elevation"]].notna().all(axis=None))
