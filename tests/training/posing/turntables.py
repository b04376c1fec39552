"""Photographs of a textured ball that turns before a textured wall, by a camera that stands still."""

from __future__ import annotations

import numpy as np

from tests.training.posing.rooms import TILE, bilinear, texture

SIZE = (320, 240)
RADIUS, DISTANCE = 1.0, 3.4  # of the ball, and of the camera from its centre
FOCAL = 330.0  # pixels
STEP = 8.0  # degrees from one picture to the next
SHOWN = 0.6  # of a texture lies around half the ball


def photograph(turned: float) -> tuple[np.ndarray, np.ndarray]:
    """The picture uint8 [H, W, 3] with the ball turned by some degrees, and where the ball is, bool [H, W]."""
    width, height = SIZE
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    directions = np.stack([x, -y, np.full_like(x, -FOCAL)], axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    along = -DISTANCE * directions[..., 2]  # of the point on the ray that is nearest to the centre
    within = RADIUS**2 - (DISTANCE**2 - along**2)
    ball = within > 0
    points = directions * (along - np.sqrt(np.maximum(within, 0)))[..., None] + [0, 0, DISTANCE]
    angle = (np.degrees(np.arctan2(points[..., 0], points[..., 2])) + turned + 90) / 180 * SHOWN
    level = 0.2 * (points[..., 1] / RADIUS + 1) + 0.1
    picture = texture(51)[:height, :width].copy()
    picture[ball] = bilinear(texture(50), *(np.clip(at[ball], 0, 0.998) * (TILE - 1) for at in (level, angle)))
    return picture.astype(np.uint8), ball
