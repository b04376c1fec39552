"""Which OpenGL context is the thread's current one, so that who borrows the thread can give it back. EGL only.

moderngl makes a context current, but neither says which one was nor makes that current again; on EGL, leaving `with ctx:`
leaves none at all.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Callable

DRAW, READ = 0x3059, 0x305A  # EGL_DRAW, EGL_READ


def current_context() -> Callable[[], None]:
    """Call what this returns to make that context current again which is current now, if there is one and it lives then."""
    egl = _egl()
    if egl is None:
        return lambda: None
    context, display = egl.eglGetCurrentContext(), egl.eglGetCurrentDisplay()
    if not context or not display:
        return lambda: None
    thread = threading.get_ident()
    surfaces = egl.eglGetCurrentSurface(DRAW), egl.eglGetCurrentSurface(READ)

    def give_back() -> None:
        if threading.get_ident() == thread:
            egl.eglMakeCurrent(display, *surfaces, context)  # False, and nothing happens, where it is gone

    return give_back


def _egl() -> ctypes.CDLL | None:
    """The system's EGL, None where there is none."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return None
    handle = ctypes.c_void_p
    for name, arguments in (
        ("eglGetCurrentContext", []),
        ("eglGetCurrentDisplay", []),
        ("eglGetCurrentSurface", [ctypes.c_int]),
        ("eglMakeCurrent", [handle] * 4),
    ):
        function = getattr(egl, name)
        function.argtypes, function.restype = arguments, ctypes.c_uint if name == "eglMakeCurrent" else handle
    return egl
