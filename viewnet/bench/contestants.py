"""The contestants of `viewnet bench`, the package and viewnet.reference: their work, its time and its memory.

A contestant is a function without arguments that does the work once, on the same inputs as the other.
"""

import contextlib
import ctypes
import gc
import math
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from viewnet import reference
from viewnet.bench.roofline import seconds, synchronise
from viewnet.config import RunConfig
from viewnet.errors import ViewnetError
from viewnet.geometry import look_at, view_vector
from viewnet.model import volume
from viewnet.model.kernels import volume_cpu
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.training.optimisers import descend, make_optimisers
from viewnet.training.step import step_loss

FORWARD, BOTH = "renderer, forward", "renderer, forward + backward"
EXACT, STEP = "renderer, forward + backward (all voxels)", "training step"
VIEWS = 3
"""Images rendered of each volume: one for each head of the paper's viewpoint network."""
FOCAL = 0.4
Call = Callable[[], None]


@dataclass(frozen=True)
class Work:
    """The work of both contestants.

    kind        FORWARD; BOTH, as training does it (`sparse` of viewnet.model.volume.render); EXACT, without that; STEP
    occupancy   object: a car-like blob that fills a quarter of the cube, empty elsewhere;
                dense: every voxel is a little occupied, and a fifth of the light passes through all of them;
                initial (STEP only): the output of untrained networks, the Gaussian prior S included
    size        voxels along a side, and pixels of the image
    batch       volumes per call; target images per call in a STEP
    profile     STEP only: the profile of the networks
    memory      whether its memory is measured as well
    """

    kind: str
    occupancy: str
    size: int
    batch: int
    profile: str = ""
    memory: bool = False

    @property
    def images(self) -> int:
        """Images per call."""
        return self.batch if self.kind == STEP else VIEWS * self.batch


def superellipsoid(size: int) -> Tensor:
    """The distance of voxels (n, n, n) from the centre: 0 in the middle, 1 on the surface of a rounded box along x."""
    axis = (torch.arange(size) * 2 + 1) / size - 1
    z, y, x = torch.meshgrid(axis / 0.57, axis / 0.57, axis / 0.95, indexing="ij")
    return (x**4 + y**4 + z**4) ** 0.25


def logits(occupancy: str, size: int, count: int) -> Tensor:
    """Inputs of viewnet.model.volume.squash, (count, n, n, n, 1, 1, 1, 4), in different colours."""
    generator = torch.Generator().manual_seed(size)
    blocks = torch.randn(count, size, size, size, 1, 1, 1, 4, generator=generator)
    if occupancy == "object":
        blocks[..., 3] = (4 * (1 - superellipsoid(size)))[..., None, None, None]
    else:  # optical depth 1.5 along an axis; atanh undoes 2 sigmoid - 1
        little = (1.5 / size) * (0.5 + torch.rand(blocks.shape[:-1], generator=generator))
        blocks[..., 3] = 2 * torch.atanh(little.clamp(max=0.9))
    return blocks


def camera_frames(count: int) -> Tensor:
    """Camera frames (count, 3, 3) all around, elevations from -20 to 40 degrees."""
    azimuth, elevation = torch.rand(2, count, generator=torch.Generator().manual_seed(count))
    return look_at(view_vector(360 * azimuth, 60 * elevation - 20))


