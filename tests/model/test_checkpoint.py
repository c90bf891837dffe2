"""Training from another run's weights: the first step uses them, and they are part of the run's key."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
from helpers.boxes import box_store
from safetensors.torch import load_file, save_file

from viewnet.config import RunConfig
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.model import checkpoint
from viewnet.recipes import make_config
from viewnet.runs import run_store
from viewnet.training import train as training
from viewnet.training.train import train

pytestmark = pytest.mark.usefixtures("one_thread")


def config(**overrides) -> RunConfig:
    """Two steps an epoch."""
    settings = {"epochs": 2, "batch_size": 8, "patience": 100, "amp": "off", "neighbours": 0.0}
    return make_config(profile="smoke", **{**settings, "search": 0.0, **overrides})


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> ViewStore:
    return box_store(tmp_path_factory.mktemp("views") / "boxes", {"train": 4, "val": 2}, views=4)


@pytest.fixture(scope="module")
def first(store, tmp_path_factory) -> Path:
    """The folder of a run."""
    folder = tmp_path_factory.mktemp("runs") / "viewnet" / "0123456789ab"
    train(config(epochs=1), store, folder, threads=1, progress=False)
    return folder


@pytest.fixture
def seen(monkeypatch) -> list[dict[str, torch.Tensor]]:
    """The weights at every step of trainings; the training ends where the list is full."""
    states: list[dict[str, torch.Tensor]] = []
    step_loss = training.step_loss

    def watched(model, *arguments):
        states.append({name: value.clone() for name, value in model.state_dict().items()})
        if len(states) in (1, 4, 5):
            raise ViewnetError("far enough")
        return step_loss(model, *arguments)

    monkeypatch.setattr(training, "step_loss", watched)
    return states


def same(one: dict[str, torch.Tensor], two: dict[str, torch.Tensor]) -> bool:
    return one.keys() == two.keys() and all(torch.equal(one[name], two[name]) for name in one)


def test_the_first_step_has_the_weights_of_the_start_and_a_resumed_one_its_own(store, first, seen, tmp_path):
    theirs = load_file(first / "checkpoint.safetensors")
    asked = config(seed=1, start=str(first))
    for steps in (1, 3, 1):  # before anything; in the second epoch; going on where the first one ended
        before = len(seen)
        with pytest.raises(ViewnetError, match="far enough"):
            train(asked, store, tmp_path / "run", threads=1, progress=False)
        assert len(seen) == before + steps
    assert same(seen[0], theirs) and same(seen[1], theirs)
    assert not same(seen[2], theirs)
    assert same(seen[4], seen[3]) and not same(seen[4], theirs)


def test_another_network_is_no_start(store, first, tmp_path):
    with pytest.raises(ViewnetError, match="its network has heads 3, the one to train 2: start from one like it"):
        train(config(start=str(first), heads=2), store, tmp_path, threads=1, progress=False)
    assert not (tmp_path / "checkpoint.safetensors").exists()


def test_a_start_is_named_by_key_folder_or_file(first, tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(first.parent.parent))
    file = first / "checkpoint.safetensors"
    for name in (first.name, first.name[:6], str(first), str(file)):
        assert checkpoint.locate(name) == file
    for name in ("0123456789ac", str(tmp_path), "*", "shapenet"):
        with pytest.raises(ViewnetError, match="no finished run of that key or folder"):
            checkpoint.locate(name)
    twin = file.parents[1] / f"{first.name[:6]}{'0' * 6}" / file.name
    twin.parent.mkdir()
    twin.write_bytes(file.read_bytes())
    with pytest.raises(ViewnetError, match="no finished run of that key or folder"):
        checkpoint.locate(first.name[:6])
    (tmp_path / "checkpoint.safetensors").write_bytes(b"?")
    with pytest.raises(ViewnetError, match="not a whole file of weights"):
        checkpoint.identity(str(tmp_path))
    with pytest.raises(ViewnetError, match="not a whole checkpoint"):
        checkpoint.starting_weights(str(tmp_path), config().model)


def test_a_run_is_known_by_the_weights_it_starts_from_wherever_they_lie(first, tmp_path):
    shutil.copytree(first, tmp_path / "copy")
    weights = load_file(first / "checkpoint.safetensors")
    save_file(weights, tmp_path / "copy/checkpoint.safetensors", metadata={"config": "{}"})
    (tmp_path / "changed").mkdir()
    changed = {name: value + 1 if name.endswith("focal") else value for name, value in weights.items()}
    save_file(changed, tmp_path / "changed/checkpoint.safetensors")
    here, copy, other = (
        run_store.locate(config(start=str(folder)), "views")
        for folder in (first, tmp_path / "copy", tmp_path / "changed")
    )
    assert here == copy != other
    assert run_store.locate(config(epochs=9), "views") not in (here, other)
