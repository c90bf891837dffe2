"""Confidences made true on photographs: by their calibration split alone, without another viewpoint."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.estimators import photograph, untrained
from helpers.photo_data import make_photos
from PIL import Image

from viewnet.cli import main
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.experiments.calibrated import calibrate


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.setattr("viewnet.evaluation.features.SIZE", 32)
    monkeypatch.chdir(tmp_path)


def listed(folder, turn: float = 0, splits: str = "val") -> str:
    """Photographs in their list at what an untrained model answers for two of three, and behind it for the third.

    Those to be scored, another twelve, are turned.
    """
    (folder / "images").mkdir(parents=True)
    lines = ["file,azimuth_deg,elevation_deg,split"]
    for number in range(24):
        Image.fromarray(photograph(seed=number)).save(path := folder / "images" / f"{number}.png")
        (said,) = model().predict([path])
        split = "val" if number % 2 == 0 and splits == "val" else "test"
        off = (180 if number % 6 == 0 else 0) + (turn if split == "test" else 0)
        lines.append(f"{number}.png,{(said.azimuth + off) % 360:.3f},{said.elevation:.3f},{split}")
    (folder / "viewpoints.csv").write_text("\n".join(lines) + "\n")
    return str(folder)


def model() -> ViewpointEstimator:
    return untrained(recipe="photos", rotation=np.eye(3))


def test_confidences_fit_what_is_right_of_the_calibration_split_and_viewpoints_stay(tmp_path):
    model().save_pretrained("model")
    images = [photograph(seed=number) for number in range(24)]
    before = model().predict(images)
    for name, turn in (("photos", 0), ("turned", 77)):
        place = listed(tmp_path / name, turn)
        assert main(["save", "model", f"{name}-model", "--calibrate", place]) == 0
    after = ViewpointEstimator.from_pretrained("photos-model", device="cpu")
    said = after.predict(images)
    assert np.allclose(said.vector, before.vector, atol=1e-6)
    about = after.about["calibrated"]
    assert (about["images"], round(about["right"])) == (12, 67)
    assert after.about["calibrated"] == ViewpointEstimator.from_pretrained("turned-model").about["calibrated"]
    shares = np.exp(np.log(before.probabilities) / about["temperature"])
    assert np.allclose(said.probabilities, shares / shares.sum(1, keepdims=True), atol=1e-4)
    assert abs(said.confidence.mean() - 2 / 3) <= abs(before.confidence.mean() - 2 / 3) + 1e-3
    assert (
        "| confidence | calibrated on 12 photographs with known viewpoints"
        in (tmp_path / "photos-model" / "README.md").read_text()
    )


def test_a_stand_in_for_photographs_will_do(tmp_path, monkeypatch):
    asked = []

    def photo_views(config):
        asked.append(config)
        return make_photos(tmp_path / "made", 40, size=32)

    monkeypatch.setattr("viewnet.data.build.photo_views", photo_views)
    model().save_pretrained("model")
    assert main(["save", "model", "calibrated", "--calibrate", "stand-in"]) == 0
    assert (asked[0].root, asked[0].category) == (None, "car")
    about = ViewpointEstimator.from_pretrained("calibrated").about["calibrated"]
    assert (about["images"], about["stand_in"]) == (20, True)
    assert "calibrated on 20 images of a stand-in for photographs" in (tmp_path / "calibrated/README.md").read_text()


def test_what_cannot_be_calibrated_is_refused(tmp_path):
    place = listed(tmp_path / "photos", splits="none")
    with pytest.raises(ViewnetError, match="photos: has no calibration split: mark some photographs val"):
        calibrate(model(), place)
    with pytest.raises(ViewnetError, match="the model has no rotation to the annotated frame"):
        calibrate(untrained(recipe="photos"), place)
    with pytest.raises(ViewnetError, match="the model has a single hypothesis"):
        calibrate(untrained(recipe="photos", heads=1, head_spread=0.0, rotation=np.eye(3)), place)
    with pytest.raises(ViewnetError, match="calibrate nowhere: no such folder"):
        calibrate(model(), "nowhere")
