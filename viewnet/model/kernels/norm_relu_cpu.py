"""Normalisation, scale, shift and ReLU in one pass over the features, for CPUs.

PyTorch takes a dozen passes for them, forwards and backwards, and in bfloat16 rounds after each; here statistics are
of float32 and what is stored between forward and backward is the input alone.
"""

from typing import Any

import torch
from torch import Tensor

from viewnet.model.kernels import numba_call


def usable(x: Tensor) -> bool:
    """Whether `norm_relu` takes `x`."""
    return x.device.type == "cpu" and x.dtype in (torch.float32, torch.bfloat16) and numba_call.available()


def norm_relu(x: Tensor, scale: Tensor, shift: Tensor, epsilon: float = 1e-5) -> tuple[Tensor, Tensor, Tensor]:
    """relu(scale * normalised x + shift) of features (N, P, C), each channel normalised over the P places.

    `scale` and `shift` are (N, C). Also returns mean and (biased) variance (N, C), which take no gradient.
    """
    return _NormReLU.apply(x, scale, shift, epsilon)


class _NormReLU(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, scale: Tensor, shift: Tensor, epsilon: float) -> tuple[Tensor, Tensor, Tensor]:
        x, scale, shift = x.contiguous(), scale.float().contiguous(), shift.float().contiguous()  # sums in float32
        out = torch.empty_like(x)
        mean, variance, slope, offset = (torch.empty_like(scale) for _ in range(4))  # (N, C) each
        _run("norm", x, scale, shift, epsilon, out, mean, variance, slope, offset)
        ctx.save_for_backward(x, mean, variance, slope, offset)  # not `out`: it follows from these
        ctx.epsilon = epsilon
        ctx.mark_non_differentiable(mean, variance)
        return out, mean, variance

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        x, mean, variance, slope, offset = ctx.saved_tensors
        grad = grads[0].to(x.dtype).contiguous()  # autograd may hand over another type or layout
        grad_x, grad_scale, grad_shift = torch.empty_like(x), torch.empty_like(mean), torch.empty_like(mean)
        _run("norm_backward", x, grad, mean, variance, ctx.epsilon, slope, offset, grad_x, grad_scale, grad_shift)
        return grad_x, grad_scale, grad_shift, None  # none for epsilon


def _run(kernel: str, *arguments: Any) -> None:
    from viewnet.model.kernels import norm_relu_numba  # imported late: Numba takes a second to load

    numba_call.run(getattr(norm_relu_numba, kernel), *arguments)
