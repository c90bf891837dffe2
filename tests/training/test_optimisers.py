from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F

from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.training.optimisers import Muon, orthogonal
from viewnet.training.train import make_optimisers


@pytest.mark.parametrize("shape", [(8, 72), (72, 8), (16, 16)])
def test_singular_values_are_brought_near_one(shape):
    torch.manual_seed(0)
    u, _, v = torch.linalg.svd(torch.randn(shape), full_matrices=False)
    wanted = torch.logspace(0, -1.5, min(shape))  # a thirtieth of the largest is still seen
    values = torch.linalg.svdvals(orthogonal([u * (1e-3 * wanted) @ v])[0])
    assert values.min() > 0.85 and values.max() < 1.15


def test_the_singular_vectors_stay():
    torch.manual_seed(0)
    matrix = torch.randn(8, 72)
    u, _, v = torch.linalg.svd(matrix, full_matrices=False)
    turned = u.T @ orthogonal([matrix])[0] @ v.T
    assert torch.allclose(turned, torch.diag(turned.diagonal()), atol=1e-3)


def test_a_zero_gradient_moves_nothing():
    weight = torch.nn.Parameter(torch.randn(4, 3, 2, 2))
    before = weight.detach().clone()
    weight.grad = torch.zeros_like(weight)
    Muon([weight]).step()
    assert torch.equal(weight, before)


def test_it_finds_a_linear_map():
    torch.manual_seed(0)
    wanted, weight = torch.randn(6, 20), torch.nn.Parameter(torch.zeros(6, 5, 2, 2))
    optimiser = Muon([weight], lr=0.05)
    losses = []
    for step in range(200):
        optimiser.param_groups[0]["lr"] = 0.05 * (1 - step / 200)
        loss = (weight.flatten(1) - wanted).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.1 * losses[0]


def test_only_inner_convolutions_are_taken():
    config = make_config(profile="smoke", muon=0.02)
    model = ViewNet(config.model)
    adam, muon = make_optimisers(model, config.train)
    taken = {id(p) for group in muon.param_groups for p in group["params"]}
    names = {name for name, p in model.named_parameters() if id(p) in taken}
    depth = len([m for m in model.appearance if isinstance(m, torch.nn.Conv2d)])
    for part in ("viewpoint.encoder.", "appearance."):
        of = {name for name in names if name.startswith(part)}
        assert len(of) == depth - 2 and f"{part}0.weight" not in of
    assert len({name for name in names if name.startswith("decoder.stages.")}) == len(model.decoder.stages)
    assert len(names) == 2 * (depth - 2) + len(model.decoder.stages)
    assert len(adam.param_groups[0]["params"]) + len(taken) == len(list(model.parameters()))
    assert len(make_optimisers(model, make_config(profile="smoke", muon=0.0).train)) == 1


@pytest.mark.parametrize("muon", [0.02, 0.0])
def test_the_output_of_a_fixed_code_s_layer_learns_as_by_the_layer_s_weights(muon):
    """So that the paper's first layer, nine tenths of its generator, can be left out."""
    config = make_config(profile="smoke", muon=muon)
    torch.manual_seed(0)
    model = ViewNet(config.model)
    optimisers, code = make_optimisers(model, config.train), model.decoder.code  # (1, n, 1, 1, 1)
    output = model.decoder.stages[0].convolution.output  # (1, C, 4, 4, 4)
    weight = torch.nn.Parameter(output.detach() * code.movedim(1, 0) / code.square().sum())  # (n, C, 4, 4, 4)
    with_weights = Muon([weight], muon) if muon else torch.optim.Adam([weight], config.train.optimiser.learning_rate)
    wanted, before = torch.randn_like(output), output.detach().clone()
    for _ in range(6):
        made = F.conv_transpose3d(code, weight)
        assert torch.allclose(made, output, atol=0.02 * (made - before).norm().item() + 1e-5)
        for result, steppers in ((made, [with_weights]), (output, optimisers)):
            for stepper in steppers:
                stepper.zero_grad()
            (result - wanted).abs().pow(1.5).sum().backward()
            for stepper in steppers:
                stepper.step()
    assert (output - before).norm() > 0.01 * before.norm()


def test_bfloat16_brings_large_matrices_as_near():
    torch.manual_seed(0)
    matrix = torch.randn(128, 600)
    (whole,), (half,) = orthogonal([matrix]), orthogonal([matrix], half=True)
    assert half.dtype == torch.float32
    assert not torch.equal(whole, half)
    assert (whole - half).norm() < 0.03 * whole.norm()
    small = [matrix[:64]]  # too small to gain from it
    assert torch.equal(orthogonal(small)[0], orthogonal(small, half=True)[0])


def test_without_mixed_precision_muon_has_none(monkeypatch):
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: True)
    for amp, half in (("auto", True), ("off", False)):
        config = make_config(profile="smoke", amp=amp)
        assert make_optimisers(ViewNet(config.model), config.train)[1].half is half
