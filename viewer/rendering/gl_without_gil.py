"""OpenGL calls that take long, made without holding Python's global interpreter lock. moderngl holds it.

A software rasteriser draws while the caller waits. With the lock held no other thread runs: a pack of 1000³ voxels took 31 s to
read beside an orbiting camera, instead of 9.
"""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from functools import cache

import moderngl

LIBRARIES = {
    "win32": ("opengl32",),
    "darwin": ("/System/Library/Frameworks/OpenGL.framework/OpenGL",),
}
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
