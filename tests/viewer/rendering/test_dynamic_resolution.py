"""How many pixels are drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewer.rendering.dynamic_resolution import HEADROOM, LATE, SMALLEST_SCALE, DynamicResolution

FULL = 1280 * 800  # pixels of the picture at scale 1


class Machine:
    """Takes known times: panels, swap and fixed (ms), and ms_at_full for all pixels of a picture at scale 1."""

    def __init__(self, ms_at_full: float, panels=0.0, swap=0.0, fixed=0.0, noise=0.0) -> None:
        self.ms_at_full, self.panels, self.swap, self.fixed = ms_at_full, panels, swap, fixed
        self.noise, self.random = noise, np.random.default_rng(0)

    def pixels_ms(self, resolution: DynamicResolution) -> float:
        return self.ms_at_full * resolution.moving_scale**2

    def frame(self, resolution: DynamicResolution) -> float:
        """One frame while the camera moves; how long it took, ms."""
        uneven = 1.0 + self.noise * self.random.uniform(-1, 1)
        picture = (self.fixed + self.pixels_ms(resolution)) * uneven
        resolution.moved(picture, round(FULL * resolution.moving_scale**2))
        frame = self.panels + picture + self.swap
        resolution.frame_ended(frame, self.swap)
        return frame

    def run(self, resolution: DynamicResolution, frames: int = 150) -> None:
        for _ in range(frames):
            self.frame(resolution)


@given(st.floats(1.0, 1500.0), st.floats(10, 60), st.floats(0.0, 0.3), st.floats(0.0, 0.15), st.floats(0.0, 0.1))
def test_the_whole_frame_holds_the_target_and_no_pixels_are_given_away(ms_at_full, fps, panels, swap, fixed):
    resolution = DynamicResolution(target_fps=fps)
    target = resolution.target_ms
    machine = Machine(ms_at_full, panels * target, swap * target, fixed * target)
    machine.run(resolution)
    work = machine.panels + machine.swap + machine.fixed + machine.pixels_ms(resolution)
    assert work <= (LATE + 0.03) * target or resolution.scale == SMALLEST_SCALE
    assert work >= 0.8 * HEADROOM * target or resolution.scale in (1.0, SMALLEST_SCALE)


def test_the_scale_holds_still_while_times_waver():
    resolution = DynamicResolution(target_fps=30.0)
    machine = Machine(ms_at_full=150.0, panels=4.0, swap=3.0, noise=0.05)
    machine.run(resolution)
    scales = [(machine.frame(resolution), resolution.scale)[1] for _ in range(100)]
    assert max(scales) / min(scales) < 1.12 and (np.diff(scales) != 0).mean() < 0.3


def test_a_resolution_that_is_not_dynamic_draws_everything():
    resolution = DynamicResolution(enabled=False, rest_scale=0.5)
    Machine(900.0).run(resolution, 5)
    assert resolution.moving_scale == 0.5


# The mean cost of a ray at each quarter of a second of the flight of tools/fly_window.py through shapes_pack(), as the shader
# counts: samples fetched, and jumps at a third of one.
COSTS = np.array([
    1.05, 1.38, 1.71, 2.49, 3.22, 3.63, 4.13, 5.1, 6.75, 8.03, 10.32, 11.97, 13.64, 13.85, 13.75, 13.21, 14.06,
    12.25, 10.6, 12.49, 17.04, 14.04, 9.84, 7.1, 4.9, 3.29, 2.64, 2.16, 1.81, 1.49, 1.19, 1.04, 1.05,
])  # fmt: skip


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("load", [3.0, 6.0])
@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_the_target_is_held_within_a_tenth_over_a_flight(fps, load, noise):
    """load: frames' times that all pixels of a middling view take. Where every pixel is drawn, frames may be quicker."""
    resolution = DynamicResolution(target_fps=fps)
    target = resolution.target_ms
    times, ms = np.arange(len(COSTS)) / 4, COSTS / COSTS.mean() * load * target
    machine, now = Machine(0.0, 0.15 * target, fixed=0.05 * target, noise=noise), 0.0
    spent, drawn = [], []
    while now < times[-1]:
        machine.ms_at_full = float(np.interp(now, times, ms))
        drawn.append(resolution.moving_scale)
        spent.append(machine.frame(resolution))
        now += spent[-1] / 1000.0
    frames, scales = np.array(spent), np.array(drawn)
    used = frames[scales < 1.0] / target
    assert len(used) > 100 and scales.min() > SMALLEST_SCALE and scales.max() > 3 * scales.min()
    assert abs(used.mean() - HEADROOM) < 0.02  # what is planned for: a tenth below the target
    assert (used > 1.1).mean() <= 0.01 and used.max() < 1.2
    assert (used < 0.75).mean() <= 0.04  # nor are pixels given away
