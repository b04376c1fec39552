"""Rays of cameras in NumPy, through their lenses, and the NDC warp. training.dataset has the JAX twin.

Notation: (x, y) pixel coordinates, pixel centres at +0.5; (u, v) = ((x - cx) / fx, (y - cy) / fy) image coordinates as the lens
made them, y down; training.scenes.lens goes on from there. We undistort rays, not pictures: no pixel is resampled.
"""

from __future__ import annotations

import numpy as np

from scenepack.constants import NDC_NEAR
from training.scenes.lens import directions_at, image_of, shows
from training.scenes.scene import Camera


def pixel_grid(camera: Camera, count: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y [count, count] of pixel coordinates spread evenly over a picture, from edge to edge."""
    x, y = (np.linspace(0.0, side, count) for side in (camera.width, camera.height))
    return np.meshgrid(x, y)  # type: ignore[return-value]


def camera_rays(camera: Camera, x: np.ndarray | None = None, y: np.ndarray | None = None):
    """origins, unit directions float64 [..., 3] through pixel coordinates x, y [...]; default: every pixel's centre [H, W]."""
    if x is None or y is None:
        y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    in_camera = directions_at((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, camera.distortion)
    directions = in_camera @ camera.world_T_camera[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.broadcast_to(camera.world_T_camera[:3, 3], directions.shape), directions


def shown_pixels(camera: Camera) -> np.ndarray:
    """bool [H, W]: the pixels in which the lens shows anything: not the corners of a circular fisheye, where the model ends."""
    y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    return shows((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, camera.distortion)


def pixels_of(camera: Camera, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel coordinates [..., 2] of places [..., 3] in the training frame, and which of them the lens shows [...]."""
    u, v, shown = image_of((places - camera.world_T_camera[:3, 3]) @ camera.world_T_camera[:3, :3], camera.distortion)
    return np.stack([camera.cx + camera.fx * u, camera.cy + camera.fy * v], axis=-1), shown


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
