from __future__ import annotations

import numpy as np
import pytest
from helpers.boxes import box_store
from helpers.figures import images, inside
from helpers.photo_data import make_photos
from helpers.untrained_models import untrained_renderer, untrained_run

from viewnet.errors import ViewnetError
from viewnet.model import rendering
from viewnet.tables import image_grids, plots, run_renderer


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return box_store(tmp_path_factory.mktemp("gallery") / "views", {"val": 3, "test": 4}, views=3)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    return [untrained_run(folder / v, v) for v in ("viewnet", "viewnet_cycle", "hologan_decoder")]


def test_reconstructions_stand_beside_their_image(runs, store):
    figure = image_grids.reconstructions(runs[:2], lambda run: store, count=2)
    shown = images(figure)
    assert [len(line) for line in shown] == [3, 3]
    assert [axes.get_title() for axes in figure.axes[:3]] == ["car", "ViewNet", "ViewNet +\ncycle"]
    renderer = run_renderer.RunRenderer.of(runs[1].folder, store)
    assert np.array_equal(shown[1][0], renderer.test_images([6])[0])
    assert np.array_equal(shown[1][2], rendering.to_uint8(renderer.reconstruct([6]))[0])
    assert inside(figure)


def test_seeds_are_told_apart(runs, store, tmp_path):
    figure = image_grids.reconstructions([runs[0], untrained_run(tmp_path / "run", seed=1)], lambda run: store, count=1)
    assert [axes.get_title() for axes in figure.axes] == ["car", "ViewNet\nseed 0", "ViewNet\nseed 1"]


def test_photographs_are_reconstructed_too(runs, tmp_path):
    photos = make_photos(tmp_path / "photos", count=12)
    assert len(images(image_grids.reconstructions(runs[:2], lambda run: photos))) == 3


def test_runs_of_other_views_cannot_share_images(runs, store, tmp_path):
    other = box_store(tmp_path / "views", {"val": 3, "test": 3}, views=3, seed=1)
    with pytest.raises(ViewnetError, match="have other views"):
        image_grids.reconstructions(runs[:2], lambda run: store if run is runs[0] else other)


def test_views_around_have_a_line_a_run_and_a_column_an_azimuth(runs, store):
    figure = image_grids.around([runs[2], runs[0]], lambda run: store)
    shown = images(figure)
    assert [len(line) for line in shown] == [9, 9]
    assert [axes.get_title() for axes in figure.axes[:4]] == ["appearance", "0°", "45°", "90°"]
    assert [axes.get_ylabel() for axes in figure.axes[::9]] == ["HoloGAN-\nDecoder", "ViewNet"]
    # The same object for both, and not two views alike.
    assert np.array_equal(shown[0][0], shown[1][0])
    assert not np.array_equal(shown[1][1], shown[1][3])
    assert inside(figure)


def test_volumes_stand_below_their_images_from_one_viewpoint(runs, store, monkeypatch):
    monkeypatch.setattr(image_grids, "ACROSS", 3)
    figure = image_grids.volumes(runs[:1], lambda run: store, count=4)
    shown = images(figure)
    assert [len(line) for line in shown] == [3, 3, 1, 1]
    renderer = run_renderer.RunRenderer.of(runs[0].folder, store)
    assert np.array_equal(shown[2][0], renderer.test_images([9])[0])
    assert inside(figure)


def test_figures_are_files(runs, store, tmp_path):
    files = plots.save(image_grids.volumes(runs[:1], lambda run: store, count=2), tmp_path, "volumes")
    assert files[0].read_bytes().startswith(b"\x89PNG")
    assert files[1].read_bytes().startswith(b"%PDF")


def test_untrained_renderer_is_that_of_a_run(store, tmp_path):
    """The two ways in which tests get a renderer agree."""
    one, other = run_renderer.RunRenderer.of(untrained_run(tmp_path / "run").folder, store), untrained_renderer(store)
    assert np.allclose(rendering.to_uint8(one.reconstruct([0])), rendering.to_uint8(other.reconstruct([0])), atol=2)


def test_candidates_stand_by_rising_error_above_error_and_angle(runs, store):
    figure = image_grids.candidate_figure(runs[:1], lambda run: store, count=2)
    assert [len(line) for line in images(figure)] == [4, 4]
    renderer = run_renderer.RunRenderer.of(runs[0].folder, store)
    rows = np.linspace(0, len(renderer) - 1, 4).round().astype(int)[1:-1]
    for row, line in zip(rows, (figure.axes[:4], figure.axes[4:]), strict=True):
        assert np.array_equal(line[0].images[0].get_array(), renderer.test_images([row])[0])
        numbers = [axes.get_xlabel().split(" / ") for axes in line[1:]]
        errors = [float(error) for error, _ in numbers]
        assert errors == sorted(errors)
        assert sorted(angle for _, angle in numbers) == sorted(f"{a:.0f}°" for a in renderer.aligned.errors[row])
    assert figure.axes[0].get_ylabel() == "car"
    assert inside(figure)


def test_candidates_are_drawn_from_their_own_viewpoint(runs, store):
    renderer = run_renderer.RunRenderer.of(runs[0].folder, store)
    errors, drawn = image_grids.candidates(renderer, [0, 3, 5])
    assert errors.shape == drawn.shape[:2] == (3, 3)
    best = renderer.aligned.predictions.choice[3]
    own = renderer.render(renderer.encode(renderer.next_views([3])), renderer.predicted_frames([3]))
    assert np.array_equal(drawn[1, best], renderer.displayed(own)[0])


def test_no_runs_and_untrained_runs_are_refused(smoke_runs, store):
    with pytest.raises(ViewnetError, match="no runs"):
        image_grids.candidate_figure([])
    with pytest.raises(ViewnetError, match="constant"):
        image_grids.candidate_figure(smoke_runs[2:], lambda run: store)
