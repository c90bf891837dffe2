"""Scores of a finished run or of a saved model, on its own test views or on other data, by each alignment.

A saved model (viewnet.estimator.pretrained) is laid out as the run it was saved from, in a folder that passes, so that both are
scored by the same functions. Its own views are drawn again where they are not there.
"""

from __future__ import annotations

import json
import re
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.torch import save_file

from viewnet import paths
from viewnet.config import PhotoConfig, RunConfig, known
from viewnet.data import catalogue
from viewnet.data.build import photo_views
from viewnet.errors import ViewnetError
from viewnet.estimator import pretrained
from viewnet.estimator.model_card import METRICS, with_interval
from viewnet.evaluation import evaluate, features
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments.parameters import folder_named
from viewnet.experiments.photos import SMOKE_COUNT, SMOKE_MODELS
from viewnet.model import checkpoint
from viewnet.recipes import make_config
from viewnet.runtime.files import read_json, write_json
from viewnet.training import make_run, other_views
from viewnet.training.make_run import Steps

LEARNED = ("procrustes", "robust", "linear")
"""What predictions of a trained network are aligned by."""
OWN = "own"
"""The rotation that the estimator answers by: fitted on the model's own validation views, whatever is scored."""
SUBSETS = ("imagenet", "pascal", "both")


@dataclass(frozen=True)
class Elsewhere:
    """What to score on, and where a model's own data lies.

    data_root  photographs (PASCAL3D+, or images/ and viewpoints.csv) or a ShapeNetCore folder; None: own test views
    stand_in   the stand-in for photographs instead
    subset     of PASCAL3D+: imagenet, pascal or both
    cad_root   the collection that the model was trained on, where it has moved
    """

    data_root: str | None = None
    stand_in: bool = False
    subset: str = "imagenet"
    cad_root: str | None = None


def scores(
    where: str, on: Elsewhere | None = None, calibration: int | None = None, steps: Steps | None = None
) -> dict[str, Any]:
    """How a model does, as JSON values. `where`: a finished run's key or folder, or what viewnet.estimator.pretrained.load takes.

    model, name  what was asked for, and what it is
    key          of the run, or of the run that the model was saved from
    on           what was scored, in some words; of a folder the last name
    alignments   alignment -> what viewnet.evaluation.evaluate.evaluate says; of photographs also by the rotation that the
                 estimator answers by, as `OWN`

    Alignments are fitted on the model's own validation views or, where photographs are scored, on those of them that
    calibrate: on `calibration` of either (all, if None). Raises ViewnetError where there is no model, for data of no
    layout that is scored, for views that are not those that the model was trained with, and as `evaluate` does.
    """
    on, steps = on or Elsewhere(), steps or make_run.default_steps()
    known(on.subset, SUBSETS, "subset")
    with tempfile.TemporaryDirectory(prefix="viewnet-") as folder:
        run = _run(where, on.cad_root, Path(folder))
        told, predictions, calibrated_elsewhere = _predictions(run, on, steps)
        result = run.result
    kinds = LEARNED if run.trained else run.alignments
    found = {kind: evaluate.evaluate(predictions, kind, calibration) for kind in kinds}
    if calibrated_elsewhere and result["metrics"] is not None:
        rotation = np.array(result["metrics"]["procrustes"]["alignment"]["rotation"])
        found = {OWN: evaluate.evaluate(_turned(predictions, rotation), "none", calibration), **found}
    return {
        "model": where,
        "name": run.name,
        "key": result.get("key"),
        "on": told,
        "alignments": found,
    }


