"""Which OpenGL a computer has, where it has none that is good enough, and what its owner can do about that.

The window and the offscreen renderer ask here, so that both say the same. A function's address, as drivers hand them
out, stands for OpenGL itself: the context that is current may be older than anything moderngl speaks to.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Mapping

from console import UserError

NEEDED = "OpenGL 3.3 or later"
GL_RENDERER, GL_VERSION = 0x1F01, 0x1F02
OVERRIDE = "MESA_GL_VERSION_OVERRIDE"
# Other variables of the environment that decide which driver draws.
DRIVER_CHOICES = (
    "LIBGL_ALWAYS_INDIRECT",
    "LIBGL_DRIVERS_PATH",
    "GALLIUM_DRIVER",
    "MESA_LOADER_DRIVER_OVERRIDE",
    "EGL_PLATFORM",
    "__EGL_VENDOR_LIBRARY_FILENAMES",
    "__GLX_VENDOR_LIBRARY_NAME",
)
SOFTWARE = ("llvmpipe", "softpipe", "swrast")
PACKAGES = "apt-get install libgl1 libegl1 libgl1-mesa-dri, or dnf install mesa-libGL mesa-libEGL mesa-dri-drivers"


def version_at(get_string: int | None) -> str:
    """The version and the renderer of the context that is current; "" where they are not told.

    get_string: address of glGetString, None where there is none.
    """
    if not get_string:
        return ""
    make = getattr(ctypes, "WINFUNCTYPE", ctypes.CFUNCTYPE)  # OpenGL's calling convention on Windows
    ask = make(ctypes.c_char_p, ctypes.c_uint)(get_string)
    version, renderer = ((ask(name) or b"").decode(errors="replace") for name in (GL_VERSION, GL_RENDERER))
    return f"OpenGL {version}, drawn by {renderer}" if version else ""


def opengl_refusal(version: str, complaint: str = "", *, window: bool = False) -> UserError:
    """What to tell where there is no OpenGL 3.3.

    version: as version_at gives it, "" where there is no OpenGL at all. complaint: the driver's own words. window: it was
    for a window, which some displays refuse where drawing into files works.
    """
    version = version if _is_old(version) else ""  # it was something else then
    remedy = _remedy(version, complaint, os.environ, sys.platform)
    if window and not version:
        remedy += "; snerg-render may draw without a window"
    what, found = (
        ("this computer's OpenGL is too old", version) if version else ("no OpenGL to draw with", complaint.strip())
    )
    choices = [f"{name}={os.environ[name]}" for name in DRIVER_CHOICES if os.environ.get(name)]
    if choices:
        found = f"{found or 'none'}, while {', '.join(choices)} is set"
        remedy = f"unset {choices[0].partition('=')[0]} and start again; or {remedy}"
    return UserError(what, expected=NEEDED, found=found or "none", remedy=remedy)


def _is_old(version: str) -> bool:
    number = re.match(r"OpenGL (?:ES )?(\d+)\.(\d+)", version)
    return number is not None and (int(number[1]), int(number[2])) < (3, 3)


def _remedy(version: str, complaint: str, environment: Mapping[str, str], platform: str) -> str:
    """What to install, or to try."""
    if override := environment.get(OVERRIDE):
        return f"{OVERRIDE}={override} is set, which hides what the driver can do: unset it and start again"
    if platform == "win32":
        return (
            "install the driver of the graphics card's maker (what comes with Windows has OpenGL 1.1 alone); over Remote "
            "Desktop, start it on the computer itself"
        )
    if platform == "darwin":
        return "update macOS: every Mac since 2012 has OpenGL 4.1"
    if "GLX extension not found" in complaint:
        return "this display has no OpenGL, as over ssh -X or some VNC servers: start it on the computer's own screen"
    if any(name in version for name in SOFTWARE):
        return f"update Mesa: {PACKAGES}"
    if version:
        return f"update the graphics driver, or draw without it: start again with LIBGL_ALWAYS_SOFTWARE=1 (needs {PACKAGES})"
    return f"install a graphics driver, or Mesa, which draws without a graphics card: {PACKAGES}"
