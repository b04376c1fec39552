"""The Erase page under real events: each of its tools with the real mouse, the real keys that erase and undo, and a saved pack.

Not collected by itself; see live_window.py.
"""

from __future__ import annotations

from collections.abc import Callable

import glfw
import numpy as np
import pytest
from imgui_bundle import icons_fontawesome_6 as fa

from scenepack import load_pack, save_pack
from scenepack.blocks import dense_from_pack
from tests.viewer.features.editing.test_erasing import BALL, SPECK, specked
from tests.viewer.window.living import LARGE, place_of, press, pump, type_path, wait
from viewer.window.window import Window


@pytest.fixture
def window(start_page, tmp_path) -> Window:
    save_pack(specked(), tmp_path / "toy")
    start_page.app.show(load_pack(tmp_path / "toy"), tmp_path / "toy")
    start_page.app.interface.page = "erase"
    glfw.set_window_size(start_page.handle, *LARGE)  # all of the page is seen
    wait(start_page, lambda: glfw.get_window_size(start_page.handle) == LARGE)
    pump(start_page)
    return start_page


def stroke(window: Window, xdotool: Callable[..., None], points: list[tuple[float, float]], button: int = 1) -> None:
    """Drags with a button through points, in pixels from where the ball's middle is seen."""
    x, y = place_of(window, BALL)
    places = [(x + round(dx), y + round(dy)) for dx, dy in points]
    xdotool("mousemove", *places[0], "mousedown", button)
    pump(window)
    for place in places[1:]:
        xdotool("mousemove", *place)
        pump(window, 0.05)
    xdotool("mouseup", button)
    at_rest(window)


def at_rest(window: Window) -> None:
    """Lets it live until all is selected and shown."""
    pump(window)
    wait(window, lambda: not window.app.erasing.busy(window.app))


def selected(window: Window) -> int:
    return window.app.scene.edits.selected.count


CIRCLE = [(25 * np.cos(turn), 25 * np.sin(turn)) for turn in np.linspace(0, 6, 12)]


@pytest.mark.parametrize(
    ("tool", "points"),
    [("Brush", [(-20, 0), (0, 0), (20, 5)]), ("Lasso", CIRCLE), ("Sphere", [(0, 0), (15, 0), (40, 0)])],
)
def test_each_tool_selects_by_a_drag_and_keys_erase_and_undo(window, watched, xdotool, tool, points):
    app = window.app
    if tool == "Brush":
        xdotool("mousemove", *place_of(window, BALL), "key", "x")
    else:
        press(watched, xdotool, f"{tool}##tool")
    wait(window, lambda: app.erasing.tool == tool.lower())
    goal = app.scene.rig.goal
    stroke(window, xdotool, points)
    found = selected(window)
    assert found > 20 and app.scene.rig.goal == goal
    xdotool("keydown", "ctrl")
    stroke(window, xdotool, points[: len(points) // 2 + 1])
    xdotool("keyup", "ctrl")
    assert selected(window) < found
    for keys, count in (("ctrl+z", found), ("ctrl+z", 0), ("ctrl+y", found)):
        xdotool("key", keys)
        wait(window, lambda count=count: selected(window) == count)
    xdotool("key", "Delete")
    wait(window, lambda: app.scene.edits.removed.count == found and selected(window) == 0)
    xdotool("key", "ctrl+z")
    wait(window, lambda: app.scene.edits.removed.count == 0 and selected(window) == found)
    stroke(window, xdotool, [(0, 0), (40, 10)], button=3)
    assert app.scene.rig.goal.azimuth != goal.azimuth and selected(window) == found
    xdotool("key", "Escape")
    wait(window, lambda: not app.erasing.tool)
    at_rest(window)
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_specks_are_selected_erased_and_a_smaller_pack_saved_and_opened(window, watched, xdotool, tmp_path):
    app = window.app
    before = app.scene.pack.occupied.sum()
    press(watched, xdotool, "All but the largest part")
    at_rest(window)
    assert selected(window) == 8
    press(watched, xdotool, "##clear")
    wait(window, lambda: selected(window) == 0)
    press(watched, xdotool, "##small")  # its slider follows the mouse: at a third of it, some hundred voxels
    at_rest(window)
    assert selected(window) == 8
    press(watched, xdotool, "##invert")
    wait(window, lambda: selected(window) > 1000)
    xdotool("key", "ctrl+z")
    wait(window, lambda: selected(window) == 8)
    press(watched, xdotool, f"{fa.ICON_FA_ERASER}  Erase")
    wait(window, lambda: app.scene.edits.removed.count == 8)
    press(watched, xdotool, "Save as…")
    type_path(window, xdotool, tmp_path / "clean")
    wait(window, lambda: app.scene.path == tmp_path / "clean" and app.loading is None)
    pump(window)
    left = load_pack(tmp_path / "clean")
    assert left.occupied.sum() == before - 1 and not dense_from_pack(left)[0][SPECK].any()
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"
