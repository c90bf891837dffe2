from __future__ import annotations

import numpy as np
import pytest
from helpers.fake_steps import STEPS, views

from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.recipes import make_config
from viewnet.tables import plots
from viewnet.training.run_store import ensure, untrained


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    root = tmp_path_factory.mktemp("figures")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VIEWNET_RUNS", str(root / "runs"))
        patch.setenv("VIEWNET_DATA", str(root / "data"))
        wanted = [make_config(category=c, profile="smoke") for c in ("car", "chair")]
        yield ensure([*wanted, untrained("constant", wanted[0])], workers=1, progress=False, steps=STEPS)


def draw(folder, store, rows):
    """Two heads in the order (1, 0), flat images of 10 and 20."""
    n = len(rows)
    images = np.stack([np.full((n, 8, 8, 3), 10, np.uint8), np.full((n, 8, 8, 3), 20, np.uint8)], axis=1)
    heads = np.tile([1, 0], (n, 1))
    return np.full((n, 8, 8, 3), 200, np.uint8), images, np.tile([0.1, 0.2], (n, 1)), heads


def test_azimuths_are_those_of_the_aligned_selection(runs):
    aligned = align(runs[0].predictions)
    true, predicted = plots.azimuths(aligned)
    assert len(true) == len(aligned.predictions)
    right = aligned.selected_errors < 10
    assert right.any()
    assert (np.abs((true - predicted + 180) % 360 - 180)[right] < 15).all()
    assert ((predicted >= 0) & (predicted < 360)).all()


def test_scatter_has_a_panel_a_category_and_a_point_an_image(runs):
    figure = plots.azimuth_scatter(runs[:2])
    assert [axes.get_title() for axes in figure.axes] == ["car", "chair"]
    for axes, run in zip(figure.axes, runs, strict=False):
        assert len(axes.collections[0].get_offsets()) == len(run.predictions.subset("test"))


def test_candidates_show_each_head_with_its_error_and_angle(runs):
    figure = candidates.candidates(runs[:2], views, draw, count=2)
    assert len(figure.axes) == 4 * 3
    aligned = align(runs[0].predictions)
    n = len(aligned.predictions)
    row = np.linspace(0, n - 1, 4).round().astype(int)[1]
    labels = [axes.get_xlabel() for axes in figure.axes[:3]]
    assert labels == ["", f"0.100 / {aligned.errors[row, 1]:.0f}°", f"0.200 / {aligned.errors[row, 0]:.0f}°"]
    assert figure.axes[0].get_ylabel() == "car"
    assert figure.axes[-3].get_ylabel() == "chair"


def test_files_are_the_same_bytes_each_time(runs, tmp_path):
    first = plots.save(plots.azimuth_scatter(runs[:2]), tmp_path / "a", "figure3_azimuth")
    again = plots.save(plots.azimuth_scatter(runs[:2]), tmp_path / "b", "figure3_azimuth")
    assert [f.name for f in first] == ["figure3_azimuth.png", "figure3_azimuth.pdf"]
    for one, other in zip(first, again, strict=True):
        assert one.read_bytes() == other.read_bytes()
    assert first[0].read_bytes().startswith(b"\x89PNG")
    pdf = first[1].read_bytes()
    assert pdf.startswith(b"%PDF")
    assert b"CreationDate" not in pdf
    assert b"/Type3" not in pdf


def test_what_cannot_be_shown_is_said(runs):
    for show in (plots.azimuth_scatter, candidates.candidates):
        with pytest.raises(ViewnetError, match="no runs to show"):
            show([])
    with pytest.raises(ViewnetError, match="constant draws nothing"):
        candidates.candidates(runs[2:], views, draw)
