"""Walking in the toy: a ball and a post on a plate, in the box of -1 … 1."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from scenepack.placement import Placement
from tests.viewer.conftest import toy_pack
from tests.viewer.features.camera.test_orbit_camera import seen_from
from viewer.app.application import App
from viewer.core.annotations import Scale
from viewer.features.camera.orbit_camera import DEFAULT_FOV, WALKING_FOV, OrbitCamera
from viewer.features.camera.walking import SCENE_M, USUAL_M, metre_of
from viewer.features.crop import crop
from viewer.features.photographs.photographs import shots_of
from viewer.features.placing import placing
from viewer.features.preferences.preferences import apply_preferences, current_preferences

PLATE = -0.65  # its upper side


@pytest.fixture
def walker(app: App) -> App:
    """On foot in the toy, with eyes 0.2 above the ground."""
    app.show(toy_pack(), Path("toy"))
    app.walking.eye_height_m = 0.2 / metre_of(app.open_scene.pack, app.open_scene.rig, Scale())
    app.run("walk")
    settle(app)
    return app


def settle(app: App, seconds: float = 2.0, ahead: float = 0.0) -> None:
    for _ in range(round(30 * seconds)):
        if ahead:
            app.open_scene.rig.fly(0.0, 0.0, ahead, 1 / 30)
        app.tick(1 / 30)


def eye(app: App) -> np.ndarray:
    return app.open_scene.rig.goal.eye(app.open_scene.rig.table)


def put(app: App, x: float, z: float, y: float = PLATE + 0.2, azimuth: float = 0.0) -> None:
    """At azimuth 0 it looks towards -z."""
    app.open_scene.rig.stand_at(np.array([x, y, z]), replace(app.open_scene.rig.goal, azimuth=azimuth, elevation=0.0))
    app.open_scene.rig.shown = app.open_scene.rig.goal


def test_from_outside_the_walk_begins_before_what_is_seen_and_level(walker):
    rig = walker.scene.rig
    assert rig.walking and rig.goal.elevation == 0 and rig.fov == WALKING_FOV
    x, y, z = eye(walker)  # in the middle of the first view is the ball's upper half
    assert 0.4 < np.hypot(x, z) < 0.83 and y == pytest.approx(PLATE + 0.2, abs=0.03)
    walker.frames_owed = 0
    settle(walker, 0.2)
    assert not walker.wants_frame  # who stands still costs nothing


def test_keys_walk_up_to_the_ball_and_jump_and_the_mouse_looks_around(offscreen, walker):
    walker.resolution.rest_scale = 0.1
    ui = offscreen(walker, size=(480, 360))
    put(walker, 0.0, 0.7)

    def hold(key: imgui.Key, seconds: float) -> float:
        """The highest that the eye was while a key was held."""
        ui.hold(key)
        heights = [(ui.frame(1 / 30), eye(walker)[1])[1] for _ in range(round(30 * seconds))]
        ui.let_go(key)
        return max(heights)

    assert hold(imgui.Key.e, 0.4) > PLATE + 0.25
    settle(walker)
    hold(imgui.Key.w, 2.0)
    x, y, z = before_ball = eye(walker)
    assert 0.3 < z < 0.5 and abs(x) < 0.1 and y == pytest.approx(PLATE + 0.2, abs=0.03)
    azimuth = walker.scene.rig.goal.azimuth
    ui.drag([(100, 200), (130, 200), (160, 200)])
    assert walker.scene.rig.goal.azimuth != azimuth and np.allclose(eye(walker), before_ball, atol=0.02)
    put(walker, *before_ball[[0, 2]])
    hold(imgui.Key.s, 0.5)
    assert eye(walker)[2] > z + 0.1
    ui.key(imgui.Key.g)
    assert not walker.scene.rig.walking


def test_off_the_plate_it_falls_to_the_bottom_of_the_content_and_stays_within_its_sides(walker):
    put(walker, 0.0, 0.7, azimuth=180.0)
    settle(walker, 4.0, ahead=1.0)
    low, high = walker.scene.rig.all_of_it
    _, y, z = eye(walker)
    assert y == pytest.approx(low[1] + 0.2, abs=0.03) and z == pytest.approx(high[2], abs=0.05)


def test_a_crop_takes_the_ground_away(walker):
    put(walker, 0.0, 0.7)
    settle(walker, 0.5)
    walker.set(crop=crop.placed(walker.scene.pack, np.array([0.0, 0.5, 0.0]), np.full(3, 0.5)))
    settle(walker)
    assert eye(walker)[1] < PLATE + 0.15


def test_undo_goes_back_to_where_the_walk_began_and_then_to_the_view_before(walker):
    rig = walker.scene.rig
    start = rig.goal
    rig.remember()
    settle(walker, 0.5, ahead=-1.0)
    walker.run("undo")
    assert rig.walking and rig.goal == start
    walker.run("undo")
    assert not rig.walking and rig.goal == rig.home_pose and rig.fov == DEFAULT_FOV


@pytest.mark.parametrize(
    "command", ["home", "frame", "front", "orthographic", "fly", "walk", "bookmark", "next-bookmark"]
)
def test_commands_that_move_the_camera_end_the_walk_and_nothing_else_does(walker, command):
    if command == "next-bookmark":
        walker.run("bookmark")
    walker.run(command)
    rig = walker.scene.rig
    assert rig.walking == (command == "bookmark") and rig.flying == (command == "fly")
    assert rig.fov == (WALKING_FOV if "bookmark" in command else DEFAULT_FOV)


def test_down_is_that_of_the_placed_frame(walker):
    """A scene that lies on its side: the plate is a wall, and the box's side its bottom."""
    placing.put(walker, Placement(((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))))
    walker.scene.rig.stand_at(np.array([0.0, 0.6, 0.7]))
    settle(walker)
    assert eye(walker)[0] == pytest.approx(walker.scene.rig.all_of_it[1][0] - 0.2, abs=0.03)


