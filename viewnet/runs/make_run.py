"""Making one run: train, predict and evaluate whatever of it is missing in its folder."""

import contextlib
import datetime
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from viewnet.config import RunConfig
from viewnet.errors import ViewnetError
from viewnet.evaluation.baselines import UNTRAINED
from viewnet.evaluation.evaluate import scores
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import NOT_SCORED, ROBUST_PREDICTIONS, Run, can_be_scored, read_log, read_result
from viewnet.model import checkpoint
from viewnet.recipes import PEERS
from viewnet.runtime import distributed, provenance
from viewnet.runtime.files import locked, write_json, write_text
from viewnet.training.history import STATE

SCHEMA = 1  # of result.json
# A change in the statements of these modules repeats predictions and metrics of finished runs, not their training.
PREDICTING = ("evaluation/predict.py", "evaluation/predictions.py")
EVALUATING = (*(f"evaluation/{name}.py" for name in ("alignment", "evaluate", "metrics", "predictions")), "geometry.py")


@dataclass(frozen=True)
class Steps:
    """The functions a run is made of; spawned processes must be able to import them."""

    views: Callable[..., Any]  # (DataConfig, workers=, progress=, executor=) -> ViewStore
    open: Callable[[Path], Any]  # folder of a view store -> ViewStore
    train: Callable[..., None]  # (RunConfig, ViewStore, folder, threads=, progress=), resumable
    predict: Callable[..., Predictions]  # (folder of the run, ViewStore, splits=, checkpoint=)


def default_steps() -> Steps:
    """Rendering, training and prediction of this package, imported only when needed."""
    from viewnet.data.build import view_store
    from viewnet.data.store import ViewStore
    from viewnet.evaluation.predict import predict

    return Steps(view_store, ViewStore.open, train_any, predict)


def train_any(config: RunConfig, *where: Any, **how: Any) -> None:
    """Training of ViewNet (viewnet.training.train.train), or of a peer (viewnet.training.train_peer.train_peer)."""
    if config.variant in PEERS:
        from viewnet.training.train_peer import train_peer as train
    else:
        from viewnet.training.train import train
    # Numbers below 1e-38, such as a blur's tails, would slow Intel's processors down, and change nothing that counts.
    torch.set_flush_denormal(True)
    try:
        train(config, *where, **how)
    finally:
        torch.set_flush_denormal(False)


@dataclass(frozen=True)
class Job(Run):
    """A run that is not finished, and the folder of its view store."""

    views: Path


_one_at_a_time = threading.Lock()


def attempt(job: Job, steps: Steps, threads: int | None, progress: bool = False) -> str | None:
    """Make a job. None, or what went wrong in one line, with the traceback of an unforeseen error in error.log."""
    with _one_at_a_time:  # however many threads an executor gives a process: seeds and thread counts are global
        threads_before = torch.get_num_threads()
        try:
            make(job, steps, threads, progress)
        except ViewnetError as error:
            return f"{job.name}: {error}"
        except Exception as error:
            report, where = job.folder / "error.log", ""
            with contextlib.suppress(ViewnetError):  # the error may be that nothing can be written
                write_text(report, traceback.format_exc())
                where = f" (see {report})"
            return f"{job.name}: {one_line(error)}{where}"
        finally:
            torch.set_num_threads(threads_before)
    return None


def one_line(error: BaseException) -> str:
    """The type of an error and the first line of its message."""
    return f"{type(error).__name__}: {(str(error).strip().splitlines() or [''])[0]}"


