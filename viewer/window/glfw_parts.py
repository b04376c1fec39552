"""Joysticks and the second OpenGL context, by the GLFW library that the window hands in."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from types import ModuleType
from typing import Any

from viewer.core.input import ControllerState


def controllers_now(glfw: ModuleType) -> list[ControllerState]:
    """What the gamepads and other joysticks of this computer say at this moment. glfw: the library, once it is initialised."""
    found = []
    for number in range(glfw.JOYSTICK_1, glfw.JOYSTICK_LAST + 1):
        if not glfw.joystick_present(number):
            continue
        state = glfw.get_gamepad_state(number) if glfw.joystick_is_gamepad(number) else None
        if state is not None:
            name = text_of(glfw.get_gamepad_name(number))
            found.append(ControllerState(name, tuple(state.axes), tuple(bool(b) for b in state.buttons), gamepad=True))
            continue
        axes, buttons = (_values(ask(number)) for ask in (glfw.get_joystick_axes, glfw.get_joystick_buttons))
        name = text_of(glfw.get_joystick_name(number))
        found.append(ControllerState(name, axes, tuple(bool(button) for button in buttons)))
    return found


def _values(value: Any) -> tuple[float, ...]:
    """Numbers that GLFW gives as an array and how many they are."""
    values, count = value
    return tuple(float(values[i]) for i in range(count))


def text_of(value: Any) -> str:
    """A string of GLFW's, which its bindings give as bytes at times."""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


# --- A second OpenGL context beside the window's ---


class SecondContext:
    """An OpenGL context for one thread at a time that shares the window's textures, made when it is asked for."""

    def __init__(self, glfw: ModuleType, window: Any) -> None:
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
