"""What hands do to the camera."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.viewer.conftest import toy_pack
from viewer.app.commands import run
from viewer.core.pose import box_points, shortest_turn, view_camera
from viewer.core.pose import project as projected
from viewer.features.camera.forward_facing import (
    DISTANCES,
    PAN_LIMIT,
    TURN_LIMIT,
    ForwardFacingCamera,
    orbit_camera_for,
)
from viewer.features.camera.orbit_camera import OrbitCamera
from viewer.rendering.camera import ViewCamera, content_box
from viewer.rendering.framing import outline

SIZE = (800, 600)


def project(camera: ViewCamera, point: np.ndarray) -> tuple[float, float]:
    """Pixel (x, y) at which `camera` sees a point of the grid frame."""
    x, y, z = np.linalg.inv(camera.grid_T_camera)[:3] @ np.append(point, 1.0)
    return camera.cx - camera.fx * x / z, camera.cy + camera.fy * y / z


def under(camera: ViewCamera, x: float, y: float, depth: float) -> np.ndarray:
    """The point `depth` ahead that is seen at pixel (x, y)."""
    ray = np.array([(x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, -1.0])
    return camera.position + camera.grid_T_camera[:3, :3] @ (depth * ray)


def corners_of_voxels(pack) -> np.ndarray:
    """float64 [n, 3], grid frame: of all voxels that the toy is made of."""
    places = []
    for block in np.argwhere(pack.occupied):
        x, y, z = pack.atlas_indices[tuple(block)].astype(int) * pack.padded_block_size + 1
        size = pack.block_size
        inner = np.argwhere(pack.atlas_rgba[z : z + size, y : y + size, x : x + size, 3])
        places.append((block * size + inner)[:, ::-1])
    corners = np.concatenate(places)[:, None] + np.indices((2, 2, 2)).reshape(3, -1).T
    return pack.min_xyz + pack.voxel_size * np.unique(corners.reshape(-1, 3), axis=0)


@pytest.fixture
def rig(pack) -> OrbitCamera:
    return orbit_camera_for(pack)


def test_the_first_view_shows_all_of_the_content(rig, pack):
    pixels, before = projected(rig.camera(SIZE), corners_of_voxels(pack))
    assert before.all() and pixels.min() > 0 and (pixels < SIZE).all()


def test_turning_keeps_the_pivot_in_the_middle_and_the_distance(rig):
    before = rig.goal
    rig.orbit(0.3, 0.1)
    rig.shown = rig.goal
    assert rig.goal.distance == before.distance and rig.goal.pivot == before.pivot
    assert project(rig.camera(SIZE), np.asarray(before.pivot)) == pytest.approx((400, 300))


def test_dragging_to_the_right_turns_the_scene_to_the_right(rig):
    near_side = under(rig.camera(SIZE), 400, 300, 0.7 * rig.goal.distance)
    rig.orbit(0.02, 0.0)
    rig.shown = rig.goal
    assert project(rig.camera(SIZE), near_side)[0] > 401


@given(dx=st.floats(-0.4, 0.4), dy=st.floats(-0.4, 0.4))
def test_what_lies_at_the_pivots_depth_stays_under_the_cursor_while_it_is_slid(dx, dy):
    rig = orbit_camera_for(toy_pack())
    point = under(rig.camera(SIZE), 250, 200, rig.goal.distance)
    rig.pan(dx, dy)
    rig.shown = rig.goal
    assert project(rig.camera(SIZE), point) == pytest.approx((250 + 600 * dx, 200 + 600 * dy), abs=1e-3)


@given(x=st.floats(0, 800), y=st.floats(0, 600), notches=st.floats(-5, 5))
def test_the_wheel_keeps_what_lies_under_the_cursor(x, y, notches):
    rig = orbit_camera_for(toy_pack())
    point = under(rig.camera(SIZE), x, y, rig.goal.distance)
    rig.dolly(notches, ((2 * x - 800) / 600, (600 - 2 * y) / 600))
    rig.shown = rig.goal
    assert project(rig.camera(SIZE), point) == pytest.approx((x, y), abs=1e-3)


def test_damping_arrives_and_stops(rig):
    rig.orbit(0.3, 0.2)
    rig.dolly(3, (0.2, 0.1))
    frames = 0
    while rig.update(1 / 60):
        frames += 1
        assert frames < 120
    assert rig.shown == rig.goal and frames > 5
    assert not rig.update(1 / 60)


def test_damping_does_not_depend_on_the_frame_rate(pack):
    poses = []
    for rate in (30, 120):
        rig = orbit_camera_for(pack)
        rig.orbit(0.5, 0.0)
        for _ in range(rate // 10):
            rig.update(1 / rate)
        poses.append(rig.shown.azimuth)
    assert poses[0] == pytest.approx(poses[1], abs=1e-6)


def test_home_comes_back_from_anywhere(rig):
    start = rig.goal
    rig.orbit(1.0, 0.4)
    rig.pan(0.3, 0.2)
    rig.dolly(8)
    rig.fov = 90.0
    rig.home()
    rig.shown = rig.goal
    assert rig.goal == start and rig.fov == rig.home_fov


def test_undo_and_redo_walk_through_gestures(rig):
    places = [rig.goal]
    for dx in (0.1, 0.2, 0.3):
        rig.remember()
        rig.orbit(dx, 0.0)
        places.append(rig.goal)
    for place in reversed(places[:-1]):
        assert rig.history.undo()
        assert rig.goal == place
    assert not rig.history.undo()
    for place in places[1:]:
        assert rig.history.redo()
        assert rig.goal == place
    assert not rig.history.redo()


def test_a_held_camera_is_shown_exactly_until_the_hands_move(rig):
    held = ViewCamera.look_at((2, 1, 2), (0, 0, 0), up=(0.2, 1, 0), fov_degrees=50, size=(400, 300))
    rig.hold(held)
    seen = rig.camera(SIZE)
    np.testing.assert_array_equal(seen.grid_T_camera, held.grid_T_camera)
    assert seen.fx == pytest.approx(2 * held.fx)
    rig.orbit(1e-9, 0.0)
    rig.shown = rig.goal
    assert rig.held is None
    np.testing.assert_allclose(rig.matrix[:3, 3], held.position, atol=1e-4)


def test_a_new_pivot_is_looked_at_from_the_same_place(rig):
    eye = rig.goal.eye(rig.table)
    rig.set_pivot(np.array([0.5, 0.1, 0.0]))
    rig.shown = rig.goal
    np.testing.assert_allclose(rig.goal.eye(rig.table), eye, atol=1e-9)
    assert project(rig.camera(SIZE), np.array([0.5, 0.1, 0.0])) == pytest.approx((400, 300), abs=1e-6)


def test_another_up_axis_keeps_the_eye_and_levels_the_camera(rig):
    eye = rig.matrix[:3, 3].copy()
    rig.set_up("z")
    np.testing.assert_allclose(rig.matrix[:3, 3], eye, atol=1e-9)
    assert rig.matrix[2, 0] == pytest.approx(0.0)  # the camera's right axis lies in the new horizon


def test_flying_forward_moves_along_the_view(rig):
    before = rig.matrix.copy()
    rig.fly(0, 0, 1, 0.5)
    rig.shown = rig.goal
    np.testing.assert_allclose(rig.matrix[:3, 3] - before[:3, 3], -0.5 * rig.speed * before[:3, 2], atol=1e-9)


def test_looking_around_while_flying_keeps_the_eye(rig):
    rig.flying = True
    eye = rig.matrix[:3, 3].copy()
    rig.orbit(0.2, 0.1)
    while rig.update(1 / 60):
        np.testing.assert_allclose(rig.matrix[:3, 3], eye, atol=1e-6)


moves = st.lists(
    st.tuples(st.sampled_from(["orbit", "pan", "dolly"]), st.floats(-2, 2), st.floats(-2, 2)), min_size=1, max_size=30
)


@settings(max_examples=40, deadline=None)
@given(moves)
def test_no_movement_leaves_the_bounds_of_a_forward_facing_pack(steps):
    rig = ForwardFacingCamera(toy_pack(ndc=True))
    for name, a, b in steps:
        rig.dolly(5 * a) if name == "dolly" else getattr(rig, name)(a, b)
        rig.update(0.03)
        for pose in (rig.goal, rig.shown):
            assert max(abs(v) for v in pose.pivot) <= PAN_LIMIT + 1e-9
            assert DISTANCES[0] - 1e-9 <= pose.distance <= DISTANCES[1] + 1e-9
            assert abs(shortest_turn(180.0, pose.azimuth)) <= TURN_LIMIT + 1e-9
            assert abs(pose.elevation) <= TURN_LIMIT + 1e-9


def test_a_forward_facing_pack_is_first_seen_as_in_the_published_viewer(ndc_pack):
    rig = orbit_camera_for(ndc_pack)
    assert rig.bounded
    np.testing.assert_allclose(rig.matrix[:3, 3], (0, 0, -0.25), atol=1e-12)
    training = ndc_pack.worldspace_T_opengl[:3, :3] @ rig.matrix[:3, :3]
    np.testing.assert_allclose(training, np.eye(3), atol=1e-12)


def test_sliding_a_forward_facing_pack_moves_the_picture_with_the_hand(ndc_pack):
    rig = orbit_camera_for(ndc_pack)
    far = np.array([0.0, 0.0, 5.0])
    before = project(rig.camera(SIZE), far)
    rig.pan(0.1, 0.05)
    rig.shown = rig.goal
    after = project(rig.camera(SIZE), far)
    assert after[0] > before[0] and after[1] > before[1]


@settings(max_examples=40, deadline=None)
@given(moves)
def test_no_movement_breaks_the_camera(steps):
    rig = OrbitCamera(toy_pack())
    for name, a, b in steps:
        rig.dolly(5 * a, (b, a)) if name == "dolly" else getattr(rig, name)(a, b)
        rig.update(0.03)
        assert np.isfinite(rig.matrix).all()
        np.testing.assert_allclose(rig.matrix[:3, :3].T @ rig.matrix[:3, :3], np.eye(3), atol=1e-9)


def seen_from(pack, distance: float):
    """The pack with cameras in its metadata, `distance` half sides of the toy from its middle, looking there."""
    half = 0.5 * pack.voxel_size * max(pack.grid_size)
    cameras = []
    for azimuth in (20.0, 50.0, 80.0):
        view = ViewCamera.orbit(pack, azimuth, 5.0, distance * half, 60.0, (40, 60))
        matrix = (pack.worldspace_T_opengl @ view.grid_T_camera).tolist()
        numbers = {key: getattr(view, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        cameras.append({"name": str(azimuth), "split": "train", "world_T_camera": matrix, **numbers})
    return pack.with_metadata(cameras=cameras)


def test_a_scene_that_surrounds_its_cameras_begins_at_one_of_them():
    pack = seen_from(toy_pack(), 0.6)
    rig = OrbitCamera(pack)
    expected = ViewCamera.orbit(pack, 50.0, 5.0, 0.6 * 0.5 * pack.voxel_size * max(pack.grid_size), 60.0, (40, 60))
    np.testing.assert_allclose(rig.camera((40, 60)).grid_T_camera, expected.grid_T_camera, atol=1e-6)
    assert rig.fov == pytest.approx(60.0)
    rig.dolly(3, (0.1, 0.2))
    rig.home()
    rig.shown = rig.goal
    np.testing.assert_allclose(rig.matrix, expected.grid_T_camera, atol=1e-6)
    outside = OrbitCamera(seen_from(toy_pack(), 6.0))
    np.testing.assert_allclose(outside.matrix, OrbitCamera(toy_pack()).matrix)


@given(aspect=st.floats(0.3, 3.0), azimuth=st.floats(0, 360), elevation=st.floats(-60, 60), fov=st.floats(15, 80))
@settings(deadline=None, max_examples=60)
def test_the_whole_scene_is_seen_in_every_picture(aspect, azimuth, elevation, fov):
    pack = toy_pack()
    rig = orbit_camera_for(pack)
    rig.shape(aspect)
    rig.fov = fov
    rig.look_along(azimuth, elevation)
    rig.frame()
    rig.shown = rig.goal
    size = (round(600 * aspect), 600)
    pixels, before = projected(rig.camera(size), corners_of_voxels(pack))
    assert before.all() and pixels.min() >= 0 and (pixels <= size).all()


def test_the_first_view_follows_the_window_until_it_is_left(rig):
    wide = rig.goal.distance
    rig.shape(0.4)
    assert rig.goal.distance > wide and rig.shown == rig.goal == rig.home_pose
    rig.shape(1.5)
    assert rig.goal.distance == wide
    rig.orbit(0.1, 0.0)
    left = rig.goal
    rig.shape(0.4)
    assert rig.goal == left
    rig.home()
    assert rig.goal.distance > wide


def test_what_home_changes_of_the_lens_is_undone_too(rig):
    rig.fov = 90.0
    rig.home()
    assert rig.history.undo() and rig.fov == 90.0


def test_another_up_is_undone(rig):
    before = rig.goal, rig.table
    rig.set_up("-z")
    assert rig.history.undo() and (rig.goal, rig.table) == before


def test_the_first_view_is_filled_and_cuts_nothing_off():
    rig = orbit_camera_for(toy_pack())
    for aspect in (0.5, 1.0, 2.2):
        rig.shape(aspect)
        camera = rig.camera((round(600 * aspect), 600))
        places = np.array([project(camera, point) for point in outline(toy_pack())])
        shares = np.abs(places / [camera.width, 600] * 2 - 1)
        assert 0.9 < shares.max() < 1.0


def test_without_perspective_the_pivot_keeps_its_size_and_moving_closer_only_enlarges(rig):
    rig.look_along(30, 20)
    rig.shown = rig.goal
    before = rig.camera(SIZE)
    rig.set_orthographic(True)
    camera = rig.camera(SIZE)
    assert camera.orthographic and camera.fy == pytest.approx(before.fy / rig.goal.distance)
    low, high = content_box(toy_pack())
    corners = box_points(low, high)
    for notches in (0, 40):  # to as close as can be: no corner is ever behind the camera
        rig.dolly(notches)
        rig.shown = rig.goal
        pixels, before_it = projected(rig.camera(SIZE), corners)
        assert before_it.all()
    assert np.ptp(pixels[:, 0]) > 20 * SIZE[0]
    rig.home()
    assert not rig.orthographic
    assert rig.history.undo() and rig.orthographic


def test_the_near_plane_stays_in_place_without_perspective(rig):
    near = 0.8 * rig.goal.distance
    plane = rig.camera(SIZE, near).position - near * rig.matrix[:3, 2]
    rig.set_orthographic(True)
    camera = rig.camera(SIZE, near)
    np.testing.assert_allclose(
        (camera.position - camera.near * rig.matrix[:3, 2] - plane) @ rig.matrix[:3, 2], 0, atol=1e-9
    )


def test_a_copied_orthographic_view_comes_back(app, pack, pack_folder):
    app.show(pack, pack_folder)
    rig = app.scene.rig
    rig.set_orthographic(True)
    rig.orbit(0.2, 0.1)
    rig.dolly(3, (0.2, 0.1))
    rig.shown = rig.goal
    app.copy_pose()
    before = rig.camera(SIZE)
    rig.home()
    app.paste()
    after = rig.camera(SIZE)
    assert after.orthographic and after.fx == pytest.approx(before.fx, rel=1e-5)
    corners = box_points(*content_box(pack))
    np.testing.assert_allclose(projected(after, corners)[0], projected(before, corners)[0], atol=0.01)


@pytest.mark.parametrize(("axis", "angles"), [((1, 0, 0), (90, 0)), ((0, 1, 0), (0, 90)), ((0, 0, -1), (180, 0))])
def test_an_axis_is_looked_along_and_from_the_other_side_the_second_time(rig, axis, angles):
    axis = np.array(axis, float)
    rig.look_from(axis)
    assert (rig.goal.azimuth % 360, rig.goal.elevation) == pytest.approx(angles)
    np.testing.assert_allclose(rig.goal.rotation(rig.table)[:, 2], axis, atol=1e-9)
    rig.shown = rig.goal
    rig.look_from(axis)
    np.testing.assert_allclose(rig.goal.rotation(rig.table)[:, 2], -axis, atol=1e-9)


def test_a_camera_that_looks_straight_down_keeps_its_turn(rig):
    for azimuth in (0.0, 70.0, -130.0):
        for elevation in (90.0, -90.0):
            rig.look_along(azimuth, elevation)
            rig.shown = rig.goal
            rig.set_matrix(rig.matrix)
            assert shortest_turn(rig.goal.azimuth, azimuth) == pytest.approx(0, abs=1e-6)


def test_a_forward_facing_pack_says_that_it_has_no_orthographic_view(app, ndc_pack):
    app.show(ndc_pack, Path("ndc"))
    run(app, "orthographic")
    assert "no orthographic view" in app.messages.dialogs[0].text and not app.scene.rig.orthographic
    app.paste_pose('{"eye": [0, 0, -0.2], "target": [0, 0, 1], "ortho_height": 2}')
    assert not app.camera().orthographic


def test_a_turntable_from_the_first_view_shows_every_side_whole(app):
    app.show(toy_pack(), Path("toy"))
    app.scene.rig.shape(0.6)
    run(app, "turntable")
    points = outline(app.scene.pack)
    for matrix, fov in app.filming.path.sample(4):
        camera = view_camera(matrix, fov, (360, 600))
        pixels, _ = projected(camera, points)
        assert np.abs(pixels / [180, 300] - 1).max() < 1.0
