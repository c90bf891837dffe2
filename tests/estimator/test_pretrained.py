from __future__ import annotations

import json
import pickle
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
import torch
from helpers.estimators import untrained
from helpers.untrained_models import finished_run, turned, untrained_run
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from viewnet.config import DataConfig, ModelConfig, VideoConfig
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator, pretrained
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predictions import Predictions
from viewnet.peers import registry
from viewnet.runtime.files import read_json, write_json

load = ViewpointEstimator.from_pretrained


def test_a_run_is_known_by_its_key_its_folder_and_its_checkpoint(run, images):
    aligned = align(Predictions.from_parquet(run.folder / "predictions.parquet"))
    for where in ("0123456789ab", run.folder, str(run.folder), run.folder / "checkpoint.safetensors"):
        estimator = load(where, device="cpu")
        assert estimator.aligned
        assert np.allclose(estimator.predict(images).hypotheses, aligned.hypotheses, atol=1e-6)
    assert "annotated frame" in repr(estimator)
    assert estimator.about["key"] == "0123456789ab"


def test_a_run_that_is_not_scored_is_not_aligned(tmp_path, images):
    estimator = load(finished_run(tmp_path / "run", None).folder)
    assert not estimator.aligned
    assert not estimator.predict(images).aligned
    estimator.save_pretrained(tmp_path / "saved")
    assert not load(tmp_path / "saved").aligned
    said = (tmp_path / "saved" / "README.md").read_text()
    assert "Not scored" in said
    assert "its own, not aligned" in said


def test_errors_of_loading(run, tmp_path):
    unfinished = untrained_run(tmp_path / "unfinished").folder
    with pytest.raises(ViewnetError, match="the run is not finished"):
        load(unfinished)
    (unfinished / "checkpoint.safetensors").unlink()
    with pytest.raises(ViewnetError, match="nor a finished run"):
        load(unfinished)
    for where in ("ba9876543210", tmp_path / "nowhere", tmp_path, "cars"):
        with pytest.raises(ViewnetError, match=r"no model there"):
            load(where)
    for where in ("a" * 300, "~nobody-of-that-name/model"):
        with pytest.raises(ViewnetError, match=r"model .*: not the name of a file or folder"):
            load(where)
    with pytest.raises(ViewnetError, match="device gpu: not available here"):
        load(run.folder, device="gpu")
    if not torch.cuda.is_available():
        with pytest.raises(ViewnetError, match="device cuda: not available here"):
            load(run.folder, device="cuda")


def test_saved_models_predict_the_same_bit_for_bit(run, images, tmp_path):
    estimator = load(run.folder)
    assert estimator.save_pretrained(tmp_path / "saved") is None
    assert sorted(p.name for p in (tmp_path / "saved").iterdir()) == ["README.md", "config.json", "model.safetensors"]
    again = load(tmp_path / "saved")
    one, other = estimator.predict(images), again.predict(images)
    assert np.array_equal(one.hypotheses, other.hypotheses)
    assert np.array_equal(one.probabilities, other.probabilities)
    assert np.array_equal(estimator.reconstruct(images), again.reconstruct(images))
    assert again.about == estimator.about
    assert again.config == estimator.config
    # Saved from a saved model, and over another one.
    again.save_pretrained(tmp_path / "again")
    untrained(rotation=turned(90)).save_pretrained(tmp_path / "saved")
    again.save_pretrained(tmp_path / "saved")
    for name in pretrained.WEIGHTS, pretrained.CONFIG, pretrained.CARD:
        assert (tmp_path / "saved" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_folders_of_a_machine_stay_there(tmp_path):
    video = VideoConfig("car", root="/home/someone/clips", mask_folder="/home/someone/masks")
    data = DataConfig("car", root="/home/someone/ShapeNetCore.v1", backgrounds="/home/someone/SUN397", video=video)
    estimator = untrained()
    there = replace(estimator, config=replace(estimator.config, data=data))
    there.save_pretrained(tmp_path / "saved")
    assert not any("someone" in path.read_bytes().decode(errors="ignore") for path in (tmp_path / "saved").iterdir())
    back = load(tmp_path / "saved")
    assert back.config.data.backgrounds == "SUN397"
    assert back.framing == there.framing


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2, "viewnet": "9.1"}, "format 2, written by viewnet 9.1"),
        ({"format": None}, "nor a finished run"),
        ({"about": ...}, "'about' is missing"),
        ({"alignment": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}}, "was not saved with this config.json"),
        ({"config": {"variant": "viewnet"}}, "is of another version of viewnet"),
    ],
)
def test_errors_of_configurations(tmp_path, change, message):
    untrained().save_pretrained(tmp_path)
    values = read_json(tmp_path / "config.json") | change
    write_json(tmp_path / "config.json", {name: value for name, value in values.items() if value is not ...})
    with pytest.raises(ViewnetError, match=message):
        load(tmp_path)


