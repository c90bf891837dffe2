"""The run store: what is missing is trained, what is there is reused.

    <paths.runs()>/<variant>/<key>/config.json            what was asked for
                                   log.csv                a row a validation (viewnet.training.train)
                                   checkpoint.safetensors the kept weights
                                   predictions.parquet    of the validation and the test split; none where these
                                                          views cannot be scored (see can_be_scored)
                                   predictions-*.parquet  of photographs (see on_photographs)
                                   result.json            metrics (null where views cannot be scored) and where
                                                          they come from; written last

The key is a hash of everything that decides the training: configuration, identity of the views, and the code of
`TRAINING`. Prediction and evaluation are cheap, so a change in their code repeats them and not the training.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import logging
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from viewnet import paths
from viewnet.config import DataConfig, ModelConfig, RunConfig, TrainConfig, VideoConfig
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, evaluate
from viewnet.evaluation.predictions import Predictions, joined
from viewnet.model import checkpoint
from viewnet.runtime import provenance
from viewnet.runtime.files import locked, read_csv, read_json, write_json

log = logging.getLogger(__name__)

SCHEMA = 1
TRAINING = (
    "model/kernels/bfloat16_numba.py",
    "model/kernels/norm_relu_cpu.py",
    "model/kernels/norm_relu_numba.py",
    "model/kernels/numba_call.py",
    "model/kernels/trilinear_llvm.py",
    "model/kernels/volume_cpu.py",
    "model/kernels/volume_gpu.py",
    "model/kernels/volume_numba.py",
    "model/kernels/volume_triton.py",
    "model/checkpoint.py",
    "model/losses.py",
    "model/networks.py",
    "model/precision.py",
    "model/viewnet.py",
    "model/volume.py",
    "training/muon.py",
    "training/step.py",
    "training/train.py",
    "data/augment.py",
    "data/pairs.py",
    "evaluation/alignment.py",
    "runtime/distributed.py",
    "runtime/random.py",
    "runtime/torchvision_weights.py",
    "geometry.py",
)
"""The code that decides a training; identified by its statements, wherever they stand (provenance.code_identity)."""
UNTRAINED_CODE = ("evaluation/baselines.py", "geometry.py")
PREDICTING = ("evaluation/predict.py", "evaluation/predictions.py")
EVALUATING = (
    "evaluation/alignment.py",
    "evaluation/evaluate.py",
    "evaluation/metrics.py",
    "evaluation/predictions.py",
    "geometry.py",
)

STATE = "state.pt"
"""What a training goes on from (viewnet.training.train); gone when it has come to its end."""
NOT_SCORED = "its own views have no annotated val and test split"

UNTRAINED: dict[str, Callable[[pd.DataFrame], Predictions]] = {
    "constant": baselines.constant,
    "best_constant": baselines.best_constant,
    "random": baselines.random,
}
"""Variants that need no training: view-store index -> predictions in the annotated frame."""


@dataclass(frozen=True)
class Steps:
    """The functions a run is made of; spawned processes must be able to import them."""

    views: Callable[..., Any]  # (DataConfig, workers=, progress=, executor=) -> ViewStore
    open: Callable[[Path], Any]  # folder of a view store -> ViewStore
    train: Callable[..., None]  # (RunConfig, ViewStore, folder, threads=, progress=), resumable
    predict: Callable[..., Predictions]  # (folder of the run, ViewStore, splits=)


def default_steps() -> Steps:
    """The project's own, imported only when needed."""
    from viewnet.data.build import view_store
    from viewnet.data.store import ViewStore
    from viewnet.evaluation.predict import predict
    from viewnet.training.train import train

    return Steps(view_store, ViewStore.open, train, predict)


@dataclass(frozen=True)
class Run:
    """A finished run."""

    config: RunConfig
    folder: Path

    @property
    def key(self) -> str:
        """The name of the folder."""
        return self.folder.name

    @property
    def trained(self) -> bool:
        """Whether there is a checkpoint."""
        return self.config.variant not in UNTRAINED

    @property
    def alignment(self) -> str:
        """The alignment of its row in the tables: rigid for what is learned without labels, none for constants."""
        return "procrustes" if self.trained else "none"

    @property
    def result(self) -> dict[str, Any]:
        """The content of result.json."""
        return _result(self.folder / "result.json")

    @property
    def scored(self) -> bool:
        """Whether its own views could be scored: there are predictions, and metrics in `result`.

        ViewnetError for a run that is not finished.
        """
        if "metrics" not in (found := self.result):
            raise ViewnetError(f"{self.folder / 'result.json'}: no metrics: the run is not finished, train it again")
        return found["metrics"] is not None

    @property
    def predictions(self) -> Predictions:
        """Of the splits "val" and "test". ViewnetError where the run's own views could not be scored."""
        if not self.scored:
            raise ViewnetError(f"{name(self.config)}: {NOT_SCORED}: score it on photographs (on_photographs)")
        return Predictions.from_parquet(self.folder / "predictions.parquet")

    @property
    def log(self) -> pd.DataFrame:
        """A row a validation: epoch, step, seconds, losses, val_accuracy, val_reconstruction.

        ViewnetError where there is none.
        """
        if not (self.folder / "log.csv").is_file():
            raise ViewnetError(f"{self.folder}: no log.csv: {name(self.config)} needs no training, or it was removed")
        return read_log(self.folder / "log.csv")


