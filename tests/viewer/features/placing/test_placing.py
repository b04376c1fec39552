"""The Move page: clicks level the ground and set the origin, and everything that names a place follows."""

import json
from dataclasses import replace
from math import degrees
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from scenepack import load_pack, save_pack
from scenepack.placement import NOT_MOVED, placed_T_grid
from tests.scenepack.helpers import written
from tests.scenepack.test_placement import AT, SLOPE, UP, sloping_pack
from tests.viewer.commands.test_commands import picture, rendered
from tests.viewer.conftest import toy_pack
from viewer.app.application import App
from viewer.core.annotations import Scale
from viewer.core.pose import Pose
from viewer.features.bookmarks.bookmarks import bookmark_of
from viewer.features.placing import placing
from viewer.rendering.camera import filling_orbit
from viewer.web.description import PageContent, describe


@pytest.fixture
def slope(tmp_path: Path) -> Path:
    return written(tmp_path / "slope", sloping_pack())


@pytest.fixture
def ui(offscreen, app: App, slope: Path):
    app.annotations.folder = slope.parent / "user"
    ui = offscreen(app, load_pack(slope), slope, size=(1280, 800))
    rig = app.open_scene.rig
    rig.goal = rig.shown = Pose((0.0, -0.4, 0.2), 20.0, 40.0, 3.5)
    app.interface.page = placing.PAGE
    ui.settle()
    return ui


def on_slope(x: float, z: float) -> np.ndarray:
    return AT + np.array([x, SLOPE * x, z])


def steepness(app: App) -> float:
    """Degrees between the slope and what is up."""
    return degrees(np.arccos(np.clip(app.annotations.current.placement.up @ UP, -1, 1)))


def test_clicks_level_the_ground_set_the_origin_and_the_scale_and_undo_takes_each_back(ui, app) -> None:
    eye, before = app.scene.rig.matrix[:3, 3].copy(), steepness(app)
    ui.press("By three points")
    for x, z in ((-0.5, 0.7), (0.7, 0.6), (-0.2, -0.3)):
        ui.click(*ui.place_of(on_slope(x, z)))
    assert before > 10 and steepness(app) < 1.0 and app.measure_tool.tool == ""
    rig, levelled = app.scene.rig, app.annotations.current
    assert np.allclose(rig.matrix[:3, 3], eye) and abs(rig.matrix[:3, 0] @ levelled.placement.up) < 1e-9
    words = app.measure_tool.length_format(app)
    assert abs(words.placed(on_slope(0.4, 0.5))[1]) < 0.05  # its height
    ui.press("By a point")
    ui.click(*ui.place_of(on_slope(0.4, 0.5)))
    assert np.allclose(app.annotations.current.placement.origin, on_slope(0.4, 0.5), atol=0.04)
    origin = app.annotations.current
    ui.press("Set by two points")
    for x in (-0.4, 0.6):
        ui.click(*ui.place_of(on_slope(x, 0.5)))
    ui.frames(2)
    ui.io.add_input_characters_utf8("2")
    ui.frame()
    ui.press("Set the scale")
    scale = app.annotations.current.scale
    assert scale.unit == "m" and scale.factor == pytest.approx(2.0 / np.hypot(1.0, SLOPE), rel=0.05)
    assert app.measure_tool.tool == ""  # the ruler is of another page
    steps = [app.annotations.current]
    while app.scene.rig.history.undo():
        assert app.scene.rig.table.placed == app.annotations.current.placement.rotation
        if app.annotations.current != steps[-1]:
            steps.append(app.annotations.current)
    assert steps[1:] == [origin, levelled, steps[-1]] and steps[-1].placement == NOT_MOVED
    while app.scene.rig.history.redo():
        pass
    assert app.annotations.current == steps[0]


def test_the_ground_is_found_and_a_line_of_points_is_no_ground(ui, app) -> None:
    app.run("move-find-ground")
    assert steepness(app) < 0.5 and not app.messages.dialogs
    assert abs(app.measure_tool.length_format(app).placed(AT)[1]) < app.scene.pack.voxel_size  # its height
    app.run("move-reset")
    app.run("move-ground")
    for x in (-0.5, 0.0, 0.5):
        ui.click(*ui.place_of(on_slope(x, 0.8)))
    assert app.annotations.current.placement == NOT_MOVED and "line" in app.messages.toast
    assert app.measure_tool.tool == "ground"  # for another try
    ui.key(imgui.Key.escape)
    assert app.measure_tool.tool == ""


