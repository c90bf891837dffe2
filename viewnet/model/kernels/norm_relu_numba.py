"""Numba kernels of viewnet.model.kernels.norm_relu_cpu: normalisation, scale, shift and ReLU in one pass.

On float32, or on bfloat16's bits.

Features are (N, P, C): P places, the channels of one side by side. Each (n, c) is normalised over its places.
"""

import numpy as np
from numba import prange

from viewnet.model.kernels.bfloat16_numba import compiled, narrowed, widened

ZERO, ONE = np.float32(0.0), np.float32(1.0)


def _norm(x, scale, shift, epsilon, out, mean, variance, slope, offset):
    """Fills `out` with relu(slope x + offset), and all of (N, C): mean, variance and these slopes and offsets."""
    places, channels = x.shape[1:]
    share = ONE / np.float32(places)
    for n in prange(len(x)):  # an image's sums are one thread's: the same for any number of threads
        total, square = np.zeros(channels, np.float32), np.zeros(channels, np.float32)
        # Of differences from the first place: a mean far from zero would swallow the variance.
        for p in range(places):
            for c in range(channels):  # innermost, where memory is contiguous: vectorised
                value = widened(x[n, p, c]) - widened(x[n, 0, c])
                total[c] += value
                square[c] += value * value
        for c in range(channels):
            centre = total[c] * share
            mean[n, c] = centre + widened(x[n, 0, c])
            spread = square[c] * share - centre * centre
            variance[n, c] = ZERO if spread < ZERO else spread  # rounding may make it negative
            slope[n, c] = scale[n, c] / np.sqrt(variance[n, c] + epsilon)
            offset[n, c] = shift[n, c] - slope[n, c] * mean[n, c]  # one multiplication and sum a number is left
        for p in range(places):
            for c in range(channels):
                value = slope[n, c] * widened(x[n, p, c]) + offset[n, c]
                value = ZERO if value < ZERO else value  # unlike max, lets NaN through to be noticed
                out[n, p, c] = narrowed(value, out[n, p, c])


def _norm_backward(x, grad, mean, variance, epsilon, slope, offset, grad_x, grad_scale, grad_shift):
    """Fills the gradients (N, P, C), (N, C) and (N, C) for `grad` (N, P, C)."""
    places, channels = x.shape[1:]
    share = ONE / np.float32(places)
    for n in prange(len(x)):
        total, product = np.zeros(channels, np.float32), np.zeros(channels, np.float32)
        along, level = np.empty(channels, np.float32), np.empty(channels, np.float32)
        for p in range(places):
            for c in range(channels):
                value = widened(x[n, p, c])
                change = widened(grad[n, p, c]) if slope[n, c] * value + offset[n, c] > ZERO else ZERO
                total[c] += change
                product[c] += change * (value - mean[n, c])  # g (x - mean)
        for c in range(channels):
            inverse = ONE / np.sqrt(variance[n, c] + epsilon)
            grad_scale[n, c] = product[c] * inverse  # of scale (x - mean) / deviation
            grad_shift[n, c] = total[c]
            # With y the normalised x: slope (g - mean of g - y times mean of g y), as slope g + along x + level.
            along[c] = -slope[n, c] * inverse * inverse * product[c] * share
            level[c] = -slope[n, c] * total[c] * share - along[c] * mean[n, c]
        for p in range(places):
            for c in range(channels):
                value = widened(x[n, p, c])
                change = widened(grad[n, p, c]) if slope[n, c] * value + offset[n, c] > ZERO else ZERO
                result = slope[n, c] * change + along[c] * value + level[c]  # through mean and variance too
                grad_x[n, p, c] = narrowed(result, grad_x[n, p, c])


norm, norm_backward = compiled(_norm), compiled(_norm_backward)
