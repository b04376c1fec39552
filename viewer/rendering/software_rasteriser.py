"""Work-arounds for software rasterisers, which draw in this process's memory and on its processor.

One switch: `software_draws`. A GPU takes none of these paths.

The lock: moderngl draws while it holds Python's global interpreter lock, so no other thread runs. A pack of 1000³ voxels took
31 s to read beside an orbiting camera, instead of 9.

Huge pages: a ray meets another page of a 3D texture at almost every sample, and processors remember where only a few thousand
pages are: with pages of 4 KiB that is 6 MB of textures, with pages of 2 MiB all of them. Needs Linux 6.1 or later.
"""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache

import moderngl

LIBRARIES = {"win32": ("opengl32",), "darwin": ("/System/Library/Frameworks/OpenGL.framework/OpenGL",)}
ELSEWHERE = ("libGL.so.1", "libOpenGL.so.0")
GL_VERSION = 0x1F02


@cache
def opengl() -> ctypes.CDLL | None:
    """The system's OpenGL library; None where there is none that knows the context that is current at the first call."""
    for name in LIBRARIES.get(sys.platform, ELSEWHERE):
        with suppress(OSError, AttributeError):
            library = ctypes.CDLL(name)
            library.glGetString.restype = ctypes.c_char_p
            if library.glGetString(GL_VERSION):
                return library
    return None


def finish(ctx: moderngl.Context) -> None:
    """Waits until all that was asked of `ctx`, which is current, is drawn."""
    library = opengl()
    if library is None:
        ctx.finish()
    else:
        library.glFinish()


# --- Huge pages ---

MADV_HUGEPAGE, MADV_COLLAPSE = 14, 25
HUGE = 2 << 20  # bytes of a huge page
PIECE = 16 << 20  # bytes moved at once
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software")  # in GL_RENDERER

Range = tuple[int, int]


def is_software(renderer: str) -> bool:
    """Whether GL_RENDERER names a software rasteriser."""
    return any(word in renderer.lower() for word in SOFTWARE_RENDERERS)


def software_draws(ctx: moderngl.Context) -> bool:
    """Whether textures of `ctx` live in this process's memory, on a system with huge pages."""
    return sys.platform.startswith("linux") and is_software(ctx.info["GL_RENDERER"])


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


def private_memory() -> list[Range]:
    """Addresses [start, end), in order, of writable memory that no file backs."""
    found = []
    with suppress(OSError), open("/proc/self/maps", encoding="ascii", errors="replace") as maps:
        for line in maps:
            addresses, access, _, _, inode, *name = line.split()
            if access == "rw-p" and inode == "0" and not name:
                start, end = (int(part, 16) for part in addresses.split("-"))
                found.append((start, end))
    return found


def memory_taken_since(before: list[Range]) -> list[Range]:
    """What this process has allocated since private_memory() gave `before`."""
    left = []
    for start, end in private_memory():
        for low, high in before:
            if high <= start or low >= end:
                continue
            if low > start:
                left.append((start, low))
            start = max(start, high)
        if start < end:
            left.append((start, end))
    return left
