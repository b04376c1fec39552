"""Walking: in the toy (a ball and a post on a plate, in the box of -1 … 1), and the motion of a body by itself."""

from collections.abc import Callable
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
from viewer.features.camera.walking import JUMP_SPEED, RADIUS, SCENE_M, STEP, USUAL_M, Body, Space, metre_of, moved
from viewer.features.crop import crop
from viewer.features.photographs.photographs import shots_of
from viewer.features.placing import placing

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


# How a body on foot moves among boxes and planes. Lengths are in eye heights.


GRAIN = 0.06
FRAME_S = 1 / 30
Solid = Callable[[np.ndarray], np.ndarray]


def floor(p: np.ndarray) -> np.ndarray:
    return p[:, 1] <= 0


def box(low: tuple[float, ...], high: tuple[float, ...]) -> Solid:
    return lambda p: np.all((p >= low) & (p <= high), axis=1)


def space(*solids: Solid, grain: float = GRAIN) -> Space:
    return Space(lambda p: np.any([solid(p) for solid in solids], axis=0), grain)


def standing(x: float = 0.0) -> Body:
    return Body(np.array([x, 0.0, 0.0]), 0.0, True)


def walked(among: Space, body: Body, direction: tuple[float, float], seconds: float) -> Body:
    """Two eye heights a second towards (x, z)."""
    for _ in range(round(seconds / FRAME_S)):
        way = 2.0 * FRAME_S * np.array([direction[0], 0.0, direction[1]])
        body = moved(among, body, way, False, FRAME_S)
    return body


@pytest.mark.parametrize("grain", [GRAIN, 0.5])  # voxels of half its eye height, as in a small preview
def test_a_body_stands_still_on_the_floor_and_walks_level_at_its_speed(grain):
    among = space(floor, grain=grain)
    still = moved(among, standing(), np.zeros(3), False, FRAME_S)
    assert still.stands and np.array_equal(still.feet, [0, 0, 0])
    body = walked(among, standing(), (0.6, 0.8), 1.0)
    assert body.feet == pytest.approx([1.2, 0, 1.6], abs=1e-9) and body.stands


@pytest.mark.parametrize("degrees", [0, 20, 45, 200])
def test_a_wall_stops_it_and_it_slides_along(degrees):
    """A wall whose normal points in that direction, made of voxels."""
    turn = np.radians(degrees)
    normal, along = np.array([np.cos(turn), 0, np.sin(turn)]), np.array([-np.sin(turn), 0, np.cos(turn)])

    def wall(p: np.ndarray) -> np.ndarray:
        return (np.floor(p / GRAIN) + 0.5) * GRAIN @ normal < -0.5

    among = space(floor, wall)
    direct = walked(among, standing(), tuple(-normal[[0, 2]]), 1.0)
    assert abs(direct.feet @ normal + 0.5 - RADIUS) < 1.5 * GRAIN and abs(direct.feet @ along) < 4 * GRAIN
    slant = (along - normal) / np.sqrt(2)
    body = walked(among, standing(), tuple(slant[[0, 2]]), 2.0)
    assert body.feet @ normal > -0.5 and body.feet @ along > 1.7  # of 2.8


def test_in_a_corner_it_stops():
    among = space(floor, lambda p: p[:, 0] > 0.6, lambda p: p[:, 2] > 0.6)
    body = walked(among, standing(), (0.8, 0.6), 2.0)
    assert body.feet[[0, 2]] == pytest.approx([0.6 - RADIUS] * 2, abs=GRAIN)
    assert walked(among, body, (-1, 0), 0.5).feet[0] < -0.3  # and walks away again


@pytest.mark.parametrize(
    ("height", "ceiling", "climbed"),
    [(0.15, 3, True), (0.25, 3, True), (0.25, 1.2, False), (0.3, 3, True), (0.45, 3, False), (0.8, 3, False)],
)
def test_it_climbs_steps_up_to_a_third_of_its_eye_height_where_there_is_room_for_its_head(height, ceiling, climbed):
    among = space(floor, box((0.5, -1, -9), (9, height, 9)), box((0.5, ceiling, -9), (9, 4, 9)))
    body = walked(among, standing(), (1, 0), 1.0)
    assert body.feet[0] > 1.5 if climbed else body.feet[0] < 0.5
    assert body.feet[1] == pytest.approx(height if climbed else 0, abs=GRAIN / 4) and body.stands


def test_it_walks_down_stairs_without_falling_and_off_a_ledge_falls():
    def stairs(p: np.ndarray) -> np.ndarray:
        return p[:, 1] <= -0.2 * np.floor(np.clip(p[:, 0], 0, 2) / 0.4)

    body = standing(-0.3)
    for _ in range(46):
        body = moved(space(stairs), body, np.array([0.05, 0, 0]), False, FRAME_S)
        assert body.stands
    assert body.feet[1] < -0.7
    ledge = space(box((-9, -1, -9), (0, 0, 9)), lambda p: p[:, 1] <= -2)
    body = walked(ledge, standing(-0.3), (1, 0), 0.35)
    assert not body.stands and body.rising < 0
    assert walked(ledge, body, (0, 0), 1.5).feet[1] == pytest.approx(-2, abs=GRAIN / 4)


def test_it_jumps_once_and_a_ceiling_stops_the_jump():
    among = space(floor)
    body, top = moved(among, standing(), np.zeros(3), True, FRAME_S), 0.0
    for _ in range(60):
        top = max(top, body.feet[1])
        body = moved(among, body, np.zeros(3), False, FRAME_S)
    assert top == pytest.approx(JUMP_SPEED**2 / 12, abs=0.05) and body.stands and top > STEP
    low = space(floor, lambda p: p[:, 1] > 1.2)
    body = moved(low, standing(), np.zeros(3), True, 0.1)
    assert 0.05 < body.feet[1] < 0.15 and body.rising == 0


@pytest.mark.parametrize("frame_s", [0.1, 1.0, 5.0])
def test_long_frames_go_through_no_thin_wall_and_no_thin_floor(frame_s):
    thin_floor, thin_wall = box((-99, -GRAIN, -99), (99, 0, 99)), box((0.5, -1, -99), (0.5 + GRAIN, 9, 99))
    among = space(thin_floor, thin_wall)
    body = moved(among, standing(), np.array([2 * frame_s, 0, 0]), False, frame_s)
    assert body.feet[0] < 0.5 and body.feet[1] == pytest.approx(0, abs=1e-9)
    body = Body(np.array([0.0, 4.0, 0.0]), -9.0)
    for _ in range(60):
        body = moved(among, body, np.zeros(3), False, frame_s)
    assert body.stands and body.feet[1] == pytest.approx(0, abs=GRAIN / 2)


def test_a_body_that_is_stuck_is_lifted_out():
    body = walked(space(floor, box((-1, 0, -1), (1, 1.7, 1))), standing(), (0, 0), 1.0)
    assert body.feet[1] == pytest.approx(1.7, abs=GRAIN / 4) and body.stands
