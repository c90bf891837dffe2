from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from helpers.photo_data import make_photos
from scipy.spatial.transform import Rotation

from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, metrics
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.predictions import Predictions
from viewnet.experiments.alignment_study import (
    RANDOM,
    RANDOM_SEED,
    Predictor,
    Study,
    collapse_rows,
    one_sided,
    score_rows,
    side,
    spread,
    study_alignment,
)
from viewnet.tables import plots


@pytest.fixture(scope="module")
def index(tmp_path_factory):
    return make_photos(tmp_path_factory.mktemp("photos") / "car", 1200, size=8).index


def noisy(index: pd.DataFrame, degrees: float = 8) -> Predictions:
    """The truth in a frame of its own, jittered."""
    turn = Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    right = baselines.oracle(index, rotation=turn)
    found = right.hypotheses + np.deg2rad(degrees) * np.random.default_rng(0).standard_normal(right.hypotheses.shape)
    return Predictions(right.ids, found / np.linalg.norm(found, axis=-1, keepdims=True), right.logits)


def predictor(said: Predictions, fitted: bool = False) -> Predictor:
    return Predictor("ViewNet", "car", 0, lambda count, seed: said, fitted)


def test_every_draw_is_the_alignment_of_that_many_photographs(index):
    said = noisy(index)
    rows = pd.DataFrame(score_rows(predictor(said), (16, 32, 5000), draws=2))
    assert set(rows["images"]) == {16, 32, 600}
    assert len(rows) == 4 * (2 * 2 + 1)
    one = rows[(rows["images"] == 32) & (rows["draw"] == 1) & (rows["alignment"] == "linear")].iloc[0]
    aligned = align(said, "linear", 32, seed=1)
    assert one["median"] == np.median(aligned.selected_errors)
    assert one["dva"] == metrics.dva(aligned.selected_errors, aligned.predictions.ids["azimuth"].to_numpy())
    few, many = (rows[(rows["images"] == n) & (rows["alignment"] == "procrustes")]["median"] for n in (16, 600))
    assert few.max() > many.min()


def test_what_is_fitted_is_fitted_anew_for_each_number_and_draw(index):
    calls = []

    def said(count, seed):
        calls.append((count, seed))
        rows = baselines.calibrating(index, count, seed)
        return baselines.constant(index[rows], source="val")

    rows = pd.DataFrame(score_rows(Predictor("Constant", "car", 0, said, True), (16,), draws=2))
    assert calls[1:] == [(16, 0), (16, 1), (600, 0)]
    assert set(rows["alignment"]) == {"none", "procrustes", "robust", "linear", "per_angle"}
    assert rows.groupby(["images", "draw"])["median"].nunique().min() >= 1
    assert rows[rows["images"] == 16].groupby("draw")["median"].first().nunique() == 2


def test_parts_are_as_one_sided_as_asked_for(index):
    said = noisy(index)
    assert len(one_sided(said, 0)) == len(said)
    shares = [side(one_sided(said, k).ids["azimuth"].to_numpy()) for k in (0, 1, 4, 8)]
    assert shares == sorted(shares)
    assert shares[0] < 0.15 and shares[-1] > 0.35
    few = said.take(np.arange(40))
    assert one_sided(few, 8) is None
    with pytest.raises(ViewnetError, match=r"concentration -1: expected 0 or more"):
        one_sided(said, -1)


def test_spread_is_that_of_directions():
    ring = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    assert spread(ring) == pytest.approx(1)
    assert spread(np.tile([0.6, 0, 0.8], (5, 1))) == pytest.approx(0)
    half = np.array([[1.0, 0, 0], [0, 1, 0]])
    assert spread(half) == pytest.approx(1 - np.square(half.mean(axis=0)).sum())


def test_every_predictor_is_left_with_the_same_photographs(index):
    said = noisy(index)
    shuffled = said.take(np.random.default_rng(0).permutation(len(said)))
    assert set(one_sided(said, 2).objects) == set(one_sided(shuffled, 2).objects)


def test_random_predictions_collapse_to_the_constant_and_good_ones_do_not(index):
    good = pd.DataFrame(collapse_rows(predictor(noisy(index))))
    none = pd.DataFrame(collapse_rows(predictor(baselines.random(index, seed=RANDOM_SEED))))
    assert (good["spread_linear"] > 0.8).all()
    assert (none["spread_linear"] < 0.3).all()
    assert np.allclose(none["acc30_linear"], none["acc30_constant"], atol=12)
    # One-sided photographs are where a collapsed map gains, and only as long as sides are not counted alike.
    last = none.iloc[-1]
    assert last["acc30_linear"] - last["acc30_rigid"] > 20
    assert last["weights"] < last["bias"]
    assert list(good["side"]) == sorted(good["side"])


