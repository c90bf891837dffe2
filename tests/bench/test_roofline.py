"""Work is counted from shapes and from what volumes hold."""

from __future__ import annotations

import pytest
import torch

from viewnet.bench import contestants, roofline
from viewnet.model import volume


def test_layers_and_samples_are_counted():
    layer = torch.nn.Conv2d(3, 8, 3, padding=1, bias=False, device="meta")
    image = torch.zeros(2, 3, 16, 16, device="meta")
    need = roofline.network_need(lambda: layer(image).sum(), 216, 5.0)
    products = 2 * 16 * 16 * 8 * 27
    assert need.products == 5 * 2 * products  # forward, and the weights' gradient; images need none
    assert need.layer_values == 5 * 3 * (image.numel() + 2 * 8 * 256)
    rates = roofline.Rates(float32=1.0, bfloat16=1e-9, copy=1e30)
    assert need.seconds(rates) == pytest.approx(need.products)
    rotated = torch.zeros(1, 4, 4, 1, 2)
    rotated[:, 3, 1:, 0, 0] = 1.0  # the first one is opaque
    rotated[:, 3, ::2, 0, 1] = 0.5
    assert roofline.lit_samples(rotated) == 3


def test_the_object_fills_a_quarter_and_the_dense_volume_all():
    filled = volume.squash(contestants.logits("object", 32, 1), None)[0, 3]
    assert 0.2 < (filled > 0).float().mean() < 0.3
    dense = volume.squash(contestants.logits("dense", 32, 1), None)[0, 3]
    assert (dense > 0).all()
    assert 0.15 < (1 - dense).prod(0).mean() < 0.3
