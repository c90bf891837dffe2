"""Photo augmentation: backgrounds, crops, and targets that stay unchanged."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from PIL import Image

from viewnet.config import DataConfig, PhotoAugmentationConfig
from viewnet.data import augment
from viewnet.runtime.images import CROP_MARGIN

PLAIN = PhotoAugmentationConfig()
PHOTO = PhotoAugmentationConfig(box_error=0.05, tilt=5.0, exposure=1.0)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def things(count: int, size: int = 40) -> torch.Tensor:
    """Red rectangles with CROP_MARGIN around them."""
    images = torch.zeros(count, 4, size, size)
    edge = round(size * CROP_MARGIN / (1 + 2 * CROP_MARGIN))
    images[:, [0, 3], edge : size - edge, edge : size - edge] = 1
    return images


def blue(count: int = 3) -> torch.Tensor:
    images = torch.zeros(count, 3, 80, 80, dtype=torch.uint8)
    images[:, 2] = 255
    return images


def test_nothing_stays_transparent_and_the_object_fills_its_box():
    seen = augment.photograph(things(8), blue(), PLAIN, generator())
    assert (seen[:, 3] == 1).all()
    # A photograph's box has no margin: all but the outermost pixels are object.
    assert (seen[:, 0, 2:-2, 2:-2] > 0.99).all() and (seen[:, 2, 2:-2, 2:-2] < 0.01).all()


def test_backgrounds_show_where_there_is_no_object():
    empty = torch.zeros(4, 4, 16, 16)
    seen = augment.photograph(empty, blue(), PLAIN, generator())
    assert torch.allclose(seen[:, 2], torch.ones(4, 16, 16)) and not seen[:, :2].any()
    half = torch.zeros(1, 4, 2, 2)
    half[:, 3], half[:, 0] = 0.5, 0.5  # half transparent red
    assert augment.over(half, torch.ones(1, 3, 2, 2))[0, :, 0, 0].tolist() == [1.0, 0.5, 0.5, 1.0]


def test_windows_of_backgrounds_differ_and_stay_images():
    ramp = (torch.linspace(0, 255, 64).to(torch.uint8)).expand(1, 3, 64, 64)
    windows = augment.windows(ramp, 20, 32, generator(), torch.device("cpu"))
    assert windows.shape == (20, 3, 32, 32) and windows.min() >= 0 and windows.max() <= 1
    rising = windows[:, 0, 0, -1] > windows[:, 0, 0, 0]
    assert 4 <= rising.sum() <= 16  # half of them mirrored
    assert windows[:, 0, 0].amin(1).std() > 0.05


def test_the_same_chance_gives_the_same_images():
    first, second, other = (augment.photograph(things(6), blue(), PHOTO, generator(seed)) for seed in (1, 1, 2))
    assert torch.equal(first, second) and not torch.equal(first, other)


@pytest.mark.parametrize("field, strength", [("box_error", 0.2), ("tilt", 20.0), ("exposure", 1.0)])
def test_each_setting_does_something_of_its_own(field, strength):
    plain = augment.photograph(things(16), blue(), PLAIN, generator())
    changed = augment.photograph(things(16), blue(), replace(PLAIN, **{field: strength}), generator())
    assert changed.min() >= 0 and changed.max() <= 1
    assert (changed - plain).abs().amax((1, 2, 3)).gt(0.05).float().mean() > 0.8


def test_exposure_of_nothing_is_nothing():
    images = torch.rand(4, 3, 16, 16, generator=generator())
    assert torch.allclose(augment.expose(images, 0.0, generator()), images, atol=1e-6)


def test_scenery_is_loaded_where_it_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    assert augment.load(DataConfig("car"), 16, torch.device("cpu")) is None
    (tmp_path / "pictures").mkdir()
    Image.new("RGB", (50, 70), (0, 0, 255)).save(tmp_path / "pictures" / "a.png")
    found = augment.load(DataConfig("car", backgrounds=str(tmp_path / "pictures")), 16, torch.device("cpu"))
    assert found is not None and found.shape == (1, 3, 32, 32) and found.dtype == torch.uint8
    assert (found[:, 2] > 250).all()
