"""Random numbers for a training step, the same whether one process or several work on its batch.

Every process draws for the whole batch from the same generator and takes its own rows.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class RankGenerator:
    """A generator in the same state in `size` processes, of which process `rank` (from 0) takes its rows of a batch.

    With `repeats`, the rows are those of the batch repeated that many times.
    """

    generator: torch.Generator
    rank: int
    size: int
    repeats: int = 1


RandomSource = torch.Generator | RankGenerator
"""Where random numbers come from: a generator for all rows, or for this process's rows."""


def rand(*shape: int, generator: RandomSource, dim: int = 0) -> Tensor:
    """Uniform in [0, 1). The shape is this process's; `dim` is the dimension of the batch's rows."""
    return _sample(torch.rand, shape, generator, dim)


def randn(*shape: int, generator: RandomSource, dim: int = 0) -> Tensor:
    """Standard normal, as `rand`."""
    return _sample(torch.randn, shape, generator, dim)


def randint(high: int, *shape: int, generator: RandomSource, dim: int = 0) -> Tensor:
    """Whole numbers from 0 to `high` - 1, as `rand`."""
    return _sample(functools.partial(torch.randint, high), shape, generator, dim)


def repeated(generator: RandomSource, times: int) -> RandomSource:
    """The same source for a batch whose rows are repeated `times` times, one copy of the batch after the other."""
    return generator if isinstance(generator, torch.Generator) else replace(generator, repeats=times)


def _sample(draw: Callable[..., Tensor], shape: tuple[int, ...], source: RandomSource, dim: int) -> Tensor:
    if isinstance(source, torch.Generator):
        return draw(shape, generator=source)
    batch = draw((*shape[:dim], shape[dim] * source.size, *shape[dim + 1 :]), generator=source.generator)
    # Rows of the batch are (repeats, size, rows of a process).
    return batch.unflatten(dim, (source.repeats, source.size, -1)).select(dim + 1, source.rank).flatten(dim, dim + 1)
