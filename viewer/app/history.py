"""One history of what can be undone: where the camera was, and what was cut off.

An entry holds all of it, so that moves and cuts are taken back in the order in which they were made.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

DEPTH = 100

Moment = tuple[Any, ...]  # one value for each part


class History:
    """Moments to come back to. parts: each reads a value (told apart by ==) and puts it back."""

    def __init__(self) -> None:
        self._parts: list[tuple[Callable[[], Any], Callable[[Any], None]]] = []
        self._undo: list[Moment] = []
        self._redo: list[Moment] = []

    def follow(self, read: Callable[[], Any], restore: Callable[[Any], None]) -> None:
        """Has another part remembered; call before the first moment is."""
        self._parts.append((read, restore))

    def remember(self) -> None:
        """Marks this moment as one to come back to; call before each gesture."""
        now = self._now()
        if not self._undo or self._undo[-1] != now:
            self._undo = [*self._undo[1 - DEPTH :], now]
        self._redo = []

    def undo(self) -> bool:
        """Back to before the last gesture; False where there is none."""
        return self._swap(self._undo, self._redo)

    def redo(self) -> bool:
        """Forward again; False where there is nothing."""
        return self._swap(self._redo, self._undo)

    @property
    def empty(self) -> bool:
        """Whether nothing was ever done."""
        return not self._undo

    def _now(self) -> Moment:
        return tuple(read() for read, _ in self._parts)

    def _swap(self, take: list[Moment], give: list[Moment]) -> bool:
        now = self._now()
        while take and take[-1] == now:
            take.pop()
        if not take:
            return False
        give.append(now)
        for (_, restore), value in zip(self._parts, take.pop(), strict=True):
            restore(value)
        return True
