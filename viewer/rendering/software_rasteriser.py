"""Work-arounds for software rasterisers, which draw in this process's memory and on its processor.

One switch: `software_draws`. A GPU takes none of these paths.

The lock: moderngl draws while it holds Python's global interpreter lock, so no other thread runs. A pack of 1000³ voxels took
31 s to read beside an orbiting camera, instead of 9.

Huge pages: a ray meets another page of a 3D texture at almost every sample, and processors remember where only a few thousand
pages are: with pages of 4 KiB that is 6 MB of textures, with pages of 2 MiB all of them. Needs Linux 6.1 or later.
"""

import ctypes
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache

import moderngl

LIBRARIES = {"win32": ["opengl32"], "darwin": ["/System/Library/Frameworks/OpenGL.framework/OpenGL"]}
GL_VERSION = 0x1F02


@cache
def opengl() -> ctypes.CDLL | None:
    """The system's OpenGL library; None where there is none that knows the context that is current at the first call."""
    for name in LIBRARIES.get(sys.platform, ["libGL.so.1", "libOpenGL.so.0"]):
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
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software")  # in GL_RENDERER


def is_software(renderer: str) -> bool:
    """Whether GL_RENDERER names a software rasteriser."""
    return any(word in renderer.lower() for word in SOFTWARE_RENDERERS)


def software_draws(ctx: moderngl.Context) -> bool:
    """Whether textures of `ctx` live in this process's memory, on a system with huge pages."""
    return sys.platform.startswith("linux") and is_software(ctx.info["GL_RENDERER"])


def huge_pages() -> set[int]:
    """Numbers (address / HUGE) of the pages that lie wholly in writable memory of this process that no file backs."""
    found: set[int] = set()
    with suppress(OSError), open("/proc/self/maps", encoding="ascii", errors="replace") as maps:
        for line in maps:
            addresses, access, _, _, inode, *name = line.split()
            if access == "rw-p" and inode == "0" and not name:
                start, end = (int(part, 16) for part in addresses.split("-"))
                found.update(range(-(-start // HUGE), end // HUGE))
    return found


def move_to_huge_pages(pages: Iterable[int]) -> Iterator[None]:
    """Has the kernel keep what lies in `pages` (see huge_pages) in huge pages indeed, one a step."""
    madvise = ctypes.CDLL(None).madvise
    for page in pages:
        for advice in (MADV_HUGEPAGE, MADV_COLLAPSE):  # what the kernel cannot do now, it leaves
            madvise(ctypes.c_void_p(page * HUGE), ctypes.c_size_t(HUGE), advice)
        yield
