from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.evaluation_data import make_index, noisy

from viewnet.errors import ViewnetError
from viewnet.evaluation.run import NOT_SCORED, Run, can_be_scored, read_log, run_name
from viewnet.recipes import make_config

LOG = "epoch,step,seconds,loss,val_accuracy\n1,9,1.5,2.5,20\n2,18,3,1.5,\n"


@pytest.fixture
def run(tmp_path) -> Run:
    """A finished run, written by hand."""
    noisy(make_index(8, 2)).to_parquet(tmp_path / "predictions.parquet")
    (tmp_path / "log.csv").write_text(LOG)
    (tmp_path / "result.json").write_text(json.dumps({"metrics": {"procrustes": {"acc30": 50.0}}}))
    return Run(make_config("viewnet_cycle", "chair", profile="smoke", seed=3), tmp_path)


def test_a_finished_run_has_a_result_predictions_and_a_log(run):
    assert run.name == run_name(run.config) == "viewnet_cycle chair seed 3 (smoke, matting)"
    assert run.key == run.folder.name and run.trained and run.scored
    assert set(run.predictions.ids["split"]) == {"val", "test"}
    assert list(run.log["epoch"]) == [1, 2] and np.isnan(run.log["val_accuracy"].iloc[1])


@pytest.mark.parametrize(
    ("variant", "alignments"),
    [
        ("viewnet", ("procrustes", "linear")),
        *((variant, ("none", "procrustes")) for variant in ("constant", "best_constant", "random")),
    ],
)
def test_a_run_knows_how_it_is_aligned(run, variant, alignments):
    other = Run(make_config("viewnet", profile="smoke"), run.folder)
    object.__setattr__(other.config, "variant", variant)
    assert other.alignments == alignments and other.alignment == alignments[0]
    assert other.trained == (variant == "viewnet")


def test_a_run_that_is_not_finished_or_was_not_scored_is_refused(run):
    (run.folder / "result.json").write_text('{"metrics": null}')
    assert not run.scored
    with pytest.raises(ViewnetError, match=f"chair seed 3 .*: {NOT_SCORED}"):
        _ = run.predictions
    (run.folder / "result.json").write_text("{}")
    with pytest.raises(ViewnetError, match="no metrics"):
        _ = run.scored
    (run.folder / "result.json").write_text("[]")
    with pytest.raises(ViewnetError, match=r"result.json: not a run's result"):
        _ = run.result
    (run.folder / "log.csv").unlink()
    with pytest.raises(ViewnetError, match=r"no log.csv: viewnet_cycle chair"):
        _ = run.log


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LOG.replace("1.5,2.5", "1.5,high"), "column 'loss' .* not numbers"),
        ("epoch,step\n1,2\n", "column 'loss' is missing"),
    ],
)
def test_damaged_logs_name_the_column(tmp_path, text, message):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(ViewnetError, match=message):
        read_log(tmp_path / "log.csv")
    (tmp_path / "log.csv").write_text(LOG.splitlines()[0])
    assert read_log(tmp_path / "log.csv").empty


def test_views_can_be_scored_with_both_splits_and_all_viewpoints():
    index = make_index(8, 2)
    assert can_be_scored(index)
    assert not can_be_scored(index[index["split"] != "val"])
    assert not can_be_scored(index.assign(azimuth=index["azimuth"].where(index["split"] != "test")))
    assert can_be_scored(index.assign(azimuth=index["azimuth"].where(index["split"] != "train")))
