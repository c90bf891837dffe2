"""The README.md of a saved model: what it is, how well it does and how it is used, in the hub's form."""

from __future__ import annotations

import json
from typing import Any

from viewnet.config import DataConfig, RunConfig
from viewnet.errors import ViewnetError

METRICS = {"acc30": "within 30 degrees, %", "median": "median error, degrees", "dva": "DVA, %"}
URL = "https://openaccess.thecvf.com/content/ICCV2021/html/Mariotti_ViewNet_Unsupervised_Viewpoint_Estimation_From_Conditional_Generation_ICCV_2021_paper.html"


def card(config: RunConfig, aligned: bool, about: dict[str, Any], license: str | None = None) -> str:
    """Markdown with the hub's front matter. `about` is what viewnet.estimator.hub keeps of a run's result and scores."""
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
        # JSON is YAML, and there is nothing in it to be mistaken.
        *(f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in front.items()),
        "---",
        "",
        f"# ViewNet: the viewpoint of a {config.category}",
        "",
        f"From which direction an image shows a {config.category}, learned without viewpoints from pairs of images "
        f"of the same object ([ViewNet, ICCV 2021]({URL})). Trained with `viewnet`, a replication.",
        "",
        "| | |",
        "|---|---|",
        f"| trained on | {_data(config.data)} |",
        f"| variant, recipe, profile, seed | {config.variant}, {config.recipe}, {config.profile}, {config.seed} |",
        f"| sees | {config.model.input_size} x {config.model.input_size} pixels, crop {config.model.crop} |",
        f"| answers in | {'the annotated frame' if aligned else 'its own frame: it is aligned to none'} |",
        f"| run | {about.get('key', 'unknown')} |",
        f"| licence of the weights | {licence} |",
        "",
        "## How well it does",
        "",
        *_scores(scores),
        *[line for found in about.get("scores") or [] for line in _elsewhere(found)],
        "",
        "## How to use it",
        "",
        "```python",
        "from viewnet.estimator.viewpoint_estimator import ViewpointEstimator",
        "",
        'estimator = ViewpointEstimator.from_pretrained("FOLDER OR NAME/MODEL")',
        'print(estimator.predict("image.jpg", boxes=(40, 60, 380, 250)))',
        "```",
        "",
        "Azimuth 0 shows the object's front and 90 its left side; elevation is the height above the horizon; degrees."
        if aligned
        else "Azimuth 0 and the up of its own frame are arbitrary: only differences between viewpoints tell something.",
        "It knows this category alone, and answers for any image.",
    ]
    return "\n".join([*lines, ""])


def _result(config: RunConfig, scores: dict[str, Any]) -> dict[str, Any]:
    return {
        "task": {"type": "viewpoint-estimation", "name": "Viewpoint estimation"},
        "dataset": {"type": "views", "name": f"test views of {_data(config.data)}"},
        "metrics": [{"type": key, "name": told, "value": scores[key]} for key, told in METRICS.items()],
    }


def kept(scores: dict[str, Any], key: Any) -> dict[str, Any]:
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
        return ["Its own views have no annotated viewpoints: it was not scored."]
    views, objects, fitted = scores["images"], scores["objects"], scores["alignment"]["images"]
    told = f"On {views} test views of {objects} objects that it has not seen, after a rotation fitted on {fitted} "
    told += "annotated validation views. In brackets 95 % intervals over objects."
    return [*_table({"": scores}), "", told]


def _elsewhere(found: dict[str, Any]) -> list[str]:
    """What `kept` keeps, a column an alignment."""
    columns = found["alignments"]
    scores = next(iter(columns.values()))
    fitted = scores["alignment"]["images"]
    told = f"On {found['on']}: {scores['images']} images of {scores['objects']} objects, after each of these "
    told += f"alignments, fitted on {fitted} other annotated images"
    told += (
        "; but for `own`, the rotation of the model as it is, which has seen none of them." if "own" in columns else "."
    )
    return ["", *_table(columns), "", told]


def _table(columns: dict[str, dict[str, Any]]) -> list[str]:
    """The scores of a dictionary, each below its name."""
    rows = {told: [with_interval(scores, metric) for scores in columns.values()] for metric, told in METRICS.items()}
    rows["half turns, %"] = [f"{scores['flips']:.1f}" for scores in columns.values()]
    rows["the best hypothesis within 30 degrees, %"] = [f"{s['oracle']['acc30']:.1f}" for s in columns.values()]
    head = [f"| | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}"]
    return [*head, *(f"| {told} | {' | '.join(cells)} |" for told, cells in rows.items())]


def _ours(data: DataConfig) -> bool:
    """Whether everything it was trained on comes with the project."""
    places = (data.root, data.extra, data.video.root if data.video else None)
    return not any(places) and data.backgrounds in (None, "drawn")


def _data(data: DataConfig) -> str:
    if data.video is not None:
        return f"videos of a {data.category} each ({data.video.root or 'a stand-in that comes with viewnet'})"
    models = "CAD models that come with viewnet" if data.root is None else f"CAD models ({data.root})"
    before = f" before backgrounds ({data.backgrounds})" if data.backgrounds else ""
    return f"{models}{', and more' if data.extra else ''}{before}"
