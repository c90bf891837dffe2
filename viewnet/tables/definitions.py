"""The scores of a table's rows by other alignments and definitions of the error, beside the headline.

A row whose predictions are right up to half a turn fails by Procrustes, which fits all of them at once; what it has
learned shows where opposite sides count as one (folded, the released code's error), or where the rotation is the one
that most predictions agree on.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from viewnet.evaluation import metrics
from viewnet.evaluation.alignment import HalfTurns, Procrustes, QuarterTurns
from viewnet.evaluation.predictions import Floats
from viewnet.recipes import PEERS, VARIANTS
from viewnet.runtime.files import write_csv
from viewnet.tables.table import Table

DEFINITIONS: dict[str, tuple[str, Callable[[Floats], Floats]]] = {
    "geodesic": ("procrustes", np.asarray),
    "folded": ("procrustes", metrics.folded),
    "robust": ("robust", np.asarray),
    "yaw": ("yaw", np.asarray),
}
"""Column -> the alignment of predictions, and what is made of geodesic errors (N,); "geodesic" is the headline."""


def of_seeds(table: Table) -> pd.DataFrame:
    """A line for each row, category and seed, but for constants; of upper bounds it says what an alignment adds.

    acc30 and median by each of DEFINITIONS; `spread`, that of Procrustes (viewnet.evaluation.alignment), below a
    quarter of which its rotation is hardly determined; `degenerate`, whether that is so. Then, after the robust
    alignment, per cent of views that are seen from the opposite side (`half_turns`), how much that is a matter of
    whole objects (`half_turns_by_object`, viewnet.evaluation.metrics.clustering), and Acc@30 of the best head
    (`best_head_acc30`). `up_to_half_turns_acc30` and `up_to_quarter_turns_acc30` are of the least error over turns
    about the object's vertical, as where objects are said to be symmetric (Orient Anything V2), here of all objects,
    and after an alignment that takes such turns for one. `best_of_24_acc30` is the best of the 24 rotations of a cube
    after Procrustes, chosen by test labels, as some publish it: an upper bound and no score.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    cube = Rotation.create_group("O").as_matrix()  # (24, 3, 3)
    lines = []
    for entry in (entry for entry in table.entries if entry.origin.get("variant") in VARIANTS | PEERS):
        line: dict[str, object] = {"row": table.label(entry), "category": entry.category, "seed": entry.seed}
        for name, (alignment, error) in DEFINITIONS.items():
            aligned = entry.aligned(alignment)
            errors = error(aligned.selected_errors)
            line |= {f"{name}_acc30": metrics.accuracy(errors, 30), f"{name}_median": metrics.median(errors)}
            if name == "geodesic" and isinstance(aligned.alignment, Procrustes):
                line |= {"spread": aligned.alignment.spread, "degenerate": int(aligned.alignment.degenerate)}
        robust, usual = entry.aligned("robust"), entry.aligned("procrustes")
        turned = robust.selected_errors > metrics.FLIP  # (N,)
        line |= {"half_turns": 100 * float(turned.mean())}
        line |= {"half_turns_by_object": metrics.clustering(turned, robust.predictions.objects)}
        line |= {"best_head_acc30": metrics.accuracy(robust.errors.min(axis=1), 30)}
        for name, kind in (("half", HalfTurns), ("quarter", QuarterTurns)):
            free = entry.aligned(kind.kind)
            errors = metrics.geodesic_error(free.selected, free.predictions.truth, turns=kind.order)  # (N,)
            line |= {f"up_to_{name}_turns_acc30": metrics.accuracy(errors, 30)}
        turns = (metrics.geodesic_error(usual.selected @ turn.T, usual.predictions.truth) for turn in cube)
        lines.append(line | {"best_of_24_acc30": max(metrics.accuracy(errors, 30) for errors in turns)})
    return pd.DataFrame(lines)


def by_definition(table: Table) -> pd.DataFrame:
    """`of_seeds` as means over seeds; `degenerate` counts them, of so many `seeds`."""
    seeds = of_seeds(table).drop(columns="seed").groupby(["row", "category"], sort=False)
    return seeds.mean().round(4).assign(degenerate=seeds["degenerate"].sum(), seeds=seeds.size())


def write_with(table: Table, folder: Path) -> list[Path]:
    """The files of a table (Table.write), and beside those of CAD models that the paper has, its definitions."""
    beside = table.name in ("table1_shapenet", "table2_ablation")
    return [*table.write(folder), *([write(table, folder)] if beside else [])]


def write(table: Table, folder: Path) -> Path:
    """`<name>_definitions.csv` of `by_definition`."""
    return write_csv(folder / f"{table.name}_definitions.csv", by_definition(table), index=True)
