"""The README.md of a saved model, a model card with the hub's front matter: training, scores, usage."""

from __future__ import annotations

import json
from typing import Any

from viewnet.config import DataConfig, RunConfig
from viewnet.errors import ViewnetError

METRICS = {"acc30": "Acc@30, %", "median": "median error, degrees", "dva": "DVA, %"}
URL = "https://openaccess.thecvf.com/content/ICCV2021/html/Mariotti_ViewNet_Unsupervised_Viewpoint_Estimation_From_Conditional_Generation_ICCV_2021_paper.html"


def card(config: RunConfig, aligned: bool, about: dict[str, Any], license: str | None = None) -> str:
    """Markdown with the hub's front matter. `about` is what a saved model keeps of its run's result and scores."""
    name = f"{config.variant} {config.category}"
    scores = (about.get("metrics") or {}).get("procrustes")
    licence = license or ("mit" if _ours(config.data) else "other")
    front: dict[str, Any] = {
        "license": licence,
        "library_name": "viewnet",
        "tags": ["viewnet", "viewpoint-estimation", "pose-estimation", "unsupervised", config.category],
    }
    if scores:
        front["model-index"] = [{"name": name, "results": [_result(config, scores)]}]
    lines = [
        "---",
        # JSON is valid YAML, without YAML's ambiguous scalars.
        *(f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in front.items()),
        "---",
        "",
        f"# ViewNet: viewpoint estimation for the category {config.category}",
        "",
        f"Estimates the camera viewpoint of an image of one {config.category}. Trained without viewpoint labels, on "
        f"pairs of images of the same object ([ViewNet, ICCV 2021]({URL})), with `viewnet`, a replication.",
        "",
        "| | |",
        "|---|---|",
        f"| trained on | {_data(config.data)} |",
        f"| variant, recipe, profile, seed | {config.variant}, {config.recipe}, {config.profile}, {config.seed} |",
        f"| input | {config.model.input_size} x {config.model.input_size} pixels, crop {config.model.crop} |",
        f"| frame of predictions | {'annotated' if aligned else 'its own, not aligned'} |",
        f"| run | {about.get('key', 'unknown')} |",
        f"| licence of the weights | {licence} |",
        "",
        "## Scores",
        "",
        *_scores(scores),
        *[line for found in about.get("scores") or [] for line in _elsewhere(found)],
        "",
        "## Usage",
        "",
        "```python",
        "from viewnet.estimator import ViewpointEstimator",
        "",
        'estimator = ViewpointEstimator.from_pretrained("FOLDER OR NAME/MODEL")',
        'print(estimator.predict("image.jpg", boxes=(40, 60, 380, 250)))',
        "```",
        "",
        "Angles are in degrees. Azimuth 0 shows the object's front, 90 its left side; elevation is above the horizon."
        if aligned
        else "The model's own frame is arbitrary: only differences between viewpoints mean anything.",
        "The model was trained on this category only, and gives a prediction for any image.",
    ]
    return "\n".join([*lines, ""])


def _result(config: RunConfig, scores: dict[str, Any]) -> dict[str, Any]:
    return {
        "task": {"type": "viewpoint-estimation", "name": "Viewpoint estimation"},
        "dataset": {"type": "views", "name": f"test views of {_data(config.data)}"},
        "metrics": [{"type": key, "name": told, "value": scores[key]} for key, told in METRICS.items()],
    }


def selected(scores: dict[str, Any], key: Any) -> dict[str, Any]:
    """Of viewnet.experiments.score_model.scores what goes along with a model of the run `key`.

    ViewnetError for anything else, and for scores of another run.
    """
    unlike = ViewnetError("scores: expected what viewnet evaluate --json says of a model")
    try:
        whose, on = scores["key"], str(scores["on"])
        alignments = {
            str(kind): {name: found[name] for name in ("images", "objects", *METRICS, "flips", "intervals")}
            | {"oracle": {"acc30": found["oracle"]["acc30"]}}
            | {"alignment": {name: found["alignment"][name] for name in ("kind", "images", "objects")}}
            for kind, found in scores["alignments"].items()
        }
    except (KeyError, TypeError, AttributeError):
        raise unlike from None
    if not alignments:
        raise unlike
    if whose != key:
        raise ViewnetError(f"scores: are of the run {whose}, and the model of {key}: score this model")
    return {"on": on, "alignments": alignments}


def with_interval(scores: dict[str, Any], metric: str) -> str:
    """A metric of viewnet.evaluation.evaluate.evaluate, with its interval if it has one.

    >>> with_interval({"acc30": 71.04, "intervals": {"acc30": [67.4, 74.3]}}, "acc30")
    '71.0 [67.4, 74.3]'
    """
    bounds = (scores.get("intervals") or {}).get(metric)
    return f"{scores[metric]:.1f}" + (f" [{bounds[0]:.1f}, {bounds[1]:.1f}]" if bounds else "")


def _scores(scores: dict[str, Any] | None) -> list[str]:
    if not scores:
        return ["Not scored: the test views have no annotated viewpoints."]
    views, objects, fitted = scores["images"], scores["objects"], scores["alignment"]["images"]
    told = f"{views} test views of {objects} objects not used in training, aligned by a rotation fitted on {fitted} "
    told += "annotated validation views. In brackets 95 % intervals over objects."
    return [*_table({"": scores}), "", told]


def _elsewhere(found: dict[str, Any]) -> list[str]:
    """What `selected` keeps, a column an alignment."""
    columns = found["alignments"]
    scores = next(iter(columns.values()))
    fitted = scores["alignment"]["images"]
    told = f"On {found['on']}: {scores['images']} images of {scores['objects']} objects. A column for each alignment, "
    told += f"fitted on {fitted} other annotated images"
    told += "; `own` is the rotation saved with the model, fitted on none of them." if "own" in columns else "."
    return ["", *_table(columns), "", told]


def _table(columns: dict[str, dict[str, Any]]) -> list[str]:
    """The scores of a dictionary, each below its name."""
    rows = {told: [with_interval(scores, metric) for scores in columns.values()] for metric, told in METRICS.items()}
    rows["180-degree flips, %"] = [f"{scores['flips']:.1f}" for scores in columns.values()]
    rows["best hypothesis, Acc@30, %"] = [f"{s['oracle']['acc30']:.1f}" for s in columns.values()]
    head = [f"| | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}"]
    return [*head, *(f"| {told} | {' | '.join(cells)} |" for told, cells in rows.items())]


def _ours(data: DataConfig) -> bool:
    """Whether everything it was trained on comes with the project."""
    places = (data.root, data.extra, data.video.root if data.video else None)
    return not any(places) and data.backgrounds in (None, "drawn")


def _data(data: DataConfig) -> str:
    if data.video is not None:
        return f"videos of one {data.category} each ({data.video.root or 'the built-in stand-in'})"
    models = "viewnet's built-in CAD models" if data.root is None else f"CAD models ({data.root})"
    behind = f" over backgrounds ({data.backgrounds})" if data.backgrounds else ""
    return f"{models}{', and more' if data.extra else ''}{behind}"