@pytest.fixture(scope="module")
def found(index):
    said = {"ViewNet": noisy(index), RANDOM: baselines.random(index, seed=RANDOM_SEED)}
    mine = [Predictor(name, "car", 0, lambda c, s, p=p: p, False) for name, p in said.items()]
    fitted = Predictor("Constant", "car", 0, lambda c, s: baselines.constant(index, source="val"), True)
    scores = pd.DataFrame([row for p in (*mine, fitted) for row in score_rows(p, (16, 64), 2)])
    return Study(scores, pd.DataFrame([row for p in mine for row in collapse_rows(p)]))


def test_the_study_reads_as_tables(found, tmp_path):
    table = found.by_count()
    assert list(table.columns) == [16, 64, 600]
    assert len(table) == 4 + 4 + 5
    values = found.scores.query("predictor == 'ViewNet' and alignment == 'linear' and images == 16")["acc30"]
    assert table.loc[("car", "ViewNet", "linear"), 16] == (
        f"{values.median():.1f} [{values.min():.1f}, {values.max():.1f}]"
    )
    beside = found.side_by_side()
    assert list(beside.index) == [("car", "ViewNet"), ("car", RANDOM), ("car", "Constant")]
    assert np.isnan(beside.loc[("car", "ViewNet"), ("acc30", "none")])
    assert beside.loc[("car", "Constant"), ("acc30", "none")] >= 0
    verdict = found.verdict()
    assert verdict.loc[("car", RANDOM), "acc30_gain"] > 0.5
    assert verdict.loc[("car", RANDOM), "parts"] == len(found.collapse) // 2
    gain = found.collapsed().loc[("car", "ViewNet", 0.0)]
    assert gain["acc30_gain"] == pytest.approx(gain["acc30_linear"] - gain["acc30_rigid"], abs=0.11)
    files = found.write(tmp_path)
    assert [f.name for f in files] == ["alignment_study_scores.csv", "alignment_study_collapse.csv"]
    assert len(pd.read_csv(files[0])) == len(found.scores)


def test_figures_show_every_predictor_and_category(found, tmp_path):
    figure = plots.calibration_curves(found.scores)
    (axes,) = figure.axes  # one category, and one predictor that is aligned and not random
    assert axes.get_title() == "car" and axes.get_ylabel().startswith("ViewNet")
    lines = {line.get_label(): line for line in axes.lines}
    assert set(lines) == {"rotation", "robust rotation", "linear", "angle by angle", "Constant"}
    assert list(lines["linear"].get_xdata()) == [16, 64, 600]
    collapse = plots.collapse_curves(found.collapse)
    assert [axes.get_ylabel().partition("\n")[0] for axes in collapse.axes] == [
        "spread of predictions", "accuracy, linear", "DVA, linear",
    ]  # fmt: skip
    (line,) = (line for line in collapse.axes[0].lines if line.get_label() == "ViewNet")
    mine = found.collapse[found.collapse["predictor"] == "ViewNet"]
    assert np.allclose(line.get_ydata(), 100 * mine["spread_linear"])
    assert np.allclose(line.get_xdata(), 100 * mine["side"])
    for name, drawn in (("a", figure), ("b", collapse)):
        assert all(file.stat().st_size > 1000 for file in plots.save(drawn, tmp_path, name))


@pytest.mark.slow
def test_the_study_of_an_experiment_has_every_predictor_of_the_table(tmp_path, monkeypatch):
    import sys
    import types

    from helpers.fake_steps import STEPS

    from viewnet.experiments import experiment
    from viewnet.runs.run_store import ensure

    for name in ("RUNS", "DATA"):
        monkeypatch.setenv(f"VIEWNET_{name}", str(tmp_path / name.lower()))
    store = make_photos(tmp_path / "photos", 100, size=16)
    monkeypatch.setattr("viewnet.data.build.photo_views", lambda *a: store, raising=False)
    monkeypatch.setitem(sys.modules, "viewnet.data.photo_store", types.SimpleNamespace(summary=str))
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 16)
    request = experiment("alignment_study", profile="smoke", categories="car", features="pixels", seeds=2)
    found = study_alignment(request, ensure(request.configs, workers=1, progress=False, steps=STEPS))
    assert set(found.scores["predictor"]) == {
        "ViewNet", "ViewNet + cycle", RANDOM, "Constant", "Constant (rotation)", "VGG view*",
    }  # fmt: skip
    assert set(found.collapse["predictor"]) == {"ViewNet", "ViewNet + cycle", RANDOM}
    assert found.scores.groupby("predictor")["seed"].nunique()["ViewNet"] == 2
    assert set(found.scores["images"]) == {16, 32, 50}
