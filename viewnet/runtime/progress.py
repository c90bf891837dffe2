"""Progress bars: on the terminal and in notebooks alike, gone with TQDM_DISABLE=1."""

from __future__ import annotations

from typing import Any

from tqdm import tqdm


def bar(show: bool, **settings: Any) -> tqdm:
    """A tqdm bar, silent if not `show`.

    `disable` is left alone otherwise: tqdm heeds TQDM_DISABLE only then, and None would silence notebooks.
    """
    return tqdm(**settings) if show else tqdm(**settings, disable=True)
