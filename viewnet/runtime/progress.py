"""Progress bars on the terminal and in notebooks, switched off by TQDM_DISABLE=1."""

from typing import Any

from tqdm import tqdm


def bar(show: bool, **settings: Any) -> tqdm:
    """A tqdm bar, silent if not `show`."""
    # tqdm reads TQDM_DISABLE only without `disable`, and None would silence notebooks.
    return tqdm(**settings) if show else tqdm(**settings, disable=True)
