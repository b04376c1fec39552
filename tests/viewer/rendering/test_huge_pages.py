"""What a software rasteriser allocates ends in huge pages, and its contents stay."""

from __future__ import annotations

import platform
import re
from pathlib import Path

import numpy as np
import pytest

from viewer.rendering.software_rasteriser import HUGE, memory_taken_since, move_to_huge_pages, private_memory


def test_new_memory_is_moved_and_keeps_its_contents() -> None:
    if not Path("/proc/self/smaps_rollup").exists():
        pytest.skip("not Linux")
    if "[never]" in Path("/sys/kernel/mm/transparent_hugepage/enabled").read_text():
        pytest.skip("this kernel gives no huge pages")
    import mmap

    before, huge = private_memory(), huge_bytes()
    memory = mmap.mmap(-1, 16 * HUGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    memory.madvise(mmap.MADV_NOHUGEPAGE)  # as if the kernel had not had any at first
    values = np.frombuffer(memory, np.uint32)
    values[:] = np.arange(len(values))
    steps = sum(1 for _ in move_to_huge_pages(memory_taken_since(before)))
    assert steps >= 1 and np.array_equal(values, np.arange(len(values)))
    if tuple(map(int, platform.release().split(".")[:2])) < (6, 1):
        pytest.skip("this kernel moves memory when it pleases")
    assert huge_bytes() > huge


def huge_bytes() -> int:
    found = re.search(r"AnonHugePages: +(\d+) kB", Path("/proc/self/smaps_rollup").read_text())
    return 1024 * int(found[1]) if found else 0
