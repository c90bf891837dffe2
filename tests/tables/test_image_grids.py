from __future__ import annotations

import numpy as np
import pytest
from helpers.boxes import box_store
from helpers.fake_steps import views
from helpers.figures import images, inside
from helpers.photo_data import make_photos
from helpers.untrained_models import untrained_renderer, untrained_run

from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
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
    figure = image_grids.around(
        [runs[2], runs[0]], lambda run: store, azimuths=(0, 90, 180), elevation=10, object_number=1
    )
    shown = images(figure)
    assert [len(line) for line in shown] == [4, 4]
    assert [axes.get_title() for axes in figure.axes[:4]] == ["appearance", "0°", "90°", "180°"]
    assert [axes.get_ylabel() for axes in figure.axes[::4]] == ["HoloGAN-\nDecoder", "ViewNet"]
    # The same object for both, and not two views alike.
    assert np.array_equal(shown[0][0], shown[1][0])
    assert not np.array_equal(shown[1][1], shown[1][3])
    assert inside(figure)
    with pytest.raises(ViewnetError, match="object 4: the test split has 4"):
        image_grids.around(runs, lambda run: store, object_number=4)


def test_volumes_stand_below_their_images_from_one_viewpoint(runs, store):
    figure = image_grids.volumes(runs[:1], lambda run: store, count=4, columns=3)
    shown = images(figure)
    assert [[p is not None for p in line] for line in shown] == [[True] * 3] * 2 + [[True, False, False]] * 2
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


def synthetic(run):
    return views(run.config.data, progress=False)


def two_heads(folder, store, rows):
    """Two heads in the order (1, 0), uniform images of 10 and 20."""
    n = len(rows)
    images = np.stack([np.full((n, 8, 8, 3), 10, np.uint8), np.full((n, 8, 8, 3), 20, np.uint8)], axis=1)
    heads = np.tile([1, 0], (n, 1))
    return np.full((n, 8, 8, 3), 200, np.uint8), images, np.tile([0.1, 0.2], (n, 1)), heads


def test_candidates_show_each_head_with_its_error_and_angle(smoke_runs):
    figure = image_grids.candidate_figure(smoke_runs[:2], synthetic, two_heads, count=2)
    assert len(figure.axes) == 4 * 3
    aligned = align(smoke_runs[0].predictions)
    n = len(aligned.predictions)
    row = np.linspace(0, n - 1, 4).round().astype(int)[1]
    labels = [axes.get_xlabel() for axes in figure.axes[:3]]
    assert labels == ["", f"0.100 / {aligned.errors[row, 1]:.0f}°", f"0.200 / {aligned.errors[row, 0]:.0f}°"]
    assert figure.axes[0].get_ylabel() == "car"
    assert figure.axes[-3].get_ylabel() == "chair"


def test_no_runs_and_untrained_runs_are_refused(smoke_runs):
    with pytest.raises(ViewnetError, match="no runs to show"):
        image_grids.candidate_figure([])
    with pytest.raises(ViewnetError, match="constant renders nothing"):
        image_grids.candidate_figure(smoke_runs[2:], synthetic, two_heads)
