"""The supplement's architecture tables, read off the networks themselves."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from torch import nn

from viewnet.config import ModelConfig
from viewnet.model.fast_layers import FixedCodeDeconv
from viewnet.model.networks import AdaIN, Stage
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.files import write_csv, write_text
from viewnet.tables import reported
from viewnet.tables.latex import escape, line, tabular

COLUMNS = ("layer", "channels", "kernel", "stride")
NAMES = {
    nn.Conv2d: "Conv2D",
    nn.ConvTranspose2d: "ConvTranspose2D",
    nn.ConvTranspose3d: "ConvTranspose3D",
    FixedCodeDeconv: "ConvTranspose3D",  # the same for a single code
    nn.BatchNorm2d: "BatchNorm",
    nn.BatchNorm3d: "BatchNorm",
    nn.ReLU: "ReLU",
    AdaIN: "AdaptiveIN",
}


@dataclass(frozen=True)
class Architecture:
    """One network's layers from input to output; `layers` has the columns of `COLUMNS`, all text."""

    part: str  # "encoder" or "generator"
    layers: pd.DataFrame

    def comparison(self) -> pd.DataFrame:
        """Reported and present layers side by side, lined up from the top; `same` says where they agree."""
        paper, ours = (frame.fillna("") for frame in reported.architecture(self.part).align(self.layers, axis=0))
        same = (paper == ours) | (paper == "variable")  # the sizes of both encoders
        return paper.add_suffix(" (print)").join(ours.add_suffix(" (ours)")).assign(same=same.all(axis=1))

    def latex(self) -> str:
        """A booktabs tabular to \\input, ruled between convolutions as in the paper."""
        layers = self.layers.itertuples(index=False)
        rows = (("\\midrule\n" if "Conv" in layer.layer else "") + line(map(escape, layer)) for layer in layers)
        return tabular("lccc", [line(["Layer", "\\# channels", "Kernel", "Stride"]), *rows])

    def write(self, folder: Path) -> list[Path]:
        """`architecture_<part>.tex` and `.csv`."""
        tex = folder / f"architecture_{self.part}.tex"
        write_text(tex, self.latex())
        return [tex, write_csv(tex.with_suffix(".csv"), self.layers)]


def architectures(config: ModelConfig) -> list[Architecture]:
    """Encoder (f^v and f^a, which differ in the last layer only) and generator (f^d) of a configuration."""
    model = ViewNet(config)
    viewpoint, appearance = layers(model.viewpoint.encoder), layers(model.appearance)
    encoder = viewpoint.where(viewpoint == appearance, viewpoint + " or " + appearance)  # only the last layers differ
    return [Architecture("encoder", encoder), Architecture("generator", layers(model.decoder))]


def layers(network: nn.Module) -> pd.DataFrame:
    """Convolutions, normalisations and activations in the order they are applied."""
    return pd.DataFrame(list(_rows(network)), columns=list(COLUMNS))  # of what is not named in NAMES, the parts


def _rows(module: nn.Module) -> Iterator[tuple[str, str, str, str]]:
    name = next((name for kind, name in NAMES.items() if isinstance(module, kind)), None)
    if isinstance(module, nn.Conv2d | nn.ConvTranspose2d | nn.ConvTranspose3d | FixedCodeDeconv):
        kernel = "x".join(map(str, module.kernel_size[:2]))  # as in the paper: one face of a cube
        yield str(name), str(module.out_channels), kernel, str(module.stride[0])
    elif name is not None:
        yield name, "", "", ""
    else:
        for child in module.children():
            yield from _rows(child)
        if isinstance(module, Stage):  # its ReLU is a function and no module
            yield "ReLU", "", "", ""
