"""Images as tensors: over backgrounds, resized, cropped to their object."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F

from viewnet.runtime.images import composite, resize, tight_crop


def test_compositing_is_a_blend():
    image = torch.tensor([0.3, 0.2, 0.1, 0.5]).view(1, 4, 1, 1)
    colour = torch.tensor([1.0, 0.0, 0.5]).view(1, 3, 1, 1)
    assert composite(image, colour).flatten().tolist() == pytest.approx([0.8, 0.2, 0.35])
    assert composite(image, 1.0).flatten().tolist() == pytest.approx([0.8, 0.7, 0.6])


def image_of(rows: slice, columns: slice, size: int = 32) -> torch.Tensor:
    image = torch.zeros(1, 4, size, size)
    image[:, :, rows, columns] = torch.tensor([0.8, 0.4, 0.2, 1.0]).view(4, 1, 1)
    return image


@pytest.mark.parametrize(("side", "size"), [(64, 32), (64, 16), (48, 12), (60, 20), (30, 32), (7, 3)])
def test_resizing_averages_areas(side, size):
    images = torch.rand(2, 4, side, side)
    assert torch.allclose(resize(images, size), F.interpolate(images, (size, size), mode="area"), atol=1e-6)
    assert resize(images, side) is images


def test_a_square_object_fills_its_crop_up_to_the_margin():
    crop = tight_crop(image_of(slice(3, 13), slice(18, 28)), 110, margin=0.05)[0]
    inside, edge = crop[:, 10:-10, 10:-10], crop[3, :4]
    assert torch.allclose(inside, torch.tensor([0.8, 0.4, 0.2, 1.0]).view(4, 1, 1).expand_as(inside), atol=1e-4)
    assert edge.max() < 0.5  # enlarging blurs an edge by half a pixel of the original
    assert crop[3].mean().sqrt() == pytest.approx(1 / 1.1, abs=0.02)


def test_a_long_object_keeps_its_aspect_and_is_centred():
    crop = tight_crop(image_of(slice(10, 14), slice(2, 22)), 64, margin=0.0)[0, 3]
    rows, columns = crop.mean(1) > 0.5, crop[32] > 0.5
    assert columns.sum() >= 62
    assert rows.sum() == pytest.approx(64 * 4 / 20, abs=2)
    assert (torch.arange(64.0)[rows].mean() - 31.5).abs() < 1


def test_a_stretched_crop_is_filled_both_ways():
    crop = tight_crop(image_of(slice(10, 14), slice(2, 22)), 64, stretch=True, margin=0.0)[0, 3]
    assert (crop[10:-10, 4:-4] > 0.9).all()
    framed = tight_crop(image_of(slice(10, 14), slice(2, 22)), 64, stretch=True, margin=0.5)[0, 3] > 0.5
    assert framed.any(0).sum() == pytest.approx(32, abs=2) and framed.any(1).sum() == pytest.approx(32, abs=8)


def test_photographs_are_left_whole():
    photograph = torch.rand(2, 4, 16, 16)
    photograph[:, 3] = 1
    assert torch.allclose(tight_crop(photograph, 16), photograph, atol=1e-5)


def test_a_crop_may_reach_beyond_the_image():
    crop = tight_crop(image_of(slice(0, 30), slice(0, 4)), 30, margin=0.0)[0]
    assert crop[3].mean(0).argmax() in range(12, 18)  # centred, with nothing on either side
    assert crop[:, :, :10].abs().max() < 1e-4


def test_where_the_object_is_and_how_large_does_not_matter():
    small, large = image_of(slice(4, 8), slice(20, 28)), image_of(slice(8, 24), slice(0, 32))
    assert (tight_crop(small, 32, margin=0.0) - tight_crop(large, 32, margin=0.0)).abs().mean() < 0.05


def test_a_image_without_an_object_is_left_whole():
    empty = torch.zeros(2, 4, 16, 16)
    faint = empty.clone()
    faint[:, :, 3, 4] = 0.2
    assert not tight_crop(empty, 8).any()
    assert tight_crop(faint, 8).any()
