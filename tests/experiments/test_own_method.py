"""Users' own methods in the tables: scored like ViewNet, given images only, and checked."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
import torch
from helpers.evaluation_data import make_index, noisy
from helpers.fake_steps import STEPS
from helpers.latex import assert_tabular
from helpers.photo_data import keep_apart, make_photos
from helpers.tables import cell_of

from viewnet import geometry
from viewnet.config import CATEGORIES
from viewnet.data.pairs import load_views
from viewnet.data.store import ViewStore, write_store
from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predictions import Predictions, true_vectors
from viewnet.experiments import experiment, own_method
from viewnet.experiments.own_method import (
    OwnMethodExperiment,
    Submission,
    held_out,
    predictions,
    view_vectors,
    with_methods,
)
from viewnet.experiments.request import accepted
from viewnet.runs.other_views import on_photographs
from viewnet.runs.run_store import ensure
from viewnet.tables import definitions
from viewnet.tables.columns import DASH
from viewnet.tables.layouts import ADDED
from viewnet.tables.table import CHOSEN_ROBUSTLY, Entry, Table, named

SCORES = ("measured", "low", "high", "images", "objects")


class Brightest:
    """Reads the viewpoint off the synthetic photographs' bright square, in a frame a quarter turn off."""

    def predict(self, images):
        rows, columns = np.indices(images.shape[1:3]) - images.shape[1] / 2 + 0.5
        bright = images[..., 0] > 100
        turn = np.degrees(np.arctan2((bright * rows).sum((1, 2)), (bright * columns).sum((1, 2))))
        return view_vectors(turn + 90, np.zeros(len(images)))


class Nearest:
    """The viewpoint of the most similar calibration image; stores its inputs."""

    def __init__(self):
        self.fits, self.shown = [], []

    def fit(self, images, vectors):
        self.fits.append((images, vectors))

    def predict(self, images):
        self.shown.append(images)
        known, vectors = self.fits[-1]
        away = [np.abs(known.astype(float) - image).sum((1, 2, 3)).argmin() for image in images]
        return vectors[away]


class Says:
    """Predicts what it was constructed with."""

    def __init__(self, said):
        self.said = said

    def predict(self, images):
        return self.said(len(images))


def straight(count):
    return np.tile([1.0, 0.0, 0.0], (count, 1))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run store that no test changes."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(autouse=True)
def apart(tmp_path, monkeypatch, trained):
    keep_apart(tmp_path, monkeypatch)
    monkeypatch.setenv("VIEWNET_RUNS", str(trained))
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)


