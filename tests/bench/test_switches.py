"""benchmarks/switches.py: each switch changes one thing only; the summary of the curves."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pandas as pd
import pytest
import torch

from viewnet.model import volume
from viewnet.model.kernels import norm_relu_cpu, volume_cpu
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.training import step

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "switches.py"
spec = importlib.util.spec_from_file_location("switches", SCRIPT)
switches = importlib.util.module_from_spec(spec)
spec.loader.exec_module(switches)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VIEWNET_DATA", str(tmp_path_factory.mktemp("data")))
        yield patch


@pytest.mark.parametrize("switch", list(switches.SWITCHES))
def test_every_switch_trains(switch, data, one_thread):
    log = switches.curve(switch, "car", "smoke", 1, 0)
    assert log["switch"].tolist() == [switch] and log["epoch"].tolist() == [1]
    assert log["val_reconstruction"].between(0, 1).all()


def what_happens(switch, monkeypatch):
    """Which ways of computing one step of the profile tiny takes, by name."""
    overrides, patch = switches.SWITCHES[switch]
    config = make_config("viewnet", "car", "tiny", "matting", **overrides)
    torch.manual_seed(0)
    model = ViewNet(config.model)
    seen = set()

    def record(module, name, say):
        original = getattr(module, name)

        def wrapper(*arguments, **options):
            seen.update(say(*arguments, **options))
            return original(*arguments, **options)

        monkeypatch.setattr(module, name, wrapper)

    record(volume, "render", lambda *a, sparse, **o: {"sparse" if sparse else "dense", f"{a[3]} pixels"})
    record(volume_cpu, "compare", lambda *a: {f"{a[3].shape[-1]} pixels"})
    record(volume, "render_reference", lambda *_, **__: {"PyTorch's renderer"})
    record(volume_cpu, "render", lambda *_, **__: {"fused renderer"})
    record(
        norm_relu_cpu,
        "norm_relu",
        lambda x, *_, **__: {"fused layers"} | ({"bfloat16"} if x.dtype == torch.bfloat16 else set()),
    )
    images = torch.rand(4, 4, 64, 64, generator=torch.Generator().manual_seed(0))
    with patch():
        terms = step.step_loss(model, (images[:2], images, images), config.train, None, 0.0, torch.Generator())
        early = frozenset(seen)
        sum(terms.values()).backward()
        seen.clear()
        step.step_loss(model, (images[:2], images, images), config.train, None, 0.9, torch.Generator())
    return early, frozenset(seen)


def test_what_a_switch_undoes(monkeypatch):
    half = {"bfloat16"} if torch.cpu._is_avx512_bf16_supported() else set()
    common = {"sparse", "fused renderer", "fused layers", "16 pixels", "32 pixels"} | half
    required = dict.fromkeys(switches.SWITCHES, common)
    for name, before, after in (
        ("renderer in PyTorch", "fused renderer", "PyTorch's renderer"),
        ("gradients of empty voxels", "sparse", "dense"),
    ):
        required[name] = common - {before} | {after}
    required["float32"] = common - half
    required["normalisation in PyTorch"] = common - {"fused layers"} - half
    required["compared at full resolution"] = common - {"16 pixels"}
    for name, expected in required.items():
        with monkeypatch.context() as patch:
            assert what_happens(name, patch) == (expected, expected), name


def test_summary_and_figure(tmp_path):
    rows = [
        {
            "switch": name,
            "seed": seed,
            "epoch": epoch,
            "val_accuracy": value,
            "val_reconstruction": 0.1,
            "seconds": took,
        }
        for name, seed, value, took in (
            (switches.USUAL, 0, 80.0, 10.0),
            (switches.USUAL, 1, 84.0, 12.0),
            ("x", 0, 81.0, 33.0),
        )
        for epoch, value in ((1, 10.0), (2, value))
    ]
    curves = pd.DataFrame(rows)
    result = switches.summary(curves)
    assert result.loc[switches.USUAL, ["seeds", "accuracy", "accuracy_low", "accuracy_high"]].tolist() == [
        2,
        82,
        80,
        84,
    ]
    assert result.loc["x", "times_as_long"] == pytest.approx(3)
    left = switches.figure(curves).axes[0]
    assert [line.get_ydata().tolist() for line in left.lines] == [[10, 81]]
    assert {text.get_text() for text in left.get_legend().get_texts()} == {switches.USUAL, "x"}
