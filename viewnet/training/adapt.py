"""Adaptation (ours): the viewpoint network trained on with a user's own photographs, of which nothing is known.

Drawn views differ from photographs in ways that no augmentation covers. Answers for photographs that their crops and
mirror images agree on are learned beside those for drawn views, so that nothing is forgotten. No label is used, and
none decides whether the result is kept: photographs held out do, by whether their augmented images agree more often.
"""

import copy
import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.data import augment
from viewnet.data.pairs import model_views
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.model.viewnet import ViewNet
from viewnet.training.distil import AUGMENTATIONS, BATCH, Hypotheses, Lesson, Seen, ask, ask_about, learn, learned, vote

LEAST = 50  # photographs
HELD_OUT = 0.2  # the share of photographs that is not learned from
KEPT, DRAWN_KEPT = 0.7, 0.8  # the share of photographs, and of drawn views, whose answers are the most confident
SHARE = 16  # photographs of a batch
ROUNDS, STEPS = 2, 700
RATE = 0.3  # of the learning rates of training: the network has learned most of it
TOGETHER = math.cos(math.radians(30))
SAME = 0.9  # the share of sure answers, for photographs held out and for drawn validation views, that must stay


@dataclass(frozen=True)
class Adaptation:
    """What came of it, as far as it can be known without labels."""

    photographs: int  # that were learned from
    held_out: int
    before: float  # the share of pairs of augmented images of a photograph held out that have one answer
    after: float
    stayed: float  # the share of photographs held out, those with the most confident answers, whose answer stays
    remembered: float  # the same of drawn validation views, all of them

    @property
    def kept(self) -> bool:
        """Whether the network was replaced."""
        return self.after > self.before and min(self.stayed, self.remembered) >= SAME


def adapt(
    model: ViewNet, config: RunConfig, store: ViewStore, photographs: Tensor, seed: int = 0, progress: bool = True
) -> Adaptation:
    """Trains `model.viewpoint` on its own answers for photographs (N, 4, S, S) uint8 and training views of `store`.

    `model` stays as it was unless `Adaptation.kept`, and on any error. Raises ViewnetError for a network that is not
    trained over backgrounds or has in-plane rotation, for fewer than LEAST photographs, and for a loss not finite.
    """
    if config.model.in_plane:
        raise ViewnetError("adapt: answers are viewpoints without in-plane rotation: train with in_plane=false")
    if config.data.backgrounds is None:
        raise ViewnetError("adapt: expected a network for photographs: train one with the recipe photos")
    if len(photographs) < LEAST:
        raise ViewnetError(f"adapt: {len(photographs)} photographs: needs {LEAST} or more")
    device, size = next(model.parameters()).device, config.model.input_size
    generator = torch.Generator().manual_seed(seed)
    train, val = (model_views(store, split, size, config.model) for split in ("train", "val"))
    backgrounds = augment.load(config.data, size, device)
    drawn = ask_about(model, config, train, backgrounds, generator)
    viewpoint, confidence = vote(drawn)
    rows = confidence.topk(math.ceil(DRAWN_KEPT * len(confidence))).indices.cpu()  # (n,)
    lesson = Lesson(rows, viewpoint, BATCH - SHARE, learned(config, train, backgrounds, device))
    order = torch.randperm(len(photographs), generator=generator)
    held_out, own = order.split([count := math.ceil(HELD_OUT * len(order)), len(order) - count])

    def known(chosen: Tensor) -> Hypotheses:
        seen = _seen(photographs[chosen], config, device)
        return ask(model, len(chosen), seen, AUGMENTATIONS, torch.Generator().manual_seed(seed), drawn.mirror)

    def on_drawn() -> Tensor:
        return vote(ask_about(model, config, val, backgrounds, torch.Generator().manual_seed(seed)))[0]

    optimiser = config.train.optimiser
    rates = {name: RATE * getattr(optimiser, name) for name in ("learning_rate", "muon")}
    gentle = replace(config, train=replace(config.train, optimiser=replace(optimiser, **rates)))
    former, said, formerly = model.viewpoint, known(held_out), on_drawn()
    model.viewpoint = copy.deepcopy(former)
    try:
        for number in range(ROUNDS):
            answer, confidence = vote(known(own))
            sure = confidence.topk(math.ceil(KEPT * len(own))).indices.cpu()  # (n,)
            lessons = [lesson, Lesson(sure, answer, SHARE, _seen(photographs[own], config, device))]
            learn(model, gentle, lessons, drawn.mirror, STEPS, generator, f"round {number + 1} of {ROUNDS}", progress)
        now = known(held_out)
        answer, confidence = vote(said)
        sure = confidence.topk(math.ceil(KEPT * len(held_out))).indices  # (n,)
        stayed, remembered = _same(answer[sure], vote(now)[0][sure]), _same(formerly, on_drawn())
        shares = _consistency(said), _consistency(now), stayed, remembered
        result = Adaptation(len(own), len(held_out), *shares)
    except BaseException:
        model.viewpoint = former
        raise
    if not result.kept:
        model.viewpoint = former
    return result


def _seen(photographs: Tensor, config: RunConfig, device: torch.device) -> Seen:
    """Photographs (N, 4, S, S) uint8 cut a little closer, rotated, and in other light."""

    def seen(rows: Tensor, generator: torch.Generator) -> Tensor:
        images = augment.crop_and_rotate(photographs[rows].to(device).float() / 255, generator)  # (n, 4, S, S)
        colours = augment.expose(images[:, :3], config.train.photo.exposure / 2, generator)  # they have their own
        return torch.cat([colours, images[:, 3:]], 1)  # (n, 4, S, S)

    return seen


def _same(one: Tensor, other: Tensor) -> float:
    """The share of view vectors (N, 3) within 30 degrees of others."""
    return float(((one * other).sum(1) > TOGETHER).float().mean())


def _consistency(said: Hypotheses) -> float:
    """The share of pairs of augmented images of one photograph whose most probable hypotheses are within 30 degrees."""
    weights = said.weights.unflatten(1, (AUGMENTATIONS, -1))  # (N, A, M)
    vectors = said.vectors.unflatten(1, (AUGMENTATIONS, -1))  # (N, A, M, 3)
    chosen = F.one_hot(weights.argmax(2), weights.shape[2]).to(vectors)  # (N, A, M)
    answers = (vectors * chosen[..., None]).sum(2)  # (N, A, 3)
    together = (answers @ answers.transpose(1, 2) > TOGETHER).float()  # (N, A, A)
    others = AUGMENTATIONS * (AUGMENTATIONS - 1)
    return float(((together.sum((1, 2)) - AUGMENTATIONS) / others).mean())
