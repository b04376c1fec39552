"""Bare photographs and films on the window itself, by real drops, clicks and drags; see live_window.py.

What takes long is a stand-in: a reconstruction that is there already, and a training without end.
"""

import sys
import time
from pathlib import Path

import glfw
import numpy as np
import pytest

from tests.training.posing.conftest import COUNT, write_photographs
from tests.training.posing.test_films import frames_of_film, write_film
from tests.training.reconstructions import around, ball, write_colmap
from tests.viewer.window.living import at_start_page, live, opened_window, other_program, press, pump
from viewer.app.application import App
from viewer.core.pose import project
from viewer.features.crop import crop
from viewer.features.making.make_plan import Plan
from viewer.features.making.survey import BarePreview
from viewer.window.window import Window

SIZE = (1000, 700)
FAKE = Path(__file__).parents[1] / "features" / "making" / "fake_make.py"


@pytest.fixture(scope="module")
def opened(display):
    pytest.importorskip("pycolmap", reason="finding poses needs pycolmap (the extra poses)")
    with opened_window(display, SIZE) as opened:
        yield opened


@pytest.fixture
def window(opened):
    """The window with its start page."""
    with at_start_page(opened[0]) as window:
        yield window


@pytest.fixture
def drop(display, window):
    """Another program drops a path on the window, by XDND."""

    return lambda path: other_program(display, window, "drop", path)


def test_bare_photographs_that_are_dropped_are_shown_with_what_is_set_aside_and_the_time_it_takes(
    window, drop, xdotool, tmp_path
):
    pytest.importorskip("pycolmap", reason="finding poses needs pycolmap (the extra poses)")
    photographs = tmp_path / "attic"
    write_photographs(photographs)
    (photographs / "p0b.jpg").write_bytes((photographs / "p0.jpg").read_bytes())
    drop(photographs)
    preview = whole_preview(window)
    assert preview.count == COUNT + 1 and preview.aside == {"p0b.jpg": "the same as p0.jpg"}
    assert set(preview.seconds) == {"pictures", "features", "matches", "poses"} and preview.seconds["features"] > 0
    assert len(preview.boxes) == COUNT + 1 and not preview.error
    dialog = window.screenshot()
    assert blue_pixels(dialog) > 300  # of the photographs; nothing else there is blue
    assert window.app.making.plan.problem() is None
    xdotool("key", "Escape")
    pump(window)
    assert window.app.making.plan is None
    end = time.monotonic() + 10
    while not preview.finished and time.monotonic() < end:
        pump(window)
    assert preview.finished


def test_a_film_that_is_dropped_is_shown_by_some_of_its_frames(window, drop, xdotool, tmp_path):
    pytest.importorskip("pycolmap", reason="finding poses needs pycolmap (the extra poses)")
    pytest.importorskip("av", reason="films need PyAV (the extra video)")
    frames = frames_of_film(30)
    film = write_film(tmp_path / "walk.mp4", frames, [100 * i for i in range(30)])
    drop(film)
    preview = whole_preview(window)
    assert window.app.making.plan.survey.text.startswith("A film of") and preview.count == 17
    assert len(preview.boxes) > 8 and preview.seconds_in_all > 0 and not preview.error
    xdotool("key", "Escape")
    pump(window)
    assert window.app.making.plan is None


def whole_preview(window: Window) -> BarePreview:
    """What the question shows of bare photographs, once all of it is there."""
    end = time.monotonic() + 60
    while window.app.making.busy:
        assert time.monotonic() < end
        pump(window, 0.05)
    pump(window)
    return window.app.making.plan.survey.preview


def drawn_pixels(picture: np.ndarray, app: App) -> int:
    """How many pixels in the upper half of the viewport are other than its white background."""
    box = app.viewport
    seen = picture[round(box.y) : round(box.y + 0.5 * box.height), round(box.x) : round(box.x + box.width)]
    return int((seen.min(axis=-1) < 200).sum())


def blue_pixels(picture: np.ndarray) -> int:
    """How many pixels of uint8 [H, W, 3] are far more blue than anything else."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return int((blue > np.maximum(red, green) + 40).sum())


def test_points_and_cameras_are_shown_and_a_face_of_the_box_is_dragged_before_training(
    opened, window, drop, xdotool, tmp_path, monkeypatch
):
    photographs = tmp_path / "attic"
    write_photographs(photographs)
    found = write_colmap(tmp_path / "found", around(), ball(radius=1.0))
    command, real = Plan.command, []

    def stand_in(plan: Plan) -> list[str]:
        real.append(command(plan))
        copy = f"import shutil; shutil.copytree({str(found)!r}, {str(plan.posed)!r})"
        return [sys.executable, "-c", copy] if plan.poses_only else [sys.executable, str(FAKE), "wait", str(tmp_path)]

    monkeypatch.setattr(Plan, "command", stand_in)
    drop(photographs)
    live(window, lambda: not window.app.making.busy)  # the question has its last size
    app = window.app
    press(opened, xdotool, "Make it")
    assert app.making.plan is None
    live(window, lambda: app.making.review is not None)
    assert "--poses-only" in real[0] and app.making.sparse_preview_shown(app)
    live(window, lambda: len(app.gallery.thumbnails.boxes) == 10)  # the photographs in their frusta
    assert drawn_pixels(window.screenshot(), app) > 500
    box = app.viewport
    left, top = glfw.get_window_pos(window.handle)
    start = app.scene.rig.goal
    x, y = left + round(box.x + 0.5 * box.width), top + round(box.y + 0.2 * box.height)
    xdotool("mousemove", x, y, "mousedown", 1)
    pump(window)
    xdotool("mousemove", x + 60, y + 10)
    pump(window)
    xdotool("mouseup", 1)
    pump(window)
    assert app.scene.rig.goal.azimuth != start.azimuth
    assert app.making.review.kind == "subject"
    press(opened, xdotool, "##box")
    live(window, lambda: app.settings.crop is not None and app.scene.rig.shown == app.scene.rig.goal)
    before = app.settings.crop
    handle, _ = project(app.camera(), crop.face_centre(before, 3)[None])  # the upper face
    x, y = (float(v) / app.viewport.pixels_per_unit for v in np.asarray(handle).reshape(-1)[:2])
    x, y = left + round(app.viewport.x + x), top + round(app.viewport.y + y)
    xdotool("mousemove", x, y)
    pump(window)
    xdotool("mousedown", 1)
    pump(window)
    xdotool("mousemove", x, y + 40)
    pump(window)
    xdotool("mouseup", 1)
    pump(window)
    assert app.settings.crop[1][1] < before[1][1] and app.settings.crop[0] == before[0]
    assert app.making.review.seconds_left is None  # somebody is there
    press(opened, xdotool, "Train it")
    live(window, lambda: app.making.job is not None and app.making.job.report is not None)
    words = real[-1]
    top_of_box = float(words[words.index("--aabb") + 1].split(",")[-1])
    assert abs(top_of_box - app.making.job.plan.aabb[5]) < 1e-3 and app.settings.crop is None
    assert app.making.sparse_preview_shown(app)  # while the field trains
