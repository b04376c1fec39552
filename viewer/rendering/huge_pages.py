"""Huge pages for textures that live in this process's memory, as those of Mesa's software rasteriser do.

A ray of the marcher meets another page of a 3D texture at almost every sample, and processors remember where only a few
thousand pages are: with pages of 4 KiB that is 6 MB of textures, with pages of 2 MiB all of them. On graphics cards the
driver sees to this. No effect where the system is not Linux 6.1 or later.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator

import moderngl

MADV_HUGEPAGE, MADV_COLLAPSE = 14, 25
HUGE = 2 << 20  # bytes of a huge page
PIECE = 16 << 20  # bytes moved at once
SOFTWARE = ("llvmpipe", "softpipe")

Range = tuple[int, int]


def software_draws(ctx: moderngl.Context) -> bool:
    """Whether textures of `ctx` live in this process's memory, on a system with huge pages."""
    return sys.platform.startswith("linux") and any(name in ctx.info["GL_RENDERER"] for name in SOFTWARE)


def move_to_huge_pages(ranges: list[Range]) -> Iterator[None]:
    """Moves what lies there, a piece a step."""
    try:
        madvise = ctypes.CDLL(None).madvise
    except (OSError, AttributeError):
        return
    for start, end in ranges:
        start, end = -(-start // HUGE) * HUGE, end // HUGE * HUGE
        for first in range(start, end, PIECE):
            address, length = ctypes.c_void_p(first), ctypes.c_size_t(min(PIECE, end - first))
            madvise(address, length, MADV_HUGEPAGE)
            madvise(address, length, MADV_COLLAPSE)  # what the kernel cannot do now, it leaves
            yield


def memory_taken_since(before: list[Range]) -> list[Range]:
    """What this process has allocated since private_memory() gave `before`."""
    return _without(private_memory(), before)


def private_memory() -> list[Range]:
    """Addresses [start, end), in order, of writable memory that no file backs."""
    found = []
    try:
        with open("/proc/self/maps", encoding="ascii", errors="replace") as maps:
            for line in maps:
                addresses, access, _, _, inode, *name = line.split()
                if access == "rw-p" and inode == "0" and not name:
                    start, end = (int(part, 16) for part in addresses.split("-"))
                    found.append((start, end))
    except OSError:
        pass
    return found


def _without(ranges: list[Range], others: list[Range]) -> list[Range]:
    """The parts of `ranges` that are in none of `others`; both in order."""
    left = []
    for start, end in ranges:
        for low, high in others:
            if high <= start or low >= end:
                continue
            if low > start:
                left.append((start, low))
            start = max(start, high)
        if start < end:
            left.append((start, end))
    return left
