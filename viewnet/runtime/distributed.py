"""One training over several processes, each with a GPU or some cores of its own, on one machine or several.

torchrun starts the processes and says so in the environment. A step's batch is the configured one: every process takes
its share of the objects, whatever is averaged over a batch is averaged over all processes, and so are the gradients. A
process that is alone (`size()` 1) takes the same path and pays nothing.
"""

from __future__ import annotations

import atexit
import datetime
import os
import sys
from collections.abc import Callable, Iterable
from typing import Any, NoReturn, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from viewnet.errors import ViewnetError

T = TypeVar("T")

ENVIRONMENT = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT")
PATIENCE = datetime.timedelta(days=7)
"""The others wait while the first process renders a collection. Who waits for a dead one is ended by torchrun."""


def start() -> None:
    """Join the processes that torchrun started; nothing for a process alone, or one that has joined.

    Raises ViewnetError where a machine has fewer GPUs than processes.
    """
    if _joined() or any(name not in os.environ for name in ENVIRONMENT) or os.environ["WORLD_SIZE"] == "1":
        return
    backend = "gloo"
    if torch.cuda.is_available():
        local, gpus = int(os.environ["LOCAL_RANK"]), torch.cuda.device_count()
        if local >= gpus:
            raise ViewnetError(f"process {local} of this machine has no GPU, there are {gpus}: start as many processes")
        torch.cuda.set_device(local)
        backend = "cpu:gloo,cuda:nccl"
    dist.init_process_group(backend, timeout=PATIENCE)


def stop() -> None:
    """Leave the other processes, when all is done. The process ends with exit code 0 once it has nothing more to do."""
    if _joined():
        dist.all_reduce(torch.zeros(1))  # nobody leaves while another still talks
        dist.destroy_process_group()
        # Gloo's threads may outlive the interpreter and abort the process while it is taken down: it ends before that.
        atexit.register(_leave)


def _leave() -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(0)


def size() -> int:
    """How many processes train together."""
    return dist.get_world_size() if _joined() else 1


def rank() -> int:
    """Which of them this one is, counting from 0. The first one validates and writes."""
    return dist.get_rank() if _joined() else 0


def local_size() -> int:
    """How many of them this machine has."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", size())) if size() > 1 else 1


def _joined() -> bool:
    return dist.is_available() and dist.is_initialized()


def fail(message: str) -> NoReturn:
    """End this process, and with it all: torchrun ends the others. The first to fail says why, for all of them."""
    store = dist.distributed_c10d._get_default_store()
    if store.add("failures", 1) == 1:
        print(message, file=sys.stderr, flush=True)
    # What an orderly end would do is wait for the others.
    os._exit(2)


def first(work: Callable[[], T]) -> T:
    """What `work` gives in the first process, in all of them.

    What it raises there is raised in all, as a ViewnetError in the others.
    """
    if size() == 1:
        return work()
    found: list[Any] = [None, None]
    error = None
    if rank() == 0:
        try:
            found[0] = work()
        except Exception as problem:
            error, found[1] = problem, str(problem)
    dist.broadcast_object_list(found, 0, device=torch.device("cpu"))
    if error is not None:
        raise error
    if found[1] is not None:
        raise ViewnetError(found[1])
    return found[0]


def share(rows: Tensor) -> Tensor:
    """This process's part of a batch's rows: as many for each, in their order."""
    return rows if size() == 1 else rows.chunk(size())[rank()]


def gathered(value: Tensor) -> Tensor:
    """Every process's value, (processes, ...). Gradients find their way back to all of them."""
    return value[None] if size() == 1 else _Gather.apply(value)


def mean(value: Tensor) -> Tensor:
    """The mean of all processes' values: where each has the mean of its rows, that of the batch."""
    return value if size() == 1 else gathered(value).mean(0)


def average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Give every process the mean of all processes' gradients.

    DistributedDataParallel wraps a module's `forward`, and a step calls several methods of several parts of the model.
    One sum of all gradients behind the backward pass does not overlap with it, but there is nothing to go wrong: Muon
    and Adam see the same numbers everywhere, to the bit, and so all processes keep the same weights.
    """
    if size() == 1:
        return
    gradients = [weight.grad for weight in parameters if weight.grad is not None]
    flat = torch.cat([gradient.flatten() for gradient in gradients])
    dist.all_reduce(flat)
    flat /= size()
    for gradient, averaged in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(averaged.view(gradient.shape))


def together(model: nn.Module) -> None:
    """Make a model ready: the weights of the first process in all, and normalisation by the whole batch."""
    if size() == 1:
        return
    # One seed gives almost the same weights on different processors.
    model.load_state_dict(first(lambda: {name: value.cpu() for name, value in model.state_dict().items()}))
    share_normalisation(model)


def share_normalisation(model: nn.Module) -> None:
    """Have a model's batch normalisation go by all processes' rows."""
    for parent in list(model.modules()):
        for name, child in parent.named_children():
            if isinstance(child, _BatchNorm):
                setattr(parent, name, BatchNorm.of(child))


class BatchNorm(_BatchNorm):
    """Batch normalisation by the statistics of all processes' rows, of which each has as many.

    As torch.nn.SyncBatchNorm, which is for GPUs only.
    """

    @classmethod
    def of(cls, other: _BatchNorm) -> BatchNorm:
        """One that takes another's place, with its weights and running statistics."""
        made = cls(other.num_features, other.eps, other.momentum).to(other.weight.device)
        made.load_state_dict(other.state_dict())
        return made

    def _check_input_dim(self, input: Tensor) -> None:
        """Any number of dimensions will do."""

    def forward(self, x: Tensor) -> Tensor:
        """Normalised features (N, C, ...) of this process's rows."""
        if not self.training:
            return super().forward(x)
        dims = [d for d in range(x.dim()) if d != 1]
        spread, centre = torch.var_mean(x.float(), dims, correction=0)
        spreads, centres = gathered(torch.stack([spread, centre])).unbind(1)
        mean, variance = centres.mean(0), spreads.mean(0) + centres.var(0, correction=0)
        with torch.no_grad():
            count = x.numel() // x.shape[1] * size()
            assert self.momentum is not None and self.running_mean is not None and self.running_var is not None
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * (count / max(1, count - 1)), self.momentum)
            assert self.num_batches_tracked is not None
            self.num_batches_tracked += 1
        scale = self.weight * (variance + self.eps).rsqrt()
        shape = (-1, *[1] * (x.dim() - 2))
        return (x * scale.view(shape) + (self.bias - mean * scale).view(shape)).to(x.dtype)


class _Gather(torch.autograd.Function):
    """A sum over arrays that are zero but for a process's own place: every transport has it, and it is exact."""

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        places = value.new_zeros(size(), *value.shape)
        places[rank()] = value
        dist.all_reduce(places)
        return places

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        # Each process minimises its own loss, and all depend on this value.
        total = gradient.contiguous().clone()
        dist.all_reduce(total)
        return total[rank()]
