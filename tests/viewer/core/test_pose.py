"""Turntable poses against the renderer's own cameras."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.core.pose import UP_AXES, Pose, Turntable, pose_from_text, pose_to_text
from viewer.rendering.camera import ViewCamera

ANGLES = {"azimuth": st.floats(-400, 400), "elevation": st.floats(-85, 85), "distance": st.floats(0.1, 50)}


@given(pivot=st.tuples(*[st.floats(-5, 5)] * 3), mirrored=st.booleans(), **ANGLES)
def test_a_pose_is_the_camera_that_looks_from_its_eye_at_its_pivot(pivot, azimuth, elevation, distance, mirrored):
    table = Turntable(mirrored=mirrored)
    pose = Pose(pivot, azimuth, elevation, distance)
    looked = ViewCamera.look_at(pose.eye(table), pivot, mirrored=mirrored)
    np.testing.assert_allclose(pose.matrix(table), looked.grid_T_camera, atol=1e-6)


@settings(max_examples=60)
@given(up=st.sampled_from(list(UP_AXES)), mirrored=st.booleans(), **ANGLES)
def test_a_level_camera_survives_the_way_to_a_pose_and_back(azimuth, elevation, distance, up, mirrored):
    table = Turntable(up, mirrored)
    pose = Pose((0.3, -1.0, 2.0), azimuth, elevation, distance)
    back = Pose.from_matrix(pose.matrix(table), distance, table)
    np.testing.assert_allclose(back.matrix(table), pose.matrix(table), atol=1e-6)
    np.testing.assert_allclose(back.pivot, pose.pivot, atol=1e-6)


def test_a_pose_survives_as_text_and_six_numbers_are_eye_and_target():
    matrix = Pose((0.1, 0.2, 0.3), 33.0, 12.0, 4.0).matrix(Turntable())
    again, fov, height = pose_from_text(pose_to_text(matrix, 41.5, 2.5))
    np.testing.assert_allclose(again, matrix, atol=1e-5)
    assert fov == pytest.approx(41.5) and height == 2.5
    matrix, fov, height = pose_from_text("0, 0, 4,  0 0 0")
    np.testing.assert_allclose(matrix, ViewCamera.look_at((0, 0, 4), (0, 0, 0)).grid_T_camera)
    assert fov is None and height is None
