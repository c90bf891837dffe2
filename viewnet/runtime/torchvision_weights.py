"""Weights of torchvision's networks, never downloaded, and the convolutions of its ImageNet classifiers.

Weights are in the file that `VIEWNET_<NAME>_WEIGHTS` names or in torchvision's cache (`$TORCH_HOME/hub/checkpoints`).
"""

import os
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import torch
from torch import nn

from viewnet import paths
from viewnet.errors import ViewnetError

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
ALIASES = {"squeezenet": "squeezenet1_1"}
"""Short name -> torchvision's name. The environment variable has the short name where there is one."""


def variable(network: str) -> str:
    """The name of the environment variable for the file of a network's weights."""
    short = {full: alias for alias, full in ALIASES.items()}.get(network, network)
    return f"VIEWNET_{short.upper()}_WEIGHTS"


def weights_file(network: str) -> Path:
    """Where a network's weights are expected, `~` expanded. ViewnetError for networks without ImageNet weights."""
    if named := os.environ.get(variable(network)):
        return paths.named(named, variable(network))
    return Path(torch.hub.get_dir()) / "checkpoints" / published(network).url.rsplit("/", 1)[1]


def available(network: str) -> bool:
    """Whether the weights are there. ViewnetError where a variable names a file that is missing."""
    path = weights_file(network)
    if not path.is_file() and os.environ.get(variable(network)):
        raise ViewnetError(f"{variable(network)}: no such file: {path}")
    return path.is_file()


def convolutions(network: str, weights: Path | None = None, otherwise: str = "choose another network") -> nn.Sequential:
    """The convolution layers of a torchvision classifier, without its pooling and classifier, in evaluation mode.

    `network` is a name of torchvision.models or of ALIASES. Raises ViewnetError for a network that is unknown or has no
    such layers, and as `load` does.
    """
    published(network)  # refuses unknown networks
    from torchvision import models

    with torch.device("meta"):  # initialising VGG16 at random would take a while
        model = models.get_model(ALIASES.get(network, network), weights=None)
    children, layers = dict(model.named_children()), getattr(model, "features", None)  # VGG, SqueezeNet, AlexNet ...
    if {"layer4", "avgpool", "fc"} <= children.keys():  # ResNet and its kin
        children = {name: layer for name, layer in children.items() if name not in ("avgpool", "fc")}
        layers = nn.Sequential(OrderedDict(children))
    if not isinstance(layers, nn.Sequential):
        advice = "choose vgg16, squeezenet1_1 or resnet18"
        raise ViewnetError(f"network {network!r} has no plain convolution layers: {advice}")
    load(layers, network, weights, otherwise)
    return layers.eval()


def load(module: nn.Module, network: str, weights: Path | None, otherwise: str) -> None:
    """Give a network, or its features, the weights of a file with torchvision's names (default: `weights_file`).

    The file may hold others too. ViewnetError, which ends in `otherwise`, an alternative for the user, for a missing
    file, and for a file of something else.
    """
    url, path = published(network).url, weights or weights_file(network)
    if not path.is_file():
        advice = f"download {url} to that place, name another file by {variable(network)}, or {otherwise}"
        raise ViewnetError(f"no {network} weights at {path}: {advice}")
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                if any(part.compress_type != zipfile.ZIP_STORED for part in archive.infolist()):
                    raise ValueError("it is compressed, and so may claim any size")
        state = torch.load(path, map_location="cpu", weights_only=True)
        # As plain values, without the file's versions, names of all versions are taken.
        state = {name.removeprefix("features."): value for name, value in state.items()}
        if missing := module.load_state_dict(state, strict=False, assign=True).missing_keys:
            raise ValueError(f"{missing[0]} is missing")
        for name, weight in module.state_dict().items():
            kind = torch.int64 if name.endswith("num_batches_tracked") else torch.float32
            if (weight.dtype, weight.layout, weight.device.type) != (kind, torch.strided, "cpu"):
                raise ValueError(f"{name} is {weight.dtype} and not plain {kind}")
    except Exception as error:  # torch raises whatever a damaged file makes it stumble over
        problem = (str(error).splitlines() or [type(error).__name__])[0]
        raise ViewnetError(f"{path} does not hold {network} weights ({problem}): download {url} again") from error


def published(network: str) -> Any:
    """torchvision's weights of a network: their `url`, and in `meta` its classes. ViewnetError for unknown networks."""
    from torchvision import models

    try:
        return next(iter(models.get_model_weights(ALIASES.get(network, network))))
    except ValueError:
        names = ", ".join(models.list_models(module=models))
        raise ViewnetError(f"unknown network {network!r}: choose one of {names}") from None
