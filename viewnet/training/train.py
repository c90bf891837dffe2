"""Training, top to bottom. To resume, call it again: every step is a function of (seed, step) and the saved state.

step        reconstruct target views from another view's appearance and the best of M viewpoint hypotheses
validation  reconstruction error without labels, and accuracy with them; either may pick the kept weights
files       log.csv (a row a validation), state.pt (to resume), checkpoint.safetensors (the best weights; last)

Under torchrun all processes train one run (viewnet.runtime.distributed); the first one validates and writes.
"""

from __future__ import annotations

import csv
import json
import math
import os
import time
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor

from viewnet.config import RunConfig, TrainConfig
from viewnet.data import augment
from viewnet.data.pairs import Views, draw_pairs, step_generator, viewed
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import fit_rotation
from viewnet.geometry import look_at, rotation_angle, view_vector
from viewnet.model import checkpoint
from viewnet.model.kernels import volume_cpu
from viewnet.model.losses import PerceptualLoss
from viewnet.model.precision import half_precision
from viewnet.model.viewnet import ViewNet
from viewnet.runtime import distributed
from viewnet.runtime.files import replacing
from viewnet.runtime.progress import bar
from viewnet.runtime.random import RankGenerator
from viewnet.training.muon import Muon
from viewnet.training.step import reconstruct, step_loss

VALIDATION_VIEWS = 320
"""Validation uses at most so many target views, those of the first models: enough to rank epochs."""


@torch.no_grad()
def validate(
    model: ViewNet, views: Views, config: TrainConfig, device: torch.device, scenery: Tensor | None = None
) -> dict[str, float]:
    """Reconstruction error of the best head (label-free) and true acc@30 in percent after Procrustes (uses labels).

    Accuracy is that of the views with an annotated viewpoint, NaN where there are none. Each view is drawn from the
    appearance of the next view of its object. With `scenery`, images (K, 3, S, S) uint8, views are before it as in
    training, the same each time.
    """
    model.eval()
    rows = torch.arange(min(VALIDATION_VIEWS, len(views.objects)))
    others = views.partners(rows)
    error, vectors = 0.0, []
    generator = torch.Generator().manual_seed(0)
    size = model.config.input_size
    for part in rows.split(64):
        appearance, target = views.images(others[part], size, device), views.images(rows[part], size, device)
        seen, behind = views.seen(rows[part], size, device), None
        if scenery is not None:
            seen = augment.photograph(seen, scenery, config, generator)
            behind = augment.behind(scenery, len(part), size, generator, device)
        found = reconstruct(model, appearance, target, seen, config, behind=behind)
        error += found.errors.amin(1).sum().item()
        vectors.append(found.hypotheses.pick(found.hypotheses.logits.argmax(1)))
    predicted = torch.cat(vectors).cpu().double()
    annotated = ~views.truth[rows].isnan().any(1)
    accuracy = math.nan
    if annotated.any():
        predicted, truth = predicted[annotated], view_vector(*views.truth[rows][annotated].double().unbind(1))
        aligned = predicted @ torch.as_tensor(fit_rotation(predicted.numpy(), truth.numpy())).T
        accuracy = 100 * (rotation_angle(look_at(aligned), look_at(truth)) < 30).double().mean().item()
    model.train()
    return {"reconstruction": error / len(rows), "accuracy": accuracy}


