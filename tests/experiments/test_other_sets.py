from __future__ import annotations

import numpy as np
import pytest
from helpers.fake_steps import STEPS, views
from helpers.photo_data import keep_apart
from helpers.tables import cell_of

from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.experiments.other_sets import OTHER, OWN, SEED, OtherSetsExperiment, nearest_iou
from viewnet.runs.run_store import ensure
from viewnet.tables import kept_predictions
from viewnet.tables.table import named


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    keep_apart(tmp_path, monkeypatch)
    monkeypatch.setattr("viewnet.data.build.view_store", views)
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)


def request_and_runs(**parameters):
    request = experiment("test_sets", profile="smoke", categories="car", **parameters)
    assert isinstance(request, OtherSetsExperiment)
    return request, ensure(request.configs, workers=1, progress=False, steps=STEPS)


def test_the_same_run_is_scored_on_each_set(tmp_path):
    request, runs = request_and_runs(eval_root=str(tmp_path))
    table = request.table(runs)
    assert table.complete
    assert table.rows == tuple(named(label, "matting") for label in (OWN, SEED, OTHER))
    cells = [cell_of(table, row, "car", "acc30") for row in table.rows]
    assert [cell["images"] for cell in cells] == [len(runs[0].predictions.subset("test")), 120, 120]
    keys = [cell["runs"] for cell in cells]
    assert keys[0] == runs[0].key and len(set(keys)) == 3
    assert all(table.provenance[key]["variant"] == "viewnet" for key in keys)
    path = next(path for path in table.write(tmp_path / "out") if path.suffix == ".json")
    assert kept_predictions.differences(path).empty


def test_without_another_collection_its_row_is_empty():
    request, runs = request_and_runs()
    assert request.label == "smoke-car"
    table = request.table(runs)
    assert table.complete
    assert np.isnan(cell_of(table, OTHER, "car", "acc30")["measured"])


def test_another_seed_has_as_many_models_as_the_test_split():
    request = experiment("test_sets", profile="tiny", categories="car", seeds=2)
    other = request.other_seed(request.configs[0])
    assert (other.data.models, other.data.seed) == (200, 1)
    assert other.model == request.configs[0].model


def test_both_recipes_are_taken_and_several_only_for_cad_models():
    request = experiment("test_sets", profile="smoke", recipe="paper,matting")
    assert request.recipes == ("paper", "matting")
    with pytest.raises(ViewnetError, match="recipe photos,paper_photos"):
        experiment("table3_pascal3d", recipe="photos,paper_photos")


@pytest.mark.slow
def test_every_set_has_its_distance_from_the_models_trained_on():
    nearness = experiment("test_sets", profile="smoke", categories="car").nearness()
    assert list(nearness.loc["car", "models"]) == [6, 6]
    assert nearness["nearest_iou"].between(0.4, 1).all()


def test_the_most_alike_counts():
    masks = np.array([[[1, 1, 0, 0], [1, 0, 0, 0]]], dtype=bool)  # one model, two viewpoints
    others = np.array([[[1, 0, 0, 0], [1, 0, 0, 0]], [[1, 1, 0, 0], [0, 1, 0, 0]]], dtype=bool)
    assert nearest_iou(masks, others).tolist() == [0.75]
