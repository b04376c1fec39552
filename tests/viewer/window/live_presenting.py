"""Scenes shown to others, on the window itself under real events: 360° pictures, colours, the kiosk. See live_window.py."""

from __future__ import annotations

import glfw
import numpy as np
from PIL import Image

from tests.viewer.screen import SCREEN
from tests.viewer.window.living import place_of, press, pump, type_path, wait
from viewer.features.film import kiosk


def test_a_view_is_saved_as_a_360_picture(film_page, watched, xdotool, tmp_path):
    window, app = film_page, film_page.app
    press(watched, xdotool, "##panorama")
    wait(window, lambda: app.filming.size == (4096, 2048))
    app.filming.set_size(128, 2048)
    pump(window)
    press(watched, xdotool, "Save this view…")
    type_path(window, xdotool, tmp_path / "around.png")
    wait(window, (tmp_path / "around.png").exists)
    around = app.scene.rig.camera((128, 64)).as_panorama((128, 64))
    assert np.array_equal(np.asarray(Image.open(tmp_path / "around.png")), window.canvas.snapshot(around, app.settings))
    press(watched, xdotool, "##panorama")
    wait(window, lambda: app.filming.size == (1920, 1080))
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_colours_are_changed_exported_and_taken_back(film_page, watched, xdotool, act, tmp_path):
    window, app = film_page, film_page.app
    app.interface.page = "view"
    pump(window)
    before = window.canvas.snapshot(app.camera().resized(96, 64), app.picture_settings)
    press(watched, xdotool, "##exposure")
    act("mousedown", 1)
    xdotool("mousemove_relative", 70, 0)
    wait(window, lambda: app.annotations.current.look is not None and app.annotations.current.look.exposure > 0.5)
    xdotool("mouseup", 1)
    look = app.annotations.current.look
    xdotool("mousemove", 200, 300, "key", "ctrl+s")
    type_path(window, xdotool, tmp_path / "bright.png")
    wait(window, (tmp_path / "bright.png").exists)
    brighter = np.asarray(Image.open(tmp_path / "bright.png")).astype(int)
    assert brighter.mean() > before.mean() + 1 and app.settings.look is None
    xdotool("key", "ctrl+z", "key", "ctrl+z")  # the drag, and the click
    wait(window, lambda: app.annotations.current.look is None)
    xdotool("key", "ctrl+y", "key", "ctrl+y")
    wait(window, lambda: app.annotations.current.look == look)
    press(watched, xdotool, "Colours as they are")
    wait(window, lambda: app.annotations.current.look is None)
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


BALL = (0.0, -0.25, 0.4)  # its front


def test_a_place_is_annotated_by_a_click_hides_when_covered_and_is_flown_to(film_page, watched, xdotool, act):
    window, app = film_page, film_page.app
    app.interface.page = "bookmarks"
    rig = app.scene.rig
    rig.look_along(0, 10)
    wait(window, lambda: rig.shown == rig.goal)
    press(watched, xdotool, "###annotate")
    wait(window, lambda: app.bookmarks.placing)
    xdotool("mousemove", *place_of(window, BALL), "click", 1)
    wait(window, lambda: len(app.annotations.current.bookmarks) == 1)
    place, seen = app.annotations.current.bookmarks[0], rig.goal
    assert place.name == "Place 1" and np.allclose(place.point, BALL, atol=0.05) and not app.bookmarks.placing
    press(watched, xdotool, "##text")
    act("type", "--delay", 20, "A ball <b>")
    press(watched, xdotool, "##name")
    act("key", "ctrl+a", "type", "--delay", 20, "Ball")
    xdotool("key", "Return")
    wait(window, lambda: app.annotations.current.bookmarks[0].name == "Ball")
    assert app.annotations.current.bookmarks[0].text == "A ball <b>" and rig.goal == seen
    rig.look_along(180, 10)
    wait(window, lambda: rig.shown == rig.goal and app.bookmarks.covered(app) == {place.point})
    at = place_of(window, place.point)
    xdotool("mousemove", *at, "click", 1)
    pump(window, 0.5)
    assert rig.goal.azimuth == 180
    rig.look_along(40, 25)
    wait(window, lambda: rig.shown == rig.goal and not app.bookmarks.covered(app))
    xdotool("mousemove", *place_of(window, place.point), "click", 1)
    wait(window, lambda: np.allclose(rig.goal.matrix(rig.table), seen.matrix(rig.table), atol=1e-6))
    xdotool("mousemove", 200, 300, "key", "ctrl+shift+d")
    wait(window, lambda: app.bookmarks.placing)
    xdotool("key", "Escape")
    wait(window, lambda: not app.bookmarks.placing)
    for _ in range(9):
        rig.history.undo()
    assert not app.annotations.current.bookmarks
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_a_kiosk_plays_gives_way_to_the_mouse_and_begins_again(window, xdotool, act, monkeypatch):
    app = window.app
    monkeypatch.setattr(kiosk, "IDLE_S", 1.5)
    app.kiosk = kiosk.Kiosk()
    app.kiosk.prepare(app)
    wait(window, lambda: glfw.get_window_size(window.handle) == SCREEN and app.filming.time > 0.2)
    assert app.viewport.width, app.viewport.height == SCREEN
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