def test_a_forward_facing_scene_is_refused(app, ndc_pack):
    app.show(ndc_pack, Path("toy"))
    app.run("walk")
    assert not app.scene.rig.walking
    assert app.messages.dialogs[-1].text.startswith("a forward-facing scene has no ground")


def test_a_metre_is_that_of_the_scale_unless_the_scene_is_too_small_for_a_body(app):
    app.show(toy_pack(), Path("toy"))
    pack, rig = app.scene.pack, app.scene.rig
    side = float(np.subtract(*rig.all_of_it[::-1]).max())
    assert metre_of(pack, rig, Scale(5.0, "m")) == pytest.approx(0.2)
    assert metre_of(pack, rig, Scale(500.0, "cm")) == pytest.approx(0.2)
    assert metre_of(pack, rig, Scale(20.0, "cm")) == metre_of(pack, rig, Scale()) == pytest.approx(side / SCENE_M)
    rig.within, rig.home_pose = True, rig.home_pose.seen_from(np.array([-0.6, PLATE + 0.4, 0.0]), rig.table)
    assert metre_of(pack, rig, Scale()) == pytest.approx(0.4 / USUAL_M, abs=0.02)
    photographed = seen_from(toy_pack(), 0.9)
    cameras = [dict(camera) for camera in photographed.metadata["cameras"]]
    raised = np.array(cameras[1]["world_T_camera"])  # that of the first view, which is one of three
    raised[:3, 3] += 0.2 * photographed.worldspace_T_opengl[:3, 1]
    cameras[1]["world_T_camera"] = raised.tolist()
    photographed = photographed.with_metadata(cameras=cameras)
    rig = OrbitCamera(photographed)
    heights = [shot.view.position[1] - PLATE for shot in shots_of(photographed)]
    assert rig.home_pose.eye(rig.table)[1] - PLATE == pytest.approx(max(heights))
    assert max(heights) > np.median(heights) + 0.1
    assert metre_of(photographed, rig, Scale()) == pytest.approx(np.median(heights) / USUAL_M, abs=0.02)


def test_the_eye_height_is_remembered_and_nothing_absurd_is_taken(app):
    apply_preferences(app, {"eye_height": 1.2})
    assert app.walking.eye_height_m == 1.2 and current_preferences(app)["eye_height"] == 1.2
