"""Self-distillation (ours): the viewpoint network trained anew on what ViewNets answer for their training images.

ViewNet learns viewpoints while it learns to reconstruct, from errors that hardly tell the front of some objects from
their rear. Where an image and its mirror image, and several ViewNets, get one answer, it is right far more often than
elsewhere. A network that learns these answers alone, in a second round its own, sees many more images in the same time.
No viewpoint label is used, and all but the viewpoint network stays as it is, with the frame of its viewpoints.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.data import augment
from viewnet.data.pairs import Views, model_views
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import Robust
from viewnet.model.losses import pull_loss
from viewnet.model.viewnet import ViewNet, ViewpointNetwork
from viewnet.runtime.progress import bar
from viewnet.training.optimisers import descend, make_optimisers, set_learning_rates

KEPT = (0.7, 0.8)
"""The share of the images, those with the most confident answers, that is learned from in each round."""
EPOCHS = 30  # of a round
BATCH = 64
AUGMENTATIONS = 8  # images of a view that a network trained over backgrounds is asked about, half of them mirrored
NARROW, WIDE = 0.03, 0.1
"""Of kernels exp((cos - 1) / width): hypotheses within some 14 degrees make one answer, those within 26 confidence."""

Model = tuple[ViewNet, RunConfig]
Seen = Callable[[Tensor, torch.Generator], Tensor]
"""From rows (n,) of N images to these as a network is shown them, augmented: (n, 4, S, S) on its device."""


@dataclass(frozen=True)
class Hypotheses:
    """All that networks say of N images, in the frame of the first of them."""

    vectors: Tensor  # (N, K, 3)
    weights: Tensor  # (N, K), summing to 1
    mirror: Tensor  # (3, 3), what mirroring an image does to its view vector


@dataclass(frozen=True)
class Lesson:
    """Images whose viewpoints are learned."""

    rows: Tensor  # (n,) which of N images
    viewpoint: Tensor  # (N, 3)
    share: int  # images of a batch
    seen: Seen


def distil(
    model: ViewNet,
    config: RunConfig,
    store: ViewStore,
    teachers: Sequence[Model] = (),
    seed: int = 0,
    progress: bool = True,
) -> None:
    """Trains `model.viewpoint` anew on the answers of `teachers`, by default its own, for training views of `store`.

    Teachers may have seen views over backgrounds or over black: each is asked about such images as it was trained on.
    Raises ViewnetError for networks with in-plane rotation, for fewer than BATCH images to learn from, and for a loss
    that is not finite; `model` then is as it was.
    """
    if any(each.model.in_plane for each in (config, *(about for _, about in teachers))):
        raise ViewnetError("distil: answers are viewpoints without in-plane rotation: train with in_plane=false")
    device, size = next(model.parameters()).device, config.model.input_size
    views = model_views(store, "train", size, config.model)
    rows = math.ceil(min(KEPT) * len(views.objects))
    if rows < BATCH:
        raise ViewnetError(f"distil: {len(views.objects)} training views: needs {math.ceil(BATCH / min(KEPT))} or more")
    backgrounds = augment.load(config.data, size, device)
    before = model.viewpoint
    generator = torch.Generator().manual_seed(seed)
    said = ask_about(model, config, views, backgrounds, generator)
    if teachers:
        first, *others = [_asked_anew(*each, store, backgrounds, generator) for each in teachers]
        answer, _ = vote(first)
        # In one frame before the model's, which may be too often wrong to tell it, or what mirroring does.
        asked = [first, *(_in_frame_of(answer, each) for each in others)]
        joined = [torch.cat([getattr(each, name) for each in asked], 1) for name in ("vectors", "weights")]
        said = _in_frame_of(vote(said)[0], Hypotheses(joined[0], joined[1] / len(asked), first.mirror))
    try:
        for number, kept in enumerate(KEPT):
            viewpoint, confidence = vote(said)
            chosen = confidence.topk(math.ceil(kept * len(confidence))).indices  # (n,)
            torch.manual_seed(seed + number)  # the seed alone decides the initial weights
            model.viewpoint = ViewpointNetwork(config.model).to(device)
            lesson = Lesson(chosen.cpu(), viewpoint, BATCH, learned(config, views, backgrounds, device))
            title, steps = f"round {number + 1} of {len(KEPT)}", EPOCHS * (len(chosen) // BATCH)
            learn(model, config, [lesson], said.mirror, steps, generator, title, progress)
            if number + 1 < len(KEPT):
                said = ask_about(model, config, views, backgrounds, generator)
    except BaseException:
        model.viewpoint = before
        raise


def _asked_anew(
    model: ViewNet, config: RunConfig, store: ViewStore, backgrounds: Tensor | None, generator: torch.Generator
) -> Hypotheses:
    views = model_views(store, "train", config.model.input_size, config.model)
    if config.data.backgrounds is None:
        backgrounds = None
    elif backgrounds is None or backgrounds.shape[-1] != 2 * config.model.input_size:
        backgrounds = augment.load(config.data, config.model.input_size, next(model.parameters()).device)
    return ask_about(model, config, views, backgrounds, generator)


def ask_about(
    model: ViewNet, config: RunConfig, views: Views, backgrounds: Tensor | None, generator: torch.Generator
) -> Hypotheses:
    """What a network says of views: of each as it is and mirrored, or, with backgrounds, of AUGMENTATIONS of it."""
    device, size = next(model.parameters()).device, config.model.input_size
    seen, times = learned(config, views, backgrounds, device), AUGMENTATIONS
    if backgrounds is None:
        seen, times = (lambda rows, _: views.viewpoint_input(rows, size, device)), 2
    return ask(model, len(views.objects), seen, times, generator)


def learned(config: RunConfig, views: Views, backgrounds: Tensor | None, device: torch.device) -> Seen:
    """Views as networks are trained on them, over backgrounds or, without any, as they are."""

    def seen(rows: Tensor, generator: torch.Generator) -> Tensor:
        crops = views.viewpoint_input(rows, config.model.input_size, device)  # (n, 4, S, S)
        if backgrounds is None:
            return augment.crop_and_rotate(crops, generator)
        return augment.photograph(crops, backgrounds, config.train.photo, generator)

    return seen


@torch.no_grad()
def ask(
    model: ViewNet, count: int, seen: Seen, times: int, generator: torch.Generator, mirror: Tensor | None = None
) -> Hypotheses:
    """What a network says of `count` images that it is shown so many times, every second time mirrored.

    Without a `mirror` the one that brings most answers for the first two together.
    """
    model.eval()
    vectors, weights, answers = [], [], []
    for rows in torch.arange(count).split(4 * BATCH):
        found = []
        for number in range(times):
            images = seen(rows, generator)  # (n, 4, S, S)
            found.append(model.viewpoint(model.composite(images.flip(-1) if number % 2 else images)))
        vectors.append(torch.stack([each.vectors for each in found], 1))  # (n, A, M, 3)
        weights.append(torch.stack([each.logits.softmax(1) for each in found], 1))  # (n, A, M)
        answers.append(torch.stack([each.of_heads(each.logits.argmax(1)) for each in found[:2]], 1))  # (n, 2, 3)
    said = torch.cat(vectors)  # (N, A, M, 3)
    if mirror is None:
        plain, mirrored = torch.cat(answers).unbind(1)  # (N, 3) each
        flip = torch.diag(plain.new_tensor([1.0, -1.0, 1.0]))
        mirror = flip @ _rotation(mirrored, plain @ flip)  # takes most answers for mirrored images to the others
    said[:, 1::2] = said[:, 1::2] @ mirror.T  # back to what the unmirrored image shows
    return Hypotheses(said.flatten(1, 2), torch.cat(weights).flatten(1) / times, mirror)


def _rotation(vectors: Tensor, onto: Tensor) -> Tensor:
    """The rotation (3, 3) that takes most of view vectors (N, 3) to `onto` (N, 3)."""
    fit = Robust.fit(*(each.double().cpu().numpy() for each in (vectors, onto)))
    return torch.as_tensor(fit.rotation).to(vectors)


def _in_frame_of(viewpoint: Tensor, said: Hypotheses) -> Hypotheses:
    """What is said, turned so that most of its answers are the viewpoints (N, 3)."""
    answer, _ = vote(said)
    rotation = _rotation(answer, viewpoint)
    return Hypotheses(said.vectors @ rotation.T, said.weights, rotation @ said.mirror @ rotation.T)


def vote(said: Hypotheses) -> tuple[Tensor, Tensor]:
    """The view vector (N, 3) where hypotheses lie closest together, and the share (N,) of their weight around it."""
    answers, confidence = [], []
    for vectors, weights in zip(said.vectors.split(1000), said.weights.split(1000), strict=True):
        close = torch.exp((vectors @ vectors.transpose(1, 2) - 1) / NARROW)  # (n, K, K)
        best = (close @ weights[:, :, None])[:, :, 0].argmax(1)  # (n,)
        answer = vectors[torch.arange(len(vectors), device=vectors.device), best]  # (n, 3)
        for _ in range(2):  # to the mean of what is around it
            near = torch.exp(((vectors @ answer[:, :, None])[:, :, 0] - 1) / NARROW) * weights  # (n, K)
            answer = F.normalize((near[:, :, None] * vectors).sum(1), dim=-1)  # (n, 3)
        answers.append(answer)
        around = torch.exp(((vectors @ answer[:, :, None])[:, :, 0] - 1) / WIDE)  # (n, K)
        confidence.append((around * weights).sum(1))  # (n,)
    return torch.cat(answers), torch.cat(confidence)


def learn(
    model: ViewNet,
    config: RunConfig,
    lessons: Sequence[Lesson],
    mirror: Tensor,
    steps: int,
    generator: torch.Generator,
    title: str,
    progress: bool,
) -> None:
    """Train `model.viewpoint`: the closest head learns the viewpoint, and the selection which head that is.

    Half of the images are mirrored, viewpoints by `mirror` (3, 3). Raises ViewnetError for a loss that is not finite.
    """
    optimisers = make_optimisers(model, config.train)  # what has no gradient stays as it is
    batches = [_batches(lesson, generator) for lesson in lessons]
    model.train()
    with bar(progress, total=steps, desc=title, unit="step") as shown:
        for step in range(steps):
            set_learning_rates(optimisers, config.train.optimiser, step / steps)
            parts = [next(batch) for batch in batches]
            images, wanted = (torch.cat(each) for each in zip(*parts, strict=True))  # (B, 4, S, S) and (B, 3)
            mirrored = (torch.rand(len(wanted), generator=generator) < 0.5).to(wanted.device)  # (B,)
            images = torch.where(mirrored[:, None, None, None], images.flip(-1), images)
            wanted = torch.where(mirrored[:, None], wanted @ mirror, wanted)  # its inverse: rows times it
            said = model.viewpoint(model.composite(images))
            closest = said.closest(wanted)  # (B,)
            terms = {
                "pull": pull_loss(said.of_heads(closest), wanted),
                "selection": F.cross_entropy(said.logits, closest),
            }
            descend(model, optimisers, terms, step, title)
            shown.update()
    model.eval()


def _batches(lesson: Lesson, generator: torch.Generator) -> Iterator[tuple[Tensor, Tensor]]:
    """Images and their viewpoints, `share` at a time: pass after pass over all but the last few."""
    while True:
        order = lesson.rows[torch.randperm(len(lesson.rows), generator=generator)]  # (n,)
        for start in range(0, len(order) - lesson.share + 1, lesson.share):
            rows = order[start : start + lesson.share]
            yield lesson.seen(rows, generator), lesson.viewpoint[rows.to(lesson.viewpoint.device)]
