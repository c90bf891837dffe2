"""What a process does with memory that it no longer needs."""

import ctypes
import mmap
import sys

TRIM_THRESHOLD, MMAP_MAX = -1, -4  # of mallopt(3)
HUGE_PAGES = 2**30  # bytes of memory to come that are asked for in pages of 2 MB


def keep_freed() -> None:
    """Memory that is freed stays with the process, for its next allocations, where the C library is glibc.

    By itself glibc hands blocks of 32 MB and more back to the system, and a loop that makes one at every step, such as
    64 volumes of 32 voxels a side, waits for fresh pages, zeroed one by one. With pages as large as the system has, a
    walk through volumes needs fewer of them.
    """
    if sys.platform != "linux" or not hasattr(libc := ctypes.CDLL(None), "mallopt"):
        return
    libc.mallopt(MMAP_MAX, 0)  # no block gets pages of its own
    libc.mallopt(TRIM_THRESHOLD, -1)  # and what is free at the end stays
    libc.valloc.restype = ctypes.c_void_p
    if block := libc.valloc(ctypes.c_size_t(HUGE_PAGES)):  # only addresses, of whole pages: nothing is touched
        libc.madvise(ctypes.c_void_p(block), ctypes.c_size_t(HUGE_PAGES), mmap.MADV_HUGEPAGE)  # refused: as before
        libc.free(ctypes.c_void_p(block))
