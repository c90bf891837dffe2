"""Training, top to bottom. To resume, call it again: every step is a function of (seed, step) and the saved state.

    step        reconstruct target views from another view's appearance and the best of M viewpoint hypotheses
    validation  reconstruction error without labels, and accuracy with them; either may pick the kept weights
    files       log.csv (a row a validation), state.pt (to resume), checkpoint.safetensors (the best weights; last)
"""

from __future__ import annotations

import csv
import json
import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from safetensors.torch import save_file
from torch import Tensor
from tqdm import tqdm

from viewnet.alignment import fit_rotation
from viewnet.config import RunConfig, TrainConfig
from viewnet.data.pairs import Views, draw_pairs, load_views, resize, step_generator, tight_crop
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.geometry import look_at, rotation_angle, view_vector
from viewnet.losses import PerceptualLoss, composite, cycle_loss, head_errors, pixel_loss
from viewnet.model import Hypotheses, ViewNet

VALIDATION_VIEWS = 320
"""Validation uses at most so many target views, those of the first models: enough to rank epochs."""


@dataclass
class Reconstruction:
    """One pass over target views: what was said of them and how they were drawn."""

    hypotheses: Hypotheses
    errors: Tensor  # (N, M) of each head
    best: Tensor  # (N,) the head with the least
    picture: Tensor  # (N, 3 or 1, S, S) of the best head, over the background
    target: Tensor  # the same of the target view
    shape: Tensor
    appearance: Tensor


def reconstruct(
    model: ViewNet,
    appearance: Tensor,
    target: Tensor,
    seen: Tensor,
    config: TrainConfig,
    colour: Tensor,
    size: int | None = None,
) -> Reconstruction:
    """Draws targets (N, 4, s, s) from appearance views (B, 4, s, s), N = B K, over colours (N, 3) (equations 1 and 2).

    All heads are compared without gradients; only the best is drawn with them ("gradients will only be propagated
    through m*"). `seen` (N, 4, s, s) is what the viewpoint network sees of the targets: themselves, or cut and augmented.
    `size` is the drawings' side in pixels (default: the configuration's).
    """
    size, heads = size or model.config.render_size, model.config.heads
    with autocast(appearance.device, config):
        code = model.appearance(model.see(appearance))
        shape = model.shape(code, coarse=size < model.config.render_size)
        hypotheses = model.viewpoint(model.see(seen))
    wanted = _over(target if target.shape[-1] == size else resize(target, size), config, colour)
    frames = hypotheses.frames
    if heads > 1:
        with torch.no_grad(), autocast(appearance.device, config):
            drawn = model.draw(shape, code, frames.flatten(0, 1), size)
            drawn = _over(drawn, config, colour.repeat_interleave(heads, 0)).unflatten(0, (-1, heads))
            errors = head_errors(drawn, wanted)
        best = errors.argmin(1)
    else:
        best = torch.zeros(len(target), dtype=torch.long, device=target.device)
    with autocast(appearance.device, config):
        picture = _over(model.draw(shape, code, frames[torch.arange(len(best)), best], size), config, colour)
    if heads == 1:
        errors = head_errors(picture.detach()[:, None], wanted)
    return Reconstruction(hypotheses, errors, best, picture, wanted, shape, code)


def _over(picture: Tensor, config: TrainConfig, colour: Tensor) -> Tensor:
    return picture[:, 3:] if config.target == "mask" else composite(picture, colour)


def backgrounds(config: TrainConfig, count: int, generator: torch.Generator, device: torch.device) -> Tensor:
    """Colours (count, 3) behind target and reconstruction: black as printed, or one random colour a sample."""
    if config.background == "black":
        return torch.zeros(count, 3, device=device)
    return torch.rand(count, 3, generator=generator).to(device)


def autocast(device: torch.device, config: TrainConfig) -> torch.autocast:
    """bfloat16 for convolutions where the hardware computes in it, plain float32 elsewhere."""
    if device.type == "cuda":
        able = torch.cuda.is_bf16_supported()
    else:
        able = bool(torch.cpu._is_amx_tile_supported())
    return torch.autocast(device.type, torch.bfloat16, enabled=able and config.amp == "auto")


def augment(pictures: Tensor, generator: torch.Generator) -> Tensor:
    """Random crops of 80 to 100 % of the area and rotations within 3 degrees of pictures (N, C, S, S)."""
    count = len(pictures)
    scale = (0.8 + 0.2 * torch.rand(count, generator=generator)).sqrt()
    shift = (2 * torch.rand(count, 2, generator=generator) - 1) * (1 - scale)[:, None]
    angle = torch.deg2rad(6 * torch.rand(count, generator=generator) - 3)
    rows = [
        torch.stack([scale * angle.cos(), -scale * angle.sin(), shift[:, 0]], 1),
        torch.stack([scale * angle.sin(), scale * angle.cos(), shift[:, 1]], 1),
    ]
    grid = F.affine_grid(torch.stack(rows, 1).to(pictures), list(pictures.shape), align_corners=False)
    return F.grid_sample(pictures, grid, align_corners=False)


