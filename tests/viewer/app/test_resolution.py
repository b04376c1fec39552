"""How many pixels are drawn."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from viewer.app.resolution import SMALLEST_SCALE, Governor, tiles
from viewer.app.timing import FrameTimes


@given(st.integers(1, 700), st.integers(1, 700), st.integers(16, 300))
def test_tiles_cover_every_pixel_once(width, height, side):
    covered = np.zeros((height, width), int)
    for x, y, w, h in tiles(width, height, side):
        assert w > 0 and h > 0
        covered[y : y + h, x : x + w] += 1
    assert (covered == 1).all()


@given(ms_at_full=st.floats(1.0, 1500.0), fps=st.floats(10, 60))
def test_the_scale_finds_the_target_and_stays(ms_at_full, fps):
    governor = Governor(target_fps=fps)
    for _ in range(60):
        governor.moved(ms_at_full * governor.moving_scale**2, 1000)
    time = ms_at_full * governor.moving_scale**2
    assert time <= governor.target_ms or governor.scale == SMALLEST_SCALE
    assert time >= 0.6 * governor.target_ms or governor.scale == 1.0 or governor.scale == SMALLEST_SCALE


def test_a_governor_that_is_off_draws_everything():
    governor = Governor(enabled=False, rest_scale=0.5)
    governor.moved(900.0, 1000)
    assert governor.moving_scale == 0.5


def test_tiles_grow_with_the_cards_speed():
    governor = Governor()
    sides = []
    for speed in (100, 1000, 10000):
        governor.pixels_per_ms = speed
        sides.append(governor.tile_side())
    assert sides == sorted(sides) and sides[0] < sides[2]


def test_frame_times_are_told_and_forgotten():
    times = FrameTimes()
    assert times.summary()["fps"] == 0.0
    for _ in range(500):
        times.add(3.0, 10.0)
    summary = times.summary()
    assert summary["p50"] == 10.0 and summary["fps"] == 100.0 and len(times.frame_ms) < 500
