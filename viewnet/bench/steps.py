"""`viewnet bench --steps`: where a training step's time goes, part by part, beside the least time each part needs.

The step is training's, on built-in models by any profile, recipe and variant. Untrained networks have volumes unlike
those of a training, and rendering takes as long as volumes are full: the occupancy of a car that comes with the package
stands in the place of the shape prior, and learning rates are 0, so that it stays.
"""

import math
import os
import re
import statistics
from collections import Counter
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from typing import Any
from unittest import mock

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd import DeviceType  # type: ignore[attr-defined]
from torch.autograd.profiler import record_function
from torch.nn.modules.module import register_module_forward_hook
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from viewnet import reference
from viewnet.bench.contestants import camera_frames
from viewnet.bench.measure import Row, Settings, recorded
from viewnet.bench.roofline import COUNTED, Need, Rates, lit_samples, network_need, render_need, seconds
from viewnet.config import RunConfig
from viewnet.data import augment, build
from viewnet.data.pairs import model_views, sample_pairs, step_generator
from viewnet.estimator import pretrained
from viewnet.model.losses import PerceptualLoss
from viewnet.model.viewnet import ViewNet
from viewnet.model.volume import halved
from viewnet.recipes import make_config
from viewnet.runtime import memory, torchvision_weights
from viewnet.runtime.progress import bar
from viewnet.training.matting import SECTORS, PoseSearch
from viewnet.training.optimisers import descend, make_optimisers
from viewnet.training.step import step_loss

IMAGES, CHOICE = "reading images", "choice of viewpoints"
"""Names that this module records around its own code, and around that of training."""
PERCEPTUAL, BEGINS, ENDS = "perceptual term", "backward of the perceptual term begins", "and ends"
COMPARING, FORWARD, BACKWARD = "comparing viewpoints, no gradient", "rendering, forward", "rendering, backward"
OPTIMISERS, SQUASH, NORMS, LAYERS = "optimisers", "squash", "normalisation, ReLU", "convolutions, products"
PARTS: dict[str, str] = {
    COMPARING: rf"^{CHOICE} > .*(_Render|_Rotate|[Cc]ompare)",
    "the rest of the choice": rf"^{CHOICE}",
    IMAGES: rf"^{IMAGES}",
    PERCEPTUAL: rf"^{PERCEPTUAL}",
    OPTIMISERS: r"^Optimizer\.",
    BACKWARD: r"_(Render|Rotate)Backward",
    FORWARD: r"_(Render|Rotate)\b",
    SQUASH: r"_Squash|_Clamp",
    NORMS: r"_NormReLU|(batch|instance)_norm|(Batch|Instance)NormBackward|[Rr]elu|threshold_backward",
    LAYERS: r"[Cc]onv(olution|_transpose|[23]d)|aten::(linear|matmul|mm|bmm|addmm|baddbmm)\b|(Mm|mm|Linear)Backward",
    "copies, fills": r"aten::(to|copy_|clone|contiguous|cat|stack|fill_|zeros?_?|zeros_like|ones_like)\b|CopyBackwards",
    "the rest, element-wise": "",
}
"""Part -> pattern. An event of the profiler belongs to the first part whose pattern is found in its path: the names of
the events around it and its own, outermost first, joined by " > ". To add a part, record a name
(torch.profiler.record_function, or a class of torch.autograd.Function) and put its pattern before the more general."""
WHOLE, BETWEEN, PROFILED = "whole step", "between operations", "whole step, profiled"
COLUMNS = (
    "profile", "recipe", "variant", "batch", "device", "phase", "part",
    "ms", "ms_low", "ms_high", "share", "calls", "floor_ms", "over_floor",
)  # fmt: skip
"""Milliseconds a step, median, least and most of the windows; the share of the profiled step; calls a step."""
MODELS = 96
"""Built-in models whose views are the batches."""
PHASES = {"search": 0.5, "after": 2.0}
"""Progress at which a step is measured, in units of the share of training in which viewpoints are searched."""


def configuration(profile: str, recipe: str | None, variant: str, batch: int | None) -> RunConfig:
    """A configuration to measure."""
    changes: dict[str, Any] = {"models": MODELS} | ({"batch_size": batch} if batch else {})
    return make_config(variant, "car", profile, recipe, **changes)


