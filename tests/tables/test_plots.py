from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.untrained_models import untrained_run
from matplotlib.text import Text

from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.tables import image_grids, plots


def test_azimuths_are_those_of_the_aligned_selection(smoke_runs):
    aligned = align(smoke_runs[0].predictions)
    true, (predicted, _) = aligned.predictions.ids["azimuth"], plots.angles(aligned.selected)
    right = aligned.selected_errors < 10
    assert right.any()
    assert (np.abs((true - predicted + 180) % 360 - 180)[right] < 15).all()
    assert ((predicted >= 0) & (predicted < 360)).all()


def test_scatter_has_a_panel_a_category_and_a_point_an_image(smoke_runs):
    figure = plots.azimuth_scatter(smoke_runs[:2])
    assert [axes.get_title() for axes in figure.axes] == ["car", "chair"]
    for axes, run in zip(figure.axes, smoke_runs, strict=False):
        assert len(axes.collections[0].get_offsets()) == len(run.predictions.subset("test"))


def test_files_are_the_same_bytes_each_time(smoke_runs, tmp_path):
    first = plots.save(plots.azimuth_scatter(smoke_runs[:2]), tmp_path / "a", "figure3_azimuth")
    again = plots.save(plots.azimuth_scatter(smoke_runs[:2]), tmp_path / "b", "figure3_azimuth")
    assert [f.name for f in first] == ["figure3_azimuth.png", "figure3_azimuth.pdf"]
    for one, other in zip(first, again, strict=True):
        assert one.read_bytes() == other.read_bytes()
    assert first[0].read_bytes().startswith(b"\x89PNG")
    pdf = first[1].read_bytes()
    assert pdf.startswith(b"%PDF")
    assert b"CreationDate" not in pdf
    assert b"/Type3" not in pdf


def test_no_runs_cannot_be_plotted():
    with pytest.raises(ViewnetError, match="no runs to show"):
        plots.azimuth_scatter([])


BATCHES = {"paper": 16, "matting": 64}
"""Recipe -> batch size."""


def lines_of(axes) -> dict[str, list]:
    """Label -> points of the lines that have one."""
    named = [line for line in axes.lines if not line.get_label().startswith("_")]
    return {line.get_label(): line.get_xydata().tolist() for line in named}


def labels_of(axes) -> list[str]:
    return sorted(text.get_text() for text in axes.texts)


def test_curves_are_the_logs(tmp_path):
    runs = [untrained_run(tmp_path / v, v) for v in ("viewnet", "viewnet_cycle", "hologan_decoder")]
    logs = plots.training_logs(runs)
    figure = plots.training_curves(pd.concat([logs, logs.assign(seed=1, val_accuracy=logs["val_accuracy"] + 10)]))
    titles = [plots.MEASURES[name] for name in ("val_accuracy", "val_reconstruction", "loss")]
    assert [axes.get_ylabel() for axes in figure.axes] == titles
    assert figure.axes[0].get_title() == "car" and figure.axes[-1].get_xlabel() == "target images seen"
    for axes, values in zip(figure.axes, ([25, 65], [0.4, 0.2], [2.5, 1.5]), strict=True):
        assert len(lines_of(axes)) == 3 and len(axes.lines) == 9  # means and two seeds of each
        # steps of 16 targets
        assert lines_of(axes)["ViewNet"] == [[9 * 16, values[0]], [18 * 16, values[1]]]
        assert labels_of(axes) == ["HoloGAN-Decoder", "ViewNet", "ViewNet + cycle"]


