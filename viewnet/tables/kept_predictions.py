"""The predictions behind a table, kept beside it in one file, and the table made from them again, without training.

table2_ablation.json            where each number comes from
table2_ablation.parquet         a row for each run and image: the run's key, and what `packed` makes of its predictions
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Predictions, read_parquet
from viewnet.runtime.files import read_json
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.packed import unpacked
from viewnet.tables.table import CHOSEN_ROBUSTLY, Entry, Table, named, run_of

NUMBERS = ("measured", "sd", "low", "high")
"""The columns of a table's cells that predictions decide."""
TOLERANCE = 5e-3
"""Of these, in per cent or degrees: predictions are kept with few digits, cells with four."""


def cells_of(about: Mapping[str, Any]) -> pd.DataFrame:
    """The cells of the JSON of a table, as viewnet.tables.table.Table has them."""
    # Files of earlier versions have neither recipes nor degenerate alignments, nor supervision.
    lines = [
        {"recipe": "", "supervision": "", "degenerate": 0} | cell | {"runs": " ".join(cell["runs"])}
        for cell in about["cells"]
    ]
    return pd.DataFrame(lines).astype(dict.fromkeys(NUMBERS, float))  # null where there is none


def read(path: Path) -> Table:
    """The table of `<name>.json`, its cells as they are there; with entries where predictions are kept beside it.

    Raises ViewnetError, naming the file, where one is damaged, or a run of the table has no predictions.
    """
    about = read_json(path)
    kept = path.with_suffix(".parquet")
    runs = _runs(kept) if kept.is_file() else None
    try:
        cells = cells_of(about)
        renamed, remarks = about.get("renamed", {}), tuple(about.get("remarks", ()))
        labels = {renamed.get(row.label, row.label): row.label for row in LAYOUTS[about["table"]].rows}
        labels |= {label + CHOSEN_ROBUSTLY: label + CHOSEN_ROBUSTLY for label in labels.values()}
        entries = () if runs is None else tuple(_entries(cells, labels, about["runs"], runs))
        return Table(about["table"], about["measured on"], cells, entries, remarks, renamed)
    except (KeyError, TypeError, ValueError) as error:
        raise ViewnetError(f"{path}: not a table with its predictions ({error}): make it again") from error


def entries(path: Path) -> tuple[Entry, ...]:
    """The entries of the table at `path`; none where no predictions are kept beside it. Errors as `read`."""
    return read(path).entries if path.with_suffix(".parquet").is_file() else ()


def remade(path: Path) -> Table:
    """As `read`, its cells measured again from the predictions, or ViewnetError where these are not kept."""
    if not path.with_suffix(".parquet").is_file():
        raise ViewnetError(f"{path.with_suffix('.parquet')}: no such file: make the table again")
    table = read(path)
    return Table.of(table.name, table.entries, table.categories, table.note, table.remarks, table.renamed)


def differences(path: Path) -> pd.DataFrame:
    """The cells of `<name>.json` that its predictions do not reproduce: none, or something is wrong.

    Columns row, category, metric, what ("measured", "low" ...), printed in the file, and remade. Errors as `remade`.
    """
    return differing(pd.DataFrame(read_json(path)["cells"]), remade(path).cells, TOLERANCE)


def differing(printed: pd.DataFrame, again: pd.DataFrame, tolerance: float) -> pd.DataFrame:
    """The NUMBERS of `printed` cells that are others in those made `again`, as `differences` has them."""
    keys = ["row", "category", "metric"]
    sides = {"printed": printed, "remade": again}
    was, now = (cells[[*keys, *NUMBERS]].melt(keys, NUMBERS, "what", name) for name, cells in sides.items())
    both = was.merge(now, how="left", on=[*keys, "what"]).astype({"printed": float, "remade": float})
    return both[~np.isclose(both["printed"], both["remade"], rtol=0, atol=tolerance, equal_nan=True)]


def _runs(path: Path) -> dict[str, Predictions]:
    """Key of a run -> its predictions. Raises ViewnetError naming the file where it is damaged."""
    frame = read_parquet(path)
    runs = {}
    try:
        for key, rows in frame.groupby("run", observed=True):
            heads = rows.dropna(axis=1, how="all")  # columns of heads that only other runs have are empty
            runs[str(key)] = unpacked(heads.astype(dict.fromkeys(("category", "split", "model_id"), str)))
    except (KeyError, TypeError, ViewnetError) as error:
        raise ViewnetError(f"{path}: not the predictions of a table ({error}): make it again") from error
    return runs


def _entries(
    cells: pd.DataFrame, labels: dict[str, str], origins: dict[str, Any], runs: Mapping[str, Predictions]
) -> Iterator[Entry]:
    """The entries of a table's cells; `labels` are those of the layout's rows by their names in the table."""
    for (row, recipe, category), group in cells.groupby(["row", "recipe", "category"], sort=False):
        label = next((label for name, label in labels.items() if named(name, recipe) == row), row)
        for key in group["runs"].iloc[0].split():
            origin = origins[key]
            how = (origin["seed"], origin["alignment"], key, runs[run_of(key)], origin, origin["calibration"])
            yield Entry(label, category, *how)