def measure(configs: list[RunConfig], settings: Settings, progress: bool = True) -> dict[str, Any]:
    """Everything, as `steps.json` has it: settings, machine, and rows with the columns COLUMNS."""
    os.environ.setdefault("KINETO_LOG_LEVEL", "99")  # the profiler tells of GPUs that are not there
    memory.keep_freed()  # as training does
    perceptual: dict[str, str] = {}

    def measured(device: torch.device, rates: Rates) -> list[Row]:
        rows = []
        for config in bar(progress, iterable=configs, unit="profile"):
            step = Step(config, device)
            perceptual[config.profile] = step.told
            share = config.train.search.share
            for phase, units in PHASES.items() if share else [("all", 0.0)]:
                rows += _rows(step, phase, units * share or 0.5, settings, rates)
        return rows

    told = {"repeat": settings.repeat, "quick": settings.quick, "models": MODELS, "perceptual": perceptual}
    return recorded(settings, told, measured)


class Step:
    """The training step of a configuration, ready to be called at any progress of training.

    Without the weights of its perceptual term, pixels take the term's place; `told` says so.
    """

    def __init__(self, config: RunConfig, device: torch.device):
        network = config.train.perceptual
        self.perceptual: PerceptualLoss | None = None
        self.told: str = network
        if network != "none" and torchvision_weights.available(network):
            self.perceptual = PerceptualLoss(network).to(device)
        elif network != "none":
            self.told = f"pixels, as there are no weights of {network}"
            config = replace(config, train=replace(config.train, perceptual="none", pixel_weight=1.0))
        self.config, self.device, self.number = config, device, 0
        side = max(config.model.input_size, config.model.render_size)
        self.views = model_views(build.view_store(config.data, progress=False), "train", side, config.model)
        self.backgrounds = augment.load(config.data, config.model.input_size, device)
        torch.manual_seed(config.seed)
        self.model = ViewNet(config.model)
        if config.model.decoder != "hologan":
            self._fill()
        self.model.to(device).train()
        self.optimisers = make_optimisers(self.model, config.train)
        for group in (group for optimiser in self.optimisers for group in optimiser.param_groups):
            group["lr"] = 0.0  # the same work, and volumes stay as they are

    @torch.no_grad()
    def _fill(self) -> None:
        """Gives all volumes the occupancy of a trained car, to which the generator adds nothing."""
        trained = pretrained.load("car").network.cpu().eval()
        _, volume = trained.encode(self.views.images(torch.tensor([0]), trained.config.input_size, torch.device("cpu")))
        side = self.config.model.volume_size
        occupancy = F.interpolate(volume[:, 3:].float(), (side,) * 3)[0, 0]  # (n, n, n), the nearest: as full as it was
        self.model.prior = torch.where(occupancy > 0, occupancy, -1.0)
        self.model.config = replace(self.config.model, shape_prior=True)
        last: Any = self.model.decoder.last
        for values in (last.weight[:, 3], last.bias[3]):  # of the occupancy
            values.zero_()

    def __call__(self, progress: float) -> None:
        config, settings, size = self.config, self.config.train, self.config.model.input_size
        with record_function(IMAGES):
            rows = sample_pairs(self.views, settings.objects, settings.targets_per_object, config.seed, self.number)
            batch = self.views.batch(*rows, size, self.device)
        generator = step_generator(config.seed, self.number)
        terms = step_loss(self.model, batch, settings, self.perceptual, progress, generator, self.backgrounds)
        descend(self.model, self.optimisers, terms, self.number, "step")
        self.number += 1


