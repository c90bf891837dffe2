from __future__ import annotations

import pytest
import torch
from helpers.latex import assert_tabular
from torch import nn

from viewnet.config import ModelConfig
from viewnet.model.networks import Stage
from viewnet.recipes import make_config
from viewnet.tables.architecture import architectures, layers


@pytest.fixture(scope="module")
def paper():
    return architectures(make_config(profile="paper").model)


def test_the_paper_s_generator_is_the_printed_one_up_to_its_last_layer(paper):
    comparison = paper[1].comparison()
    convolutions = comparison[comparison["layer (print)"].str.contains("Conv")]
    assert len(convolutions) == 8
    assert convolutions["same"].all()
    different = comparison[~comparison["same"]]
    assert list(different["layer (print)"]) == ["AdaptiveIN", "ReLU"]  # after the last layer: occupancy needs a sign
    assert set(different["layer (ours)"]) == {""}


def test_the_paper_s_encoder_is_the_printed_one_up_to_its_last_layer(paper):
    comparison = paper[0].comparison()
    assert list(comparison.loc[~comparison["same"], "layer (print)"]) == ["BatchNorm", "ReLU"]
    last = paper[0].layers.iloc[-1]
    assert last["channels"] == "12 or 256"  # 4 x 3 heads, or the appearance
    assert last["kernel"] == "1x1"


def test_channels_and_strides_are_those_of_what_runs():
    config = ModelConfig(input_size=32, encoder_channels=(8, 16, 16, 32, 32), appearance_size=4, heads=2)
    encoder = architectures(ModelConfig(**{**config.__dict__, "volume_size": 16, "generator_channels": (8, 8)}))[0]
    convolutions = encoder.layers[encoder.layers["layer"] == "Conv2D"]
    assert list(convolutions["channels"]) == ["8", "16", "16", "32", "32", "8 or 4"]
    assert list(convolutions["stride"]) == ["2", "2", "2", "2", "1", "1"]


def test_a_stage_ends_with_the_relu_the_table_says():
    stage = Stage(nn.ConvTranspose3d(3, 5, 4, 2, 1), appearance=7)
    assert list(layers(stage)["layer"]) == ["ConvTranspose3D", "AdaptiveIN", "ReLU"]
    out = stage(torch.randn(2, 3, 4, 4, 4), torch.randn(2, 7))
    assert out.shape == (2, 5, 8, 8, 8)
    assert out.min() == 0
    assert list(layers(nn.Sequential(nn.Conv2d(3, 4, 3), nn.ReLU()))["kernel"]) == ["3x3", ""]


def test_files_hold_a_tabular_and_the_same_layers(paper, tmp_path):
    for part in paper:
        files = part.write(tmp_path)
        assert [f.name for f in files] == [f"architecture_{part.part}.tex", f"architecture_{part.part}.csv"]
        assert_tabular(files[0].read_text())
        assert files[0].read_text().count("Conv") == part.layers["layer"].str.contains("Conv").sum()
