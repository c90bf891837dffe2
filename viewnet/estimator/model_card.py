"""The README.md of a saved model, a model card with the hub's front matter: training, scores, usage."""

from __future__ import annotations

import json
from typing import Any

from viewnet.config import DataConfig, RunConfig
from viewnet.errors import ViewnetError

METRICS = {"acc30": "Acc@30, %", "median": "median error, degrees", "dva": "DVA, %"}
URL = (
    "https://openaccess.thecvf.com/content/ICCV2021/html/"
    "Mariotti_ViewNet_Unsupervised_Viewpoint_Estimation_From_Conditional_Generation_ICCV_2021_paper.html"
)


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
        *[line for scores in about.get("scores") or [] for line in _elsewhere(scores)],
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
        "metrics": [{"type": key, "name": name, "value": scores[key]} for key, name in METRICS.items()],
    }


def selected(scores: dict[str, Any], key: Any) -> dict[str, Any]:
    """The part of viewnet.experiments.score_model.scores that is saved with a model of the run `key`.

    ViewnetError for anything else, and for scores of another run.
    """
    try:
        run, on = scores["key"], str(scores["on"])
        alignments = {
            str(kind): {name: values[name] for name in ("images", "objects", *METRICS, "flips", "intervals")}
            | {"oracle": {"acc30": values["oracle"]["acc30"]}}
            | {"alignment": {name: values["alignment"][name] for name in ("kind", "images", "objects")}}
            for kind, values in scores["alignments"].items()
        }
    except (KeyError, TypeError, AttributeError):
        alignments = {}
    if not alignments:
        raise ViewnetError("scores: expected the output of viewnet evaluate --json on this model")
    if run != key:
        raise ViewnetError(f"scores: are of the run {run}, and the model of {key}: score this model")
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
    text = f"{views} test views of {objects} objects not used in training, aligned by a rotation fitted on {fitted} "
    text += "annotated validation views. In brackets 95 % intervals over objects."
    return [*_table({"": scores}), "", text]


def _elsewhere(scores: dict[str, Any]) -> list[str]:
    """The scores of `selected`, a column for each alignment."""
    columns = scores["alignments"]
    first = next(iter(columns.values()))
    text = f"On {scores['on']}: {first['images']} images of {first['objects']} objects. A column for each alignment, "
    text += f"fitted on {first['alignment']['images']} other annotated images"
    text += "; `own` is the rotation saved with the model, fitted on none of them." if "own" in columns else "."
    return ["", *_table(columns), "", text]


def _table(columns: dict[str, dict[str, Any]]) -> list[str]:
    """A Markdown table of scores, a column for each."""
    rows = {name: [with_interval(scores, metric) for scores in columns.values()] for metric, name in METRICS.items()}
    rows["180-degree flips, %"] = [f"{scores['flips']:.1f}" for scores in columns.values()]
    rows["best hypothesis, Acc@30, %"] = [f"{s['oracle']['acc30']:.1f}" for s in columns.values()]
    head = [f"| | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}"]
    return [*head, *(f"| {name} | {' | '.join(cells)} |" for name, cells in rows.items())]


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
