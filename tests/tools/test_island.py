"""The procedural island: deterministic, whole, and what it is taken for."""

from __future__ import annotations

import numpy as np
import pytest

from tools.procedural import drawn, spread_cameras
from tools.procedural.island import make_island
from tools.procedural.island.shapes import COTTAGE_AT, TOWER_AT, Island, ground, nearest

CAMERA = spread_cameras(12, 40, 0.0)[4]


@pytest.fixture(scope="module")
def island() -> Island:
    return make_island(0)


def test_it_is_drawn_alike_each_time_over_a_transparent_background() -> None:
    picture = drawn("island", 0, 1)(CAMERA)
    np.testing.assert_array_equal(picture, drawn("island", 0, 1)(CAMERA))
    assert set(np.unique(picture[..., 3])) == {0, 255}
    seen = picture[picture[..., 3] == 255][:, :3].astype(int)
    red, green, blue = seen.T
    assert 0.3 < len(seen) / picture[..., 3].size < 0.8
    assert ((blue > red + 30) & (blue > 90)).mean() > 0.2  # the sea
    assert (green > blue + 40).mean() > 0.05  # grass and trees
    assert ((red > 120) & (green < 0.5 * red)).any()  # the tower's stripes


def test_distances_never_reach_past_the_next_surface(island: Island) -> None:
    """Between two points, the distance may not shrink by more than the way between them, or rays would go through things."""
    feet = np.array([ground(island.heights, *at) for at in (TOWER_AT, COTTAGE_AT)])
    rng = np.random.default_rng(0)
    through = 0
    for _ in range(3000):
        at, way = rng.uniform([-1.2, -1.2, -0.4], [1.2, 1.2, 1.0]), rng.normal(size=3)
        d, _ = nearest(island, feet, *at)
        if d > 0:
            beyond = at + way / np.linalg.norm(way) * rng.uniform(0, d)
            through += nearest(island, feet, *beyond)[0] < -5e-3
    assert through <= 3  # at the steepest cliffs
