"""The scores of a table's rows by other alignments and definitions of the error, beside the headline.

A row whose predictions are right up to half a turn fails by Procrustes, which fits all of them at once; what it has
learned shows where opposite sides count as one (folded, the released code's error), or where the rotation is the one
that most predictions agree on.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd

from viewnet.evaluation import metrics
from viewnet.evaluation.alignment import Procrustes
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predictions import Floats
from viewnet.tables.table import Table


class Definition(NamedTuple):
    """How predictions are aligned, and what is made of geodesic errors (N,)."""

    alignment: str
    error: Callable[[Floats], Floats]


DEFINITIONS = {
    "geodesic": Definition("procrustes", np.asarray),
    "folded": Definition("procrustes", metrics.folded),
    "robust": Definition("robust", np.asarray),
    "yaw": Definition("yaw", np.asarray),
}
"""Column -> definition; "geodesic" is the headline."""


def by_definition(table: Table) -> pd.DataFrame:
    """A line for each row and category of learned viewpoints: means over seeds.

    acc30 and median by each of DEFINITIONS, and `spread`, that of Procrustes (viewnet.evaluation.alignment), below
    which, at a quarter, its rotation is hardly determined: `degenerate` says of how many seeds.
    """
    lines: dict[tuple[str, str], list[dict[str, float]]] = {}
    for entry in (entry for entry in table.entries if entry.alignment == "procrustes"):
        values: dict[str, float] = {}
        for name, definition in DEFINITIONS.items():
            aligned = align(entry.predictions, definition.alignment, entry.calibration)
            errors = definition.error(aligned.selected_errors)
            values |= {f"{name}_acc30": metrics.accuracy(errors, 30), f"{name}_median": metrics.median(errors)}
            if name == "geodesic" and isinstance(aligned.alignment, Procrustes):
                values |= {"spread": aligned.alignment.spread, "degenerate": float(aligned.alignment.degenerate)}
        lines.setdefault((entry.row, entry.category), []).append(values)
    found = {key: pd.DataFrame(seeds).mean() | {} for key, seeds in lines.items()}
    frame = pd.DataFrame(found).T.rename_axis(index=["row", "category"])
    frame["degenerate"] *= [len(seeds) for seeds in lines.values()]
    return frame.assign(seeds=[len(seeds) for seeds in lines.values()])
