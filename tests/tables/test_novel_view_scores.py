from __future__ import annotations

from dataclasses import replace
from types import MethodType

import numpy as np
import pandas as pd
import pytest
import torch
from helpers.boxes import PERSPECTIVE, SYMMETRIC, box_mesh, box_store, box_volume
from helpers.photo_data import make_photos
from helpers.untrained_models import finished_run, turned, untrained_renderer
from skimage.metrics import structural_similarity

from viewnet.data.store import write_store
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.geometry import view_vector
from viewnet.model.viewnet import Hypotheses
from viewnet.render import render_mesh
from viewnet.tables import novel_view_scores
from viewnet.tables.columns import NOVEL_VIEWS


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return box_store(tmp_path_factory.mktemp("novel") / "views", {"val": 3, "test": 4}, views=3)


@pytest.fixture(scope="module")
def one_shape(store, tmp_path_factory):
    """The views of `store`, all of the same object."""
    index = store.index
    images = render_mesh(box_mesh(SYMMETRIC), index["azimuth"].to_numpy(), index["elevation"].to_numpy(), 32, 2)
    return write_store(tmp_path_factory.mktemp("one") / "views", [images], index, {"one": 1})


def knowing(renderer, degrees: float):
    """A network that always imagines the boxes themselves, turned by so much in its own frame: 90 or nothing."""
    volume = box_volume(SYMMETRIC, 64)
    # Own azimuths lack the turn: the own frame's volume is turned back by it.
    volume = torch.rot90(volume, -round(degrees / 90), (4, 3))
    renderer.network.focal.data.fill_(PERSPECTIVE)

    def encode(self, images, background=None):
        return torch.zeros(len(images), 1), volume.expand(len(images), -1, -1, -1, -1)

    renderer.network.encode = MethodType(encode, renderer.network)
    return renderer


def test_true_viewpoints_are_taken_into_the_own_frame(one_shape):
    result = [
        novel_view_scores.fidelity(knowing(untrained_renderer(one_shape, turned(rotation), render_size=32), volume))
        for rotation, volume in ((0, 0), (90, 90), (90, 0))
    ]
    assert list(result[0].columns) == ["model_id", "view", "psnr", "ssim", "iou"]
    for right in result[:2]:
        assert (right["psnr"] > 20).all()
        assert (right["ssim"] > 0.85).all()
        assert (right["iou"] > 0.8).all()
    assert result[2]["psnr"].mean() < 18
    assert result[2]["iou"].mean() < 0.75


def test_copy_shows_the_next_view_of_the_object(store):
    renderer = untrained_renderer(store)
    result = novel_view_scores.fidelity(renderer, copy=True)
    expected = novel_view_scores.compare(renderer.images([1, 2, 0]), renderer.images([0, 1, 2]))
    assert np.allclose(result[["psnr", "ssim", "iou"]].head(3), expected)


def test_measures_are_those_of_the_literature():
    generator = torch.Generator().manual_seed(0)
    target = torch.rand(1, 4, 16, 16, generator=generator)
    rendered = (target + 0.1).clamp(max=2)
    rendered[:, :3] = target[:, :3] * 0.5
    (line,) = novel_view_scores.compare(rendered, target).to_dict("records")
    error = ((target[:, :3] * 0.5) ** 2).mean()
    assert line["psnr"] == pytest.approx(float(-10 * torch.log10(error)), abs=1e-4)
    a, b = (p[0, :3].movedim(0, -1).double().numpy() for p in (rendered, target))
    gaussian = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    assert line["ssim"] == pytest.approx(structural_similarity(b, a, data_range=1.0, channel_axis=-1, **gaussian))
    both, either = (target[:, 3] > 0.5).sum(), (target[:, 3] > 0.4).sum()
    assert line["iou"] == pytest.approx(float(both / either), abs=0.02)
    (same,) = novel_view_scores.compare(target, target).to_dict("records")
    assert same == {"psnr": novel_view_scores.HIGHEST, "ssim": pytest.approx(1), "iou": 1}


def test_what_a_variant_does_not_draw_is_not_scored(store):
    whole = novel_view_scores.fidelity(untrained_renderer(store, variant="hologan_decoder"))
    assert whole[["psnr", "ssim", "iou"]].notna().all(axis=None)
    masks = novel_view_scores.fidelity(untrained_renderer(store, variant="segmentation_target"))
    assert masks[["psnr", "ssim"]].isna().all(axis=None)
    assert masks["iou"].notna().all()


def test_the_hypothesis_that_reconstructs_best_need_not_be_the_closest(one_shape):
    """Of the truth, and the same seen from a quarter turn away: a volume that is turned so too prefers the other."""
    found = {}
    for turned_by in (0, 90):
        renderer = knowing(untrained_renderer(one_shape, turned(0), render_size=32), turned_by)
        predictions = renderer.aligned.predictions
        azimuths = predictions.ids[["azimuth"]].to_numpy() + np.array([90, 0])  # (N, 2)
        elevations = np.repeat(predictions.ids[["elevation"]].to_numpy(), 2, axis=1)
        vectors = view_vector(torch.from_numpy(azimuths), torch.from_numpy(elevations)).numpy()
        errors = metrics.geodesic_error(vectors, np.repeat(predictions.truth[:, None], 2, axis=1))
        seen = replace(predictions, hypotheses=vectors, logits=np.zeros(vectors.shape[:2]))
        renderer = replace(renderer, aligned=replace(renderer.aligned, predictions=seen, errors=errors))
        found[turned_by] = novel_view_scores.of_hypotheses(renderer)
    assert (found[0]["closest"] < 1).all() and (found[90]["closest"] < 1).all()
    assert (found[0]["reconstructing"] < 1).mean() > 0.8
    assert (found[90]["reconstructing"] > 60).mean() > 0.8


