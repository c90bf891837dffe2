"""Folders of the project, and the environment variables that move them; one that is empty moves nothing."""

import os
from pathlib import Path

from viewnet.errors import ViewnetError


def root() -> Path:
    """The folder everything is relative to: `VIEWNET_ROOT`, else the checkout, else the working directory."""
    if named := os.environ.get("VIEWNET_ROOT"):
        return Path(named)
    checkout = Path(__file__).resolve().parent.parent
    return checkout if (checkout / "pyproject.toml").exists() else Path.cwd()


def data() -> Path:
    """CAD collections and view stores that the project makes: `VIEWNET_DATA`, else `<root>/data`."""
    return Path(os.environ.get("VIEWNET_DATA") or root() / "data")


def runs() -> Path:
    """The run store: `VIEWNET_RUNS`, else `<root>/runs`."""
    return Path(os.environ.get("VIEWNET_RUNS") or root() / "runs")


def tables() -> Path:
    """Tables and figures: `VIEWNET_TABLES`, else `<root>/paper_tables`."""
    return Path(os.environ.get("VIEWNET_TABLES") or root() / "paper_tables")


def named(value: str | os.PathLike[str], what: str) -> Path:
    """A path that a user gave, "~" expanded. Raises ViewnetError, which says `what` it is, for what cannot be one."""
    try:
        path = Path(value).expanduser()
        path.resolve().exists()
    except (OSError, ValueError, RuntimeError, TypeError):  # too long, a null byte, an unknown user's home, no text
        raise ViewnetError(f"{what} {value!r:.300}: not the name of a file or folder") from None
    return path


def part(*names: str) -> Path:
    """A folder of the project beside the package: under `root`, else in this package's checkout.

    Raises ViewnetError where there is none: an installed package comes without these folders.
    """
    places = [base.joinpath(*names) for base in (root(), Path(__file__).resolve().parent.parent)]
    for place in places:
        if place.is_dir():
            return place
    raise ViewnetError(f"{places[0]}: no such folder: set VIEWNET_ROOT to a checkout of the project")