def step_loss(
    model: ViewNet,
    batch: tuple[Tensor, Tensor, Tensor],
    config: TrainConfig,
    perceptual: PerceptualLoss | None,
    progress: float,
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """The terms of one step's loss, weighted; their sum is minimised. `progress` is the share of training done."""
    appearance, target, seen = batch
    device = appearance.device
    colour = backgrounds(config, len(target), generator, device)
    seen = augment(seen, generator) if config.augment else seen
    # The HoloGAN decoder's layers paint one size only.
    coarse = progress < config.coarse and model.config.decoder != "hologan"
    size = model.config.render_size // 2 if coarse else model.config.render_size
    found = reconstruct(model, appearance, target, seen, config, colour, size)
    terms: dict[str, Tensor] = {}
    if perceptual is not None:
        channels = (found.picture.expand(-1, 3, -1, -1), found.target.expand(-1, 3, -1, -1))
        terms["perceptual"] = perceptual(*channels)
    if config.pixel_weight:
        terms["pixels"] = config.pixel_weight * pixel_loss(found.picture, found.target)
    if model.config.heads > 1:
        terms["selection"] = config.selection_weight * F.cross_entropy(found.hypotheses.logits, found.best)
    ramp = min(1.0, (progress - config.cycle_start) / 0.1) if config.cycle_start else 1.0
    if config.cycle_weight and ramp > 0:
        terms["cycle"] = ramp * config.cycle_weight * _cycle(model, found, config, generator)
    return terms


def _cycle(model: ViewNet, found: Reconstruction, config: TrainConfig, generator: torch.Generator) -> Tensor:
    """Section 3.4: new views of the same objects at random viewpoints, and what the viewpoint network says of them."""
    count = len(found.appearance)
    low, high = config.cycle_elevation
    azimuth = 360 * torch.rand(count, generator=generator)
    elevation = low + (high - low) * torch.rand(count, generator=generator)
    truth = view_vector(azimuth, elevation).to(found.appearance.device)
    with torch.no_grad(), autocast(truth.device, config):
        novel = model.draw(found.shape, found.appearance, look_at(truth), model.config.input_size)
        if model.config.crop:
            novel = tight_crop(novel, model.config.input_size)
    with autocast(truth.device, config):
        return cycle_loss(model.viewpoint(model.see(novel)), truth, config)


@torch.no_grad()
def validate(model: ViewNet, views: Views, config: TrainConfig, device: torch.device) -> dict[str, float]:
    """Reconstruction error of the best head (label-free) and true acc@30 in percent after Procrustes (uses labels).

    Each view is drawn from the appearance of the next view of its object, over mid-grey.
    """
    model.eval()
    rows = torch.arange(min(VALIDATION_VIEWS, len(views.objects)))
    others = views.first[views.objects[rows]] + (rows - views.first[views.objects[rows]] + 1) % views.count[
        views.objects[rows]
    ]
    error, vectors = 0.0, []
    size = model.config.input_size
    for part in rows.split(64):
        appearance, target = views.pictures(others[part], size, device), views.pictures(rows[part], size, device)
        grey = torch.full((len(part), 3), 0.5, device=device)
        found = reconstruct(model, appearance, target, views.seen(rows[part], size, device), config, grey)
        error += found.errors.amin(1).sum().item()
        vectors.append(found.hypotheses.pick(found.hypotheses.logits.argmax(1)))
    predicted = torch.cat(vectors).cpu().double()
    truth = view_vector(*views.truth[rows].double().unbind(1))
    aligned = predicted @ torch.as_tensor(fit_rotation(predicted.numpy(), truth.numpy())).T
    accuracy = 100 * (rotation_angle(look_at(aligned), look_at(truth)) < 30).double().mean().item()
    model.train()
    return {"reconstruction": error / len(rows), "accuracy": accuracy}


def train(
    config: RunConfig, views: ViewStore, folder: Path, *, threads: int | None = None, progress: bool = True
) -> None:
    """Trains one run in `folder`, from where it was if it was begun before.

    Raises ViewnetError for data that cannot be trained on, missing perceptual weights, or a loss that is not finite
    (the last good state is kept).
    """
    # ---- set up
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if threads:
        torch.set_num_threads(threads)
    settings = config.train
    if settings.batch_size % settings.targets_per_object:
        raise ViewnetError(
            f"batch_size {settings.batch_size} is no multiple of targets_per_object {settings.targets_per_object}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / "checkpoint.safetensors").exists():
        return
    size = max(config.model.input_size, config.model.render_size)
    crop = config.model.input_size if config.model.crop else None
    training, validation = load_views(views, "train", size, crop), load_views(views, "val", size, crop)
    torch.manual_seed(config.seed)
    model = ViewNet(config.model).to(device)
    weights = os.environ.get(f"VIEWNET_{settings.perceptual.upper()}_WEIGHTS")
    perceptual = None
    if settings.perceptual != "none":
        perceptual = PerceptualLoss(settings.perceptual, Path(weights) if weights else None).to(device)
    optimiser = torch.optim.Adam(_parameter_groups(model), lr=settings.learning_rate, betas=settings.betas)
    steps = max(1, len(training.objects) // settings.batch_size)  # an epoch: as many targets as there are views
    objects = settings.batch_size // settings.targets_per_object
    total = settings.epochs * steps

    # ---- go on where it was
    log: list[dict[str, Any]] = []
    best: dict[str, Any] = {"score": -math.inf, "epoch": -1, "weights": None}
    first, spent = 0, 0.0
    if (folder / "state.pt").exists():
        state = torch.load(folder / "state.pt", map_location=device, weights_only=True)
        model.load_state_dict(state["model"])
        optimiser.load_state_dict(state["optimiser"])
        log, best, first, spent = state["log"], state["best"], state["epoch"], state["seconds"]

    # ---- epochs
    begun = time.perf_counter()
    bar = tqdm(total=total, initial=first * steps, disable=None if progress else True, desc=_title(config), unit="step")
    model.train()
    for epoch in range(first, settings.epochs):
        sums: dict[str, float] = {}
        for step in range(epoch * steps, (epoch + 1) * steps):
            done = step / total
            for group in optimiser.param_groups:
                group["lr"] = settings.learning_rate * group["factor"] * _schedule(settings, done)
            appearance_rows, target_rows = draw_pairs(
                training, objects, settings.targets_per_object, config.seed, step
            )
            batch = (
                training.pictures(appearance_rows, config.model.input_size, device),
                training.pictures(target_rows, config.model.input_size, device),
                training.seen(target_rows, config.model.input_size, device),
            )
            terms = step_loss(model, batch, settings, perceptual, done, step_generator(config.seed, step))
            loss = torch.stack(list(terms.values())).sum()
            if not torch.isfinite(loss):
                names = ", ".join(f"{name} {value.item():.3g}" for name, value in terms.items())
                raise ViewnetError(f"{folder}: the loss is not finite at step {step} ({names}): lower the learning rate")
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
            for name, value in terms.items():
                sums[name] = sums.get(name, 0.0) + value.item()
            bar.update()
        last = epoch + 1 == settings.epochs
        if (epoch + 1) % settings.validate_every and not last:
            continue

        # ---- validation: labels are used for the choice only where the recipe says so (section 4.1)
        found = validate(model, validation, settings, device)
        score = found["accuracy"] if settings.select_by == "accuracy" else -found["reconstruction"]
        if score > best["score"]:
            kept = {name: value.detach().cpu().clone() for name, value in model.state_dict().items()}
            best = {"score": score, "epoch": epoch, "weights": kept}
        means = {name: value / steps for name, value in sums.items()}
        seconds = spent + time.perf_counter() - begun
        log.append(
            {"epoch": epoch + 1, "step": (epoch + 1) * steps, "seconds": round(seconds, 2)}
            | {"loss": sum(means.values())}
            | {f"val_{name}": value for name, value in found.items()}
            | means
        )
        bar.set_postfix(loss=f"{log[-1]['loss']:.4f}", acc=f"{found['accuracy']:.0f}%", refresh=False)
        _write_log(folder / "log.csv", log)
        state = {"model": model.state_dict(), "optimiser": optimiser.state_dict(), "log": log, "best": best}
        _replace(folder / "state.pt", lambda path: torch.save(state | {"epoch": epoch + 1, "seconds": seconds}, path))
        if epoch - best["epoch"] >= settings.patience:
            break
    bar.close()

    # ---- keep the best
    metadata = {"config": json.dumps(config.to_dict()), "epoch": str(best["epoch"] + 1), "score": repr(best["score"])}
    _replace(folder / "checkpoint.safetensors", lambda path: save_file(best["weights"], path, metadata=metadata))
    (folder / "state.pt").unlink(missing_ok=True)


def _parameter_groups(model: ViewNet) -> list[dict[str, Any]]:
    """The mean volume's voxels see few gradients each and learn faster than shared weights should."""
    template = [p for name, p in model.named_parameters() if name.endswith("template")]
    others = [p for name, p in model.named_parameters() if not name.endswith("template")]
    groups = [{"params": others, "factor": 1.0}, {"params": template, "factor": model.config.template}]
    return [group for group in groups if group["params"]]


def _schedule(config: TrainConfig, done: float) -> float:
    """The learning rate's factor when the share `done` of the training is behind."""
    if config.schedule == "constant":
        return 1.0
    return 0.5 * (1 + math.cos(math.pi * done))


def _title(config: RunConfig) -> str:
    return f"{config.variant} {config.category} seed {config.seed}"


def _write_log(path: Path, rows: list[dict[str, Any]]) -> None:
    names = list(dict.fromkeys(name for row in rows for name in row))
    def write(temporary: Path) -> None:
        with temporary.open("w", newline="") as file:
            writer = csv.DictWriter(file, names)
            writer.writeheader()
            writer.writerows(rows)

    _replace(path, write)


def _replace(path: Path, write: Any) -> None:
    """Writes beside `path` and renames: there is the old file or the new one, never a part."""
    temporary = path.with_name(f".{path.name}.partial")
    write(temporary)
    os.replace(temporary, path)
