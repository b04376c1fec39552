"""Gamepads and 3D mice, with states that are made up: no device is at hand where tests run."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewer.core.input import LEFT_X, LEFT_Y, PUSH_Y, RIGHT_TRIGGER, RIGHT_X, TURN_Z, A, ControllerState, Y, shaped
from viewer.window.window import controllers_now

AXES = {"lx": LEFT_X, "ly": LEFT_Y, "rx": RIGHT_X, "rt": RIGHT_TRIGGER, "push_y": PUSH_Y, "turn": TURN_Z}


def device(name: str, neutral: tuple[float, ...], buttons: tuple[int, ...] = (), **axes: float) -> ControllerState:
    values = list(neutral)
    for axis, value in axes.items():
        values[AXES[axis]] = value
    return ControllerState(name, tuple(values), tuple(i in buttons for i in range(15)), gamepad=name == "a pad")


pad = partial(device, "a pad", (0.0, 0.0, 0.0, 0.0, -1.0, -1.0))
cap = partial(device, "3Dconnexion SpaceMouse Compact", (0.0,) * 6)


@pytest.fixture
def hear(app, pack, pack_folder):
    """Has the app hear states for a number of frames."""
    app.show(pack, pack_folder)

    def call(*states: ControllerState, frames: int = 10) -> None:
        for _ in range(frames):
            app.controllers.update(app, states, 1 / 60)

    return call


def test_the_right_stick_turns_the_left_one_slides_and_a_trigger_comes_closer(app, hear):
    rig = app.scene.rig
    start = rig.goal
    hear(pad(rx=1.0))
    turned = rig.goal
    assert turned.azimuth != start.azimuth and turned.pivot == start.pivot
    hear(pad(lx=1.0))
    right = rig.goal.rotation(rig.table)[:, 0]
    assert (np.subtract(rig.goal.pivot, turned.pivot) @ right) > 0 and rig.goal.azimuth == turned.azimuth
    before = rig.goal.distance
    hear(pad(rt=1.0))
    assert rig.goal.distance < before
    hear(pad())
    for _ in range(4):
        rig.history.undo()
    assert rig.goal == start  # each way is one step


def test_a_button_starts_flying_once_for_each_press_and_the_left_stick_flies_ahead(app, hear):
    rig = app.scene.rig
    hear(pad((A,)))
    assert not rig.flying  # it was down when the device came
    hear(pad())
    hear(pad((A, Y)), frames=30)
    assert rig.flying and rig.goal == rig.home_pose
    hear(pad())
    eye, ahead = rig.goal.eye(rig.table), -rig.goal.rotation(rig.table)[:, 2]
    hear(pad(ly=-1.0))
    assert (rig.goal.eye(rig.table) - eye) @ ahead == pytest.approx(rig.speed * 10 / 60)


def test_a_button_held_on_one_gamepad_can_be_pressed_on_another_of_the_same_name(app, hear):
    hear(pad(), pad())
    hear(pad((A,)), pad(), frames=4)  # held on the first for four frames: one press
    assert app.scene.rig.flying
    hear(pad((A,)), pad((A,)))  # pressed on the second, too: another press
    assert not app.scene.rig.flying


def test_a_3d_mouse_turns_the_scene_and_pulls_it_closer(app, hear):
    rig = app.scene.rig
    start = rig.goal
    hear(cap(turn=0.8))
    assert rig.goal.azimuth != start.azimuth
    distance = rig.goal.distance
    hear(cap(push_y=1.0))
    assert rig.goal.distance < distance
    hear(cap())
    hear(cap((0,)))
    assert rig.goal == rig.home_pose


@given(value=st.floats(-2, 2) | st.just(float("nan")), dead_zone=st.floats(0, 0.5))
def test_the_dead_zone_is_still_and_beyond_it_deflections_grow_evenly(value, dead_zone):
    out = shaped(value, dead_zone)
    assert -1 <= out <= 1 and (out == 0 or np.sign(out) == np.sign(value))
    if not abs(value) > dead_zone:
        assert out == 0
    assert shaped(1.0, dead_zone) == 1.0 and shaped(min(abs(value), 1.0) + 0.01, dead_zone) >= abs(out)


def test_a_resting_stick_asks_for_no_frame(app, hear):
    hear(pad())
    app.frames_owed = 0
    hear(pad(rx=0.1), frames=30)
    assert app.frames_owed == 0 and app.controllers.present


def test_glfw_s_answers_become_states():
    """As GLFW's bindings give them: a gamepad, a joystick's arrays, and a device that went away in between."""
    gamepad = SimpleNamespace(axes=[0.5] * 6, buttons=[0, 1] + [0] * 13)
    glfw = SimpleNamespace(
        JOYSTICK_1=0,
        JOYSTICK_LAST=3,
        joystick_present=lambda number: number < 3,
        joystick_is_gamepad=lambda number: number != 1,
        get_gamepad_state=lambda number: gamepad if number == 0 else None,
        get_gamepad_name=lambda number: b"Pad",
        get_joystick_name=lambda number: b"SpaceNavigator" if number == 1 else None,
        get_joystick_axes=lambda number: ([0.25] * 8, 6) if number == 1 else (None, 0),
        get_joystick_buttons=lambda number: ([1, 0], 2) if number == 1 else (None, 0),
    )
    pad_state, mouse, gone = controllers_now(glfw)
    assert pad_state.gamepad and pad_state.name == "Pad" and pad_state.buttons[1] and pad_state.usable
    assert mouse.mouse and mouse.axes == (0.25,) * 6 and mouse.buttons == (True, False)
    assert not gone.usable
