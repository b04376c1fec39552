"""360° pictures: all directions from one place, and, for two eyes, from beside it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from scenepack import Pack
from tests.scenepack.volumes import cube_pack
from tests.viewer.rendering.shapes import glossy_mlp
from training.scenes.lens import directions_at
from viewer.rendering.camera import ViewCamera
from viewer.rendering.layers import depth_along_axis
from viewer.rendering.settings import RenderSettings

SIDE, WALL = 56, 3  # voxels
SIZE = (192, 96)
FACE, FACE_FOV = 640, 100.0  # pixels; degrees, so that faces overlap
EYE = np.array([0.2, -0.1, 0.15])
FACES = [(axis, sign) for axis in range(3) for sign in (1.0, -1.0)]


@pytest.fixture(scope="module")
def room() -> Pack:
    """A glossy room around the origin whose walls, of opaque voxels, are painted smoothly."""
    z, y, x = (np.mgrid[:SIDE, :SIDE, :SIDE] + 0.5) * (2 / SIDE) - 1
    wall = np.maximum.reduce([abs(x), abs(y), abs(z)]) > 1 - 2 * WALL / SIDE
    colour = 0.3 + 0.2 * np.sin(2 * np.stack([x + y, y + z, z - x, 0 * x], -1) + [0.0, 1.0, 2.0, 0.0])
    colour[..., 3] = 1.0
    rgba = np.rint(255 * colour * wall[..., None]).astype(np.uint8)
    features = np.rint(120 * (1 + np.sin(np.stack([x, y, z, x * y], -1))) * wall[..., None]).astype(np.uint8)
    return cube_pack(rgba, 14, features=features, view_mlp=glossy_mlp())


def standing(ahead: tuple[float, float, float] = (0.6, -0.3, -0.5)) -> ViewCamera:
    return ViewCamera.look_at(EYE, EYE + np.array(ahead))


def directions(camera: ViewCamera) -> np.ndarray:
    """float64 [h, w, 3], grid frame, of unit length."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    across, down = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    return directions_at(across, down, camera.distortion) @ camera.grid_T_camera[:3, :3].T


def test_a_360_picture_is_six_perspective_views_resampled(room, offscreen) -> None:
    renderer = offscreen(room)
    panorama = standing().as_panorama(SIZE)
    ways = directions(panorama)
    expected = np.full((*ways.shape[:2], 3), np.nan)
    for axis, sign in FACES:
        ahead = sign * np.eye(3)[axis]
        face = ViewCamera.look_at(EYE, EYE + ahead, (0.0, 0.0, 1.0), FACE_FOV, (FACE, FACE))
        seen = sign * ways[..., axis] >= np.abs(ways).max(axis=-1)
        local = ways[seen] @ face.grid_T_camera[:3, :3]
        places = [
            face.cy + face.fy * local[:, 1] / local[:, 2] - 0.5,
            face.cx - face.fx * local[:, 0] / local[:, 2] - 0.5,
        ]
        picture = renderer.render_float(face)
        expected[seen] = np.stack([map_coordinates(picture[..., c], places, order=1) for c in range(3)], axis=-1)
    actual = renderer.render_float(panorama)
    assert np.ptp(expected) > 0.3 and 255 * np.abs(actual - expected).max() < 2


@pytest.mark.parametrize("ahead", [(0.6, -0.3, -0.5), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)])
def test_a_360_picture_is_level_and_its_middle_is_where_the_camera_looks(ahead) -> None:
    camera = ViewCamera.look_at(EYE, EYE + np.array(ahead), (0.0, 1.0, 1e-3))
    ways = directions(camera.as_panorama(SIZE))
    assert np.allclose(ways[0].mean(axis=0), (0, 1, 0), atol=0.05) and np.allclose(np.ptp(ways[..., 1], axis=1), 0)
    middle = ways[SIZE[1] // 2 - 1 : SIZE[1] // 2 + 1, SIZE[0] // 2 - 1 : SIZE[0] // 2 + 1].mean(axis=(0, 1))
    upper = camera.grid_T_camera[:3, 1] * np.sign(-ahead[1]) if not ahead[0] else np.array(ahead)
    assert middle @ upper > 0 and abs(np.cross(middle, upper)[1]) < 1e-3


def test_depth_is_the_distance_and_the_near_plane_a_ball(room, offscreen) -> None:
    renderer, panorama = offscreen(room), standing().as_panorama(SIZE)
    inner = 1 - 2 * WALL / SIDE
    ways = directions(panorama)
    expected = ((np.sign(ways) * inner - EYE) / ways).min(axis=-1)
    raw = RenderSettings(mode="depth", raw=True)
    depth = depth_along_axis(renderer.render_raw(panorama, raw), panorama, room)
    assert np.abs(depth - expected).max() < 0.07  # a voxel is 0.036; rays that graze go deeper into a wall
    assert np.array_equal(renderer.render(panorama, RenderSettings(near=0.5)), renderer.render(panorama))
    cut = renderer.render_float(panorama, RenderSettings(mode="alpha", near=1.4))[..., 0]
    assert (cut[expected > 1.45] > 0.9).all() and (cut[expected < 1.2] < 0.1).all() and 0.05 < cut.mean() < 0.95


def test_each_column_of_an_eyes_picture_is_seen_from_beside_the_middle(room, offscreen) -> None:
    renderer = offscreen(room)
    eye = standing().as_panorama(SIZE, eye_offset=0.2)
    actual, ways = renderer.render_float(eye), directions(eye)
    assert np.abs(actual - renderer.render_float(replace(eye, eye_offset=0.0))).max() > 0.05
    for column in (0, 70, 150):
        ahead = ways[SIZE[1] // 2, column] * (1, 0, 1)
        moved = eye.grid_T_camera.copy()
        moved[:3, 3] += 0.2 * np.cross(ahead, (0, 1, 0)) / np.linalg.norm(ahead)
        alone = renderer.render_float(replace(eye, grid_T_camera=moved, eye_offset=0.0))
        assert np.abs(actual[:, column] - alone[:, column]).max() < 1e-3
