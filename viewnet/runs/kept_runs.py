"""The runs in the run store: what each is, how far it is, what it reached, and which committed files show it."""

import contextlib
import functools
import operator
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet import paths
from viewnet.config import RunConfig, nearest, settings
from viewnet.errors import ViewnetError
from viewnet.evaluation.run import Run
from viewnet.runtime import provenance
from viewnet.runtime.files import locked, read_json

FINISHED, TRAINING, STOPPED, DAMAGED = "finished", "in training", "stopped", "damaged"
"""States of a run: all of it is there, a process is making it, the same command would go on with it, unreadable."""
MEASURED = ("reconstruction", "acc30", "median")
NAMES = ("variant", "category", "profile", "recipe", "seed")
FIELDS = ("key", *NAMES, "state", "epochs", *MEASURED, "hours", "finished", "commit", "bytes", "folder")


def listed(**wanted: str) -> pd.DataFrame:
    """Every run with these values of `NAMES`, one a row, by name: the columns are `FIELDS`.

    `epochs` are those that were logged, `reconstruction` is the least error of validation views, `acc30` (%) and
    `median` (degrees) are those of the test views by the alignment of the tables; NaN or empty where a run has none.
    """
    rows = [_row(folder) for folder in _folders()]
    rows = [row for row in rows if all(str(row[name]) == value for name, value in wanted.items())]
    table = pd.DataFrame(rows, columns=list(FIELDS))
    return table.sort_values([*NAMES, "finished", "key"], ignore_index=True)


def find(key: str) -> Path:
    """The folder of the run whose key begins with `key`. ViewnetError for none, and for several."""
    folders = _folders()
    found = [folder for folder in folders if folder.name.startswith(key)] if key else []
    if len(found) > 1:
        raise ViewnetError(f"run {key!r}: {len(found)} keys begin so: {', '.join(folder.name for folder in found)}")
    if not found:
        near = nearest(key, [folder.name for folder in folders])
        raise ViewnetError(f"run {key!r}: no such key in {paths.runs()}{near}: viewnet runs lists them")
    return found[0]


def read(folder: Path) -> Run:
    """The run in a folder. ViewnetError, which names it, for a configuration that this version does not read."""
    try:
        return Run(RunConfig.from_dict(read_json(folder / "config.json")), folder)
    except ViewnetError as error:
        raise ViewnetError(f"run {folder.name}: {error}") from error


def differences(runs: Sequence[Run]) -> pd.DataFrame:
    """The settings in which runs differ: a row a setting, a column a key."""
    values = {run.key: _settings(run) for run in runs}
    table = pd.DataFrame(values, dtype=object)
    return table[[len({repr(value) for value in row}) > 1 for row in table.to_numpy()]]


def shown_in(key: str) -> list[str]:
    """The files of paper_tables/ that show a run, relative to it."""
    shown = ((path, {name.partition("/")[0] for name in runs}) for path, runs in in_tables())
    return [path.relative_to(paths.tables()).as_posix() for path, keys in shown if key in keys]


def in_tables() -> Iterator[tuple[Path, dict[str, Any]]]:
    """The JSON files of paper_tables/, and what each says of the runs that it shows, by their names."""
    for path in sorted(paths.tables().rglob("*.json")):
        about = read_json(path)
        yield path, about.get("runs", {}) if isinstance(about, dict) else {}


def remove(folder: Path) -> int:
    """Delete a run and return how many bytes it had. ViewnetError for one that is being made, which stays."""
    with locked(folder, wait=False):
        size = _bytes(folder)
        shutil.rmtree(folder)
    return size


def _folders() -> list[Path]:
    return sorted(path.parent for path in paths.runs().glob("*/*/config.json"))


def _settings(run: Run) -> dict[str, Any]:
    """Every setting of a run by its name, and what decides a run beside settings."""
    config, found = run.config.to_dict(), {name: getattr(run.config, name) for name in NAMES}
    found |= {name: functools.reduce(operator.getitem, place, config) for name, place in settings()}
    with contextlib.suppress(ViewnetError):  # not finished yet
        found |= {"views": run.result.get("views"), "commit": _commit(run.result)}
    return found


def _row(folder: Path) -> dict[str, Any]:
    """What `listed` says of a run."""
    row: dict[str, Any] = dict.fromkeys(FIELDS, "") | dict.fromkeys(("epochs", *MEASURED, "hours"), np.nan)
    row |= {"key": folder.name, "variant": folder.parent.name, "bytes": _bytes(folder), "folder": str(folder)}
    try:
        run = read(folder)
        row |= {name: getattr(run.config, name) for name in NAMES}
        row["state"] = TRAINING if _held(folder) else STOPPED
        if (folder / "log.csv").is_file() and len(log := run.log):
            row |= {"epochs": log["epoch"].iloc[-1], "hours": log["seconds"].iloc[-1] / 3600}
            row["reconstruction"] = run.reconstruction
        if (folder / "result.json").is_file() and "metrics" in run.result:
            row |= {"state": FINISHED, "commit": _commit(run.result)}
            if training := run.result["training"]:
                row |= {"hours": training["seconds"] / 3600, "finished": training["finished"]}
            if metrics := run.result["metrics"]:
                row |= {name: metrics[run.alignment][name] for name in ("acc30", "median")}
    except (ViewnetError, LookupError, TypeError):  # of another version, or not whole
        row["state"] = DAMAGED
    return row


def _held(folder: Path) -> bool:
    """Whether a living process makes a run."""
    try:
        with locked(folder, wait=False):
            return False
    except ViewnetError as error:
        return error.__cause__ is None  # else the lock cannot be written


def _commit(result: dict[str, Any]) -> str:
    """The commit by which a run was trained, in 7 digits; with a mark where the code was changed since."""
    return provenance.in_words((result.get("training") or result).get("git") or {})


def _bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