def _rows(step: Step, phase: str, progress: float, settings: Settings, rates: Rates) -> list[Row]:
    """A row for each of PARTS, between those of the whole step, without and with the profiler."""
    config, device, call = step.config, step.device, partial(step, progress)
    activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if device.type == "cuda" else [])]
    call()  # memory and kernels
    times = 1 if settings.quick else max(1, math.ceil(0.5 / seconds(call, device)))
    found: dict[str, list[float]] = {name: [] for name in (WHOLE, *PARTS, BETWEEN, PROFILED)}
    calls: Counter[str] = Counter()
    for _ in range(settings.repeat):
        found[WHOLE].append(seconds(call, device, times))
        with named_choice(), named_perceptual(), profile(activities=activities, acc_events=True) as profiler:
            found[PROFILED].append(seconds(call, device, times))
        spent, counted = attribute(profiler.events(), device.type == "cuda")
        calls += counted
        for part in PARTS:
            found[part].append(spent[part] / times)
        found[BETWEEN].append(found[PROFILED][-1] - sum(found[part][-1] for part in PARTS))
    floors = {part: need.seconds(rates) for part, need in needs(step, progress).items()}
    floors[WHOLE] = sum(floors.values())
    whole = statistics.median(found[PROFILED])
    rows = []
    for part, values in found.items():
        if part in PARTS and not calls[part]:
            continue
        middle, floor = statistics.median(values), floors.get(part)
        row: Row = {"profile": config.profile, "recipe": config.recipe, "variant": config.variant}
        row |= {"batch": config.train.batch_size, "device": device.type, "phase": phase, "part": part}
        row |= {"ms": 1000 * middle, "ms_low": 1000 * min(values), "ms_high": 1000 * max(values)}
        row |= {"share": None if part == WHOLE else middle / whole}
        row |= {"calls": calls[part] / (times * settings.repeat) if part in PARTS else None}
        row |= {"floor_ms": 1000 * floor if floor else None, "over_floor": middle / floor if floor else None}
        rows.append(row)
    return rows


def named_choice() -> AbstractContextManager[Any]:
    """Records the choice of viewpoints as CHOICE: what is rendered in it has no gradient."""
    return mock.patch.object(PoseSearch, "__call__", record_function(CHOICE)(PoseSearch.__call__))


def named_perceptual() -> AbstractContextManager[Any]:
    """Records the perceptual term as PERCEPTUAL, and when its backward pass begins and ends."""
    call = record_function(PERCEPTUAL)(PerceptualLoss.forward)

    def marked(self: PerceptualLoss, image: Tensor, target: Tensor) -> Tensor:
        loss = call(self, image, target)
        loss.register_hook(record_function(BEGINS)(lambda gradient: None))
        image.register_hook(record_function(ENDS)(lambda gradient: None))
        return loss

    return mock.patch.object(PerceptualLoss, "forward", marked)


def attribute(events: Any, on_gpu: bool = False) -> tuple[dict[str, float], "Counter[str]"]:
    """Seconds of each of PARTS by the profiler's events, and its calls: events of a part in none of the same part.

    Every event counts with its own time, without that of events within it; on a GPU with its kernels'.
    """
    spent, calls = dict.fromkeys(PARTS, 0.0), Counter[str]()
    known: dict[int, tuple[str, str]] = {}
    begun, ended = ([event.time_range.start for event in events if event.name == name] for name in (BEGINS, ENDS))

    def place(event: Any) -> tuple[str, str]:
        """Path and part. Backward, nothing else is between the perceptual term's beginning and its end."""
        if event is None:
            return "", ""
        if id(event) not in known:
            above = place(event.cpu_parent)[0]
            if not above and any(a <= event.time_range.start < b for a, b in zip(begun, ended, strict=True)):
                above = PERCEPTUAL
            path = f"{above} > {event.name}" if above else str(event.name)
            known[id(event)] = path, next(part for part, pattern in PARTS.items() if re.search(pattern, path))
        return known[id(event)]

    for event in events:
        if event.device_type != DeviceType.CPU:
            continue  # a kernel: its time is its operation's
        part = place(event)[1]
        spent[part] += (event.self_device_time_total if on_gpu else event.self_cpu_time_total) / 1e6
        calls[part] += part != place(event.cpu_parent)[1]
    return spent, calls


def compared(config: RunConfig, progress: float) -> tuple[int, int]:
    """Viewpoints that are compared for each target: at the full resolution, and at half of it."""
    heads, settings = config.model.heads, config.train
    full, half = heads, 0
    coarse = config.model.render_size > 16 and config.model.decoder != "hologan"
    if settings.comparison.neighbours:
        full, half = (heads if heads > 1 else 0, 5 * heads) if coarse else (5 * heads, 0)
    if progress < settings.search.share:
        views = settings.search.views
        if coarse and views > SECTORS:
            full, half = full + SECTORS, half + math.ceil(views / SECTORS) * SECTORS
        else:
            full += views
    return full, half


