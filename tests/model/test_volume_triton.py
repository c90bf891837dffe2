"""The GPU renderer: its logic in Triton's interpreter, its kernels through the real compiler, and both on a GPU."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from helpers.volumes import CASES, Case, check_against_definition, gradients
from hypothesis import given, settings

from viewnet.errors import ViewnetError
from viewnet.model import volume
from viewnet.model.kernels import volume_cpu, volume_gpu

CASE = Case((5, 7, 9), volumes=2, share=3, size=8, steps=9, focal=0.3, solid=True, seed=0)


def has_triton() -> bool:
    try:
        import triton  # noqa: F401
    except ImportError:
        return False
    return True


needs_triton = pytest.mark.skipif(not has_triton(), reason="Triton is not installed: it has no build for this system")
needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU: the interpreter runs the kernels instead")


@needs_triton
@pytest.mark.slow
@pytest.mark.parametrize("chosen", ["not slow", "slow"])
def test_the_kernels_in_the_interpreter(chosen):
    here = Path(__file__).resolve().parents[1] / "helpers"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", chosen, "--tb=short"]
    environment = dict(os.environ, TRITON_INTERPRET="1", OMP_NUM_THREADS="1")
    environment["PYTHONPATH"] = os.pathsep.join([str(here.parent), os.environ.get("PYTHONPATH", "")])
    environment.pop("PYTEST_ADDOPTS", None)
    done = subprocess.run(
        [*command, str(here / "interpreted_triton.py")],
        env=environment,
        cwd=here.parent,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"in the interpreter:\n{done.stdout}\n{done.stderr}"


@needs_triton
@pytest.mark.slow
@pytest.mark.parametrize("name", ["pack", *volume_gpu.CHOICES])
def test_the_kernels_compile_for_a_gpu(name, tmp_path, monkeypatch):
    """With the real compiler, which is stricter than the interpreter; a voxel's values are loaded together."""
    monkeypatch.setenv("TRITON_CACHE_DIR", str(tmp_path))
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    from viewnet.model.kernels import volume_triton

    kernel = getattr(volume_triton, name)
    arrays = {"volume", "voxels", "frames", "focal", "image", "grad", "grad_voxels", "partial"}
    types = {array: "*fp32" for array in arrays} | {"cells": "*u8"}
    for warps, chunk in volume_gpu.CHOICES.get(name, ((4, 0),)):
        constants = {"BLOCK": 256} if name == "pack" else {"RAYS": 32 * warps, "CHUNK": chunk}
        if name == "draw_backward":
            constants["SPARSE"] = True
        signature = {x: "constexpr" if x in constants else types.get(x, "i32") for x in kernel.arg_names}
        aligned = {(i,): [["tt.divisibility", 16]] for i, x in enumerate(kernel.arg_names) if x in types}
        source = ASTSource(kernel, signature, constants, aligned)
        options = {"num_warps": warps, "enable_fp_fusion": True}
        compiled = triton.compile(source, target=GPUTarget("cuda", 90, 32), options=options)
        code = compiled.asm["ptx"]
        assert {
            "pack": "st.global.v4.b32" in code,
            "draw": code.count("ld.global.v4.b32") == 8 * chunk,
            "draw_backward": code.count("add.v4.f32") == 8 * chunk,
        }[name]
        assert ".local" not in code  # registers are enough
        assert compiled.asm["cubin"]


# Choice of the implementation


def test_without_a_gpu_there_is_one_warning(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    available = volume_gpu.available.__wrapped__
    with pytest.warns(UserWarning, match="no usable GPU .*slower PyTorch path"):
        assert available() is False


def test_without_triton_it_says_so(monkeypatch):
    def packed(volume):
        raise ImportError("No module named 'triton'")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch, "zeros", lambda *shape, device: None)
    monkeypatch.setattr(volume_gpu, "pack", packed)
    with pytest.warns(UserWarning, match=r"ImportError: No module named 'triton'"):
        assert volume_gpu.available.__wrapped__() is False


