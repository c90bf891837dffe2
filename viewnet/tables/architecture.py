"""The supplement's architecture tables, read off the live networks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from torch import nn

from viewnet.config import ModelConfig
from viewnet.model.networks import AdaIN, Stage, parameters
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.files import write_text
from viewnet.tables import reported
from viewnet.tables.latex import escape, line, tabular

COLUMNS = ("layer", "channels", "kernel", "stride")
_NAMES = {
    nn.Conv2d: "Conv2D",
    nn.ConvTranspose2d: "ConvTranspose2D",
    nn.ConvTranspose3d: "ConvTranspose3D",
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
    learned: int  # numbers that are trained

    def comparison(self) -> pd.DataFrame:
        """Reported and present layers side by side, lined up from the top; `same` says where they agree."""
        paper, ours = reported.architecture(self.part).add_suffix(" (print)"), self.layers.add_suffix(" (ours)")
        both = paper.join(ours, how="outer").fillna("")
        same = pd.Series(True, index=both.index)
        for column in COLUMNS:
            # "variable" stands for the sizes of both encoders.
            agree = both[f"{column} (print)"] == both[f"{column} (ours)"]
            same &= agree | (both[f"{column} (print)"] == "variable")
        return both.assign(same=same)

    def latex(self) -> str:
        """A booktabs tabular to \\input, ruled between convolutions as in the paper."""
        body = [line(["Layer", "\\# channels", "Kernel", "Stride"])]
        for layer in self.layers.itertuples(index=False):
            body.append(("\\midrule\n" if "Conv" in layer.layer else "") + line(map(escape, layer)))
        return tabular("lccc", body)

    def write(self, folder: Path) -> list[Path]:
        """`architecture_<part>.tex` and `.csv`."""
        files = [folder / f"architecture_{self.part}{suffix}" for suffix in (".tex", ".csv")]
        write_text(files[0], self.latex())
        write_text(files[1], self.layers.to_csv(index=False, lineterminator="\n"))
        return files


def architectures(config: ModelConfig) -> list[Architecture]:
    """Encoder (f^v and f^a, which differ in the last layer only) and generator (f^d) of a configuration."""
    model = ViewNet(config)
    viewpoint, appearance = layers(model.viewpoint.encoder), layers(model.appearance)
    encoder = viewpoint.copy()
    for column in COLUMNS:
        differs = viewpoint[column] != appearance[column]
        encoder.loc[differs, column] = viewpoint.loc[differs, column] + " or " + appearance.loc[differs, column]
    return [
        Architecture("encoder", encoder, parameters(model.viewpoint) + parameters(model.appearance)),
        Architecture("generator", layers(model.decoder), parameters(model.decoder)),
    ]


def layers(network: nn.Module) -> pd.DataFrame:
    """Convolutions, normalisations and activations in the order they are applied."""
    rows: list[tuple[str, str, str, str]] = []
    _walk(network, rows)
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _walk(module: nn.Module, rows: list[tuple[str, str, str, str]]) -> None:
    kind = next((name for cls, name in _NAMES.items() if isinstance(module, cls)), None)
    if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d, nn.ConvTranspose3d)):
        kernel = "x".join(map(str, module.kernel_size[:2]))  # as in the paper: one face of a cube
        rows.append((str(kind), str(module.out_channels), kernel, str(module.stride[0])))
    elif kind is not None:
        rows.append((kind, "", "", ""))
    else:
        for child in module.children():
            _walk(child, rows)
        if isinstance(module, Stage):  # its ReLU is a function and no module
            rows.append(("ReLU", "", "", ""))
