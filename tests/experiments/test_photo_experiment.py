from __future__ import annotations

import os

import numpy as np
import pytest
from helpers.fake_steps import STEPS
from helpers.photo_data import fake_photographs, keep_apart, make_photos
from helpers.tables import cell_of

from viewnet.config import CATEGORIES, SHAPENET_CATEGORIES, PhotoConfig
from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.experiments import experiment
from viewnet.experiments.photos import PhotoExperiment
from viewnet.experiments.request import PHOTO_RECIPE, accepted
from viewnet.recipes import ABSOLUTE, PROFILES, RECIPES, VARIANTS
from viewnet.runs.other_views import on_photographs
from viewnet.runs.run_store import ensure
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.packed import as_kept
from viewnet.tables.table import named


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    return keep_apart(tmp_path, monkeypatch)


@pytest.fixture
def photographs(tmp_path, monkeypatch):
    """Fake photographs, by their configurations."""
    return fake_photographs(tmp_path, monkeypatch)


def run(request: PhotoExperiment):
    return ensure(request.configs, workers=1, progress=False, steps=STEPS)


@pytest.fixture
def steps(monkeypatch):
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)


def test_defaults_train_over_backgrounds_and_make_a_stand_in(folders):
    request = experiment("table3_pascal3d")
    assert isinstance(request, PhotoExperiment)
    assert request.categories == SHAPENET_CATEGORIES
    assert (request.profile, request.recipe, request.label) == ("tiny", "photos", "")
    assert [(c.variant, c.category) for c in request.configs] == [
        (variant, category)
        for variant in ("ssv", "viewnet", "viewnet_cycle", "behind_both", "spherical_regression", "box_corners")
        for category in SHAPENET_CATEGORIES
    ]
    assert all(c.data.backgrounds == "drawn" and c.data.root is None for c in request.configs)
    assert request.photo_config("chair") == PhotoConfig("chair", size=32, square=False)
    assert request.note.startswith(
        "a stand-in for photographs; trained on built-in models, profile tiny, recipe photos"
    )
    assert experiment("table5_dva").configs == request.configs
    studied = [config for config in request.configs if config.variant not in (*ABSOLUTE, "behind_both")]
    assert experiment("alignment_study").configs == studied
    assert experiment("table3_pascal3d", categories="everything").categories == CATEGORIES
    assert experiment("table3_pascal3d", profile="smoke").photo_config("car").count < 100


def test_parameters_reach_the_photographs_and_the_training(tmp_path):
    (tmp_path / "pascal" / "Annotations").mkdir(parents=True)
    (tmp_path / "cad").mkdir()
    places = {name: str(tmp_path / name) for name in ("pascal", "cad")}
    request = experiment(
        "table3_pascal3d", data_root=places["pascal"], cad_root=places["cad"], extra_cad=places["pascal"],
        backgrounds=places["cad"], subset="pascal", keep="easy", margin="0.1", ridge="50", calibration=64,
        features="pixels", categories="car", seeds=2,
    )  # fmt: skip
    photos = request.photo_config("car")
    assert (photos.root, photos.subset, photos.keep, photos.margin) == (places["pascal"], "pascal", "easy", 0.1)
    data = request.configs[0].data
    assert (data.root, data.extra, data.backgrounds) == (places["cad"], places["pascal"], places["cad"])
    assert (request.ridge, request.calibration) == (50, 64)
    assert [c.seed for c in request.configs] == [0, 1] * len(request.trained_variants)
    assert request.label == (
        "tiny-car-data_root-cad_root-extra_cad-backgrounds-pascal-easy-margin0.1-pixels-ridge50-calibration64"
    )
    assert request.note.startswith("PASCAL3D+ (pascal); trained on a CAD collection and a second one")


