"""The textbook version computes what the package computes; output of `viewnet bench`, and its errors."""

from __future__ import annotations

import csv
import dataclasses
import json

import pandas as pd
import pytest
import torch

from viewnet import cli
from viewnet.bench import contestants, measure, report, roofline, textbook
from viewnet.model import volume
from viewnet.model.losses import PerceptualLoss
from viewnet.model.viewnet import ViewNet
from viewnet.training.step import step_loss

NAMES = {"bench.json", "bench.csv", "bench.tex", "bench.png", "bench.pdf"}


# The same work


@pytest.mark.parametrize("occupancy", ["object", "dense"])
def test_the_textbook_renderer_is_the_definition(occupancy):
    shape = volume.squash(contestants.logits(occupancy, 11, 2), None, None)
    weights = torch.randn(6, 4, 9, 9, generator=torch.Generator().manual_seed(0))
    images, gradients = [], []
    for draw in (textbook.render, volume.render_reference):
        inputs = (shape, contestants.camera_frames(6), torch.tensor(0.3))
        leaves = [x.detach().double().requires_grad_() for x in inputs]
        images.append(draw(*leaves, 9, 13))
        gradients.append(torch.autograd.grad((images[-1] * weights).sum(), leaves))
    assert torch.allclose(*images, atol=1e-10)
    for found, wanted in zip(*gradients, strict=True):
        assert (found - wanted).abs().max() < 1e-4 * wanted.abs().max()


class Features(PerceptualLoss):
    """Two taps of random layers instead of ImageNet's."""

    def __init__(self):
        torch.nn.Module.__init__(self)
        torch.manual_seed(1)
        self.taps = ((0, 10.0), (2, 1.0))
        self.layers = torch.nn.Sequential(torch.nn.Conv2d(3, 4, 3), torch.nn.Tanh()).requires_grad_(False)
        self.mean, self.std = torch.full((1, 3, 1, 1), 0.5), torch.full((1, 3, 1, 1), 0.2)


def gradients(change, perceptual=None):
    """The loss of one step, and every weight's gradient, by the package and by the textbook version."""
    config = contestants.step_config("smoke")
    torch.manual_seed(0)
    net = ViewNet(config.model)
    with torch.no_grad():
        change(net)
    book = textbook.TextbookViewNet(config.model)
    book.load(net.state_dict())
    batch = contestants.images(6, 32)
    settings = dataclasses.replace(config.train, amp="off")
    ours = sum(step_loss(net, batch, settings, perceptual, 0.5, torch.Generator()).values())
    theirs = textbook.step_loss(book, batch, settings, perceptual)
    found = []
    for loss, module in ((ours, net), (theirs, book)):
        loss.backward()
        found.append((loss.item(), {name: weight.grad for name, weight in module.named_parameters()}))
    return found


def same(found, tolerance):
    (ours, mine), (theirs, its) = found
    assert ours == pytest.approx(theirs, rel=tolerance)
    assert mine.keys() == its.keys()
    for name, gradient in mine.items():
        assert gradient.norm() > 0, name
        assert (gradient - its[name]).norm() < tolerance * gradient.norm(), name


def filled(net):
    """No voxel is empty, so none is skipped."""
    net.decoder.last.bias[3] += 1.0


@pytest.mark.parametrize("perceptual", [None, Features()], ids=["pixels", "features"])
def test_the_textbook_step_has_the_package_s_loss_and_gradients(perceptual, monkeypatch):
    def plain(shape, frames, focal, size, steps=None, sparse=False):
        return volume.render_reference(shape, frames, focal, size, steps or size)

    monkeypatch.setattr(volume, "render", plain)
    same(gradients(lambda net: None, perceptual), 1e-4)


def test_the_compiled_step_is_the_textbook_s_where_nothing_is_empty():
    same(gradients(filled), 1e-3)


# The roofline


def test_layers_and_samples_are_counted():
    layer = torch.nn.Conv2d(3, 8, 3, padding=1, bias=False, device="meta")
    image = torch.zeros(2, 3, 16, 16, device="meta")
    need = roofline.network_need(layer, lambda: layer(image).sum(), 216, 5.0)
    products = 2 * 16 * 16 * 8 * 27
    assert need.products == 5 * 2 * products  # forward, and the weights' gradient; images need none
    assert need.layer_values == 5 * 3 * (image.numel() + 2 * 8 * 256)
    rates = roofline.Rates(float32=1.0, bfloat16=1e-9, copy=1e30)
    assert need.seconds(rates) == pytest.approx(need.products)
    rotated = torch.zeros(1, 4, 4, 1, 2)
    rotated[:, 3, 1:, 0, 0] = 1.0  # the first one is opaque
    rotated[:, 3, ::2, 0, 1] = 0.5
    assert roofline.lit_samples(rotated) == 3