def test_no_label_stands_on_another_and_every_line_is_within_its_axes():
    committed = Path(__file__).resolve().parents[2] / "paper_tables"
    scores = pd.read_csv(committed / "alignment_study_scores.csv")
    collapse = pd.read_csv(committed / "alignment_study_collapse.csv")
    logs = pd.read_csv(committed / "table2_ablation_logs.csv")
    drawn = [plots.calibration_curves(scores), plots.collapse_curves(collapse), plots.training_curves(logs)]
    for axes in (axes for figure in drawn for axes in figure.axes):
        named, (bottom, top) = lines_of(axes), axes.get_ylim()
        assert labels_of(axes) == sorted(named) and len(named) <= 7
        places = np.sort([text.get_position()[1] for text in axes.texts])
        assert (np.diff(places) > 0.99 * (top - bottom) / 11).all()
        assert all(bottom <= y <= top for points in named.values() for _, y in points)
    assert all("(" in axes.get_ylabel() for figure in drawn for axes in figure.axes if axes.get_ylabel())


def test_the_numbers_of_the_curves_name_their_run(tmp_path):
    logs = plots.training_logs([untrained_run(tmp_path / v, v) for v in ("viewnet", "single_head")])
    assert logs[["row", "recipe", "category", "seed", "targets"]].iloc[-1].tolist() == [
        "Single-head", "matting", "car", 0, 18 * 16,
    ]  # fmt: skip
    assert len(logs) == 4 and "val_accuracy" in logs


def test_recipes_are_told_apart_over_the_targets_they_saw(tmp_path):
    runs = [untrained_run(tmp_path / recipe, recipe=recipe, batch_size=batch) for recipe, batch in BATCHES.items()]
    figure = plots.training_curves(plots.training_logs(runs))
    assert {axes.get_xscale() for axes in figure.axes} == {"log"}
    drawn = {name: [x for x, _ in points] for name, points in lines_of(figure.axes[0]).items()}
    assert drawn == {"ViewNet (paper)": [9 * 16, 18 * 16], "ViewNet (matting)": [9 * 64, 18 * 64]}
    assert labels_of(figure.axes[0]) == ["ViewNet (matting)", "ViewNet (paper)"]


NAMES = ("a$b$c", r"$\foo", r"$\frac{1}$", "x_1^2", r"50\$")
"""Names that mathtext would typeset, refuse or change."""


def of_logs(name: str):
    rows = [{"row": name, "recipe": recipe, "category": name, "seed": 0, "targets": targets, "epoch": 1, "loss": 2.0}
            for recipe in (name, "paper") for targets in (100, 3000)]  # fmt: skip
    return plots.training_curves(pd.DataFrame(rows))


def of_calibration(name: str):
    row = {"predictor": name, "alignment": "linear", "category": name} | {"acc30": 50.0}
    return plots.calibration_curves(pd.DataFrame([row | {"images": images} for images in (4, 16)]))


def of_collapse(name: str):
    row = {"predictor": name, "category": name, "concentration": 0.5, "side": 0.2, "spread_linear": 1.0}
    gains = {f"{metric}_{kind}": 10.0 for metric in ("acc30", "dva") for kind in ("linear", "rigid")}
    return plots.collapse_curves(pd.DataFrame([row | gains]))


def of_images(name: str):
    return image_grids.image_grid([[np.zeros((4, 4, 3), np.uint8)]], [name], [name], [[name]])


@pytest.mark.parametrize("draw", [of_logs, of_calibration, of_collapse, of_images])
@pytest.mark.parametrize("name", NAMES)
def test_names_are_text_whatever_is_in_them(draw, name, tmp_path):
    figure = draw(name)
    plots.save(figure, tmp_path, "figure")
    texts = [text for text in figure.findobj(Text) if text.get_text()]
    assert any(name in text.get_text() for text in texts)
    assert not any(text.get_parse_math() for text in texts)
    own = [text.get_text() for text in texts if name not in text.get_text()]
    assert not any("$" in text for text in own), "numbers along the axes are no mathtext either"


def test_a_run_without_a_log_is_named(tmp_path):
    run = untrained_run(tmp_path / "run")
    (run.folder / "log.csv").write_text("epoch,step,seconds,loss\n")
    with pytest.raises(ViewnetError, match=r"viewnet car seed 0 .* log is empty"):
        plots.training_logs([run])
    with pytest.raises(ViewnetError, match="no runs"):
        plots.training_logs([])