@pytest.mark.parametrize("wanted, fused", [("auto", True), ("", True), ("fused", True), ("reference", False)])
def test_a_renderer_can_be_forced(wanted, fused, monkeypatch):
    called, compiled = [], volume_cpu.render
    monkeypatch.setattr(volume_cpu, "render", lambda *arguments: called.append(1) or compiled(*arguments))
    monkeypatch.setenv("VIEWNET_RENDERER", wanted)
    (voxels, frames, focal), _ = CASE.inputs()
    image = volume.render(voxels, frames, focal, 4)
    assert bool(called) is fused
    assert torch.allclose(image, volume.render_reference(voxels, frames, focal, 4, 4), atol=1e-4)


def test_a_renderer_that_is_none(monkeypatch):
    monkeypatch.setenv("VIEWNET_RENDERER", "fast")
    (voxels, frames, focal), _ = CASE.inputs()
    with pytest.raises(ViewnetError, match="VIEWNET_RENDERER is 'fast': set it to auto, reference or fused"):
        volume.render(voxels, frames, focal, 4)


def test_a_renderer_that_cannot_be_had(monkeypatch):
    monkeypatch.setattr(volume_cpu, "available", lambda: False)
    (voxels, frames, focal), _ = CASE.inputs()
    monkeypatch.setenv("VIEWNET_RENDERER", "fused")
    with pytest.raises(ViewnetError, match="VIEWNET_RENDERER is fused, which cannot be had on cpu here"):
        volume.render(voxels, frames, focal, 4)
    monkeypatch.setenv("VIEWNET_RENDERER", "auto")
    assert torch.equal(volume.render(voxels, frames, focal, 4), volume.render_reference(voxels, frames, focal, 4, 4))


# On a GPU


@needs_gpu
def test_a_gpu_is_what_draws():
    assert volume_gpu.available()
    assert volume.fused_kernels(torch.device("cuda")) is volume_gpu


@needs_gpu
@settings(max_examples=25)
@given(CASES)
def test_the_gpu_draws_the_definition(case):
    check_against_definition(volume.render, case, "cuda")
    check_against_definition(volume.render, case, "cuda", by_vector=True)


@needs_gpu
@pytest.mark.parametrize("sparse", [False, True])
def test_a_gpu_and_a_processor_agree_at_full_size(sparse):
    """Many tiles, long rays, several images a volume: 32 pixels, 40 steps, 32 voxels a side."""
    (voxels, frames, focal), weights = Case((32, 30, 31), 3, 2, 32, 40, 0.3, False, 0).inputs()
    voxels[:, 3] *= torch.rand(voxels[:, 3].shape, generator=torch.Generator().manual_seed(0)) < 0.05
    results = [
        gradients(lambda v, r, f: volume.render(v, r, f, 32, 40, sparse), [x.to(device) for x in inputs], w)
        for device, inputs, w in (
            ("cpu", [voxels, frames, focal], weights),
            ("cuda", [voxels, frames, focal], weights.cuda()),
        )
    ]
    (cpu, cpu_grads), (gpu, gpu_grads) = results
    assert (gpu.cpu() - cpu).abs().max() < 1e-4
    for name, a, b in zip(("volume", "frames", "focal"), gpu_grads, cpu_grads, strict=True):
        assert (a.cpu() - b).abs().max() < 1e-3 * b.abs().max(), name


@needs_gpu
def test_a_gpu_repeats_the_bits_of_images_and_of_the_gradients_of_frames():
    (voxels, frames, focal), weights = CASE.inputs()
    inputs = [x.cuda() for x in (voxels, frames, focal)]
    one, other = (gradients(lambda v, r, f: volume.render(v, r, f, 8, 9), inputs, weights.cuda()) for _ in range(2))
    assert torch.equal(one[0], other[0])
    assert torch.equal(one[1][1], other[1][1])
    assert torch.equal(one[1][2], other[1][2])
