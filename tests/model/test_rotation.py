"""The HoloGAN decoder's rotation in one pass, against PyTorch's sampling."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import pytest
import torch
import torch.nn.functional as F

from viewnet.geometry import look_at
from viewnet.model.kernels import numba_call
from viewnet.model.networks import HoloGANDecoder
from viewnet.recipes import make_config

# A sum of bits; lines of 32 channels are vectorised.
BITS = """
import torch
from viewnet.model.kernels.rotation_numba import rotated
generator = torch.Generator().manual_seed(0)
features = torch.randn(2, 32, 8, 8, 8, generator=generator).requires_grad_()
frames = torch.linalg.qr(torch.randn(4, 3, 3, generator=generator))[0].requires_grad_()
out = rotated(features, frames)
out.square().sum().backward()
print([value.detach().view(torch.int32).long().sum().item() for value in (out, features.grad, frames.grad)])
"""
SMALL = dataclasses.replace(make_config(profile="smoke").model, decoder="hologan", generator_channels=(12, 5))


def images_and_gradients(decoder, code, frames, weights):
    decoder.zero_grad()
    code, frames = (value.clone().requires_grad_() for value in (code, frames))
    images = decoder.render(decoder.features(code), code, frames)
    (images * weights).sum().backward()
    learned = {name: value.grad for name, value in decoder.named_parameters()}
    return {"images": images.detach(), "code": code.grad, "frames": frames.grad} | learned


@pytest.mark.parametrize(("size", "views"), [(16, 1), (16, 3), (32, 2)])
def test_one_pass_does_what_sampling_does(size, views, monkeypatch):
    torch.manual_seed(size + views)
    decoder = HoloGANDecoder(dataclasses.replace(SMALL, render_size=size))
    code = torch.randn(2, SMALL.appearance_size)
    frames = look_at(F.normalize(torch.randn(2 * views, 3), dim=1))
    weights = torch.randn(2 * views, 4, size, size)
    fused = images_and_gradients(decoder, code, frames, weights)
    monkeypatch.setattr(numba_call, "available", lambda: False)
    expected = images_and_gradients(decoder, code, frames, weights)
    for name, value in expected.items():
        assert torch.allclose(fused[name], value, rtol=1e-3, atol=1e-4 * (1 + value.abs().max().item())), name


def test_half_precision_is_rounded_once():
    from viewnet.model.kernels.rotation_numba import rotated

    torch.manual_seed(0)
    features, frames = torch.randn(2, 8, 4, 4, 4).bfloat16(), look_at(F.normalize(torch.randn(6, 3), dim=1))
    exact = rotated(features.float(), frames)  # (6, 4, 4, 4, 8)
    # Within half a step of bfloat16, whose significand has eight bits. Not to the bit: compiled loops for vectors and
    # for what remains add in float32 with and without rounding the products, and which runs depends on addresses.
    half_step = torch.ldexp(torch.ones_like(exact), torch.frexp(exact).exponent - 9)
    assert ((rotated(features, frames).float() - exact).abs() <= half_step + 1e-6).all()
    # The identity: rows from the top, columns from the left, the nearest depth first; nothing between voxels.
    same = rotated(features, torch.eye(3).expand(2, 3, 3))
    assert torch.equal(same, features.permute(0, 3, 4, 2, 1).flip(1, 3))


def test_threads_do_not_change_bits():
    torch.manual_seed(0)
    decoder, code = HoloGANDecoder(SMALL), torch.randn(2, SMALL.appearance_size)
    frames, weights = look_at(F.normalize(torch.randn(4, 3), dim=1)), torch.randn(4, 4, 16, 16)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            rotated = decoder.features(code).detach().requires_grad_()
            image = decoder.render(rotated, code, frames)
            found.append((image.detach(), *torch.autograd.grad((image * weights).sum(), rotated)))
    finally:
        torch.set_num_threads(before)
    assert all(torch.allclose(one, two, atol=1e-5) for one, two in zip(*found, strict=True))


@pytest.mark.slow
def test_kernels_have_the_same_bits_whether_compiled_or_loaded(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", BITS]
    runs = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in range(2)]
    assert next(tmp_path.rglob("*.nbc"), None)
    assert runs[0].stdout == runs[1].stdout
