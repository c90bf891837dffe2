"""Training as a whole, on made-up boxes: the same bits every time, resumed or not, and the right weights kept."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import os
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.boxes import box_store
from helpers.simulated_faults import weights_spoilt_at
from PIL import Image
from safetensors import safe_open
from safetensors.torch import load_file

from viewnet.config import RunConfig
from viewnet.data.augment import crop_and_rotate
from viewnet.data.pairs import model_views
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.predict import predict
from viewnet.model.checkpoint import ROBUST, load_model
from viewnet.model.precision import autocast
from viewnet.recipes import make_config
from viewnet.training import train as training
from viewnet.training.train import train

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> ViewStore:
    return box_store(tmp_path_factory.mktemp("views") / "boxes", {"train": 6, "val": 3, "test": 2}, views=4)


def config(variant: str = "viewnet", **overrides) -> RunConfig:
    """Three steps an epoch."""
    settings = {"epochs": 2, "batch_size": 8, "targets_per_object": 1, "patience": 100, "amp": "off"}
    settings |= {"neighbours": 0.0, "search": 0.0, "learning_rate": 1e-3, "recipe": "matting"}
    return make_config(variant, profile="smoke", **{**settings, **overrides})


def trained(store: ViewStore, folder: Path, variant: str = "viewnet", **overrides) -> Path:
    train(config(variant, **overrides), store, folder, threads=1, progress=False)
    return folder


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_file(folder / "checkpoint.safetensors")


def same(one: dict[str, torch.Tensor], two: dict[str, torch.Tensor]) -> bool:
    return one.keys() == two.keys() and all(torch.equal(one[name], two[name]) for name in one)


def log(folder: Path) -> list[dict[str, str]]:
    """The rows of log.csv but for the time they took."""
    with (folder / "log.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


class Killed(Exception):
    pass


def killed_after(
    store: ViewStore, folder: Path, monkeypatch, steps: int, variant: str = "viewnet", **overrides
) -> None:
    """A training that dies after so many steps."""
    left = iter(range(steps))
    step_loss = training.step_loss

    def dying(*arguments):
        if next(left, None) is None:
            raise Killed
        return step_loss(*arguments)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(training, "step_loss", dying)
        trained(store, folder, variant, **overrides)


# The same bits


def test_training_twice_gives_the_same_bits(store, tmp_path):
    one, two = (trained(store, tmp_path / name) for name in ("one", "two"))
    assert same(weights(one), weights(two))
    assert log(one) == log(two)
    assert not same(weights(one), weights(trained(store, tmp_path / "other", learning_rate=2e-3)))


@pytest.mark.parametrize(
    ("variant", "overrides"),
    [
        ("viewnet_cycle", {"epochs": 3, "search": 0.5, "targets_per_object": 2}),
        pytest.param("single_head", {"epochs": 3, "augment": True}, marks=pytest.mark.slow),
        pytest.param("hologan_decoder", {"epochs": 3, "neighbours": 8.0}, marks=pytest.mark.slow),
        pytest.param(
            "encoder_decoder",
            {"epochs": 3, "recipe": "paper", "perceptual": "none", "pixel_weight": 1.0},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_killed_run_goes_on_as_if_nothing_had_been(store, tmp_path, monkeypatch, variant, overrides):
    whole = trained(store, tmp_path / "whole", variant, **overrides)
    killed_after(store, tmp_path / "killed", monkeypatch, 7, variant, **overrides)  # in the third epoch
    assert not (tmp_path / "killed" / "checkpoint.safetensors").exists()
    assert log(tmp_path / "killed") == log(whole)[:2]
    torch.manual_seed(12345)  # whatever else has been going on
    resumed = trained(store, tmp_path / "killed", variant, **overrides)
    assert same(weights(resumed), weights(whole))
    assert log(resumed) == log(whole)
    assert {path.name for path in resumed.iterdir()} == {path.name for path in whole.iterdir()}
    assert {path.name for path in whole.iterdir()} - {ROBUST} == {"checkpoint.safetensors", "log.csv"}


def test_a_finished_run_is_left_alone(store, tmp_path):
    folder = trained(store, tmp_path / "run", epochs=1)
    written = (folder / "checkpoint.safetensors").stat().st_mtime_ns
    trained(store, folder, epochs=1)
    assert (folder / "checkpoint.safetensors").stat().st_mtime_ns == written


# What is kept


def scored(monkeypatch, reconstruction: list[float], accuracy: list[float]) -> list[dict[str, torch.Tensor]]:
    """Validations give these numbers, one after another; the weights that each of them saw."""
    seen: list[dict[str, torch.Tensor]] = []

    def validate(model, *_):
        seen.append({name: value.detach().clone() for name, value in model.state_dict().items()})
        score = accuracy[len(seen) - 1]
        return {"reconstruction": reconstruction[len(seen) - 1], "accuracy": score, "robust": -score}

    monkeypatch.setattr(training, "validate", validate)
    return seen


@pytest.mark.parametrize(("criterion", "kept"), [("reconstruction", 1), ("accuracy", 2)])
def test_the_best_weights_by_the_criterion_are_kept(store, tmp_path, monkeypatch, criterion, kept):
    seen = scored(monkeypatch, [0.3, 0.1, 0.2, 0.1], [10.0, 20.0, 40.0, 40.0])
    folder = trained(store, tmp_path / "run", epochs=4, select_by=criterion)
    assert same(weights(folder), seen[kept])  # of equals the first
    with safe_open(folder / "checkpoint.safetensors", framework="pt") as file:
        metadata = file.metadata()
    assert metadata["epoch"] == str(kept + 1)
    assert RunConfig.from_dict(json.loads(metadata["config"])).train.select_by == criterion


def test_beside_the_best_weights_by_accuracy_the_best_by_a_robust_alignment_are_kept(store, tmp_path, monkeypatch):
    seen = scored(monkeypatch, [0.3, 0.1, 0.2, 0.2], [20.0, 10.0, 40.0, 10.0])
    folder = trained(store, tmp_path / "run", epochs=3, select_by="accuracy")
    robust, config = load_model(folder, ROBUST)
    assert same(robust.state_dict(), seen[1])
    assert same(weights(folder), seen[2])
    assert config.train.select_by == "accuracy"
    without_labels = trained(store, tmp_path / "other", epochs=1, select_by="reconstruction")
    assert not (without_labels / ROBUST).exists()


def test_training_stops_when_patience_is_at_its_end(store, tmp_path, monkeypatch):
    scored(monkeypatch, [0.5, 0.4] + [0.45] * 10, [0.0] * 12)
    folder = trained(store, tmp_path / "run", epochs=12, patience=3)
    assert [row["epoch"] for row in log(folder)] == ["1", "2", "3", "4", "5"]
    assert not (folder / "state.pt").exists()


def test_validations_may_be_rare_but_the_last_epoch_has_one(store, tmp_path):
    folder = trained(store, tmp_path / "run", epochs=3, validate_every=2)
    assert [row["epoch"] for row in log(folder)] == ["2", "3"]


def test_choosing_without_labels_reads_none(store, tmp_path, monkeypatch):
    honest = trained(store, tmp_path / "honest", select_by="reconstruction")

    def mislabelled(*arguments):
        views = model_views(*arguments)
        return dataclasses.replace(views, truth=0.05 * views.truth.flip(0))

    monkeypatch.setattr(training, "model_views", mislabelled)
    other = trained(store, tmp_path / "other", select_by="reconstruction")
    assert same(weights(honest), weights(other))
    labels = {"val_accuracy", "val_folded", "val_robust"}
    without = [{k: v for k, v in row.items() if k not in labels} for row in log(honest)]
    assert without == [{k: v for k, v in row.items() if k not in labels} for row in log(other)]
    assert log(honest) != log(other)  # accuracy is told, and does depend on labels


# The schedule


@pytest.mark.parametrize(
    ("schedule", "factors"),
    [
        ("constant", [1.0] * 6),
        ("cosine", [(1 + math.cos(math.pi * k / 6)) / 2 for k in range(6)]),
        ("hold", [1.0, 1.0, 1.0, 1.0, *[(1 + math.cos(math.pi * (k / 6 - 0.6) / 0.4)) / 2 for k in (4, 5)]]),
    ],
)
def test_learning_rates(store, tmp_path, monkeypatch, schedule, factors):
    rates: list[float] = []
    step = torch.optim.Adam.step

    def recording(self, *arguments):
        rates.append(self.param_groups[0]["lr"])
        return step(self, *arguments)

    monkeypatch.setattr(torch.optim.Adam, "step", recording)
    trained(store, tmp_path / "run", schedule=schedule, learning_rate=0.01)
    assert rates == pytest.approx([0.01 * factor for factor in factors])


# What goes wrong


def test_a_loss_that_is_not_finite_stops_and_keeps_the_last_good_state(store, tmp_path, monkeypatch):
    step_loss = training.step_loss
    calls = iter(range(100))

    def broken(*arguments):
        terms = step_loss(*arguments)
        return {name: value * math.nan for name, value in terms.items()} if next(calls) == 4 else terms

    folder = tmp_path / "run"
    message = r"the loss is not finite at step 4 \(selection nan, pixels nan, masks nan\)"
    with monkeypatch.context() as patch:
        patch.setattr(training, "step_loss", broken)
        with pytest.raises(ViewnetError, match=message):
            trained(store, folder)
    state = torch.load(folder / "state.pt", weights_only=True)
    assert state["epoch"] == 1
    assert all(value.isfinite().all() for value in state["model"].values())
    assert not (folder / "checkpoint.safetensors").exists()
    assert same(weights(trained(store, folder)), weights(trained(store, tmp_path / "whole")))


@pytest.mark.parametrize("spoilt", [4, 6])  # the second epoch's first step and its last, after which it is validated
def test_weights_that_are_not_finite_stop_and_keep_the_last_good_state(store, tmp_path, spoilt):
    folder = tmp_path / "run"
    with (
        weights_spoilt_at(spoilt),
        pytest.raises(
            ViewnetError,
            match=r"(weights are not finite after step 6|loss is not finite at step 4) .*: lower the learning",
        ),
    ):
        trained(store, folder)
    assert all(value.isfinite().all() for value in torch.load(folder / "state.pt", weights_only=True)["model"].values())
    assert same(weights(trained(store, folder)), weights(trained(store, tmp_path / "whole")))


def test_settings_that_do_not_go_together(store, tmp_path):
    with pytest.raises(ViewnetError, match="batch_size 8 with targets_per_object 3: expected a multiple"):
        trained(store, tmp_path / "run", targets_per_object=3)


def test_views_that_cannot_be_paired(tmp_path):
    store = box_store(tmp_path / "views", {"train": 4, "val": 2}, views=1)
    with pytest.raises(ViewnetError, match="two views or more of every object"):
        trained(store, tmp_path / "run")


# Parts of a step


def test_augmented_images_stay_close_to_the_originals():
    images = torch.zeros(64, 4, 32, 32)
    images[:, :, 8:24, 8:24] = 1
    changed = crop_and_rotate(images, torch.Generator().manual_seed(0))
    assert changed.shape == images.shape
    area = changed[:, 3].mean((1, 2)) / images[:, 3].mean((1, 2))
    assert area.min() > 0.95  # cut to 80 to 100 % of the area and enlarged: nothing shrinks
    assert area.max() < 1 / 0.8 + 0.05
    assert area.std() > 0.02
    assert torch.equal(changed, crop_and_rotate(images, torch.Generator().manual_seed(0)))


def test_low_precision_can_be_switched_off():
    device = torch.device("cpu")
    assert not autocast(device, config(amp="off").train)._enabled
    assert autocast(device, config(amp="auto").train)._enabled == torch.cpu._is_avx512_bf16_supported()


# From a checkpoint to predictions


@pytest.fixture(scope="module")
def run(store, tmp_path_factory) -> Path:
    return trained(store, tmp_path_factory.mktemp("runs") / "run", epochs=1)


def test_predictions_are_in_the_store_s_order_and_repeatable(store, run):
    found = predict(run, store)
    rows = store.index[store.index["split"].isin(["val", "test"])]
    assert found.ids["model_id"].tolist() == rows["model_id"].tolist()
    assert found.ids["view"].tolist() == rows["view"].tolist()
    assert found.heads == 3
    again = predict(load_model(run)[0], store)
    assert (found.hypotheses == again.hypotheses).all()
    assert (found.logits == again.logits).all()


def test_views_are_predicted_before_backgrounds_as_in_training_and_photographs_as_they_are(
    store, tmp_path, monkeypatch
):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    (tmp_path / "pictures").mkdir()
    for number, colour in enumerate(((250, 0, 0), (0, 250, 250))):
        Image.new("RGB", (70, 70), colour).save(tmp_path / "pictures" / f"{number}.png")
    behind = {"recipe": "photos", "backgrounds": str(tmp_path / "pictures"), "views": 4}
    folder, again = (trained(store, tmp_path / name, **behind) for name in ("one", "two"))
    assert same(weights(folder), weights(again))  # what is behind is a function of seed and step
    assert math.isfinite(float(log(folder)[-1]["repeated_views"]))
    assert not same(weights(folder), weights(trained(store, tmp_path / "plain", recipe="photos", backgrounds=None)))
    first = predict(folder, store, ("test",))
    assert np.array_equal(first.hypotheses, predict(folder, store, ("test",)).hypotheses)
    network, _ = load_model(folder)
    assert not np.allclose(first.hypotheses, predict(network, store, ("test",)).hypotheses)  # a network alone has none
    opaque = np.array(store.images)
    opaque[..., 3] = 255
    photographs = dataclasses.replace(store, images=opaque)
    seen = predict(folder, photographs, ("test",)).hypotheses
    assert np.allclose(seen, predict(network, photographs, ("test",)).hypotheses)


def test_a_loaded_model_is_the_one_that_was_kept(run):
    model, loaded = load_model(run)
    assert loaded == config(epochs=1)
    assert not model.training
    assert same({k: v.cpu() for k, v in model.state_dict().items()}, weights(run))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda file: file.unlink(), "no checkpoint at"),
        (lambda file: file.write_bytes(file.read_bytes()[:1000]), "not a whole checkpoint"),
        (lambda file: file.write_bytes(b""), "not a whole checkpoint"),
    ],
)
def test_damaged_checkpoints_are_refused(run, tmp_path, damage, message):
    shutil.copytree(run, tmp_path / "run")
    damage(tmp_path / "run" / "checkpoint.safetensors")
    with pytest.raises(ViewnetError, match=message):
        load_model(tmp_path / "run")


@pytest.mark.slow
def test_training_learns_to_draw(store, tmp_path):
    rows = log(trained(store, tmp_path / "run", epochs=25, learning_rate=3e-3))
    assert float(rows[-1]["pixels"]) < 0.7 * float(rows[0]["pixels"])


@pytest.mark.slow
def test_training_after_drawing_with_opengl_in_one_process():
    """Mesa and Triton each bring an LLVM; in the wrong order the process crashed."""
    code = """
