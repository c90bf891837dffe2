"""What holds of every method of another paper: the same bits, resumed or not, refusals, names and keys."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.boxes import box_store
from helpers.imported_code import imports
from safetensors.torch import load_file

from viewnet.config import RunConfig
from viewnet.data.pairs import step_generator
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.evaluation.predict import predict
from viewnet.evaluation.run import FITTED_ALIGNMENTS, LEARNED_ALIGNMENTS, Run
from viewnet.geometry import look_at, view_vector
from viewnet.peers import registry
from viewnet.peers.imagenet import ImageNetTrunk
from viewnet.peers.peer import Batch
from viewnet.recipes import ABSOLUTE, PEERS, make_config
from viewnet.runs import run_store
from viewnet.runtime.files import write_json
from viewnet.training import train_peer as training
from viewnet.training.train_peer import train_peer

pytestmark = pytest.mark.usefixtures("one_thread")
CPU = torch.device("cpu")
every = pytest.mark.parametrize("variant", list(registry.METHODS))
HARMLESS = {
    # Settings, views and backgrounds are in the key by themselves; the others read and write, count and score.
    *("config.py", "errors.py", "paths.py", "data/backgrounds.py", "data/build.py", "data/store.py"),
    *("data/readers/shapenet.py", "evaluation/metrics.py", "evaluation/predictions.py", "model/checkpoint.py"),
    *("runtime/distributed.py", "runtime/files.py", "runtime/progress.py", "training/validation.py"),
    # Its networks are not a peer's, only its record of hypotheses.
    *("model/viewnet.py", "model/volume.py", "model/precision.py"),
}


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> ViewStore:
    return box_store(tmp_path_factory.mktemp("views") / "boxes", {"train": 8, "val": 3, "test": 2}, views=5)


@pytest.fixture
def possible(monkeypatch):
    """Boxes for the made-up objects, and no weights from ImageNet."""

    def boxes_of(data, store, split):
        return torch.tensor([0.8, 0.4, 0.4]).expand(store.index["model_id"].iloc[store.split(split)].nunique(), 3)

    monkeypatch.setattr(training, "boxes_of", boxes_of)
    monkeypatch.setattr(ImageNetTrunk, "begin", lambda self: None)


def config(variant: str, **overrides) -> RunConfig:
    """Two steps an epoch."""
    return make_config(
        variant,
        profile="smoke",
        **{"epochs": 2, "input_size": 32, "batch_size": 16, "targets_per_object": 4, **overrides},
    )


def trained(variant: str, store: ViewStore, folder: Path, **overrides) -> dict[str, torch.Tensor]:
    train_peer(config(variant, **overrides), store, folder, threads=1, progress=False)
    return load_file(folder / "checkpoint.safetensors")


def same(one: dict[str, torch.Tensor], two: dict[str, torch.Tensor]) -> bool:
    return one.keys() == two.keys() and all(torch.equal(one[name], two[name]) for name in one)


class Killed(Exception):
    pass


@every
def test_a_killed_training_goes_on_as_if_nothing_had_been(variant, store, tmp_path, monkeypatch, possible):
    whole = trained(variant, store, tmp_path / "whole")
    kind, left = registry.METHODS[variant], iter(range(3))
    losses = kind.losses

    def dying(self, *arguments):
        if self.training and next(left, None) is None:
            raise Killed
        return losses(self, *arguments)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(kind, "losses", dying)
        trained(variant, store, tmp_path / "killed")
    assert not (tmp_path / "killed" / "checkpoint.safetensors").exists()
    torch.manual_seed(12345)  # whatever else has been going on
    assert same(trained(variant, store, tmp_path / "killed"), whole)
    assert predict(tmp_path / "killed", store).hypotheses.shape == (25, 1, 3) or config(variant).model.heads > 1


@pytest.mark.parametrize("variant", ABSOLUTE)
def test_labels_that_a_method_learns_from_choose_its_weights_too(variant, store, tmp_path, possible, monkeypatch):
    settings = make_config(variant).train
    assert (settings.select_by, make_config(variant, recipe="photos").train.select_by) == ("accuracy", "reconstruction")
    assert make_config("relative_pose").train.select_by == "reconstruction"  # it knows no absolute viewpoint
    scores = [{"reconstruction": 0.1, "accuracy": 10.0}, {"reconstruction": 0.2, "accuracy": 20.0}]
    blank = dict.fromkeys(("folded", "robust", "least_used", "focal"), float("nan"))
    left = iter(scores * 2)
    monkeypatch.setattr(training.Source, "validate", lambda self: blank | next(left))
    by_labels, by_loss = (
        trained(variant, store, tmp_path / rule, select_by=rule) for rule in ("accuracy", "reconstruction")
    )
    assert not same(by_labels, by_loss)
    assert not list(tmp_path.rglob("checkpoint_robust.safetensors"))  # nothing is aligned, so there is one accuracy


def test_views_are_cut_and_rotated_in_training_alone(store, possible, tmp_path):
    source = training.Source(
        config("box_corners"), store, registry.make("box_corners", config("box_corners").model), CPU
    )
    plain = dataclasses.replace(source.config.train, augment=False)
    batches = {}
    for augmented in (True, False):
        source.config = dataclasses.replace(source.config, train=dataclasses.replace(plain, augment=augmented))
        batches[augmented] = source.batch(3, step_generator(0, 3)).images
    assert batches[True].shape == batches[False].shape and not torch.equal(batches[True], batches[False])
    assert 0 < (batches[True] - batches[False]).abs().mean() < 0.3  # the same views
    scores = []
    for augmented in (True, False):
        source.config = dataclasses.replace(source.config, train=dataclasses.replace(plain, augment=augmented))
        scores.append(source.validate()["reconstruction"])
    assert scores[0] == scores[1]


@every
def test_what_a_method_needs_is_asked_for_before_it_is_trained(variant, store, tmp_path, possible, monkeypatch):
    needs = registry.METHODS[variant].needs
    assert set(needs) <= {"viewpoints", "boxes"}
    unknown = dataclasses.replace(store, index=store.index.assign(azimuth=float("nan"), elevation=float("nan")))
    if "viewpoints" in needs:
        with pytest.raises(ViewnetError, match="no viewpoint"):
            trained(variant, unknown, tmp_path / "unknown")
    else:
        trained(variant, unknown, tmp_path / "unknown", epochs=1)
    monkeypatch.undo()
    monkeypatch.setattr(ImageNetTrunk, "begin", lambda self: None)
    if "boxes" in needs:
        with pytest.raises(ViewnetError, match="no boxes"):
            trained(variant, store, tmp_path / "boxless")
    assert not list(tmp_path.glob("*/log.csv")) or not needs


def test_methods_recipes_and_alignments_have_the_same_names():
    assert set(registry.METHODS) == set(PEERS)
    assert set(ABSOLUTE) == {name for name, kind in registry.METHODS.items() if kind.absolute}
    for name, kind in registry.METHODS.items():
        run = Run(make_config(name, profile="smoke"), Path(name))
        assert run.alignments == (FITTED_ALIGNMENTS if kind.absolute else LEARNED_ALIGNMENTS)
        assert kind.supervision and kind.judged


@every
def test_the_key_covers_all_code_that_training_reaches(variant):
    own = set(registry.code_of(variant))
    reached, waiting = set(), {"training/train_peer.py", *own}
    while waiting:
        module = waiting.pop()
        reached.add(module)
        found = imports(module) - HARMLESS - reached
        waiting |= {each for each in found if not each.startswith("peers/")} | (found & own)
    covered = {*run_store.PEER_TRAINING, *own}
    assert reached - covered == set()
    assert own - {"peers/peer.py"}


def test_no_key_has_code_that_is_not_there():
    assert all((run_store.provenance.PACKAGE / module).is_file() for module in run_store.PEER_TRAINING)


def test_a_mirrored_batch_is_of_mirrored_objects():
    count, views = 40, 2
    angles = torch.rand(count * views, 2) * torch.tensor([360.0, 60.0]) - torch.tensor([0.0, 20.0])
    frames, images = look_at(view_vector(*angles.unbind(1))), torch.rand(count * views, 4, 8, 8)
    batch = Batch(images[::views], images, frames, torch.rand(count * views, 3))
    found = batch.mirrored(torch.Generator().manual_seed(0))
    flipped = torch.tensor([torch.equal(*pair) for pair in zip(found.images, images.flip(-1), strict=True)])
    assert torch.equal(flipped[::2], flipped[1::2]) and 5 < flipped[::2].sum() < 35  # all views of an object, or none
    for chosen, sign in ((flipped, -1), (~flipped, 1)):
        expected = look_at(view_vector(sign * angles[chosen, 0], angles[chosen, 1]))
        assert torch.allclose(found.world_from_camera[chosen], expected, atol=1e-5)
        assert torch.equal(found.images[chosen], images[chosen].flip(-1) if sign < 0 else images[chosen])
    assert torch.equal(found.first, found.images[::views]) and torch.equal(found.boxes, batch.boxes)


@every
def test_a_finished_run_predicts_images_and_refuses_the_rest(variant, store, tmp_path, possible):
    folder = tmp_path / "run"
    trained(variant, store, folder, epochs=1)
    turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    write_json(folder / "result.json", {"metrics": {"procrustes": {"alignment": {"rotation": turn}}}})
    estimator = ViewpointEstimator.from_pretrained(folder, device="cpu")
    image = np.asarray(store.images[0])
    found = estimator.predict([image, image])
    own = predict(folder, store, splits=("train",)).selected[0]
    expected = own if variant in ABSOLUTE else np.array(turn) @ own
    assert found.aligned and np.allclose(found.vector, expected, atol=1e-4)
    for asked in (
        lambda: estimator.volume(image),
        lambda: estimator.save_pretrained(tmp_path / "saved"),
        lambda: estimator.export_onnx(tmp_path / "model.onnx"),
    ):
        with pytest.raises(ViewnetError, match=f"{variant} only predicts viewpoints"):
            asked()
    assert not (tmp_path / "saved").exists()


@pytest.mark.usefixtures("possible")
def test_a_pretrained_trunk_learns_slowly_or_not_at_all(store, tmp_path):
    for variant, frozen in (("spherical_regression_imagenet", False), ("spherical_regression_frozen", True)):
        torch.manual_seed(0)  # the seed of `trained`
        before = registry.make(variant, config(variant).model).state_dict()
        after = trained(variant, store, tmp_path / variant)
        moved = {name: (after[name] - before[name]).abs().max().item() for name in after}
        trunk = {name: by for name, by in moved.items() if ".convolutions." in name}
        rest = {name: by for name, by in moved.items() if name not in trunk}
        assert max(rest.values()) > 5 * max(trunk.values())
        assert (max(trunk.values()) == 0) == frozen
