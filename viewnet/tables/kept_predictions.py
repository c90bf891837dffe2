"""The predictions behind a table, kept beside it in one file, and the table made from them again, without training.

table2_ablation.json            where each number comes from
table2_ablation.parquet         a row for each run and image: the run's key, then the columns of a run's predictions
"""

import math
from collections.abc import Iterator, Mapping
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


def read(path: Path) -> Table:
    """The table of `<name>.json`, its cells as they are there; with entries where predictions are kept beside it.

    Raises ViewnetError, naming the file, where one is damaged, or a run of the table has no predictions.
    """
    about = read_json(path)
    kept = path.with_suffix(".parquet")
    runs = _runs(kept) if kept.is_file() else None
    try:
        # Files of earlier versions have neither recipes nor degenerate alignments.
        lines = [{"recipe": "", "degenerate": 0} | cell | {"runs": " ".join(cell["runs"])} for cell in about["cells"]]
        cells = pd.DataFrame(lines).astype(dict.fromkeys(NUMBERS, float))
        renamed, remarks = about.get("renamed", {}), tuple(about.get("remarks", ()))
        entries = () if runs is None else tuple(_entries(cells, renamed, about["runs"], runs))
        return Table(about["table"], about["measured on"], cells, entries, remarks, renamed)
    except (KeyError, TypeError, ValueError) as error:
        raise ViewnetError(f"{path}: not a table with its predictions ({error}): make it again") from error


def remade(path: Path) -> Table:
    """As `read`, its cells measured again from the predictions, or ViewnetError where these are not kept."""
    if not path.with_suffix(".parquet").is_file():
        raise ViewnetError(f"{path.with_suffix('.parquet')}: no such file: make the table again")
    table = read(path)
    labels = {row.label for row in LAYOUTS[table.name].rows}
    own, added = ([e for e in table.entries if (e.row in labels) == ours] for ours in (True, False))
    about = (table.categories, table.note, table.remarks, table.renamed)
    return Table.of(table.name, own, *about, added=added)


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


def _runs(path: Path) -> dict[str, Predictions]:
    """Key of a run -> its predictions. Raises ViewnetError naming the file where it is damaged."""
    frame = read_parquet(path)
    runs = {}
    try:
        for key, rows in frame.groupby("run", observed=True):
            heads = rows.dropna(axis=1, how="all")  # columns of heads that only other runs have are empty
            runs[str(key)] = Predictions.from_frame(heads.astype(dict.fromkeys(("category", "split", "model_id"), str)))
    except (KeyError, TypeError, ViewnetError) as error:
        raise ViewnetError(f"{path}: not the predictions of a table ({error}): make it again") from error
    return runs


def _entries(
    cells: pd.DataFrame, renamed: dict[str, str], origins: dict[str, Any], runs: Mapping[str, Predictions]
) -> Iterator[Entry]:
    """The entries of a table's cells."""
    former = {new: old for old, new in renamed.items()}
    for (row, recipe, category), group in cells.groupby(["row", "recipe", "category"], sort=False):
        label = former.get(unnamed(row, recipe), unnamed(row, recipe))
        for key in group["runs"].iloc[0].split():
            origin = origins[key]
            how = (origin["seed"], origin["alignment"], key, runs[run_of(key)], origin, origin["calibration"])
            yield Entry(label, category, *how)
