"""Room on the card for a pack that is still being read, made by a thread beside the window.

A software rasteriser fills a new texture with zeros before it hands it out: 1.7 s for the 1.1 GiB of a pack of 1000³ voxels, in
which the window would stand still. A card makes room at once, and needs none of this.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from threading import Event, Thread

import moderngl

from viewer.rendering.gl_without_gil import opengl
from viewer.rendering.huge_pages import memory_taken_since, move_to_huge_pages, private_memory

GL_TEXTURE_3D, GL_RGBA8, GL_NO_ERROR = 0x806F, 0x8058, 0
CHANNELS = 4

Triple = tuple[int, int, int]


class Room:
    """An empty RGBA8 texture of `size` (x, y, z) voxels for `ctx`, the current context.

    beside: within it, a thread has a context that shares textures with `ctx`. For moderngl, the texture stays one of 1 × 1 × 1.
    """

    def __init__(self, ctx: moderngl.Context, size: Triple, beside: AbstractContextManager[None]) -> None:
        self.size, self.taken = size, False
        self._texture, self._made = ctx.texture3d((1, 1, 1), CHANNELS), False
        self._tried, self._settled = Event(), Event()  # whether there is room; whether it is taken
        self._thread = Thread(target=self._run, args=(beside,), name="snerg-room", daemon=True)
        self._thread.start()

    def _run(self, beside: AbstractContextManager[None]) -> None:
        taken_before = private_memory()
        try:
            with beside:
                self._made = self._make()
        finally:
            self._tried.set()
        memory = memory_taken_since(taken_before)
        self._settled.wait()  # moving it is work, and while the pack is being read the processor has enough
        if self.taken:
            for _ in move_to_huge_pages(memory):
                pass

    def _make(self) -> bool:
        gl = opengl()
        if gl is None:
            return False
        gl.glBindTexture(GL_TEXTURE_3D, self._texture.glo)
        # Not glTexImage3D: while that makes a texture, the window's context waits as soon as it uses any (Mesa 22.3).
        gl.glTexStorage3D(GL_TEXTURE_3D, 1, GL_RGBA8, *self.size)
        gl.glFinish()
        return gl.glGetError() == GL_NO_ERROR

    @property
    def busy(self) -> bool:
        """Whether its thread is at work, so that release() would wait."""
        return self._thread.is_alive()

    def take(self, size: Triple, channels: int) -> moderngl.Texture3D | None:
        """The texture, waited for, which is the caller's from then on; None where another one is wanted or it was refused."""
        if self._settled.is_set() or (size, channels) != (self.size, CHANNELS):
            return None
        self._tried.wait()
        self.taken = self._made
        self._settled.set()
        return self._texture if self.taken else None

    def give_back(self) -> None:
        """It is not wanted any more, unless it was taken."""
        self._settled.set()

    def release(self) -> None:
        """Frees what was not taken; waits for the thread."""
        self.give_back()
        self._thread.join()
        if not self.taken:
            self._texture.release()
