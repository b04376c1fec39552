"""Pictures without a display: an EGL context of our own and a framebuffer of the picture's size."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager, ExitStack
from typing import Any

import moderngl
import numpy as np

from console import UserError
from scenepack.pack import Pack
from viewer.rendering import opengl
from viewer.rendering.camera import ViewCamera
from viewer.rendering.renderer import Renderer
from viewer.rendering.settings import RenderSettings
from viewer.rendering.targets import Target


def create_context() -> moderngl.Context:
    """An offscreen OpenGL >= 3.3 core context. UserError, one line, where there is none to be had."""
    # macOS and Windows know no EGL; there moderngl opens a hidden native context.
    options: dict[str, Any] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        return moderngl.create_context(standalone=True, require=330, **options)
    except Exception as error:  # glcontext raises bare Exception for a missing library, moderngl its own for versions
        raise opengl.opengl_refusal("", str(error)) from error


def lost(ctx: moderngl.Context) -> bool:
    """Whether the driver took the context away (a reset, a sleep): it then reports an error without end."""
    return all(ctx.error != "GL_NO_ERROR" for _ in range(17))


class OffscreenRenderer(AbstractContextManager["OffscreenRenderer"]):
    """Renders a pack into arrays. Use as a context manager, or call release().

    ctx: a context to use instead of one of our own. allow_half: at half resolution if need be; see
    viewer.rendering.renderer.Renderer. Raises UserError where there is no OpenGL or the pack does not fit.

    Until it is released its context is the thread's current one; then that which was before is current again.
    """

    def __init__(
        self,
        pack: Pack,
        marcher: str = "exact",
        ctx: moderngl.Context | None = None,
        *,
        allow_half: bool = True,
    ) -> None:
        with ExitStack() as parts:
            parts.callback(opengl.current_context())
            self.ctx = ctx or create_context()
            if ctx is None:
                parts.callback(self.ctx.release)
            self.make_current()  # a context handed in need not be: uploads would land in another's textures
            self.renderer = Renderer(self.ctx, pack, marcher, allow_half=allow_half)
            parts.callback(self.renderer.release)
            self._targets = {dtype: Target(self.ctx, dtype=dtype) for dtype in ("f1", "f4")}
            for target in self._targets.values():
                parts.callback(target.release)
            self._parts = parts.pop_all()

    @property
    def pack(self) -> Pack:
        return self.renderer.pack

    def make_current(self) -> None:
        """Makes our context the thread's current one; another may have been made since."""
        self.ctx.__enter__()  # and no __exit__: on EGL that leaves no context current at all

    def framebuffer(self, width: int, height: int, dtype: str = "f1") -> moderngl.Framebuffer:
        """The RGBA framebuffer in whose lower left corner pictures of this size are drawn; "f1" is 8 bit, "f4" float32."""
        return self._targets[dtype].fit(width, height)

    def render(self, camera: ViewCamera, settings: RenderSettings | None = None) -> np.ndarray:
        """The picture, uint8 [height, width, 3]."""
        return self._draw_and_read(camera, settings, "f1")

    def render_float(self, camera: ViewCamera, settings: RenderSettings | None = None) -> np.ndarray:
        """The picture before it is rounded to 8 bits, float32 [height, width, 3]; for tests and metrics."""
        return self._draw_and_read(camera, settings, "f4")

    def render_raw(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """What `settings` with raw give, float32 [height, width, 4]; see viewer.rendering.layers."""
        return self._draw_and_read(camera, settings, "f4", components=4)

    def _draw_and_read(
        self, camera: ViewCamera, settings: RenderSettings | None, dtype: str, components: int = 3
    ) -> np.ndarray:
        self.make_current()
        framebuffer = self.framebuffer(camera.width, camera.height, dtype)
        self.renderer.render(framebuffer, camera, settings)
        pixels = opengl.read_pixels(framebuffer, camera.width, camera.height, components, dtype)
        if lost(self.ctx):
            raise UserError("the OpenGL context was lost", remedy="the graphics driver restarted; run it again")
        return pixels

    def release(self) -> None:
        """Frees everything on the GPU, and the context if it is ours."""
        self.make_current()
        self._parts.close()

    def __exit__(self, *_: object) -> None:
        self.release()
