"""Cells of tables."""

from __future__ import annotations

from typing import Any

from viewnet.tables.columns import by_key
from viewnet.tables.table import Table


def cell_of(table: Table, row: str, category: str, metric: str) -> dict[str, Any] | None:
    """One line of a table's cells; None where the row has no such metric."""
    return by_key(table.cells).get((row, category, metric))
