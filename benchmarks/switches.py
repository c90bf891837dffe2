"""Do the optimisations of training cost accuracy? The same training with one of them undone at a time.

    python benchmarks/switches.py [--category car] [--epochs 6] [--seeds 2] [--usual 4] [--processes 2] [--switches ...]

Trains on built-in models by the recipe `matting`, one thread a process, and validates after every epoch. Writes
`switches.csv` (a row an epoch), `switches.json` (versions, machine) and `switches.{png,pdf}` to the output folder, and
prints the last accuracy, reconstruction error and seconds of each. The unchanged training runs from more seeds, since
its spread is what the others are compared with.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import pandas as pd
from torch import Tensor

from viewnet.model import volume
from viewnet.recipes import make_config
from viewnet.runtime import provenance
from viewnet.runtime.files import replacing, write_json
from viewnet.runtime.parallel import cores
from viewnet.runtime.progress import bar

USUAL = "as it is"


@contextlib.contextmanager
def _reference_renderer() -> Iterator[None]:
    with mock.patch.dict(os.environ, VIEWNET_RENDERER="reference"):
        yield


@contextlib.contextmanager
def _exact_gradients() -> Iterator[None]:
    with mock.patch.object(volume, "render", partial(_render, volume.render)):
        yield


def _render(render: Callable[..., Tensor], *arguments: Any, **options: Any) -> Tensor:
    return render(*arguments, **{**options, "sparse": False})


@contextlib.contextmanager
def _plain_layers() -> Iterator[None]:
    with mock.patch("viewnet.model.kernels.norm_relu_cpu.usable", lambda _: False):
        yield


@contextlib.contextmanager
def _full_resolution() -> Iterator[None]:
    with mock.patch("viewnet.training.matting.half_resolution", lambda model, objects, target: (objects, target)):
        yield


@contextlib.contextmanager
def _nothing() -> Iterator[None]:
    yield


Patch = Callable[[], contextlib.AbstractContextManager[None]]
SWITCHES: dict[str, tuple[dict[str, Any], Patch]] = {
    USUAL: ({}, _nothing),
    "float32": ({"amp": "off"}, _nothing),
    "renderer in PyTorch": ({}, _reference_renderer),
    "gradients of empty voxels": ({}, _exact_gradients),
    "normalisation in PyTorch": ({}, _plain_layers),
    "compared at full resolution": ({}, _full_resolution),
}
"""Optimisation undone -> changes of the configuration, and a patch of the package."""


def curve(switch: str, category: str, profile: str, epochs: int, seed: int) -> pd.DataFrame:
    """The log of one training, whose run is thrown away."""
    from viewnet.data.build import view_store
    from viewnet.training.train import train

    overrides, patch = SWITCHES[switch]
    config = make_config("viewnet", category, profile, "matting", seed, epochs=epochs, validate_every=1, **overrides)
    with tempfile.TemporaryDirectory() as folder, patch():
        train(config, view_store(config.data, progress=False), Path(folder), threads=1, progress=False)
        log = pd.read_csv(Path(folder) / "log.csv")
    log = log[["epoch", "step", "seconds", "val_accuracy", "val_reconstruction"]]
    log.insert(0, "seed", seed)
    log.insert(0, "switch", switch)
    return log


def summary(curves: pd.DataFrame) -> pd.DataFrame:
    """After the last epoch, for each switch: mean over seeds, least and most, seconds beside the usual."""
    last = curves[curves["epoch"] == curves["epoch"].max()]
    rows = last.groupby("switch", sort=False).agg(
        seeds=("seed", "count"),
        accuracy=("val_accuracy", "mean"),
        accuracy_low=("val_accuracy", "min"),
        accuracy_high=("val_accuracy", "max"),
        reconstruction=("val_reconstruction", "mean"),
        seconds=("seconds", "median"),
    )
    rows["times_as_long"] = rows["seconds"] / rows["seconds"][USUAL]
    return rows


def figure(curves: pd.DataFrame) -> Any:
    """Validation accuracy and reconstruction error over the epochs; the range of the usual training's seeds in grey."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import MaxNLocator

    shown, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for axis, column, label in (
        (axes[0], "val_accuracy", "validation views within 30°, %"),
        (axes[1], "val_reconstruction", "validation reconstruction error"),
    ):
        usual = curves[curves["switch"] == USUAL].groupby("epoch")[column]
        axis.fill_between(usual.min().index, usual.min(), usual.max(), color="0.85", label=USUAL)
        for index, (name, rows) in enumerate(curves[curves["switch"] != USUAL].groupby("switch", sort=False)):
            for number, (_, run) in enumerate(rows.groupby("seed")):
                axis.plot(run["epoch"], run[column], color=f"C{index}", lw=1, label=None if number else name)
        axis.set(xlabel="epoch", ylabel=label)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.spines[["top", "right"]].set_visible(False)
    axes[1].set_ylim(bottom=0)
    axes[0].legend(frameon=False, fontsize=7, loc="lower right")
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--category", default="car")
    parser.add_argument("--profile", default="tiny", choices=("smoke", "tiny", "small"))
    parser.add_argument("--epochs", type=int, default=6)
    parser.add_argument("--seeds", type=int, default=2, help="of each switch")
    parser.add_argument("--usual", type=int, default=4, help="seeds of the training as it is")
    parser.add_argument("--processes", type=int, default=cores())
    parser.add_argument("--switches", nargs="*", default=list(SWITCHES), choices=list(SWITCHES), metavar="SWITCH")
    parser.add_argument("-o", "--output", type=Path, default=Path("paper_tables/benchmarks"))
    given = parser.parse_args()

    from viewnet.data.build import view_store

    view_store(make_config("viewnet", given.category, given.profile, "matting").data)
    wanted = [USUAL, *(name for name in given.switches if name != USUAL)]
    jobs = [(name, seed) for name in wanted for seed in range(given.usual if name == USUAL else given.seeds)]
    curves: dict[tuple[str, int], pd.DataFrame] = {}
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(given.processes, mp_context=spawn) as pool:
        work = (given.category, given.profile, given.epochs)
        futures = {pool.submit(curve, name, *work, seed): (name, seed) for name, seed in jobs}
        for future in bar(True, iterable=as_completed(futures), total=len(futures), unit="run"):
            curves[futures[future]] = future.result()
    found = pd.concat([curves[job] for job in jobs], ignore_index=True)
    with replacing(given.output / "switches.csv") as path:
        found.to_csv(path, index=False, lineterminator="\n")
    settings = {
        "category": given.category,
        "epochs": given.epochs,
        "profile": given.profile,
        "processes": given.processes,
    }
    about = {
        "settings": settings,
        "hardware": provenance.hardware(1),
        "versions": provenance.versions(provenance.LIBRARIES),
        "git": provenance.commit(),
    }
    write_json(given.output / "switches.json", about)
    drawn = figure(found)
    for ending in ("png", "pdf"):
        drawn.savefig(given.output / f"switches.{ending}", dpi=150)
    print(summary(found).round(4).to_string())


if __name__ == "__main__":
    main()
