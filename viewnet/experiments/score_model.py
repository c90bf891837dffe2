"""Scores of a finished run or a saved model, on its own test views or on other data, by each alignment.

A saved model is laid out as the run it was saved from, in a temporary folder, so that both are scored by the same
functions. Its own views are rendered again where they are missing.
"""

import json
import re
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.torch import save_file

from viewnet import paths
from viewnet.config import RunConfig, known
from viewnet.data import build, catalogue
from viewnet.data.readers.registry import READERS
from viewnet.errors import ViewnetError
from viewnet.estimator import pretrained
from viewnet.estimator.model_card import METRICS, with_interval
from viewnet.evaluation.evaluate import evaluate
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import LEARNED_ALIGNMENTS, Run
from viewnet.experiments import photos
from viewnet.experiments.parameters import SUBSETS, folder_named
from viewnet.model import checkpoint
from viewnet.recipes import PEERS, make_config
from viewnet.runs import make_run, other_views
from viewnet.runtime.files import read_json, write_json
from viewnet.tables.benchmark import aligned

LEARNED = ("procrustes", "robust", "linear")  # the alignments of a trained network's predictions
OWN = "own"  # the rotation saved with a model: fitted on its own validation views, whatever is scored
HEADER = ("aligned", "within 30, %", "median, degrees", "DVA, %", "flips, %", "best of the heads, %")


@dataclass(frozen=True)
class ScoredData:
    """What to score on, and where the model's own data is."""

    data_root: str | None = None  # photographs or a ShapeNetCore folder; None: the model's own test views
    stand_in: bool = False  # the stand-in for photographs instead
    subset: str = "imagenet"  # of PASCAL3D+: imagenet, pascal or both
    cad_root: str | None = None  # the collection that the model was trained on, if it has moved


def scores(
    where: str, data: ScoredData | None = None, calibration: int | None = None, steps: make_run.Steps | None = None
) -> dict[str, Any]:
    """The scores of a model as JSON values; `where` is a run's key or folder, or what pretrained.load takes.

    model, name, key  `where`; the name and key of the run, or of the run that the model was saved from
    on                what was scored, in words; of a folder the last name
    alignments        alignment -> the result of viewnet.evaluation.evaluate.evaluate; of photographs also for `OWN`

    Alignments are fitted on `calibration` images (None: all) of the model's own validation views, or of photographs'
    calibration split. Raises ViewnetError where there is no model, for data that cannot be scored, for views that are
    not those that the model was trained with, and as `evaluate` does.
    """
    data, steps = data or ScoredData(), steps or make_run.default_steps()
    known(data.subset, SUBSETS, "subset")  # before anything is rendered
    with tempfile.TemporaryDirectory(prefix="viewnet-") as folder:
        run = _run(where, data.cad_root, Path(folder))
        description, predictions, is_photographs = _predictions(run, data, steps)
        result = run.result  # the folder is gone after the block
    own_frame = run.alignments == LEARNED_ALIGNMENTS
    kinds = LEARNED if own_frame else run.alignments  # else predictions are in the annotated frame already
    alignments = {kind: evaluate(predictions, kind, calibration) for kind in kinds}
    if is_photographs and own_frame and result["metrics"] is not None:
        # What a user of the model gets: no label of the photographs is used.
        back = np.array(result["metrics"]["procrustes"]["alignment"]["rotation"]).T
        ups = None if predictions.ups is None else predictions.ups @ back
        rotated = replace(predictions, hypotheses=predictions.hypotheses @ back, ups=ups)
        alignments = {OWN: evaluate(rotated, "none", calibration), **alignments}
    about = {"model": where, "name": run.name, "key": result.get("key"), "on": description}
    return about | {"alignments": alignments}


