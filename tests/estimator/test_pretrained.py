from __future__ import annotations

import json
import pickle
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import huggingface_hub
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from helpers.boxes import box_store
from helpers.estimators import same, untrained
from helpers.untrained_models import finished_run, turned, untrained_run
from safetensors.torch import load_file, save_file

from viewnet.config import DataConfig, VideoConfig
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator, pretrained
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predictions import Predictions
from viewnet.runtime.files import read_json, write_json

load = ViewpointEstimator.from_pretrained


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return box_store(tmp_path_factory.mktemp("pretrained") / "views", {"val": 3, "test": 3}, views=3)


@pytest.fixture(scope="module")
def images(store):
    return np.asarray(store.images[store.split("test")])


@pytest.fixture
def run(store, tmp_path, monkeypatch):
    """A finished run in a run store of its own."""
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    return finished_run(tmp_path / "runs" / "viewnet" / "0123456789ab", store)


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


def test_what_is_no_finished_run_is_said(run, tmp_path):
    unfinished = untrained_run(tmp_path / "unfinished").folder
    with pytest.raises(ViewnetError, match="a run that is not finished: give the command that trains it again"):
        load(unfinished)
    (unfinished / "checkpoint.safetensors").unlink()
    with pytest.raises(ViewnetError, match="neither a model of save_pretrained nor a finished run"):
        load(unfinished)
    for where in ("ba9876543210", tmp_path / "nowhere", tmp_path, "cars"):
        with pytest.raises(
            ViewnetError, match=r"no model there: expected a model that .*, a folder of save_pretrained"
        ):
            load(where)
    with pytest.raises(ViewnetError, match="device gpu: not available here"):
        load(run.folder, device="gpu")
    if not torch.cuda.is_available():
        with pytest.raises(ViewnetError, match="device cuda: not available here"):
            load(run.folder, device="cuda")


def test_saved_models_say_the_same_to_the_bit(run, images, tmp_path):
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
    video = VideoConfig("car", root="/home/someone/clips", masks="alpha")
    data = DataConfig("car", root="/home/someone/ShapeNetCore.v1", backgrounds="/home/someone/SUN397", video=video)
    estimator = untrained()
    there = replace(estimator, config=replace(estimator.config, data=data))
    there.save_pretrained(tmp_path / "saved")
    assert not any("someone" in path.read_bytes().decode(errors="ignore") for path in (tmp_path / "saved").iterdir())
    back = load(tmp_path / "saved")
    assert back.config.data.backgrounds == "SUN397"
    assert back.framing == there.framing


def test_the_card_is_what_the_hub_reads(run, tmp_path):
    load(run.folder).save_pretrained(tmp_path / "saved")
    card = huggingface_hub.ModelCard.load(tmp_path / "saved" / "README.md")
    metrics = run.result["metrics"]["procrustes"]
    found = {result.metric_type: result.metric_value for result in card.data.eval_results}
    assert found == {name: metrics[name] for name in ("acc30", "median", "dva")}
    assert (card.data.license, card.data.library_name) == ("mit", "viewnet")
    assert f"| Acc@30, % | {metrics['acc30']:.1f} [" in card.text
    assert "9 test views of 3 objects" in card.text
    estimator = untrained(data_root="/data/ShapeNet")
    estimator.save_pretrained(tmp_path / "other")
    assert huggingface_hub.ModelCard.load(tmp_path / "other" / "README.md").data.license == "other"
    estimator.save_pretrained(tmp_path / "other", license="cc-by-4.0")
    assert huggingface_hub.ModelCard.load(tmp_path / "other" / "README.md").data.license == "cc-by-4.0"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2, "viewnet": "9.1"}, "format 2, written by viewnet 9.1: this version reads format 1"),
        ({"format": None}, "neither a model of save_pretrained nor a finished run"),
        ({"about": ...}, "'about' is missing"),
        ({"alignment": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}}, "was not saved with this config.json"),
        ({"config": {"variant": "viewnet"}}, "is of another version of viewnet"),
    ],
)
def test_a_configuration_that_does_not_fit_is_said(tmp_path, change, message):
    untrained().save_pretrained(tmp_path)
    values = read_json(tmp_path / "config.json") | change
    write_json(tmp_path / "config.json", {name: value for name, value in values.items() if value is not ...})
    with pytest.raises(ViewnetError, match=message):
        load(tmp_path)


@pytest.mark.parametrize("rotation", [np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.ones(5)])
def test_an_alignment_that_is_no_rotation_is_said(tmp_path, rotation):
    untrained(rotation=rotation).save_pretrained(tmp_path)
    with pytest.raises(ViewnetError, match=r"config\.json: its alignment is not a rotation"):
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
        with pytest.raises(ViewnetError, match=rf"{message}.*: weights and configuration are not of one network"):
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


def test_what_cannot_be_written_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ViewnetError, match="is a file: name a folder"):
        untrained().save_pretrained(tmp_path / "file")


def cached(estimator: ViewpointEstimator, cache: Path, name: str) -> None:
    """A model in the cache of the hub's library."""
    repository = cache / f"models--{name.replace('/', '--')}"
    estimator.save_pretrained(repository / "snapshots" / "c0ffee")
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text("c0ffee")


