"""Measuring, bookmarks and sessions in the window, on a display of our own, under real events. Not collected by itself."""

from __future__ import annotations

import time
from collections.abc import Callable

import glfw
import numpy as np

from tests.viewer.window.live_window import opened, pump, window
from tests.viewer.window.running import PATIENCE_S
from tests.viewer.window.widgets_seen import watch
from viewer.core.pose import project
from viewer.window.window import Window

__all__ = ["opened", "window"]  # fixtures


def wait(window: Window, condition: Callable[[], object]) -> None:
    """Lets the window live until `condition`."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it does not come about"
        pump(window, 0.05)


def place_of(window: Window, point: tuple[float, float, float]) -> tuple[int, int]:
    """Where a point of the scene is on the screen."""
    app = window.app
    left, top = glfw.get_window_pos(window.handle)
    x, y = project(app.camera(), np.array([point]))[0][0]
    return round(left + app.viewport.x + x), round(top + app.viewport.y + y)


def test_m_measures_between_clicks_and_the_result_is_on_the_clipboard(window, xdotool):
    app = window.app
    xdotool("mousemove", *place_of(window, (0.0, -0.25, 0.0)), "key", "m")
    wait(window, lambda: app.measure_tool.tool == "line" and app.interface.page == "measure")
    app.scene.rig.frame()
    app.scene.rig.shown = app.scene.rig.goal
    wait(window, lambda: app.measure_tool.cursor is not None)  # the ball
    for i, point in enumerate(((-0.15, -0.25, 0.0), (0.2, -0.1, 0.0), (0.0, -0.45, 0.0)), 1):
        xdotool("mousemove", *place_of(window, point), "click", 1)
        wait(window, lambda i=i: len(app.measure_tool.draft) == i)
    xdotool("key", "BackSpace")
    wait(window, lambda: len(app.measure_tool.draft) == 2)
    xdotool("key", "Return")
    wait(window, lambda: len(app.annotations.current.measurements) == 1)
    xdotool("key", "ctrl+shift+c")
    wait(window, lambda: app.clipboard.get().startswith("line 1: 0."))
    before = app.annotations.current.measurements[0].points[0]
    goal = app.scene.rig.goal
    xdotool("mousemove", *place_of(window, before), "mousedown", 1)
    pump(window)
    xdotool("mousemove_relative", 0, 25)
    pump(window)
    xdotool("mouseup", 1)
    wait(window, lambda: app.annotations.current.measurements[0].points[0] != before)
    assert app.scene.rig.goal == goal
    xdotool("key", "Escape", "key", "ctrl+z")
    wait(window, lambda: not app.measure_tool.tool and app.annotations.current.measurements[0].points[0] == before)
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def press(window: Window, xdotool: Callable[..., None], ending: str) -> None:
    """Clicks the button whose label ends so."""
    with watch() as seen:
        places: list[tuple[float, float]] = []

        def rests() -> bool:
            places.extend(each.at for (_, label), each in seen.seen.items() if label.endswith(ending))
            return len(places) > 2 and places[-1] == places[-2] == places[-3]

        wait(window, rests)
        at = places[-1]
    left, top = glfw.get_window_pos(window.handle)
    xdotool("mousemove", left + round(at[0]), top + round(at[1]), "click", 1)


def test_a_scale_is_typed_after_two_clicks(window, xdotool):
    app = window.app
    app.interface.page = "measure"
    press(window, xdotool, "Set by two points")
    wait(window, lambda: app.measure_tool.tool == "scale")
    for i, point in enumerate(((-0.15, -0.25, 0.0), (0.2, -0.1, 0.0)), 1):
        xdotool("mousemove", *place_of(window, point), "click", 1)
        wait(window, lambda i=i: len(app.measure_tool.draft) == i)
    press(window, xdotool, "##known")
    pump(window)
    xdotool("key", "ctrl+a", "type", "2.5")
    pump(window)
    xdotool("key", "Return")
    wait(window, lambda: app.annotations.current.scale.unit == "m")
    between = np.linalg.norm(np.subtract((-0.15, -0.25), (0.2, -0.1)))
    assert 2.0 < app.annotations.current.scale.factor * between < 3.0


def test_views_are_bookmarked_named_stepped_through_and_filmed(window, xdotool):
    app = window.app
    xdotool("mousemove", 200, 300, "key", "ctrl+d")
    wait(window, lambda: len(app.annotations.current.bookmarks) == 1)
    first = app.scene.rig.goal
    xdotool("key", "2")
    wait(window, lambda: app.scene.rig.goal != first and app.scene.rig.shown == app.scene.rig.goal)
    second = app.scene.rig.goal
    xdotool("key", "ctrl+d")
    wait(window, lambda: len(app.annotations.current.bookmarks) == 2)
    xdotool("key", "Next")  # page down
    wait(
        window,
        lambda: app.bookmarks.selected == 0 and np.isclose(app.scene.rig.goal.azimuth % 360, first.azimuth % 360),
    )
    xdotool("key", "Prior")
    wait(
        window,
        lambda: app.bookmarks.selected == 1 and np.isclose(app.scene.rig.goal.azimuth % 360, second.azimuth % 360),
    )
    app.interface.page = "bookmarks"
    press(window, xdotool, "##name")
    pump(window)
    xdotool("key", "ctrl+a", "type", "--delay", 20, "The post")
    pump(window)
    xdotool("key", "Return")
    wait(window, lambda: app.annotations.current.bookmarks[1].name == "The post")
    press(window, xdotool, "##bookmark0")
    wait(window, lambda: app.bookmarks.selected == 0)
    press(window, xdotool, "##down")
    wait(window, lambda: app.annotations.current.bookmarks[0].name == "The post")
    press(window, xdotool, "Film through the bookmarks")
    wait(window, lambda: len(app.filming.path.keyframes) == 2 and app.interface.page == "film")
    xdotool("mousemove", 200, 300, "key", "ctrl+z")
    wait(window, lambda: app.annotations.current.bookmarks[1].name == "The post")
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_a_session_is_saved_and_opened_again(window, xdotool, tmp_path):
    app = window.app
    window.ui.file_dialogs.native = False
    file = tmp_path / "here.snerg"
    xdotool("mousemove", 200, 300, "key", "3")
    wait(window, lambda: app.scene.rig.shown == app.scene.rig.goal and app.scene.rig.goal.elevation > 80)
    seen = app.scene.rig.matrix.copy()
    xdotool("key", "ctrl+d", "key", "ctrl+shift+s")
    wait(window, lambda: app.file_request is not None)
    pump(window)
    xdotool("key", "ctrl+a", "type", "--delay", 20, str(file))
    pump(window)
    xdotool("key", "Return")
    wait(window, file.exists)
    assert not app.messages.dialogs
    again = type(app)(canvas=window.canvas)
    again.clipboard, window.app = app.clipboard, again
    window.canvas.show(None)
    xdotool("mousemove", 200, 300, "key", "ctrl+o")
    wait(window, lambda: again.open_prompt is not None)
    pump(window)
    xdotool("type", "--delay", 20, str(file))
    pump(window)
    xdotool("key", "Return")
    wait(window, lambda: again.scene is not None and again.scene.whole and again.loading is None)
    assert np.allclose(again.scene.rig.matrix, seen, atol=1e-6)
    assert [view.name for view in again.annotations.current.bookmarks] == ["View 1"]
    assert not again.messages.dialogs and window.ctx.error == "GL_NO_ERROR"
