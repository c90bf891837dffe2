from __future__ import annotations

import math

import pytest

from viewnet.config import SHAPENET_CATEGORIES
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.experiments.parameters import PARAMETERS
from viewnet.experiments.request import DESIGNS, accepted


@pytest.fixture(autouse=True)
def no_profile_from_outside(monkeypatch, tmp_path):
    monkeypatch.delenv("VIEWNET_PROFILE", raising=False)
    monkeypatch.setenv("VIEWNET_TABLES", str(tmp_path / "tables"))


def test_defaults_are_the_table_s(tmp_path):
    request = experiment("table2_ablation")
    assert request.profile == "tiny"
    assert request.categories == SHAPENET_CATEGORIES
    assert request.seeds == (0,)
    assert request.folder == tmp_path / "tables"
    assert len(request.configs) == 10 * 3
    assert request.configs[0].variant == "viewnet"
    assert "profile tiny, recipe matting, 1 seed" in request.note


def test_the_environment_sets_the_default_profile_and_only_that(monkeypatch):
    monkeypatch.setenv("VIEWNET_PROFILE", "smoke")
    assert experiment("table1_shapenet").profile == "smoke"
    assert experiment("table1_shapenet", profile="small").profile == "small"
    monkeypatch.setenv("VIEWNET_PROFILE", "huge")
    with pytest.raises(ViewnetError, match="unknown profile 'huge'"):
        experiment("table1_shapenet")


@pytest.mark.parametrize("given", ["car,chair", "car, chair", ["car", "chair"], ("car", "chair")])
def test_categories_as_text_or_list(given):
    assert experiment("table1_shapenet", categories=given).categories == ("car", "chair")


@pytest.mark.parametrize(
    ("given", "seeds"), [(3, (0, 1, 2)), ("2", (0, 1)), ("0,4", (0, 4)), ([7], (7,)), ("7,", None)]
)
def test_seeds_as_count_or_list(given, seeds):
    if seeds is None:
        with pytest.raises(ViewnetError, match="expected how many"):
            experiment("table1_shapenet", seeds=given)
    else:
        assert experiment("table1_shapenet", seeds=given).seeds == seeds


def test_constants_are_run_once_a_category_however_many_seeds():
    request = experiment("table2_ablation", seeds=3, categories="car")
    variants = [config.variant for config in request.configs]
    assert variants.count("viewnet") == 3
    assert variants.count("constant") == variants.count("best_constant") == 1
    assert "mean of 3 seeds" in request.note


def test_nothing_but_the_default_is_written_where_the_default_goes(tmp_path):
    base, root = tmp_path / "tables", str(tmp_path)
    options = [
        {"profile": "smoke"}, {"profile": "small"}, {"categories": "car"}, {"recipe": "paper"},
        {"data_root": root}, {"eval_root": root}, {"profile": "small", "categories": "car", "recipe": "paper"},
    ]  # fmt: skip
    folders = [experiment("table2_ablation", **option).folder for option in options]
    assert len({base, *folders}) == len(options) + 1
    assert all(folder.parent == base for folder in folders)
    assert folders[0].name == "smoke"
    assert folders[2].name == "tiny-car"
    assert experiment("table2_ablation", seeds=3).folder == base  # more seeds make the same table better
    assert experiment("table2_ablation", output=root, profile="smoke").folder == tmp_path / "smoke"
    assert experiment("architecture").folder == base


def test_a_figure_shows_the_variant_asked_for():
    assert experiment("figure3_azimuth").variants == ("viewnet",)
    request = experiment("figure3_azimuth", variant="viewnet_cycle")
    assert request.variants == ("viewnet_cycle",)
    assert request.folder.name == "tiny-viewnet_cycle"


def test_rows_are_those_asked_for_and_optional_ones_only_then(tmp_path):
    usual = experiment("table3_pascal3d").trained_variants
    assert "box_corners" in usual and "box_corners_imagenet" not in usual
    request = experiment("table3_pascal3d", rows="viewnet, box_corners_imagenet")
    assert request.trained_variants == ["viewnet", "box_corners_imagenet"]
    assert request.folder.name == "tiny-viewnet-box_corners_imagenet"
    left_out = {"Constant", "SSV (reduced)*", "Grabner (trained here)", "ViewNet + cycle"}
    assert left_out <= set(request.unmeasured_rows) and "ViewNet*" not in request.unmeasured_rows


