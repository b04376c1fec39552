"""The ground among the points, where somebody clicks on it: which point lies under the mouse, and which plane around it.

Notation: M points and N eyes of cameras, float64 [., 3], in one frame.
"""

from __future__ import annotations

import numpy as np

from viewer.app.projection import project
from viewer.rendering.camera import ViewCamera

REACH = 24.0  # pixels between the mouse and a point that it means
NEIGHBOURS = 40  # points around that tell a plane; fewer than FEWEST tell none
FEWEST = 8
ROUNDS, KEPT = 4, 0.7  # fits, each to this share of the points that lie nearest to the plane before
FLATTEST = 0.35  # how thick points may be, of their lesser breadth, to be a plane


def point_under(camera: ViewCamera, points: np.ndarray, x: float, y: float) -> int | None:
    """The nearest to the camera of the points (grid frame) within REACH of pixel (x, y); None where there is none."""
    pixels, before = project(camera, points)
    near = before & (np.linalg.norm(pixels - (x, y), axis=-1) <= REACH)
    if not near.any():
        return None
    away = np.linalg.norm(points - camera.position, axis=-1)
    return int(np.argmin(np.where(near, away, np.inf)))


def normal_at(points: np.ndarray, index: int, eyes: np.ndarray) -> np.ndarray | None:
    """The unit normal [3], towards the cameras, of the plane about one of the points; None where there is no plane."""
    order = np.argsort(np.linalg.norm(points - points[index], axis=-1), kind="stable")
    around = points[order[:NEIGHBOURS]]
    if len(around) < FEWEST:
        return None
    some, spread, axes, middle = around, np.zeros(3), np.eye(3), around.mean(0)
    for _ in range(ROUNDS):  # what stands on the ground is not of it
        middle = some.mean(0)
        _, spread, axes = np.linalg.svd(some - middle, full_matrices=False)
        off = np.abs((around - middle) @ axes[2])
        some = around[np.argsort(off, kind="stable")[: max(int(KEPT * len(around)), FEWEST)]]
    if spread[2] > FLATTEST * max(spread[1], 1e-12):
        return None
    return axes[2] if ((eyes - middle) @ axes[2]).mean() > 0 else -axes[2]