def images(count: int, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Three images (count, 4, size, size) each of blobs in different colours: appearance, target, viewpoint input."""
    shapes = volume.squash(logits("object", 16, count), None)
    with torch.no_grad():
        rendered = volume.render_reference(shapes, camera_frames(3 * count), torch.tensor(FOCAL), size, 16)
    appearance, target, inputs = rendered.unflatten(0, (count, 3)).unbind(1)
    return appearance, target, inputs


def step_config(profile: str) -> RunConfig:
    """The recipe `paper` at the size of a profile, without augmentation, other random numbers or VGG16's weights."""
    changes: dict[str, Any] = {"perceptual": "none", "pixel_weight": 1.0, "augment": False, "targets_per_object": 1}
    return make_config(profile=profile, recipe="paper", **changes)


def reference_name(name: str) -> str:
    """What viewnet.reference calls a weight of the package's network."""
    names = {"viewpoint.encoder.": "f_v.", "appearance.": "f_a.", "decoder.": "f_d.", ".norm.": "."}
    for ours, theirs in names.items():
        name = name.replace(ours, theirs)
    return name


def as_reference(model: ViewNet) -> reference.ViewNet:
    """The network of viewnet.reference with the weights of `model`."""
    net = reference.ViewNet(model.config)
    weights = {reference_name(name): value for name, value in model.state_dict().items()}
    code = weights["f_d.code"].view(-1, 1, 1, 1, 1)  # (Z, 1, 1, 1, 1)
    # The package learns W z of the first layer alone; any weights W that give it will do.
    weights["f_d.stages.0.convolution.weight"] = weights["f_d.stages.0.convolution.output"] * code / code.square().sum()
    net.load_state_dict({name: weights[name] for name in net.state_dict()})
    return net


def prepare(work: Work, contestant: str, device: torch.device) -> Call:
    """The function that does `work` once, by the "textbook" version, viewnet.reference, or by "viewnet"."""
    return (_step if work.kind == STEP else _renderer)(work, contestant == "textbook", device)


def _renderer(work: Work, by_textbook: bool, device: torch.device) -> Call:
    shape = volume.squash(logits(work.occupancy, work.size, work.batch).to(device), None)
    shape = shape.contiguous() if by_textbook else shape
    cameras, focal, size = camera_frames(work.images).to(device), torch.tensor(FOCAL, device=device), work.size
    weights = torch.randn(work.images, 4, size, size, generator=torch.Generator(device).manual_seed(0), device=device)

    def call() -> None:
        # New leaves each time, so that nothing cached of the last volume helps.
        leaves = (x.detach().requires_grad_(work.kind != FORWARD) for x in (shape, cameras, focal))
        inputs = next(leaves), next(leaves), next(leaves), size
        image = reference.render(*inputs, size) if by_textbook else volume.render(*inputs, sparse=work.kind != EXACT)
        if work.kind != FORWARD:
            image.backward(weights)

    return call


def _step(work: Work, by_textbook: bool, device: torch.device) -> Call:
    config = step_config(work.profile)
    settings = config.train
    torch.manual_seed(0)
    model = ViewNet(config.model)
    appearance, target, inputs = (part.to(device) for part in images(work.batch, config.model.input_size))
    batch = appearance, target, inputs
    if work.occupancy == "object":
        # In the place of S, so that the volumes of untrained networks are like those of trained ones.
        model.prior = torch.tanh(2 * (1 - superellipsoid(config.model.volume_size)))
    net: nn.Module
    optimisers: list[torch.optim.Optimizer]
    if by_textbook:
        net, rates = as_reference(model).to(device), settings.optimiser
        net.prior.copy_(model.prior)
        optimisers = [torch.optim.Adam(net.parameters(), rates.learning_rate, rates.betas)]
        losses = partial(reference.step_loss, net, batch, settings, None)
    else:
        net = model.to(device)
        optimisers = make_optimisers(model, settings)
        losses = partial(step_loss, model, batch, settings, None, 0.5)

    def call() -> None:
        descend(net, optimisers, losses(torch.Generator().manual_seed(0)), 0, "step")

    return call


def in_turn(calls: dict[str, Call], repeat: int, device: torch.device, least: float) -> dict[str, list[float]]:
    """Seconds per call, `repeat` measurements of each contestant of `least` seconds or more, after an untimed call.

    They alternate, A B B A A B ..., so that other load on the machine affects both.
    """
    times = {}
    for name, call in calls.items():
        first = seconds(call, device)
        if first < least:  # the first call includes compilation and caches
            first = seconds(call, device)
        times[name] = max(1, math.ceil(least / first))
    results: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(repeat):
        for name in list(calls)[:: -1 if turn % 2 else 1]:
            results[name].append(seconds(calls[name], device, times[name]))
    return results


def peak_memory(work: Work, contestant: str, device: torch.device, threads: int) -> int | None:
    """Peak bytes of two calls above the level before them, in a process of its own; None where it is not reported.

    On a GPU the memory that PyTorch allocates there, else resident memory. ViewnetError where that process fails.
    """
    what = f"{work.kind} at {work.size} by the {contestant} version"
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        try:
            return pool.submit(_peak_memory, work, contestant, device, threads).result()
        except BrokenProcessPool:
            advice = "too little memory is likely: choose a smaller --batch or smaller --sizes"
            raise ViewnetError(f"{what}: its process was ended: {advice}") from None
        except Exception as error:
            reason = f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"
            raise ViewnetError(f"{what} failed: {reason}") from error


def _peak_memory(work: Work, contestant: str, device: torch.device, threads: int) -> int | None:
    """The body of the measuring process."""
    torch.set_num_threads(threads)
    volume_cpu.warm_up()
    call = prepare(work, contestant, device)
    gc.collect()
    gpu = device.type == "cuda"
    if gpu:
        torch.cuda.reset_peak_memory_stats(device)
    before = torch.cuda.memory_allocated(device) if gpu else _reset_peak()
    call()
    call()
    synchronise(device)
    peak = torch.cuda.max_memory_allocated(device) if gpu else _status("VmHWM")
    return None if before is None or peak is None else max(0, peak - before)


def _reset_peak() -> int | None:
    """Resident bytes once freed memory is given back and the peak is reset; None where the system cannot."""
    with contextlib.suppress(AttributeError, OSError):  # another C library gives back by itself, or never
        ctypes.CDLL(None).malloc_trim(0)
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return None
    return _status("VmRSS")


def _status(name: str) -> int | None:
    """Bytes of an entry of /proc/self/status; None where there is none."""
    status = Path("/proc/self/status")
    match = re.search(rf"^{name}:\s*(\d+)", status.read_text() if status.exists() else "", re.MULTILINE)
    return 1024 * int(match[1]) if match else None
