from __future__ import annotations

import huggingface_hub
from helpers.estimators import untrained

from viewnet.estimator import ViewpointEstimator
from viewnet.estimator.demo.analysis import model_facts
from viewnet.estimator.model_card import with_interval

load = ViewpointEstimator.from_pretrained


def test_the_card_is_what_the_hub_reads(run, tmp_path):
    load(run.folder).save_pretrained(tmp_path / "saved")
    card = huggingface_hub.ModelCard.load(tmp_path / "saved" / "README.md")
    metrics = run.result["metrics"]["procrustes"]
    found = {result.metric_type: result.metric_value for result in card.data.eval_results}
    assert found == {name: metrics[name] for name in ("acc30", "median", "dva")}
    assert (card.data.license, card.data.library_name) == ("mit", "viewnet")
    assert f"| Acc@30, % | {metrics['acc30']:.1f} [" in card.text
    assert "9 test views of 3 objects" in card.text
    estimator = untrained(data_root="/data/ShapeNet")
    estimator.save_pretrained(tmp_path / "other")
    assert huggingface_hub.ModelCard.load(tmp_path / "other" / "README.md").data.license == "other"
    estimator.save_pretrained(tmp_path / "other", license="cc-by-4.0")
    assert huggingface_hub.ModelCard.load(tmp_path / "other" / "README.md").data.license == "cc-by-4.0"


def test_a_robust_rotation_is_said_to_be_one(run, tmp_path):
    estimator = load(run.folder)
    estimator.save_pretrained(tmp_path / "usual")
    metrics = estimator.about["metrics"]
    metrics["robust"] = metrics["procrustes"] | {"alignment": metrics["procrustes"]["alignment"] | {"kind": "robust"}}
    estimator.save_pretrained(tmp_path / "robust")
    usual, robust = ((tmp_path / name / "README.md").read_text() for name in ("usual", "robust"))
    assert "(`robust`)" in robust and "(`robust`)" not in usual


def test_scores_up_to_a_symmetry_stand_beside_the_others(run, tmp_path):
    estimator = load(run.folder)
    metrics = estimator.about["metrics"]["procrustes"]
    metrics["alike"] = {name: metrics[name] for name in ("median", "dva", "flips", "intervals")} | {"acc30": 98.76}
    metrics["alike"]["intervals"] = metrics["intervals"] | {"acc30": [97.5, 99.5]}
    estimator.save_pretrained(tmp_path / "saved")
    text = (tmp_path / "saved" / "README.md").read_text()
    assert f"| Acc@30, % | {with_interval(metrics, 'acc30')} | 98.8 [97.5, 99.5] |" in text
    assert "up to the symmetry of its objects" in text
    assert "Up to the symmetry of its objects they are **98.8 %**" in model_facts(estimator)


def test_what_a_symmetry_leaves_unknown_is_said(tmp_path):
    for category, said in (("bottle", True), ("car", False)):
        estimator = untrained(category=category)
        estimator.save_pretrained(tmp_path / category)
        for text in ((tmp_path / category / "README.md").read_text(), model_facts(estimator)):
            assert ("look alike from all sides" in text) == said
