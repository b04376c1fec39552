"""A second OpenGL context beside the window's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any


class SecondContext:
    """For one thread at a time: textures that are made in it are the window's as well.

    glfw: the library that `window` is of. Nothing is made before it is asked for.
    """

    def __init__(self, glfw: Any, window: Any) -> None:
        self._glfw, self._window = glfw, window
        self._handle: Any = None

    def for_a_thread(self) -> AbstractContextManager[None] | None:
        """What a thread enters to have it current; None where there is none to be had. The main thread asks, as of all GLFW."""
        if not self._handle:
            self._glfw.window_hint(self._glfw.VISIBLE, False)
            self._handle = self._glfw.create_window(1, 1, "", None, self._window)  # GLFW has contexts with windows only
        return self._current() if self._handle else None

    @contextmanager
    def _current(self) -> Iterator[None]:
        self._glfw.make_context_current(self._handle)
        try:
            yield
        finally:
            self._glfw.make_context_current(None)

    def close(self) -> None:
        """Once no thread has it."""
        if self._handle:
            self._glfw.destroy_window(self._handle)
