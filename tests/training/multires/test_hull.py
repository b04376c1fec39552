"""Where nothing can be, by panoramas: their bound on what a ball can show."""

from __future__ import annotations

import numpy as np

from training.multires.hull import _in_panorama

WIDTH, ROWS = 90, 45
ACROSS, DOWN = WIDTH / (2 * np.pi), ROWS / np.pi


def test_a_panorama_shows_a_ball_wherever_one_of_its_pixels_does_and_hardly_elsewhere() -> None:
    """At the poles too, and across the picture's left and right edges."""
    random = np.random.default_rng(0)
    shown = near = 0
    for _ in range(2000):
        x, y = random.integers(WIDTH), random.integers(ROWS)
        table = np.zeros((ROWS + 1, WIDTH + 1), np.int32)
        table[y + 1 :, x + 1 :] = 1
        longitude, latitude = random.uniform(-np.pi, np.pi), np.arcsin(random.uniform(-1, 1))
        angle = random.uniform(0.02, 0.5)
        found = _in_panorama(
            table, ACROSS * longitude + WIDTH / 2, DOWN * latitude + ROWS / 2, latitude, angle, ACROSS, DOWN
        )
        a, b = np.meshgrid(
            (x + np.linspace(0, 1, 9) - WIDTH / 2) / ACROSS, (y + np.linspace(0, 1, 9) - ROWS / 2) / DOWN
        )
        cosines = np.sin(b) * np.sin(latitude) + np.cos(b) * np.cos(latitude) * np.cos(a - longitude)
        meets = np.arccos(np.clip(cosines, -1, 1)).min() < angle - 1e-6
        assert found or not meets
        shown, near = shown + found, near + meets
    assert 30 < near <= shown < 1.5 * near
