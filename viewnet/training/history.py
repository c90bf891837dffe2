"""How far a training is: its log, its best weights so far, and the files that it resumes from."""

import csv
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor
from torch.optim import Optimizer

from viewnet.config import RunConfig
from viewnet.errors import ViewnetError
from viewnet.model.checkpoint import CHECKPOINT, ROBUST
from viewnet.model.viewnet import ViewNet
from viewnet.runtime import distributed
from viewnet.runtime.files import replacing

STATE = "state.pt"
"""What a training resumes from; removed when it has come to its end."""


@dataclass
class History:
    """How far a training is: its log, and the best weights so far by each rule that counts: a score of validation."""

    epoch: int = 0  # finished ones
    seconds: float = 0.0
    log: list[dict[str, Any]] = field(default_factory=list)
    best: dict[str, dict[str, Any]] = field(default_factory=dict)

    def exhausted(self, patience: int, by: str) -> bool:
        """Whether the last `patience` epochs brought no improvement by a rule."""
        return bool(self.log) and self.log[-1]["epoch"] - 1 - self.best[by]["epoch"] >= patience  # `best` counts from 0

    def add(
        self, model: ViewNet, step: int, rules: tuple[str, ...], scores: dict[str, float], means: dict[str, float]
    ) -> None:
        """Adds a row to the log, and keeps the weights where they are the best by one of `rules`."""
        weights: dict[str, Tensor] = {}
        for rule in rules:
            score = -scores[rule] if rule == "reconstruction" else scores[rule]  # higher is better
            if rule not in self.best or score > self.best[rule]["score"]:  # a first score of NaN counts
                weights = weights or {  # copied, as training goes on; contiguous, as safetensors wants them
                    name: value.detach().cpu().clone(memory_format=torch.contiguous_format)
                    for name, value in model.state_dict().items()
                }
                self.best[rule] = {"score": score, "epoch": self.epoch - 1, "weights": weights}
        self.log.append(
            {"epoch": self.epoch, "step": step, "seconds": round(self.seconds, 2)}  # columns of log.csv, in this order
            | {"loss": sum(means.values())}
            | {f"val_{name}": value for name, value in scores.items()}
            | means  # the loss's terms
        )


def resume(model: ViewNet, optimisers: list[Optimizer], folder: Path) -> History:
    """How far the training in `folder` is; its state goes to the model and the optimisers."""

    def saved() -> dict[str, Any] | None:
        path = folder / STATE
        # weights_only: tensors and plain values, no code.
        return torch.load(path, map_location="cpu", weights_only=True) if path.exists() else None

    state = distributed.first(saved)  # one process reads, all get it
    if state is None:
        return History()
    model.load_state_dict(state["model"])
    for optimiser, values in zip(optimisers, state["optimisers"], strict=True):
        optimiser.load_state_dict(values)
    return History(state["epoch"], state["seconds"], state["log"], state["best"])


def write(model: ViewNet, optimisers: list[Optimizer], history: History, folder: Path) -> None:
    """Writes log.csv, and all that `resume` needs."""
    columns = list(dict.fromkeys(name for row in history.log for name in row))  # terms may join later
    with replacing(folder / "log.csv") as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(history.log)
    state: dict[str, Any] = {"model": model.state_dict(), "optimisers": [each.state_dict() for each in optimisers]}
    state |= {"log": history.log, "best": history.best, "epoch": history.epoch, "seconds": history.seconds}
    with replacing(folder / STATE) as temporary:  # last: state.pt never is ahead of log.csv
        torch.save(state, temporary)


def keep_best(config: RunConfig, history: History, folder: Path) -> None:
    """Writes a checkpoint of the best weights by each rule, and removes the state: the training has come to its end."""
    by = config.train.select_by
    for rule in sorted(history.best, key=lambda rule: rule == by):  # its own rule's last, which means finished
        best = history.best[rule]
        about = {"config": json.dumps(config.to_dict()), "epoch": str(best["epoch"] + 1), "score": repr(best["score"])}
        with replacing(folder / (CHECKPOINT if rule == by else ROBUST)) as temporary:
            save_file(best["weights"], temporary, metadata=about)
    (folder / STATE).unlink(missing_ok=True)  # after the checkpoint: one of the two is always there


def board_of(folder: Path) -> Any:
    """A TensorBoard log in the run's folder where VIEWNET_TENSORBOARD is set, else None.

    Raises ViewnetError where TensorBoard is not installed.
    """
    if not os.environ.get("VIEWNET_TENSORBOARD"):
        return None
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise ViewnetError(
            "VIEWNET_TENSORBOARD is set, but TensorBoard is not installed: pip install tensorboard, or unset it"
        ) from error
    return SummaryWriter(folder / "tensorboard")
