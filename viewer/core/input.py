"""Keyboard and controllers (gamepads, 3D mice).

Notation: a key's place is what is printed there on a US keyboard ("W", "Home", "Left"), whatever the user's layout; its
name is the letter or digit that the layout gives it ("Z" on a French keyboard at the place "W"), else its place.
Commands go by names and characters, as on any desktop; what a hand rests on (flying, walking) goes by places.

A state is what the system tells of one device at this moment; the window asks for it, tests make it up. Gamepads have the axes
and buttons of GLFW's standard layout (SDL's game controller mappings), 3D mice the six axes of the joystick interface.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import copysign
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viewer.app.application import App
    from viewer.features.camera.orbit_camera import OrbitCamera

TAKEN_ON_MACOS = "Tab"  # Cmd+Tab is the system's, so that Ctrl+Tab is ours there, too
FLYING = ("W", "A", "S", "D", "Q", "E")  # places: forward, left, back, right, down, up


def shown_keys(combination: str, platform: str = sys.platform) -> str:
    """ "Ctrl+S" as it is printed on the keyboard: "Cmd+S" on macOS."""
    return re.sub(rf"Ctrl\+(?!{TAKEN_ON_MACOS})", "Cmd+", combination) if platform == "darwin" else combination


def holds_command(name: str, control: bool, super_: bool, platform: str = sys.platform) -> bool:
    """Whether the modifier is held that makes a key (by its name) a command; see KeyPress.ctrl."""
    return super_ if platform == "darwin" and name != TAKEN_ON_MACOS else control


@dataclass(frozen=True)
class KeyPress:
    """A key that went down, with the modifiers of that very moment; or a character that was typed, with name ""."""

    name: str = ""
    ctrl: bool = False  # Cmd on macOS, but with Tab
    shift: bool = False
    alt: bool = False
    repeat: bool = False  # the system repeats a key that is held
    character: str = ""


@dataclass
class Keyboard:
    """held: places of the keys that are down. local_name: what the user's layout prints at a place."""

    held: set[str] = field(default_factory=set)
    local_name: Callable[[str], str] = lambda place: place
    _tapped: set[str] = field(default_factory=set)  # went down since the last frame, and perhaps up again

    def down(self, place: str) -> None:
        self.held.add(place)
        self._tapped.add(place)

    def up(self, place: str) -> None:
        self.held.discard(place)

    def axis(self, plus: str, minus: str) -> float:
        """1, 0 or -1: which of two keys is held, or was tapped since the last frame."""
        active = self.held | self._tapped
        return float(plus in active) - float(minus in active)

    def seen(self) -> None:
        """A frame has seen what was tapped."""
        self._tapped.clear()

    @property
    def flying_names(self) -> tuple[str, ...]:
        """What the user's layout prints on the keys of FLYING."""
        return tuple(self.local_name(place) for place in FLYING)


# --- Gamepads and 3D mice ---

# GLFW's gamepad layout
LEFT_X, LEFT_Y, RIGHT_X, RIGHT_Y, LEFT_TRIGGER, RIGHT_TRIGGER = range(6)
A, B, X, Y, LEFT_BUMPER, RIGHT_BUMPER, BACK, START = range(8)
UP, RIGHT, DOWN, LEFT = range(11, 15)
GAMEPAD_BUTTONS: dict[int, tuple[str, str]] = {  # button: its name, and the command
    A: ("A", "fly"), B: ("B", "walk"), X: ("X", "next-mode"), Y: ("Y", "home"),
    LEFT_BUMPER: ("left bumper", "last-photo"), RIGHT_BUMPER: ("right bumper", "next-photo"),
    BACK: ("Back", "orthographic"), START: ("Start", "help"),
    UP: ("up", "top"), RIGHT: ("right", "right"), DOWN: ("down", "front"), LEFT: ("left", "left"),
}  # fmt: skip
MOUSE_BUTTONS: dict[int, tuple[str, str]] = {0: ("left", "home"), 1: ("right", "frame")}
# Axes of a 3D mouse: the cap pushed right, towards the user, and down; tilted forward, to the right, and turned clockwise.
PUSH_X, PUSH_Y, PUSH_Z, TILT_X, TILT_Y, TURN_Z = range(6)
MAKERS = ("spacemouse", "spacenavigator", "spacepilot", "spaceexplorer", "spaceball", "3dconnexion")

ORBIT_PER_S, PAN_PER_S, NOTCHES_PER_S = 0.7, 0.6, 6.0  # at full deflection: picture heights, and notches of the wheel


