"""Numbers too small to matter are nothing in trainings, and what they were before and after."""

import contextlib

import pytest
import torch
from helpers.boxes import box_store

from viewnet.recipes import make_config
from viewnet.runs.make_run import train_any
from viewnet.training import train, train_peer

pytestmark = pytest.mark.usefixtures("one_thread")


def is_flushed() -> bool:
    return (torch.tensor(1e-30) * torch.tensor(1e-10)).item() == 0


@pytest.mark.parametrize("variant", ["viewnet", "pointcloud"])
@pytest.mark.parametrize("fails", [False, True])
def test_trainings_flush_denormals(variant, fails, tmp_path, monkeypatch):
    flushed = []

    def scores(*_):
        flushed.append(is_flushed())
        if fails:
            raise KeyError
        return dict.fromkeys(("reconstruction", "accuracy", "folded", "robust", "least_used", "focal"), 0.5)

    monkeypatch.setattr(train, "validate", scores)
    monkeypatch.setattr(train_peer.Source, "validate", scores)
    config = make_config(variant, profile="smoke", epochs=1, batch_size=8, targets_per_object=2)
    store = box_store(tmp_path / "boxes", {"train": 8, "val": 3, "test": 2}, views=4)
    with pytest.raises(KeyError) if fails else contextlib.nullcontext():
        train_any(config, store, tmp_path / "run", threads=1, progress=False)
    assert flushed == [True] and not is_flushed()
