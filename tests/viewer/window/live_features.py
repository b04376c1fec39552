"""What only real events show, on the window itself: keys of all layouts, the clipboard, the kiosk. See live_window.py."""

import os
import subprocess
import sys
import time

import glfw
import numpy as np
import pytest
from PIL import Image

from tests.viewer.conftest import installed
from tests.viewer.screen import SCREEN
from tests.viewer.window.conftest import pump, wait
from tests.viewer.window.live_window import AXES, moved
from viewer.core.pose import shortest_turn
from viewer.features.film import filming

SLOW_FRAME_S, QUICK = 0.2, 12
KEYCODE = {"Q": 24, "W": 25, "E": 26, "A": 38, "S": 39, "D": 40, "M": 58, "Z": 52}  # evdev's, by place
PASTE = """import sys, copykitten; from PIL import Image; pixels, *size = copykitten.paste_image()
Image.frombytes("RGBA", size, bytes(pixels)).save(sys.argv[1])"""
NUMBER_BLOCK = {"1": 87, "2": 88, "3": 89, "4": 83, "5": 84, "6": 85, "7": 79, "8": 80, "9": 81}  # evdev's keycodes


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
    program = installed("xdotool")

    def call(*words: object) -> None:
        command = [program, *(str(word) for word in words)]
        sender = subprocess.Popen(command, env={**os.environ, "DISPLAY": display}, stdout=subprocess.DEVNULL)
        while sender.poll() is None:
            window.app.touch(1)
            window.step()
        assert sender.returncode == 0

    return call


@pytest.fixture
def french(display, window):
    """The French layout, which has Z, Q and A where a US keyboard has W, A and Q."""
    program = installed("setxkbmap")

    def use(layout: str) -> None:
        subprocess.run([program, "-display", display, layout], check=True, stderr=subprocess.DEVNULL)
        pump(window, 0.3)

    use("fr")
    wait(window, lambda: glfw.get_key_name(glfw.KEY_W, 0) == "z")
    yield
    use("us")


def test_every_quick_paste_is_a_paste_and_none_is_a_v(window, slow_frames, during_frames):
    pasted = []
    window.app.go_to_pose = lambda text: pasted.append(window.app.scene.rig.flying)
    for _ in range(QUICK):
        during_frames("keydown", "ctrl")
        during_frames("keydown", "v", "keyup", "ctrl", "keyup", "v")  # within one frame
        window.step()
    assert pasted == [False] * QUICK and not window.app.scene.rig.flying


def test_what_is_typed_fast_into_a_field_is_there_at_once_and_runs_no_command(window, slow_frames, during_frames):
    during_frames("key", "ctrl+shift+o")
    wait(window, lambda: window.app.file_request is not None and window.ui.typing)
    text = "/vvrf n?k1b2/this is no folder"
    during_frames("type", "--delay", 1, text)
    for _ in range(2):  # all that is left in the queue comes with the next frame
        window.app.touch(1)
        window.step()
    assert window.ui.file_dialogs._text == text
    app = window.app
    assert not app.scene.rig.flying and app.settings.mode == "normal" and not app.interface.help_shown
    during_frames("key", "Escape")
    wait(window, lambda: app.file_request is None)


def test_flying_goes_by_the_places_of_keys_on_a_french_keyboard(window, xdotool, act, french):
    act("key", "v")
    assert window.app.scene.rig.flying
    for place, (axis, sign) in AXES.items():
        way = moved(window, xdotool, KEYCODE[place])
        assert np.argmax(np.abs(way)) == axis and np.sign(way[axis]) == sign, place
    assert window.app.keyboard.flying_names == ("Z", "Q", "S", "D", "A", "E")
    assert "Z Q S D, A and E" in window.app.messages.toast


def test_commands_go_by_names_and_characters_on_a_french_keyboard(window, xdotool, act, french):
    rig = window.app.scene.rig
    xdotool("key", 11)  # the place of 2, which types é
    wait(window, lambda: rig.goal.azimuth == 90)
    xdotool("keydown", "ctrl", "key", KEYCODE["W"], "keyup", "ctrl")  # Z is printed there
    wait(window, lambda: rig.goal.azimuth != 90)
    xdotool("keydown", "shift", "key", KEYCODE["M"], "keyup", "shift")  # ? is printed there
    wait(window, lambda: window.app.interface.help_shown)
    act("key", KEYCODE["M"])
    assert window.app.interface.help_shown


@pytest.mark.parametrize(
    ("keys", "azimuth", "elevation"),
    [(["3"], 90, 0), (["ctrl", "7"], 0, -90), (["1", "9"], 180, 0), (["1", "6", "8", "8"], 15, 30)],
)
def test_the_number_block_shows_the_views_that_blender_shows(window, xdotool, keys, azimuth, elevation):
    rig = window.app.scene.rig
    for key in keys:
        if key == "ctrl":
            xdotool("keydown", "ctrl")
        else:
            before = rig.goal
            xdotool("key", NUMBER_BLOCK[key])
            wait(window, lambda before=before: rig.goal != before)
    xdotool("keyup", "ctrl")
    wait(window, lambda: rig.shown == rig.goal)
    assert abs(shortest_turn(rig.goal.azimuth, azimuth)) < 0.1
    assert rig.goal.elevation == pytest.approx(elevation, abs=0.1)
    assert not rig.flying and not window.app.messages.dialogs


def test_another_program_pastes_the_picture_that_was_copied(window, xdotool, display, tmp_path):
    app, file = window.app, tmp_path / "pasted.png"
    for mode in ("normal", "diffuse"):  # the second takes the place of the first
        app.set(mode=mode)
        pump(window)
        xdotool("key", "ctrl+i")
        wait(window, lambda: app.messages.lines[-1].text == "The picture is on the clipboard")
        app.messages.log("pasted")
        subprocess.run([sys.executable, "-c", PASTE, file], check=True, env={**os.environ, "DISPLAY": display})
        pasted = np.asarray(Image.open(file).convert("RGB"))
        assert np.array_equal(pasted, window.canvas.snapshot(app.camera(), app.settings))
    assert not app.messages.dialogs


def test_a_kiosk_plays_gives_way_to_the_mouse_and_begins_again(window, xdotool, act, monkeypatch):
    app = window.app
    monkeypatch.setattr(filming, "IDLE_S", 1.5)
    app.kiosk = filming.Kiosk()
    app.interface.full_screen, app.interface.panels_shown = True, False
    wait(window, lambda: glfw.get_window_size(window.handle) == SCREEN and app.filming.time > 0.2)
    assert (app.viewport.width, app.viewport.height) == SCREEN
    act("mousemove", 600, 400, "mousedown", 1)
    xdotool("mousemove_relative", 60, 10)
    wait(window, lambda: not app.filming.playing and app.scene.rig.held is None)
    turned = app.scene.rig.goal
    xdotool("mouseup", 1, "key", "ctrl+o", "key", "Tab", "key", "space")
    pump(window, 0.5)
    assert app.open_prompt is None and not app.interface.panels_shown and app.settings.mode == "normal"
    assert app.scene.rig.goal == turned and not app.filming.playing
    wait(window, lambda: app.filming.playing and 0 < app.filming.time < 2)
    xdotool("key", "Escape")
    wait(window, lambda: glfw.get_window_size(window.handle) != SCREEN)
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"