def test_the_object_fills_a_quarter_and_the_dense_volume_all():
    filled = volume.squash(contestants.logits("object", 32, 1), None, None)[0, 3]
    assert 0.2 < (filled > 0).float().mean() < 0.3
    dense = volume.squash(contestants.logits("dense", 32, 1), None, None)[0, 3]
    assert (dense > 0).all()
    assert 0.15 < (1 - dense).prod(0).mean() < 0.3


# The command


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    assert cli.main(["bench", "--quick", "--threads", "1", "--repeat", "1", "-o", str(folder)]) == 0
    return folder


@pytest.mark.slow
def test_quick_writes_every_file(quick):
    assert {path.name for path in quick.iterdir()} == NAMES
    tex = (quick / "bench.tex").read_text()
    assert tex.count("\\begin{tabular}") == tex.count("\\bottomrule") == 1
    lines = [line for line in tex.splitlines() if line.endswith("\\\\") and "multicolumn" not in line and "&" in line]
    assert {line.count("&") for line in lines} == {13}


@pytest.mark.slow
def test_what_was_measured_is_told_as_json(quick, tmp_path, monkeypatch, capsys):
    before = json.loads((quick / "bench.json").read_text())
    monkeypatch.setattr(measure, "measure", lambda settings: before)
    assert cli.main(["bench", "--quick", "--json", "-o", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert sorted(told.pop("files")) == sorted(str(tmp_path / name) for name in NAMES)
    assert told == before


@pytest.mark.slow
def test_quick_measures_what_it_says_and_leaves_the_rest_empty(quick):
    found = json.loads((quick / "bench.json").read_text())
    assert found["schema"] == measure.SCHEMA
    assert found["settings"]["quick"] is True
    assert found["hardware"]["threads"] == 1
    assert {"hardware", "versions", "git", "rates", "settings", "started"} <= found.keys()
    rows = found["rows"]
    assert all(tuple(row) == measure.COLUMNS for row in rows)
    here = [row for row in rows if row["device"] == found["settings"]["device"] and row["size"]]
    assert {row["size"] for row in here} == {8, 16}
    for row in here:
        for name in ("textbook_s", "viewnet_s", "speedup", "floor_s", "viewnet_over_floor", "viewnet_images_per_s"):
            assert row[name] > 0, (row["work"], name)
        assert row["speedup_low"] <= row["speedup"] <= row["speedup_high"]
    assert [row["growth_expected"] for row in here if row["work"].startswith("renderer")] == [None, 8.0] * 5
    assert [row["memory_ratio"] is not None for row in here].count(True) <= 1
    missing = [row for row in rows if row["device"] == "cuda"] if not torch.cuda.is_available() else []
    missing += [row for row in rows if row["work"].startswith("time to")]
    for row in missing:
        assert not any(row[name] for name in measure.COLUMNS[4:])
    with (quick / "bench.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == len(rows)
    assert table[-1]["viewnet_s"] == table[-1]["speedup"] == ""
    text = report.as_text(found)
    assert text.count(report.NOT_MEASURED) == len(missing)


def test_the_seconds_a_training_took_to_an_accuracy():
    log = pd.DataFrame({"seconds": [1.5, 3.0, 4.5], "val_accuracy": [50.0, 85.0, 82.0]})
    assert measure.first_reached(log, 80) == 3.0
    assert measure.first_reached(log, 90) is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sizes", "4"], "size 4: expected 8 to 512"),
        (["--sizes", "16", "8"], "sizes 16 8: name each once, the smallest first"),
        (["--batch", "1"], "batch 1: expected 2 to 4096"),
        (["--repeat", "0"], "repeat 0: expected 1 to 1000"),
        (["--threads", "0"], "threads 0: expected 1 to 1024"),
    ],
)
def test_what_cannot_be_measured_is_said_in_a_line(arguments, message, capsys):
    assert cli.main(["bench", "--quick", *arguments]) == 2
    assert capsys.readouterr().err == f"viewnet: {message}\n"


def test_the_time_to_an_accuracy_is_the_seeds_median(monkeypatch):
    accuracy = {("car", 0): [85, 91], ("car", 1): [70, 85], ("car", 2): [81, 88], ("aeroplane", 0): [50, 60]}

    def trained(config, threads, progress):
        found = accuracy.get((config.category, config.seed), [0, 0])
        return pd.DataFrame({"seconds": [10.0, 20.0], "val_accuracy": found})

    monkeypatch.setattr(measure, "training_log", trained)
    settings = measure.Settings(accuracy=3, quick=True)
    rows = measure.time_to_accuracy(settings, torch.device("cpu"), False)
    times = [(row["viewnet_s"], row["viewnet_low"], row["viewnet_high"]) for row in rows]
    assert times == [(10.0, 10.0, 20.0), (None, None, None), (None, None, None)]  # one of three is not enough
