"""Gamepads and other joysticks, as GLFW tells of them. The window hands the library in: only it imports that."""

from __future__ import annotations

from typing import Any

from viewer.app.controllers import ControllerState


def controllers_now(glfw: Any) -> list[ControllerState]:
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


def _values(told: Any) -> tuple[float, ...]:
    """Numbers that GLFW gives as an array and how many they are."""
    values, count = told
    return tuple(float(values[i]) for i in range(count))


def text_of(told: Any) -> str:
    """A string of GLFW's, which its bindings give as bytes at times."""
    return told.decode(errors="replace") if isinstance(told, bytes) else str(told)
