"""Texture preallocation: a thread allocates a pack's atlas while the pack is still being read.

A software rasteriser fills a new texture with zeros: 1.7 s for the 1.1 GiB of a pack of 1000³ voxels, in which the window would
stand still. A GPU allocates at once and needs none of this.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from threading import Event, Thread

import moderngl

from scenepack.pack import Pack
from viewer.rendering.gpu_memory import Limits, NoRoomError
from viewer.rendering.gpu_scene import atlas_size, features_stored, tightest_atlas
from viewer.rendering.software_rasteriser import (
    memory_taken_since,
    move_to_huge_pages,
    opengl,
    private_memory,
    software_draws,
)

GL_TEXTURE_3D, GL_RGBA8, GL_NO_ERROR = 0x806F, 0x8058, 0
CHANNELS = 4
WORTH_A_THREAD = 64 << 20  # bytes of textures

Triple = tuple[int, int, int]
# Called by the main thread; gives what another thread enters to share textures.
SharedContext = Callable[[], AbstractContextManager[None] | None]


class PreallocatedTexture:
    """An empty RGBA8 texture of `size` (x, y, z) voxels for `ctx`, the current context.

    shared_context: a thread that enters it has a context that shares textures with `ctx`.
    moderngl takes the texture for 1 × 1 × 1.
    """

    def __init__(self, ctx: moderngl.Context, size: Triple, shared_context: AbstractContextManager[None]) -> None:
        self.size, self.taken = size, False
        self._texture, self._made = ctx.texture3d((1, 1, 1), CHANNELS), False
        self._tried = Event()  # set once allocation was tried
        self._settled = Event()  # set once it is known whether the texture is used
        self._thread = Thread(target=self._run, args=(shared_context,), name="snerg-preallocation", daemon=True)
        self._thread.start()

    def _run(self, shared_context: AbstractContextManager[None]) -> None:
        taken_before = private_memory()
        try:
            with shared_context:
                self._made = self._make()
        finally:
            self._tried.set()
        memory = memory_taken_since(taken_before)
        self._settled.wait()  # moving it takes processor time, which reading the pack needs first
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
        """Whether its thread still runs, so that release() would wait."""
        return self._thread.is_alive()

    def take(self, size: Triple, channels: int) -> moderngl.Texture3D | None:
        """Waits for the texture and hands it to the caller; None if it does not match or could not be allocated."""
        if self._settled.is_set() or (size, channels) != (self.size, CHANNELS):
            return None
        self._tried.wait()
        self.taken = self._made
        self._settled.set()
        return self._texture if self.taken else None

    def give_back(self) -> None:
        """The texture is not wanted any more; no effect once it was taken."""
        self._settled.set()

    def release(self) -> None:
        """Waits for the thread; frees the texture unless it was taken."""
        self.give_back()
        self._thread.join()
        if not self.taken:
            self._texture.release()


def preallocate(
    ctx: moderngl.Context, pack: Pack, shared_context: AbstractContextManager[None]
) -> PreallocatedTexture | None:
    """Begins to allocate the "exact" texture of a pack that is still being read; None on a GPU and for small packs."""
    parts = 2 if features_stored(pack) else 1
    count, block = int(pack.occupied.sum()), pack.padded_block_size
    if not software_draws(ctx) or parts * count * block**3 * 4 < WORTH_A_THREAD:
        return None
    try:
        slots = tightest_atlas(count, block, Limits.of(ctx).max_side, parts)
    except NoRoomError:  # the upload reports it
        return None
    return PreallocatedTexture(ctx, atlas_size(slots, block, parts), shared_context)


class TexturePreallocator:
    """Preallocates for one pack at a time and frees what was not used. now: for the pack that is being read, if any."""

    def __init__(self, ctx: moderngl.Context, shared_context: SharedContext | None) -> None:
        self.ctx, self._shared_context = ctx, shared_context
        self.now: PreallocatedTexture | None = None
        self._given_back: list[PreallocatedTexture] = []

    def make(self, pack: Pack | None) -> None:
        """Begins to allocate for `pack` and gives up the one before; None: only gives up."""
        if self.now is not None:
            self.now.give_back()
            self._given_back.append(self.now)
        self.now = None
        if pack is not None and self._shared_context is not None:
            shared_context = self._shared_context()
            self.now = preallocate(self.ctx, pack, shared_context) if shared_context is not None else None

    def sweep(self) -> None:
        """Frees what was given up, without waiting for a thread."""
        for preallocated in [preallocated for preallocated in self._given_back if not preallocated.busy]:
            preallocated.release()
            self._given_back.remove(preallocated)

    def release(self) -> None:
        """Waits for all threads and frees all textures that were not taken."""
        self.make(None)
        for preallocated in self._given_back:
            preallocated.release()
        self._given_back.clear()
