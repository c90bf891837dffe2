"""Splits of models and clips into train, val and test, 0.7, 0.1 and 0.2 of them (section 4.2)."""

import hashlib
import itertools
from collections.abc import Iterable, Mapping

import numpy as np

SHARES = {"train": 0.7, "val": 0.1, "test": 0.2}
SPLITS = tuple(SHARES)


def seeded_rank(seed: int, *names: str) -> bytes:
    """A sort key that shuffles names. It depends on its arguments alone, so other names do not change an order."""
    return hashlib.sha256(" ".join((str(seed), *names)).encode()).digest()


def seeded_generator(seed: int, *names: str) -> np.random.Generator:
    """Random numbers of one thing with these names, whatever others there are."""
    return np.random.default_rng(int.from_bytes(seeded_rank(seed, *names)[:8], "little"))


def split_sizes(total: int, one_above: Mapping[str, int] | None = None) -> dict[str, int]:
    """How many of `total` are val and test; the rest is train.

    A split in `one_above` has one member at least where there are more than so many in total.
    """
    least = {split: total > above for split, above in (one_above or {}).items()}
    return {split: max(round(SHARES[split] * total), least.get(split, 0)) for split in ("val", "test")}


def seeded_splits(
    names: Iterable[str], seed: int, one_above: Mapping[str, int], order: Iterable[str] = ("test", "val")
) -> dict[str, str]:
    """Name -> split, by seed and names only. Splits take their members in this `order`; what is left is train."""
    ranked = sorted(names, key=lambda name: seeded_rank(seed, "split", name))
    sizes, rest = split_sizes(len(ranked), one_above), iter(ranked)
    splits = {name: split for split in order for name in itertools.islice(rest, sizes[split])}
    return splits | dict.fromkeys(rest, "train")
