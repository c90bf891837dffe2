"""The weights of a finished training, for another one to start from (TrainConfig.start)."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from pathlib import Path

from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor

from viewnet import paths
from viewnet.config import ModelConfig, RunConfig
from viewnet.errors import ViewnetError

CHECKPOINT = "checkpoint.safetensors"


def checkpoint(start: str) -> Path:
    """The full path of the checkpoint that a run's key, a run's folder or a file names. ViewnetError for none."""
    named = Path(start).expanduser()
    keyed = sorted(paths.runs().glob(f"*/{start}/{CHECKPOINT}")) if re.fullmatch("[0-9a-f]{12}", start) else []
    for place in (named, named / CHECKPOINT, *keyed):
        if place.is_file():
            return place.absolute()
    raise ViewnetError(f"start {start}: no finished run of that key or folder, and no {CHECKPOINT}: train it first")


def identity(start: str) -> str:
    """16 hex digits of the weights, wherever they lie."""
    digest = hashlib.sha256()
    for name, weight in sorted(_read(checkpoint(start)).items()):
        digest.update(f"{name} {weight.dtype} {list(weight.shape)}\n".encode())
        digest.update(weight.contiguous().numpy().tobytes())
    return digest.hexdigest()[:16]


def weights(start: str, model: ModelConfig) -> dict[str, Tensor]:
    """What a network of the settings `model` starts from: a state for `load_state_dict`.

    Raises ViewnetError naming the first setting in which the network that was trained differs.
    """
    path = checkpoint(start)
    try:
        with safe_open(path, framework="pt") as file:
            theirs = RunConfig.from_dict(json.loads((file.metadata() or {})["config"])).model
    except Exception as error:  # safetensors raises its own
        raise ViewnetError(f"{path}: no checkpoint of this version ({str(error).splitlines()[0]})") from error
    for field in dataclasses.fields(ModelConfig):
        there, here = getattr(theirs, field.name), getattr(model, field.name)
        if there != here:
            raise ViewnetError(
                f"{path}: its network has {field.name} {there!r}, the one to train {here!r}: start from one like it"
            )
    return _read(path)


def _read(path: Path) -> dict[str, Tensor]:
    try:
        return load_file(path)
    except Exception as error:  # safetensors raises its own
        raise ViewnetError(f"{path}: not a whole checkpoint ({str(error).splitlines()[0]})") from error
