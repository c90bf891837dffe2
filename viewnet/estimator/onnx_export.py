"""The viewpoint network as an ONNX file, for where there is no PyTorch."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from viewnet.errors import ViewnetError
from viewnet.model.viewnet import ViewpointNetwork
from viewnet.runtime.files import replacing

if TYPE_CHECKING:
    from viewnet.estimator.viewpoint_estimator import ViewpointEstimator

INPUT = "pictures"
OUTPUTS = ("vectors", "logits", "ups")
"""The last only of networks of in-plane rotation."""


class _Plain(nn.Module):
    """The network with tensors for its answer."""

    def __init__(self, network: ViewpointNetwork):
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        found = self.network(images)
        return (found.vectors, found.logits, *(() if found.ups is None else (found.ups,)))


def export(estimator: ViewpointEstimator, path: Path) -> Path:
    """Write what takes `images` (N, 3, S, S) in [0, 1], cut, to `vectors` (N, M, 3) and `logits` (N, M); any N.

    Vectors are unit view vectors in the network's own frame; the file's metadata has the `rotation` (nine numbers, row
    by row) to the annotated one, where there is one, and the `category`. `ups` (N, M, 3) follow where in-plane rotation
    was learned. What an image is cut to is said in viewnet.estimator.preprocess. Returns `path`. ViewnetError for another suffix
    than .onnx, and without the packages of the extra onnx.
    """
    if path.suffix != ".onnx":
        raise ViewnetError(f"{path}: unknown kind of model file: name it .onnx")
    try:
        import onnx
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise ViewnetError(f'{path}: {error.name} is not installed: pip install "viewnet[onnx]"') from None
    size, device = estimator.framing.size, estimator.device
    plain = _Plain(estimator.network.viewpoint).eval()
    names = OUTPUTS if estimator.network.config.in_plane else OUTPUTS[:2]
    # Two images: the size of a dimension of one would be taken for a constant.
    example = torch.rand(2, 3, size, size, generator=torch.Generator().manual_seed(0)).to(device)
    logging.getLogger("onnxscript").setLevel(logging.WARNING)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # of what the exporter itself is made of
        program = torch.onnx.export(
            plain,
            (example,),
            input_names=[INPUT],
            output_names=list(names),
            dynamic_shapes={INPUT: {0: torch.export.Dim("batch")}},
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    known = {"category": estimator.config.category}
    if estimator.turned is not None:
        known["rotation"] = " ".join(repr(float(value)) for value in estimator.turned.ravel())
    onnx.helper.set_model_props(model, known)
    with replacing(path) as temporary:
        onnx.save(model, temporary)
    return path
