"""OpenGL beside moderngl: versions, the current context, framebuffers, programs and their buffers, timer queries.

moderngl makes a context current, but neither says which one was nor makes that current again; on EGL, leaving `with ctx:`
leaves none at all.

A software rasteriser draws on the processor after the query has ended, or not at all until it is asked for pixels, so
that its timer queries tell little of what a picture costs; there they are not used.
"""

import ctypes
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from typing import Any

import moderngl
import numpy as np

from console import UserError
from viewer.rendering.software_rasteriser import GL_VERSION, finish, is_software

NEEDED = "OpenGL 3.3 or later"
GL_RENDERER = 0x1F01
OVERRIDE = "MESA_GL_VERSION_OVERRIDE"
# Other variables of the environment that decide which driver draws.
DRIVER_CHOICES = (
    "LIBGL_ALWAYS_INDIRECT", "LIBGL_DRIVERS_PATH", "GALLIUM_DRIVER", "MESA_LOADER_DRIVER_OVERRIDE", "EGL_PLATFORM",
    "__EGL_VENDOR_LIBRARY_FILENAMES", "__GLX_VENDOR_LIBRARY_NAME",
)  # fmt: skip
PACKAGES = "apt-get install libgl1 libegl1 libgl1-mesa-dri, or dnf install mesa-libGL mesa-libEGL mesa-dri-drivers"


def version_at(get_string: int | None) -> str:
    """Version and renderer of the current context, which may be too old for moderngl; "" where unknown.

    get_string: address of glGetString, if there is one.
    """
    if not get_string:
        return ""
    make = getattr(ctypes, "WINFUNCTYPE", ctypes.CFUNCTYPE)  # OpenGL's calling convention on Windows
    ask = make(ctypes.c_char_p, ctypes.c_uint)(get_string)
    version, renderer = ((ask(name) or b"").decode(errors="replace") for name in (GL_VERSION, GL_RENDERER))
    return f"OpenGL {version}, drawn by {renderer}" if version else ""


def opengl_refusal(version: str, complaint: str = "", *, window: bool = False) -> UserError:
    """The message where there is no OpenGL 3.3.

    version: as version_at gives it, "" where there is no OpenGL at all. complaint: the driver's own words. window: it was
    for a window, which some displays refuse where drawing into files works.
    """
    number = re.match(r"OpenGL (?:ES )?(\d+)\.(\d+)", version)
    if number is None or (int(number[1]), int(number[2])) >= (3, 3):
        version = ""  # it was something else then
    remedy = _remedy(version, complaint)
    if window and not version:
        remedy += "; snerg-render may draw without a window"
    what = "this computer's OpenGL is too old" if version else "no OpenGL to draw with"
    found = version or complaint.strip()
    choices = [f"{name}={os.environ[name]}" for name in DRIVER_CHOICES if os.environ.get(name)]
    if choices:
        found = f"{found or 'none'}, while {', '.join(choices)} is set"
        remedy = f"unset {choices[0].partition('=')[0]} and start again; or {remedy}"
    return UserError(what, expected=NEEDED, found=found or "none", remedy=remedy)


def _remedy(version: str, complaint: str) -> str:
    if override := os.environ.get(OVERRIDE):
        return f"{OVERRIDE}={override} is set, which hides what the driver can do: unset it and start again"
    if sys.platform == "win32":
        return (
            "install the driver of the graphics card's maker (what comes with Windows has OpenGL 1.1 alone); over Remote "
            "Desktop, start it on the computer itself"
        )
    if sys.platform == "darwin":
        return "update macOS: every Mac since 2012 has OpenGL 4.1"
    if "GLX extension not found" in complaint:
        return "this display has no OpenGL, as over ssh -X or some VNC servers: start it on the computer's own screen"
    if is_software(version):
        return f"update Mesa: {PACKAGES}"
    if version:
        return f"update the graphics driver, or draw without it: start again with LIBGL_ALWAYS_SOFTWARE=1 (needs {PACKAGES})"
    return f"install a graphics driver, or Mesa, which draws without a graphics card: {PACKAGES}"


# --- Which OpenGL context is the thread's current one ---

DRAW, READ = 0x3059, 0x305A  # EGL_DRAW, EGL_READ


def current_context() -> Callable[[], None]:
    """Call what this returns to make that context current again which is current now, if there is one and it lives then."""
    if not sys.platform.startswith("linux"):
        return lambda: None
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return lambda: None
    pointer = ctypes.c_void_p
    for ask in (egl.eglGetCurrentContext, egl.eglGetCurrentDisplay, egl.eglGetCurrentSurface):
        ask.restype = pointer
    context, display = pointer(egl.eglGetCurrentContext()), pointer(egl.eglGetCurrentDisplay())
    if not (context and display):
        return lambda: None
    surfaces = [pointer(egl.eglGetCurrentSurface(kind)) for kind in (DRAW, READ)]
    thread = threading.get_ident()

    def give_back() -> None:
        if threading.get_ident() == thread:
            egl.eglMakeCurrent(display, *surfaces, context)  # False, and nothing happens, where it is gone

    return give_back


# --- Framebuffers ---


