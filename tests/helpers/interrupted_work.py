"""Work that is disturbed: its commands, its progress, and whether its files are complete and unchanged."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nbformat
import torch
from safetensors import safe_open

from viewnet.runs.make_run import STATE
from viewnet.runtime.files import PART

PLACES = {"data": "VIEWNET_DATA", "runs": "VIEWNET_RUNS", "tables": "VIEWNET_TABLES"}
VOLATILE = {"started", "finished", "seconds", "resumed", "git"}
"""What results say of when they were made, by which commit, and of interruptions: the rest is the same each time."""

GROWING = {"log.csv", "result.json"}

DRAWING = """
from viewnet.recipes import make_config
from viewnet.data.build import view_store
view_store(make_config(category="car", profile="smoke", models={models}, image_size=64).data, {workers}, False)
"""


@dataclass(frozen=True)
class Work:
    """A command for the interpreter. `makes` are the folders it fills, `phase` returns the progress in a folder."""

    name: str
    command: tuple[str, ...]
    makes: tuple[str, ...]
    phase: Callable[[Path], str]

    def start(self, root: Path, data: Path | None = None) -> subprocess.Popen[bytes]:
        """Start or resume it in `root`, on one CPU and in a process group of its own."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith("VIEWNET_")}
        environment |= {variable: str(root / place) for place, variable in PLACES.items()}
        environment |= {"VIEWNET_DATA": str(data or root / "data"), "JUPYTER_RUNTIME_DIR": str(root / "jupyter")}
        environment |= {"CUDA_VISIBLE_DEVICES": "", "OMP_NUM_THREADS": "1", "TQDM_DISABLE": "1", "MPLBACKEND": "Agg"}
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(CHECKOUT), os.environ.get("PYTHONPATH")]))
        root.mkdir(parents=True, exist_ok=True)
        with (root / "output.txt").open("ab") as output:
            return subprocess.Popen(
                [sys.executable, *self.command],
                env=environment,
                stdout=output,
                stderr=output,
                start_new_session=True,
                preexec_fn=_on_one_processor,
            )


CHECKOUT = Path(__file__).resolve().parents[2]


def _on_one_processor() -> None:
    # With more, a training has more threads and gives other bits.
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def drawing(models: int = 160, workers: int = 2) -> Work:
    """A view store and its CAD models."""
    return Work("view store", ("-c", DRAWING.format(models=models, workers=workers)), ("data",), _drawn)


def training(epochs: int = 5) -> Work:
    """A run of the profile smoke: trained, its test views predicted and scored."""
    settings = ("-s", f"epochs={epochs}", "-s", f"patience={epochs}")
    return Work("run", ("-m", "viewnet", "train", "car", "--profile", "smoke", *settings), ("runs",), _trained)


def table() -> Work:
    """A notebook's table of two runs, which are trained side by side."""
    values = (part for value in ("profile smoke", "categories car", "workers 2") for part in ("-p", *value.split()))
    return Work("table", ("-m", "viewnet", "notebook", "table1_shapenet", *values), ("runs", "tables"), _tabled)


def _drawn(root: Path) -> str:
    stores = root / "data" / "views"
    names = os.listdir(stores) if stores.is_dir() else []
    if any(not name.startswith(".") for name in names):
        return "clearing up"
    if any(PART in name for name in names):
        return "putting together"
    return "drawing" if any((root / "data").glob("cad/*/all.csv")) else "writing CAD models"


def _trained(root: Path) -> str:
    if any(_finished(root)):
        return "clearing up"
    if any((root / "runs").glob("*/*/checkpoint.safetensors")):
        return "scoring"
    return "training, after a state" if any((root / "runs").glob(f"*/*/{STATE}")) else "training, before a state"


def _tabled(root: Path) -> str:
    if any(file.is_file() for file in files(root / "tables")):
        return "writing the table"
    begun = [path for path in (root / "runs").glob("*/*/config.json") if path.parent.parent.name != "notebooks"]
    return "training" if not begun or len(begun) > len(list(_finished(root))) else "making the table"


def _finished(root: Path) -> Iterator[Path]:
    for path in (root / "runs").glob("*/*/result.json"):
        if "metrics" in json.loads(path.read_text()):
            yield path


def files(folder: Path) -> Iterator[Path]:
    """Files that readers take for complete: neither they nor a folder around them is hidden."""
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (Path(place) / name for name in names if not name.startswith("."))


def content(file: Path) -> Any:
    """The content of a file without what is VOLATILE. Raises whatever its reader does where it is incomplete."""
    if file.suffix == ".json":
        return _steady(json.loads(file.read_text()))
    if file.name == "log.csv":
        return [_steady(row) for row in csv.DictReader(io.StringIO(file.read_text()))]
    if file.name == STATE:
        state = torch.load(file, weights_only=True)
        return sorted(state)
    if file.suffix == ".ipynb":  # its output is in the tables; the copy exists from the first cell on
        nbformat.validate(nbformat.read(file, as_version=4))
        return None
    if file.suffix == ".safetensors":  # the order of its header varies
        with safe_open(file, framework="pt") as stored:
            weights = {name: stored.get_tensor(name).numpy().tobytes() for name in sorted(stored.keys())}
            return stored.metadata(), weights
    return file.read_bytes()


def _steady(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _steady(part) for name, part in value.items() if name not in VOLATILE}
    return [_steady(part) for part in value] if isinstance(value, list) else value


def damage(root: Path, reference: Path, makes: tuple[str, ...]) -> list[str]:
    """Files that are incomplete or unexpected while work is under way or interrupted.

    What is written once must be that of the undisturbed work to the byte; what grows must be readable. A notebook's
    copy is not looked at: papermill writes it cell by cell, and it is promised at the end only.
    """
    found = []
    for file in (file for place in makes for file in files(root / place)):
        name = file.relative_to(root)
        if file.suffix == ".ipynb":
            continue
        if file.name in (*GROWING, STATE):
            found += _unreadable(name, file)
        else:
            found += _unlike(name, file, reference / name)
    return found


def differences(root: Path, reference: Path, makes: tuple[str, ...]) -> list[str]:
    """Differences between finished and undisturbed work, including temporary files left over."""
    found = []
    for place in makes:
        here, there = ({f.relative_to(base) for f in files(base / place)} for base in (root, reference))
        found += [f"{name}: is missing" for name in sorted(there - here)]
        found += [problem for name in sorted(here) for problem in _unlike(name, root / name, reference / name)]
        found += leftovers(root / place)
    return found


def _unreadable(name: Path, file: Path) -> list[str]:
    try:
        content(file)
    except Exception as error:  # each kind of file has a reader with errors of its own
        return [f"{name}: {type(error).__name__}: {str(error).splitlines()[0][:200]}"]
    return []


def _unlike(name: Path, file: Path, other: Path) -> list[str]:
    if found := _unreadable(name, file):
        return found
    if not other.is_file():
        return [f"{name}: undisturbed work has no such file"]
    return [] if content(file) == content(other) else [f"{name}: half-written, or of other content"]


def leftovers(folder: Path) -> list[str]:
    """Temporary files and folders; locks are none."""
    return [
        f"{path}: left behind"
        for place, folders, names in os.walk(folder)
        for path in (Path(place) / name for name in (*folders, *names))
        if path.name.startswith(".") and path.suffix != ".lock"
    ]