import numpy as np, torch
from helpers.boxes import SYMMETRIC, box_mesh
from viewnet.render import choose_backend, render_mesh
if choose_backend("pyrender") != "pyrender":
    raise SystemExit(7)
render_mesh(box_mesh(SYMMETRIC), np.zeros(1), np.zeros(1), 16, 1, "pyrender")
torch.optim.Adam([torch.zeros(1, requires_grad=True)])
"""
    here = Path(__file__).parents[1]
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(here), str(here.parent)]))
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300)
    if done.returncode == 7:
        pytest.skip("OpenGL cannot draw here")
    assert done.returncode == 0, done.stderr


# Bad settings, and a log to watch


@pytest.mark.parametrize(
    ("overrides", "message"),
    [({"epochs": 0}, "epochs 0: expected 1 to 1000000"), ({"targets_per_object": 8}, "one object a step")],
)
def test_settings_that_cannot_be_trained_are_named(store, tmp_path, overrides, message):
    with pytest.raises(ViewnetError, match=message):
        trained(store, tmp_path / "run", **overrides)
    assert not (tmp_path / "run").exists()


def test_a_tensorboard_log_is_an_option(store, tmp_path, monkeypatch):
    written = []

    class SummaryWriter:
        def __init__(self, folder):
            written.append(folder)

        def add_scalar(self, name, value, step):
            written.append((name, value, step))

        def flush(self):
            pass

    module = types.ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = SummaryWriter
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    trained(store, tmp_path / "without", epochs=1)
    assert not written
    monkeypatch.setenv("VIEWNET_TENSORBOARD", "1")
    folder = trained(store, tmp_path / "with", epochs=2)
    assert written[0] == folder / "tensorboard"
    losses = [(value, step) for name, value, step in written[1:] if name == "loss"]
    assert losses == [(float(row["loss"]), int(row["step"])) for row in log(folder)]


def test_a_tensorboard_that_is_not_installed_is_named(store, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    monkeypatch.setenv("VIEWNET_TENSORBOARD", "1")
    with pytest.raises(ViewnetError, match="pip install tensorboard"):
        trained(store, tmp_path / "run", epochs=1)


def test_a_run_that_ended_early_and_was_killed_before_its_checkpoint_only_writes_it(store, tmp_path, monkeypatch):
    settings = {"epochs": 9, "patience": 1, "learning_rate": 10.0}  # nothing is gained by such steps
    whole = trained(store, tmp_path / "whole", **settings)
    assert len(log(whole)) < 9
    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr("viewnet.training.history.save_file", lambda *a, **k: (_ for _ in ()).throw(Killed))
        trained(store, tmp_path / "killed", **settings)
    resumed = trained(store, tmp_path / "killed", **settings)
    assert log(resumed) == log(whole)
    assert same(weights(resumed), weights(whole))
