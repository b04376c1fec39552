"""NDC space of points, to compare with the warp of rays."""

from __future__ import annotations

import numpy as np

from scenepack.constants import NDC_NEAR


def ndc_points(points: np.ndarray, width: float, height: float, focal: float, near: float = NDC_NEAR) -> np.ndarray:
    """World points [..., 3] (camera frame of the mean pose, z negative in front) in NDC space."""
    z = points[..., 2]
    return np.stack(
        [-2.0 * focal / width * points[..., 0] / z, -2.0 * focal / height * points[..., 1] / z, 1.0 + 2.0 * near / z],
        axis=-1,
    )
