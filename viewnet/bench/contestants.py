"""The two contestants of `viewnet bench`: the package, and the textbook version of the same work, timed in turn.

A contestant is a function without arguments that does the work once. Both get the same volumes, weights, images and
viewpoints; the textbook version is viewnet.bench.textbook.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path

import torch
from torch import Tensor

from viewnet.bench import textbook
from viewnet.config import RunConfig
from viewnet.errors import ViewnetError
from viewnet.geometry import look_at, view_vector
from viewnet.model import volume
from viewnet.model.kernels import volume_cpu
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.training.optimisers import make_optimisers
from viewnet.training.step import step_loss

FORWARD, BOTH, EXACT, STEP = (
    "renderer, forward",
    "renderer, forward + backward",
    "renderer, forward + backward (all voxels)",
    "training step",
)
VIEWS = 3
"""Images drawn of each volume: one for each head of the paper's viewpoint network."""
FOCAL = 0.4


@dataclass(frozen=True)
class Work:
    """What both contestants do.

    kind        FORWARD; BOTH, as training does it (viewnet.model.volume.render's `sparse`); EXACT, without that; STEP
    occupancy   object: a car-like blob that fills a quarter of the cube, empty elsewhere;
                dense: every voxel holds a little, and a fifth of the light passes through all of them;
                initial (STEP only): what networks that have learned nothing say, the Gaussian S included
    size        voxels along a side, and pixels of the image
    batch       volumes a call; target images a call in a STEP
    profile     STEP only: whose networks
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
        """Images a call."""
        return self.batch if self.kind == STEP else VIEWS * self.batch


# ---- what is drawn


def superellipsoid(size: int) -> Tensor:
    """How far voxels (n, n, n) lie out: 0 in the middle, 1 on the surface of a rounded box along x."""
    axis = (torch.arange(size) * 2 + 1) / size - 1
    z, y, x = torch.meshgrid(axis / 0.57, axis / 0.57, axis / 0.95, indexing="ij")
    return (x**4 + y**4 + z**4) ** 0.25


def logits(occupancy: str, size: int, count: int) -> Tensor:
    """Volumes as viewnet.model.volume.squash takes them, (count, n, n, n, 1, 1, 1, 4), in colours of their own."""
    generator = torch.Generator().manual_seed(size)
    blocks = torch.randn(count, size, size, size, 1, 1, 1, 4, generator=generator)
    if occupancy == "object":
        blocks[..., 3] = (4 * (1 - superellipsoid(size)))[..., None, None, None]
    else:  # optical depth 1.5 along an axis; sigmoids give back Q by 2 sigmoid - 1
        little = (1.5 / size) * (0.5 + torch.rand(blocks.shape[:-1], generator=generator))
        blocks[..., 3] = 2 * torch.atanh(little.clamp(max=0.9))
    return blocks


def frames(count: int) -> Tensor:
    """Camera frames (count, 3, 3) all around, elevations from -20 to 40 degrees."""
    generator = torch.Generator().manual_seed(count)
    azimuth, elevation = torch.rand(2, count, generator=generator)
    return look_at(view_vector(360 * azimuth, 60 * elevation - 20))


def images(count: int, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Three images (count, 4, size, size) each of blobs in different colours, as training gets them."""
    shapes = volume.squash(logits("object", 16, count), None, None)
    with torch.no_grad():
        drawn = volume.render_reference(shapes, frames(3 * count), torch.tensor(FOCAL), size, 16)
    appearance, target, seen = drawn.unflatten(0, (count, 3)).unbind(1)
    return appearance, target, seen


def step_config(profile: str) -> RunConfig:
    """The recipe `paper` at the size of a profile, and without random numbers.

    Pixels are compared instead of VGG16's features, whose weights are not everywhere, and nothing is augmented.
    """
    return make_config(
        profile=profile,
        recipe="paper",
        perceptual="none",
        pixel_weight=1.0,
        augment=False,
        targets_per_object=1,
    )


# ---- one call


def prepare(work: Work, contestant: str, device: torch.device) -> Callable[[], None]:
    """Sets up a contestant; its function does `work` once."""
    if work.kind == STEP:
        return _step(work, contestant, device)
    return _renderer(work, contestant, device)


def _renderer(work: Work, contestant: str, device: torch.device) -> Callable[[], None]:
    shape = volume.squash(logits(work.occupancy, work.size, work.batch).to(device), None, None)
    cameras, focal = frames(work.images).to(device), torch.tensor(FOCAL, device=device)
    size = work.size
    weights = torch.randn(work.images, 4, size, size, generator=torch.Generator(device).manual_seed(0), device=device)
    if contestant == "textbook":
        module, shape = textbook, shape.contiguous()

        def draw(voxels: Tensor, cameras: Tensor, focal: Tensor) -> Tensor:
            return module.render(voxels, cameras, focal, size, size)
    else:

        def draw(voxels: Tensor, cameras: Tensor, focal: Tensor) -> Tensor:
            return volume.render(voxels, cameras, focal, size, sparse=work.kind != EXACT)

    def call() -> None:
        # Leaves of their own each time: what is remembered of the volume drawn last helps no second call.
        leaves = [x.detach().requires_grad_(work.kind != FORWARD) for x in (shape, cameras, focal)]
        image = draw(*leaves)
        if work.kind != FORWARD:
            image.backward(weights)

    return call


