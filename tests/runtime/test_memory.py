"""Memory that is freed stays with a process that asks for it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

LOOP = """
import resource
from viewnet.runtime import memory
{first}
for _ in range(4):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    block = b"1" * 2**26
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    del block
print(faults)
"""


def new_pages(first):
    """Pages that a process, after the statement `first`, gets for a block it had before."""
    script = [sys.executable, "-c", LOOP.format(first=first)]
    return int(subprocess.run(script, capture_output=True, text=True, check=True).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc")
def test_freed_memory_is_used_again():
    assert new_pages("memory.keep_freed()") < 100 < new_pages("pass")


HUGE = """
from viewnet.runtime import memory
memory.keep_freed()
block = bytearray(b"1" * 2**26)
with open("/proc/self/smaps") as maps:
    print(sum(int(line.split()[1]) for line in maps if line.startswith("AnonHugePages")))
"""


def test_memory_comes_in_huge_pages_where_the_system_has_them():
    setting = Path("/sys/kernel/mm/transparent_hugepage/enabled")
    if not setting.exists() or "[never]" in setting.read_text():
        pytest.skip("the system has no huge pages for those who ask")
    done = subprocess.run([sys.executable, "-c", HUGE], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 2**15  # KB: half of the block
