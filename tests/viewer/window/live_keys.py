"""Keys and small windows, on a display of our own, under real events. Not collected by itself; see live_window.py."""

import os
import shutil
import subprocess
import time
from collections.abc import Callable

import glfw
import numpy as np
import pytest
from imgui_bundle import imgui

from tests.viewer.conftest import missing
from tests.viewer.window.live_window import opened, pump, window
from viewer.window.window import Window

__all__ = ["opened", "window"]  # fixtures

PATIENCE_S = 30.0
SLOW_FRAME_S = 0.2
QUICK = 12
KEYCODE = {"Q": 24, "W": 25, "E": 26, "A": 38, "S": 39, "D": 40, "M": 58, "Z": 52}  # evdev's, by place


@pytest.fixture
def slow_frames(monkeypatch):
    """Frames as they are on a slow card: whole keystrokes come and go within one."""
    swap = glfw.swap_buffers

    def slowly(handle) -> None:
        time.sleep(SLOW_FRAME_S)
        swap(handle)

    monkeypatch.setattr(glfw, "swap_buffers", slowly)


@pytest.fixture
def during_frames(window, display):
    """Has xdotool send events while the window draws frame after frame, until it has sent them all."""
    program = shutil.which("xdotool")
    if program is None:
        missing("xdotool")

    def call(*words: object) -> None:
        command = [str(program), *(str(word) for word in words)]
        sender = subprocess.Popen(command, env={**os.environ, "DISPLAY": display}, stdout=subprocess.DEVNULL)
        while sender.poll() is None:
            window.app.touch(1)
            window.step()
        assert sender.returncode == 0

    return call


@pytest.fixture
def french(display, window):
    """The French layout, which has Z, Q and A where a US keyboard has W, A and Q."""
    program = shutil.which("setxkbmap")
    if program is None:
        missing("setxkbmap")

    def use(layout: str) -> None:
        subprocess.run([str(program), "-display", display, layout], check=True, stderr=subprocess.DEVNULL)
        pump(window, 0.3)

    use("fr")
    wait_until(window, lambda: glfw.get_key_name(glfw.KEY_W, 0) == "z")
    yield
    use("us")


def wait_until(window: Window, condition: Callable[[], bool]) -> None:
    """Lets the window live until `condition`."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it does not come about"
        window.app.touch(1)
        window.step()


# Presses and their modifiers


def test_every_quick_paste_is_a_paste_and_none_is_a_v(window, slow_frames, during_frames):
    pasted = []
    window.app.paste_pose = lambda: pasted.append(window.app.scene.rig.flying)
    for _ in range(QUICK):
        quick_paste(during_frames)
        window.step()
    assert pasted == [False] * QUICK and not window.app.scene.rig.flying


def quick_paste(during_frames) -> None:
    """Ctrl first; then, within one frame, V, and Ctrl is let go of before V is."""
    during_frames("keydown", "ctrl")
    during_frames("keydown", "v", "keyup", "ctrl", "keyup", "v")


def test_quick_pastes_into_a_field_are_pastes_too(window, slow_frames, during_frames):
    window.app.clipboard.set("ab")
    during_frames("key", "ctrl+shift+o")
    wait_until(window, lambda: window.app.file_request is not None and window.ui.typing)
    for _ in range(QUICK // 2):
        quick_paste(during_frames)
        window.step()
    assert window.ui.file_dialogs._text == QUICK // 2 * "ab"
    during_frames("key", "Escape")
    wait_until(window, lambda: window.app.file_request is None)


def test_quick_presses_are_neither_lost_nor_doubled(window, slow_frames, during_frames):
    during_frames("key", "--delay", 1, "v", "v", "v", "space", "space")
    for _ in range(3):
        window.app.touch(1)
        window.step()
    assert window.app.scene.rig.flying and window.app.settings.mode == "features"


def test_what_is_typed_fast_into_a_field_is_there_at_once_and_runs_no_command(window, slow_frames, during_frames):
    during_frames("key", "ctrl+shift+o")
    wait_until(window, lambda: window.app.file_request is not None and window.ui.typing)
    text = "/vvrf n?k1b2/this is no folder"
    during_frames("type", "--delay", 1, text)
    for _ in range(2):  # all that is left in the queue comes with the next frame
        window.app.touch(1)
        window.step()
    assert window.ui.file_dialogs._text == text
    app = window.app
    assert not app.scene.rig.flying and app.settings.mode == "normal" and not app.interface.help_shown
    during_frames("key", "Escape")
    wait_until(window, lambda: app.file_request is None)


def test_typing_right_after_the_click_into_a_field_stays_in_the_field(window, slow_frames, during_frames, xdotool):
    """All in one frame: imgui gives the keyboard to a field a frame after the click."""
    window.app.interface.page = "camera"
    pump(window, 0.5)
    # Ctrl+click on a slider makes a field of it; the first one of the page is the field of view.
    x, y = field_of_view(window)
    xdotool("mousemove", x, y)
    pump(window, 0.5)
    during_frames("keydown", "ctrl", "click", 1, "keyup", "ctrl", "type", "--delay", 1, "42")
    during_frames("key", "Return")
    wait_until(window, lambda: window.app.scene.rig.fov == 42.0)
    assert window.app.scene.rig.goal.azimuth == window.app.scene.rig.home_pose.azimuth  # 2 looks from the right


def field_of_view(window: Window) -> tuple[int, int]:
    """Where its slider is: the longest run of the control's colour in the second card."""
    picture = window.screenshot().astype(int)
    left = round(window.app.viewport.width) + 120
    slider = (np.abs(picture[:, left:-70] - (0x23, 0x2C, 0x39)).sum(axis=2) < 6).mean(axis=1) > 0.6
    rows = np.flatnonzero(slider & (np.arange(len(slider)) > 230))
    assert len(rows), "there is no slider"
    return left + 100, int(rows[0]) + 12