def make(job: Job, steps: Steps, threads: int | None = None, progress: bool = True) -> None:
    """Train, predict and evaluate what is missing of a run; waits where another process is making it.

    A run on views that cannot be scored is trained only; ViewnetError for an untrained predictor on such views.
    """
    config, folder = job.config, job.folder
    with locked(folder):
        if is_complete(folder):
            return
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "config.json", config.to_dict())
        views = steps.open(job.views)
        result = job.result if (folder / "result.json").is_file() else {}
        predictions: Predictions | None = None
        scored = can_be_scored(views.index)
        if not job.trained:
            if not scored:
                raise ViewnetError(f"{job.name}: {NOT_SCORED}, and there is nothing to train: use an annotated store")
            predictions = UNTRAINED[config.variant](views.index)
        else:
            # A training that ended is never repeated; predictions are, where the code that predicts has changed.
            if not ("training" in result and (folder / checkpoint.CHECKPOINT).is_file()):
                result = {"schema": SCHEMA, "training": _train(job, views, steps, threads, progress)}
                write_json(folder / "result.json", result)
            current = result.get("code", {}).get("predicting") == code_identities()["predicting"]
            if scored and not (current and (folder / "predictions.parquet").is_file()):
                predictions = steps.predict(folder, views, splits=("val", "test"))
            robust = folder / checkpoint.ROBUST
            if scored and robust.is_file() and not (current and (folder / ROBUST_PREDICTIONS).is_file()):
                other = steps.predict(folder, views, splits=("val", "test"), checkpoint=checkpoint.ROBUST)
                other.to_parquet(folder / ROBUST_PREDICTIONS)
        if predictions is not None:
            predictions.to_parquet(folder / "predictions.parquet")
        elif scored:
            predictions = Predictions.from_parquet(folder / "predictions.parquet")
        # Metrics are cheap and follow from predictions, so they are always computed anew.
        metrics = None if predictions is None else scores(predictions, job.alignments)
        result = {
            "schema": SCHEMA,
            "key": folder.name,
            **{name: getattr(config, name) for name in ("variant", "category", "profile", "recipe", "seed")},
            "views": views.identity,
            "metrics": metrics,
            "code": code_identities(),
            "git": provenance.commit(),
            "training": result.get("training"),
        }
        write_json(folder / "result.json", result)


def is_complete(folder: Path) -> bool:
    """Whether a run is finished, and predicted and evaluated by the present code."""
    result = read_result(folder / "result.json") if (folder / "result.json").is_file() else {}
    if not (result.get("schema") == SCHEMA and "metrics" in result and result.get("code") == code_identities()):
        return False
    return result["metrics"] is None or (folder / "predictions.parquet").is_file()


def code_identities() -> dict[str, str]:
    """The identities of the code that predicts and of the code that evaluates, as result.json has them."""
    return {"predicting": provenance.code_identity(PREDICTING), "evaluating": provenance.code_identity(EVALUATING)}


def _train(job: Job, views: Any, steps: Steps, threads: int | None, progress: bool) -> dict[str, Any]:
    """Train a run, or resume it; how that went, for result.json."""
    config, folder = job.config, job.folder
    resumed = (folder / "log.csv").is_file()
    started, clock = datetime.datetime.now(datetime.UTC), time.perf_counter()
    try:
        steps.train(config, views, folder, threads=threads, progress=progress)
    except ViewnetError as error:
        raise ViewnetError(f"{error}{_saved_state(folder)}") from error
    (folder / STATE).unlink(missing_ok=True)  # left by a process that was killed after it had saved the weights
    if not (folder / checkpoint.CHECKPOINT).is_file():
        raise ViewnetError(f"{folder}: training left no checkpoint")
    seconds = time.perf_counter() - clock
    if (folder / "log.csv").is_file() and len(log := read_log(folder / "log.csv")):
        seconds = max(seconds, float(log["seconds"].iloc[-1]))  # time spent before an interruption counts too
    return {
        "started": started.isoformat(timespec="seconds"),
        "finished": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "seconds": round(seconds, 1),
        "resumed": resumed,
        "start": checkpoint.identity(config.train.start) if config.train.start else None,
        "seeds": {"run": config.seed, "data": (config.data.video or config.data).seed, "evaluation": 0},
        "hardware": provenance.hardware(threads),
        "processes": distributed.size(),
        "git": provenance.commit(),
        "versions": provenance.versions(),
    }


def _saved_state(folder: Path) -> str:
    """The end of the message of a failed training: which state the next call resumes from, if any."""
    if not (folder / STATE).is_file():
        return ""
    epoch = ""
    with contextlib.suppress(ViewnetError, LookupError):  # no log, or none of a whole epoch
        epoch = f" of epoch {int(read_log(folder / 'log.csv')['epoch'].iloc[-1])}"
    return f" (the state{epoch} is kept in {folder / STATE})"
