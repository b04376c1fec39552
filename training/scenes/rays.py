"""Rays of cameras in NumPy: lens distortion undone, and the NDC warp. training.dataset has the JAX twin.

Notation: (x, y) pixel coordinates, pixel centres at +0.5; (u, v) = ((x - cx) / fx, (y - cy) / fy) image coordinates as the lens
made them, y down (OpenCV); (a, b) the same without distortion. A lens distorts, with r^2 = a^2 + b^2:

    u = a (1 + k1 r^2 + k2 r^4) + 2 p1 a b + p2 (r^2 + 2 a^2)
    v = b (1 + k1 r^2 + k2 r^4) + p1 (r^2 + 2 b^2) + 2 p2 a b

We undistort rays, not pictures: no pixel is resampled. In the camera the ray is then (a, -b, -1), OpenGL axes.
"""

from __future__ import annotations

import numpy as np

from scenepack.constants import NDC_NEAR
from training.scenes.scene import Camera

NEWTON_STEPS = 10


def distort(a: np.ndarray, b: np.ndarray, distortion: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(u, v) of undistorted (a, b), any shape; distortion = (k1, k2, p1, p2)."""
    k1, k2, p1, p2 = distortion
    r2 = a * a + b * b
    radial = 1.0 + r2 * (k1 + r2 * k2)
    u = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    v = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    return u, v


def undistort(u: np.ndarray, v: np.ndarray, distortion: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of distort, by Newton's method from (u, v); float64."""
    k1, k2, p1, p2 = distortion
    a, b = np.array(u, np.float64), np.array(v, np.float64)
    if not any(distortion):
        return a, b
    for _ in range(NEWTON_STEPS):
        r2 = a * a + b * b
        radial, slope = 1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * k2 * r2)
        ua = radial + a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a
        ub = a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b  # equals dv/da
        vb = radial + b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a
        du, dv = distort(a, b, distortion)
        du, dv = du - u, dv - v
        determinant = ua * vb - ub * ub
        # where the lens model folds over, no step is better than a wild one
        usable = np.abs(determinant) > 1e-6
        determinant = np.where(usable, determinant, 1.0)
        a = a - np.where(usable, (vb * du - ub * dv) / determinant, 0.0)
        b = b - np.where(usable, (ua * dv - ub * du) / determinant, 0.0)
    return a, b


def pixel_grid(camera: Camera, count: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y [count, count] of pixel coordinates spread evenly over a picture, from edge to edge."""
    x, y = (np.linspace(0.0, side, count) for side in (camera.width, camera.height))
    return np.meshgrid(x, y)  # type: ignore[return-value]


def camera_rays(camera: Camera, x: np.ndarray | None = None, y: np.ndarray | None = None):
    """origins, unit directions float64 [..., 3] through pixel coordinates x, y [...]; default: every pixel's centre [H, W]."""
    if x is None or y is None:
        y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    a, b = undistort((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, camera.distortion)
    directions = np.stack([a, -b, -np.ones_like(a)], axis=-1) @ camera.world_T_camera[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.broadcast_to(camera.world_T_camera[:3, 3], directions.shape), directions


def ndc_rays(
    origins: np.ndarray, directions: np.ndarray, width: float, height: float, focal: float, near: float = NDC_NEAR
) -> tuple[np.ndarray, np.ndarray]:
    """NeRF's NDC warp (appendix C): rays [..., 3], not of unit length, so that t = 0 is the near plane z = -near and t = 1 is
    infinity. width, height, focal: pixels of the reference camera."""
    t = -(near + origins[..., 2]) / directions[..., 2]
    o = origins + t[..., None] * directions
    scale = -2.0 * focal / np.array([width, height])
    place, slope = o[..., :2] / o[..., 2:], directions[..., :2] / directions[..., 2:]
    depth = 2.0 * near / o[..., 2:]
    warped_origins = np.concatenate([scale * place, 1.0 + depth], axis=-1)
    return warped_origins, np.concatenate([scale * (slope - place), -depth], axis=-1)