def needs(step: Step, progress: float) -> dict[str, Need]:
    """The least amount of work of the parts that have one: the others are nothing that must be done."""
    config, model, settings = step.config, step.config.model, step.config.train
    objects, targets, size = settings.objects, settings.batch_size, model.render_size
    cycle = settings.cycle.on
    seen = targets * (settings.photo.views_per_target if step.backgrounds is not None else 1) + objects * cycle
    result = _networks(step, seen, objects) | {OPTIMISERS: _optimisers(step)}
    if step.perceptual is not None:
        network, images = step.perceptual, torch.zeros(targets, 3, size, size, device=step.device)
        three = network_need(lambda: network(images.clone().requires_grad_(), images), 0, 1.0)
        # Features of images and targets, and the images' gradients: three passes for an image, one for its target.
        result[PERCEPTUAL] = replace(three, layer_values=three.layer_values * 2 / 3)
    if model.decoder == "hologan":
        return result
    voxels, pixels = objects * model.volume_size**3, targets * size**2
    samples = _samples(step, size)
    full, half = compared(config, progress)
    # Errors are all that is needed of a comparison: targets are read, and no image is written.
    result[COMPARING] = render_need(full * targets * samples[0], voxels, pixels, False)
    if half:
        result[COMPARING] += render_need(half * targets * samples[1], voxels // 8, pixels // 4, False)
    once, both = (render_need(targets * samples[0], voxels, pixels, backward) for backward in (False, True))
    result[FORWARD] = once
    if cycle:
        side = model.input_size
        result[FORWARD] += render_need(objects * _samples(step, side)[0], voxels, objects * side**2, False)
    result[BACKWARD] = Need(samples=both.samples - once.samples, values=both.values - once.values)
    result[SQUASH] = Need(values=5 * 4 * voxels)  # logits to volumes; backward, logits and gradients to gradients
    return result


def _networks(step: Step, seen: int, objects: int) -> dict[str, Need]:
    """Layers and normalisations: `seen` images by the viewpoint network, `objects` by the other two."""
    model, size = step.model, step.config.model.input_size
    normalised = 0

    def count(module: Any, inputs: Any, output: Tensor) -> None:
        nonlocal normalised
        if isinstance(module, COUNTED) and module.bias is None:  # a normalisation, which has the bias, comes next
            normalised += output.numel()

    def run() -> Tensor:
        images = torch.zeros(max(seen, objects), 4, size, size, device=step.device)
        hypotheses = model.viewpoint(model.composite(images[:seen]))
        return hypotheses.vectors.sum() + hypotheses.logits.sum() + model.encode(images[:objects])[1].sum()

    with register_module_forward_hook(count):
        layers = network_need(run, 0, 1.0)
    weights = sum(weight.numel() for weight in model.parameters())  # read twice, and their gradients written
    # Normalising reads and writes; backward it reads two and writes one.
    return {LAYERS: layers + Need(layer_values=3.0 * weights), NORMS: Need(layer_values=5.0 * normalised)}


def _optimisers(step: Step) -> Need:
    """Adam reads weight, gradient and two moments, writes all but the gradient; Muon has one moment, and products."""
    values = 0
    with FlopCounterMode(display=False) as counter:
        for optimiser in step.optimisers:
            optimiser.step()
            count = sum(weight.numel() for group in optimiser.param_groups for weight in group["params"])
            values += (7 if isinstance(optimiser, torch.optim.Adam) else 5) * count
    return Need(products=counter.get_total_flops() / 2, values=values)


@torch.no_grad()
def _samples(step: Step, size: int) -> tuple[float, float]:
    """Occupied and lit ray samples of an image of `size` pixels, and of one at half the resolution of both."""
    rows = sample_pairs(step.views, 4, 1, step.config.seed, 0)[0]
    _, volumes = step.model.encode(step.views.images(rows, step.config.model.input_size, step.device))
    frames, focal = camera_frames(4 * len(volumes)).to(step.device), step.model.focal
    found = []
    for volume, side in ((volumes.float(), size), (halved(volumes.float()), size // 2)):
        rotated = reference.rotate(volume.repeat_interleave(4, 0), frames, focal, side, side)
        found.append(lit_samples(rotated) / len(frames))
    return found[0], found[1]
