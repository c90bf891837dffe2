"""Random numbers for a training step, the same whether one process or several work on its batch.

Every draw is made for the whole batch, in each process from the same generator, and each process takes its rows of it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Shared:
    """A generator that `size` processes have alike, each for its part of a batch's rows: `rank` counts from 0.

    With `repeats` the rows are those of the batch so many times over.
    """

    generator: torch.Generator
    rank: int
    size: int
    repeats: int = 1


Chance = torch.Generator | Shared
"""Where random numbers come from: a generator for all rows, or for this process's part of them."""


def rand(*shape: int, generator: Chance, dim: int = 0) -> Tensor:
    """Uniform in [0, 1). The shape is this process's; `dim` is the dimension that counts the batch's rows."""
    return _drawn(torch.rand, shape, generator, dim)


def randn(*shape: int, generator: Chance, dim: int = 0) -> Tensor:
    """Normally distributed, as `rand`."""
    return _drawn(torch.randn, shape, generator, dim)


def randint(high: int, *shape: int, generator: Chance, dim: int = 0) -> Tensor:
    """Whole numbers from 0 to `high` - 1, as `rand`."""
    return _drawn(functools.partial(torch.randint, high), shape, generator, dim)


def repeated(generator: Chance, times: int) -> Chance:
    """The same for a batch's rows so many times over, one batch behind the other."""
    return generator if isinstance(generator, torch.Generator) else replace(generator, repeats=times)


def _drawn(draw: Callable[..., Tensor], shape: tuple[int, ...], chance: Chance, dim: int) -> Tensor:
    if isinstance(chance, torch.Generator):
        return draw(shape, generator=chance)
    whole = draw((*shape[:dim], shape[dim] * chance.size, *shape[dim + 1 :]), generator=chance.generator)
    return whole.unflatten(dim, (chance.repeats, chance.size, -1)).select(dim + 1, chance.rank).flatten(dim, dim + 1)