SIZES = [name for name, kind in get_type_hints(ModelConfig).items() if re.search(r"\bint\b", str(kind))]


@pytest.mark.parametrize("size", [10**7, 0, -1])
@pytest.mark.parametrize("name", SIZES)
@pytest.mark.parametrize("variant", ["viewnet", "spherical_regression"])
def test_sizes_of_a_network_beyond_all_limits_are_refused(tmp_path, variant, name, size):
    untrained().save_pretrained(tmp_path)
    values = read_json(tmp_path / "config.json")
    usual = values["config"]["model"][name]
    values["config"]["variant"] = variant
    values["config"]["model"][name] = [size] * len(usual) if isinstance(usual, list) else size
    write_json(tmp_path / "config.json", values)
    with pytest.raises(ViewnetError, match=rf"config\.json .*\({name} .*{size}.*: expected [18] to \d+\)") as error:
        load(tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("half", [False, True])
def test_weights_that_are_not_finite_are_refused(tmp_path, value, half):
    untrained().save_pretrained(tmp_path, half=half)
    path = tmp_path / "model.safetensors"
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    weights = load_file(path)
    name = next(name for name, weight in weights.items() if weight.ndim > 1)
    weights[name].view(-1)[-1] = value
    save_file(weights, path, metadata)
    with pytest.raises(ViewnetError, match=rf"model\.safetensors: {re.escape(name)} holds values that are not finite"):
        load(tmp_path)


def test_weights_of_a_run_that_are_not_finite_are_refused(run, tmp_path):
    shutil.copytree(run.folder, folder := tmp_path / "run")
    path = folder / "checkpoint.safetensors"
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    save_file(load_file(path) | {"focal": torch.tensor(float("nan"))}, path, metadata)
    for read in (load, registry.load):
        with pytest.raises(ViewnetError, match="focal holds values that are not finite"):
            read(folder)


@pytest.mark.parametrize("rotation", [np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.ones(5)])
def test_an_alignment_that_is_not_a_rotation_is_an_error(tmp_path, rotation):
    untrained(rotation=rotation).save_pretrained(tmp_path)
    with pytest.raises(ViewnetError, match=r"config\.json: .* not a rotation"):
        load(tmp_path)


def test_weights_that_do_not_fit_are_named(tmp_path):
    untrained().save_pretrained(tmp_path)
    path = tmp_path / "model.safetensors"
    whole, weights = path.read_bytes(), load_file(path)
    for change, message in (
        ({"focal": weights["focal"].double()}, r"focal is torch.float64 \(\), its configuration says torch.float32"),
        ({"focal": torch.zeros(2)}, r"focal is torch.float32 \(2,\), its configuration says torch.float32 \(\)"),
        ({"more": torch.zeros(2)}, "more has no place"),
        ({"focal": None}, "focal is missing"),
    ):
        save_file({name: value for name, value in (weights | change).items() if value is not None}, path)
        with pytest.raises(ViewnetError, match=rf"{message}.*not of one network"):
            load(tmp_path)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ViewnetError, match="not a whole file of weights"):
        load(tmp_path)
    path.unlink()
    with pytest.raises(ViewnetError, match=r"no model\.safetensors in it"):
        load(tmp_path)
    path.write_bytes(whole)
    (tmp_path / "config.json").unlink()
    with pytest.raises(ViewnetError, match=r"no config\.json in it"):
        load(tmp_path)


