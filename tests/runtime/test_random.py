from __future__ import annotations

import torch

from viewnet.runtime import random


def test_processes_draw_the_rows_of_one_batch():
    def generator() -> torch.Generator:
        return torch.Generator().manual_seed(3)

    whole = random.rand(6, 5, generator=generator())
    assert torch.equal(whole, torch.rand(6, 5, generator=torch.Generator().manual_seed(3)))
    parts = [random.rand(2, 5, generator=random.RankGenerator(generator(), rank, 3)) for rank in range(3)]
    assert torch.equal(torch.cat(parts), whole)
    parts = [random.randn(2, 2, 4, generator=random.RankGenerator(generator(), rank, 3), dim=1) for rank in range(3)]
    assert torch.equal(torch.cat(parts, 1), random.randn(2, 6, 4, generator=generator()))
    # Each process has its rows twice, and so has the batch: 0 1 0 1, 2 3 2 3 of 0 1 2 3 0 1 2 3.
    shared = [random.repeated(random.RankGenerator(generator(), rank, 2), 2) for rank in range(2)]
    one, two = (random.randint(1000, 4, generator=one).view(2, 2) for one in shared)
    assert torch.equal(torch.cat([one, two], 1).flatten(), random.randint(1000, 8, generator=generator()))
