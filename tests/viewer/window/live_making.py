"""What is being made, on the window itself, by real clicks and drags: the ground that is level, and what is trained so far.

See live_window.py. What takes long is a stand-in: a reconstruction that is there already, and a training without end.
"""

import sys
from dataclasses import replace
from pathlib import Path

import glfw
import numpy as np
import pytest

from scenepack import save_pack
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.window.living import at_start_page, live, opened_window, press, pump
from viewer.core.pose import project
from viewer.features.making.make_plan import Plan
from viewer.features.making.review import Review
from viewer.window.window import Window

SIZE = (1000, 760)
FAKE = Path(__file__).parents[1] / "features" / "making" / "fake_make.py"


@pytest.fixture(scope="module")
def opened(display):
    with opened_window(display, SIZE) as opened:
        yield opened


@pytest.fixture
def window(opened):
    """The window with its start page."""
    with at_start_page(opened[0]) as window:
        yield window


def drag(window: Window, xdotool, dx: int, dy: int) -> None:
    """Turns the camera by the left button, from the middle of the picture's upper half."""
    box = window.app.viewport
    left, top = glfw.get_window_pos(window.handle)
    x, y = left + round(box.x + 0.6 * box.width), top + round(box.y + 0.25 * box.height)
    xdotool("mousemove", x, y, "mousedown", 1)
    pump(window)
    xdotool("mousemove", x + dx, y + dy)
    pump(window)
    xdotool("mouseup", 1)
    pump(window)


def test_a_click_on_the_ground_sets_up(opened, window, xdotool, tmp_path):
    pytest.importorskip("pycolmap", reason="the reconstruction is written by pycolmap (the extra poses)")
    from tests.training.reconstructions import around, write_colmap
    from tests.viewer.features.making.test_review import look_at, tilted_ground
    from viewer.features.making.sparse_preview import normal_at

    app, folder = window.app, write_colmap(tmp_path / "scene", around(), tilted_ground())
    app.making.sparse_preview = look_at(folder)
    review = app.making.review = Review(Plan("scene", folder, tmp_path / "out"), app.making.sparse_preview)
    app.making.show_points(app)
    pump(window)

    def leaning() -> float:
        """Degrees between the ground and what is level."""
        places = app.making.sparse_preview.points.places
        normal = normal_at(places, int(np.argmin(np.linalg.norm(places, axis=-1))), app.making.sparse_preview.eyes())
        return float(np.degrees(np.arccos(min(normal[2], 1.0))))

    def click_on_ground() -> None:
        """Clicks on a point of the ground that no card covers."""
        scale, box = app.viewport.pixels_per_unit, app.viewport
        pixels, before = project(app.camera(), app.making.sparse_preview.places_in_grid())
        seen = pixels[before] / scale
        free = seen[
            (seen[:, 0] > 0.55 * box.width) & (seen[:, 0] < box.width - 60) & (abs(seen[:, 1] - 0.5 * box.height) < 150)
        ]
        at = free[np.argmin(np.linalg.norm(free - np.median(free, axis=0), axis=-1))]
        left, top = glfw.get_window_pos(window.handle)
        xdotool("mousemove", left + round(box.x + at[0]), top + round(box.y + at[1]), "click", 1)
        pump(window)

    assert leaning() > 15
    click_on_ground()
    assert app.making.review is review, "as long as nobody asks for it, a click is the camera's"
    press(opened, xdotool, "##up")
    assert review.picking and review.seconds_left is None
    click_on_ground()
    live(window, lambda: app.making.review is not None and app.making.review is not review)
    assert leaning() < 3 and app.making.sparse_preview_shown(app) and app.making.review.plan.up is not None
    press(opened, xdotool, "As it was")
    live(window, lambda: app.making.review is not None and app.making.review.plan.up is None)
    assert leaning() > 15


def test_what_is_trained_so_far_is_flown_through_while_it_is_exchanged(opened, window, xdotool, tmp_path, monkeypatch):
    monkeypatch.setattr(Plan, "command", lambda plan: [sys.executable, str(FAKE), "wait", str(tmp_path)])
    app = window.app

    def write(steps: int, brightness: float) -> None:
        pack = shapes_pack()
        rgba = pack.atlas_rgba.copy()
        rgba[..., :3] = np.round(brightness * rgba[..., :3])
        made = {"steps": steps, "of_steps": 6000, "preview": True}
        save_pack(replace(pack, atlas_rgba=rgba).with_metadata(provenance=made), tmp_path / "preview.zip")

    app.making.plan = Plan("scene", tmp_path / "photographs", tmp_path)
    app.making.start(app)
    write(1200, 1.0)
    live(window, lambda: app.scene is not None and not app.canvas.pending)
    assert "preview after 1,200 steps" in window._title
    first = window.screenshot()
    start = app.scene.rig.goal
    drag(window, xdotool, 120, 20)
    chosen = app.scene.rig.goal
    assert chosen != start
    live(window, lambda: app.scene.rig.shown == chosen and not app.canvas.pending)
    before = window.screenshot()
    assert (before != first).any()
    blank = []
    write(2400, 0.4)

    def exchanged() -> bool:
        shown = window.screenshot()
        box = app.viewport
        part = shown[round(box.y) : round(box.y + 0.5 * box.height), round(box.x) : round(box.x + box.width)]
        blank.append((part.min(axis=-1) < 200).mean())
        return app.making.training_preview.steps == 2400 and not app.canvas.pending

    live(window, exchanged)
    assert min(blank) > 0.5 * blank[0] > 0, "something is to be seen all the time"
    assert "preview after 2,400 steps" in window._title
    assert app.scene.rig.goal == app.scene.rig.shown == chosen
    assert window.screenshot().mean() < before.mean() - 1, "and it is the newer one"
    drag(window, xdotool, -60, 0)
    assert app.scene.rig.goal != chosen, "the hands go on"
