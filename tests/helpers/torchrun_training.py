"""Trainings as a script, for torchrun: `torchrun_training.py TASK...` with files that test_distributed writes."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import torch

from viewnet.config import RunConfig
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.runtime import distributed
from viewnet.training import train as training

STEP_LOSS, TOGETHER = training.step_loss, distributed.together


class Recorder(torch.optim.SGD):
    """Keeps the gradients of a step in a file, and changes nothing."""

    def __init__(self, model: torch.nn.Module, file: Path):
        super().__init__(model.parameters(), lr=1.0)
        self.names, self.file = {id(weight): name for name, weight in model.named_parameters()}, file
        self.param_groups[0]["initial_lr"] = 1.0

    def step(self, closure: Any = None) -> None:
        weights = self.param_groups[0]["params"]
        found = {self.names[id(weight)]: weight.grad.clone() for weight in weights if weight.grad is not None}
        if last():  # which has the same ones as the first
            torch.save(found, self.file)


def last() -> bool:
    return distributed.rank() == distributed.size() - 1


def one_step(task: dict[str, Any], folder: Path) -> list[Any]:
    """A step of a training at the share `progress`; alone with the normalisation of viewnet, which rounds less."""

    def together(model: torch.nn.Module) -> None:
        TOGETHER(model)
        distributed.share_normalisation(model)

    def step_loss(*arguments: Any) -> Any:
        return STEP_LOSS(*arguments[:4], task["progress"], *arguments[5:])

    recorder = mock.patch.object(
        training, "make_optimisers", lambda model, _: [Recorder(model, folder.with_suffix(".gradients"))]
    )
    return [
        recorder,
        mock.patch.object(distributed, "together", together),
        mock.patch.object(training, "step_loss", step_loss),
    ]


def failing(kind: str, steps: int) -> Any:
    """Make the last process die, or its loss NaN, after some steps."""
    left = iter(range(steps))

    def step_loss(*arguments: Any) -> Any:
        found = STEP_LOSS(*arguments)
        if next(left, None) is None and last():
            if kind == "die":
                os.kill(os.getpid(), signal.SIGKILL)
            return {name: value * float("nan") for name, value in found.items()}
        return found

    return mock.patch.object(training, "step_loss", step_loss)


def run(task: dict[str, Any]) -> None:
    folder = Path(task["folder"])
    patches = one_step(task, folder) if "progress" in task else []
    patches += [failing(kind, task[kind]) for kind in ("die", "nan") if kind in task]
    with contextlib.ExitStack() as stack:
        for patch in patches:
            stack.enter_context(patch)
        views = ViewStore.open(task["views"])
        training.train(RunConfig.from_dict(task["config"]), views, folder, threads=1, progress=False)


def main() -> None:
    torch.set_num_threads(1)
    try:
        for file in sys.argv[1:]:
            run(json.loads(Path(file).read_text()))
    except ViewnetError as error:
        if distributed.size() == 1:
            raise
        distributed.fail(f"viewnet: {error}")
    distributed.stop()


if __name__ == "__main__":
    main()
