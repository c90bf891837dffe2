"""benchmarks/other_renderers.py: all get the same rays, and one that renders something else is found out."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
import torch

from viewnet.model import volume

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "other_renderers.py"
spec = importlib.util.spec_from_file_location("other_renderers", SCRIPT)
other_renderers = importlib.util.module_from_spec(spec)
spec.loader.exec_module(other_renderers)


def test_rays_are_those_of_the_definition():
    frame, focal = torch.eye(3)[None], torch.tensor(0.3)
    origins, directions, places = other_renderers.rays(frame, focal, 6)
    points = origins[0] + places[:, None, None, None] * directions[0]  # (steps, S, S, 3)
    assert torch.allclose(points, volume.ray_points(6, 6, focal), atol=1e-6)


def reference(shape, frames, focal, size):
    return volume.render_reference(shape, frames, focal, size, size)


def test_every_renderer_has_a_row_for_each_work(monkeypatch):
    monkeypatch.setattr(other_renderers, "renderers", lambda: {other_renderers.OURS: reference, "other": reference})
    rows = other_renderers.measure([8], 2, 1)
    assert len(rows) == 2 * 2 * 2
    assert (rows.loc[rows["renderer"] == other_renderers.OURS, "times_as_long"] == 1).all()
    assert rows["rays_per_s"].tolist() == pytest.approx((6 * 64 / rows["s"]).tolist())


def test_a_renderer_of_something_else_is_refused(monkeypatch):
    def mirrored(*inputs):
        return reference(*inputs).flip(-1)

    monkeypatch.setattr(other_renderers, "renderers", lambda: {"mirrored": mirrored})
    with pytest.raises(AssertionError, match="mirrored: images differ"):
        other_renderers.measure([8], 2, 1)


@pytest.mark.parametrize(("library", "make"), [("nerfacc", "by_nerfacc"), ("pytorch3d", "by_pytorch3d")])
def test_a_library_renders_the_same(library, make):
    pytest.importorskip(library)
    given = other_renderers.inputs("object", 12, 2)
    image, gradients = other_renderers.differences(getattr(other_renderers, make)(), given)
    assert image < 1e-5 and gradients[0] < 1e-4
