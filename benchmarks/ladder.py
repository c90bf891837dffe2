"""From the paper's recipe to ours, a step at a time: what each brings at equal data, and where the focal length goes.

    python benchmarks/ladder.py [car] [--epochs 14] [--seeds 3] [-o paper_tables/benchmarks]

Every rung keeps what those above it have and adds the settings named. All are trained by the networks, batches and
number of targets of the profile tiny under the recipe `paper`, 3,500 targets an epoch. Needs the weights of SqueezeNet
(VIEWNET_SQUEEZENET_WEIGHTS). Runs go to the run store and resume. Writes `ladder.csv`: for each rung and seed the
accuracy on *validation* views after Procrustes, the same with opposite sides taken for one, the error of the
reconstruction and the focal length, all at the end of training.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pandas as pd

from viewnet.config import RunConfig
from viewnet.evaluation.run import read_log
from viewnet.recipes import make_config
from viewnet.runs import run_store
from viewnet.runtime.files import write_csv

RUNGS: dict[str, dict[str, Any]] = {
    "paper": {},
    "learning rate 1e-3": {"learning_rate": 1e-3},
    "masks": {"mask_weight": 1.0},
    "whole views": {"crop": "none", "augment": False},
    "elevation limits": {"elevation_limits": (-22.0, 42.0)},
    "heads that start apart": {"head_spread": 0.5},
    "neighbours and pull": {"neighbours": 8.0},
    "search": {"search": 0.3},
    "shares of the selection": {"selection_temperature": 0.1},
    "pixels for features": {"perceptual": "none", "pixel_weight": 0.3},
    "optimiser": {"betas": (0.9, 0.99), "muon": 0.02, "schedule": "hold"},
    "weights chosen without labels": {"select_by": "reconstruction"},
}
"""What is added, from top to bottom, to the recipe `paper`: the last has all of `matting` but for its batches."""


def configurations(category: str, epochs: int, seeds: int) -> dict[tuple[str, int], RunConfig]:
    """Rung and seed -> how it is trained."""
    settings: dict[str, Any] = {}
    configs = {}
    for rung, added in RUNGS.items():
        settings |= added
        for seed in range(seeds):
            configs[rung, seed] = make_config(
                category=category,
                profile="tiny",
                recipe="paper",
                seed=seed,
                epochs=epochs,
                validate_every=epochs,
                **settings,
            )
    return configs


def ladder(category: str, epochs: int, seeds: int) -> pd.DataFrame:
    """A line for each rung and seed, trained where it is missing."""
    configs = configurations(category, epochs, seeds)
    runs = run_store.ensure(list(configs.values()))
    lines = []
    for (rung, seed), run in zip(configs, runs, strict=True):
        last = read_log(run.folder / "log.csv").iloc[-1]
        columns = {
            "accuracy": "val_accuracy",
            "folded": "val_folded",
            "error": "val_reconstruction",
            "focal": "val_focal",
        }
        numbers = {name: last[column] for name, column in columns.items()}
        git = run.result["git"]["commit"]
        lines.append(
            {"category": category, "rung": rung, "seed": seed, "targets": 3500 * epochs, **numbers, "git": git}
        )
    return pd.DataFrame(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("category", nargs="?", default="car")
    parser.add_argument("--epochs", type=int, default=14)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, default=Path("paper_tables/benchmarks"))
    options = parser.parse_args()
    found = ladder(options.category, options.epochs, options.seeds)
    write_csv(options.output / "ladder.csv", found.round(4))
    print(found.groupby("rung", sort=False)[["accuracy", "folded", "error", "focal"]].mean().round(3).to_string())