def name(config: RunConfig) -> str:
    """How messages call a run.

    >>> from viewnet.recipes import make_config
    >>> name(make_config("viewnet_cycle", "chair", seed=1))
    'viewnet_cycle chair seed 1 (tiny, matting)'
    """
    return f"{config.variant} {config.category} seed {config.seed} ({config.profile}, {config.recipe})"


def untrained(variant: str, config: RunConfig) -> RunConfig:
    """The configuration of a predictor of `UNTRAINED` on the views of `config`; the settings it ignores at default.

    Raises ViewnetError for another variant.
    """
    if variant not in UNTRAINED:
        raise ViewnetError(f"unknown untrained variant {variant!r}: choose one of {', '.join(UNTRAINED)}")
    return replace(config, variant=variant, seed=0, model=ModelConfig(), train=TrainConfig())


def locate(config: RunConfig, identity: str, scenery: str = "") -> Path:
    """The folder of a run on views, and before backgrounds, of these identities, wherever their files lie."""
    code = TRAINING if config.variant not in UNTRAINED else UNTRAINED_CODE
    data = replace(config.data, root=None, splits=None, extra=None, backgrounds=None)
    if data.video is not None:
        # Of videos only what is said of them counts.
        data = DataConfig(data.category, video=replace(data.video, root=None, mask_folder=VideoConfig.mask_folder))
    placeless = replace(config, data=data, train=replace(config.train, start=None))
    identities = [identity, scenery] if scenery else [identity]
    identities += [checkpoint.identity(config.train.start)] if config.train.start else []
    return paths.runs() / config.variant / placeless.key(*identities, provenance.code_identity(code))


def _scenery(config: RunConfig, progress: bool) -> str:
    """What is behind the views that a run is trained on: its identity, "" for nothing. Made where it is not there."""
    if config.data.backgrounds is None:
        return ""
    from viewnet.data import augment

    found = augment.wanted(config.data, config.model.input_size, progress)
    return "" if found is None else found.identity


def ensure(
    configs: Sequence[RunConfig],
    workers: int | None = None,
    progress: bool = True,
    steps: Steps | None = None,
    executor: Executor | None = None,
) -> list[Run]:
    """The runs of `configs`, in their order, whatever is missing trained first.

    Up to `workers` are trained side by side in processes of their own, each with its share of the cores (default: as
    many as there are GPUs, or cores without any). Runs that another process is training are waited for. A failed run
    leaves the others to end; then ViewnetError names each failed run and why.

    With an `executor`, or a cluster in VIEWNET_CLUSTER (viewnet.training.dask_cluster), views are rendered and runs trained there;
    its workers see the same files. Under torchrun every process calls this, and trains each run together with the
    others; there the first failure ends all.
    """
    from viewnet.runtime import distributed
    from viewnet.training import dask_cluster
    from viewnet.training.worker_pool import make_together, run_all

    if workers is not None and workers < 1:
        raise ViewnetError(f"workers {workers}: expected 1 or more")
    steps = steps or default_steps()
    distributed.start()
    with (
        contextlib.nullcontext(executor)
        if executor or not dask_cluster.named()
        else dask_cluster.executor() as executor
    ):
        if executor is not None and distributed.size() > 1:
            raise ViewnetError("torchrun and a cluster at once: take torchrun for one run, a cluster for many")
        folders, jobs = distributed.first(lambda: _planned(configs, workers, progress, steps, executor))
        if distributed.size() > 1:
            make_together(jobs, steps, progress)
        elif failures := run_all(jobs, steps, workers, progress, executor):
            raise ViewnetError(f"{len(failures)} of {len(folders)} runs failed: {'; '.join(failures)}")
    return [Run(config, folders[config]) for config in configs]