def test_the_hub_s_models_are_read_from_its_cache(images, tmp_path):
    estimator = untrained(rotation=turned(20))
    cached(estimator, tmp_path, "someone/cars")
    found = load("someone/cars", cache_dir=tmp_path, local_files_only=True)
    assert same(found.predict(images), estimator.predict(images), 0)
    for name, options in (("someone/boats", {}), ("someone/cars", {"revision": "v2"})):
        with pytest.raises(ViewnetError, match=rf"{name}: the Hugging Face hub gives no such model \(") as told:
            load(name, cache_dir=tmp_path, local_files_only=True, **options)
        assert "\n" not in str(told.value)


def test_without_the_hub_s_library_folders_are_all_there_is(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    untrained().save_pretrained(tmp_path)
    load(tmp_path)
    with pytest.raises(ViewnetError, match=r'and for the Hugging Face hub: pip install "viewnet\[hub\]"'):
        load("someone/cars")


def test_models_go_to_the_hub(tmp_path, monkeypatch, images):
    class Api:
        def __init__(self, token=None):
            assert token == "secret"

        def create_repo(self, repo_id, private, exist_ok):
            assert (private, exist_ok) == (True, True)
            return huggingface_hub.RepoUrl(f"https://huggingface.co/{repo_id}")

        def upload_folder(self, repo_id, folder_path, allow_patterns, **_):
            there = tmp_path / "hub" / repo_id
            shutil.copytree(folder_path, there, ignore=lambda _, names: set(names) - set(allow_patterns))
            return f"https://huggingface.co/{repo_id}/commit/1"

    monkeypatch.setattr(huggingface_hub, "HfApi", Api)
    estimator = untrained()
    (tmp_path / "cars").mkdir()
    (tmp_path / "cars" / "private.txt").write_text("stays here")
    options = {"push_to_hub": True, "private": True, "token": "secret"}
    address = estimator.save_pretrained(tmp_path / "cars", repo_id="someone/cars", **options)
    assert address == "https://huggingface.co/someone/cars/commit/1"
    assert same(load(tmp_path / "hub" / "someone" / "cars").predict(images), estimator.predict(images), 0)
    assert not (tmp_path / "hub" / "someone" / "cars" / "private.txt").exists()
    with pytest.raises(ViewnetError, match=r"someone/cars: the Hugging Face hub takes no model \("):
        estimator.save_pretrained(tmp_path / "cars", repo_id="someone/cars", **options)


@pytest.mark.parametrize("overrides", [{"recipe": "paper"}, {"in_plane": True}], ids=["replicate", "in plane"])
@pytest.mark.slow
def test_onnx_says_what_the_network_says(tmp_path, overrides):
    estimator = untrained(rotation=turned(30), **overrides)
    path = estimator.export_onnx(tmp_path / "models" / "car.onnx")
    onnx.checker.check_model(onnx.load(path), full_check=True)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    assert [given.name for given in session.get_inputs()] == ["pictures"]
    for count in (1, 5):
        seen = torch.rand(count, 3, 32, 32, generator=torch.Generator().manual_seed(count))
        with torch.no_grad():
            expected = estimator.network.viewpoint(seen)
        found = dict(
            zip([o.name for o in session.get_outputs()], session.run(None, {"pictures": seen.numpy()}), strict=True)
        )
        assert found["vectors"].shape == (count, 3, 3)
        assert np.allclose(found["vectors"], expected.vectors, atol=1e-5)
        assert np.allclose(found["logits"], expected.logits, atol=1e-4)
        assert ("ups" in found) == (expected.ups is not None)
        if expected.ups is not None:
            assert np.allclose(found["ups"], expected.ups, atol=1e-5)
    kept = session.get_modelmeta().custom_metadata_map
    assert np.allclose(np.array(kept["rotation"].split(), float).reshape(3, 3), turned(30))
    assert kept["category"] == "car"


def test_what_cannot_be_exported_is_said(tmp_path, monkeypatch):
    with pytest.raises(ViewnetError, match=r"car\.pt: unknown kind of model file: name it \.onnx"):
        untrained().export_onnx(tmp_path / "car.pt")
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(ViewnetError, match=r'onnxscript is not installed: pip install "viewnet\[onnx\]"'):
        untrained().export_onnx(tmp_path / "car.onnx")
    assert not list(tmp_path.iterdir())


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


def test_what_half_precision_cannot_hold_is_said(tmp_path):
    estimator = untrained()
    with torch.no_grad():
        next(estimator.network.viewpoint.encoder.parameters()).fill_(1e6)
    with pytest.raises(ViewnetError, match=r"viewpoint\.encoder.* holds values that half precision cannot"):
        estimator.save_pretrained(tmp_path / "saved", half=True)
    assert not (tmp_path / "saved").exists()


def test_models_that_come_with_the_package_are_called_by_their_category(tmp_path, monkeypatch, images):
    untrained().save_pretrained(tmp_path / "car", half=True)
    monkeypatch.setattr(pretrained, "SHIPPED", tmp_path)
    (tmp_path / "not a model").mkdir()
    assert pretrained.shipped() == ["car"]
    assert np.allclose(load("car").predict(images).hypotheses, load(tmp_path / "car").predict(images).hypotheses)
    with pytest.raises(ViewnetError, match=r"boat: no model there: expected a model that comes with viewnet \(car\)"):
        load("boat")


def test_the_configuration_is_json(tmp_path):
    untrained().save_pretrained(tmp_path)
    values = json.loads((tmp_path / "config.json").read_text())
    assert tuple(values) == pretrained.FIELDS
    assert values["config"] == untrained().config.to_dict()
