from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.boxes import box_store
from helpers.photo_data import make_photos
from helpers.untrained_models import turned, untrained_renderer, untrained_run

from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import Identity
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predict import predict
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.geometry import azimuth_elevation, look_at, view_vector
from viewnet.model import rendering
from viewnet.runs.run_store import untrained
from viewnet.runtime.files import write_json
from viewnet.tables import run_renderer


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return box_store(tmp_path_factory.mktemp("drawing") / "views", {"val": 3, "test": 3}, views=3)


def test_a_run_is_aligned_as_in_the_tables(store, tmp_path):
    run = untrained_run(tmp_path / "run")
    renderer = run_renderer.RunRenderer.of(run.folder, store)
    assert len(renderer) == len(renderer.views.objects) == 9
    predicted = predict(run.folder, store)
    assert np.allclose(renderer.rotation, align(predicted).alignment.rotation)
    # Kept predictions are used where they are of these views, and only there.
    saved = Predictions(predicted.ids, predicted.hypotheses[:, ::-1], predicted.logits)
    saved.to_parquet(run.folder / "predictions.parquet")
    for views, expected in ((store.identity, saved), ("others", predicted)):
        write_json(run.folder / "result.json", {"views": views})
        outcome = run_renderer.RunRenderer.of(run.folder, store).aligned.predictions
        assert np.allclose(outcome.hypotheses, expected.subset("test").hypotheses)


def test_frames_are_taken_back_into_the_own_frame(store):
    renderer = untrained_renderer(store, turned(90))
    azimuth, elevation = torch.tensor([120.0]), torch.tensor([20.0])
    own = renderer.in_own_frame(look_at(view_vector(azimuth, elevation)))
    assert torch.allclose(own, look_at(view_vector(azimuth - 90, elevation)), atol=1e-6)


def test_turn_is_what_own_azimuths_lack(store):
    renderer = untrained_renderer(store)
    ids = renderer.aligned.calibration.ids
    angles = (torch.tensor(ids[c].to_numpy()) for c in ("azimuth", "elevation"))
    predicted = view_vector(next(angles) - 70, next(angles) * 0.5).numpy()[:, None]
    calibration = Predictions(ids, predicted, np.zeros((len(ids), 1)))
    renderer = replace(renderer, aligned=replace(renderer.aligned, calibration=calibration))
    level = renderer.level(torch.tensor([100.0]), torch.tensor([15.0]))
    assert np.allclose([float(x) for x in azimuth_elevation(level[0, :, 2])], [30, 15], atol=1e-3)


def test_answers_are_the_selected_frames(store):
    renderer = untrained_renderer(store)
    rows = [4, 1]
    outcome = renderer.network.viewpoint(renderer.network.composite(renderer.images(rows, 32)))
    frames = outcome.world_from_camera[torch.arange(2), outcome.logits.argmax(1)]
    assert torch.allclose(renderer.predicted_frames(rows), frames, atol=1e-4)


def test_larger_drawings_show_the_same(store):
    renderer = untrained_renderer(store)
    encoded, frames = renderer.encode([0, 3]), renderer.predicted_frames([0, 3])
    small, large = (renderer.render(encoded, frames, size) for size in (None, 64))
    assert large.shape == (2, 4, 64, 64)
    pair = torch.stack([torch.nn.functional.avg_pool2d(large, 4).flatten(), small.flatten()])
    assert torch.corrcoef(pair)[0, 1] > 0.95
    hologan = untrained_renderer(store, variant="hologan_decoder")
    assert hologan.render(hologan.encode([0]), frames[:1], 64).shape == (1, 4, 16, 16)


def test_photographs_are_drawn_cut_to_their_object(tmp_path):
    renderer = untrained_renderer(make_photos(tmp_path / "photos"), recipe="photos", backgrounds=None)
    rendered = renderer.reconstruct([0, 1])
    assert renderer.next_views([0, 1]) == [0, 1]
    covered = rendered[:, 3] > 0.5
    assert covered.any()
    sides = torch.stack([covered.any(axis).sum(1) for axis in (1, 2)], 1).amax(1)
    assert (sides >= rendered.shape[-1] - 2).all()


def test_shown_is_before_a_wall():
    image = torch.tensor([0.2, 0.0, 0.6, 0.4])[None, :, None, None]
    assert rendering.to_uint8(image).tolist() == [[[[204, 153, 255]]]]
    assert rendering.to_uint8(image, 0.0).tolist() == [[[[51, 0, 153]]]]


def test_runs_that_render_nothing_are_refused(store, tmp_path):
    renderer = untrained_renderer(store)
    with pytest.raises(ViewnetError, match="no runs to render"):
        run_renderer.renderers([])
    with pytest.raises(ViewnetError, match=r"constant car seed 0 .* renders nothing"):
        run_renderer.renderers([Run(untrained("constant", renderer.config), tmp_path)])
    with pytest.raises(ViewnetError, match="alignment none is no rotation"):
        _ = replace(renderer, aligned=replace(renderer.aligned, alignment=Identity())).rotation
