"""The paper's layers computed in other ways that are faster: the same numbers up to rounding, the same weights.

Stride2Conv           nn.Conv2d(kernel 3, stride 2), the edge repeated
LastConv              nn.Conv2d with a kernel as large as the image
FirstDeconv           nn.ConvTranspose3d(kernel 4) of a single voxel
FixedCodeDeconv       the same of a code that never changes: its output is learned
Upsample2x            nn.ConvTranspose3d(kernel 2, stride 2) to the volume's four channels
batch_norm_relu       nn.BatchNorm2d or 3d, then ReLU
"""

import math
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.grad import conv2d_input
from torch.nn.modules.batchnorm import _BatchNorm

from viewnet.model.kernels import norm_relu_cpu


class Stride2Conv(nn.Conv2d):
    """Convolution of kernel 3 and stride 2 of an image with its edge repeated, of an even number of pixels a side.

    On CPUs a small image's weights get their gradient by a product: oneDNN takes up to four times as long for them.
    """

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, n, n) -> (N, outputs, n / 2, n / 2)."""
        if torch.is_autocast_enabled(x.device.type):
            x = x.to(torch.get_autocast_dtype(x.device.type))
        with torch.autocast(x.device.type, enabled=False):  # which would pad in float32, there and back
            x = F.pad(x, (1, 0, 1, 0), mode="replicate")  # (N, C, n + 1, n + 1); strides never reach the other edges
        if not self.training or x.device.type != "cpu" or x.shape[-1] > 9:
            return super().forward(x)
        result: Tensor = _Stride2Conv.apply(x, self.weight.to(x.dtype))
        return result


class _Stride2Conv(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight)
        return F.conv2d(x, weight, None, 2)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        x, weight = ctx.saved_tensors
        grad = grads[0].to(x.dtype, memory_format=torch.channels_last)  # (N, O, h, h)
        grad_x = conv2d_input(x.shape, weight, grad, 2)
        patches = x.permute(0, 2, 3, 1).unfold(1, 3, 2).unfold(2, 3, 2)  # (N, h, h, C, 3, 3)
        patches = patches.permute(0, 1, 2, 4, 5, 3).flatten(0, 2).flatten(1)  # (N h h, 3 3 C)
        product = grad.permute(0, 2, 3, 1).flatten(0, 2).T @ patches  # (O, 3 3 C)
        return grad_x, product.unflatten(1, (3, 3, -1)).permute(0, 3, 1, 2)


class LastConv(nn.Conv2d):
    """Convolution with a kernel as large as the image, as the matrix product it is: (N, C, k, k) -> (N, O, 1, 1)."""

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, k, k) -> (N, outputs, 1, 1)."""
        flat = x.permute(0, 2, 3, 1).flatten(1)  # (N, k k C)
        weight = self.weight.permute(0, 2, 3, 1).flatten(1)  # (O, k k C)
        return F.linear(flat, weight, self.bias)[:, :, None, None]


class FirstDeconv(nn.ConvTranspose3d):
    """Transposed convolution of kernel 4 on a single voxel, as the matrix product it is: (N, C, 1, 1, 1) to 4^3 voxels.

    In float32: it is the largest of all weights by far, and to convert it takes longer than the product.
    """

    def __init__(self, inputs: int, outputs: int):
        super().__init__(inputs, outputs, 4, bias=False)

    def forward(self, x: Tensor, output_size: list[int] | None = None) -> Tensor:
        """(N, C, 1, 1, 1) -> (N, outputs, 4, 4, 4)."""
        with torch.autocast(x.device.type, enabled=False):
            flat = x.flatten(1).float() @ self.weight.permute(0, 2, 3, 4, 1).flatten(1)  # (N, 4 4 4 outputs)
        return flat.view(len(x), 4, 4, 4, self.out_channels).movedim(-1, 1)  # (N, outputs, 4, 4, 4)


class FixedCodeDeconv(nn.Module):
    """`FirstDeconv` for the one code it ever sees: what is learned is its output, (1, outputs, 4, 4, 4).

    The code z never changes, so nothing of the layer's weights W counts but W z, and their gradient is that of W z
    times z. A step of Adam with W changes W z as a step with W z itself does, |z|_1 times as far; one of Muon, |z|_2
    times (viewnet.training.optimisers). At the paper's size 33 thousand numbers learn what 34 million would.
    """

    kernel_size = (4, 4, 4)  # as the layer it stands for has them
    stride = (1, 1, 1)

    def __init__(self, code: Tensor, outputs: int):
        super().__init__()
        self.out_channels = outputs
        spread = code.norm() / math.sqrt(3 * 64 * outputs)  # of W z with PyTorch's first weights, nearly normal
        self.output = nn.Parameter(spread * torch.randn(1, outputs, 4, 4, 4))

    def forward(self, code: Tensor) -> Tensor:
        """(1, outputs, 4, 4, 4), whatever the code."""
        return self.output


class Upsample2x(nn.ConvTranspose3d):
    """Transposed convolution of kernel and stride 2 to four channels, as the matrix product it is.

    Every voxel becomes its own eight, so nothing is summed.
    The eight start equal: detail is learned where it helps.
    """

    def __init__(self, inputs: int):
        super().__init__(inputs, 4, 2, 2)
        with torch.no_grad():
            self.weight.copy_(self.weight[:, :, :1, :1, :1].expand_as(self.weight))  # (inputs, 4, 2, 2, 2)

    def blocks(self, x: Tensor) -> Tensor:
        """(N, inputs, n, n, n) -> the eight of every voxel, (N, n, n, n, 2, 2, 2, 4)."""
        weight = self.weight.permute(0, 2, 3, 4, 1).flatten(1)  # (inputs, 2 2 2 4)
        bias = self.bias.repeat(8) if self.bias is not None else None  # (2 2 2 4,), the order of the weight's rows
        eight = F.linear(x.permute(0, 2, 3, 4, 1), weight.T, bias)  # (N, n, n, n, 2 2 2 4)
        return eight.view(*eight.shape[:4], 2, 2, 2, 4)  # (N, n, n, n, 2, 2, 2, 4)


def batch_norm_relu(layer: _BatchNorm, x: Tensor) -> Tensor:
    """Batch normalisation of features (N, C, ...) and the ReLU after it, in one pass on CPUs."""
    if not (layer.training and norm_relu_cpu.usable(x) and isinstance(layer, nn.BatchNorm2d | nn.BatchNorm3d)):
        return F.relu(layer(x), inplace=True)
    assert layer.momentum is not None and layer.running_mean is not None and layer.running_var is not None
    assert layer.num_batches_tracked is not None
    flat = x.movedim(1, -1).flatten(0, -2)[None]  # (1, N P, C): one batch, every place alike
    out, mean, variance = norm_relu_cpu.norm_relu(flat, layer.weight[None], layer.bias[None], layer.eps)  # (1, N P, C)
    with torch.no_grad():
        count = flat.shape[1]
        layer.num_batches_tracked += 1
        layer.running_mean.lerp_(mean[0], layer.momentum)
        layer.running_var.lerp_(variance[0] * (count / (count - 1)), layer.momentum)  # unbiased, as PyTorch has it
    return out.view(x.movedim(1, -1).shape).movedim(-1, 1)  # (N, C, ...)
