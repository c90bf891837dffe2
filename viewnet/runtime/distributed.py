"""Data-parallel training over the processes of a torchrun, on one machine or several.

The configured batch is that of all processes: each takes its share of the objects; batch averages, batch statistics and
gradients are averaged over all. A single process (`size()` 1) runs the same code without any communication.
"""

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
PATIENCE = datetime.timedelta(days=7)  # the first may be rendering; torchrun ends those that wait for a dead one


def start() -> None:
    """Join the processes that torchrun started, if any and once. ViewnetError for fewer GPUs than processes."""
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
    """Leave the process group at the end of the program, which then exits with code 0."""
    if _joined():
        dist.all_reduce(torch.zeros(1))  # wait until no process needs another any more
        dist.destroy_process_group()

        @atexit.register
        def leave() -> None:  # Gloo's threads may abort the process during the interpreter's shutdown
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)


def size() -> int:
    """How many processes train together."""
    return dist.get_world_size() if _joined() else 1


def rank() -> int:
    """The number of this process, from 0. Process 0 validates and writes files."""
    return dist.get_rank() if _joined() else 0


def _joined() -> bool:
    return dist.is_available() and dist.is_initialized()


def fail(message: str) -> NoReturn:
    """End this process; torchrun then ends the others. Only the first to fail prints its message."""
    store = dist.distributed_c10d._get_default_store()
    if store.add("failures", 1) == 1:
        print(message, file=sys.stderr, flush=True)
    # Not sys.exit: shutting down in order would wait for the other processes.
    os._exit(2)


def first(work: Callable[[], T]) -> T:
    """Call `work` in process 0 only and return its result in every process.

    An exception is raised in every process, as a ViewnetError in the others.
    """
    if size() == 1:
        return work()
    outcome: list[Any] = [None, None]  # result, message of the exception
    if rank() == 0:
        try:
            outcome[0] = work()
        except Exception as error:
            dist.broadcast_object_list([None, str(error)], 0, device=torch.device("cpu"))
            raise
    dist.broadcast_object_list(outcome, 0, device=torch.device("cpu"))
    if outcome[1] is not None:
        raise ViewnetError(outcome[1])
    return outcome[0]


def share(rows: Tensor) -> Tensor:
    """This process's rows of a batch: equal, consecutive parts in the order of ranks."""
    return rows if size() == 1 else rows.chunk(size())[rank()]


def gathered(value: Tensor) -> Tensor:
    """The values of all processes, (processes, ...). Differentiable: gradients reach every process's value."""
    return value[None] if size() == 1 else _Gather.apply(value)


def mean(value: Tensor) -> Tensor:
    """The mean over processes; of means over each process's rows, that is the mean over the batch."""
    return value if size() == 1 else gathered(value).mean(0)


def average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Replace gradients by their mean over all processes, the same to the bit, so that all keep the same weights.

    DistributedDataParallel wraps a module's `forward`, but a step calls several methods of parts of the model.
    """
    if size() == 1:
        return
    gradients = [weight.grad for weight in parameters if weight.grad is not None]
    flat = torch.cat([gradient.flatten() for gradient in gradients])  # (all numbers,)
    dist.all_reduce(flat)
    flat /= size()
    for gradient, averaged in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(averaged.view(gradient.shape))


def together(model: nn.Module) -> None:
    """Prepare a model: weights of process 0 in every process, and batch normalisation over the whole batch."""
    if size() > 1:
        # The same seed gives slightly different weights on different CPUs.
        model.load_state_dict(first(lambda: {name: value.cpu() for name, value in model.state_dict().items()}))
        share_normalisation(model)


def share_normalisation(model: nn.Module) -> None:
    """Replace batch normalisation layers, in place, by ones over the rows of all processes."""
    for parent in list(model.modules()):
        for name, child in parent.named_children():
            if isinstance(child, _BatchNorm):
                setattr(parent, name, BatchNorm.of(child))


class BatchNorm(_BatchNorm):
    """Batch normalisation over the rows of all processes, of which each has as many; SyncBatchNorm needs GPUs."""

    @classmethod
    def of(cls, other: _BatchNorm) -> "BatchNorm":
        """A replacement of another layer, with its weights and running statistics."""
        layer = cls(other.num_features, other.eps, other.momentum).to(other.weight.device)
        layer.load_state_dict(other.state_dict())
        return layer

    def _check_input_dim(self, input: Tensor) -> None:
        """Features of any number of dimensions are accepted."""

    def forward(self, x: Tensor) -> Tensor:
        """Normalised features (N, C, ...) of this process's rows."""
        if not self.training:
            return super().forward(x)
        dims = [d for d in range(x.dim()) if d != 1]
        statistics = torch.stack(torch.var_mean(x.float(), dims, correction=0))  # (2, C)
        variances, means = gathered(statistics).unbind(1)  # (processes, C) each
        # The variance over all rows is the mean variance within processes plus the variance of their means.
        mean, variance = means.mean(0), variances.mean(0) + means.var(0, correction=0)
        with torch.no_grad():
            count = x.numel() // x.shape[1] * size()
            assert self.momentum is not None and self.running_mean is not None
            assert self.running_var is not None and self.num_batches_tracked is not None
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * (count / max(1, count - 1)), self.momentum)
            self.num_batches_tracked += 1
        scale = self.weight * (variance + self.eps).rsqrt()
        shape = (-1, *[1] * (x.dim() - 2))
        return (x * scale.view(shape) + (self.bias - mean * scale).view(shape)).to(x.dtype)


class _Gather(torch.autograd.Function):
    """Gathers by a sum of arrays that are zero outside a process's own slot: exact, and every backend has it."""

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        slots = value.new_zeros(size(), *value.shape)  # (processes, ...)
        slots[rank()] = value
        dist.all_reduce(slots)
        return slots

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        # Each process minimises its own loss, and all losses depend on this value.
        total = gradient.contiguous().clone()
        dist.all_reduce(total)
        return total[rank()]
