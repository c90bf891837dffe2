from __future__ import annotations

import numpy as np
import pytest
from helpers.fake_steps import views

from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.tables.candidates import candidate_figure


def store(run):
    return views(run.config.data, progress=False)


def render(folder, store, rows):
    """Two heads in the order (1, 0), uniform images of 10 and 20."""
    n = len(rows)
    images = np.stack([np.full((n, 8, 8, 3), 10, np.uint8), np.full((n, 8, 8, 3), 20, np.uint8)], axis=1)
    heads = np.tile([1, 0], (n, 1))
    return np.full((n, 8, 8, 3), 200, np.uint8), images, np.tile([0.1, 0.2], (n, 1)), heads


def test_candidates_show_each_head_with_its_error_and_angle(smoke_runs):
    figure = candidate_figure(smoke_runs[:2], store, render, count=2)
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
        candidate_figure([])
    with pytest.raises(ViewnetError, match="constant renders nothing"):
        candidate_figure(smoke_runs[2:], store, render)
