"""Pictures and the scene taken away from the window, under real events. Not collected by itself; see live_window.py."""

from __future__ import annotations

import json
from pathlib import Path

import glfw
import numpy as np
import pytest
from PIL import Image

from tests.viewer.window.live_marks import press, wait
from tests.viewer.window.live_window import opened, other_client, pump, window
from tests.viewer.window.widgets_seen import watch
from viewer.window.window import Window

__all__ = ["opened", "other_client", "window"]  # fixtures
OpenEXR = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed: pip install 'snerg[export]'")
trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: the extra dev")
LARGE = (1240, 860)


def type_path(window: Window, xdotool, path: Path) -> None:
    """Types a path into the dialog that asks for one."""
    wait(window, lambda: window.app.file_request is not None)
    pump(window)
    xdotool("key", "ctrl+a", "type", "--delay", 1, str(path))
    pump(window)
    xdotool("key", "Return")
    wait(window, lambda: window.app.file_request is None)


@pytest.fixture
def film_page(window):
    window.ui.file_dialogs.native = False
    glfw.set_window_size(window.handle, *LARGE)
    wait(window, lambda: glfw.get_window_size(window.handle) == LARGE)
    window.app.interface.page = "film"
    window.app.filming.size = (96, 64)
    pump(window)
    return window


def test_a_view_is_saved_in_several_modes_and_as_exr(film_page, xdotool, tmp_path):
    window, app = film_page, film_page.app
    for name in ("##transparent", "##depth", "##normals"):
        press(window, xdotool, name)
        pump(window)
    assert app.filming.transparent and set(app.filming.besides) == {"depth", "normals"}
    press(window, xdotool, "Save this view…")
    type_path(window, xdotool, tmp_path / "view.png")
    wait(window, lambda: app.filming.export is None and len(list(tmp_path.glob("*.png"))) == 3)
    assert {path.name for path in tmp_path.iterdir()} == {"view_rgb.png", "view_depth.png", "view_normals.png"}
    picture = Image.open(tmp_path / "view_rgb.png")
    assert picture.mode == "RGBA" and picture.size == (96, 64)
    assert picture.getpixel((0, 0)) == (0, 0, 0, 0) and np.asarray(picture)[..., 3].max() == 255
    xdotool("key", "ctrl+s")
    type_path(window, xdotool, tmp_path / "view.exr")
    wait(window, (tmp_path / "view.exr").exists)
    file = OpenEXR.File(str(tmp_path / "view.exr"), separate_channels=True)
    assert set(file.channels()) == {"R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z"}
    depth = file.channels()["Z"].pixels
    radius = app.scene.rig.goal.distance
    assert 0.3 * radius < np.median(depth[depth > 0]) < 1.5 * radius
    assert json.loads(file.header()["snerg"])["fx"] > 0
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_another_program_pastes_the_picture_that_was_copied(window, xdotool, other_client, tmp_path):
    app = window.app
    for mode in ("normal", "diffuse"):  # the second takes the place of the first
        app.set(mode=mode)
        pump(window)
        xdotool("key", "ctrl+i")
        wait(window, lambda: app.messages.lines[-1].text == "The picture is on the clipboard")
        app.messages.log("pasted")
        other_client("paste", tmp_path / "pasted.png")
        pasted = np.asarray(Image.open(tmp_path / "pasted.png").convert("RGB"))
        assert np.array_equal(pasted, window.canvas.snapshot(app.camera(), app.settings))
    assert not app.messages.dialogs


def test_the_scene_is_exported_within_the_crop_box_and_can_be_cancelled(film_page, xdotool, tmp_path):
    window, app = film_page, film_page.app
    app.set(crop=((-1.0, -1.0, -1.0), (1.0, -0.5, 1.0)))  # the plate
    xdotool("key", "ctrl+e")
    wait(window, lambda: app.exporting.asking)
    press(window, xdotool, "Points##kind")
    wait(window, lambda: app.exporting.plan.kind == "points")
    press(window, xdotool, "Sparse##spacing")
    wait(window, lambda: app.exporting.plan.spacing == "Sparse")
    press(window, xdotool, "Export…")
    type_path(window, xdotool, tmp_path / "plate.ply")
    goal = app.scene.rig.goal
    assert app.exporting.writing is not None
    xdotool("key", "2")  # the window lives on meanwhile
    wait(window, lambda: app.scene.rig.goal != goal)
    wait(window, lambda: app.exporting.writing is None)
    assert not app.messages.dialogs
    cloud = trimesh.load(tmp_path / "plate.ply")
    assert len(cloud.vertices) > 50 and cloud.bounds[1, 1] <= -0.5 + 2 / 44
    assert np.ptp(cloud.vertices[:, 0]) > 1.5

    xdotool("key", "ctrl+e")
    wait(window, lambda: app.exporting.asking)
    press(window, xdotool, "Mesh##kind")
    pump(window)
    xdotool("key", "Return")
    type_path(window, xdotool, tmp_path / "mesh.glb")
    press(window, xdotool, "Cancel##export")
    wait(window, lambda: app.exporting.writing is None)
    assert {path.name for path in tmp_path.iterdir()} <= {"plate.ply", "mesh.glb"}
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_escape_closes_the_question(film_page, xdotool):
    window, app = film_page, film_page.app
    xdotool("key", "ctrl+e")
    wait(window, lambda: app.exporting.asking)
    with watch() as seen:
        wait(window, lambda: any(label == "Export…" for _, label in seen.seen))
    xdotool("key", "Escape")
    wait(window, lambda: not app.exporting.asking)