@dataclass(frozen=True)
class ControllerState:
    name: str  # as the system has it
    axes: tuple[float, ...]  # -1 … 1 each
    buttons: tuple[bool, ...] = ()  # whether each is down
    gamepad: bool = False  # axes and buttons are in GLFW's standard layout

    @property
    def mouse(self) -> bool:
        return not self.gamepad and len(self.axes) >= 6 and any(maker in self.name.lower() for maker in MAKERS)

    @property
    def usable(self) -> bool:
        return (self.gamepad or self.mouse) and len(self.axes) >= 6


@dataclass
class Controllers:
    """The devices. dead_zone: 0 … 1, deflections below are none. states: of this moment."""

    dead_zone: float = 0.15
    states: Sequence[ControllerState] = ()
    _moving: bool = False

    @property
    def present(self) -> bool:
        """Whether there is one, so that it must be looked at often."""
        return any(state.usable for state in self.states)

    def update(self, app: App, states: Sequence[ControllerState], seconds: float) -> None:
        before = {(place, state.name): state.buttons for place, state in enumerate(self.states)}
        self.states = states
        for place, state in enumerate(states):
            if state.usable:  # what is down when a device comes is not pressed
                for command in _pressed(state, before.get((place, state.name), state.buttons)):
                    app.run(command)
        rig = app.scene.rig if app.scene is not None else None
        moves = [(state, self._axes(state)) for state in states if state.usable]
        was_moving, self._moving = self._moving, rig is not None and any(any(axes) for _, axes in moves)
        if rig is None or not self._moving:
            return
        if not was_moving:  # the whole way is one step to be undone
            rig.remember()
        for state, axes in moves:
            _move(rig, state.gamepad, axes, seconds)
        app.touch()

    def _axes(self, state: ControllerState) -> tuple[float, ...]:
        """-1 … 1 each, 0 within the dead zone and growing slowly beyond it; triggers 0 … 1."""
        axes = list(state.axes)
        if state.gamepad:
            for trigger in (LEFT_TRIGGER, RIGHT_TRIGGER):
                axes[trigger] = 0.5 * (axes[trigger] + 1.0)
        return tuple(shaped(value, self.dead_zone) for value in axes[:6])


def _pressed(state: ControllerState, before: Sequence[bool]) -> list[str]:
    """The commands of the buttons that are down and were not before."""
    table = GAMEPAD_BUTTONS if state.gamepad else MOUSE_BUTTONS
    went_down = [down and not was_down for down, was_down in zip(state.buttons, before, strict=False)]
    return [command for button, (_, command) in table.items() if button < len(went_down) and went_down[button]]


def shaped(value: float, dead_zone: float) -> float:
    """A deflection without its dead zone, squared, so that small ones are fine; -1 … 1. What is no number is none."""
    size = min(abs(value), 1.0)
    if not size > dead_zone:
        return 0.0
    return copysign(((size - dead_zone) / (1.0 - dead_zone)) ** 2, value)


def _move(rig: OrbitCamera, gamepad: bool, axes: Sequence[float], seconds: float) -> None:
    """Left stick: slide, or move the camera itself; right stick: turn, or look; triggers: away and closer, or down and up.

    A 3D mouse's cap is the camera where that looks around, else it holds the scene: pushed, tilted and turned, the scene follows.
    """
    looks = rig.looks_around
    sign = -1.0 if looks else 1.0  # one looks where the stick points, and goes there around a pivot
    if gamepad:
        ahead, rise = -axes[LEFT_Y], axes[RIGHT_TRIGGER] - axes[LEFT_TRIGGER]
        right, up, closer = (axes[LEFT_X], rise, ahead) if looks else (axes[LEFT_X], ahead, rise)
        across, along = axes[RIGHT_X], sign * axes[RIGHT_Y]
    else:
        right, up, closer = -sign * axes[PUSH_X], sign * axes[PUSH_Z], sign * axes[PUSH_Y]
        across, along = sign * axes[TURN_Z], axes[TILT_X]
    if looks:
        rig.fly(right, up, closer, seconds)
    else:
        if right or up:
            rig.pan(-PAN_PER_S * seconds * right, PAN_PER_S * seconds * up)
        if closer:
            rig.dolly(NOTCHES_PER_S * seconds * closer)
    if across or along:
        rig.orbit(-ORBIT_PER_S * seconds * across, -ORBIT_PER_S * seconds * along)
