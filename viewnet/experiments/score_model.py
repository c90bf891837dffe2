"""Scores of a finished run or a saved model, on its own test views or on other data, by each alignment.

A saved model is laid out as the run it was saved from, in a temporary folder, so that both are scored by the same
functions. Its own views are rendered again where they are missing.
"""

import json
import re
import tempfile
from dataclasses import dataclass
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
from viewnet.estimator.model_card import METRICS, columns, own, with_interval
from viewnet.evaluation.alignment import MINIMUM
from viewnet.evaluation.confidence import calibration_error
from viewnet.evaluation.evaluate import align, calibrating, evaluate
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import LEARNED_ALIGNMENTS, Run
from viewnet.evaluation.support import support
from viewnet.evaluation.symmetry import symmetry
from viewnet.experiments import photos
from viewnet.experiments.calibrated import answers, turned
from viewnet.experiments.distilled import moved
from viewnet.experiments.parameters import SUBSETS, folder_named
from viewnet.model import checkpoint
from viewnet.recipes import PEERS, make_config
from viewnet.runs import make_run, other_views
from viewnet.runtime.files import read_json, write_json
from viewnet.tables.benchmark import aligned

LEARNED = ("procrustes", "robust", "linear")  # the alignments of a trained network's predictions
OWN = "own"  # the rotation saved with a model: fitted on its own validation views, whatever is scored
HEADER = ("aligned", "within 30, %", "median, degrees", "DVA, %", "flips, %", "best of the heads, %")
SUPPORT = ("left out, %", "uncertain by, degrees")  # see viewnet.evaluation.support


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
    alignments        alignment -> the result of viewnet.evaluation.evaluate.evaluate; of other data also for `OWN`;
                      of photographs with its "support" (viewnet.evaluation.support)
    choose            of photographs the alignment to take: the first one, unless another is right on more of the
                      calibration images that it was not fitted on, by more than chance can be (two standard errors)
    confidence        its mean in per cent and its expected calibration error in points, by the first alignment: by
                      `OWN` what viewnet predict says; None of single hypotheses

    Alignments are fitted on `calibration` images (None: all) of the model's own validation views, or of photographs'
    calibration split; with fewer than four of these there is `OWN` alone. Raises ViewnetError where there is no model,
    for data that cannot be scored, for views other than those that the model was trained with, and as `evaluate` does.
    """
    data, steps = data or ScoredData(), steps or make_run.default_steps()
    known(data.subset, SUBSETS, "subset")  # before anything is rendered
    with tempfile.TemporaryDirectory(prefix="viewnet-") as folder:
        run = _run(where, data.cad_root, Path(folder))
        description, predictions, where_from = _predictions(run, data, steps)
        result = run.result  # the folder is gone after the block
    own_frame = run.alignments == LEARNED_ALIGNMENTS
    kinds = LEARNED if own_frame else run.alignments  # else predictions are in the annotated frame already
    if own_frame and (symmetric := symmetry(run.config.category).alignment):
        kinds = (symmetric,)  # such a category determines no other
    by_kind = {kind: (predictions, kind) for kind in kinds}
    if where_from != "own views" and own_frame and result["metrics"] is not None:
        # What a user of the model gets: no label of the photographs is used.
        rotation = np.array(own(result["metrics"])["alignment"]["rotation"])
        by_kind = {OWN: (turned(predictions, rotation), "none"), **by_kind}
    if where_from == "photographs" and (predictions.ids["split"] == "val").sum() < MINIMUM:
        by_kind = {name: how for name, how in by_kind.items() if how[1] == "none"}
        if not by_kind:
            remedy = f"{run.name} has no rotation of its own: give {MINIMUM} or more"
            raise ViewnetError(f"{description}: too few to calibrate on, and {remedy}")
    found = {name: evaluate(said, kind, calibration) for name, (said, kind) in by_kind.items()}
    choose = choice(found, by_kind, calibration) if where_from == "photographs" else None
    about = {"model": where, "name": run.name, "key": result.get("key"), "on": description}
    said, kind = next(iter(by_kind.values()))
    confidence: dict[str, float] | None = None
    if said.heads > 1:
        sure, right = answers(align(said, kind, calibration))
        confidence = {"mean": 100 * float(sure.mean()), "error": calibration_error(sure, right)}
    return about | {"alignments": found, "choose": choose, "confidence": confidence}


def choice(
    found: dict[str, dict[str, Any]], by_kind: dict[str, tuple[Predictions, str]], calibration: int | None
) -> str:
    """The alignment that calibration images support, see `scores`; what it found joins `found`."""
    first = choose = next(iter(found))
    if len(found) == 1:  # nothing to choose from, and perhaps no calibration images
        return first
    for name, (said, kind) in by_kind.items():
        rows = calibrating(said, calibration)
        found[name]["support"] = support(rows, kind)
        right = {each: found[each]["support"]["acc30"] for each in (name, first, choose)}
        if right[name] > max(right[choose], right[first] + 100 / np.sqrt(len(set(rows.objects)))):
            choose = name
    return choose


def as_text(scores: dict[str, Any]) -> str:
    """The result of `scores` as a table, one line an alignment."""
    found = scores["alignments"]
    first = next(iter(found.values()))  # all are of the same images
    fitted, header = first["alignment"], HEADER + (SUPPORT if "support" in first else ())
    rows = [
        (kind, *(with_interval(s, name) for name in METRICS), f"{s['flips']:.1f}", *_further(s))[: len(header)]
        for kind, s in columns(found).items()
    ]
    calibrated = f"aligned on {fitted['images']} of {fitted['objects']}" if fitted["images"] else "none to calibrate on"
    images = f"{first['images']} of {first['objects']} objects"
    lines = [
        f"{scores['name']}: {scores['model']}",
        f"  {scores['on']}: {images}; {calibrated}; [95 % intervals over objects]",
        *("  " + row for row in aligned([header, *rows], len(header))),
    ]
    if sure := scores["confidence"]:
        average = f"confidence {sure['mean']:.1f} % on average"
        lines.append(f"  {average}; expected calibration error {sure['error']:.1f} points")
    if "support" in first:
        right = {name: score["support"]["acc30"] for name, score in found.items()}
        lines.append(f"  take {scores['choose']}; left out: calibration images that a fit to others has right")
        if worse := [name for name, value in right.items() if value < right.get(OWN, 0)]:
            lines.append(f"  worse than the model's own rotation: {', '.join(worse)}: calibrate on more images")
    return "\n".join(lines)


def _further(scores: dict[str, Any]) -> tuple[str, ...]:
    """The last three cells of a line; scores up to a symmetry have none of them."""
    support = scores.get("support", {})
    numbers = (scores.get("oracle", {}).get("acc30"), support.get("acc30"), support.get("uncertainty"))
    return tuple("" if number is None else f"{number:.1f}" for number in numbers)


def _run(where: str, cad_root: str | None, folder: Path) -> Run:
    """The finished run of a key or folder, or a saved model laid out as one in `folder`."""
    keyed = sorted(paths.runs().glob(f"*/{where}")) if re.fullmatch("[0-9a-f]{12}", where) else []
    for place in (paths.named(where, "model"), *keyed):
        if (place / "result.json").is_file():
            return Run(moved(RunConfig.from_dict(read_json(place / "config.json")), cad_root), place)
    model = pretrained.load(where)  # no finished run, so a saved model
    config = moved(model.config, cad_root)
    # As safetensors wants them.
    weights = {name: value.contiguous() for name, value in model.network.state_dict().items()}
    save_file(weights, folder / checkpoint.CHECKPOINT, metadata={"config": json.dumps(config.to_dict())})
    write_json(folder / "config.json", config.to_dict())
    write_json(folder / "result.json", {"metrics": None} | model.about)  # no metrics: of videos without viewpoints
    return Run(config, folder)


def _predictions(run: Run, data: ScoredData, steps: make_run.Steps) -> tuple[str, Predictions, str]:
    """What is scored, in words; the predictions, of "val" to align on and "test" to score; and what these are of.

    That is "own views", "CAD models" or "photographs".
    """
    config, root, description = run.config, None, "a stand-in for photographs"
    if data.data_root is None and not data.stand_in:
        return "its own test views", _own(run, steps).predictions, "own views"
    if data.data_root is not None:
        root, name = folder_named(data.data_root, "data_root"), Path(data.data_root).name
        description = f"photographs of {name}"
        kind = catalogue.recognise(Path(data.data_root))  # by what is in it, whatever its name
        if kind == "shapenet":
            variant = config.variant if config.variant in PEERS else "viewnet"
            other = make_config(variant, config.category, config.profile, config.recipe, data_root=root).data
            views = steps.views(other)  # rendered as the model's own, so that only the objects differ
            return f"all models of {name}", other_views.transferred(_own(run, steps), views, steps), "CAD models"
        if READERS[kind].photographs is None:
            expected = "name PASCAL3D+, ImageNet3D, photographs or crops with a list, or a ShapeNetCore folder"
            raise ViewnetError(f"data_root {data.data_root}: is {kind}, whose viewpoints are not scored: {expected}")
    square = config.model.crop != "stretched"  # photographs are cut as the network was trained on views
    smoke = root is None and config.profile == "smoke"
    store = build.photo_views(photos.photographs(config.category, root, square, smoke, subset=data.subset))
    return description, other_views.on_photographs(run, store, steps), "photographs"


def _own(run: Run, steps: make_run.Steps) -> Run:
    """The same run, with predictions of its own views: made where it was laid out from a saved model."""
    if run.scored and not (run.folder / "predictions.parquet").is_file():
        views = steps.views(run.config.data)
        if views.identity != run.result.get("views"):  # a model trained on some of them would be scored on these
            remedy = "name the collection it was trained on (cad_root), or other data (data_root)"
            raise ViewnetError(f"{run.name}: its configuration's views are not those it was trained with: {remedy}")
        steps.predict(run.folder, views, splits=("val", "test")).to_parquet(run.folder / "predictions.parquet")
    return run
