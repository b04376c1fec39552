"""Small windows and what is cut off, on a display of our own, under real events. Not collected by itself; see live_window.py."""

from pathlib import Path

import glfw
import numpy as np
import pytest
from imgui_bundle import imgui

from scenepack import Pack
from scenepack.blocks import atlas_from_dense
from scenepack.pack import pack_of_cube
from tests.viewer.conftest import BLENDER, BLOCK, SIDE
from tests.viewer.window.live_keys import wait_until
from tests.viewer.window.live_window import opened, pump, window
from viewer.interface.layout import PAGES
from viewer.window.window import Window

__all__ = ["opened", "window"]  # fixtures


def resize(window: Window, xdotool, width: int, height: int) -> None:
    xdotool("search", "--class", "^snerg$", "windowsize", "--sync", width, height)
    wait_until(window, lambda: glfw.get_window_size(window.handle) == (width, height))
    pump(window, 0.2)


def press_at(window: Window, xdotool, x: float, y: float) -> None:
    xdotool("mousemove", round(x), round(y))
    pump(window, 0.1)
    xdotool("click", 1)
    pump(window, 0.2)


def test_every_icon_of_a_small_window_can_be_clicked(window, xdotool):
    resize(window, xdotool, 480, 360)
    interface, x = window.app.interface, 480 - 25
    rail = [48 + 10 + 16 + 40 * i for i in range(7)]  # six pages, and the menu of the others
    for page, y in zip(PAGES[:6], rail, strict=False):
        press_at(window, xdotool, x, y)
        wait_until(window, lambda page=page: interface.over == page.id)
        wait_until(window, lambda: covered(window))
    for i, page in enumerate(PAGES[6:]):
        press_at(window, xdotool, x, rail[6])
        wait_until(window, popups)
        press_at(window, xdotool, *menu_line(window, i, len(PAGES) - 6))
        wait_until(window, lambda page=page: interface.over == page.id)
    xdotool("key", "Escape")
    wait_until(window, lambda: not interface.over)
    assert window.app.scene is not None


def covered(window: Window) -> bool:
    """Whether a page lies over the picture."""
    return window.screenshot()[60:350, 120:420].mean() < 90


def menu_line(window: Window, index: int, count: int) -> tuple[float, float]:
    """Where a line of the open menu is."""
    menu = popups()[0]
    top, height = menu.pos.y + menu.window_padding.y, menu.size.y - 2 * menu.window_padding.y
    return menu.pos.x + 40, top + height * (index + 0.5) / count


def popups():
    """imgui's windows that are menus just now."""
    return [entry.window for entry in imgui.get_current_context().open_popup_stack if entry.window is not None]


def test_the_bar_of_a_small_window_does_what_its_buttons_say(window, xdotool, monkeypatch):
    resize(window, xdotool, 480, 360)
    ran = []
    monkeypatch.setattr("viewer.interface.top_bar.run", lambda app, name: ran.append(name))
    window.app.touch()
    for i in range(6):
        press_at(window, xdotool, 480 - 8 - 17 - 38 * (5 - i), 24)
    assert ran == ["open", "save", "home", "frame", "help", "full-screen"]


@pytest.mark.parametrize("size", [(1280, 900)])
def test_all_keys_are_seen_at_once(window, xdotool, size):
    resize(window, xdotool, *size)
    xdotool("key", "F1")
    wait_until(window, lambda: window.app.interface.help_shown)
    pump(window)
    help_window = imgui.internal.find_window_by_name("##help")
    assert help_window.pos.y >= 0 and help_window.pos.y + help_window.size.y <= size[1]
    assert help_window.content_size.y < help_window.size.y and help_window.scroll_max.y == 0


def test_the_wheel_and_the_arrows_reach_the_last_key_in_a_small_window(window, xdotool):
    resize(window, xdotool, 480, 360)
    xdotool("key", "F1")
    wait_until(window, lambda: window.app.interface.help_shown)
    pump(window)
    help_window = imgui.internal.find_window_by_name("##help")
    assert help_window.pos.y + help_window.size.y <= 360 and help_window.scroll_max.y > 0
    distance = window.app.scene.rig.goal.distance
    xdotool("mousemove", 200, 180, "click", "--repeat", 30, "--delay", 10, 5)
    wait_until(window, lambda: help_window.scroll.y == help_window.scroll_max.y)
    xdotool("keydown", "Up")
    wait_until(window, lambda: help_window.scroll.y == 0)
    xdotool("keyup", "Up")
    assert window.app.scene.rig.goal.distance == distance


def plank() -> Pack:
    """A bar from one side of the grid to the other."""
    z, y, _ = np.mgrid[:SIDE, :SIDE, :SIDE]
    rgba = np.where((np.hypot(y - SIDE / 2, z - SIDE / 2) < 5)[..., None], [200, 40, 40, 255], 0).astype(np.uint8)
    return pack_of_cube(SIDE, BLOCK, atlas_from_dense(rgba, None, BLOCK), None, BLENDER)


@pytest.mark.parametrize("key", ["f", "Home"])
def test_the_whole_scene_fits_into_a_narrow_window(window, xdotool, key):
    window.app.show(plank(), Path("plank"))
    resize(window, xdotool, 480, 800)
    xdotool("key", "1", "key", key)
    pump(window, 0.2)
    window.draw_frames(2)
    box = window.app.viewport
    picture = window.screenshot()[round(box.y) + 40 : round(box.y + box.height) - 60, : round(box.width)].astype(int)
    seen = np.flatnonzero((picture.min(axis=2) < 200).any(axis=0))
    assert seen[0] > 3 and seen[-1] < box.width - 4


# What is cut off


def test_the_near_plane_is_undone_with_the_rest_and_reset_by_its_button(window, xdotool):
    window.app.interface.page = "crop"
    pump(window)
    app, rig = window.app, window.app.scene.rig
    x = round(app.viewport.width) + 140
    y = near_row(window)
    xdotool("mousemove", x, y, "mousedown", 1)
    pump(window)
    xdotool("mousemove", x + 40, y)
    pump(window)
    xdotool("mouseup", 1)
    pump(window)
    near = app.settings.near
    assert near > 0
    xdotool("key", "2")
    wait_until(window, lambda: rig.goal.azimuth == 90)
    xdotool("key", "ctrl+z")
    wait_until(window, lambda: rig.goal.azimuth != 90)
    assert app.settings.near == near
    xdotool("key", "ctrl+z")
    wait_until(window, lambda: app.settings.near == 0)
    xdotool("key", "ctrl+shift+z")
    wait_until(window, lambda: app.settings.near == near)
    press_at(window, xdotool, 900 - 50 - 3 - 12 - 14 - 17, y)  # the arrow at the row's end
    assert app.settings.near == 0
    xdotool("key", "ctrl+z")
    wait_until(window, lambda: app.settings.near == near)


def near_row(window: Window) -> int:
    """Where the near plane's slider is: the control that is farthest down on the page."""
    picture = window.screenshot().astype(int)
    left = round(window.app.viewport.width) + 120
    slider = (np.abs(picture[:, left : left + 90] - (0x23, 0x2C, 0x39)).sum(axis=2) < 6).mean(axis=1) > 0.5
    rows = np.flatnonzero(slider)
    assert len(rows), "there is no slider"
    return int(rows[-1]) - 8
