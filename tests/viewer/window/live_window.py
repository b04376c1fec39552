"""The window itself, on a display of our own, under real mouse and keyboard events.

Not collected by itself: test_window.py runs it in a process of its own, because Xlib ends the process when a GLX window
is opened while another test's EGL context is current in the same thread.
"""

import os
import time
from typing import Any

import glfw
import numpy as np
import pytest
from imgui_bundle import imgui

from scenepack import save_pack
from tests.viewer.conftest import toy_pack
from tests.viewer.screen import SCREEN
from tests.viewer.window.conftest import PATIENCE_S, SIZE, pump, wait
from viewer.window.window import Window


@pytest.mark.parametrize("button", [1, 3])
def test_a_drag_whose_last_way_and_release_come_in_one_frame_is_whole_and_the_wheel_comes_nearer(window, act, button):
    rig = window.app.scene.rig
    start = rig.goal
    act("mousemove", 200, 300, "mousedown", button)
    act("mousemove", 320, 350, "mouseup", button)
    assert (rig.goal.azimuth != start.azimuth) == (button == 1) and (rig.goal.pivot != start.pivot) == (button == 3)
    act("click", "--repeat", 3, "--delay", 30, 4)
    assert rig.goal.distance < start.distance and window.ctx.error == "GL_NO_ERROR"


def test_the_window_follows_a_new_size(window, xdotool):
    xdotool("search", "--class", "^snerg$", "windowsize", "--sync", 1100, 700)
    pump(window, 0.5)
    assert window.app.viewport.height > 640
    assert window.screenshot().shape == (700, 1100, 3)


def test_an_idle_window_sleeps(window):
    window.draw_frames(2)
    for _ in range(20):
        window.app.frames_owed = 0
        if not window.step():
            break
    spent, start = time.process_time(), time.monotonic()
    drawn = sum(window.step() for _ in range(3))
    spent, passed = time.process_time() - spent, time.monotonic() - start
    assert drawn == 0 and passed > 2.0
    assert spent / passed < 0.02


def test_a_tip_shows_without_another_event_where_the_mouse_came_to_rest(window, xdotool):
    xdotool("mousemove", SIZE[0] - 26, 24)  # the icon of full screen
    end = time.monotonic() + PATIENCE_S
    while (tip := imgui.internal.find_window_by_name("##Tooltip_00")) is None or not tip.active or tip.hidden:
        assert time.monotonic() < end
        window.step()
    for _ in range(3):
        window.step()
    assert not window.ui.changes_soon
    xdotool("mousemove", 200, 300)


def test_a_pack_that_is_dropped_is_opened(window, tmp_path):
    save_pack(toy_pack(view_mlp=False), tmp_path / "a dröpped päck")
    glfw_untyped: Any = glfw  # the stub has the C signatures
    heard = glfw_untyped.set_drop_callback(window.handle, None)
    heard(window.handle, 1, [os.fsencode(tmp_path / "a dröpped päck")])  # as GLFW's C code does
    wait(window, lambda: window.app.loading is None)
    assert window.app.scene.name == "a dröpped päck" and window.app.scene.pack.view_mlp is None
    assert not window.app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_f11_fills_the_screen_and_gives_it_back(window, xdotool):
    xdotool("key", "F11")
    wait(window, lambda: glfw.get_window_size(window.handle) == SCREEN)
    pump(window)
    assert window.app.interface.full_screen and window.screenshot().shape[:2] == SCREEN[::-1]
    assert window.size == SIZE  # what is remembered
    xdotool("key", "Escape")
    wait(window, lambda: glfw.get_window_size(window.handle) == SIZE)
    assert not window.app.interface.full_screen
    assert window.ctx.error == "GL_NO_ERROR"


def moved(window: Window, xdotool, keycode: int | str) -> np.ndarray:
    """How the flying camera moves, along its own axes, while a key is held."""
    rig = window.app.open_scene.rig
    before, rotation = rig.goal.eye(rig.table), rig.goal.rotation(rig.table)
    xdotool("keydown", keycode)
    wait(window, lambda: np.linalg.norm(rig.goal.eye(rig.table) - before) > 0.02 * rig.radius)
    xdotool("keyup", keycode)
    pump(window, 0.2)
    return (rig.goal.eye(rig.table) - before) @ rotation


AXES = {"D": (0, 1), "A": (0, -1), "E": (1, 1), "Q": (1, -1), "S": (2, 1), "W": (2, -1)}  # camera axes: z is back


def test_the_arrow_keys_turn_slide_and_fly(window, xdotool, act):
    rig = window.app.scene.rig
    start = rig.goal
    xdotool("keydown", "Right")
    wait(window, lambda: abs(rig.goal.azimuth - start.azimuth) > 5)
    act("keyup", "Right")
    turned = rig.goal
    assert turned.azimuth > start.azimuth and turned.pivot == start.pivot  # the camera goes to the right
    xdotool("keydown", "shift", "keydown", "Up")
    wait(window, lambda: rig.goal.pivot != turned.pivot)
    act("keyup", "Up", "keyup", "shift")
    assert rig.goal.pivot[1] > turned.pivot[1] and rig.goal.azimuth == turned.azimuth
    for expected in (turned, start):  # each way is one step
        xdotool("key", "ctrl+z")
        wait(window, lambda goal=expected: rig.goal == goal)
    act("key", "v")
    for arrow, place in (("Up", "W"), ("Down", "S"), ("Left", "A"), ("Right", "D")):
        axis, sign = AXES[place]
        way = moved(window, xdotool, arrow)
        assert np.argmax(np.abs(way)) == axis and np.sign(way[axis]) == sign, arrow


def test_the_cross_quits_as_the_command_does(window):
    """Which asks while a scene is made: tests/viewer/features/making/test_making.py."""
    glfw.set_window_should_close(window.handle, True)
    window.run()
    assert window.app.quitting and not glfw.window_should_close(window.handle)
