"""The predictions behind a table, kept beside it in one file, and the table made from them again, without training.

table2_ablation.json            where each number comes from
table2_ablation.parquet         a row for each run and image: the run's key, then the columns of a run's predictions
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from viewnet.errors import ViewnetError
from viewnet.evaluation.predictions import Predictions, read_parquet
from viewnet.runtime.files import read_json
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry, Table, run_of, unnamed

NUMBERS = ("measured", "sd", "low", "high")
"""The columns of a table's cells that predictions decide."""
TOLERANCE = 1e-3
"""Of these, in per cent or degrees: predictions are kept in single precision, cells with four digits."""


def remade(path: Path) -> Table:
    """The table of `<name>.json` from the predictions beside it.

    Raises ViewnetError, naming the file, where either is missing or damaged, or a run of the table has no predictions.
    """
    frame = read_parquet(path.with_suffix(".parquet"))
    try:
        runs = {}
        for key, rows in frame.groupby("run", observed=True):
            heads = rows.dropna(axis=1, how="all")  # columns of heads that only other runs have are empty
            runs[str(key)] = Predictions.from_frame(heads.astype(dict.fromkeys(("category", "split", "model_id"), str)))
        return _table(read_json(path), runs)
    except (KeyError, TypeError, ViewnetError) as error:
        raise ViewnetError(f"{path}: not a table with its predictions ({error}): make it again") from error


def differences(path: Path) -> pd.DataFrame:
    """The cells of `<name>.json` that its predictions do not reproduce: none, or something is wrong.

    Columns row, category, metric, what ("measured", "low" ...), printed in the file, and remade. Errors as `remade`.
    """
    found = []
    again = remade(path).cells
    keys = ["row", "category", "metric"]
    new = {tuple(cell[key] for key in keys): cell for cell in again.to_dict("records")}
    for cell in read_json(path)["cells"]:
        other = new[tuple(cell[key] for key in keys)]
        for name in NUMBERS:
            was, now = (math.nan if value is None else float(value) for value in (cell[name], other[name]))
            if math.isnan(was) != math.isnan(now) or abs(was - now) > TOLERANCE:
                found.append({**{key: cell[key] for key in keys}, "what": name, "printed": was, "remade": now})
    return pd.DataFrame(found, columns=[*keys, "what", "printed", "remade"])


def _table(about: dict[str, Any], runs: Mapping[str, Predictions]) -> Table:
    """The table of a table's JSON from predictions by run."""
    cells = pd.DataFrame(about["cells"])
    renamed, layout = about.get("renamed", {}), LAYOUTS[about["table"]]
    former = {new: old for old, new in renamed.items()}
    own: list[Entry] = []
    added: list[Entry] = []
    for (row, recipe, category), group in cells.groupby(["row", "recipe", "category"], sort=False):
        label = former.get(unnamed(row, recipe), unnamed(row, recipe))
        for key in group["runs"].iloc[0]:
            origin = about["runs"][key]
            entry = Entry(label, category, origin["seed"], origin["alignment"], key, runs[run_of(key)], origin,
                          origin["calibration"])  # fmt: skip
            (own if label in {each.label for each in layout.rows} else added).append(entry)
    return Table.of(
        about["table"], own, list(dict.fromkeys(cells["category"])), about["measured on"], about.get("remarks", ()),
        renamed, added=added,
    )  # fmt: skip
