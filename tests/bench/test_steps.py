"""`viewnet bench --steps`: every moment of a step belongs to one part, and the work is that of training."""

from __future__ import annotations

import csv
import json
from types import SimpleNamespace

import pytest
import torch
from torch.autograd import DeviceType
from torch.profiler import ProfilerActivity, profile

from viewnet import cli
from viewnet.bench import measure, steps
from viewnet.recipes import make_config
from viewnet.training import matting


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VIEWNET_DATA", str(tmp_path_factory.mktemp("data")))
        yield patch


@pytest.fixture
def step(data, one_thread):
    return steps.Step(steps.configuration("smoke", None, "viewnet_cycle", 8), torch.device("cpu"))


@pytest.mark.slow
def test_parts_add_up(data, tmp_path, capsys):
    options = ["--threads", "1", "--repeat", "1", "--batch", "8", "--quick", "-o", str(tmp_path)]
    assert cli.main(["bench", "--steps", "smoke", *options]) == 0
    assert "normalisation, ReLU" in capsys.readouterr().out
    result = json.loads((tmp_path / "steps.json").read_text())
    assert {"hardware", "versions", "git", "rates", "settings", "started"} <= result.keys()
    with (tmp_path / "steps.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == len(result["rows"])
    assert {row["phase"] for row in result["rows"]} == set(steps.PHASES)
    for phase in steps.PHASES:
        rows = {row["part"]: row for row in result["rows"] if row["phase"] == phase}
        parts = [part for part in steps.PARTS if part != steps.PERCEPTUAL]  # the recipe has none
        assert list(rows) == [steps.WHOLE, *parts, steps.BETWEEN, steps.PROFILED]
        assert all(tuple(row) == steps.COLUMNS and row["ms"] > 0 for row in rows.values())
        ends = rows[steps.WHOLE], rows[steps.PROFILED]
        inner = [row for row in rows.values() if row not in ends]
        assert sum(row["ms"] for row in inner) == pytest.approx(ends[1]["ms"])
        assert sum(row["floor_ms"] or 0 for row in inner) == pytest.approx(ends[0]["floor_ms"])
        assert rows[steps.BACKWARD]["calls"] == rows[steps.FORWARD]["calls"] == 1  # what has no gradient is apart
        assert rows[steps.SQUASH]["calls"] == 2  # forward and backward


def test_time_goes_to_the_first_part_that_a_path_names():
    def event(name, spent, parent=None):
        kind = DeviceType.CPU
        return SimpleNamespace(name=name, self_cpu_time_total=spent, cpu_parent=parent, device_type=kind)

    choice = event(steps.CHOICE, 1e6)
    compare = event("compare", 2e6, choice)
    optimiser = event("Optimizer.step#Muon.step", 4e6)
    backward = event("autograd::engine::evaluate_function: _RenderBackward", 8e6)
    events = [choice, compare, optimiser, backward]
    events += [event("aten::mul", 16e6, compare), event("aten::mm", 32e6, optimiser), event("aten::mm", 64e6)]
    events += [event("_RenderBackward", 128e6, backward), event("_Render", 256e6), event("_Render", 512e6, choice)]
    spent, calls = steps.attribute(events)
    assert {part: seconds for part, seconds in spent.items() if seconds} == {
        "the rest of the choice": 1,
        steps.COMPARING: 2 + 16 + 512,
        steps.OPTIMISERS: 4 + 32,
        steps.BACKWARD: 8 + 128,
        steps.FORWARD: 256,
        steps.LAYERS: 64,
    }
    assert calls[steps.COMPARING] == 2 and calls[steps.BACKWARD] == 1


def random_weights(folder):
    """A file of random weights for the perceptual term, in SqueezeNet's shapes."""
    from torchvision import models

    torch.manual_seed(0)
    torch.save(models.squeezenet1_1(weights=None).state_dict(), folder / "squeezenet.pth")
    return str(folder / "squeezenet.pth")


def test_the_perceptual_term_is_a_part_with_its_backward_pass(data, tmp_path, monkeypatch, one_thread):
    monkeypatch.setenv("VIEWNET_SQUEEZENET_WEIGHTS", random_weights(tmp_path))
    config = make_config(profile="smoke", recipe="paper", models=8, batch_size=4, perceptual="squeezenet")
    step = steps.Step(config, torch.device("cpu"))
    assert step.told == "squeezenet"
    with steps.named_choice(), steps.named_perceptual(), profile(activities=[ProfilerActivity.CPU]) as profiler:
        step(0.5)
    spent, calls = steps.attribute(profiler.events())
    assert spent[steps.PERCEPTUAL] > 0
    events = [event for event in profiler.events() if "evaluate_function" in event.name]
    begin, end = (
        next(event.time_range.start for event in profiler.events() if event.name == name)
        for name in (steps.BEGINS, steps.ENDS)
    )
    within = [event.name for event in events if begin <= event.time_range.start < end]
    assert sum("MaxPool" in name for name in within) == sum("MaxPool" in event.name for event in events) == 2
    assert calls[steps.BACKWARD] == 1 and not any("_Render" in name for name in within)
    assert calls[steps.PERCEPTUAL] >= 1 + len(within)  # once forward
    need = steps.needs(step, 0.5)[steps.PERCEPTUAL]
    assert need.products > 4 * 64 * 27 * 7 * 7 and need.layer_values > 0  # more than its first layer's


def test_without_weights_pixels_take_the_perceptual_term_s_place(data, tmp_path, monkeypatch):
    monkeypatch.delenv("VIEWNET_SQUEEZENET_WEIGHTS", raising=False)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    config = make_config(profile="smoke", recipe="paper", models=8, batch_size=4, perceptual="squeezenet")
    step = steps.Step(config, torch.device("cpu"))
    assert step.perceptual is None and step.config.train.pixel_weight == 1
    assert "squeezenet" in step.told and "pixels" in step.told
    assert steps.PERCEPTUAL not in steps.needs(step, 0.5)


@pytest.mark.parametrize("profile", ["smoke", "tiny"])  # at 16 pixels nothing is halved
@pytest.mark.parametrize("progress", [0.1, 0.9])
@pytest.mark.parametrize("variant", ["viewnet", "single_head"])
def test_as_many_viewpoints_are_compared_as_are_counted(profile, progress, variant, data, monkeypatch):
    config = steps.configuration(profile, "matting", variant, 4)
    count = {True: 0, False: 0}
    compare = matting.compare

    def counted(model, objects, candidates, ups, target, settings):
        count[target.shape[-1] == config.model.render_size] += candidates.shape[1] * candidates.shape[2]
        return compare(model, objects, candidates, ups, target, settings)

    monkeypatch.setattr(matting, "compare", counted)
    steps.Step(config, torch.device("cpu"))(progress)
    assert (count[True], count[False]) == steps.compared(config, progress)


def test_volumes_are_as_full_as_a_trained_car_s_and_stay_so(step):
    images = step.views.images(torch.arange(4), 32, step.device)
    before = step.model.encode(images)[1][:, 3]
    assert 0.03 < (before > 0).float().mean() < 0.15
    step(0.9)
    assert torch.equal(step.model.encode(images)[1][:, 3], before)


def test_a_search_needs_more(step):
    early, late = (steps.needs(step, progress) for progress in (0.1, 0.9))
    assert late[steps.LAYERS].products == early[steps.LAYERS].products
    assert late[steps.COMPARING].samples < early[steps.COMPARING].samples  # the search is over


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--steps", "huge"], "unknown profile 'huge': choose one of smoke, tiny, pocket, small, paper"),
        (["--steps", "smoke", "--batch", "0"], "batch 0: expected 2 to 4096"),
        (["--steps", "smoke", "--sizes", "8"], "--steps goes with neither --sizes nor --accuracy: run it twice"),
        (["--recipe", "paper"], "--recipe and --variant are of --steps: name its profiles, such as --steps tiny"),
    ],
)
def test_options_that_make_no_sense_are_refused(arguments, message, capsys, monkeypatch):
    monkeypatch.setattr(measure, "measure", None)
    assert cli.main(["bench", *arguments]) == 2
    assert capsys.readouterr().err == f"viewnet: {message}\n"
