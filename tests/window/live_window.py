"""The window itself, on a display of our own, under real mouse and keyboard events.

Not collected by itself: test_window.py runs it in a process of its own, because Xlib ends the process when a GLX window
is opened while another test's EGL context is current in the same thread.
"""

import os
import shutil
import subprocess
import time

import pytest

from tests.window.conftest import missing
from viewer.app.application import App
from viewer.window import NoDisplay, Window, display_problem

SIZE = (900, 600)


@pytest.fixture
def xdotool(display):
    """Moves the mouse and presses keys on our display."""
    program = shutil.which("xdotool")
    if program is None:
        missing("xdotool")

    def call(*words: object) -> None:
        command = [str(program), *(str(word) for word in words)]
        subprocess.run(command, check=True, env={**os.environ, "DISPLAY": display}, stdout=subprocess.DEVNULL)

    return call


@pytest.fixture
def window(display, monkeypatch, pack, pack_folder):
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    app = App()
    with Window(app, SIZE) as window:
        app.show(pack, pack_folder)
        window.draw_frames(3)
        yield window


def pump(window: Window, seconds: float = 0.25) -> None:
    """Lets the window live for a moment."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        window.app.touch(1)
        window.step()


def test_real_events_move_the_camera_and_run_commands(window, xdotool):
    rig = window.app.scene.rig
    start = rig.goal
    xdotool("mousemove", 200, 300, "mousedown", 1)
    pump(window)
    xdotool("mousemove", 260, 320)
    pump(window)
    xdotool("mouseup", 1)
    pump(window)
    assert rig.goal.azimuth != start.azimuth
    xdotool("click", "--repeat", 3, "--delay", 30, 4)  # the wheel
    pump(window)
    assert rig.goal.distance < start.distance
    xdotool("key", "space")
    pump(window)
    assert window.app.settings.mode == "diffuse"
    xdotool("key", "r")
    pump(window)
    assert rig.goal == rig.home_pose
    assert window.ctx.error == "GL_NO_ERROR"


def test_the_window_follows_a_new_size(window, xdotool):
    xdotool("search", "--name", "^snerg", "windowsize", "--sync", 1100, 700)
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


def test_the_screenshot_shows_scene_and_panel(window):
    window.draw_frames(2)
    picture = window.screenshot()
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    assert picture[100:500, 50:400].reshape(-1, 3).std(axis=0).max() > 15
    assert picture[80:, SIZE[0] - 300 :].mean() < 70


def test_a_display_that_does_not_answer_is_no_display(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":4711")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert display_problem() is None
    with pytest.raises(NoDisplay, match="no window can be opened"):
        Window(App())