@pytest.fixture
def photographs(tmp_path, monkeypatch):
    """Fake photographs, 40 to calibrate on and 40 to score in each category."""

    def views(config, workers=None, progress=True):
        folder = tmp_path / "photos" / config.category
        if folder.exists():
            return ViewStore.open(folder)
        return make_photos(folder, category=config.category, seed=CATEGORIES.index(config.category))

    monkeypatch.setattr("viewnet.data.build.photo_views", views)
    monkeypatch.setattr("viewnet.data.photo_store.summary", lambda store: "all used")


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Views with transparent pixels, indexed like those of the synthetic runs."""

    def views(config, workers=None, progress=True):
        other = "other-" if config.root else ""
        folder = tmp_path / "drawn" / f"{other}{config.category}"
        if folder.exists():
            return ViewStore.open(folder)
        index = make_index(30, 4, config.category, seed=config.seed).assign(source="made up")
        index["model_id"] = other + index["model_id"]
        images = np.random.default_rng(7).integers(0, 256, (len(index), 16, 16, 4), dtype=np.uint8)
        return write_store(folder, [images], index, {"made up": folder.name})

    monkeypatch.setattr("viewnet.data.build.view_store", views)


def finished(request):
    return ensure(request.configs, workers=1, progress=False, steps=STEPS)


def of_cars(name="table3_pascal3d", **options):
    return experiment(name, profile="smoke", categories="car", **options)


def on_cars(name="table3_pascal3d", **options):
    request = of_cars(name, **options)
    return request, finished(request)


def alone(name, *submissions):
    """The table of cars with nothing measured but these."""
    return Table.of(name, own_method.entries(of_cars(name), submissions), ["car"])


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@pytest.mark.slow
def test_the_same_predictions_score_the_same_as_ours_to_the_last_bit(photographs, tmp_path, suffix):
    request, runs = on_cars(calibration=30)
    ours = on_photographs(next(run for run in runs if run.config.variant == "viewnet"), held_store(request))
    file = tmp_path / f"said{suffix}"
    ours.to_parquet(file)
    if suffix == ".csv":
        pd.read_parquet(file).sample(frac=1, random_state=0).to_csv(file, index=False)
    kinds = {"ViewNet": "procrustes", "ViewNet*": "linear", "ViewNet (robust)": "robust"}
    table = with_methods(request, runs, [Submission(f"By file, {kind}", file, kind) for kind in kinds.values()])
    for row, kind in kinds.items():
        for metric in ("acc30", "median"):
            mine, theirs = (cell_of(table, r, "car", metric) for r in (f"By file, {kind}", named(row, "photos")))
            assert [mine[s] for s in SCORES] == [theirs[s] for s in SCORES]
    added = [row for row in table.rows if row.startswith("By file")]
    assert added == [f"By file, {kind}" for kind in kinds.values()]
    assert table.complete


def held_store(request, category="car"):
    return request.stores()[category]


def test_table_1_scores_views_of_cad_models(drawn, tmp_path):
    request, runs = on_cars("table1_shapenet")
    ours = next(run for run in runs if run.config.variant == "viewnet").predictions
    ours.to_parquet(tmp_path / "said.parquet")
    mine = [Submission("Straight", Says(straight), "none"), Submission("By file", tmp_path / "said.parquet")]
    table = with_methods(request, runs, mine)
    for metric in ("acc30", "median"):
        scores = [[cell_of(table, row, "car", metric)[s] for s in SCORES] for row in ("ViewNet (matting)", "By file")]
        assert scores[0] == scores[1]
    ids = held_out(request, "car").ids
    expected = np.median(
        align(Predictions(ids, straight(len(ids))[:, None], np.zeros((len(ids), 1))), "none").selected_errors
    )
    assert cell_of(table, "Straight", "car", "median")["measured"] == pytest.approx(expected)
    assert_tabular(table.latex())
    assert "Straight: added, by predict; alignment none" in table.latex()


def test_another_collection_is_scored_as_a_whole(drawn, tmp_path):
    request, runs = on_cars("table1_shapenet", eval_root=str(tmp_path))
    images = held_out(request, "car")
    assert images.ids["split"].value_counts().to_dict() == {"test": 120, "val": 32}
    assert images.ids.loc[images.ids["split"] == "test", "model_id"].str.startswith("other-").all()
    table = with_methods(request, runs, [Submission("Straight", Says(straight))])
    assert [cell_of(table, row, "car", "acc30")["images"] for row in ("Straight", "ViewNet (matting)")] == [120, 120]


def test_a_method_without_labels_is_aligned(photographs):
    table = alone("table3_pascal3d", Submission("As is", Brightest(), "none"), Submission("Turned", Brightest()))
    assert cell_of(table, "As is", "car", "acc30")["measured"] == 0
    assert cell_of(table, "Turned", "car", "acc30")["measured"] > 95


def test_the_dva_table_has_its_row_too(photographs):
    table = alone("table5_dva", Submission("Turned", Brightest()))
    assert cell_of(table, "Turned", "car", "dva")["measured"] > 95
    assert cell_of(table, "Turned", "car", "confidence_index") is None


@pytest.mark.slow
def test_rows_stand_in_everything_a_reader_sees(photographs, tmp_path):
    request, runs = on_cars()
    mine = Submission("Mine^2 & 100 %", Brightest())
    table = with_methods(request, runs, [mine])
    bare = request.table(runs)
    assert table.frame().drop("Mine^2 & 100 %").equals(bare.frame())
    row = table.frame().loc["Mine^2 & 100 %"]
    assert (row.xs("print", level=2) == DASH).all()
    assert (row.xs("ours", level=2) != DASH).all()
    assert ("Mine^2 & 100 %", "car") in table.measurements().index
    assert any(line.startswith("Mine^2 & 100 % beside ViewNet (") for line in table.verdict())
    files = table.write(tmp_path / "written")
    assert_tabular(files[0].read_text().replace(r"\textasciicircum{}", ""))
    assert r"Mine\textasciicircum{}2 \& 100 \% &  & -- &" in files[0].read_text()
    told = json.loads(files[2].read_text())
    (cell,) = [c for c in told["cells"] if c["row"] == mine.label and c["metric"] == "acc30"]
    assert cell["printed"] == "" and cell["measured"] > 95
    (key,) = cell["runs"]
    origin = told["runs"][key]
    assert (origin["label"], origin["alignment"], origin["source"]) == (mine.label, "procrustes", "Brightest")
    assert origin["images"] == held_store(request).identity
    assert origin["predictions"] == own_method.digest(predictions(request, mine))
    assert "Mine^2 & 100 %: added, by predict; alignment procrustes" in told["remarks"]


def test_many_categories_have_the_row_in_one_line():
    origin = {"variant": ADDED}
    added = [Entry("Mine", c, 0, "procrustes", c, noisy(make_index(20, 2, c)), origin) for c in CATEGORIES[:5]]
    text = Table.of("table3_pascal3d", added, CATEGORIES[:5]).latex()
    assert_tabular(text)
    assert "Mine, \\textit{ours} &  & \\textit{" in text


def test_the_key_is_of_what_was_said_and_how_it_is_aligned(photographs):
    request = of_cars()
    submissions = [
        Submission("A", Brightest()), Submission("B", Brightest()), Submission("A", Brightest(), "linear"),
        Submission("A", Says(straight)), Submission("A", Brightest()),
    ]  # fmt: skip
    keys = [own_method.entries(request, [submission])[0].key for submission in submissions]
    assert len(set(keys)) == 4
    assert keys[0] == keys[4]


def test_a_method_sees_the_pixels_that_our_networks_see(drawn):
    images = held_out(of_cars("table1_shapenet"), "car")
    for split in ("val", "test"):
        store, rows = images.stores[split]
        ours = load_views(store, split, store.images.shape[1]).pixels[:, :3].permute(0, 2, 3, 1)
        assert np.array_equal(images.images(split, np.arange(len(rows))), ours.numpy())


def test_nothing_but_images_is_handed_out(photographs, monkeypatch):
    monkeypatch.setattr(own_method, "BATCH", 16)
    request = of_cars(calibration=20)
    nearest = Nearest()
    said = predictions(request, Submission("Nearest", nearest, "none"))
    ((fitted, vectors),) = nearest.fits
    store = held_store(request)
    assert len(fitted) == len(vectors) == 20
    # The same as predictions are aligned on, each with its own viewpoint.
    drawn = align(said, "none", 20).calibration
    assert np.array_equal(vectors, drawn.truth)
    mine = store.index["model_id"].isin(drawn.ids["model_id"])
    assert np.array_equal(fitted, store.images[mine][..., :3])
    for images in nearest.shown:
        assert type(images) is np.ndarray and images.base is None
        assert images.shape[1:] == (24, 24, 3) and images.dtype == np.uint8 and len(images) <= 16
        images[:] = 0  # it may change them
    assert sum(map(len, nearest.shown)) == 80
    assert np.array_equal(ViewStore.open(store.folder).images, store.images) and store.images.any()


def test_images_come_in_an_order_of_their_own_and_answers_find_their_places(photographs):
    request = of_cars()
    seen = []

    class Watching(Brightest):
        def predict(self, images):
            seen.append(images.copy())
            return super().predict(images)

    said = predictions(request, Submission("Watching", Watching()))
    store = held_store(request)
    val = store.images[store.split("val")][..., :3]
    assert not np.array_equal(seen[0], val)
    assert np.array_equal(np.sort(seen[0].sum((1, 2, 3))), np.sort(val.sum((1, 2, 3))))
    azimuths = geometry.azimuth_elevation(torch.from_numpy(said.selected))[0].numpy()
    turned = azimuths - said.ids["azimuth"].to_numpy() - 90
    assert np.median(np.abs((turned + 180) % 360 - 180)) < 10


def test_a_category_may_have_a_method_of_its_own_and_learns_by_itself(photographs):
    request = experiment("table3_pascal3d", profile="smoke", categories="car,chair")
    nearest = Nearest()
    said = predictions(request, Submission("Nearest", nearest))
    assert len(nearest.fits) == 2
    assert not np.array_equal(nearest.fits[0][0], nearest.fits[1][0])
    assert said.ids["category"].unique().tolist() == ["car", "chair"]
    both = Submission("Both", {"car": Says(straight), "chair": Says(lambda n: -straight(n))})
    vectors = predictions(request, both)
    assert (vectors.selected[:, 0] == np.where(vectors.ids["category"] == "car", 1, -1)).all()
    with pytest.raises(ViewnetError, match="'Half' 'chair'"):
        predictions(request, Submission("Half", {"car": Says(straight)}))


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (["Mine", "Mine"], "row 'Mine'"),
        (["ViewNet"], "row 'ViewNet': the table has a row"),
        (["SSV*"], r"row 'SSV\*': the table has a row"),
        (["Liao"], "row 'Liao': the table has a row"),  # reported under that name
        (["VGG view* (pixels)"], r"row 'VGG view\* \(pixels\)'"),
    ],
)
def test_a_label_is_there_once_and_that_is_found_before_a_method_is_asked(photographs, labels, message):
    refusing = Says(lambda count: pytest.fail("asked"))
    with pytest.raises(ViewnetError, match=message):
        own_method.entries(of_cars(), [Submission(label, refusing) for label in labels])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("", Brightest()), "method '': expected a label"),
        (("a\nb", Brightest()), "expected a label in a line of text"),
        ((3, Brightest()), "method 3: expected a label"),
        (("Mine", Brightest), r"method 'Mine': Brightest is a class"),
        (("Mine", object()), r"method 'Mine': has no predict\(images\)"),
        (("Mine", {"car": None}), r"method 'Mine': has no predict\(images\)"),
        (("Mine", Brightest(), "rigid"), "alignment of Mine 'rigid'"),
    ],
)
def test_what_is_no_submission_is_told(arguments, message):
    with pytest.raises(ViewnetError, match=message):
        Submission(*arguments)


def with_nan(count):
    return np.where(np.arange(count)[:, None] == 5, np.nan, straight(count))


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (with_nan, r".*nan.* image 5 of the 40 .*1 are none"),
        (lambda n: 2 * straight(n), r".*2.0, 0.0, 0.0. for image 0 .*40 are"),
        (lambda n: straight(n - 1), r".*\(39, 3\) .* expected \(40, 3\)"),
        (lambda n: straight(n)[:, :2], r".*\(40, 2\) for 40 images"),
        (lambda n: None, r"predict returned \(\) for 40 images"),
        (lambda n: ["front"] * n, "predict returned no array of numbers"),
        (lambda n: torch.ones(n, 3, requires_grad=True), ".*no array of numbers .*requires grad"),
    ],
)
def test_bad_answers_are_named(photographs, said, message):
    with pytest.raises(ViewnetError, match=f"^method 'Mine', car: {message}"):
        own_method.entries(of_cars(), [Submission("Mine", Says(said))])


def test_a_method_s_own_errors_are_its_own(photographs):
    with pytest.raises(ZeroDivisionError):
        own_method.entries(of_cars(), [Submission("Mine", Says(lambda n: n / 0))])


def test_only_tables_take_methods():
    with pytest.raises(ViewnetError, match="unknown table 'figure3_azimuth'"):
        with_methods(experiment("figure3_azimuth", profile="smoke"), [], [])


def test_a_second_collection_shares_no_model_with_the_first(tmp_path, monkeypatch):
    def views(config, workers=None, progress=True):
        folder = tmp_path / "same"
        if folder.exists():
            return ViewStore.open(folder)
        index = make_index(30, 4, "car").assign(source="")
        return write_store(folder, [np.zeros((len(index), 8, 8, 4), np.uint8)], index, {})

    monkeypatch.setattr("viewnet.data.build.view_store", views)
    request = of_cars("table1_shapenet", eval_root=str(tmp_path))
    with pytest.raises(ViewnetError, match="model 00000 is in the collection"):
        held_out(request, "car")


def test_angles_and_vectors_are_each_other_s_inverse():
    rng = np.random.default_rng(0)
    azimuth, elevation = rng.uniform(0, 360, 50), rng.uniform(-89, 89, 50)
    vectors = view_vectors(azimuth, elevation)
    assert np.allclose(vectors, true_vectors(pd.DataFrame({"azimuth": azimuth, "elevation": elevation})))
    assert np.allclose(view_vectors([0, 90], [0, 0]), [[1, 0, 0], [0, 1, 0]])
    angles = geometry.azimuth_elevation(torch.from_numpy(vectors))
    assert np.allclose([part.numpy() for part in angles], [azimuth, elevation])


class TestTheNotebook:
    @pytest.mark.slow
    def test_runs_are_those_of_its_tables_each_once(self, photographs, drawn):
        request = experiment("your_method", categories="car", seeds=2)
        assert isinstance(request, OwnMethodExperiment)
        assert request.profile == "smoke"
        names = ("table1_shapenet", "table3_pascal3d", "table5_dva")
        alone = {name: experiment(name, profile="smoke", categories="car", seeds=2) for name in names}
        assert tuple(request.tables) == names
        assert {name: part.configs for name, part in request.tables.items()} == {n: a.configs for n, a in alone.items()}
        assert request.configs == alone[names[0]].configs + alone[names[1]].configs
        tables = request.score(finished(request), [Submission("Mine", Says(straight))])
        for name, table in tables.items():
            assert table.name == name and table.complete
            assert "Mine" in table.rows and table.rows[-1] == "Grabner (trained here)"

    @pytest.mark.slow
    def test_runs_that_its_tables_have_kept_are_not_trained_again(self, photographs, drawn, trained, monkeypatch):
        request = experiment("your_method", categories="car")
        mine = [Submission("Mine", Says(straight))]
        trained_now = request.score(finished(request), mine)
        for table in request.tables.values():
            found = table.table(finished(table))
            if table.name == "table1_shapenet":  # as by the recipe paper: its rows are taken, too
                ours = next(entry for entry in found.entries if entry.row == "ViewNet")
                chosen = dataclasses.replace(ours, row=ours.row + CHOSEN_ROBUSTLY, key=f"{ours.key}-robust")
                found = table.table_of([*found.entries, chosen])
            definitions.write_with(found, table.folder)
        again = experiment("your_method", categories="car")
        monkeypatch.setenv("VIEWNET_RUNS", str(trained / "empty"))
        assert again.to_run == [] == again.run()
        assert not again.needs().runs
        for name, table in again.score([], mine).items():
            ours = table.cells[~table.cells["row"].str.contains(CHOSEN_ROBUSTLY)]
            assert (len(ours) < len(table.cells)) == (name == "table1_shapenet")
            assert list(ours["row"]) == list(trained_now[name].cells["row"])
            numbers = ["measured", "low", "high"]
            assert np.allclose(ours[numbers], trained_now[name].cells[numbers], atol=5e-3, equal_nan=True)
        assert len(experiment("your_method", categories="car", seeds=2).to_run) == len(request.configs)

    def test_its_tables_go_where_no_other_does(self, tmp_path):
        options = [{}, {"profile": "tiny"}, {"categories": "car"}, {"calibration": 8}, {"backgrounds": str(tmp_path)},
                   {"data_root": str(tmp_path)}, {"cad_root": str(tmp_path)}]  # fmt: skip
        folders = [experiment("your_method", **option).folder for option in options]
        assert len(set(folders)) == len(options)
        assert folders[0] == tmp_path / "tables" / "your_method"
        assert folders[1:3] == [folders[0] / "tiny", folders[0] / "smoke-car"]

    def test_parameters_reach_the_tables(self, tmp_path):
        for place in ("cad", "photos"):
            (tmp_path / place).mkdir()
        cad, photos = str(tmp_path / "cad"), str(tmp_path / "photos")
        request = experiment("your_method", cad_root=cad, data_root=photos, calibration=16, backgrounds="drawn")
        assert request.tables["table1_shapenet"].configs[0].data.root == cad
        on_photos = request.tables["table3_pascal3d"]
        assert (on_photos.configs[0].data.root, on_photos.photo_config("car").root) == (cad, photos)
        assert on_photos.calibration == request.tables["table5_dva"].calibration == 16

    @pytest.mark.parametrize(
        "option", [{"recipe": "paper"}, {"splits": "x"}, {"eval_root": "x"}, {"variant": "viewnet"}]
    )
    def test_what_it_does_not_take_is_told(self, option):
        with pytest.raises(ViewnetError, match=f"unknown parameter of your_method '{next(iter(option))}'"):
            experiment("your_method", **option)
        assert not set(option) & set(accepted("your_method"))