def _step(work: Work, contestant: str, device: torch.device) -> Callable[[], None]:
    config = step_config(work.profile)
    settings = config.train
    torch.manual_seed(0)
    model = ViewNet(config.model)
    appearance, target, seen = (part.to(device) for part in images(work.batch, config.model.input_size))
    batch = appearance, target, seen
    if work.occupancy == "object":
        # In the place of S, so that untrained networks have volumes like trained ones'.
        model.prior = torch.tanh(2 * (1 - superellipsoid(config.model.volume_size)))
    if contestant == "textbook":
        module = textbook
        net = module.TextbookViewNet(config.model)
        net.load(model.state_dict())
        net.prior = model.prior
        net.to(device)
        adam = torch.optim.Adam(net.parameters(), lr=settings.optimiser.learning_rate, betas=settings.optimiser.betas)

        def call() -> None:
            loss = module.step_loss(net, batch, settings)
            adam.zero_grad()
            loss.backward()
            adam.step()
    else:
        model.to(device)
        optimisers = make_optimisers(model, settings)

        def call() -> None:
            terms = step_loss(model, batch, settings, None, 0.5, torch.Generator().manual_seed(0))
            model.zero_grad(set_to_none=True)
            torch.stack(list(terms.values())).sum().backward()
            for optimiser in optimisers:
                optimiser.step()

    return call


# ---- time


def seconds(call: Callable[[], None], device: torch.device, times: int = 1) -> float:
    """How long a call takes, the mean of `times` in a row."""
    _synchronise(device)
    begun = time.perf_counter()
    for _ in range(times):
        call()
    _synchronise(device)
    return (time.perf_counter() - begun) / times


def in_turn(
    calls: dict[str, Callable[[], None]], repeat: int, device: torch.device, least: float
) -> dict[str, list[float]]:
    """Seconds a call, `repeat` measurements of each contestant, A B B A A B ..., each of `least` seconds or more.

    Alternating, so that what else the machine does meets both. Every contestant has an untimed call first.
    """
    times = {}
    for name, call in calls.items():
        taken = seconds(call, device)
        if taken < least:  # the first call is no measure of the others
            taken = seconds(call, device)
        times[name] = max(1, math.ceil(least / taken))
    found: dict[str, list[float]] = {name: [] for name in calls}
    order = list(calls)
    for _ in range(repeat):
        for name in order:
            found[name].append(seconds(calls[name], device, times[name]))
        order.reverse()
    return found


def _synchronise(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


# ---- memory


def peak_memory(work: Work, contestant: str, device: torch.device, threads: int) -> int | None:
    """The most bytes that two calls hold at once beside what was there before, in a process of its own.

    On a GPU what PyTorch allocates there, else resident memory. None where the system does not tell. Raises
    ViewnetError where that process fails or is ended.
    """
    from multiprocessing import get_context

    context = get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process: SpawnProcess = context.Process(
        target=_remember, args=(theirs, work, contestant, str(device), threads), daemon=True
    )
    process.start()
    theirs.close()
    try:
        answer = ours.recv()
    except EOFError:
        process.join()
        raise ViewnetError(
            f"{work.kind} at {work.size} by the {contestant} version: its process was ended (exit code "
            f"{process.exitcode}): too little memory is likely: choose a smaller --batch or smaller --sizes"
        ) from None
    process.join()
    if isinstance(answer, str):
        raise ViewnetError(f"{work.kind} at {work.size} by the {contestant} version failed: {answer}")
    return answer


def _remember(answer: Connection, work: Work, contestant: str, where: str, threads: int) -> None:
    """The measuring process."""
    try:
        device = torch.device(where)
        torch.set_num_threads(threads)
        volume_cpu.warm_up()
        call = prepare(work, contestant, device)
        gc.collect()
        if device.type == "cuda":
            before = torch.cuda.memory_allocated(device)
            torch.cuda.reset_peak_memory_stats(device)
            call()
            call()
            torch.cuda.synchronize(device)
            answer.send(torch.cuda.max_memory_allocated(device) - before)
            return
        level = _settled()
        call()
        call()
        peak = _status("VmHWM")
        answer.send(None if level is None or peak is None else max(0, peak - level))
    except Exception as error:
        answer.send(f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}")


def _settled() -> int | None:
    """Resident bytes once what set-up freed is given back and its high-water mark is forgotten; None if not told."""
    if sys.platform != "linux":
        return None
    with contextlib.suppress(AttributeError, OSError):  # another C library gives back by itself, or never
        ctypes.CDLL(None).malloc_trim(0)
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return None
    return _status("VmRSS")


def _status(name: str) -> int | None:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    return None
