"""Checkpoints: a finished training's weights with its configuration, written once and read in this one place.

A checkpoint is a safetensors file; its metadata holds the run's configuration as JSON. Nothing is unpickled, and a
damaged or foreign file ends in one message that names it.
"""

import dataclasses
import hashlib
import json
import math
import re
from itertools import pairwise
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor

from viewnet import paths
from viewnet.config import ModelConfig, RunConfig
from viewnet.errors import ViewnetError
from viewnet.model.viewnet import ViewNet

CHECKPOINT = "checkpoint.safetensors"
ROBUST = "checkpoint_robust.safetensors"
"""Beside a checkpoint that was chosen by validation accuracy: that of the best accuracy by a robust alignment."""
LARGEST_VOLUME = 256
"""Voxels along a side. The shape prior is built from the configuration alone, so no file bounds its size."""


def locate(start: str) -> Path:
    """The full path of the checkpoint that a run's key or its beginning, a folder or a file names; or ViewnetError."""
    named = paths.named(start, "start")  # a file, or a run's folder
    keyed = sorted(paths.runs().glob(f"*/{start}*/{CHECKPOINT}")) if re.fullmatch("[0-9a-f]{6,12}", start) else []
    only = keyed if len(keyed) == 1 else ()  # the beginning of several keys is none
    for place in (named, named / CHECKPOINT, *only):  # a path that exists wins over a key spelt like it
        if place.is_file():
            return place.absolute()  # stays right when the working directory changes
    raise ViewnetError(f"start {start}: no finished run of that key or folder, and no {CHECKPOINT}: train it first")


def identity(start: str) -> str:
    """`fingerprint` of the weights of the checkpoint `locate` names, independent of where it lies."""
    return fingerprint(read(locate(start))[0])


def fingerprint(weights: dict[str, Tensor]) -> str:
    """16 hex digits of weights by name."""
    digest = hashlib.sha256()
    for name, weight in sorted(weights.items()):  # by name: the order in the file does not count
        digest.update(f"{name} {weight.dtype} {list(weight.shape)}\n".encode())  # or equal bytes of two shapes were one
        digest.update(weight.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:16]


def read(path: Path, remedy: str = "train the run again") -> tuple[dict[str, Tensor], dict[str, str]]:
    """Weights and metadata of a safetensors file. ViewnetError, which ends in `remedy`, for a damaged one."""
    try:
        with safe_open(path, framework="pt") as file:
            metadata = dict(file.metadata() or {})
        return load_file(path), metadata
    except Exception as error:  # safetensors raises its own, and what the operating system does
        raise ViewnetError(f"{path}: not a whole file of weights ({first_line(error)}): {remedy}") from error


def config_of(path: Path) -> RunConfig:
    """The configuration in a checkpoint's metadata. ViewnetError where there is none that this version reads."""
    try:
        with safe_open(path, framework="pt") as file:  # the header alone: no weights are read
            values = json.loads((file.metadata() or {})["config"])
    except Exception as error:
        raise ViewnetError(f"{path}: not a whole checkpoint ({first_line(error)}): train the run again") from error
    try:  # whole, but perhaps of another version, which deserves a message of its own
        return RunConfig.from_dict(values)
    except ViewnetError as error:
        raise ViewnetError(f"{path} is of another version of viewnet ({error}): train the run again") from error


def load_model(folder: Path, name: str = CHECKPOINT) -> tuple[ViewNet, RunConfig]:
    """The network of a finished run's folder, ready to predict, and its configuration; `name` is the checkpoint's.

    It is on the GPU where there is one. Raises ViewnetError where there is no checkpoint, or one that is not whole.

    >>> load_model(Path("nowhere"))
    Traceback (most recent call last):
    viewnet.errors.ViewnetError: no checkpoint at nowhere/checkpoint.safetensors: train the run first
    """
    path = folder / name
    if not path.is_file():
        raise ViewnetError(f"no checkpoint at {path}: train the run first")
    config = config_of(path)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return build(config.model, read(path)[0], path).to(device).eval(), config  # eval: running statistics


def build(config: ModelConfig, weights: dict[str, Tensor], path: Path) -> ViewNet:
    """A network of these settings with these weights, half precision widened; `path` names them in messages.

    Raises ViewnetError naming the first weight that is missing, has no place or is of another shape or type.
    """
    # Counted before room is made for it: a forged configuration must not allocate more than its file holds.
    if fewest_weights(config) > sum(map(Tensor.numel, weights.values())) or config.volume_size > LARGEST_VOLUME:
        raise ViewnetError(f"{path}: its configuration is of a larger network: weights and configuration do not match")
    network = ViewNet(config)
    expected = network.state_dict()
    for name in sorted(expected.keys() | weights.keys()):  # sorted, so that the fault named first is always the same
        if name not in weights or name not in expected:
            problem = "is missing" if name not in weights else "has no place"
            raise ViewnetError(f"{path}: {name} {problem}: weights and configuration are not of one network")
        weight, place = weights[name], expected[name]
        if weight.dtype == torch.float16 and place.dtype == torch.float32:
            weight = weight.float()  # half precision halves the file alone
        if (weight.shape, weight.dtype) != (place.shape, place.dtype):
            raise ViewnetError(
                f"{path}: {name} is {weight.dtype} {tuple(weight.shape)}, its configuration says {place.dtype} "
                f"{tuple(place.shape)}: weights and configuration are not of one network"
            )
        place.copy_(weight)  # the state dict shares the network's memory
    return network


def starting_weights(start: str, model: ModelConfig) -> dict[str, Tensor]:
    """Weights that a network of the settings `model` starts from, for `load_state_dict`.

    Raises ViewnetError naming the first setting in which the network that was trained differs.
    """
    path = locate(start)
    theirs = config_of(path).model
    for field in dataclasses.fields(ModelConfig):  # one by one, so that the message names the setting
        there, here = getattr(theirs, field.name), getattr(model, field.name)
        if there != here:
            raise ViewnetError(
                f"{path}: its network has {field.name} {there!r}, the one to train {here!r}: start from one like it"
            )
    return read(path)[0]


def fewest_weights(config: ModelConfig) -> int:
    """How many weights the largest layer of a network has at least."""
    encoder, generator = config.encoder_channels, config.generator_channels
    layers = [*pairwise(encoder), *pairwise(generator)]
    layers += [(min(encoder), outputs) for outputs in (config.heads, config.appearance_size)]
    if config.decoder == "adain":
        layers += [(64, generator[0]), (1, config.code_size)]
    return max(math.prod(sizes) for sizes in layers)  # a bound is enough: no network is built for it


def first_line(error: BaseException) -> str:
    """An error's message in one line of at most 200 characters; its type's name where it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