def test_nothing_but_the_default_is_written_where_the_default_goes(tmp_path):
    root = str(tmp_path)
    options = [
        {"profile": "smoke"}, {"categories": "everything"}, {"categories": "car"}, {"data_root": root},
        {"cad_root": root}, {"extra_cad": root}, {"backgrounds": root}, {"subset": "both"}, {"keep": "first"},
        {"margin": 0.2}, {"features": "pixels"}, {"ridge": 1}, {"calibration": 16}, {"recipe": "matting"},
    ]  # fmt: skip
    labels = [experiment("table5_dva", **option).label for option in options]
    assert len({"", *labels}) == len(options) + 1
    assert experiment("table5_dva", categories="everything").label == "tiny-everything"


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"subset": "voc"}, "unknown subset 'voc'"),
        ({"keep": "hard"}, "unknown keep 'hard'"),
        ({"margin": "wide"}, "margin 'wide': expected a number"),
        ({"margin": -1}, "margin -1: expected 0 to 2"),
        ({"ridge": 0}, "ridge 0: expected more than 0"),
        ({"calibration": 3}, "calibration 3: expected a whole"),
        ({"calibration": True}, "calibration True"),
        ({"features": "vgg99"}, "unknown network 'vgg99'"),
        ({"features": "resnet18"}, "no resnet18 weights at"),
        ({"data_root": "nowhere"}, "data_root nowhere: no such folder"),
        ({"backgrounds": "nowhere"}, "backgrounds nowhere: no such folder"),
        ({"eval_root": "x"}, "table3_pascal3d 'eval_root'"),
        ({"variant": "viewnet"}, "table3_pascal3d 'variant'"),
        ({"rows": "viewnet,mvc"}, "unknown row of table3_pascal3d 'mvc'"),
        ({"margins": 1}, "table3_pascal3d 'margins'"),
    ],
)
def test_bad_parameters_are_named(option, message):
    with pytest.raises(ViewnetError, match=message):
        experiment("table3_pascal3d", **option)


def test_other_notebooks_take_nothing_of_photographs():
    with pytest.raises(ViewnetError, match="table2_ablation 'ridge'"):
        experiment("table2_ablation", ridge=3)
    assert "ridge" in accepted("table5_dva") and "ridge" not in accepted("table2_ablation")
    assert "eval_root" in accepted("table2_ablation") and "eval_root" not in accepted("table5_dva")


@pytest.mark.slow
def test_predictions_of_photographs_are_kept_with_the_run(photographs, tmp_path):
    request = experiment("table3_pascal3d", profile="smoke", categories="car")
    first, *_ = run(request)
    store = request.stores()["car"]
    said = on_photographs(first, store, STEPS)
    assert len(said.subset("val")) == len(said.subset("test")) == 40
    (kept,) = first.folder.glob("predictions-*.parquet")
    assert store.identity in kept.name
    nothing = STEPS.__class__(STEPS.views, STEPS.open, STEPS.train, lambda *a, **k: pytest.fail("predicted again"))
    assert np.array_equal(on_photographs(first, store, nothing).hypotheses, said.hypotheses)
    other = make_photos(tmp_path / "other", seed=99)
    with pytest.raises(pytest.fail.Exception):
        on_photographs(first, other, nothing)
    on_photographs(first, other, STEPS)
    assert len(list(first.folder.glob("predictions-*.parquet"))) == 2


@pytest.mark.slow
def test_predictions_of_other_code_or_weights_are_made_anew(photographs, monkeypatch):
    request = experiment("table3_pascal3d", profile="smoke", categories="car")
    first, *_ = run(request)
    store = request.stores()["car"]
    on_photographs(first, store, STEPS)
    calls = []
    counting = STEPS.__class__(
        STEPS.views, STEPS.open, STEPS.train, lambda *a, **k: calls.append(1) or STEPS.predict(*a, **k)
    )
    (first.folder / "checkpoint.safetensors").write_bytes(b"other weights")
    on_photographs(first, store, counting)
    assert len(calls) == 1
    monkeypatch.setattr("viewnet.runtime.provenance.code_identity", lambda modules: "edited")
    on_photographs(first, store, counting)
    assert len(calls) == 2
    (kept,) = first.folder.glob("predictions-*.parquet")
    os.utime(kept, (4e9, 4e9))  # a clock that was ahead
    (first.folder / "checkpoint.safetensors").write_bytes(b"weights of a third kind")
    on_photographs(first, store, counting)
    assert len(calls) == 3
    (kept,) = first.folder.glob("predictions-*.parquet")
    assert kept.name.startswith(f"predictions-{store.identity}-edited-")


@pytest.mark.slow
def test_only_what_was_trained_looks_at_photographs(photographs):
    from viewnet.runs.run_store import untrained

    request = experiment("table3_pascal3d", profile="smoke", categories="car")
    (constant,) = ensure([untrained("constant", request.configs[0])], progress=False, steps=STEPS)
    with pytest.raises(ViewnetError, match=r"constant car .* has no network"):
        on_photographs(constant, request.stores()["car"], STEPS)


