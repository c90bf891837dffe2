"""Self-distillation: answers are voted on, doubtful ones left out, and what is learned is right where they were not."""

from __future__ import annotations

import dataclasses
import itertools

import pytest
import torch
from helpers.dials import TURN, Reader, dials

from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import Robust
from viewnet.geometry import azimuth_elevation, vector_angle, view_vector
from viewnet.model import viewnet
from viewnet.recipes import make_config
from viewnet.training import distil as distilling
from viewnet.training.distil import Hypotheses, ask_about, distil, vote

pytestmark = pytest.mark.usefixtures("one_thread")

CONFIG = make_config(profile="smoke", recipe="matting")


def reader() -> viewnet.ViewNet:
    torch.manual_seed(0)
    model = viewnet.ViewNet(CONFIG.model).eval()
    model.viewpoint = Reader()
    return model


def altered(change) -> viewnet.ViewNet:
    """A reader that says what `change` makes of the azimuths it reads."""
    model = reader()
    before = model.viewpoint.forward

    def forward(images):
        said = before(images)
        azimuth, elevation = azimuth_elevation(said.vectors)
        return viewnet.Hypotheses(view_vector(change(azimuth), elevation), said.logits)

    model.viewpoint.forward = forward
    return model


def wrong(model: viewnet.ViewNet, store: ViewStore) -> float:
    """The share of views whose answer is off by more than 30 degrees in the reader's frame."""
    images = torch.from_numpy(store.images).permute(0, 3, 1, 2).float() / 255
    with torch.no_grad():
        said = model.eval().viewpoint(model.composite(images))
    azimuth = torch.tensor(store.index["azimuth"].to_list())
    truth = view_vector(azimuth + TURN, torch.full_like(azimuth, 10))
    return float((vector_angle(said.of_heads(said.logits.argmax(1)), truth) > 30).float().mean())


def test_hypotheses_that_lie_together_outvote_one_that_is_surer():
    azimuth = torch.tensor([[10.0, 14.0, 200.0], [0.0, 120.0, 240.0]])
    said = Hypotheses(
        view_vector(azimuth, torch.zeros(2, 3)), torch.tensor([[0.3, 0.3, 0.4], [0.2, 0.5, 0.3]]), torch.eye(3)
    )
    answer, confidence = vote(said)
    assert azimuth_elevation(answer)[0].tolist() == pytest.approx([12, 120], abs=0.5)
    assert confidence.tolist() == pytest.approx([0.6, 0.5], abs=0.02)


def test_the_mirror_is_found_without_labels():
    store, model = dials(300), reader()
    views = distilling.model_views(store, "train", 32, CONFIG.model)
    said = ask_about(model, CONFIG, views, None, torch.Generator().manual_seed(0))
    assert_mirrors(said.mirror)


def assert_mirrors(mirror: torch.Tensor) -> None:
    """In the true frame y changes its sign: in one turned by TURN about the vertical, azimuth a becomes 2 TURN - a."""
    azimuth = torch.tensor([0.0, 70.0, 200.0])
    mirrored = azimuth_elevation(view_vector(azimuth, torch.full((3,), 10.0)) @ mirror.T)[0]
    assert torch.allclose(torch.cos(torch.deg2rad(mirrored - (2 * TURN - azimuth))), torch.ones(3), atol=1e-3)


@pytest.mark.slow
def test_a_student_is_right_where_its_teacher_was_wrong_in_the_same_frame():
    store, model = dials(1500), reader()
    assert wrong(model, store) == pytest.approx(0.25, abs=0.01)
    others = {name: value.clone() for name, value in model.state_dict().items()}
    distil(model, CONFIG, store, progress=False)
    assert wrong(model, store) < 0.05
    after = model.state_dict()
    assert all(torch.equal(after[name], value) for name, value in others.items())  # all but the viewpoint network


def test_teachers_answer_in_frames_of_their_own_and_the_model_keeps_its(monkeypatch):
    monkeypatch.setattr(distilling, "EPOCHS", 1)
    learned = []
    monkeypatch.setattr(distilling, "learn", lambda *what: learned.append(what[2][0]))
    store, model = dials(300), reader()
    turned = altered(lambda azimuth: azimuth + 77)
    monkeypatch.setattr(distilling, "KEPT", (0.7,))
    distil(model, CONFIG, store, [(turned, CONFIG), (turned, CONFIG)], progress=False)
    chosen, viewpoint = learned[0].rows, learned[0].viewpoint
    assert len(chosen) == 210
    truth = torch.tensor(store.index["azimuth"].to_list()) + TURN
    errors = vector_angle(viewpoint, view_vector(truth, torch.full_like(truth, 10)))
    assert (errors[chosen] < 5).all()  # none of the doubtful ones
    assert (errors > 150).float().mean() == pytest.approx(0.25, abs=0.01)


def test_teachers_agree_with_each_other_where_the_model_does_not_with_itself(monkeypatch):
    learned = []
    monkeypatch.setattr(distilling, "learn", lambda *what: learned.append(what[2][0]))
    monkeypatch.setattr(distilling, "KEPT", (0.5,))
    store, generator = dials(300), torch.Generator().manual_seed(0)

    def lost(low, high):
        """Azimuths between `low` and `high` are anything."""
        return lambda a: torch.where((a > low) & (a < high), 360 * torch.rand(a.shape, generator=generator), a)

    # One half of the model's answers is in another frame; each teacher knows one of the halves better.
    model = altered(lambda azimuth: torch.where(azimuth < 180, azimuth, azimuth + 90))
    teachers = [(altered(lost(0, 60)), CONFIG), (altered(lost(180, 240)), CONFIG)]
    distil(model, CONFIG, store, teachers, progress=False)
    chosen, viewpoint = learned[0].rows, learned[0].viewpoint
    azimuth = torch.tensor(store.index["azimuth"].to_list())
    truth = view_vector(azimuth, torch.full_like(azimuth, 10))
    said, true = viewpoint[chosen].double(), truth[chosen].double()
    turned = torch.from_numpy(Robust.fit(said.numpy(), true.numpy()).apply(said.numpy()))  # from whatever frame
    assert (vector_angle(turned, true) < 5).double().mean() > 0.95


def test_what_mirroring_does_is_learned_from_the_teachers(monkeypatch):
    store, model, learned = dials(300), reader(), []
    monkeypatch.setattr(distilling, "learn", lambda *what: learned.append(what[3]))
    monkeypatch.setattr(distilling, "KEPT", (0.7,))
    reads, calls = model.viewpoint.forward, itertools.count()
    # It takes no notice: asked about an image and its mirror image in turns, it gives the same answer.
    model.viewpoint.forward = lambda images: reads(images.flip(-1) if next(calls) % 2 else images)
    distil(model, CONFIG, store, [(reader(), CONFIG)], progress=False)
    assert_mirrors(learned[0])


def test_what_cannot_be_distilled_is_refused_and_a_failure_leaves_the_model_as_it_was(monkeypatch):
    model = reader()
    tilted = dataclasses.replace(CONFIG, model=dataclasses.replace(CONFIG.model, in_plane=True))
    with pytest.raises(ViewnetError, match="in_plane=false"):
        distil(model, tilted, dials(300), progress=False)
    with pytest.raises(ViewnetError, match="50 training views: needs 92 or more"):
        distil(model, CONFIG, dials(50), progress=False)
    steep = make_config(profile="smoke", recipe="matting", learning_rate=1e12, muon=0.0)
    viewpoint = model.viewpoint
    with pytest.raises(ViewnetError, match="the loss is not finite at step"):
        distil(model, steep, dials(300), progress=False)
    assert model.viewpoint is viewpoint
