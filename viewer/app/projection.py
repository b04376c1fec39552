"""From the grid frame to the picture: points, frusta, boxes, and dragging along an axis."""

from __future__ import annotations

import numpy as np

from training.scenes.rays import distort, undistort
from viewer.rendering.camera import ViewCamera
from viewer.rendering.ray_frame import lens_reach

BOX_EDGES = tuple((a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1)
FRUSTUM_EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))


def project(camera: ViewCamera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (float [n, 2]) of points (float [n, 3], grid frame), and whether the camera can see each (bool [n])."""
    camera_T_grid = np.linalg.inv(camera.grid_T_camera)
    local = points @ camera_T_grid[:3, :3].T + camera_T_grid[:3, 3]
    before = local[:, 2] < -1e-6
    depth = np.where(before & (not camera.orthographic), -local[:, 2], 1.0)
    a, b = local[:, 0] / depth, -local[:, 1] / depth
    if any(camera.distortion):
        before &= np.hypot(a, b) < lens_reach(camera.distortion)
        a, b = distort(a, b, camera.distortion)
    return np.stack([camera.cx + camera.fx * a, camera.cy + camera.fy * b], axis=1), before


def rays_through(camera: ViewCamera, pixels: np.ndarray) -> np.ndarray:
    """float64 [n, 3], camera axes, one unit deep: what pixels (float [n, 2]) look along, through the lens.

    Of a camera with one eye. See ray_through for any.
    """
    x, y = pixels.T
    a, b = undistort((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, camera.distortion)
    return np.stack([a, -b, -np.ones_like(a)], axis=1)


def ray_through(camera: ViewCamera, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the ray through a pixel begins and its unit direction, float64 [3] each, grid frame."""
    rotation = camera.grid_T_camera[:3, :3]
    if camera.orthographic:
        across = np.array([(x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, 0.0])
        return camera.position + rotation @ across, -rotation[:, 2]
    ray = rotation @ rays_through(camera, np.array([[x, y]]))[0]
    return camera.position, ray / np.linalg.norm(ray)


def frustum_points(camera: ViewCamera, depth: float) -> np.ndarray:
    """float64 [5, 3]: a camera's eye and the corners of its picture at `depth` (grid units) ahead; see FRUSTUM_EDGES."""
    corners = [(0, 0), (camera.width, 0), (camera.width, camera.height), (0, camera.height)]
    points = np.vstack([np.zeros(3), depth * rays_through(camera, np.asarray(corners, np.float64))])
    return points @ camera.grid_T_camera[:3, :3].T + camera.grid_T_camera[:3, 3]


def box_points(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """float64 [8, 3]: corners of a box; bit k of the index tells low or high along axis k. See BOX_EDGES."""
    return np.array([[(high if i >> k & 1 else low)[k] for k in range(3)] for i in range(8)], np.float64)


def along_axis(camera: ViewCamera, at: np.ndarray, axis: int, moved: tuple[float, float]) -> float:
    """How far (grid units) a point at `at` moves along an axis when it is dragged by `moved` pixels."""
    unit = np.zeros(3)
    unit[axis] = 1e-3 * max(float(np.linalg.norm(at - camera.position)), 1e-6)
    pixels, before = project(camera, np.stack([at, at + unit]))
    direction = (pixels[1] - pixels[0]) / unit[axis]
    length = float(direction @ direction)
    if not before.all() or length < 1e-6:
        return 0.0
    return float(np.asarray(moved) @ direction) / length
