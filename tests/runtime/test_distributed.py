"""Training in two processes equals training in one: gradients, logs, resuming, failures."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.boxes import box_store
from safetensors.torch import load_file
from torch import nn

from viewnet.config import RunConfig
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.recipes import make_config
from viewnet.runtime import distributed

HERE = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> ViewStore:
    return box_store(tmp_path_factory.mktemp("views") / "boxes", {"train": 8, "val": 3, "test": 2}, views=4)


def config(variant: str = "viewnet", **overrides) -> RunConfig:
    """Four steps an epoch."""
    return make_config(variant, profile="smoke", **{"batch_size": 8, "patience": 100, "amp": "off", **overrides})


def command(processes: int) -> list[str]:
    if processes == 1:
        return [sys.executable]
    return [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]


def environment(**more: str) -> dict[str, str]:
    paths = os.pathsep.join([str(HERE), str(HERE.parent), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": "", **more}


def write_training(store: ViewStore, folder: Path, config: RunConfig, **task) -> Path:
    """The file of a training for torchrun_training.py."""
    file = folder.with_suffix(".json")
    task |= {"config": config.to_dict(), "folder": str(folder), "views": str(store.folder)}
    file.write_text(json.dumps(task))
    return file


def start(processes: int, data: Path, *trainings: Path, code: int = 0) -> str:
    """Run torchrun_training.py; its stderr."""
    done = subprocess.run(
        [*command(processes), str(HERE / "helpers" / "torchrun_training.py"), *map(str, trainings)],
        env=environment(VIEWNET_DATA=str(data)),
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert (done.returncode == 0) == (code == 0), done.stderr
    return done.stderr


def train(processes: int, store: ViewStore, folder: Path, config: RunConfig, code: int = 0, **task) -> str:
    return start(processes, folder.parent / "data", write_training(store, folder, config, **task), code=code)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_file(folder / "checkpoint.safetensors")


def log(folder: Path) -> list[dict[str, str]]:
    with (folder / "log.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


# A process alone


def test_a_process_alone_is_left_as_it_is(monkeypatch):
    monkeypatch.delenv("RANK", raising=False)
    distributed.start()
    assert (distributed.size(), distributed.rank()) == (1, 0)
    model = nn.Sequential(nn.Conv2d(3, 4, 1), nn.BatchNorm2d(4))
    distributed.together(model)
    assert type(model[1]) is nn.BatchNorm2d
    value = torch.rand(4)
    assert distributed.mean(value) is value
    assert distributed.share(value) is value
    with pytest.raises(ZeroDivisionError):
        distributed.first(lambda: 1 // 0)


@pytest.mark.parametrize("dims", [2, 3])
def test_normalisation_by_all_rows_is_torch_s_own(dims):
    layer = (nn.BatchNorm2d if dims == 2 else nn.BatchNorm3d)(5)
    nn.init.uniform_(layer.weight)
    nn.init.uniform_(layer.bias)
    other = distributed.BatchNorm.of(layer)
    x = 3 + 2 * torch.randn(6, 5, *[4] * dims)
    inputs = [x.clone().requires_grad_() for _ in range(2)]
    weight = torch.randn_like(x)
    for _ in range(2):
        for made, given in zip((layer, other), inputs, strict=True):
            (made(given) * weight).sum().backward()
    assert torch.allclose(layer(inputs[0]), other(inputs[1]), atol=1e-5)
    assert torch.allclose(inputs[0].grad, inputs[1].grad, atol=1e-4)
    for one, two in zip(layer.parameters(), other.parameters(), strict=True):
        assert torch.allclose(one.grad, two.grad, rtol=1e-4, atol=1e-4)
    for name, value in layer.state_dict().items():
        assert torch.allclose(value.float(), other.state_dict()[name].float(), atol=1e-6), name
    assert torch.allclose(layer.eval()(x), other.eval()(x), atol=1e-6)


# Two processes

STEPS: dict[str, tuple[str, dict[str, Any], float, float]] = {
    # variant, settings, share of training done, tolerance as a share of the largest gradient
    # search, cycle
    "search": ("viewnet_cycle", {"search": 0.5, "targets_per_object": 2, "augment": True}, 0.1, 1e-5),
    "after": ("viewnet_cycle", {}, 0.9, 1e-5),
    # batch normalisation in the generator, backgrounds, three views per target
    "photos": ("encoder_decoder", {"recipe": "photos", "backgrounds": "drawn", "views": 4}, 0.4, 1e-3),
}


@pytest.fixture(scope="module")
def steps(store, tmp_path_factory) -> Path:
    """One step of each of STEPS, in one process and in two."""
    folder = tmp_path_factory.mktemp("steps")
    for processes in (1, 2):
        trainings = []
        for name, (variant, overrides, progress, _) in STEPS.items():
            asked = config(variant, epochs=1, **{"batch_size": 24, **overrides})
            trainings.append(write_training(store, folder / f"{name}{processes}", asked, progress=progress))
        start(processes, folder / "data", *trainings)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", STEPS)
def test_gradients_are_those_of_one_process(steps, name):
    one, two = (torch.load(steps / f"{name}{processes}.gradients") for processes in (1, 2))
    assert one.keys() == two.keys()
    assert all(value.abs().max() > 0 for value in one.values())
    largest = max(value.abs().max() for value in one.values())
    worst = {key: ((one[key] - two[key]).abs().max() / largest).item() for key in one}
    assert max(worst.values()) < STEPS[name][3], worst
    alone, both = (weights(steps / f"{name}{processes}") for processes in (1, 2))
    for key in alone:  # running means and shares among them
        assert torch.allclose(alone[key], both[key], atol=1e-5), key


@pytest.mark.slow
def test_a_run_over_two_processes_ends_like_one_and_goes_on_after_a_death(store, tmp_path):
    asked = config(epochs=3)
    for processes in (1, 2):
        train(processes, store, tmp_path / str(processes), asked)
    one, two = (log(tmp_path / str(processes)) for processes in (1, 2))
    assert [list(row) for row in one] == [list(row) for row in two]
    for first, second in zip(one, two, strict=True):
        assert float(first["loss"]) == pytest.approx(float(second["loss"]), rel=0.05)
    alone, both = (weights(tmp_path / str(processes)) for processes in (1, 2))
    assert alone.keys() == both.keys()
    distance = sum((alone[n].double() - both[n].double()).square().sum() for n in alone).sqrt()
    assert distance < 0.1 * sum(value.double().square().sum() for value in alone.values()).sqrt()
    # Killed in the third epoch; the second process ends without a message.
    train(2, store, tmp_path / "killed", asked, code=1, die=9)
    assert log(tmp_path / "killed") == two[:2]
    assert not (tmp_path / "killed" / "checkpoint.safetensors").exists()
    train(2, store, tmp_path / "killed", asked)
    assert log(tmp_path / "killed") == two
    resumed = weights(tmp_path / "killed")
    assert all(torch.equal(resumed[name], both[name]) for name in both)


@pytest.mark.slow
def test_what_goes_wrong_in_one_process_is_said_once(store, tmp_path):
    said = train(2, store, tmp_path / "nan", config(), code=2, nan=2)
    assert said.count("the loss is not finite at step 2") == 1, said
    said = train(2, store, tmp_path / "odd", config(batch_size=6, targets_per_object=2), code=2)
    assert said.count("is 3 objects a step, which 2 processes cannot share") == 1, said
    assert not (tmp_path / "odd").exists()


def test_more_processes_than_gpus_are_refused(monkeypatch):
    for name, value in zip(distributed.ENVIRONMENT, ("1", "2", "1", "localhost", "1"), strict=True):
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(ViewnetError, match="process 1 of this machine has no GPU"):
        distributed.start()