def as_text(found: dict[str, Any]) -> str:
    """`scores` for reading: a line an alignment."""
    scored = next(iter(found["alignments"].values()))
    fitted = scored["alignment"]
    rows = [("aligned", "within 30, %", "median, degrees", "DVA, %", "flips, %", "best of the heads, %")]
    for kind, score in found["alignments"].items():
        told = [with_interval(score, name) for name in METRICS]
        rows.append((kind, *told, f"{score['flips']:.1f}", f"{score['oracle']['acc30']:.1f}"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        f"{found['name']}: {found['model']}",
        f"  {found['on']}: {scored['images']} of {scored['objects']} objects; aligned on {fitted['images']} of "
        f"{fitted['objects']}; [95 % intervals over objects]",
        *("  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows),
    ]
    return "\n".join(lines)


def _run(where: str, cad_root: str | None, folder: Path) -> Run:
    """The finished run of a key or folder, or a saved model laid out as one in `folder`."""
    keyed = sorted(paths.runs().glob(f"*/{where}")) if re.fullmatch("[0-9a-f]{12}", where) else []
    for place in (Path(where).expanduser(), *keyed):
        if (place / "result.json").is_file():
            config = RunConfig.from_dict(read_json(place / "config.json"))
            return Run(_rooted(config, cad_root), place)
    model = pretrained.load(where)
    config = _rooted(model.config, cad_root)
    weights = {name: value.contiguous() for name, value in model.network.state_dict().items()}
    save_file(weights, folder / checkpoint.CHECKPOINT, metadata={"config": json.dumps(config.to_dict())})
    write_json(folder / "config.json", config.to_dict())
    write_json(folder / "result.json", {"metrics": None} | model.about)
    return Run(config, folder)


def _rooted(config: RunConfig, cad_root: str | None) -> RunConfig:
    """The same with the collection it was trained on elsewhere."""
    if cad_root is None:
        return config
    return replace(config, data=replace(config.data, root=folder_named(cad_root, "cad_root")))


def _turned(predictions: Predictions, rotation: np.ndarray) -> Predictions:
    """The same in the frame that `rotation` (3, 3) leads to."""
    ups = None if predictions.ups is None else predictions.ups @ rotation.T
    return replace(predictions, hypotheses=predictions.hypotheses @ rotation.T, ups=ups)


def _predictions(run: Run, on: Elsewhere, steps: Steps) -> tuple[str, Predictions, bool]:
    """What is scored, in some words; what the run says of it: "val" to align on, "test" to score.

    And whether that "val" is of what is scored, and not of the run's own views.
    """
    config, root, named = run.config, None, "a stand-in for photographs"
    if on.data_root is None and not on.stand_in:
        return "its own test views", _own(run, steps).predictions, False
    if on.data_root is not None:
        root, name = folder_named(on.data_root, "data_root"), Path(on.data_root).name
        named = f"photographs of {name}"
        kind = catalogue.recognise(Path(on.data_root))
        if kind == "shapenet":
            data = make_config(
                category=config.category, profile=config.profile, recipe=config.recipe, data_root=root
            ).data
            return f"all models of {name}", other_views.transferred(_own(run, steps), steps.views(data), steps), False
        if kind not in ("pascal3d", "photographs"):
            raise ViewnetError(
                f"data_root {on.data_root}: is {kind}, whose viewpoints are not scored: name PASCAL3D+, a folder with "
                "images/ and viewpoints.csv, or a ShapeNetCore folder"
            )
    photographs = PhotoConfig(
        category=config.category,
        root=root,
        subset=on.subset,  # type: ignore[arg-type]
        size=features.SIZE,
        square=config.model.crop != "stretched",
    )
    if root is None and config.profile == "smoke":
        photographs = replace(photographs, models=SMOKE_MODELS, count=SMOKE_COUNT)
    return named, other_views.on_photographs(run, photo_views(photographs), steps), True


def _own(run: Run, steps: Steps) -> Run:
    """The same run, with predictions of its own views: made where it was laid out from a saved model."""
    if run.scored and not (run.folder / "predictions.parquet").is_file():
        views = steps.views(run.config.data)
        if views.identity != run.result.get("views"):
            raise ViewnetError(
                f"{run.name}: the views of its configuration are not those it was trained with: name the "
                "collection it was trained on (cad_root), or other data (data_root)"
            )
        steps.predict(run.folder, views, splits=("val", "test")).to_parquet(run.folder / "predictions.parquet")
    return run
