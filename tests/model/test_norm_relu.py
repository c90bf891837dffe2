"""Normalisation, scale, shift and ReLU in one pass, against PyTorch's separate ones."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from viewnet.model.fast_layers import Stride2Conv
from viewnet.model.kernels import norm_relu_cpu, numba_call
from viewnet.model.networks import Encoder


def separate(x, scale, shift):
    """x (N, P, C), in the precision it comes in."""
    mean, variance = x.mean(1, keepdim=True), x.var(1, keepdim=True, unbiased=False)
    return F.relu(scale[:, None] * (x - mean) / (variance + 1e-5).sqrt() + shift[:, None])


def gradients(function, x, scale, shift, weights):
    inputs = [value.detach().clone().requires_grad_() for value in (x, scale, shift)]
    out = function(*inputs)
    (out * weights.to(out.dtype)).sum().backward()
    return [out.detach().double()] + [value.grad.double() for value in inputs]


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 3), st.integers(2, 40), st.integers(1, 19), st.floats(-50, 50), st.floats(0.1, 10), st.integers(0, 9)
)
def test_one_pass_does_what_separate_ones_do(count, places, channels, mean, spread, seed):
    generator = torch.Generator().manual_seed(seed)
    x = mean + spread * torch.randn(count, places, channels, generator=generator)
    scale, shift = torch.randn(2, count, channels, generator=generator)
    weights = torch.randn(x.shape, generator=generator)
    x = x + 0.2 * spread * torch.arange(places)[:, None] % 7  # or two equal ones would be all there is
    expected = gradients(separate, x.double(), scale.double(), shift.double(), weights)
    # Close to the ReLU's threshold either gradient is right.
    unsure = (expected[0] < 1e-3) & (separate(x.double(), -scale.double(), -shift.double()) < 1e-3)
    weights = weights.masked_fill(unsure, 0)
    expected = gradients(separate, x.double(), scale.double(), shift.double(), weights)
    found = gradients(lambda *inputs: norm_relu_cpu.norm_relu(*inputs)[0], x, scale, shift, weights)
    for one, other in zip(found, expected, strict=True):
        assert torch.allclose(one, other, rtol=1e-3, atol=1e-3 * (1 + other.abs().max().item()))


def test_half_precision_is_rounded_once():
    torch.manual_seed(0)
    x = (3 + torch.randn(2, 500, 16)).bfloat16()
    scale, shift = torch.randn(2, 2, 16)
    out, _, _ = norm_relu_cpu.norm_relu(x, scale, shift)
    assert out.dtype == torch.bfloat16
    exact = separate(x.double(), scale.double(), shift.double())
    assert ((out.double() - exact).abs() <= 2**-8 * exact.abs() + 1e-5).all()


def test_what_is_not_a_number_is_not_hidden():
    x = torch.randn(1, 8, 3)
    x[0, 2, 1] = math.nan
    out, _, _ = norm_relu_cpu.norm_relu(x, torch.ones(1, 3), torch.zeros(1, 3))
    assert out[..., 1].isnan().all() and not out[..., [0, 2]].isnan().any()
    half, _, _ = norm_relu_cpu.norm_relu(x.bfloat16(), torch.ones(1, 3), torch.zeros(1, 3))
    assert half[..., 1].isnan().all()


def test_the_encoder_is_the_sequence_of_its_layers(monkeypatch):
    torch.manual_seed(0)
    one = Encoder((4, 4, 8, 8), 6, 16)  # of sizes beside and below that from which products are taken
    other = Encoder((4, 4, 8, 8), 6, 16)
    other.load_state_dict(one.state_dict())
    images, weights = torch.rand(5, 3, 16, 16), torch.randn(5, 6)
    fused = one(images)
    monkeypatch.setattr(numba_call, "available", lambda: False)
    plain = images
    for layer in other:
        if isinstance(layer, Stride2Conv):
            plain = F.pad(plain, (1, 1, 1, 1), mode="replicate")  # as the released code has it
        plain = nn.Conv2d.forward(layer, plain) if isinstance(layer, nn.Conv2d) else layer(plain)
    assert torch.allclose(fused, plain, atol=1e-4)
    (fused * weights).sum().backward()
    (plain * weights).sum().backward()
    for (name, value), expected in zip(one.named_parameters(), other.parameters(), strict=True):
        assert torch.allclose(value.grad, expected.grad, rtol=1e-3, atol=1e-4), name
    for (name, value), expected in zip(one.state_dict().items(), other.state_dict().values(), strict=True):
        assert torch.allclose(value, expected, atol=1e-5), name  # running statistics too


def test_the_encoder_in_half_precision():
    torch.manual_seed(0)
    encoder, images = Encoder((8, 8, 8), 6, 8), torch.rand(4, 3, 8, 8)

    def gradients(half):
        encoder.zero_grad()
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            encoder(images).float().square().sum().backward()
        return torch.cat([value.grad.flatten() for value in encoder.parameters()])

    exact = gradients(False)
    assert (gradients(True) - exact).norm() < 0.05 * exact.norm()


@pytest.mark.parametrize("value", [-200.0, -20.0, -1.0, 0.0, 1.0, 20.0, 200.0])
def test_the_compiled_sigmoid(value):
    from viewnet.model.kernels.bfloat16_numba import sigmoid

    assert sigmoid(torch.tensor(value).numpy()[()]) == pytest.approx(1 / (1 + math.exp(-value)), rel=1e-6, abs=1e-37)