@pytest.mark.slow
def test_table_3_has_every_row_by_its_own_alignment(photographs, steps, tmp_path):
    request = experiment("table3_pascal3d", profile="smoke", categories="car,chair", calibration=30)
    runs = run(request)
    table = request.table(runs)
    assert table.complete
    rows = [named(r.label, "photos" * (r.variant in VARIANTS)) for r in LAYOUTS["table3_pascal3d"].rows if r.variant]
    rows = [row for row in rows if "SqueezeNet" not in row]  # optional
    measured = table.cells[table.cells["seeds"] > 0]
    assert set(measured["row"]) == {*rows, "VGG view* (pixels)"} - {"VGG view*"}
    store = request.stores()["car"]
    car = next(r for r in runs if (r.config.variant, r.config.category) == ("viewnet", "car"))
    said = as_kept(on_photographs(car, store))  # as they are kept beside the table
    for row, kind in (("ViewNet (photos)", "procrustes"), ("ViewNet* (photos)", "linear")):
        errors = align(said, kind, 30).selected_errors
        assert cell_of(table, row, "car", "median")["measured"] == pytest.approx(np.median(errors))
    keys = {row: cell_of(table, row, "car", "median")["runs"] for row in table.rows}
    assert keys["ViewNet (photos)"] == car.key and keys["ViewNet* (photos)"] == f"{car.key}/linear"
    assert table.provenance[keys["ViewNet* (photos)"]]["alignment"] == "linear"
    assert table.provenance[keys["ViewNet* (photos)"]]["photographs"] == store.identity
    regression = table.provenance[keys["VGG view* (pixels)"]]
    assert (regression["features"], regression["ridge"], regression["calibration"]) == ("pixels", 1000, 30)
    # Reported numbers stay with their rows, whatever the rows are called.
    assert cell_of(table, "VGG view* (pixels)", "car", "acc30")["printed"] == "56"
    assert cell_of(table, "Liao (withdrawn)", "car", "acc30")["printed"] == "93"
    assert cell_of(table, "SSV*", "car", "acc30")["seeds"] == 0
    assert "80 used, 1 left out" in table.remarks
    assert any("30 calibration photographs" in line for line in table.remarks)
    files = table.write(tmp_path / "written")
    assert "left out" in files[0].read_text()


@pytest.mark.slow
def test_the_dva_table_tells_the_confidence_index_of_the_photographs(photographs, steps):
    request = experiment("table5_dva", profile="smoke", categories="car")
    table = request.table(run(request))
    assert table.complete
    from viewnet.evaluation.metrics import confidence_index, dva

    store = request.stores()["car"]
    test = store.index[store.index["split"] == "test"]
    cell = cell_of(table, "Confidence index", "car", "confidence_index")
    assert cell["measured"] == confidence_index(test["azimuth"].to_numpy())
    assert cell["printed"] == "1"
    frame = table.frame()
    assert frame.loc["Confidence index", ("dva", "car", "ours")] == f"{cell['measured']:.2f}"
    found = align(on_photographs(run(request)[0], store), "linear")
    expected = dva(found.selected_errors, test["azimuth"].to_numpy())
    starred = cell_of(table, "ViewNet* (photos)", "car", "dva")
    assert starred["measured"] == pytest.approx(expected)
    assert starred["low"] < expected < starred["high"]
    assert list(table.measurements().columns) == ["DVA, % [95 %]", "seeds", "objects", "images"]
    assert table.verdict() == []  # differences are of Acc@30


def test_baselines_are_fitted_on_as_many_photographs_as_are_asked_for(photographs):
    request = experiment("table3_pascal3d", profile="smoke", categories="car", calibration=16)
    store = request.stores()["car"]
    for variant in ("constant", "constant_rotation", "view_regression"):
        said, _ = request.fitted(variant, store, 16)
        assert len(said.subset("val")) == 16
        everything, _ = request.fitted(variant, store)
        assert not np.allclose(said.subset("test").selected, everything.subset("test").selected)


def test_recipes_named_here_exist():
    assert set(PHOTO_RECIPE) == set(PROFILES)
    assert set(PHOTO_RECIPE.values()) <= set(RECIPES)
