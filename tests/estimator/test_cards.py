"""The cards of models and of the built-in CAD models, as the hub's own library reads them."""

from __future__ import annotations

import pytest
from huggingface_hub import DatasetCard, ModelCard

from viewnet import cad
from viewnet.estimator import model_card, pretrained


@pytest.mark.parametrize("category", pretrained.shipped())
def test_the_hubs_library_finds_a_models_scores(category):
    card = ModelCard.load(pretrained.SHIPPED / category / "README.md", ignore_metadata_errors=False)
    assert (card.data.license, card.data.library_name) == ("mit", "viewnet")
    assert category in card.data.tags
    about = model_card.own(pretrained.load(category).about["metrics"])
    found = {result.metric_type: result.metric_value for result in card.data.eval_results}
    headline = about.get("alike", about)  # of symmetric categories up to their symmetry
    assert found == pytest.approx({name: headline[name] for name in model_card.METRICS})
    assert {result.task_type for result in card.data.eval_results} == {"viewpoint-estimation"}


def test_a_collection_of_built_in_models_comes_with_a_dataset_card(tmp_path):
    cad.write_collection(tmp_path, ["bottle"], 1, progress=False)
    card = DatasetCard.load(tmp_path / "README.md", ignore_metadata_errors=False)
    assert (card.data.license, card.data.size_categories) == ("mit", ["1K<n<10K"])
    (model,) = (tmp_path / "02876657").iterdir()
    for named in ("models/model_normalized.obj", "images", "all.csv"):
        assert named.split("/")[-1] in card.text
    assert (model / "models" / "model_normalized.obj").is_file()
