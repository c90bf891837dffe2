"""The methods by their variants' names, and a trained one from its file."""

from pathlib import Path

import torch
from torch import Tensor

from viewnet.config import ModelConfig, RunConfig, known
from viewnet.errors import ViewnetError
from viewnet.model import checkpoint
from viewnet.model.viewnet import ViewNet
from viewnet.peers.box_corners import BoxCorners, BoxCornersImageNet
from viewnet.peers.mvc import MVC
from viewnet.peers.peer import Peer
from viewnet.peers.pointcloud import Pointcloud
from viewnet.peers.relative_pose import RelativePose
from viewnet.peers.spherical_regression import (
    SphericalRegression,
    SphericalRegressionFrozen,
    SphericalRegressionImageNet,
)
from viewnet.peers.ssv import SSV

METHODS: dict[str, type[Peer]] = {
    "mvc": MVC,
    "pointcloud": Pointcloud,
    "spherical_regression": SphericalRegression,
    "spherical_regression_imagenet": SphericalRegressionImageNet,
    "spherical_regression_frozen": SphericalRegressionFrozen,
    "spherical_regression_larger": SphericalRegression,
    "box_corners": BoxCorners,
    "box_corners_imagenet": BoxCornersImageNet,
    "relative_pose": RelativePose,
    "ssv": SSV,
}
"""Variant (viewnet.recipes.PEERS) -> its network."""


def make(variant: str, config: ModelConfig) -> Peer:
    """An untrained network. ViewnetError for a variant that is no peer."""
    return METHODS[known(variant, METHODS, "peer")](config)


def code_of(variant: str) -> tuple[str, ...]:
    """The modules of the package, as files, that a method's network and loss are written in."""
    modules = dict.fromkeys(
        kind.__module__ for kind in METHODS[variant].__mro__ if kind.__module__.startswith("viewnet")
    )
    return tuple(f"{name.partition('.')[2].replace('.', '/')}.py" for name in modules)


def load(folder: Path, name: str = checkpoint.CHECKPOINT) -> tuple[ViewNet | Peer, RunConfig]:
    """`viewnet.model.checkpoint.load_model` for a run of ViewNet or of a peer.

    Raises ViewnetError as that does, and for weights that are not those of the configuration's network.
    """
    path = folder / name
    if not path.is_file():
        return checkpoint.load_model(folder, name)  # raises
    config = checkpoint.config_of(path)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return build(config, checkpoint.read(path)[0], path).to(device).eval(), config


def build(config: RunConfig, weights: dict[str, Tensor], path: Path) -> ViewNet | Peer:
    """`viewnet.model.checkpoint.build` for the network of ViewNet or of a peer.

    Raises ViewnetError as that does, and for weights that are not finite, of which every prediction would be NaN.
    """
    for weight_name, weight in weights.items():
        if not weight.isfinite().all():
            raise ViewnetError(f"{path}: {weight_name} holds values that are not finite: train or save the model again")
    if config.variant not in METHODS:
        return checkpoint.build(config.model, weights, path)
    network = make(config.variant, config.model)
    try:
        network.load_state_dict(weights)  # half precision is widened
    except RuntimeError as error:
        problem = checkpoint.first_line(error)
        raise ViewnetError(f"{path}: weights and configuration are not of one network ({problem})") from error
    return network