def _planned(
    configs: Sequence[RunConfig], workers: int | None, progress: bool, steps: Steps, executor: Executor | None
) -> tuple[dict[RunConfig, Path], list[Job]]:
    """Each configuration's folder, and the runs that are not finished; their views are made."""
    wanted = list(dict.fromkeys(configs))
    stores: dict[DataConfig, Any] = {}
    for config in wanted:
        if config.data not in stores:
            stores[config.data] = steps.views(config.data, workers=workers, progress=progress, executor=executor)
    folders = {config: locate(config, stores[config.data].identity, _scenery(config, progress)) for config in wanted}
    missing = [config for config in wanted if not is_complete(folders[config])]
    # What takes longest is begun first and what is soonest done last, so that no core waits long at the end.
    missing.sort(key=lambda c: (c.model.decoder != "hologan", not c.train.cycle.on, c.model.heads == 1))
    # Another machine's process has another working directory.
    jobs = [Job(_placed(c), folders[c].absolute(), Path(stores[c.data].folder).absolute()) for c in missing]
    return folders, jobs


def _placed(config: RunConfig) -> RunConfig:
    """The same with the full path of what it starts from."""
    if config.train.start is None:
        return config
    return replace(config, train=replace(config.train, start=str(checkpoint.locate(config.train.start))))


@dataclass(frozen=True)
class Job:
    """A run that is not finished, and where its views lie."""

    config: RunConfig
    folder: Path
    views: Path


def _result(path: Path) -> dict[str, Any]:
    if not isinstance(found := read_json(path), dict):
        raise ViewnetError(f"{path}: not a run's result: delete it, and what is missing of the run is made again")
    return found


def read_log(path: Path) -> pd.DataFrame:
    """A training's log, all of its columns numbers, or no rows; ViewnetError for anything else."""
    found = read_csv(path)
    if found.empty:  # nothing has been validated yet
        return found
    if wrong := [name for name in found.columns if not pd.api.types.is_numeric_dtype(found[name])]:
        raise ViewnetError(f"{path}: column {str(wrong[0])[:60]!r} holds values that are not numbers")
    if missing := {"epoch", "step", "seconds", "loss", "val_accuracy"} - set(found.columns):
        raise ViewnetError(f"{path}: column {min(missing)!r} is missing")
    return found


def is_complete(folder: Path) -> bool:
    """Whether a run is finished by the present code."""
    if not (folder / "result.json").is_file():
        return False
    result = _result(folder / "result.json")
    if not (result.get("schema") == SCHEMA and "metrics" in result and result.get("code") == _codes()):
        return False
    return result["metrics"] is None or (folder / "predictions.parquet").is_file()


def can_be_scored(index: pd.DataFrame) -> bool:
    """Whether a view store has the splits val, to align on, and test, to score, with all their viewpoints annotated."""
    held_out = index[index["split"].isin(("val", "test"))]
    return held_out["split"].nunique() == 2 and bool(held_out[["azimuth", "elevation"]].notna().all(axis=None))


def make(job: Job, steps: Steps, threads: int | None = None, progress: bool = True) -> None:
    """Train, predict and evaluate what of a run is not there. Waits where another process does.

    A run on views that cannot be scored (can_be_scored) is trained only. Raises ViewnetError for an untrained predictor
    on such views.
    """
    config, folder = job.config, job.folder
    with locked(folder):
        if is_complete(folder):
            return
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "config.json", config.to_dict())
        views = steps.open(job.views)
        result = _result(folder / "result.json") if (folder / "result.json").is_file() else {}
        predictions: Predictions | None = None
        scored = can_be_scored(views.index)
        if config.variant in UNTRAINED:
            if not scored:
                raise ViewnetError(f"{name(config)}: {NOT_SCORED}, and it is nothing else than its score")
            predictions = UNTRAINED[config.variant](views.index)
        else:
            if not ("training" in result and (folder / "checkpoint.safetensors").is_file()):
                training = _train(config, views, folder, steps, threads, progress)
                result = {"schema": SCHEMA, "training": training}
                write_json(folder / "result.json", result)
            current = result.get("code", {}).get("predicting") == _codes()["predicting"]
            if scored and not (current and (folder / "predictions.parquet").is_file()):
                predictions = steps.predict(folder, views, splits=("val", "test"))
        if predictions is not None:
            predictions.to_parquet(folder / "predictions.parquet")
        elif scored:
            predictions = Predictions.from_parquet(folder / "predictions.parquet")
        kinds = ("procrustes", "linear") if config.variant not in UNTRAINED else ("none", "procrustes")
        result = {
            "schema": SCHEMA,
            "key": folder.name,
            "variant": config.variant,
            "category": config.category,
            "profile": config.profile,
            "recipe": config.recipe,
            "seed": config.seed,
            "views": views.identity,
            "metrics": None if predictions is None else {kind: evaluate.evaluate(predictions, kind) for kind in kinds},
            "code": _codes(),
            "git": provenance.commit(),
            "training": result.get("training"),
        }
        write_json(folder / "result.json", result)


