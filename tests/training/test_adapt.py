"""Adaptation to photographs: what is learned from, what decides whether it is kept, and that else nothing changes."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers.dials import TURN, Reader, dials
from torch import nn

from viewnet.errors import ViewnetError
from viewnet.geometry import vector_angle, view_vector
from viewnet.model import viewnet
from viewnet.recipes import make_config
from viewnet.training import adapt as adapting
from viewnet.training.adapt import BATCH, SHARE, adapt

pytestmark = pytest.mark.usefixtures("one_thread")

CONFIG = make_config(profile="smoke", recipe="matting", backgrounds="drawn")


class Doubtful(Reader):
    """Takes bluish dials now for themselves and now for their opposites."""

    def forward(self, images: torch.Tensor) -> viewnet.Hypotheses:
        said = super().forward(images)
        doubt = said.logits[:, 0] < 1
        logits = torch.where((doubt & (torch.rand(len(images)) < 0.5))[:, None], said.logits[:, [1, 0, 2]], said.logits)
        return dataclasses.replace(said, logits=logits)


class Stuck(nn.Module):
    """Gives one answer, whatever it sees: with one on the mirror's plane all mirror images agree."""

    def forward(self, images: torch.Tensor) -> viewnet.Hypotheses:
        vector = view_vector(torch.tensor(TURN), torch.tensor(10.0))
        return viewnet.Hypotheses(vector.expand(len(images), 3, 3), torch.zeros(len(images), 3))


class StuckOnPhotographs(Reader):
    """Gives all photographs, which are a little blue, one answer."""

    def forward(self, images: torch.Tensor) -> viewnet.Hypotheses:
        said, stuck = super().forward(images), Stuck()(images)
        photograph = images[:, 2].mean((1, 2)) > 0.02
        vectors = torch.where(photograph[:, None, None], stuck.vectors, said.vectors)
        return viewnet.Hypotheses(vectors, said.logits)


def model_of(network: nn.Module) -> viewnet.ViewNet:
    torch.manual_seed(0)
    model = viewnet.ViewNet(CONFIG.model).eval()
    model.viewpoint = network
    return model


@pytest.fixture
def photographs(monkeypatch) -> torch.Tensor:
    monkeypatch.setattr("viewnet.data.augment.load", lambda *_: torch.zeros(2, 3, 64, 64, dtype=torch.uint8))
    return torch.from_numpy(dials(100, seed=1).images).permute(0, 3, 1, 2)


def learning(monkeypatch, network: nn.Module) -> list:
    """Let training end with this network; the lessons of each round."""
    rounds = []

    def learn(model, config, lessons, *_):
        rounds.append(lessons)
        model.viewpoint = network

    monkeypatch.setattr(adapting, "learn", learn)
    return rounds


def test_confident_answers_are_learned_beside_drawn_views_and_kept_if_images_held_out_agree_more(
    photographs, monkeypatch
):
    rounds = learning(monkeypatch, after := Reader())
    model = model_of(Doubtful())
    found = adapt(model, CONFIG, dials(200, val=100), photographs, progress=False)
    assert (found.photographs, found.held_out, len(rounds)) == (80, 20, adapting.ROUNDS)
    assert found.before < found.after == 1
    assert min(found.stayed, found.remembered) > 0.95
    assert found.kept
    assert model.viewpoint is after
    drawn, own = rounds[0]
    assert (drawn.share, own.share, len(drawn.rows), len(own.rows)) == (BATCH - SHARE, SHARE, 160, 56)
    truth = torch.tensor(dials(100, seed=1).index["azimuth"].to_list()) + TURN
    images = own.seen(torch.arange(80), torch.Generator().manual_seed(0))
    bluish = images[:, 2].mean((1, 2)) > 0.05
    assert not bluish[own.rows].any()  # none of the doubtful ones
    errors = vector_angle(own.viewpoint[own.rows, None], view_vector(truth, torch.full_like(truth, 10))[None])
    assert (errors.min(1).values < 5).all()


@pytest.mark.parametrize(
    ("before", "after", "passed"),
    [(Reader, Doubtful, (0, 1, 1)), (Doubtful, Stuck, (1, 0, 0)), (Doubtful, StuckOnPhotographs, (1, 0, 1))],
)
def test_what_does_not_help_or_overturns_sure_answers_is_not_kept(photographs, monkeypatch, before, after, passed):
    photographs[:, 2].clamp_(min=10)
    learning(monkeypatch, after())
    model = model_of(before())
    former = model.viewpoint
    found = adapt(model, CONFIG, dials(200, val=100), photographs, progress=False)
    assert (found.after > found.before, found.stayed >= adapting.SAME, found.remembered >= adapting.SAME) == passed
    assert not found.kept
    assert model.viewpoint is former


def test_what_cannot_be_adapted_is_refused_and_a_failure_leaves_the_model_as_it_was(photographs, monkeypatch):
    model = model_of(Reader())
    former = model.viewpoint
    store = dials(200, val=100)
    with pytest.raises(ViewnetError, match="adapt: 49 photographs: needs 50 or more"):
        adapt(model, CONFIG, store, photographs[:49], progress=False)
    black = make_config(profile="smoke", recipe="matting")
    with pytest.raises(ViewnetError, match="train one with the recipe photos"):
        adapt(model, black, store, photographs, progress=False)
    tilted = dataclasses.replace(CONFIG, model=dataclasses.replace(CONFIG.model, in_plane=True))
    with pytest.raises(ViewnetError, match=r"adapt: .* in_plane=false"):
        adapt(model, tilted, store, photographs, progress=False)

    def fail(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(adapting, "learn", fail)
    with pytest.raises(KeyboardInterrupt):
        adapt(model, CONFIG, store, photographs, progress=False)
    assert model.viewpoint is former
