"""What Numba kernels have in common: how they are compiled, bfloat16, and an exponential that vectorises.

NumPy has no bfloat16, so kernels see its bits, as uint16. `widened` and `narrowed` leave float32 as it is: one kernel
serves both.

Numba keeps compiled kernels beside their own module and looks at that file alone: after a change here or in
viewnet.model.kernels.trilinear_llvm, remove `viewnet/__pycache__`.
"""

import types as python_types

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic, overload

# `reassoc` lets sums vectorise and `contract` fuses; `nnan` is left out, so that NaN gets through and is noticed.
FLAGS = {"fastmath": {"contract", "arcp", "nsz", "reassoc"}, "cache": True, "error_model": "numpy"}


def compiled(kernel):
    """The kernel for one thread and, under True, for several.

    On one thread the threaded version would still wake a pool, whose threads spin on cores that other runs need. It has
    a name of its own, as Numba's cache tells versions apart by name and types, not by options.
    """
    threaded = python_types.FunctionType(kernel.__code__, kernel.__globals__, kernel.__name__ + "_threaded")
    threaded.__qualname__ = threaded.__name__
    return {False: njit(nogil=True, **FLAGS)(kernel), True: njit(parallel=True, nogil=True, **FLAGS)(threaded)}


@intrinsic
def _float(context, bits):
    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.FloatType())  # the same 32 bits

    return types.float32(types.uint32), generate


@intrinsic
def _bits(context, number):
    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.IntType(32))

    return types.uint32(types.float32), generate


def widened(value):
    """float32 of a float32, or of a bfloat16's bits."""
    raise NotImplementedError("only inside kernels")


@overload(widened, inline="always")  # chosen by type when compiled: no branch at run time
def _widened(value):
    if value == types.uint16:
        return lambda value: _float(np.uint32(value) << np.uint32(16))  # a bfloat16 is a float32's upper half
    return lambda value: value


def narrowed(value, like):
    """A float32 as what `like` is, rounded to the nearest bfloat16 if that is uint16. NaN stays NaN."""
    raise NotImplementedError("only inside kernels")


@overload(narrowed, inline="always")
def _narrowed(value, like):
    if like == types.uint16:

        def rounded(value, like):
            bits = _bits(value)  # adding 0x7FFF, or 0x8000 after an odd digit, rounds ties to even
            return np.uint16((bits + np.uint32(0x7FFF) + ((bits >> np.uint32(16)) & np.uint32(1))) >> np.uint32(16))

        return rounded
    return lambda value, like: value


@njit(inline="always", **FLAGS)
def sigmoid(x):
    """1 / (1 + exp(-x)) in float32, to some units in the last place: a polynomial on [-ln 2 / 2, ln 2 / 2], scaled."""
    x = -x  # what is computed is exp of this
    x = np.float32(-87) if x < np.float32(-87) else x  # compared so that NaN stays NaN
    x = np.float32(87) if x > np.float32(87) else x  # beyond +-87 float32 over- or underflows
    n = np.floor(x * np.float32(1.44269504) + np.float32(0.5))  # exp(x) = 2^n exp(r), n = round(x / ln 2)
    r = x - n * np.float32(0.693359375) + n * np.float32(2.12194440e-4)  # ln 2 in two parts keeps r's digits
    p = np.float32(1.9875691500e-4)  # the coefficients of Cephes' expf, by Horner's rule
    p = p * r + np.float32(1.3981999507e-3)
    p = p * r + np.float32(8.3334519073e-3)
    p = p * r + np.float32(4.1665795894e-2)
    p = p * r + np.float32(1.6666665459e-1)
    p = p * r + np.float32(5.0000001201e-1)
    p = p * r * r + r + np.float32(1)  # exp(r)
    # 2^n is n + 127 in a float32's exponent bits.
    return np.float32(1) / (np.float32(1) + p * _float(np.uint32(np.int32(n) + np.int32(127)) << np.uint32(23)))