def test_a_dialog_keeps_the_keys(window, slow_frames, during_frames):
    window.app.messages.fail("it cannot be opened", "the file is no pack")
    pump(window, 0.5)
    during_frames("key", "--delay", 1, "v", "space", "ctrl+c")
    pump(window, 0.5)
    assert window.app.messages.dialogs and not window.app.scene.rig.flying
    during_frames("key", "Return")
    wait_until(window, lambda: not window.app.messages.dialogs)


def test_an_unfinished_queue_keeps_the_window_awake(window):
    window.draw_frames(2)
    io = imgui.get_io()
    for i in range(80):
        io.add_key_event(imgui.Key.f12, i % 2 == 0)
    window.app.frames_owed = 0
    start, steps = time.monotonic(), 0
    while len(imgui.get_current_context().input_events_queue):
        window.app.frames_owed, window._touched = 0, False
        window.step()
        steps += 1
        assert time.monotonic() - start < PATIENCE_S
    assert steps < 10  # many changes a frame, and no second of sleep in between


# Places and names


def moved(window: Window, xdotool, keycode: int | str) -> np.ndarray:
    """How the flying camera moves, along its own axes, while a key is held."""
    rig = window.app.scene.rig
    before, rotation = rig.goal.eye(rig.table), rig.goal.rotation(rig.table)
    xdotool("keydown", keycode)
    wait_until(window, lambda: np.linalg.norm(rig.goal.eye(rig.table) - before) > 0.02 * rig.radius)
    xdotool("keyup", keycode)
    pump(window, 0.2)
    return (rig.goal.eye(rig.table) - before) @ rotation


AXES = {"D": (0, 1), "A": (0, -1), "E": (1, 1), "Q": (1, -1), "S": (2, 1), "W": (2, -1)}  # camera axes: z is back


def test_flying_goes_by_the_places_of_keys_on_a_french_keyboard(window, xdotool, french):
    xdotool("key", "v")
    pump(window)
    assert window.app.scene.rig.flying
    for place, (axis, sign) in AXES.items():
        way = moved(window, xdotool, KEYCODE[place])
        assert np.argmax(np.abs(way)) == axis and np.sign(way[axis]) == sign, place
    assert window.app.keyboard.flying_names == ("Z", "Q", "S", "D", "A", "E")
    assert "Z Q S D, A and E" in window.app.messages.toast


def test_commands_go_by_names_and_characters_on_a_french_keyboard(window, xdotool, french):
    rig = window.app.scene.rig
    xdotool("key", 11)  # the place of 2, which types é
    wait_until(window, lambda: rig.goal.azimuth == 90)
    xdotool("keydown", "ctrl", "key", KEYCODE["W"], "keyup", "ctrl")  # Z is printed there
    wait_until(window, lambda: rig.goal.azimuth != 90)
    xdotool("keydown", "shift", "key", KEYCODE["M"], "keyup", "shift")  # ? is printed there
    wait_until(window, lambda: window.app.interface.help_shown)
    xdotool("key", KEYCODE["M"])
    pump(window)
    assert window.app.interface.help_shown


def test_the_arrow_keys_turn_slide_and_fly(window, xdotool):
    rig = window.app.scene.rig
    start = rig.goal
    xdotool("keydown", "Right")
    wait_until(window, lambda: abs(rig.goal.azimuth - start.azimuth) > 5)
    xdotool("keyup", "Right")
    pump(window)
    turned = rig.goal
    assert turned.azimuth > start.azimuth and turned.pivot == start.pivot  # the camera goes to the right
    xdotool("keydown", "shift", "keydown", "Up")
    wait_until(window, lambda: rig.goal.pivot != turned.pivot)
    xdotool("keyup", "Up", "keyup", "shift")
    pump(window)
    assert rig.goal.pivot[1] > turned.pivot[1] and rig.goal.azimuth == turned.azimuth
    for expected in (turned, start):  # each way is one step
        xdotool("key", "ctrl+z")
        wait_until(window, lambda goal=expected: rig.goal == goal)
    xdotool("key", "v")
    pump(window)
    for arrow, place in (("Up", "W"), ("Down", "S"), ("Left", "A"), ("Right", "D")):
        axis, sign = AXES[place]
        way = moved(window, xdotool, arrow)
        assert np.argmax(np.abs(way)) == axis and np.sign(way[axis]) == sign, arrow


def test_a_tap_of_an_arrow_within_one_slow_frame_still_turns(window, slow_frames, during_frames):
    rig = window.app.scene.rig
    start = rig.goal
    during_frames("key", "--delay", 0, "Left")
    wait_until(window, lambda: rig.goal.azimuth < start.azimuth)