def test_a_slider_turns_the_scene_in_one_step(ui, app) -> None:
    (slider,) = ui.widgets("##Turn")
    x, y = slider.at
    ui.drag([(x, y), (x + 20, y), (x + 40, y)])
    turn = app.annotations.current.placement.angles[0]
    assert turn != 0 and app.scene.rig.table.placed == app.annotations.current.placement.rotation
    app.run("undo")
    assert app.annotations.current.placement == NOT_MOVED


def placed(app: App) -> None:
    """Levels the scene, with an origin and a scale."""
    placement = replace(NOT_MOVED.levelled(UP, AT), origin=(0.1, -0.4, 0.2))
    placing.change(app, placement)
    app.annotations.change(app, replace(app.annotations.current, scale=Scale(2.5, "m")))


def test_views_poses_and_bookmarks_are_of_the_placed_frame(ui, app) -> None:
    placed(app)
    rig = app.scene.rig
    for command, axis in (("top", 1), ("front", 2), ("right", 0)):
        app.run(command)
        rig.shown = rig.goal
        assert np.allclose(rig.matrix[:3, 2], app.annotations.current.placement.rotation[axis], atol=1e-6), command
    before, rig.fov = rig.matrix.copy(), 41.5
    rig.set_orthographic(True)
    height = rig.ortho_height
    app.run("copy-pose")
    values = json.loads(app.clipboard.text)
    assert set(values) == {"eye", "target", "up", "fov", "ortho_height"}
    assert np.allclose(values["eye"], (app.annotations.current.placed_T_grid @ [*before[:3, 3], 1.0])[:3], atol=1e-5)
    view = bookmark_of(rig, "right")
    app.run("home")
    rig.shown = rig.goal
    assert not np.allclose(rig.matrix, before) and not rig.orthographic
    app.paste()
    assert np.allclose(rig.matrix, before, atol=1e-5) and rig.fov == 41.5 and rig.ortho_height == pytest.approx(height)
    assert view.up == "y" and np.allclose(view.eye, before[:3, 3])


def test_the_pack_keeps_it_and_pages_and_pictures_follow(ui, app, slope, tmp_path) -> None:
    untouched = load_pack(slope)
    placed(app)
    app.annotations.save_now()
    pack = load_pack(slope)
    moved = app.annotations.current.placed_T_grid
    assert np.allclose(placed_T_grid(pack), moved)
    again = App()
    again.show(pack, slope)
    rig = again.open_scene.rig
    assert np.allclose(rig.table.axes[1], UP) and rig.goal == rig.home_pose
    # snerg-render: the same picture from the same place, named in either frame, level in each
    eye, target = np.array([1.5, 1.2, 2.0]), np.array([0.0, -0.3, 0.0])
    up = np.linalg.inv(moved[:3, :3]) @ [0.0, 1.0, 0.0]
    save_pack(untouched, tmp_path / "untouched")
    pictures = []
    for folder, frame in ((slope, moved), (tmp_path / "untouched", np.eye(4))):
        numbers = [",".join(map(str, (frame @ [*point, 1.0])[:3])) for point in (eye, target)]
        upwards = () if folder == slope else ("--up", ",".join(map(str, up)))
        words = ["--eye", numbers[0], "--target", numbers[1], *upwards, "--size", "80x60"]
        pictures.append(picture(rendered(folder, tmp_path / "view.png", *words)).astype(int))
    assert np.abs(pictures[0] - pictures[1]).max() <= 2 and pictures[0].std() > 20
    for camera in filling_orbit(pack, 5, 40.0, (60, 40)):
        assert abs(camera.grid_T_camera[:3, 0] @ UP) < 1e-9 and camera.grid_T_camera[:3, 2] @ UP == pytest.approx(0.5)
    page, _ = describe(pack, PageContent("slope", pose=app.pose_text()), lambda share: None)
    assert np.allclose(page["camera"]["home"]["axes"][1], UP)
    ahead = np.array(page["camera"]["home"]["pivot"]) - app.scene.rig.matrix[:3, 3]
    assert np.allclose(ahead / np.linalg.norm(ahead), -app.scene.rig.matrix[:3, 2], atol=1e-4)


def test_a_forward_facing_scene_has_an_origin_and_is_not_turned(offscreen, app) -> None:
    app.interface.page = placing.PAGE
    ui = offscreen(app, toy_pack(ndc=True), size=(1280, 800))
    assert ui.widgets("By a point") and not ui.widgets("By three points")
    app.run("move-find-ground")
    assert app.annotations.current.placement == NOT_MOVED and app.messages.dialogs
