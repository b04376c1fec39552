"""Room for the pack that is being read, and for those that were not opened after all."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

import moderngl

from scenepack.pack import Pack
from viewer.rendering.gpu_scene import make_room
from viewer.rendering.room import Room

Beside = Callable[[], AbstractContextManager[None] | None]


class Rooms:
    """now: for the pack that is being read, if any. beside: gives what Room needs, where there is such a thing."""

    def __init__(self, ctx: moderngl.Context, beside: Beside | None) -> None:
        self.ctx, self._beside = ctx, beside
        self.now: Room | None = None
        self._given_back: list[Room] = []

    def make(self, pack: Pack | None) -> None:
        """Begins to make room for a pack, instead of the one before; None: for no other."""
        if self.now is not None:
            self.now.give_back()
            self._given_back.append(self.now)
        beside = self._beside() if pack is not None and self._beside is not None else None
        self.now = make_room(self.ctx, pack, beside) if pack is not None and beside is not None else None

    def sweep(self) -> None:
        """Frees what was given back, without waiting for a thread."""
        for room in [room for room in self._given_back if not room.busy]:
            room.release()
            self._given_back.remove(room)

    def release(self) -> None:
        """Frees all of it; waits for its threads."""
        self.make(None)
        for room in self._given_back:
            room.release()
        self._given_back.clear()
