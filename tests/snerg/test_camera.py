"""snerg.Camera: one view in the conventions of several programs."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import snerg
from viewer.rendering.camera import ViewCamera

ROTATION = Rotation.from_euler("xyz", [20.0, -50.0, 130.0], degrees=True)
POSITION = np.array([0.3, -1.2, 2.5])
AXES = np.diag([1.0, -1.0, -1.0])  # OpenCV's in OpenGL's


def pose(rotation: np.ndarray) -> np.ndarray:
    return np.column_stack([rotation, POSITION])


def test_one_view_is_the_same_in_every_convention() -> None:
    opengl = snerg.Camera.from_pose(pose(ROTATION.as_matrix()), size=(40, 30), fov=50.0)
    opencv = snerg.Camera.from_pose(pose(ROTATION.as_matrix() @ AXES), size=(40, 30), fov=50.0, convention="opencv")
    inverse = Rotation.from_matrix(ROTATION.as_matrix() @ AXES).inv()
    x, y, z, w = 3.0 * inverse.as_quat()  # of any length
    line = [w, x, y, z, *(-inverse.as_matrix() @ POSITION)]
    colmap = snerg.Camera.from_pose(line, size=(40, 30), fov=50.0, convention="colmap")
    for camera in (opencv, colmap):
        np.testing.assert_allclose(camera.pose, opengl.pose, atol=1e-12)
    np.testing.assert_allclose(opengl.pose[:3, 3], POSITION)


def test_a_field_of_view_is_the_lens_with_its_middle_in_the_picture() -> None:
    camera = snerg.Camera.look_at((0, 0, 3), (0, 0, 0), fov=90.0, size=(40, 30))
    assert (camera.cx, camera.cy, camera.frame) == (20.0, 15.0, "grid") and camera.fx == pytest.approx(15.0)
    k = [[50.0, 0.0, 19.0], [0.0, 52.0, 16.0], [0.0, 0.0, 1.0]]
    by_k = snerg.Camera.from_pose(np.eye(4), size=(40, 30), intrinsics=k).resized(80, 60)
    assert (by_k.fx, by_k.fy, by_k.cx, by_k.cy) == (100.0, 104.0, 38.0, 32.0)
    np.testing.assert_allclose(camera.pose, ViewCamera.look_at((0, 0, 3), (0, 0, 0)).grid_T_camera)


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"pose": np.eye(3)}, "pose"),
        ({"pose": np.full((4, 4), np.nan)}, "pose"),
        ({"pose": np.column_stack([np.eye(4)[:, :3], (1, 2, 3, 1)]).T}, "pose"),  # by columns, as OpenGL has it
        ({"pose": np.zeros((3, 4))}, "pose"),
        ({"pose": np.zeros(7), "convention": "colmap"}, "pose"),
        *(({"size": size}, "size") for size in ((0, 30), (40.5, 30), 40, (40, 30, 3), "40x30")),
        ({"convention": "OpenCV"}, "convention"),
        ({"frame": "placed"}, "frame"),
        ({"distortion": (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)}, "distortion"),  # of OpenCV's rational model
        ({"distortion": (np.nan, 0.0, 0.0, 0.0)}, "distortion"),
        *(({"fov": fov}, "fov") for fov in (180.0, "wide", [50.0, 40.0])),
        *(({"pose": pose}, "pose") for pose in ("above", None, [[1.0], [1.0, 2.0]])),
        ({"distortion": None}, "distortion"),
        ({"fov": None}, None),
        *(({"fov": None, "intrinsics": lens}, "intrinsics") for lens in ([0.0, 1.0, 2.0, 3.0], {"fx": 50.0})),
    ],
)
def test_numbers_that_are_no_camera_are_refused(changes: dict, where: str | None) -> None:
    with pytest.raises(snerg.SnergError) as refused:
        snerg.Camera.from_pose(**({"pose": np.eye(4), "size": (40, 30), "fov": 50.0} | changes))
    assert refused.value.where == where and "\n" not in str(refused.value)


def test_what_numpy_and_opencv_hand_out_is_taken() -> None:
    matrix = np.asfortranarray(np.eye(4, dtype=np.float32))
    size, k3 = (np.array([40, 30]), np.array([[0.1, 0.0, 0.0, 0.0, 0.2]]))
    camera = snerg.Camera.from_pose(matrix, size=size, fov=50.0, distortion=k3)  # type: ignore[arg-type]
    assert (camera.width, camera.height, camera.distortion) == (40, 30, (0.1, 0.0, 0.0, 0.0, 0.2))
    with pytest.raises(snerg.SnergError, match="is no size"):
        camera.resized(20, 0)


@pytest.mark.parametrize(
    ("eye", "message"),
    [
        ((1, 2, 3), "choose another target"),
        ((1, 2, 3 + 1e-15), "choose another target"),
        ("above", "three numbers"),
        ([[1], [1, 2]], "three numbers"),
    ],
)
def test_an_eye_that_is_no_point_or_lies_at_its_target_is_refused(eye: Any, message: str) -> None:
    with pytest.raises(snerg.SnergError, match=message):
        snerg.Camera.look_at(eye, (1, 2, 3))


@pytest.mark.parametrize(
    "change",
    [{"frame": "World"}, {"width": 0}, {"height": 30.0}, {"pose": np.eye(3)}, {"pose": np.full((4, 4), np.nan)}],
)
def test_a_changed_copy_that_is_no_camera_is_refused(change: dict) -> None:
    camera = snerg.Camera.look_at((0, 0, 3), (0, 0, 0))
    assert isinstance(replace(camera, pose=camera.pose.tolist()).pose, np.ndarray)
    with pytest.raises(snerg.SnergError):
        replace(camera, **change)