def as_text(scores: dict[str, Any]) -> str:
    """The result of `scores` as a table, one line an alignment."""
    first = next(iter(scores["alignments"].values()))  # all are of the same images
    fitted = first["alignment"]
    rows = [
        (kind, *(with_interval(s, name) for name in METRICS), f"{s['flips']:.1f}", f"{s['oracle']['acc30']:.1f}")
        for kind, s in scores["alignments"].items()
    ]
    lines = [
        f"{scores['name']}: {scores['model']}",
        f"  {scores['on']}: {first['images']} of {first['objects']} objects; aligned on {fitted['images']} of "
        f"{fitted['objects']}; [95 % intervals over objects]",
    ]
    return "\n".join([*lines, *("  " + row for row in aligned([HEADER, *rows], len(HEADER)))])


def _run(where: str, cad_root: str | None, folder: Path) -> Run:
    """The finished run of a key or folder, or a saved model laid out as one in `folder`."""
    keyed = sorted(paths.runs().glob(f"*/{where}")) if re.fullmatch("[0-9a-f]{12}", where) else []
    for place in (Path(where).expanduser(), *keyed):
        if (place / "result.json").is_file():
            return Run(_moved(RunConfig.from_dict(read_json(place / "config.json")), cad_root), place)
    model = pretrained.load(where)  # no finished run, so a saved model
    config = _moved(model.config, cad_root)
    # As safetensors wants them.
    weights = {name: value.contiguous() for name, value in model.network.state_dict().items()}
    save_file(weights, folder / checkpoint.CHECKPOINT, metadata={"config": json.dumps(config.to_dict())})
    write_json(folder / "config.json", config.to_dict())
    write_json(folder / "result.json", {"metrics": None} | model.about)  # no metrics: of videos without viewpoints
    return Run(config, folder)


def _moved(config: RunConfig, cad_root: str | None) -> RunConfig:
    """The same with the collection it was trained on in `cad_root`, if given."""
    root = config.data.root if cad_root is None else folder_named(cad_root, "cad_root")
    return replace(config, data=replace(config.data, root=root))


def _predictions(run: Run, data: ScoredData, steps: make_run.Steps) -> tuple[str, Predictions, bool]:
    """What is scored, in words; the predictions, of "val" to align on and "test" to score; whether of photographs."""
    config, root, description = run.config, None, "a stand-in for photographs"
    if data.data_root is None and not data.stand_in:
        return "its own test views", _own(run, steps).predictions, False
    if data.data_root is not None:
        root, name = folder_named(data.data_root, "data_root"), Path(data.data_root).name
        description = f"photographs of {name}"
        kind = catalogue.recognise(Path(data.data_root))  # by what is in it, whatever its name
        if kind == "shapenet":
            variant = config.variant if config.variant in PEERS else "viewnet"
            other = make_config(variant, config.category, config.profile, config.recipe, data_root=root).data
            views = steps.views(other)  # rendered as the model's own, so that only the objects differ
            return f"all models of {name}", other_views.transferred(_own(run, steps), views, steps), False
        if READERS[kind].photographs is None:
            expected = "name PASCAL3D+, ImageNet3D, photographs or crops with a list, or a ShapeNetCore folder"
            raise ViewnetError(f"data_root {data.data_root}: is {kind}, whose viewpoints are not scored: {expected}")
    square = config.model.crop != "stretched"  # photographs are cut as the network was trained on views
    smoke = root is None and config.profile == "smoke"
    store = build.photo_views(photos.photographs(config.category, root, square, smoke, subset=data.subset))
    return description, other_views.on_photographs(run, store, steps), True


def _own(run: Run, steps: make_run.Steps) -> Run:
    """The same run, with predictions of its own views: made where it was laid out from a saved model."""
    if run.scored and not (run.folder / "predictions.parquet").is_file():
        views = steps.views(run.config.data)
        if views.identity != run.result.get("views"):  # a model trained on some of them would be scored on these
            remedy = "name the collection it was trained on (cad_root), or other data (data_root)"
            raise ViewnetError(f"{run.name}: its configuration's views are not those it was trained with: {remedy}")
        steps.predict(run.folder, views, splits=("val", "test")).to_parquet(run.folder / "predictions.parquet")
    return run
