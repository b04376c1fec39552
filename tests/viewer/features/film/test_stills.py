"""Stills that the window saves: depth of field, layers, panoramas and changed colours."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image

from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.rendering.test_depth_of_field import CAMERA, FAR_BAR, bars, edge_widths
from tests.viewer.waiting import live, there
from viewer.app.application import App
from viewer.core.pose import Pose
from viewer.features.film.filming import Filming


def saved(ui: OffscreenUi, path: Path) -> Path:
    """The path of a still, once Ctrl+S and the path that is typed have made it."""
    ui.key(imgui.Key.mod_ctrl, imgui.Key.s)
    ui.settle()
    ui.key(imgui.Key.mod_ctrl, imgui.Key.a)
    ui.io.add_input_characters_utf8(str(path))
    ui.frame()
    ui.key(imgui.Key.enter)
    assert ui.app.file_request is None
    live(ui.app, lambda: ui.app.filming.export is None)
    assert not ui.app.messages.dialogs, ui.app.messages.dialogs
    return path


def test_a_still_is_blurred_and_a_click_chooses_the_focus(offscreen, app: App, tmp_path: Path) -> None:
    ui = offscreen(app, bars(), Path("bars"), size=(1000, 700))
    rig, filming = app.open_scene.rig, app.filming
    rig.goal = rig.shown = Pose((-0.3, 0.0, 0.0), 0.0, 0.0, 3.0)
    rig.fov = 40.0
    app.interface.page = "film"
    ui.settle()
    filming.size, filming.aperture, filming.lens_rays = (240, 120), 0.3, 32

    def widths(name: str) -> tuple[float, float]:
        return edge_widths(np.asarray(Image.open(saved(ui, tmp_path / name)))[60, :, 0] / 255.0)

    middle = widths("middle.png")
    filming.focusing = True
    x, y = app.viewport.x + app.viewport.width / 2, app.viewport.y + app.viewport.height / 2
    ui.click(x + 0.7 * CAMERA.fx * app.viewport.height / 120 / (3.0 - FAR_BAR), y)  # the far bar
    assert not filming.focusing and filming.focus is not None and abs(filming.focus[2] - FAR_BAR) < 0.1
    far = widths("far.png")
    assert middle[0] < far[0] - 3 and far[1] < middle[1] - 3
    rig.set_orthographic(True)
    with pytest.raises(Exception, match="perspective"):
        filming.still(app, tmp_path / "flat.png")
    assert not Filming(focus=(0.0, 0.0, 0.0)).of_another_scene().focus


@pytest.fixture
def ui(offscreen: Callable[..., OffscreenUi], app: App, pack, pack_folder: Path) -> OffscreenUi:
    app.filming.size = (96, 64)
    return offscreen(app, pack, pack_folder, size=(1000, 800))


def test_a_view_is_saved_in_several_modes_without_background_and_as_exr(ui: OffscreenUi, app: App, tmp_path: Path):
    app.filming.transparent, app.filming.besides = True, ("depth", "normals")
    saved(ui, tmp_path / "view.png")
    assert {path.name for path in tmp_path.iterdir()} == {"view_rgb.png", "view_depth.png", "view_normals.png"}
    picture = Image.open(tmp_path / "view_rgb.png")
    assert picture.mode == "RGBA" and picture.size == (96, 64)
    assert picture.getpixel((0, 0)) == (0, 0, 0, 0) and np.asarray(picture)[..., 3].max() == 255
    exr = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed: pip install 'snerg[dev]'")
    file = exr.File(str(saved(ui, tmp_path / "view.exr")), separate_channels=True)
    assert set(file.channels()) == {"R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z"}
    depth = file.channels()["Z"].pixels
    assert 0.3 < np.median(depth[depth > 0]) / app.open_scene.rig.goal.distance < 1.5


def test_a_view_is_saved_as_a_360_picture(ui: OffscreenUi, app: App, tmp_path: Path) -> None:
    app.interface.page = "film"
    ui.settle()
    ui.press("##panorama")
    assert app.filming.size == (4096, 2048)
    app.filming.set_size(128, 2048)
    around = app.open_scene.rig.camera((128, 64)).as_panorama((128, 64))
    picture = np.asarray(Image.open(saved(ui, tmp_path / "around.png")))
    assert np.array_equal(picture, ui.canvas.snapshot(around, app.settings))
    ui.press("##panorama")
    assert app.filming.size == (1920, 1080)


def test_colours_are_changed_in_one_step_and_saved_pictures_have_them(ui: OffscreenUi, app: App, tmp_path: Path):
    before = np.asarray(Image.open(saved(ui, tmp_path / "before.png"))).astype(int)
    (slider,) = ui.widgets("##exposure")
    (x, y), right = slider.at, slider.rect[2]
    ui.drag([(x, y), (0.5 * (x + right), y), (right - 9, y)])
    look = there(app.annotations.current.look)
    assert look.exposure > 0.5 and app.settings.look is None
    assert np.asarray(Image.open(saved(ui, tmp_path / "bright.png"))).mean() > before.mean() + 1
    app.run("undo")
    assert app.annotations.current.look is None
    app.run("redo")
    assert app.annotations.current.look == look
    ui.press("Colours as they are")
    assert app.annotations.current.look is None
