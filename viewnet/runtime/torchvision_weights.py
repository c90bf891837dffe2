"""Convolutions of torchvision's ImageNet classifiers, never downloaded.

Weights are in the file that `VIEWNET_<NAME>_WEIGHTS` names or in torchvision's cache (`$TORCH_HOME/hub/checkpoints`).
"""

import os
from collections import OrderedDict
from pathlib import Path

import torch
from torch import nn

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
        return Path(named).expanduser()
    return Path(torch.hub.get_dir()) / "checkpoints" / _url(network).rsplit("/", 1)[1]


def available(network: str) -> bool:
    """Whether the weights are there. ViewnetError where a variable names a file that is missing."""
    path = weights_file(network)
    if not path.is_file() and os.environ.get(variable(network)):
        raise ViewnetError(f"{variable(network)}: no such file: {path}")
    return path.is_file()


def convolutions(network: str, weights: Path | None = None, otherwise: str = "choose another network") -> nn.Sequential:
    """The convolution layers of a torchvision classifier, without its pooling and classifier, in evaluation mode.

    `network` is a name of torchvision.models or of ALIASES; `weights` a file with torchvision's names, with or without
    the classifier's (default: `weights_file`). Raises ViewnetError for a network that is unknown or has no such layers,
    for a missing file (`otherwise`, an alternative for the user, ends the message) and for a file of something else.
    """
    url, path = _url(network), weights or weights_file(network)
    if not path.is_file():
        advice = f"download {url} to that place, name another file by {variable(network)}, or {otherwise}"
        raise ViewnetError(f"no {network} weights at {path}: {advice}")
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
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        state = {name.removeprefix("features."): value for name, value in state.items()}
        layers.load_state_dict({name: state[name] for name in layers.state_dict() if name in state}, assign=True)
    except Exception as error:
        problem = (str(error).splitlines() or [type(error).__name__])[0]
        raise ViewnetError(f"{path} does not hold {network} weights ({problem}): download {url} again") from error
    return layers.eval()


def _url(network: str) -> str:
    from torchvision import models

    try:
        weights = models.get_model_weights(ALIASES.get(network, network))
    except ValueError:
        names = ", ".join(models.list_models(module=models))
        raise ViewnetError(f"unknown network {network!r}: choose one of {names}") from None
    return str(next(iter(weights)).url)
