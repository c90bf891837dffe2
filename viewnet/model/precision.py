"""In which number format networks compute."""

import torch

from viewnet.config import TrainConfig


def half_precision(device: torch.device, config: TrainConfig) -> bool:
    """Whether to compute in bfloat16: where the hardware does, unless the configuration forbids it."""
    able = torch.cuda.is_bf16_supported() if device.type == "cuda" else torch.cpu._is_avx512_bf16_supported()
    return able and config.amp == "auto"  # emulated bfloat16 is slower than float32


def autocast(device: torch.device, config: TrainConfig) -> torch.autocast:
    """bfloat16 for convolutions with `half_precision`, plain float32 without."""
    # bfloat16 has float32's range: unlike float16 it needs no scaling of the loss.
    return torch.autocast(device.type, torch.bfloat16, enabled=half_precision(device, config))
