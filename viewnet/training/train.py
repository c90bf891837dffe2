"""Training, top to bottom. To resume, call it again: every step is a function of (seed, step) and the saved state.

step        reconstruct targets from another view's appearance and the best of M viewpoint hypotheses
validation  reconstruction error without labels, and accuracy with them; either may choose the weights to keep
files       log.csv (a row a validation), state.pt (to resume), checkpoint.safetensors (the best weights; last)

Under torchrun all processes train one run (viewnet.runtime.distributed); the first one validates and writes.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.data import augment
from viewnet.data.pairs import Views, model_views, sample_pairs, step_generator
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.model.checkpoint import CHECKPOINT, starting_weights
from viewnet.model.kernels import volume_cpu
from viewnet.model.losses import PerceptualLoss
from viewnet.model.viewnet import ViewNet
from viewnet.runtime import distributed, memory
from viewnet.runtime.progress import bar
from viewnet.runtime.random import RankGenerator
from viewnet.training.history import board_of, keep_best, resume, write
from viewnet.training.optimisers import descend, make_optimisers, set_learning_rates
from viewnet.training.step import step_loss
from viewnet.training.validation import validate


def train(
    config: RunConfig, views: ViewStore, folder: Path, *, threads: int | None = None, progress: bool = True
) -> None:
    """Trains one run in `folder`, from where it was if it was begun before.

    Where no labels are asked for and there is no validation split, the training split serves. Raises ViewnetError for
    data that cannot be trained on, such as views without viewpoints where accuracy chooses the weights, for missing
    perceptual weights, weights to start from of another network, a batch that the processes cannot share, or a loss
    or weights that are not finite (the last good state is kept).
    """
    distributed.start()  # one process unless torchrun started several
    if threads:
        torch.set_num_threads(threads)
    writes = distributed.rank() == 0  # files have one writer
    settings, processes = config.train, distributed.size()
    if settings.objects % processes:  # equal shares make a mean of means the batch's mean
        raise ViewnetError(
            f"batch_size {settings.batch_size} with targets_per_object {settings.targets_per_object} is "
            f"{settings.objects} objects a step, which {processes} processes cannot share: choose a multiple"
        )
    if writes:
        folder.mkdir(parents=True, exist_ok=True)
    if distributed.first((folder / CHECKPOINT).exists):
        return  # finished before: nothing to do
    volume_cpu.warm_up()  # loads kernels before the clock starts
    memory.keep_freed()
    run = _set_up(config, views)
    history = resume(run.model, run.optimisers, folder)
    board = board_of(folder) if writes else None
    title = f"{config.variant} {config.category} seed {config.seed}"
    total, done = settings.epochs * run.steps, history.epoch * run.steps
    shown = bar(progress and writes, total=total, initial=done, desc=title, unit="step")
    begun = time.perf_counter() - history.seconds  # what came before a resume counts
    run.model.train()

    while history.epoch < settings.epochs and not history.exhausted(settings.patience, settings.select_by):
        means = _train_epoch(run, history.epoch, folder, shown)
        history.epoch += 1
        if history.epoch % settings.validate_every and history.epoch < settings.epochs:
            continue  # the last epoch is validated whatever its number
        _check_weights(run, history.epoch * run.steps, folder)  # no broken weights among the best
        # Labels are used for the choice of weights only where the recipe says so (section 4.1). Accuracy by least
        # squares goes up and down with the rotation where predictions have two modes, and would choose by chance: so
        # the best weights by a robust alignment are kept as well.
        rules = ("accuracy", "robust") if settings.select_by == "accuracy" else (settings.select_by,)
        scores = distributed.first(lambda: validate(run.model, run.validation, settings, run.device, run.backgrounds))
        history.seconds = time.perf_counter() - begun
        history.add(run.model, history.epoch * run.steps, rules, scores, means)
        shown.set_postfix(loss=f"{history.log[-1]['loss']:.4f}", acc=f"{scores['accuracy']:.0f}%", refresh=False)
        if writes:
            write(run.model, run.optimisers, history, folder)  # an interrupted run goes on from the last validation
        if board is not None:
            for name, value in history.log[-1].items():
                board.add_scalar(name, value, history.log[-1]["step"])
            board.flush()
    shown.close()
    distributed.first(lambda: keep_best(config, history, folder))  # only now: a checkpoint means finished


@dataclass
class _Training:
    """What a run is trained with."""

    config: RunConfig
    device: torch.device
    training: Views
    validation: Views
    backgrounds: Tensor | None  # (K, 3, 2S, 2S) uint8
    model: ViewNet
    perceptual: PerceptualLoss | None
    optimisers: list[torch.optim.Optimizer]
    steps: int  # an epoch: as many targets as there are views


def _set_up(config: RunConfig, views: ViewStore) -> _Training:
    settings, device = config.train, torch.device("cuda" if torch.cuda.is_available() else "cpu")
    size, held_out = max(config.model.input_size, config.model.render_size), "val"
    if settings.select_by == "accuracy":
        views.require_viewpoints(["val"], "train with select_by='reconstruction', which needs none")
    elif not (views.index["split"] == "val").any():
        held_out = "train"  # without labels any views will do
    training, validation = (model_views(views, split, size, config.model) for split in ("train", held_out))
    backgrounds = augment.load(config.data, config.model.input_size, device)
    torch.manual_seed(config.seed)  # the seed alone decides the initial weights
    model = ViewNet(config.model).to(device)
    if settings.start is not None:
        model.load_state_dict(starting_weights(settings.start, config.model))
    perceptual = None if settings.perceptual == "none" else PerceptualLoss(settings.perceptual).to(device)
    distributed.together(model)  # one set of weights, batch statistics of all
    steps = max(1, len(training.objects) // settings.batch_size)  # no last, smaller batch
    optimisers = make_optimisers(model, settings)
    return _Training(config, device, training, validation, backgrounds, model, perceptual, optimisers, steps)


def _train_epoch(run: _Training, epoch: int, folder: Path, shown: Any) -> dict[str, float]:
    """One epoch; the means of the loss's terms. ViewnetError for a loss that is not finite."""
    config, settings, size = run.config, run.config.train, run.config.model.input_size
    sums: dict[str, float] = {}
    for step in range(epoch * run.steps, (epoch + 1) * run.steps):
        progress = step / (settings.epochs * run.steps)
        set_learning_rates(run.optimisers, settings.optimiser, progress)  # by progress alone: nothing to resume
        rows = sample_pairs(run.training, settings.objects, settings.targets_per_object, config.seed, step)
        appearance_rows, target_rows = map(distributed.share, rows)  # this process's part
        batch = run.training.batch(appearance_rows, target_rows, size, run.device)
        # Every process draws for the whole batch and takes its rows: the numbers do not depend on how many there are.
        generator = RankGenerator(step_generator(config.seed, step), distributed.rank(), distributed.size())
        terms = step_loss(run.model, batch, settings, run.perceptual, progress, generator, run.backgrounds)
        for name, value in descend(run.model, run.optimisers, terms, step, folder).items():
            sums[name] = sums.get(name, 0.0) + value
        shown.update()
    return {name: value / run.steps for name, value in sums.items()}


def _check_weights(run: _Training, step: int, folder: Path) -> None:
    """ViewnetError for weights that the last step, whose loss was finite, has made infinite."""
    broken = [name for name, value in run.model.state_dict().items() if not value.isfinite().all()]
    if broken:
        names = ", ".join(broken[:3])
        raise ViewnetError(f"{folder}: the weights are not finite after step {step} ({names}): lower the learning rate")
