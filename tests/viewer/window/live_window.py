"""The window itself, on a display of our own, under real mouse and keyboard events.

Not collected by itself: test_window.py runs it in a process of its own, because Xlib ends the process when a GLX window
is opened while another test's EGL context is current in the same thread.
"""

import sys
import time
from pathlib import Path

import glfw
import pytest
from PIL import Image

from scenepack import save_pack
from tests.viewer.conftest import toy_pack
from tests.viewer.screen import SCREEN
from tests.viewer.waiting import until
from tests.viewer.window.living import SIZE, pump, wait
from viewer.app.application import App
from viewer.features.making.make_plan import Plan

FAKE = Path(__file__).parents[1] / "features" / "making" / "fake_make.py"


def test_real_events_move_the_camera_and_run_commands(window, act):
    rig = window.app.scene.rig
    start = rig.goal
    act("mousemove", 200, 300, "mousedown", 1)
    act("mousemove", 260, 320)
    act("mouseup", 1)
    assert rig.goal.azimuth != start.azimuth
    act("click", "--repeat", 3, "--delay", 30, 4)  # the wheel
    assert rig.goal.distance < start.distance
    act("key", "space")
    assert window.app.settings.mode == "diffuse"
    act("key", "r")
    assert rig.goal == rig.home_pose
    assert window.ctx.error == "GL_NO_ERROR"


@pytest.mark.parametrize("button", [1, 3])
def test_a_drag_whose_last_way_and_release_come_in_one_frame_is_whole(window, act, button):
    rig = window.app.scene.rig
    start = rig.goal
    act("mousemove", 200, 300, "mousedown", button)
    act("mousemove", 320, 350, "mouseup", button)
    assert (rig.goal.azimuth != start.azimuth) == (button == 1) and (rig.goal.pivot != start.pivot) == (button == 3)


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


def test_a_pack_that_another_program_drops_is_opened(window, other_client, tmp_path):
    save_pack(toy_pack(view_mlp=False), tmp_path / "a dröpped päck")
    other_client("drop", tmp_path / "a dröpped päck")
    wait(window, lambda: window.app.loading is None)
    assert window.app.scene.name == "a dröpped päck" and window.app.scene.pack.view_mlp is None
    assert not window.app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_what_is_no_pack_is_a_dialog_that_real_keys_answer(window, other_client, act, tmp_path):
    scene = window.app.scene
    (tmp_path / "notes.txt").write_text("hello")
    other_client("drop", tmp_path / "notes.txt")
    wait(window, lambda: window.app.loading is None)
    pump(window)
    assert "notes.txt" in window.app.messages.dialogs[0].title and window.app.scene is scene
    act("key", "Return")
    assert not window.app.messages.dialogs


def test_photographs_that_are_dropped_are_asked_about_and_escape_declines(window, other_client, act, tmp_path):
    Image.new("RGB", (16, 12)).save(tmp_path / "r_0.png")
    (tmp_path / "transforms_train.json").write_text(
        '{"camera_angle_x": 0.7, "frames": [{"file_path": "r_0", "transform_matrix":'
        " [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}]}"
    )
    other_client("drop", tmp_path)
    plan = window.app.making.plan
    assert plan is not None
    until(lambda: plan.survey.finished)
    pump(window)
    assert plan.problem() is None and plan.survey.text.startswith("1 photographs of 16 × 12")
    act("key", "Escape")
    assert window.app.making.plan is None


def test_f11_fills_the_screen_and_gives_it_back(window, xdotool):
    xdotool("key", "F11")
    pump(window, 0.6)
    assert window.app.interface.full_screen
    assert glfw.get_window_size(window.handle) == SCREEN and window.screenshot().shape[:2] == SCREEN[::-1]
    assert window.size == SIZE  # what is remembered
    xdotool("key", "Escape")
    pump(window, 0.6)
    assert not window.app.interface.full_screen and glfw.get_window_size(window.handle) == SIZE
    assert window.ctx.error == "GL_NO_ERROR"


def test_keys_held_fly_and_combinations_undo(window, xdotool, act):
    rig = window.app.scene.rig
    act("key", "v")
    start = rig.goal.eye(rig.table)
    xdotool("keydown", "w")
    pump(window, 0.5)
    act("keyup", "w")
    assert rig.flying and abs(rig.goal.eye(rig.table) - start).max() > 0.01
    xdotool("key", "v", "key", "2")
    pump(window, 0.4)
    turned = rig.goal
    xdotool("key", "ctrl+z")
    pump(window, 0.4)
    assert rig.goal != turned


def test_closing_asks_while_a_scene_is_made_and_leaves_no_child(window, other_client, tmp_path, monkeypatch):
    app = window.app
    monkeypatch.setattr(Plan, "command", lambda plan: [sys.executable, str(FAKE), "wait", str(tmp_path)])
    app.making.plan = Plan("scene", tmp_path / "photographs", tmp_path)
    app.making.start(app)
    wait(window, (tmp_path / "pid").exists)
    other_client("close")
    pump(window)
    assert glfw.window_should_close(window.handle)  # the loop answers that with a question
    app.messages.dialogs.clear()
    answer(app)
    window.run()
    assert app.quitting and (tmp_path / "saved").exists() and app.making.job is None


def answer(app: App) -> None:
    """Presses "Stop and quit" as soon as it is asked."""
    ask = app.making.ask_to_quit

    def asked(app: App) -> None:
        ask(app)
        assert not app.quitting and "still being made" in app.messages.dialogs[0].title
        app.messages.dialogs.clear()
        app.making.stop_and_quit(app)

    app.making.ask_to_quit = asked
