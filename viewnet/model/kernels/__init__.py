"""The volume renderer and the normalisation layers, compiled: Numba on CPUs, Triton on GPUs."""