def test_evaluation_data_are_all_models_of_the_other_collection(tmp_path):
    request = experiment("table1_shapenet", eval_root=str(tmp_path))
    data = request.eval_data(request.configs[0])
    assert (data.root, data.models) == (str(tmp_path.resolve()), 0)
    assert data.image_size == request.configs[0].data.image_size
    assert request.configs[0].data.root is None


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"profile": "huge"}, "unknown profile 'huge'"),
        ({"categories": "plane"}, "unknown category 'plane'"),
        ({"categories": "car,car"}, "a name is there twice"),
        ({"categories": 2958343}, "expected names such as car"),
        ({"categories": ""}, "expected names such as car"),
        ({"seeds": 0}, "seeds 0: expected how many"),
        ({"seeds": True}, "seeds True"),
        ({"seeds": "one"}, "seeds 'one'"),
        ({"seeds": [0, 0]}, r"seeds \[0, 0\]"),
        ({"recipe": "secret"}, "unknown recipe 'secret'"),
        ({"rows": "vgg"}, "unknown rows 'vgg'"),
        ({"rows": "viewnet,mvc"}, "unknown row of table2_ablation 'mvc'"),
        ({"data_root": "nowhere"}, "data_root nowhere: no such folder"),
        ({"splits": 3}, "splits 3: expected text"),
        ({"workers": -1}, "workers -1"),
    ],
)
def test_bad_parameters_are_named(option, message):
    with pytest.raises(ViewnetError, match=message):
        experiment("table2_ablation", **option)


TAKEN_BY = {name: next(design for design in DESIGNS if name in accepted(design)) for name in PARAMETERS}
ODD = (12345678901, 1.5, -1, True, None, [], [1], {}, {"car": 1}, math.nan, math.inf, object(), ("a", None))
NUMBERS = {"workers": (12345678901,), "calibration": (12345678901,), "seed": (12345678901,)}
NUMBERS |= {"seeds": ([1],), "margin": (1.5,), "ridge": (12345678901, 1.5)}
"""Parameter -> which of ODD are values of it."""


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("value", ODD, ids=lambda value: repr(value)[:8])
def test_values_of_any_type_are_taken_or_named(name, value):
    if value in NUMBERS.get(name, ()):
        assert experiment(TAKEN_BY[name], {name: value})
        return
    with pytest.raises(ViewnetError, match=rf"^(unknown )?{name} ") as raised:
        experiment(TAKEN_BY[name], {name: value})
    assert "expected" in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("name", "ignored", "refused"),
    [
        ("table2_ablation", {"video_root": "", "start": "", "keep": "all", "calibration": 0}, {"keep": "first"}),
        ("table4_freiburg", {"categories": "all", "splits": "", "ridge": 1000.0}, {"categories": "car"}),
        ("your_method", {"recipe": "default", "variant": "", "viewpoints": ""}, {"recipe": "photos"}),
    ],
)
def test_parameters_a_notebook_does_not_take_are_ignored_at_their_defaults(name, ignored, refused):
    assert experiment(name, **ignored) == experiment(name)
    with pytest.raises(ViewnetError, match=f"unknown parameter of {name} '{next(iter(refused))}'"):
        experiment(name, **ignored | refused)
    with pytest.raises(ViewnetError, match=f"unknown parameter of {name} 'nothing'"):
        experiment(name, nothing="")


def test_every_design_is_known():
    with pytest.raises(ViewnetError, match="unknown notebook 'table9'"):
        experiment("table9")
    assert set(DESIGNS) >= {"table1_shapenet", "table2_ablation", "figure3_azimuth", "architecture"}


def test_a_list_of_viewpoints_has_a_folder_of_its_own_and_no_profile(tmp_path, monkeypatch):
    monkeypatch.delenv("VIEWNET_PROFILE", raising=False)
    request = experiment("audit_metrics", viewpoints=str(tmp_path / "list.csv"), output=str(tmp_path))
    assert request.viewpoints == tmp_path / "list.csv"
    assert request.folder == tmp_path / "viewpoints"
    assert experiment("audit_metrics", output=str(tmp_path)).folder == tmp_path