def _train(
    config: RunConfig, views: Any, folder: Path, steps: Steps, threads: int | None, progress: bool
) -> dict[str, Any]:
    from viewnet.runtime import distributed

    resumed = (folder / "log.csv").is_file()
    started, begun = datetime.datetime.now(datetime.UTC), time.perf_counter()
    try:
        steps.train(config, views, folder, threads=threads, progress=progress)
    except ViewnetError as error:
        raise ViewnetError(f"{error}{_kept(folder)}") from error
    (folder / STATE).unlink(missing_ok=True)  # where a killed process had kept the weights and not come to this
    if not (folder / "checkpoint.safetensors").is_file():
        raise ViewnetError(f"{folder}: training left no checkpoint")
    seconds = time.perf_counter() - begun
    if (folder / "log.csv").is_file() and len(kept := read_log(folder / "log.csv")) and "seconds" in kept:
        seconds = max(seconds, float(kept["seconds"].iloc[-1]))  # what was spent before an interruption counts too
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


def _kept(folder: Path) -> str:
    """What a training that failed has reached, in words."""
    if not (folder / STATE).is_file():
        return ""
    try:
        epoch = f" of epoch {int(read_log(folder / 'log.csv')['epoch'].iloc[-1])}"
    except (ViewnetError, LookupError):
        epoch = ""
    return f" (the state{epoch} is kept in {folder / STATE})"


def score_on(run: Run, views: Any, alignment: str | None = None, steps: Steps | None = None) -> dict[str, Any]:
    """How a finished run does on other views, say of CAD models made by artists: `evaluate`'s dictionary.

    All views of the store `views` are scored, whatever their split; the alignment is still fitted on the run's own
    validation views. Raises ViewnetError for the run's own views and for objects it was trained or calibrated on.
    """
    return evaluate.evaluate(transferred(run, views, steps), alignment or run.alignment)


def transferred(run: Run, views: Any, steps: Steps | None = None) -> Predictions:
    """The run's own validation predictions, and as "test" its predictions of all views of another store.

    Raises ViewnetError for the views it was trained on, and for models it has seen.
    """
    steps = steps or default_steps()
    own = steps.views(run.config.data, progress=False)
    if own.identity == views.identity:
        raise ViewnetError(f"{name(run.config)}: these are the views it was trained on: its scores are in result.json")
    seen = own.index[own.index["split"] != "test"]
    if both := set(seen["model_id"]) & set(views.index["model_id"]):
        raise ViewnetError(
            f"{name(run.config)}: model {sorted(both)[0]} was seen in training: score it on other models"
        )
    validation = run.predictions.subset("val")
    if run.trained:
        splits = tuple(views.index["split"].unique())
        other = steps.predict(run.folder, views, splits=splits)
    else:
        chosen = validation.hypotheses[:1]  # the same for every image
        other = Predictions(
            views.index, chosen.repeat(len(views.index), 0), validation.logits[:1].repeat(len(views.index), 0)
        )
    scored = Predictions(other.ids.assign(split="test"), other.hypotheses, other.logits, other.ups)
    return joined([validation, scored])


def on_photographs(run: Run, store: Any, steps: Steps | None = None) -> Predictions:
    """What a trained run says of the photographs of a store: its splits "val", to align on, and "test", to score.

    Kept in the run's folder as `predictions-<store's identity>-<code's>-<checkpoint's>.parquet`, and made anew where
    the store, the code that predicts or the checkpoint is another. Raises ViewnetError for a run that was not trained.
    """
    if not run.trained:
        raise ViewnetError(f"{name(run.config)} has no network to look at photographs: choose a trained variant")
    # By what the weights are and not by their file's time: clocks are set, and files copied.
    try:
        weights = hashlib.sha256((run.folder / checkpoint.CHECKPOINT).read_bytes()).hexdigest()[:12]
    except OSError as error:
        raise ViewnetError(
            f"{run.folder / checkpoint.CHECKPOINT}: cannot be read ({error.strerror}): train it again"
        ) from error
    path = run.folder / f"predictions-{store.identity}-{_codes()['predicting']}-{weights}.parquet"
    if path.is_file():
        return Predictions.from_parquet(path)
    found = (steps or default_steps()).predict(run.folder, store, splits=("val", "test"))
    found.to_parquet(path)
    for stale in run.folder.glob(f"predictions-{store.identity}-*.parquet"):
        if stale != path:
            stale.unlink(missing_ok=True)
    return found


def _codes() -> dict[str, str]:
    return {
        "predicting": provenance.code_identity(PREDICTING),
        "evaluating": provenance.code_identity(EVALUATING),
    }
