"""Calling Numba kernels on tensors: whether that can be done, and on how many threads."""

import functools
import warnings
from typing import Any

import numpy as np
import torch
from torch import Tensor


@functools.cache  # one warning, not one a call
def available() -> bool:
    """Whether compiled kernels can be used; says once why not."""
    try:
        import numba  # noqa: F401
    except ImportError as error:
        warnings.warn(f"numba is not usable ({error}): the slower PyTorch path is taken instead", stacklevel=2)
        return False
    return True


def run(kernel: dict[bool, Any], *arguments: Any) -> None:
    """Calls a kernel, as viewnet.model.kernels.bfloat16_numba.compiled makes it, on as many threads as PyTorch may use.

    Tensors are passed as arrays, those of bfloat16 as their bits, and those of a single number as such.
    """
    import numba

    allowed = torch.get_num_threads()
    threads = min(allowed, numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if threads > 1:  # asking for one would start the pool all the same
        numba.set_num_threads(threads)
    plain = [_plain(argument) if isinstance(argument, Tensor) else argument for argument in arguments]
    kernel[threads > 1](*plain)
    if torch.get_num_threads() != allowed:  # loading a kernel resets it behind PyTorch's back
        torch.set_num_threads(allowed)


def _plain(tensor: Tensor) -> Any:
    if tensor.dim() == 0:
        return np.float32(tensor.item())  # a number, as Numba would see a 0-d array
    # The array shares the tensor's memory: kernels fill it in place.
    return (tensor.view(torch.uint16) if tensor.dtype == torch.bfloat16 else tensor).numpy()
