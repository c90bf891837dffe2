"""The README.md of a saved model: what it is, how well it does and how it is used, in the hub's form."""

from __future__ import annotations

import json
from typing import Any

from viewnet.config import DataConfig, RunConfig

METRICS = {"acc30": "within 30 degrees, %", "median": "median error, degrees", "dva": "DVA, %"}
URL = "https://openaccess.thecvf.com/content/ICCV2021/html/Mariotti_ViewNet_Unsupervised_Viewpoint_Estimation_From_Conditional_Generation_ICCV_2021_paper.html"


def card(config: RunConfig, aligned: bool, about: dict[str, Any], license: str | None = None) -> str:
    """Markdown with the hub's front matter. `about` is what viewnet.pretrained keeps of a run's result."""
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
        f"From which direction a picture shows a {config.category}, learned without viewpoints from pairs of pictures "
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
        "",
        "## How to use it",
        "",
        "```python",
        "from viewnet.estimator import ViewpointEstimator",
        "",
        'estimator = ViewpointEstimator.from_pretrained("FOLDER OR NAME/MODEL")',
        'print(estimator.predict("picture.jpg", boxes=(40, 60, 380, 250)))',
        "```",
        "",
        "Azimuth 0 shows the object's front and 90 its left side; elevation is the height above the horizon; degrees."
        if aligned
        else "Azimuth 0 and the up of its own frame are arbitrary: only differences between viewpoints tell something.",
        "It knows this category alone, and answers for any picture.",
    ]
    return "\n".join([*lines, ""])


def _result(config: RunConfig, scores: dict[str, Any]) -> dict[str, Any]:
    return {
        "task": {"type": "viewpoint-estimation", "name": "Viewpoint estimation"},
        "dataset": {"type": "views", "name": f"test views of {_data(config.data)}"},
        "metrics": [{"type": key, "name": told, "value": scores[key]} for key, told in METRICS.items()],
    }


def _scores(scores: dict[str, Any] | None) -> list[str]:
    if not scores:
        return ["Its own views have no annotated viewpoints: it was not scored."]
    rows = []
    for key, told in METRICS.items():
        bounds = (scores.get("intervals") or {}).get(key)
        interval = f" [{bounds[0]:.1f}, {bounds[1]:.1f}]" if bounds else ""
        rows.append(f"| {told} | {scores[key]:.1f}{interval} |")
    views, objects, fitted = scores["images"], scores["objects"], scores["alignment"]["images"]
    told = f"On {views} test views of {objects} objects that it has not seen, after a rotation fitted on {fitted} "
    told += "annotated validation views. In brackets 95 % intervals over objects."
    return ["| | |", "|---|---|", *rows, "", told]


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
