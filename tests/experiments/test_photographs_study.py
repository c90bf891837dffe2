"""The study of photographs: the networks it needs, what its students are, and confidence beside what is right."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.fake_steps import STEPS
from helpers.photo_data import fake_photographs, keep_apart

from viewnet.evaluation.confidence import calibration_error
from viewnet.evaluation.predictions import Predictions
from viewnet.experiments import experiment, photographs_study
from viewnet.runs.other_views import on_photographs
from viewnet.runs.run_store import ensure
from viewnet.tables import plots
from viewnet.tables.table import Table


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    return keep_apart(tmp_path, monkeypatch)


def test_students_bring_the_networks_that_they_start_and_learn_from():
    request = experiment("photographs_study", rows="student_of_black", seeds=2)
    assert [(c.variant, c.seed) for c in request.configs] == [
        ("viewnet", 0), ("viewnet", 1), ("over_black", 0), ("over_black", 1)
    ]  # fmt: skip
    assert [c.data.backgrounds for c in request.configs] == ["drawn", "drawn", None, None]
    assert [c.train.photo.views_per_target for c in request.configs] == [3, 3, 1, 1]
    assert [c.variant for c in experiment("photographs_study", rows="student").configs] == ["viewnet"]
    assert [c.variant for c in experiment("photographs_study", rows="view_regression").configs] == []
    sizes = {c.variant: c.model.input_size for c in experiment("photographs_study").configs}
    assert sizes == {
        "viewnet": 64, "over_black": 64, "behind_both": 64, "larger_input": 128, "spherical_regression": 64,
        "spherical_regression_larger": 128,
    }  # fmt: skip


@pytest.fixture
def lessons(tmp_path, monkeypatch):
    """Trainings and lessons that take no time; who started and who taught is in the list."""
    fake_photographs(tmp_path, monkeypatch)
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)
    found: list[tuple[str, list[str]]] = []

    def distil(model, config, store, teachers, seed):
        found.append((model, [name for name, _ in teachers]))

    def predict(model, photographs, splits, config):
        (run,) = ensure([config], progress=False, steps=STEPS)
        said = on_photographs(run, photographs, STEPS)
        return Predictions(said.ids, -said.hypotheses, said.logits, said.ups)  # whatever it is, not the run's own

    monkeypatch.setattr(photographs_study, "distil", distil)
    monkeypatch.setattr(photographs_study, "predict", predict)
    monkeypatch.setattr("viewnet.data.build.view_store", lambda data: None)
    monkeypatch.setattr("viewnet.model.checkpoint.identity", lambda folder: folder[-12:])
    return found


@pytest.mark.slow
def test_a_student_starts_from_its_own_seed_and_learns_of_all_seeds_over_black(lessons, monkeypatch):
    rows = "viewnet,over_black,student,student_of_black"
    request = experiment("photographs_study", profile="smoke", rows=rows, seeds=2)
    runs = ensure(request.configs, workers=1, progress=False, steps=STEPS)
    names = {run.folder: f"{run.config.variant} {run.config.seed}" for run in runs}
    configs = {run.folder: run.config for run in runs}
    monkeypatch.setattr("viewnet.model.checkpoint.load_model", lambda folder: (names[folder], configs[folder]))
    table = request.table(runs)
    assert isinstance(table, Table)
    black = ["over_black 0", "over_black 1"]
    assert lessons == [("viewnet 0", []), ("viewnet 1", []), ("viewnet 0", black), ("viewnet 1", black)]
    cells = table.cells[(table.cells["metric"] == "flips") & (table.cells["seeds"] > 0)].set_index("row")
    assert list(cells.index) == [
        "ViewNet (robust, photos)", "ViewNet over black (robust, photos)", "Student of ViewNet (robust)",
        "Student of ViewNets over black (robust)",
    ]  # fmt: skip
    assert set(cells["seeds"]) == {2}
    again = request.table(runs)
    assert len(lessons) == 4  # what students said is kept with the run that they started from
    assert again.cells.equals(table.cells)
    drawn = request.answers(runs)
    assert list(drawn) == ["built-in car", *(row.replace(", photos", "") for row in cells.index)]


def test_confidences_are_drawn_beside_the_share_that_is_right():
    sure = np.repeat([0.25, 0.85, 0.95], [20, 40, 5])
    right = np.concatenate([np.arange(20) < 5, np.arange(40) < 20, np.ones(5)]).astype(bool)
    figure = plots.reliability({"one": (sure, right)})
    shares, counts = figure.axes
    line = next(each for each in shares.lines if each.get_label().startswith("one"))
    assert np.allclose(line.get_xydata(), [(25, 25), (85, 50)])  # five photographs are too few for a share
    assert line.get_label() == f"one: {calibration_error(sure, right):.1f} points"
    (steps,) = counts.patches
    assert np.allclose(steps.get_data().values, 100 * np.array([0, 0, 20, 0, 0, 0, 0, 0, 40, 5]) / 65)
