"""The README.md of a saved model, a model card with the hub's front matter: training, scores, usage."""

import json
from typing import Any

from viewnet.config import DataConfig, RunConfig
from viewnet.errors import ViewnetError
from viewnet.estimator import templating
from viewnet.evaluation.symmetry import symmetry

METRICS = {"acc30": "Acc@30, %", "median": "median error, degrees", "dva": "DVA, %"}
SAVED = ("any_turn", "half_turns", "robust", "procrustes")  # alignments of viewnet.evaluation.evaluate.scores
SCORES = (*METRICS, "flips", "intervals")
TAGS = ("viewnet", "viewpoint-estimation", "pose-estimation", "unsupervised")


def card(config: RunConfig, aligned: bool, about: dict[str, Any], license: str | None = None) -> str:
    """Markdown with the hub's front matter. `about` is what a saved model keeps of its run's result and scores."""
    data, trained_on = config.data, _trained_on(config.data)
    # Whatever comes with the project may be passed on.
    ours = not (data.root or data.extra or (data.video and data.video.root)) and data.backgrounds in (None, "drawn")
    licence = license or ("mit" if ours else "other")
    front: dict[str, Any] = {"license": licence, "library_name": "viewnet", "tags": [*TAGS, config.category]}
    if scores := own(about.get("metrics") or {}):
        task = {"type": "viewpoint-estimation", "name": "Viewpoint estimation"}
        shown, up_to = scores.get("alike", scores), " up to symmetry" * ("alike" in scores)
        metrics = [{"type": key, "name": name + up_to, "value": shown[key]} for key, name in METRICS.items()]
        dataset = {"type": "views", "name": f"test views of {trained_on}"}
        results = [{"task": task, "dataset": dataset, "metrics": metrics}]
        front["model-index"] = [{"name": f"{config.variant} {config.category}", "results": results}]
    return templating.rendered(
        "model_card.md",
        # JSON is valid YAML, without YAML's ambiguous scalars.
        front={key: json.dumps(value, ensure_ascii=False) for key, value in front.items()},
        **{"config": config, "aligned": aligned, "about": about, "licence": licence, "trained_on": trained_on},
        **{"scores": scores, "metrics": METRICS, "columns": columns, "with_interval": with_interval},
        alike=symmetry(data.category).note,
    )


def selected(scores: dict[str, Any], key: Any) -> dict[str, Any]:
    """The part of viewnet.experiments.score_model.scores that is saved with a model of the run `key`.

    ViewnetError for anything else, and for scores of another run.
    """
    try:
        run, on = scores["key"], str(scores["on"])
        alignments = {
            str(kind): {name: values[name] for name in ("images", "objects", *SCORES)}
            | {"oracle": {"acc30": values["oracle"]["acc30"]}}
            | {key: {name: values[key][name] for name in SCORES} for key in values if key == "alike"}
            | {"alignment": {name: values["alignment"][name] for name in ("kind", "images", "objects")}}
            for kind, values in scores["alignments"].items()
        }
    except (KeyError, TypeError, AttributeError):
        alignments = {}
    if not alignments:
        raise ViewnetError("scores: expected the output of viewnet evaluate --json on this model")
    if run != key:
        raise ViewnetError(f"scores: are of the run {run}, and the model of {key}: score this model")
    return {"on": on, "alignments": alignments, "confidence": scores.get("confidence")}


def own(metrics: dict[str, Any]) -> dict[str, Any]:
    """Of a run's metrics by alignment those by the rotation that is saved with a model; none without metrics."""
    return next((metrics[kind] for kind in SAVED if kind in metrics), {})


def columns(alignments: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Scores by alignment, each followed by those up to the category's symmetry where it has one."""
    pairs = (((name, each), (f"{name} up to symmetry".strip(), each.get("alike"))) for name, each in alignments.items())
    return {name: scores for pair in pairs for name, scores in pair if scores}


def with_interval(scores: dict[str, Any], metric: str) -> str:
    """A metric of viewnet.evaluation.evaluate.evaluate, with its interval if it has one.

    >>> with_interval({"acc30": 71.04, "intervals": {"acc30": [67.4, 74.3]}}, "acc30")
    '71.0 [67.4, 74.3]'
    """
    bounds = (scores.get("intervals") or {}).get(metric)
    return f"{scores[metric]:.1f}" + (f" [{bounds[0]:.1f}, {bounds[1]:.1f}]" if bounds else "")


def _trained_on(data: DataConfig) -> str:
    if data.video is not None:
        return f"videos of one {data.category} each ({data.video.root or 'the built-in stand-in'})"
    models = "viewnet's built-in CAD models" if data.root is None else f"CAD models ({data.root})"
    backgrounds = f" over backgrounds ({data.backgrounds})" if data.backgrounds else ""
    return f"{models}{', and more' if data.extra else ''}{backgrounds}"