def new_framebuffer(ctx: moderngl.Context, width: int, height: int, dtype: str = "f1") -> moderngl.Framebuffer:
    """An RGBA framebuffer with depth; "f1" is 8 bit, "f4" float32. UserError where the driver refuses one of this size."""
    refused = UserError("the graphics driver refuses a picture of this size", found=f"{width}x{height}")
    if max(width, height) > ctx.info["GL_MAX_TEXTURE_SIZE"]:  # sizes near 2^31 end the process from within moderngl
        raise refused
    try:
        colour = ctx.texture((width, height), 4, dtype=dtype)
        framebuffer = ctx.framebuffer([colour], ctx.depth_renderbuffer((width, height)))
    except moderngl.Error as error:
        _ = ctx.error  # OpenGL keeps it, and would hold it against the next picture
        raise refused from error
    if ctx.error != "GL_NO_ERROR":
        free_framebuffer(framebuffer)
        raise refused
    return framebuffer


def begin_drawing(framebuffer: moderngl.Framebuffer, box: tuple[int, int, int, int]) -> None:
    """From now on, draws into a box of the framebuffer (x, y, from the lower left; width, height), over whatever is there."""
    framebuffer.use()
    framebuffer.scissor = None  # pyright: ignore[reportAttributeAccessIssue]
    framebuffer.viewport = box
    framebuffer.color_mask = (True, True, True, True)
    framebuffer.depth_mask = False
    framebuffer.ctx.enable_only(moderngl.NOTHING)


def read_pixels(
    framebuffer: moderngl.Framebuffer, width: int, height: int, components: int = 3, dtype: str = "f1"
) -> np.ndarray:
    """The picture in its lower left corner, uint8 or float32 [height, width, components], from the top down."""
    data = framebuffer.read((0, 0, width, height), components=components, dtype=dtype, alignment=1)
    pixels = np.frombuffer(data, np.uint8 if dtype == "f1" else np.float32)
    return pixels.reshape(height, width, components)[::-1].copy()  # OpenGL reads from the bottom up


def unbind_framebuffers(ctx: moderngl.Context) -> None:
    """Binds a framebuffer that outlives ours: moderngl binds the last one again whenever it makes another."""
    if ctx.screen is None and ctx.extra is None:
        ctx.extra = ctx.simple_framebuffer((1, 1))
    (ctx.screen or ctx.extra).use()


def free_framebuffer(framebuffer: moderngl.Framebuffer, *, textures: bool = True) -> None:
    """Frees a framebuffer with what is attached to it: its own release() keeps that, 8 bytes for each pixel at least."""
    unbind_framebuffers(framebuffer.ctx)
    for attached in (*(framebuffer.color_attachments if textures else ()), framebuffer.depth_attachment):
        if attached is not None:
            attached.release()
    framebuffer.release()


# --- Programs that know which uniforms they have, and what they draw ---


class Drawing:
    """A vertex and a fragment shader, and the vertices that they draw; none for fullscreen.vert.

    layout: of a vertex, as moderngl has it: its format, and the name of each attribute.
    """

    def __init__(
        self, ctx: moderngl.Context, vertex: str, fragment: str, vertices: np.ndarray | None = None, *layout: str
    ) -> None:
        self.linked = ctx.program(vertex_shader=vertex, fragment_shader=fragment)
        self._buffers = [] if vertices is None else [ctx.buffer(vertices.tobytes())]
        self.vertices = ctx.vertex_array(self.linked, [(buffer, *layout) for buffer in self._buffers])
        # Asked for once: a window draws hundreds of frames a second, and each has some twenty values to write.
        members = ((name, self.linked[name]) for name in self.linked)
        self._uniforms = [(name, member) for name, member in members if isinstance(member, moderngl.Uniform)]

    def write(self, values: Mapping[str, Any]) -> None:
        """Numbers, vectors or matrices by the name of their uniform, or functions that work one out, called if it is there.

        Values that the program has no uniform for are passed over: what a variant does not use vanishes when it is linked.
        """
        for name, uniform in self._uniforms:
            if name in values:
                value = values[name]
                value = value() if callable(value) else value
                uniform.write(np.asarray(value, "f4").T.tobytes())  # GLSL's matrices are column-major

    def draw(self, vertices: int = -1, kind: int = moderngl.TRIANGLES) -> None:
        """Draws triangles, or another `kind` of primitives, from the first `vertices`; from all of them by default."""
        self.vertices.render(kind, vertices=vertices)

    def release(self) -> None:
        for thing in (self.vertices, *self._buffers, self.linked):
            thing.release()


# --- How long drawing takes ---


class GpuClock:
    """Times drawing in `ctx`. reason: why GPU times are not measured; "" where they are."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        renderer = str(ctx.info.get("GL_RENDERER", ""))
        self.reason = f"{renderer.split(' (')[0]} draws in software" if is_software(renderer) else ""
        self._query = None if self.reason else ctx.query(time=True)

    def time(self, draw: Callable[[], None]) -> tuple[float | None, float]:
        """Runs `draw` to its end: milliseconds on the GPU, None where they are not measured, and by the wall clock."""
        start = time.perf_counter()
        with self._query or nullcontext():
            draw()
        finish(self.ctx)
        wall = 1000.0 * (time.perf_counter() - start)
        return (self._query.elapsed / 1e6 if self._query is not None else None), wall