class Trap:
    """Leaves a trace where it is unpickled."""

    def __init__(self, trace: Path):
        self.trace = trace

    def __reduce__(self):
        return Path.touch, (self.trace,)


def test_nothing_is_unpickled(tmp_path):
    trace = tmp_path / "trace"
    untrained().save_pretrained(tmp_path / "saved")
    (tmp_path / "saved" / "model.safetensors").write_bytes(pickle.dumps(Trap(trace)))
    with pytest.raises(ViewnetError, match="not a whole file of weights"):
        load(tmp_path / "saved")
    assert not trace.exists()
    pickle.loads(pickle.dumps(Trap(trace)))
    assert trace.exists()


def test_errors_of_writing(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ViewnetError, match="is a file: name a folder"):
        untrained().save_pretrained(tmp_path / "file")


def test_a_folder_of_other_files_is_left_as_it_is(tmp_path):
    notes = tmp_path / "project" / "README.md"
    notes.parent.mkdir()
    notes.write_text("notes")
    with pytest.raises(ViewnetError, match="holds files and no saved model"):
        untrained().save_pretrained(notes.parent)
    assert [path.name for path in notes.parent.iterdir()] == ["README.md"] and notes.read_text() == "notes"
    notes.rename(notes.with_name(".gitattributes"))  # as in a clone from the hub
    for _ in range(2):  # the second time over the first
        untrained().save_pretrained(notes.parent)
    assert load(notes.parent, device="cpu").config.category == untrained().config.category


def test_half_precision_is_half_the_size_and_answers_alike(tmp_path, images):
    estimator = untrained()
    for half in (False, True):
        estimator.save_pretrained(tmp_path / str(half), half=half)
    whole, half = (tmp_path / name / "model.safetensors" for name in ("False", "True"))
    assert half.stat().st_size < 0.6 * whole.stat().st_size
    assert {value.dtype for value in load_file(half).values()} == {torch.float16, torch.int64}
    found = load(tmp_path / "True", device="cpu")
    assert {value.dtype for value in found.network.state_dict().values()} == {torch.float32, torch.int64}
    assert np.allclose(found.predict(images).hypotheses, estimator.predict(images).hypotheses, atol=0.01)


def test_values_out_of_range_of_half_precision_are_an_error(tmp_path):
    estimator = untrained()
    with torch.no_grad():
        next(estimator.network.viewpoint.encoder.parameters()).fill_(1e6)
    with pytest.raises(ViewnetError, match=r"viewpoint\.encoder.* half precision"):
        estimator.save_pretrained(tmp_path / "saved", half=True)
    assert not (tmp_path / "saved").exists()


def test_models_that_come_with_the_package_are_called_by_their_category(tmp_path, monkeypatch, images):
    untrained().save_pretrained(tmp_path / "car", half=True)
    monkeypatch.setattr(pretrained, "SHIPPED", tmp_path)
    (tmp_path / "not a model").mkdir()
    assert pretrained.shipped() == ["car"]
    assert np.allclose(load("car").predict(images).hypotheses, load(tmp_path / "car").predict(images).hypotheses)
    with pytest.raises(ViewnetError, match=r"boat: .* comes with viewnet \(car\)"):
        load("boat")


def test_the_configuration_is_json(tmp_path):
    untrained().save_pretrained(tmp_path)
    values = json.loads((tmp_path / "config.json").read_text())
    assert tuple(values) == pretrained.FIELDS
    assert values["config"] == untrained().config.to_dict()
