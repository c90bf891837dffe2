"""The viewpoint network as an ONNX file, for use without PyTorch."""

import logging
import warnings
from pathlib import Path

import torch
from torch import Tensor, nn

from viewnet.errors import ViewnetError
from viewnet.estimator.pretrained import Pretrained
from viewnet.model.viewnet import ViewpointNetwork
from viewnet.runtime.files import replacing

OUTPUTS = ("vectors", "logits", "ups")  # the last only of networks with in-plane rotation


class _TensorOutputs(nn.Module):
    """The viewpoint network with plain tensors as its output."""

    def __init__(self, network: ViewpointNetwork):
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        hypotheses = self.network(images)
        return tuple(each for each in (hypotheses.vectors, hypotheses.logits, hypotheses.ups) if each is not None)


def export(model: Pretrained, path: Path) -> Path:
    """Write the viewpoint network of a model as an .onnx file and return its path.

    Its input `images` (N, 3, S, S) are images in [0, 1], cut as viewnet.estimator.preprocess does. Its outputs are
    `vectors` (N, M, 3), unit view vectors in the network's own frame, `logits` (N, M), and `ups` (N, M, 3) of networks
    with in-plane rotation; N is free. The file's metadata has the `category` and, of an aligned model, the `rotation`
    to the annotated frame: nine numbers, row by row. ViewnetError for another suffix than .onnx, and without the
    packages of the extra onnx.
    """
    if path.suffix != ".onnx":
        raise ViewnetError(f"{path}: unknown kind of model file: name it .onnx")
    model.require_viewnet(f"{path}")
    try:
        import onnx
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise ViewnetError(f'{path}: {error.name} is not installed: pip install "viewnet[onnx]"') from None
    network, size = model.network, model.config.model.input_size
    # Two images: the size of a dimension of one would be taken for a constant.
    example = torch.rand(2, 3, size, size, generator=torch.Generator().manual_seed(0)).to(network.focal.device)
    logging.getLogger("onnxscript").setLevel(logging.WARNING)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # those that the exporter itself causes
        program = torch.onnx.export(
            _TensorOutputs(network.viewpoint).eval(),
            (example,),
            input_names=["images"],
            output_names=list(OUTPUTS if network.config.in_plane else OUTPUTS[:2]),
            dynamic_shapes={"images": {0: torch.export.Dim("batch")}},
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    properties = {"category": model.config.category}
    if model.annotated_from_model is not None:
        properties["rotation"] = " ".join(repr(float(value)) for value in model.annotated_from_model.ravel())
    proto = program.model_proto  # made anew at each access
    onnx.helper.set_model_props(proto, properties)
    with replacing(path) as temporary:
        onnx.save(proto, temporary)
    return path
