"""Random numbers for a training step, the same whether one process or several work on its batch.

Every process draws for the whole batch from the same generator and takes its own rows.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

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


def _sample(draw: Callable[..., Tensor], *shape: int, generator: RandomSource, dim: int = 0) -> Tensor:
    if isinstance(generator, torch.Generator):
        return draw(shape, generator=generator)
    rows = shape[dim] * generator.size
    batch = draw((*shape[:dim], rows, *shape[dim + 1 :]), generator=generator.generator)
    parts = batch.unflatten(dim, (generator.repeats, generator.size, -1))  # (..., repeats, processes, rows of one, ...)
    return parts.select(dim + 1, generator.rank).flatten(dim, dim + 1)


rand, randn = partial(_sample, torch.rand), partial(_sample, torch.randn)
"""Uniform in [0, 1), and standard normal. The shape is this process's; `dim` is the dimension of the batch's rows."""


def randint(high: int, *shape: int, generator: RandomSource, dim: int = 0) -> Tensor:
    """Whole numbers from 0 to `high` - 1, as `rand`."""
    return _sample(partial(torch.randint, high), *shape, generator=generator, dim=dim)


def repeated(generator: RandomSource, times: int) -> RandomSource:
    """The same source for a batch whose rows are repeated `times` times, one copy of the batch after the other."""
    return generator if isinstance(generator, torch.Generator) else replace(generator, repeats=times)
