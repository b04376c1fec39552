"""What hands do to the camera."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from scenepack.blocks import dense_from_pack
from tests.viewer.scenes import with_cameras
from tests.viewer.waiting import at_once
from viewer.core.pose import project, shortest_turn
from viewer.features.camera.forward_facing import DISTANCES, PAN_LIMIT, TURN_LIMIT, orbit_camera_for
from viewer.features.camera.orbit_camera import OrbitCamera
from viewer.rendering.camera import ViewCamera, box_points, content_box

SIZE = (800, 600)
AMOUNT = st.floats(-2, 2)


def pixel_of(camera: ViewCamera, point: ArrayLike) -> tuple[float, float]:
    """Where `camera` sees a point of the grid frame."""
    x, y = project(camera, np.atleast_2d(point))[0][0]
    return float(x), float(y)


def under(camera: ViewCamera, x: float, y: float, depth: float) -> np.ndarray:
    """The point `depth` ahead that is seen at pixel (x, y)."""
    ray = np.array([(x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, -1.0])
    return camera.position + camera.grid_T_camera[:3, :3] @ (depth * ray)


@pytest.fixture
def rig(pack) -> OrbitCamera:
    return orbit_camera_for(pack)


def test_the_first_view_shows_all_of_the_content(rig, pack):
    voxels = np.argwhere(dense_from_pack(pack)[0][..., 3])[:, ::-1]
    corners = voxels[:, None] + np.indices((2, 2, 2)).reshape(3, -1).T
    pixels, before = project(rig.camera(SIZE), pack.min_xyz + pack.voxel_size * corners.reshape(-1, 3))
    assert before.all() and pixels.min() > 0 and (pixels < SIZE).all()


def test_dragging_to_the_right_turns_the_scene_to_the_right_about_its_pivot_in_the_middle(rig):
    before = rig.goal
    near_side = under(rig.camera(SIZE), 400, 300, 0.7 * before.distance)
    at_once(rig.orbit, 0.02, 0.1)
    assert pixel_of(rig.camera(SIZE), near_side)[0] > 401
    assert rig.goal.distance == before.distance and rig.goal.pivot == before.pivot
    assert pixel_of(rig.camera(SIZE), before.pivot) == pytest.approx((400, 300))


@given(dx=st.floats(-0.4, 0.4), dy=st.floats(-0.4, 0.4))
def test_what_lies_at_the_pivots_depth_stays_under_the_cursor_while_it_is_slid(pack, dx, dy):
    rig = orbit_camera_for(pack)
    point = under(rig.camera(SIZE), 250, 200, rig.goal.distance)
    at_once(rig.pan, dx, dy)
    assert pixel_of(rig.camera(SIZE), point) == pytest.approx((250 + 600 * dx, 200 + 600 * dy), abs=1e-3)


@given(x=st.floats(0, 800), y=st.floats(0, 600), notches=st.floats(-5, 5))
def test_the_wheel_keeps_what_lies_under_the_cursor(pack, x, y, notches):
    rig = orbit_camera_for(pack)
    point = under(rig.camera(SIZE), x, y, rig.goal.distance)
    at_once(rig.dolly, notches, ((2 * x - 800) / 600, (600 - 2 * y) / 600))
    assert pixel_of(rig.camera(SIZE), point) == pytest.approx((x, y), abs=1e-3)


def test_damping_arrives_and_stops_and_does_not_depend_on_the_frame_rate(rig, pack):
    rig.orbit(0.3, 0.2)
    rig.dolly(3, (0.2, 0.1))
    frames = 0
    while rig.update(1 / 60):
        frames += 1
        assert frames < 120
    assert rig.shown == rig.goal and frames > 5
    assert not rig.update(1 / 60)
    poses = []
    for rate in (30, 120):
        rig = orbit_camera_for(pack)
        rig.orbit(0.5, 0.0)
        for _ in range(rate // 10):
            rig.update(1 / rate)
        poses.append(rig.shown.azimuth)
    assert poses[0] == pytest.approx(poses[1], abs=1e-6)


def test_a_held_camera_is_shown_exactly_until_the_hands_move(rig):
    held = ViewCamera.look_at((2, 1, 2), (0, 0, 0), up=(0.2, 1, 0), fov_degrees=50, size=(400, 300))
    rig.hold(held)
    seen = rig.camera(SIZE)
    np.testing.assert_array_equal(seen.grid_T_camera, held.grid_T_camera)
    assert seen.fx == pytest.approx(2 * held.fx)
    at_once(rig.orbit, 1e-9, 0.0)
    assert rig.held is None
    np.testing.assert_allclose(rig.matrix[:3, 3], held.position, atol=1e-4)


def test_a_new_pivot_is_looked_at_from_the_same_place(rig):
    eye = rig.goal.eye(rig.table)
    at_once(rig.set_pivot, np.array([0.5, 0.1, 0.0]))
    np.testing.assert_allclose(rig.goal.eye(rig.table), eye, atol=1e-9)
    assert pixel_of(rig.camera(SIZE), np.array([0.5, 0.1, 0.0])) == pytest.approx((400, 300), abs=1e-6)


def test_another_up_axis_keeps_the_eye_and_levels_the_camera(rig):
    eye = rig.matrix[:3, 3].copy()
    rig.set_up("z")
    np.testing.assert_allclose(rig.matrix[:3, 3], eye, atol=1e-9)
    assert rig.matrix[2, 0] == pytest.approx(0.0)  # the camera's right axis lies in the new horizon


def test_looking_around_while_flying_keeps_the_eye(rig):
    rig.navigate("fly")
    eye = rig.matrix[:3, 3].copy()
    rig.orbit(0.2, 0.1)
    while rig.update(1 / 60):
        np.testing.assert_allclose(rig.matrix[:3, 3], eye, atol=1e-6)


@pytest.mark.parametrize("ndc", [False, True])
@settings(max_examples=40, deadline=None)
@given(steps=st.lists(st.tuples(st.sampled_from(["orbit", "pan", "dolly"]), AMOUNT, AMOUNT), min_size=1, max_size=30))
def test_no_movement_breaks_the_camera_or_leaves_the_bounds_of_a_forward_facing_pack(pack, ndc_pack, ndc, steps):
    rig = orbit_camera_for(ndc_pack if ndc else pack)
    for name, a, b in steps:
        rig.dolly(5 * a, (b, a)) if name == "dolly" else getattr(rig, name)(a, b)
        rig.update(0.03)
        assert np.isfinite(rig.matrix).all()
        np.testing.assert_allclose(rig.matrix[:3, :3].T @ rig.matrix[:3, :3], np.eye(3), atol=1e-9)
        for pose in (rig.goal, rig.shown) if ndc else ():
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


def seen_from(pack, distance: float):
    """The pack with cameras in its metadata, `distance` half sides of the toy from its middle, looking there."""
    half = 0.5 * pack.voxel_size * max(pack.grid_size)
    azimuths = (20.0, 50.0, 80.0)
    return with_cameras(pack, [ViewCamera.orbit(pack, each, 5.0, distance * half, 60.0, (40, 60)) for each in azimuths])


@pytest.mark.parametrize(("distance", "contraction"), [(0.6, None), (6.0, 1.0)])  # what is contracted is all around
def test_a_scene_that_surrounds_its_cameras_begins_at_one_of_them(pack, distance, contraction):
    rig = OrbitCamera(seen_from(pack, distance).with_metadata(contraction=contraction))
    half = 0.5 * pack.voxel_size * max(pack.grid_size)
    expected = ViewCamera.orbit(pack, 50.0, 5.0, distance * half, 60.0, (40, 60))
    np.testing.assert_allclose(rig.camera((40, 60)).grid_T_camera, expected.grid_T_camera, atol=1e-6)
    assert rig.fov == pytest.approx(60.0)
    rig.dolly(3, (0.1, 0.2))
    at_once(rig.home)
    np.testing.assert_allclose(rig.matrix, expected.grid_T_camera, atol=1e-6)
    outside = OrbitCamera(seen_from(pack, 6.0))
    np.testing.assert_allclose(outside.matrix, OrbitCamera(pack).matrix)


@pytest.mark.parametrize("notches", [-10, 30])  # from afar, and from amid the scene
def test_without_perspective_the_near_plane_stays_where_it_is(rig, notches):
    at_once(rig.dolly, notches)
    near, back = 0.9 * rig.goal.distance, rig.matrix[:3, 2]
    through = rig.camera(SIZE, near)
    rig.set_orthographic(True)
    flat = rig.camera(SIZE, near)
    planes = [camera.position @ back - max(camera.near, near) for camera in (through, flat)]  # as the renderer has it
    assert planes[1] == pytest.approx(planes[0])


def test_without_perspective_the_pivot_keeps_its_size_and_moving_closer_only_enlarges(rig, pack):
    at_once(rig.look_along, 30, 20)
    before = rig.camera(SIZE)
    rig.set_orthographic(True)
    camera = rig.camera(SIZE)
    assert camera.orthographic and camera.fy == pytest.approx(before.fy / rig.goal.distance)
    corners = box_points(*content_box(pack))
    for notches in (0, 40):  # to as close as can be: no corner is ever behind the camera
        at_once(rig.dolly, notches)
        pixels, before_it = project(rig.camera(SIZE), corners)
        assert before_it.all()
    assert np.ptp(pixels[:, 0]) > 20 * SIZE[0]
    rig.home()
    assert not rig.orthographic
    assert rig.history.undo() and rig.orthographic