@pytest.mark.parametrize(("reads", "median"), [(True, 0.0), (False, 90.0)])
def test_consistency_is_how_well_the_drawing_tells_its_viewpoint(store, reads, median):
    renderer = untrained_renderer(store)

    def render(self, volumes, code, frames, size=None):
        """Uniform images whose colour is the view vector."""
        colours = torch.cat([frames[:, :, 2] / 2 + 0.5, torch.ones(len(frames), 1)], 1)
        return colours[:, :, None, None].expand(-1, -1, 16, 16)

    def viewpoint(images):
        predictions = 2 * images.mean((2, 3)) - 1 if reads else torch.tensor([[1.0, 0, 0]]).expand(len(images), 3)
        wrong = -predictions * torch.tensor([1.0, 1, 0]) + torch.tensor([0.0, 0, 0.1])
        # The selected head is used; the other one would be wrong.
        return Hypotheses(torch.stack([wrong, predictions], 1), torch.tensor([[0.0, 1.0]]).expand(len(images), 2))

    renderer.network.render = MethodType(render, renderer.network)
    renderer.network.viewpoint.forward = viewpoint
    errors = novel_view_scores.consistency(renderer)
    assert len(errors) == len(renderer)
    assert np.median(errors) == pytest.approx(median, abs=0.01 if reads else 45)
    assert np.array_equal(errors, novel_view_scores.consistency(renderer))


@pytest.mark.parametrize(
    ("variant", "settings"), [("viewnet", {"crop": "square"}), ("hologan_decoder", {}), ("viewnet", {"in_plane": True})]
)
def test_every_network_can_look_at_what_it_draws(store, variant, settings):
    errors = novel_view_scores.consistency(untrained_renderer(store, variant=variant, **settings))
    assert ((errors >= 0) & (errors <= 180)).all()


def test_cells_are_those_of_a_table(store, tmp_path):
    runs = [
        finished_run(tmp_path / f"{v}{s}", store, v, seed=s)
        for v, s in (("segmentation_target", 0), ("viewnet", 0), ("viewnet", 1))
    ]
    (mask, judge, _), folder = runs, tmp_path / "tables"
    novel_view_scores.keep(novel_view_scores.copied(judge, lambda run: store), folder)
    for run in (mask, judge, *runs):  # again in the place of what was kept before
        path = novel_view_scores.keep(novel_view_scores.scores(run, judge, lambda run: store), folder)
    kept = novel_view_scores.read(folder)
    assert len(kept) == 4 * 12 and kept["run"].value_counts().max() == 12
    assert kept["judged"].notna().sum() == 3 * 12
    result = novel_view_scores.cells(kept, draws=20)
    assert list(dict.fromkeys(result["row"])) == [novel_view_scores.COPY, "ViewNet", "Segmentation Target"]
    assert list(result.loc[result["row"] == "ViewNet", "metric"]) == list(NOVEL_VIEWS)
    mine = result.set_index(["row", "metric"])
    psnr = mine.loc["ViewNet", "psnr"]
    assert psnr["seeds"] == 2
    assert psnr["runs"] == "viewnet0 viewnet1"
    assert psnr["low"] <= psnr["measured"] <= psnr["high"]
    assert (psnr["images"], psnr["objects"]) == (12, 4)
    assert np.isnan(mine.loc["Segmentation Target", "psnr"]["measured"])
    assert np.isnan(mine.loc[novel_view_scores.COPY, "consistency_median"]["measured"])
    files = novel_view_scores.write(result, folder, "one & two")
    assert [file.name for file in files] == ["novel_views.tex", "novel_views.csv"]
    tex = files[0].read_text()
    assert tex.count("&") == 9 * 4 + 1 and "one \\& two" in tex and tex.count("\\midrule") == 1
    line = next(line for line in tex.splitlines() if line.startswith("Segmentation Target"))
    assert line.split(" & ")[1] == "--" and line.split(" & ")[3] != "--"
    saved = pd.read_csv(files[1], keep_default_na=False, na_values=[""])
    assert saved["measured"].to_numpy() == pytest.approx(result["measured"].round(4).to_numpy(), nan_ok=True)
    novel_view_scores.write(novel_view_scores.cells(kept), folder)
    assert not len(novel_view_scores.differences(path))
    kept.assign(iou=kept["iou"] / 2).to_parquet(path)
    assert set(novel_view_scores.differences(path)["metric"]) == {"iou"}
    kept.drop(columns="judged").to_parquet(path)
    with pytest.raises(ViewnetError, match=r"novel_views\.parquet: not the scores of novel views"):
        novel_view_scores.read(folder)


def test_photographs_and_single_views_are_refused(tmp_path):
    with pytest.raises(ViewnetError, match="photographs have no mask"):
        novel_view_scores.fidelity(untrained_renderer(make_photos(tmp_path / "photos")))
    single = box_store(tmp_path / "views", {"val": 4, "test": 2}, views=1)
    with pytest.raises(ViewnetError, match="a single view"):
        novel_view_scores.fidelity(untrained_renderer(single))
