"""Where things live: the only module that knows the tree."""

from __future__ import annotations

import os
from pathlib import Path


def root() -> Path:
    """The folder everything is relative to: `VIEWNET_ROOT`, else the checkout, else the working directory."""
    if "VIEWNET_ROOT" in os.environ:
        return Path(os.environ["VIEWNET_ROOT"])
    checkout = Path(__file__).resolve().parent.parent
    return checkout if (checkout / "pyproject.toml").exists() else Path.cwd()


def data() -> Path:
    """CAD collections and view stores that the project makes: `VIEWNET_DATA`, else `<root>/data`."""
    return Path(os.environ["VIEWNET_DATA"]) if "VIEWNET_DATA" in os.environ else root() / "data"


def runs() -> Path:
    """The run store: `VIEWNET_RUNS`, else `<root>/runs`."""
    return Path(os.environ["VIEWNET_RUNS"]) if "VIEWNET_RUNS" in os.environ else root() / "runs"


def tables() -> Path:
    """Tables and figures: `VIEWNET_TABLES`, else `<root>/paper_tables`."""
    return Path(os.environ["VIEWNET_TABLES"]) if "VIEWNET_TABLES" in os.environ else root() / "paper_tables"
