"""What a process does with memory that it no longer needs."""

import ctypes
import sys

TRIM_THRESHOLD, MMAP_MAX = -1, -4  # of mallopt(3)


def keep_freed() -> None:
    """Memory that is freed stays with the process, for its next allocations, where the C library is glibc.

    By itself glibc hands blocks of 32 MB and more back to the system, and a loop that makes one at every step, such as
    64 volumes of 32 voxels a side, waits for fresh pages, zeroed one by one.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(MMAP_MAX, 0)  # no block gets pages of its own
        mallopt(TRIM_THRESHOLD, -1)  # and what is free at the end stays
