"""Runs and renderers of untrained networks of the profile smoke, on synthetic views."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from viewnet.config import RunConfig
from viewnet.data.store import ViewStore
from viewnet.evaluation.alignment import Procrustes
from viewnet.evaluation.evaluate import align, evaluate
from viewnet.evaluation.predict import predict
from viewnet.evaluation.run import Run
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.runs.make_run import SCHEMA
from viewnet.runtime.files import write_json
from viewnet.tables.run_renderer import RunRenderer

LOG = """epoch,step,seconds,loss,val_reconstruction,val_accuracy,pixels,masks
1,9,1,2.5,0.4,20,0.5,2
2,18,2,1.5,0.2,60,0.5,1
"""


def untrained_run(folder: Path, variant: str = "viewnet", seed: int = 0, **overrides: object) -> Run:
    """A run folder as training leaves it, without the training."""
    config = make_config(variant, profile="smoke", seed=seed, **overrides)
    torch.manual_seed(seed)
    model = ViewNet(config.model)
    folder.mkdir(parents=True)
    weights = {name: value.contiguous() for name, value in model.state_dict().items()}
    save_file(weights, folder / "checkpoint.safetensors", metadata={"config": json.dumps(config.to_dict())})
    write_json(folder / "config.json", config.to_dict())
    (folder / "log.csv").write_text(LOG)
    return Run(config, folder)


def finished_run(folder: Path, store: ViewStore | None, variant: str = "viewnet", **overrides: object) -> Run:
    """`untrained_run` with its predictions and scores on `store`; None: on views that cannot be scored."""
    run = untrained_run(folder, variant, **overrides)
    result = {"schema": SCHEMA, "key": run.key, "variant": variant, "metrics": None}
    if store is not None:
        predicted = predict(run.folder, store)
        predicted.to_parquet(folder / "predictions.parquet")
        metrics = {kind: evaluate(predicted, kind, draws=20) for kind in ("procrustes", "linear")}
        result |= {"views": store.identity, "metrics": metrics}
    write_json(folder / "result.json", result)
    return run


def untrained_renderer(store: ViewStore, rotation: np.ndarray | None = None, **overrides: object) -> RunRenderer:
    """A network in memory, its alignment replaced by a `rotation` (3, 3) of our choice where one is given."""
    config: RunConfig = make_config(profile="smoke", **overrides)
    torch.manual_seed(0)
    network = ViewNet(config.model).eval()
    aligned = align(predict(network, store))
    if rotation is not None:
        aligned = replace(aligned, alignment=Procrustes(rotation))
    return RunRenderer(network, config, store, aligned)


def turned(degrees: float) -> np.ndarray:
    """The rotation about the vertical axis that adds an angle to azimuths."""
    a = np.deg2rad(degrees)
    return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
