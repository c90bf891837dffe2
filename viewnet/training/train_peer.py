"""Training of methods of other papers (viewnet.peers): viewnet.training.train with a method's own loss in the step.

Batches, resuming, the log and the choice of weights are ViewNet's. Weights are chosen without labels where a method has
none: by its own loss on validation views.
"""

import math
import time
from pathlib import Path

import torch
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.data import augment
from viewnet.data.boxes import boxes_of
from viewnet.data.pairs import Views, model_views, sample_pairs, step_generator
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.geometry import look_at, view_vector
from viewnet.model.checkpoint import CHECKPOINT
from viewnet.peers import registry
from viewnet.peers.peer import Batch, Peer
from viewnet.runtime import distributed, memory
from viewnet.runtime.progress import bar
from viewnet.training.history import keep_best, resume, write
from viewnet.training.optimisers import descend, set_learning_rates
from viewnet.training.validation import accuracies, validation_rows


def train_peer(
    config: RunConfig, views: ViewStore, folder: Path, *, threads: int | None = None, progress: bool = True
) -> None:
    """Trains one run in `folder`, from where it was if it was begun before.

    Raises ViewnetError for views that lack what the method needs (named before anything is trained), under torchrun,
    and for a loss that is not finite (the last good state is kept).
    """
    if distributed.size() > 1:
        raise ViewnetError(f"{config.variant} trains in one process: run it without torchrun")
    if threads:
        torch.set_num_threads(threads)
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / CHECKPOINT).exists():
        return  # finished before: nothing to do
    memory.keep_freed()
    settings, device = config.train, torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.manual_seed(config.seed)  # the seed alone decides the initial weights
    model = registry.make(config.variant, config.model)
    model.begin()
    model.to(device)
    if "viewpoints" in model.needs:
        views.require_viewpoints(["train", "val"], f"{config.variant} learns from viewpoints: use an annotated store")
    source = Source(config, views, model, device)
    groups = model.parameter_groups(settings.optimiser.learning_rate)
    adam = torch.optim.Adam(groups, lr=settings.optimiser.learning_rate, betas=settings.optimiser.betas, fused=True)
    history = resume(model, [adam], folder)  # type: ignore[arg-type]  # it needs the state alone
    steps = max(1, len(source.training.objects) // settings.batch_size)
    total = settings.epochs * steps
    title = f"{config.variant} {config.category} seed {config.seed}"
    shown = bar(progress, total=total, initial=history.epoch * steps, desc=title, unit="step")
    begun = time.perf_counter() - history.seconds  # what came before a resume counts
    model.train()
    while history.epoch < settings.epochs and not history.exhausted(settings.patience, settings.select_by):
        sums: dict[str, float] = {}
        for step in range(history.epoch * steps, (history.epoch + 1) * steps):
            set_learning_rates([adam], settings.optimiser, step / total)
            generator = step_generator(config.seed, step)
            terms = model.losses(source.batch(step, generator), step / total, generator)
            for name, value in descend(model, [adam], terms, step, folder).items():
                sums[name] = sums.get(name, 0.0) + value / steps
            shown.update()
        history.epoch += 1
        if history.epoch % settings.validate_every == 0 or history.epoch == settings.epochs:
            scores = source.validate()
            history.seconds = time.perf_counter() - begun
            history.add(model, history.epoch * steps, (settings.select_by,), scores, sums)  # type: ignore[arg-type]
            write(model, [adam], history, folder)  # type: ignore[arg-type]  # goes on from here
            shown.set_postfix(acc=f"{scores['accuracy']:.0f}%", refresh=False)
    shown.close()
    keep_best(config, history, folder)  # only now: a checkpoint means finished


class Source:
    """Batches for training, and the scores of validation views."""

    def __init__(self, config: RunConfig, store: ViewStore, model: Peer, device: torch.device):
        self.config, self.model, self.device = config, model, device
        size = config.model.input_size
        held_out = "val" if (store.index["split"] == "val").any() else "train"
        splits = ("train", held_out)
        boxed = "boxes" in model.needs
        self.boxes = [boxes_of(config.data, store, each).to(device) if boxed else None for each in splits]  # (O, 3)
        self.training, self.validation = (model_views(store, each, size, config.model) for each in splits)
        self.backgrounds = augment.load(config.data, size, device)

    def batch(self, step: int, generator: torch.Generator) -> Batch:
        """The batch of a training step."""
        settings = self.config.train
        first, rows = sample_pairs(self.training, settings.objects, settings.targets_per_object, self.config.seed, step)
        return self._batch(self.training, first, rows, generator, self.boxes[0])

    def _batch(
        self, views: Views, first: Tensor, rows: Tensor, generator: torch.Generator, boxes: Tensor | None
    ) -> Batch:
        size = self.config.model.input_size
        images = tuple(views.viewpoint_input(each, size, self.device) for each in (first, rows))
        if self.config.train.augment and views is self.training:
            images = tuple(augment.crop_and_rotate(each, generator) for each in images)
        if self.backgrounds is not None:
            photo = self.config.train.photo
            images = tuple(augment.photograph(each, self.backgrounds, photo, generator) for each in images)
        frames = None
        if "viewpoints" in self.model.needs:
            frames = look_at(view_vector(*views.truth[rows].unbind(1))).to(self.device)  # (N, 3, 3)
        sides = None if boxes is None else boxes[views.objects[rows]]  # (N, 3)
        return Batch(images[0], images[1], frames, sides)

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Scores of `validation_rows`, named as viewnet.training.validation.validate has them.

        reconstruction is the mean of the method's `judged` terms, the rest is of the selected hypotheses' viewpoints.
        """
        views, generator = self.validation, torch.Generator().manual_seed(0)  # the same draws each time
        rows = validation_rows(views)  # (O, V)
        self.model.eval()
        error, vectors = 0.0, []
        for part in rows.split(16):
            batch = self._batch(views, part[:, 0], part.flatten(), generator, self.boxes[1])
            terms = self.model.losses(batch, 1.0, generator)
            error += sum(float(terms[name]) for name in self.model.judged) * len(part) / len(rows)
            found = self.model.viewpoint(self.model.composite(batch.images))
            vectors.append(found.of_heads(found.logits.argmax(1)))
        self.model.train()
        accurate = accuracies(torch.cat(vectors), views.truth[rows.flatten()], self.model.absolute)
        return {"reconstruction": error, **accurate, "least_used": math.nan, "focal": math.nan}