def train(
    config: RunConfig, views: ViewStore, folder: Path, *, threads: int | None = None, progress: bool = True
) -> None:
    """Trains one run in `folder`, from where it was if it was begun before.

    Where no labels are asked for and there is no validation split, the training split serves. Raises ViewnetError for
    data that cannot be trained on, such as views without viewpoints where accuracy picks the weights, for missing
    perceptual weights, weights to start from of another network, a batch that the processes cannot share, or a loss
    or weights that are not finite (the last good state is kept).
    """
    # ---- set up
    distributed.start()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if threads:
        torch.set_num_threads(threads)
    settings = config.train
    objects, processes = settings.objects, distributed.size()
    if objects % processes:
        raise ViewnetError(
            f"batch_size {settings.batch_size} with targets_per_object {settings.targets_per_object} is {objects} "
            f"objects a step, which {processes} processes cannot share: choose a multiple"
        )
    writes = distributed.rank() == 0
    if writes:
        folder.mkdir(parents=True, exist_ok=True)
    if distributed.first((folder / "checkpoint.safetensors").exists):
        return
    volume_cpu.warm_up()
    size = max(config.model.input_size, config.model.render_size)
    held_out = "val"
    if settings.select_by == "accuracy":
        views.require_viewpoints(["val"], "train with select_by='reconstruction', which needs none")
    elif not (views.index["split"] == "val").any():
        held_out = "train"
    training, validation = (viewed(views, split, size, config.model) for split in ("train", held_out))
    scenery = augment.load(config.data, config.model.input_size, device)
    torch.manual_seed(config.seed)
    model = ViewNet(config.model).to(device)
    if settings.start is not None:
        model.load_state_dict(checkpoint.starting_weights(settings.start, config.model))
    weights = os.environ.get(f"VIEWNET_{settings.perceptual.upper()}_WEIGHTS")
    perceptual = None
    if settings.perceptual != "none":
        perceptual = PerceptualLoss(settings.perceptual, Path(weights) if weights else None).to(device)
    distributed.together(model)
    optimisers = make_optimisers(model, settings)
    steps = max(1, len(training.objects) // settings.batch_size)  # an epoch: as many targets as there are views
    total = settings.epochs * steps

    # ---- go on where it was
    log: list[dict[str, Any]] = []
    best: dict[str, Any] = {"score": -math.inf, "epoch": -1, "weights": None}
    first, spent = 0, 0.0
    state = distributed.first(lambda: _state(folder))
    if state is not None:
        model.load_state_dict(state["model"])
        for optimiser, saved in zip(optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(saved)
        log, best, first, spent = state["log"], state["best"], state["epoch"], state["seconds"]

    # ---- epochs
    begun = time.perf_counter()
    shown = bar(progress and writes, total=total, initial=first * steps, desc=_title(config), unit="step")
    model.train()
    board = _board(folder) if writes else None
    for epoch in range(first, settings.epochs):
        if log and log[-1]["epoch"] - 1 - best["epoch"] >= settings.patience:
            break
        sums: dict[str, float] = {}
        for step in range(epoch * steps, (epoch + 1) * steps):
            done = step / total
            for optimiser in optimisers:
                for group in optimiser.param_groups:
                    group["lr"] = group["initial_lr"] * _schedule(settings, done)
            appearance_rows, target_rows = draw_pairs(training, objects, settings.targets_per_object, config.seed, step)
            appearance_rows, target_rows = distributed.share(appearance_rows), distributed.share(target_rows)
            batch = (
                training.images(appearance_rows, config.model.input_size, device),
                training.images(target_rows, config.model.input_size, device),
                training.seen(target_rows, config.model.input_size, device),
            )
            generator = RankGenerator(step_generator(config.seed, step), distributed.rank(), processes)
            terms = step_loss(model, batch, settings, perceptual, done, generator, scenery)
            values = torch.stack(list(terms.values()))
            told = dict(zip(terms, distributed.mean(values.detach()).tolist(), strict=True))
            if not math.isfinite(sum(told.values())):
                names = ", ".join(f"{name} {value:.3g}" for name, value in told.items())
                raise ViewnetError(
                    f"{folder}: the loss is not finite at step {step} ({names}): lower the learning rate"
                )
            model.zero_grad(set_to_none=True)
            values.sum().backward()
            distributed.average_gradients(model.parameters())
            for optimiser in optimisers:
                optimiser.step()
            for name, value in told.items():
                sums[name] = sums.get(name, 0.0) + value
            shown.update()
        last = epoch + 1 == settings.epochs
        if (epoch + 1) % settings.validate_every and not last:
            continue
        broken = [name for name, value in model.state_dict().items() if not value.isfinite().all()]
        if broken:  # by the last step, whose loss was not
            step, names = (epoch + 1) * steps, ", ".join(broken[:3])
            raise ViewnetError(
                f"{folder}: the weights are not finite after step {step} ({names}): lower the learning rate"
            )

        # ---- validation: labels are used for the choice only where the recipe says so (section 4.1)
        found = distributed.first(lambda: validate(model, validation, settings, device, scenery))
        score = found["accuracy"] if settings.select_by == "accuracy" else -found["reconstruction"]
        if score > best["score"] or best["weights"] is None:
            kept = {
                name: value.detach().cpu().clone(memory_format=torch.contiguous_format)
                for name, value in model.state_dict().items()
            }
            best = {"score": score, "epoch": epoch, "weights": kept}
        means = {name: value / steps for name, value in sums.items()}
        seconds = spent + time.perf_counter() - begun
        log.append(
            {"epoch": epoch + 1, "step": (epoch + 1) * steps, "seconds": round(seconds, 2)}
            | {"loss": sum(means.values())}
            | {f"val_{name}": value for name, value in found.items()}
            | means
        )
        shown.set_postfix(loss=f"{log[-1]['loss']:.4f}", acc=f"{found['accuracy']:.0f}%", refresh=False)
        if not writes:
            continue
        _write_log(folder / "log.csv", log)
        if board is not None:
            for name, value in log[-1].items():
                board.add_scalar(name, value, log[-1]["step"])
            board.flush()
        state = {"model": model.state_dict(), "optimisers": [optimiser.state_dict() for optimiser in optimisers]}
        state |= {"log": log, "best": best, "epoch": epoch + 1, "seconds": seconds}
        with replacing(folder / "state.pt") as temporary:
            torch.save(state, temporary)
    shown.close()

    # ---- keep the best
    distributed.first(lambda: _keep(config, best, folder))


def _state(folder: Path) -> dict[str, Any] | None:
    """What a run that was begun has got to."""
    if not (folder / "state.pt").exists():
        return None
    return torch.load(folder / "state.pt", map_location="cpu", weights_only=True)


def _keep(config: RunConfig, best: dict[str, Any], folder: Path) -> None:
    metadata = {"config": json.dumps(config.to_dict()), "epoch": str(best["epoch"] + 1), "score": repr(best["score"])}
    with replacing(folder / "checkpoint.safetensors") as temporary:
        save_file(best["weights"], temporary, metadata=metadata)
    (folder / "state.pt").unlink(missing_ok=True)


INNER_LAYERS = (torch.nn.Conv2d, torch.nn.ConvTranspose3d)


def make_optimisers(model: ViewNet, config: TrainConfig) -> list[torch.optim.Optimizer]:
    """Adam, and Muon for the inner convolutions of encoders and generator where the configuration wants it."""
    parts = (
        [*model.viewpoint.encoder, *model.appearance, *getattr(model.decoder, "stages", [])]
        if config.optimiser.muon
        else []
    )
    # Neither a first layer, which sees colours, nor any last one: those are no maps from features to features.
    matrices = [
        layer.weight
        for part in parts
        for layer in part.modules()
        if isinstance(layer, INNER_LAYERS) and layer.in_channels > 3 and layer.kernel_size[0] > 1
    ]
    taken = {id(weight) for weight in matrices}
    others = [weight for weight in model.parameters() if id(weight) not in taken]
    optimisers: list[torch.optim.Optimizer] = [
        torch.optim.Adam(others, lr=config.optimiser.learning_rate, betas=config.optimiser.betas, fused=True)
    ]
    if matrices:
        optimisers.append(Muon(matrices, config.optimiser.muon, half=half_precision(matrices[0].device, config)))
    for optimiser in optimisers:
        for group in optimiser.param_groups:
            group["initial_lr"] = group["lr"]
    return optimisers


def _board(folder: Path) -> Any:
    """A TensorBoard log in the run's folder where VIEWNET_TENSORBOARD is set, else None."""
    if not os.environ.get("VIEWNET_TENSORBOARD"):
        return None
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise ViewnetError(
            "VIEWNET_TENSORBOARD is set, but TensorBoard is not installed: pip install tensorboard, or unset it"
        ) from error
    return SummaryWriter(folder / "tensorboard")


def _schedule(config: TrainConfig, done: float) -> float:
    """The learning rate's factor when the share `done` of the training is behind."""
    if config.optimiser.schedule == "constant":
        return 1.0
    held = 0.6 if config.optimiser.schedule == "hold" else 0.0
    return 0.5 * (1 + math.cos(math.pi * max(0.0, done - held) / (1 - held)))


def _title(config: RunConfig) -> str:
    return f"{config.variant} {config.category} seed {config.seed}"


def _write_log(path: Path, rows: list[dict[str, Any]]) -> None:
    names = list(dict.fromkeys(name for row in rows for name in row))
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
