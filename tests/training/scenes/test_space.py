"""Where the rays of a capture begin."""

from __future__ import annotations

import numpy as np
import pytest

from training.scenes.scene import Camera
from training.scenes.space import PointCloud, space_of_capture


def camera_at(x: float) -> Camera:
    """A camera on the x axis that looks at the origin."""
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[0, 3] = (0, 1, 0), (0, 0, 1), (1, 0, 0), x
    return Camera(pose, 40, 40, 40.0, 40.0, 20.0, 20.0)


def test_rays_begin_before_what_the_camera_that_comes_closest_shows() -> None:
    """Of 21 photographs one is taken from close by: by all of them together, its points would be outliers."""
    ball = np.random.default_rng(0).normal(size=(2000, 3))
    ball *= 0.2 / np.linalg.norm(ball, axis=-1, keepdims=True)
    cameras = [*(camera_at(1.0 + 0.01 * i) for i in range(20)), camera_at(0.4)]
    front = np.flatnonzero(ball[:, 0] > 0.15)  # the close one shows what it faces
    seen = [*[np.arange(len(ball))] * 20, front]
    counts = np.bincount(np.concatenate(seen), minlength=len(ball)).astype(float)
    near = space_of_capture(cameras, PointCloud(ball, counts, seen), opaque=True).near
    assert near == pytest.approx(0.7 * 0.2, rel=0.05)
    without = space_of_capture(cameras[:-1], PointCloud(ball, counts, seen[:-1]), opaque=True).near
    assert 0.4 < without <= 0.45
