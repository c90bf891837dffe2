"""Predictions of finished runs for views other than their own: another collection, or photographs."""

import hashlib
from typing import Any

from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Predictions, joined
from viewnet.evaluation.run import Run
from viewnet.model import checkpoint
from viewnet.runs import make_run


def transferred(run: Run, views: Any, steps: make_run.Steps | None = None) -> Predictions:
    """The run's own validation predictions and, as split "test", its predictions of all views of another store.

    Raises ViewnetError for the views it was trained on, and for models it was trained or validated on.
    """
    steps = steps or make_run.default_steps()
    own = steps.views(run.config.data, progress=False)
    if own.identity == views.identity:
        raise ViewnetError(f"{run.name}: these are the views it was trained on: its scores are in result.json")
    seen = own.index[own.index["split"] != "test"]
    if both := set(seen["model_id"]) & set(views.index["model_id"]):
        raise ViewnetError(f"{run.name}: model {sorted(both)[0]} was seen in training: score it on other models")
    validation = run.predictions.subset("val")
    if run.trained:
        other = steps.predict(run.folder, views, splits=tuple(views.index["split"].unique()))
    else:  # the same hypothesis for every image
        same = (values[:1].repeat(len(views.index), 0) for values in (validation.hypotheses, validation.logits))
        other = Predictions(views.index, *same)
    scored = Predictions(other.ids.assign(split="test"), other.hypotheses, other.logits, other.ups)
    return joined([validation, scored])


def on_photographs(run: Run, store: Any, steps: make_run.Steps | None = None) -> Predictions:
    """A trained run's predictions for a store of photographs: its splits "val" (to align on), if any, and "test".

    Cached in the run's folder as `predictions-<store's identity>-<code's>-<checkpoint's>.parquet`. Raises ViewnetError
    for a run without a checkpoint.
    """
    if not run.trained:
        raise ViewnetError(f"{run.name} has no network to predict photographs with: choose a trained variant")
    # By the content of the file and not its time: clocks are set, and files copied.
    file = run.folder / checkpoint.CHECKPOINT
    try:
        weights = hashlib.sha256(file.read_bytes()).hexdigest()[:12]
    except OSError as error:
        raise ViewnetError(f"{file}: cannot be read ({error.strerror}): train it again") from error
    path = run.folder / f"predictions-{store.identity}-{make_run.code_identities()['predicting']}-{weights}.parquet"
    if path.is_file():
        return Predictions.from_parquet(path)
    splits = tuple(name for name in ("val", "test") if (store.index["split"] == name).any())
    predictions = (steps or make_run.default_steps()).predict(run.folder, store, splits=splits)
    predictions.to_parquet(path)
    for stale in run.folder.glob(f"predictions-{store.identity}-*.parquet"):
        if stale != path:
            stale.unlink(missing_ok=True)
    return predictions
