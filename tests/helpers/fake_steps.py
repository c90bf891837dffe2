"""A stand-in for rendering, training and prediction that takes milliseconds; importable by spawned processes."""

from __future__ import annotations

import json
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from helpers.evaluation_data import make_index, noisy

from viewnet.config import DataConfig, RunConfig
from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Predictions
from viewnet.model.checkpoint import CHECKPOINT
from viewnet.recipes import make_config
from viewnet.runs.make_run import Steps
from viewnet.runtime.files import replacing

EPOCHS = 4


@dataclass(frozen=True)
class FakeStore:
    folder: Path
    index: pd.DataFrame
    identity: str


def views(config: DataConfig, workers=None, progress=True, executor=None) -> FakeStore:
    folder = Path(os.environ["VIEWNET_DATA"]) / "views" / f"{config.category}-{config.seed}"
    if config.root is not None:
        folder = folder.with_name(f"{folder.name}-other")
    if config.video is not None:
        folder = folder.with_name(f"{folder.name}-{config.video.mask_folder}")
    folder.mkdir(parents=True, exist_ok=True)
    index = make_index(30, 4, config.category, seed=config.seed).assign(source="")
    if config.root is not None:
        index["model_id"] = "real-" + index["model_id"]
    if config.seed:  # other models
        index["model_id"] = f"seed{config.seed}-" + index["model_id"]
    with replacing(folder / "index.parquet") as temporary:  # another process may be reading it
        index.to_parquet(temporary)
    return open_store(folder)


def open_store(folder: Path) -> FakeStore:
    return FakeStore(folder, pd.read_parquet(folder / "index.parquet"), folder.name)


def train(config: RunConfig, views: FakeStore, folder: Path, *, threads=None, progress=True) -> None:
    """Logs its epochs in log.csv, leaves one file a call in `calls`, and follows the seed's plan in plan.json."""
    calls = Path(os.environ["VIEWNET_DATA"]) / "calls"
    calls.mkdir(parents=True, exist_ok=True)
    (calls / f"{config.category}-{config.seed}-{time.time_ns()}").write_text(f"{os.getpid()} {threads}")
    log = folder / "log.csv"
    done = len(log.read_text().splitlines()) - 1 if log.exists() else 0
    plan = Path(os.environ["VIEWNET_DATA"]) / "plan.json"
    what = json.loads(plan.read_text()).get(str(config.seed)) if plan.exists() else None
    for epoch in range(done + 1, EPOCHS + 1):
        if not log.exists():
            log.write_text("epoch,step,seconds,loss,val_accuracy,val_reconstruction\n")
        with log.open("a") as file:
            error = 0.1 / epoch + 0.01 * abs(config.seed - 1)  # seed 1 reconstructs best
            file.write(f"{epoch},{10 * epoch},{100.0 * epoch},{1 / epoch},{10 * epoch},{error}\n")
        if epoch == 2 and what == "refuse":
            raise ViewnetError("the loss is not finite at step 20: lower the learning rate")
        if epoch == 2 and what == "crash":
            raise ZeroDivisionError("division by zero\nand more")
        if epoch == 2 and what == "die" and done == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        if epoch == 2 and what == "hang" and done == 0:
            time.sleep(600)
        if what == "slow":
            time.sleep(0.3)
    (folder / CHECKPOINT).write_bytes(b"weights")


def predict(folder: Path, views: FakeStore, splits=("val", "test"), checkpoint=CHECKPOINT) -> Predictions:
    config = json.loads((folder / "config.json").read_text())
    found = noisy(
        views.index[["model_id", "category", "split", "view", "azimuth", "elevation"]].assign(split="test"),
        degrees=8,
        seed=config["seed"] + 100 * (checkpoint != CHECKPOINT),
    )
    found = Predictions(found.ids.assign(split=views.index["split"].to_numpy()), found.hypotheses, found.logits)
    return found.take(found.ids["split"].isin(splits))


STEPS = Steps(views, open_store, train, predict)


def config(seed: int = 0, category: str = "car") -> RunConfig:
    return make_config(category=category, profile="smoke", seed=seed)


def plan(folder: Path, **what: str) -> None:
    """The plan for fake runs: `seed0="..."` for the one with seed 0, in the data folder below `folder`."""
    (folder / "data").mkdir(exist_ok=True)
    (folder / "data" / "plan.json").write_text(json.dumps({k.removeprefix("seed"): v for k, v in what.items()}))


def calls(folder: Path) -> list[str]:
    """The trainings started so far, by name."""
    return sorted(p.name.rsplit("-", 1)[0] for p in (folder / "data" / "calls").glob("*"))
