from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from helpers.boxes import box_store
from helpers.evaluation_data import make_index, noisy
from helpers.figures import images, inside
from helpers.untrained_models import untrained_run

from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predictions import Predictions, true_vectors
from viewnet.geometry import view_vector
from viewnet.tables import image_grids


def vectors(azimuths, elevations) -> np.ndarray:
    return view_vector(
        torch.tensor(azimuths, dtype=torch.float64), torch.tensor(elevations, dtype=torch.float64)
    ).numpy()


@pytest.mark.parametrize(
    ("angles", "cause"),
    [
        ((75, 5), ""),
        ((245, 8), "half a turn"),
        ((250, -35), "half a turn"),
        ((115, 0), "front and back mirrored"),
        ((340, 0), "other"),  # right and left mirrored
        ((70, 60), "elevation"),
        ((160, 10), "other"),
    ],
)
def test_causes(angles, cause):
    assert image_grids.causes(vectors([angles[0]], [angles[1]]), vectors([65.0], [10.0])).tolist() == [cause]


def test_from_the_front_a_mirror_is_half_a_turn():
    assert image_grids.causes(vectors([180.0], [0.0]), vectors([5.0], [0.0])).tolist() == ["half a turn"]


def test_from_the_side_a_mirror_is_no_cause_for_an_elevation():
    assert image_grids.causes(vectors([91.0], [36.0]), vectors([80.0], [-16.0])).tolist() == ["elevation"]


def test_failures_come_by_cause_worst_first():
    ids = make_index(30, 4)
    predicted = noisy(ids, heads=1, degrees=2)
    true = true_vectors(predicted.ids)
    hypotheses = true[:, None].copy()
    test = np.flatnonzero(predicted.ids["split"] == "test")
    for row, off in ((3, 40.0), (1, 170.0), (5, 178.0), (7, 75.0)):
        line = predicted.ids.iloc[test[row]]
        hypotheses[test[row], 0] = vectors([line["azimuth"] + off], [line["elevation"]])[0]
    groups = image_grids.by_cause(align(Predictions(predicted.ids, hypotheses, predicted.logits), "none"))
    assert next(iter(groups)) == "half a turn"
    assert groups.pop("half a turn") == [5, 1]
    assert sorted(row for rows in groups.values() for row in rows) == [3, 7]


@pytest.fixture
def store(tmp_path):
    return box_store(tmp_path / "views", {"val": 4, "test": 4}, views=4)


def test_gallery_tells_both_viewpoints(store, tmp_path):
    run = untrained_run(tmp_path / "run")
    figure = image_grids.failures(run, lambda run: store, count=3)
    shown = images(figure)
    (renderer,) = image_grids.renderers([run], lambda run: store)
    groups = image_grids.by_cause(renderer.aligned)
    labels = [axes.get_ylabel().replace("\n", " ") for axes in figure.axes if axes.get_ylabel()]
    assert labels == [f"{cause} {len(rows)} of 16" for cause, rows in groups.items()]
    assert [len(line) for line in shown] == [2 * min(3, len(rows)) for rows in groups.values()]
    worst = renderer.aligned.predictions.ids.iloc[next(iter(groups.values()))[0]]
    assert figure.axes[0].get_xlabel() == f"true\n{round(worst['azimuth']) % 360}°, {round(worst['elevation'])}°"
    assert figure.axes[1].get_xlabel().startswith("predicted\n")
    assert inside(figure)


def test_no_failures_are_nothing_to_show(store, tmp_path, monkeypatch):
    ids = store.index[store.index["split"] != "train"]
    right = Predictions(ids, true_vectors(ids)[:, None], np.zeros((len(ids), 1)))
    monkeypatch.setattr(image_grids, "renderers", lambda runs, stores: [SimpleNamespace(aligned=align(right))])
    with pytest.raises(ViewnetError, match="no error of 30 degrees or more"):
        image_grids.failures(untrained_run(tmp_path / "run"), lambda run: store)
